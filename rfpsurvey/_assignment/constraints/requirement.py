"""Requirements for the number of targets of a kind or category, per tile, spectrograph or group of positioners."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from numbers import Number

import numpy as np

from rfpsurvey._assignment.constraints.constraint import Constraint
from rfpsurvey._assignment.constraints.counts import Group
from rfpsurvey._sky.arrays import KINDS, has_role
from rfpsurvey.errors import InputError, check_fiber_type, check_keywords, close_to, items_of, listed, refusal, short

NUMBERS = r"(?:([0-9]{1,9})|([0-9]{1,9})?\s*-\s*([0-9]{1,9}))"
FORM = re.compile(
    rf"(?:'((?:[^']|'')+)'\s*|([^'@=/<>][^@=/<>]*))(?:@([^@=/<>]+))?=\s*{NUMBERS}\s*(?:/\s*([^/\s][^/]*))?"
)
PLAIN = re.compile(r"[^'\s@=/<>](?:[^@=/<>]*[^\s@=/<>])?")
MOST = 10**9


@check_keywords
@dataclass(frozen=True)
class Requirement(Constraint):
    """A minimum and a maximum number of observed targets of one kind or category.

    The minimum takes precedence over science targets and is met as far as possible. ``network_flow``, ``optimal`` and
    ``repair`` do not exceed the maximum. The other allocators ignore the maximum; results report each maximum that is
    exceeded.

    Parameters
    ----------
    what : str
        A category of targets, such as ``sky_boss``, or a role: ``science``, ``standard`` or ``sky``. Targets with
        several roles, such as ``science+standard``, count toward the requirements on each of them.
    minimum : int, optional
        Smallest required number of these targets.
    maximum : int, optional
        Largest allowed number of these targets.
    per : str, optional
        Whether the numbers apply to the whole ``tile``, to each ``spectrograph``, or to each value of an integer column
        of the focal plane, such as ``petal`` (``groups`` of `~rfpsurvey.FocalPlane`).
    fiber_type : str, optional
        Count only targets that are observed with this fiber type: those that require it, and those that require no
        fiber type on positioners whose first type it is.

    Raises
    ------
    InputError
        If the minimum or the maximum is not a whole number from 0 to 10^9, if the minimum exceeds the maximum, or if
        ``what``, ``per`` or ``fiber_type`` is not valid.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> rs.Requirement("sky", 20, per="spectrograph")
    Requirement('sky=20/spectrograph')
    >>> rs.Requirement.parse("standard@BOSS=50-70").maximum
    70
    """

    what: str
    minimum: int = 0
    maximum: int | None = None
    per: str = "tile"
    fiber_type: str = ""

    uses_targets = False

    @property
    def counts(self) -> tuple["Requirement"]:
        """The requirement itself."""
        return (self,)

    def missed_limit(self, n: int) -> int | None:
        """Return the limit that a number of targets misses.

        Parameters
        ----------
        n : int
            The number of targets.

        Returns
        -------
        int or None
            The minimum or the maximum; None if the number is between them.
        """
        if n < self.minimum:
            return self.minimum
        return self.maximum if self.maximum is not None and n > self.maximum else None

    def groups(self, problem: object) -> list[Group]:
        """Return the groups of targets and fibers to each of which the minimum and the maximum apply.

        Subclasses can override this method, for example to count sky fibers in each part of the focal plane.

        Parameters
        ----------
        problem : AllocationProblem
            The targets and the focal plane.

        Returns
        -------
        list of Group
            One group for the tile, or one for each spectrograph or value of a column.
        """
        if _holds(problem.category, self.what):
            targets = problem.category == self.what
        elif self.what in KINDS:
            targets = has_role(problem.kind, self.what)
        else:
            targets = np.zeros(len(problem.xy), dtype=bool)
        plane, untyped = problem.focal_plane, {}
        if self.fiber_type:
            first, no_type = plane.arrays.first_type == self.fiber_type, problem.fiber_type == ""
            targets = targets & ((problem.fiber_type == self.fiber_type) | (no_type & first.any()))
            untyped = {"untyped": targets & no_type, "first": first} if (targets & no_type).any() else {}
        if self.per in (plane.groups or {}):
            column = plane.groups[self.per]
            parts = np.unique(column).tolist()
            return [Group(self, None, targets, column == k, f"{self.per} {k}", **untyped) for k in parts]
        places = [None] if self.per == "tile" else np.unique(plane.spectrograph).tolist()
        return [Group(self, place, targets, **untyped) for place in places]

    def __post_init__(self):
        if not isinstance(self.what, str) or not self.what.strip():
            raise refusal("a requirement must contain the name of a kind or category of targets", self.what, str)
        roles = {role.strip() for role in self.what.lower().split("+")}
        if len(roles) > 1 and roles <= {*KINDS}:
            each = " and ".join(f"{role}={self.minimum}" for role in KINDS if role in roles)
            raise InputError(
                f"a requirement must contain one role, got {short(self.what)}; targets with several roles count toward "
                f"the requirements on each of them, such as {each}"
            )
        if not isinstance(self.fiber_type, str):
            raise refusal(f"fiber_type of {self.what!r} must be a name", self.fiber_type, str)
        if not isinstance(self.per, str) or not self.per.strip() or "/" in self.per:
            raise refusal(f"per of {self.what!r} must be 'tile', 'spectrograph' or the name of a column", self.per, str)
        for name in ("minimum", "maximum"):
            value = getattr(self, name)
            if not (value is None and name == "maximum") and not (
                isinstance(value, int | np.integer) and not isinstance(value, bool) and 0 <= value <= MOST
            ):
                raise refusal(f"{name} of {self.what!r} must be a whole number from 0 to 10^9", value, Number)
        if self.maximum is not None and self.minimum > self.maximum:
            raise InputError(
                f"the minimum of the requirement on {self.what!r} must not exceed its maximum {self.maximum}, "
                f"got {self.minimum}"
            )

    @classmethod
    def parse(cls, text: str) -> "Requirement":
        """Make a requirement from text such as ``sky=20/spectrograph``.

        Parameters
        ----------
        text : str
            ``WHAT=MIN``, ``WHAT=MIN-MAX`` or ``WHAT=-MAX``, optionally with ``@FIBER`` after WHAT, and with
            ``/spectrograph``, or ``/`` and the name of a column of the focal plane, at the end if the numbers apply to
            each spectrograph or to each value of the column. WHAT is in single quotes if it contains one of the
            characters ``@=/<>`` or is the name of a constraint; a single quote in it is then doubled.

        Returns
        -------
        Requirement
            The requirement.

        Raises
        ------
        InputError
            If the text does not have one of the allowed forms, or if a number or a name in the text is not valid.
        """
        match = FORM.fullmatch(text.strip()) if isinstance(text, str) else None
        if match is None:
            raise InputError(
                f"a requirement must have a form such as sky=20/spectrograph, standard@BOSS=50 or sky_boss=100-300, "
                f"got {short(text)}"
            )
        quoted, what, fiber, least, low, high, per = match.groups()
        most = None if high is None else int(high)
        name = quoted.replace("''", "'") if quoted else what.strip()
        return cls(name, int(least or low or 0), most, per or "tile", (fiber or "").strip())

    def __str__(self):
        most = "" if self.maximum is None else f"-{self.maximum}"
        fiber = f"@{self.fiber_type}" if self.fiber_type else ""
        named = {constraint.name for constraint in _subclasses(Constraint)} - {*KINDS}
        plain = PLAIN.fullmatch(self.what) and self.what.split()[0] not in named
        what = self.what if plain else "'" + self.what.replace("'", "''") + "'"
        return f"{what}{fiber}={self.minimum}{most}" + ("" if self.per == "tile" else f"/{self.per}")

    def __repr__(self):
        return f"Requirement({str(self)!r})"


def check_counts(counts: Iterable[Requirement], focal_plane: object) -> None:
    """Raise an error if a requirement names a fiber type or a column that a focal plane does not have."""
    names = tuple(focal_plane.groups or {})
    for count in counts:
        if count.fiber_type:
            check_fiber_type(count.fiber_type, focal_plane.fiber_types, f"fiber type of the requirement {str(count)!r}")
        if count.per not in ("tile", "spectrograph", *names):
            known = listed(map(repr, ("spectrograph", *names)), 8)
            hint = close_to(count.per, ("tile", "spectrograph", *names))
            raise InputError(
                f"the requirement {str(count)!r} must name an integer column of the focal plane after '/', one of: "
                f"{known}; got {count.per!r}{hint and '; ' + hint}"
            )


def as_requirements(given: object) -> tuple[Requirement, ...]:
    """Convert one or several requirements, given as objects or text, to a tuple of requirements."""
    if given is None:
        return ()
    requirements = []
    for item in items_of(given, "requirements must be a list of Requirement or text", str, Requirement):
        if not isinstance(item, str | Requirement):
            text = "a requirement must be a Requirement or text such as 'sky=20/spectrograph'"
            raise InputError(f"{text}, got {short(item)}")
        requirements.append(Requirement.parse(item) if isinstance(item, str) else item)
    return tuple(dict.fromkeys(requirements))  # a repeated requirement counts once


def _subclasses(cls: type) -> set[type]:
    """Return a class and all its subclasses, including indirect ones."""
    return {cls}.union(*map(_subclasses, cls.__subclasses__()))


def _holds(column: np.ndarray, word: str) -> bool:
    """Return whether at least one target has the text ``word`` in a column, such as the categories of the targets."""
    return bool(np.any((column[:1] if column.strides == (0,) else column) == word))
