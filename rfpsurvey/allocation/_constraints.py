"""How allocators honor constraints, and the form in which results record long lists of constraints."""

import hashlib
from collections.abc import Callable

from rfpsurvey.constraints import AS_GOAL, EXACTLY, Abilities

# Results record lists of at most this many identifiers or circles. For a longer list, they record the length and a
# digest.
MOST_LISTED = 1000
NETWORK = Abilities(precedence=AS_GOAL, counts=AS_GOAL)
ABILITIES = {
    "balanced": Abilities(),
    "nearest": Abilities(precedence=AS_GOAL),
    "lamost": NETWORK,
    "sdss": NETWORK,
    "optimal": Abilities(EXACTLY, AS_GOAL, AS_GOAL),
    "repair": Abilities(EXACTLY, AS_GOAL, AS_GOAL),
}


def abilities_of(allocator: str | Callable) -> Abilities | None:
    """Return how an allocator honors constraints; None if it is not built in, because this is then not known."""
    return ABILITIES.get(allocator) if isinstance(allocator, str) else None


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
