"""Counts of requirements: the targets and fibers that count, and the counts that a plan does not meet."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from rfpsurvey._assignment.constraints.field import FAIL, PASS, Verdict
from rfpsurvey._common.units import locked
from rfpsurvey._sky.arrays import KINDS
from rfpsurvey.errors import close_to

if TYPE_CHECKING:
    from rfpsurvey._assignment.constraints.requirement import Requirement


@dataclass(frozen=True, eq=False)
class Group:
    """The targets and fibers that count toward one requirement, of the whole tile or of a part of it.

    Parameters
    ----------
    requirement : Requirement
        The requirement.
    spectrograph : int or None
        Only fibers of this spectrograph count; None if the fibers of all spectrographs count.
    targets : ndarray of bool, shape (n_targets,)
        Whether each target counts toward the requirement.
    fibers : ndarray of bool, shape (n_positioners,), optional
        Whether the fiber of each positioner counts; by default, all fibers count.
    place : str, optional
        Name of the part of the focal plane that ``fibers`` marks, for messages.
    untyped : ndarray of bool, shape (n_targets,), optional
        Targets that count only on some positioners, because they require no fiber type.
    first : ndarray of bool, shape (n_positioners,), optional
        The positioners on which the targets in ``untyped`` count.

    Examples
    --------
    >>> import numpy as np
    >>> import rfpsurvey as rs
    >>> group = rs.constraints.Group(rs.Requirement("sky", 1), None, np.array([True, False]))
    >>> group.holds(np.array([0, 1, -1]), np.array([1, 1, 1]), np.array([0, 1, 2]))
    array([ True, False, False])
    """

    requirement: "Requirement"
    spectrograph: int | None
    targets: np.ndarray
    fibers: np.ndarray | None = None
    place: str = ""
    untyped: np.ndarray | None = None
    first: np.ndarray | None = None

    def holds(self, target: np.ndarray, spectrograph: np.ndarray, owner: np.ndarray) -> np.ndarray:
        """Return whether assignments count toward the requirement.

        Parameters
        ----------
        target : ndarray of int
            Row of the target of each assignment, or -1 for no target.
        spectrograph : ndarray of int
            Spectrograph that receives the light of each target.
        owner : ndarray of int
            Row of the positioner of each assignment.

        Returns
        -------
        ndarray of bool
            One value per assignment.
        """
        inside = self.holds_target(target, owner)
        inside = inside if self.spectrograph is None else inside & (spectrograph == self.spectrograph)
        return inside if self.fibers is None else inside & self.fibers[owner]

    def holds_target(self, target: np.ndarray, owner: np.ndarray) -> np.ndarray:
        """Return whether assignments count, in whichever part of the tile the positioners are.

        Parameters
        ----------
        target : ndarray of int
            Row of the target of each assignment, or -1 for no target.
        owner : ndarray of int
            Row of the positioner of each assignment.

        Returns
        -------
        ndarray of bool
            One value per assignment.
        """
        inside = np.append(self.targets, False)[target]
        return (
            inside if self.untyped is None else inside & (~np.append(self.untyped, False)[target] | self.first[owner])
        )


class CountedTargets:
    """Targets on a focal plane, from which the numbers of fibers are counted that requirements demand.

    A subclass is a dataclass with the columns of the targets (``xy``, ``kind``, ``category`` and ``fiber_type``), with
    ``focal_plane``, and with ``requirements``.
    """

    def _complete(self, **more: object) -> None:
        """Lock the columns; a column that is not given repeats one value, and uses no memory."""
        for name, usual in {"kind": "science", "category": "", "fiber_type": "", **more}.items():
            value = getattr(self, name)
            value = np.broadcast_to(np.array(usual), len(self.xy)) if value is None else locked(value)
            object.__setattr__(self, name, value)

    @cached_property
    def groups(self) -> list[Group]:
        """Groups of targets and fibers that count toward one requirement each, per tile or per spectrograph."""
        return [group for requirement in self.requirements for group in requirement.groups(self)]

    @property
    def several_fiber_types(self) -> bool:
        """Whether the fiber types that the targets require are given."""
        return self.fiber_type.strides != (0,)

    @cached_property
    def _fiber_index(self) -> np.ndarray:
        """Index of the fiber type that each target requires (-1: any type); the last element stands for "no target"."""
        index = {name: k for k, name in enumerate(self.focal_plane.fiber_types)}
        names, inverse = np.unique(self.fiber_type, return_inverse=True)
        return np.append(np.array([index.get(str(name), -1) for name in names], dtype=int)[inverse.reshape(-1)], -1)

    def fiber_of(self, owner: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return the index of the fiber type with which each positioner observes its target.

        Parameters
        ----------
        owner, target : ndarray of int, shape (k,)
            Rows of positioners and of their targets.

        Returns
        -------
        ndarray of int, shape (k,)
            Indices of ``focal_plane.fiber_types``.
        """
        first = self.focal_plane.arrays.first_index[owner]
        if not self.several_fiber_types:
            return first
        code = self._fiber_index[target]
        return np.where(code < 0, first, code)

    def spectrograph_of(self, owner: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Return the spectrograph that receives the light of each target through the fiber of its positioner.

        Parameters
        ----------
        owner, target : ndarray of int, shape (k,)
            Rows of positioners and of their targets.

        Returns
        -------
        ndarray of int, shape (k,)
            Number of the spectrograph for each pair of a positioner and its target.
        """
        table = self.focal_plane.spectrograph
        return table[owner] if table.ndim == 1 else table[owner, self.fiber_of(owner, target)]

    def counts_of(self, target_of: np.ndarray) -> list[int]:
        """Return the number of fibers of a plan that count toward each group of ``groups``.

        Parameters
        ----------
        target_of : ndarray of int, shape (n_positioners,)
            Target of each positioner, or -1 if it has no target.

        Returns
        -------
        list of int
            One number for each group.
        """
        owner = np.flatnonzero(target_of >= 0)
        place = self.spectrograph_of(owner, target_of[owner])
        return [int(group.holds(target_of[owner], place, owner).sum()) for group in self.groups]

    def shortfalls(self, target_of: np.ndarray) -> list["Shortfall"]:
        """Return the requirements that a plan does not meet.

        Parameters
        ----------
        target_of : ndarray of int, shape (n_positioners,)
            Target of each positioner, or -1 if it has no target.

        Returns
        -------
        list of Shortfall
            The requirements that are not met, with the required number and the actual number of targets.
        """
        shortfalls = []
        for group, n in zip(self.groups, self.counts_of(target_of), strict=True):
            count, limit = group.requirement, group.requirement.missed_limit(n)
            if limit is not None:
                shortfalls.append(
                    Shortfall(count, group.spectrograph, limit, n, *self._prospects(group, n, limit), group.place)
                )
        return shortfalls

    def verdicts(self, target_of: np.ndarray) -> list[Verdict]:
        """Return the verdict on each requirement, for each part of the focal plane to which it applies.

        Parameters
        ----------
        target_of : ndarray of int, shape (n_positioners,)
            Target of each positioner, or -1 if it has no target.

        Returns
        -------
        list of Verdict
            One verdict for each group of ``groups``.
        """
        verdicts = []
        for group, n in zip(self.groups, self.counts_of(target_of), strict=True):
            count = group.requirement
            limit = f"at least {count.minimum}" if count.maximum is None else f"{count.minimum} to {count.maximum}"
            place = group.place if group.spectrograph is None else f"spectrograph {group.spectrograph}"
            verdicts.append(Verdict(str(count), n, limit, PASS if count.missed_limit(n) is None else FAIL, place))
        return verdicts

    def _prospects(self, group: Group, n: int, limit: int) -> tuple[int, str]:
        """Return how many targets of a group are in reach, and a hint if too few of them (``n``) have a fiber.

        By default, it is not known which targets are in reach.
        """
        return limit, ""


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

    requirement: "Requirement | None"
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
    for shortfall in shortfalls:
        by_requirement.setdefault((shortfall.requirement, shortfall.requested > shortfall.found), []).append(shortfall)
    texts = []
    for (_, lacking), rows in by_requirement.items():
        per = "tile" if rows[0].requirement is None else rows[0].requirement.per
        if len(rows) == 1 or not lacking or per == "tile":
            texts += [str(shortfall) for shortfall in rows]
            continue
        missing, possible = sum(r.requested - r.found for r in rows), sum(r.possible for r in rows)
        names = [r.place.removeprefix(f"{per} ") or str(r.spectrograph) for r in rows[:16]]
        places = ", ".join(names) + (", ..." if len(rows) > 16 else "")
        why = f"; {_few(possible)} in reach there" if possible < sum(r.requested for r in rows) else ""
        texts.append(
            f"{rows[0].what}, {rows[0].requested} in each {per}: {missing} missing in {len(rows)} {per}s "
            f"({places}){why or (rows[0].hint and '; ' + rows[0].hint)}"
        )
    return texts


def _few(n):
    return "none is" if n == 0 else f"only {n} {'is' if n == 1 else 'are'}"


def hint_of_name(what: str, names: Iterable[str]) -> str:
    """Return a hint for an unknown name: a similar name among the kinds of targets and the categories ``names``."""
    names = {*KINDS, *names} - {""}
    if what in names:
        return ""
    singular = f"{what[:-3]}y" if what.endswith("ies") else what  # "skies" alone is not similar enough to "sky"
    return close_to(what, names) or close_to(singular, names)
