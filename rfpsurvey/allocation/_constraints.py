"""The form in which results record constraints, and long lists of them."""

import hashlib

from rfpsurvey.errors import InputError

# Results record lists of at most this many identifiers or circles. For a longer list, they record the length and a
# digest.
MOST_LISTED = 1000


def recorded_constraints(record: dict) -> list[str]:
    """Return the text of all constraints in a record of options, which results store."""
    texts = [*record.get("requirements", [])] if isinstance(record.get("requirements"), list) else []
    texts += [f"required {' '.join(record['required'])}"] if record.get("required") else []
    texts += [f"keep_out {text.removeprefix('cap ')}" for text in record.get("keep_out", [])]
    return [*texts, *record.get("constraints", [])]


def recorded(texts: list[str]) -> list[str]:
    """Return the list that results store for identifiers or circles; a long list becomes its length and a digest."""
    if len(texts) <= MOST_LISTED:
        return texts
    return [f"{len(texts)} in all, digest {hashlib.sha256(chr(10).join(texts).encode()).hexdigest()[:16]}"]


def listed_in(recorded: list[str]) -> list[str]:
    """Return the texts in a record; raise an error if it contains only their number and a digest."""
    if len(recorded) == 1 and " in all, digest " in recorded[0]:
        raise InputError(f"a record determines options only if it contains all texts of a list, got {recorded[0]}")
    return recorded
