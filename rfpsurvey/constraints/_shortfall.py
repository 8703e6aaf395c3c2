"""Counts that a plan does not meet, as objects and as sentences, such as too few sky fibers."""

from collections.abc import Iterable
from dataclasses import dataclass

from rfpsurvey.constraints._requirement import Requirement


@dataclass(frozen=True)
class Shortfall:
    """A requirement that a plan does not meet, with the required number and the actual number of targets.

    Parameters
    ----------
    requirement : Requirement or None
        The requirement; None if targets of the parameter ``required`` have no fiber.
    spectrograph : int or None
        Spectrograph in which the requirement is not met; None if the requirement applies to the whole tile.
    requested : int
        Required number of targets; the maximum if the plan contains too many targets.
    found : int
        Number of targets in the plan that count toward the requirement.
    possible : int
        Number of targets that count toward the requirement and are in reach of positioners that can observe them.
    hint : str, optional
        A similar name that the user may have intended, or the reason why targets are missing.
    place : str, optional
        Name of the part of the focal plane in which the requirement is not met, if it is not a spectrograph.
    """

    requirement: Requirement | None
    spectrograph: int | None
    requested: int
    found: int
    possible: int
    hint: str = ""
    place: str = ""

    @property
    def what(self) -> str:
        """Description of the targets, such as ``sky targets for BOSS``."""
        if self.requirement is None:
            return "required targets"
        fiber = f" for {self.requirement.fiber_type}" if self.requirement.fiber_type else ""
        return f"{self.requirement.what} targets{fiber}"

    def __str__(self):
        where = f" in {self.place}" if self.place else ""
        where = where if self.spectrograph is None else f" in spectrograph {self.spectrograph}"
        missing = self.requested - self.found
        if missing < 0:
            return f"{self.what}{where}: {self.found}, {-missing} more than the maximum of {self.requested}"
        why = f"; {_few(self.possible)} in reach" if self.possible < self.requested else ""
        hint = f"; {self.hint}" if self.hint else ""
        return f"{self.what}{where}: {self.found} of {self.requested}, {missing} missing{why}{hint}"


def sentences(shortfalls: Iterable[Shortfall]) -> list[str]:
    """Return one sentence for each requirement that is not met."""
    by_requirement: dict = {}
    for one in shortfalls:
        by_requirement.setdefault((one.requirement, one.requested > one.found), []).append(one)
    found = []
    for (_, lacking), rows in by_requirement.items():
        per = "tile" if rows[0].requirement is None else rows[0].requirement.per
        if len(rows) == 1 or not lacking or per == "tile":
            found += [str(one) for one in rows]
            continue
        missing, possible = sum(r.requested - r.found for r in rows), sum(r.possible for r in rows)
        names = [r.place.removeprefix(f"{per} ") or str(r.spectrograph) for r in rows[:16]]
        places = ", ".join(names) + (", ..." if len(rows) > 16 else "")
        why = f"; {_few(possible)} in reach there" if possible < sum(r.requested for r in rows) else ""
        found.append(
            f"{rows[0].what}, {rows[0].requested} in each {per}: {missing} missing in {len(rows)} {per}s "
            f"({places}){why or (rows[0].hint and '; ' + rows[0].hint)}"
        )
    return found


def _few(n):
    return "none is" if n == 0 else f"only {n} {'is' if n == 1 else 'are'}"
