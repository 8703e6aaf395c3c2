"""One allocation to make: targets, who reaches them, what they are worth, and what the plan must hold."""

from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from typing import NamedTuple

import numpy as np

from rfpsurvey.allocation._requirements import KINDS, Group, Requirement, Shortfall
from rfpsurvey.focal_plane import FocalPlane, Reach

__all__ = ["Choice", "Level", "Problem"]


class Level(NamedTuple):
    """One aim of a plan; earlier ones come first, whatever it costs later ones."""

    name: str
    value: float
    bound: float
    """What no plan exceeds, given the values of the levels before; NaN where nothing is proven."""


class Choice(NamedTuple):
    """What a method comes back with."""

    target_of: np.ndarray
    side: np.ndarray | None = None
    """Elbows, +1 right, -1 left; None: the usual ones."""
    queues: tuple | None = None
    levels: list[Level] | None = None
    meta: dict | None = None


@dataclass(frozen=True, eq=False)
class Problem:
    """Targets in mm and what is asked of them."""

    plane: FocalPlane
    points: np.ndarray
    reach: Reach
    rank: np.ndarray
    """Priority class of each target, 0 the most important; ``len(classes)`` for what is not science."""
    classes: tuple
    """Priorities, the largest first."""
    kind: np.ndarray | None = None
    category: np.ndarray | None = None
    wanted: np.ndarray | None = None
    """Fiber type that each target needs, "" for any."""
    required: np.ndarray | None = None
    requirements: tuple[Requirement, ...] = ()
    watched: np.ndarray | None = None
    """Sky position that the fiber of a stuck positioner looks at, -1 for none."""
    objective: str = "priority"
    time_limit: float = np.inf
    parked_obstacles: bool = True
    start: Callable[[], Choice] | None = None
    """Makes the plan to begin with."""
    rng: np.random.Generator | None = None

    @cached_property
    def science(self) -> np.ndarray:
        """Targets that are science."""
        return self.rank < len(self.classes)

    @cached_property
    def groups(self) -> list[Group]:
        """Everything that the requirements count."""
        found = []
        for one in self.requirements:
            if self.category is not None and np.any(self.category == one.what):
                targets = self.category == one.what
            elif one.what in KINDS:
                kind = np.full(len(self.points), "science") if self.kind is None else self.kind
                targets = kind == one.what
            else:
                targets = np.zeros(len(self.points), dtype=bool)
            if one.fiber_type:
                targets = targets & (self.fibers == one.fiber_type)
            places = [None] if one.per == "tile" else np.unique(self.plane.spectrograph).tolist()
            found += [Group(one, place, targets) for place in places]
        return found

    @cached_property
    def fibers(self) -> np.ndarray:
        """Fiber type that each target needs."""
        return np.full(len(self.points), "") if self.wanted is None else self.wanted

    def rank_of(self, target: np.ndarray) -> np.ndarray:
        """Class of targets; that of no target (-1) comes after all others."""
        found = np.full(np.shape(target), len(self.classes) + 1, dtype=np.int64)
        real = np.asarray(target) >= 0
        found[real] = self.rank[target[real]]  # without a copy of the ranks of all targets
        return found

    @cached_property
    def _fiber_index(self) -> np.ndarray:
        """Index of the fiber type that each target needs; -1 for any, and in the last place for no target."""
        index = {name: k for k, name in enumerate(self.plane.fiber_types)}
        names, inverse = np.unique(self.wanted, return_inverse=True)
        return np.append(np.array([index.get(str(name), -1) for name in names], dtype=int)[inverse.reshape(-1)], -1)

    def fiber_of(self, own: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Index of the fiber type with which positioners look at targets."""
        first = self.plane._first_index[own]
        if self.wanted is None:
            return first
        code = self._fiber_index[target]
        return np.where(code < 0, first, code)

    def spectrograph_of(self, own: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Spectrograph into which positioners send the light of targets."""
        table = self.plane.spectrograph
        return table[own] if table.ndim == 1 else table[own, self.fiber_of(own, target)]

    def only(self, targets: np.ndarray) -> Reach:
        """Return the reachable pairs of some targets."""
        return self.reach if targets.all() else self.reach.where(targets[self.reach.target])

    def values(self, target_of: np.ndarray) -> dict[str, float]:
        """Return what a plan reaches at each level, in their order; more is better."""
        used = target_of[target_of >= 0]
        counts = np.bincount(self.rank[used], minlength=len(self.classes) + 1)
        levels = {}
        if self.required is not None:
            levels["required targets"] = float(self.required[used].sum())
        if self.groups:
            missing = [g.requirement.minimum - n for g, n in zip(self.groups, self._counts(target_of), strict=True)]
            levels["requirements"] = 0.0 - sum(max(n, 0) for n in missing)
        if self.objective == "count" and len(self.classes) > 1:
            levels["science"] = float(counts[:-1].sum())
        for priority, count in zip(self.classes, counts[:-1], strict=True):
            levels["science" if len(self.classes) == 1 else f"priority {priority:.15g}"] = float(count)
        if not self.science.all():
            levels["any target"] = float(counts.sum())
        return levels

    def _counts(self, target_of: np.ndarray) -> list[int]:
        """Return how many fibers of a plan each group counts."""
        own = np.flatnonzero(target_of >= 0)
        place = self.spectrograph_of(own, target_of[own])
        return [int(group.holds(target_of[own], place).sum()) for group in self.groups]

    def shortfalls(self, target_of: np.ndarray) -> list[Shortfall]:
        """Return the requirements that a plan does not meet."""
        found = []
        for group, n in zip(self.groups, self._counts(target_of), strict=True):
            one = group.requirement
            if n < one.minimum:
                possible = self._possible(group)
                hint = self._hint(group, possible)
                found.append(Shortfall(one, group.spectrograph, one.minimum, n, possible, hint))
            elif one.maximum is not None and n > one.maximum:
                found.append(Shortfall(one, group.spectrograph, one.maximum, n, self._possible(group)))
        used = target_of[target_of >= 0]
        if self.required is not None and (n := int(self.required[used].sum())) < self.required.sum():
            possible = int((self.required & (np.diff(self.reach.indptr) > 0)).sum())
            found.append(Shortfall(None, None, int(self.required.sum()), n, possible))
        return found

    def _hint(self, group: Group, possible: int) -> str:
        """Say what may be wrong: a name that no target has, or more than there are positioners."""
        if group.targets.any():
            enough = possible >= group.requirement.minimum
            asked, there = sum(g.requirement.minimum for g in self.groups), int(self.plane._usable.sum())
            return f"all requirements ask for {asked} fibers, and there are {there}" if asked > there and enough else ""
        if group.requirement.what in KINDS:
            return ""
        names = {*KINDS, *(() if self.category is None else np.unique(self.category).tolist())} - {""}
        close = get_close_matches(group.requirement.what.lower(), sorted(names), n=1)
        return f"did you mean {close[0]!r}?" if close else ""

    def _possible(self, group: Group) -> int:
        """How many targets of a group are in reach of a fiber that would count."""
        own, target = self.reach.owner, self.reach.target
        held = group.holds(target, self.spectrograph_of(own, target))
        n = len(np.unique(target[held]))
        if self.watched is not None:
            stuck = np.flatnonzero(self.watched >= 0)
            n += int(group.holds(self.watched[stuck], self.spectrograph_of(stuck, self.watched[stuck])).sum())
        return n
