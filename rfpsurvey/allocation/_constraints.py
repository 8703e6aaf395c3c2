"""How allocators honor constraints, and the form in which results record long lists of constraints."""

import hashlib

from rfpsurvey.constraints import AS_GOAL, EXACTLY, ONLY_CHECKED, Abilities

# Results record lists of at most this many identifiers or circles. For a longer list, they record the length and a
# digest.
MOST_LISTED = 1000
COUNTS = {"exactly": EXACTLY, "goal": AS_GOAL, "no": ONLY_CHECKED}


def abilities_of(method) -> Abilities:
    """Return how an allocator honors constraints, from its record."""
    return Abilities(
        EXACTLY if method.avoids_collisions else ONLY_CHECKED,
        AS_GOAL if method.uses("required") else ONLY_CHECKED,
        COUNTS[method.counts],
        COUNTS[method.distribution],
        EXACTLY if method.avoids_collisions else ONLY_CHECKED,
    )


def recorded_constraints(record: dict) -> list[str]:
    """Return the text of all constraints in a record of options, which results store."""
    found = [*record.get("requirements", [])] if isinstance(record.get("requirements"), list) else []
    found += [f"required {' '.join(record['required'])}"] if record.get("required") else []
    found += [f"keep_out {text.removeprefix('cap ')}" for text in record.get("keep_out", [])]
    return [*found, *record.get("constraints", [])]


def recorded(texts: list[str]) -> list[str]:
    """Return the list that results store for identifiers or circles; a long list becomes its length and a digest."""
    if len(texts) <= MOST_LISTED:
        return texts
    return [f"{len(texts)} in all, digest {hashlib.sha256(chr(10).join(texts).encode()).hexdigest()[:16]}"]
