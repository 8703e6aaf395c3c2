"""The allocation problem that every allocator receives."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy  # its subpackages are imported on first use

from rfpsurvey._assignment.answer import AllocationAnswer, Objectives
from rfpsurvey._assignment.clock import now
from rfpsurvey._assignment.constraints.counts import CountedTargets, Group, Shortfall, hint_of_name
from rfpsurvey._assignment.constraints.requirement import Requirement
from rfpsurvey._assignment.constraints.rules import Distribution
from rfpsurvey._assignment.distribution import Motion, is_possible, lack_of
from rfpsurvey._common.units import locked
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.reach import Reach
from rfpsurvey.errors import InputError

if TYPE_CHECKING:
    from rfpsurvey._assignment.options import AllocationOptions


def _default_options() -> "AllocationOptions":
    from rfpsurvey._assignment.options import AllocationOptions

    return AllocationOptions()


def _no_start() -> AllocationAnswer:
    raise InputError("the option start must be given for an allocator that improves another plan")


@dataclass(frozen=True, eq=False)
class AllocationProblem(CountedTargets):
    """Targets on a focal plane, their priorities, and the options of the plan, as read-only arrays; lengths are in mm.

    Every allocator, built in or from another package, is a function that takes an `AllocationProblem` and returns an
    `~rfpsurvey.allocation.AllocationAnswer`. Instead, the function may return an array with the target of each
    positioner, or a tuple of this array and an array with the handedness of each arm ("right" or "left").

    Parameters
    ----------
    focal_plane : FocalPlane
        The positioners.
    xy : ndarray of float, shape (n_targets, 2)
        Positions of the targets on the focal plane, mm. The last rows are blank positions that were added for sky
        fibers.
    pairs : Reach
        Pairs of a positioner and a target that may be assigned to each other. Reach, joint limits, fiber types,
        disabled positioners and forbidden pairs have been taken into account.
    rank : ndarray of int, shape (n_targets,)
        Class of each target; 0 is the most important. Targets that are not science targets are in the last class.
    classes : tuple of float
        Priority of each class, the largest first.
    kind : ndarray of str, shape (n_targets,), optional
        Kind of each target: ``science`` (the default), ``standard`` or ``sky``.
    category : ndarray of str, shape (n_targets,), optional
        Category of each target, to which requirements can refer; ``""`` means no category.
    fiber_type : ndarray of str, shape (n_targets,), optional
        Fiber type that each target requires; ``""`` means any type.
    is_required : ndarray of bool, shape (n_targets,), optional
        Whether a target takes precedence over all targets that are not required.
    options : AllocationOptions, optional
        Requirements, objective, time limit and the other options of the plan.
    rng : numpy.random.Generator, optional
        Random number generator. Plans are reproducible only if allocators use no other generator.
    start : callable, optional
        ``problem.start()`` returns the plan that the option ``start`` specifies: by default, the plan of
        ``lamost_rule``.
    watched : ndarray of int, shape (n_positioners,), optional
        Row of the sky position that each stuck positioner observes; -1 if the positioner is not stuck, or if its fiber
        observes no sky position.
    tell : callable, optional
        Function that an allocator may call during a long search, with the completed fraction and the name of the stage.
    subpriority : ndarray of float, shape (n_targets,), optional
        Subpriority of each target, if the options have a ``subpriority``. The rows of the targets are then in order of
        decreasing subpriority; the rows of blank positions follow.
    deadline : float, optional
        Time at which the time limit of the plan ends, on the clock of the built-in allocators.
    motion : Motion, optional
        Motion of the arms, if a constraint requires that they unfold without collisions. The built-in allocators use
        it.
    avoided : tuple, optional
        Combinations of one or two assignments that a plan should not contain; each assignment consists of the
        positioner, the target and the elbow (1.0 is right, -1.0 is left). The built-in allocators use them.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> import rfpsurvey as rs
    >>> def first(problem):  # positioner after positioner, the first target in the catalog that is free
    ...     target_of = np.full(len(problem.focal_plane), -1)
    ...     for own in range(len(target_of)):
    ...         reach = problem.reachable[[own]].indices
    ...         target_of[own] = next((t for t in reach if t not in target_of), -1)
    ...     return target_of
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> rs.allocate(plane, [[14, 0], [20, 10], [12, 0]] * u.mm, allocator=first).target_of_positioner
    array([0, 1])
    """

    focal_plane: FocalPlane
    xy: np.ndarray
    pairs: Reach
    rank: np.ndarray
    classes: tuple
    kind: np.ndarray | None = None
    category: np.ndarray | None = None
    fiber_type: np.ndarray | None = None
    is_required: np.ndarray | None = None
    options: "AllocationOptions" = field(default_factory=_default_options)
    rng: np.random.Generator | None = None
    start: Callable[[], AllocationAnswer] = field(default_factory=lambda: _no_start)
    watched: np.ndarray | None = None
    tell: Callable[[float, str], None] | None = None
    subpriority: np.ndarray | None = None
    deadline: float | None = None
    motion: Motion | None = None
    avoided: tuple = ()

    def __post_init__(self):
        if self.deadline is None:
            object.__setattr__(self, "deadline", now() + self.time_limit)
        for name in ("xy", "rank", *(["subpriority"] if self.subpriority is not None else [])):
            object.__setattr__(self, name, locked(getattr(self, name)))
        self._complete(is_required=False)

    @cached_property
    def reachable(self) -> "scipy.sparse.csr_array":
        """Whether a positioner may observe a target: bool, shape (n_positioners, n_targets)."""
        matrix = self.pairs.matrix
        for array in (matrix.data, matrix.indices, matrix.indptr):
            array.flags.writeable = False
        return matrix

    @cached_property
    def priority(self) -> np.ndarray:
        """Priority of each target; larger values are more important. It is NaN for sky positions and standards."""
        return locked(np.append(self.classes, np.nan)[self.rank])

    @property
    def requirements(self) -> tuple[Requirement, ...]:
        """The requirements of the plan."""
        return self.options.counts

    @property
    def objective(self) -> str:
        """Quantity to maximize: ``priority`` (one class after the other) or ``count`` (all science targets first)."""
        return self.options.objective

    @property
    def time_limit(self) -> float:
        """Time limit of the search for a plan, in seconds."""
        return self.options.seconds

    @property
    def parked_obstacles(self) -> bool:
        """Whether idle positioners with two arms of equal length are obstacles."""
        return self.options.parked_obstacles

    @cached_property
    def any_required(self) -> bool:
        """Whether at least one target is required."""
        return bool(self.is_required.any())

    @cached_property
    def science(self) -> np.ndarray:
        """Whether each target is a science target, shape (n_targets,)."""
        return self.rank < len(self.classes)

    @cached_property
    def distributions(self) -> tuple[Distribution, ...]:
        """The rules on the distribution of fibers that plans should follow, without rules that no plan can follow."""
        return tuple(rule for rule in self.options.distributions if is_possible(self, rule))

    @cached_property
    def any_goals(self) -> bool:
        """Whether there are requirements or rules on the distribution of fibers."""
        return bool(self.groups or self.distributions)

    def rank_of(self, target: np.ndarray) -> np.ndarray:
        """Return the class of each target; the row -1, which means no target, has a class after all other classes.

        Parameters
        ----------
        target : ndarray of int
            Rows of targets, -1 for no target.

        Returns
        -------
        ndarray of int
            Class of each element of ``target``, with the same shape.
        """
        last = len(self.classes) + 1
        if len(self.rank) == 0:
            return np.full(np.shape(target), last)
        return np.where(np.asarray(target) >= 0, self.rank.take(target, mode="clip"), last)

    def only(self, targets: np.ndarray) -> Reach:
        """Return the reachable pairs (positioner, target) of the marked targets.

        Parameters
        ----------
        targets : ndarray of bool, shape (n_targets,)
            Whether to keep the pairs of each target.

        Returns
        -------
        Reach
            The pairs of the marked targets.
        """
        return self.pairs if targets.all() else self.pairs.where(targets[self.pairs.target])

    @cached_property
    def _objectives(self) -> Objectives:
        all_first = self.objective == "count" and len(self.classes) > 1
        special = ["required targets"] * self.any_required + ["requirements"] * self.any_goals
        return Objectives.of(special, self.classes, all_first=all_first, any_last=not self.science.all())

    @property
    def level_names(self) -> tuple[str, ...]:
        """Names of the objectives, in order of precedence."""
        return self._objectives.names

    def level_values(self, target_of: np.ndarray) -> np.ndarray:
        """Return the value of each objective in `level_names` for a plan; larger values are better.

        Parameters
        ----------
        target_of : ndarray of int, shape (n_positioners,)
            Target of each positioner, or -1 if it has no target.

        Returns
        -------
        ndarray of float
            The values, in order of precedence.
        """
        used = target_of[target_of >= 0]
        before = np.append(0, np.cumsum(np.bincount(self.rank[used], minlength=len(self.classes) + 1)))
        values = (before[self._objectives.stop] - before[self._objectives.first]).astype(float)
        if self.any_required:
            values[0] = self.is_required[used].sum()
        if self.any_goals:
            missing = [g.requirement.minimum - n for g, n in zip(self.groups, self.counts_of(target_of), strict=True)]
            missing += [lack_of(self, rule, target_of) for rule in self.distributions]
            values[int(self.any_required)] = 0.0 - sum(max(n, 0) for n in missing)
        return values

    def values(self, target_of: np.ndarray) -> dict[str, float]:
        """Return the value of each objective of a plan, in order of precedence; larger values are better.

        Parameters
        ----------
        target_of : ndarray of int, shape (n_positioners,)
            Target of each positioner, or -1 if it has no target.

        Returns
        -------
        dict of str to float
            Name and value of each objective.
        """
        return dict(zip(self.level_names, self.level_values(target_of).tolist(), strict=True))

    def meets_requirements(self, target_of: np.ndarray, slack: float = 0.0) -> bool:
        """Return whether a plan meets all requirements.

        Parameters
        ----------
        target_of : ndarray of int, shape (n_positioners,)
            Target of each positioner, or -1 if it has no target.
        slack : float, optional
            Fraction by which the plan may miss a minimum, or exceed a maximum.

        Returns
        -------
        bool
            Whether no minimum is missed and no maximum is exceeded.
        """
        for group, n in zip(self.groups, self.counts_of(target_of), strict=True):
            low, high = group.requirement.minimum, group.requirement.maximum
            if n < (1 - slack) * low or n > (1 + slack) * (n if high is None else high):
                return False
        return True

    def shortfalls(self, target_of: np.ndarray) -> list[Shortfall]:
        """Return the requirements that a plan does not meet, and the required targets without a fiber.

        Parameters
        ----------
        target_of : ndarray of int, shape (n_positioners,)
            Target of each positioner, or -1 if it has no target.

        Returns
        -------
        list of Shortfall
            The requirements that are not met, with the required number and the actual number of targets.
        """
        shortfalls, used = super().shortfalls(target_of), target_of[target_of >= 0]
        if self.any_required and (n := int(self.is_required[used].sum())) < self.is_required.sum():
            possible = int((self.is_required & (np.diff(self.pairs.indptr) > 0)).sum())
            shortfalls.append(Shortfall(None, None, int(self.is_required.sum()), n, possible))
        return shortfalls

    def _prospects(self, group: Group, n: int, limit: int) -> tuple[int, str]:
        owner, target = self.pairs.owner, self.pairs.target
        possible = len(np.unique(target[group.holds(target, self.spectrograph_of(owner, target), owner)]))
        if self.watched is not None:
            stuck = np.flatnonzero(self.watched >= 0)
            place = self.spectrograph_of(stuck, self.watched[stuck])
            possible += int(group.holds(self.watched[stuck], place, stuck).sum())
        if n >= group.requirement.minimum:
            return possible, ""
        if not group.targets.any():
            return possible, hint_of_name(group.requirement.what, np.unique(self.category).tolist())
        asked, there = sum(g.requirement.minimum for g in self.groups), int(self.focal_plane.arrays.usable.sum())
        text = f"all requirements together need {asked} fibers, but only {there} fibers are usable"
        return possible, text if asked > there and possible >= group.requirement.minimum else ""


def with_watched(problem: AllocationProblem, target_of: np.ndarray) -> np.ndarray:
    """Return the target of each positioner, including the sky positions that stuck fibers observe."""
    return target_of if problem.watched is None else np.where(problem.watched >= 0, problem.watched, target_of)
