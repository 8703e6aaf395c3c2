"""Allocators of other packages, and functions: what they see, and what they may come back with."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.sparse import csr_array

from rfpsurvey._plugins import Plugin, find_function, find_plugin, name_of
from rfpsurvey._units import to_plain
from rfpsurvey.allocation._methods import METHODS
from rfpsurvey.allocation._problem import Choice, Problem
from rfpsurvey.allocation._requirements import Requirement
from rfpsurvey.errors import InputError
from rfpsurvey.focal_plane import FocalPlane, joints_allow

__all__ = ["AllocationProblem", "find_method", "packages"]

GROUP = "rfpsurvey.allocators"
ELBOWS = ("right", "left")


@dataclass(frozen=True, eq=False)
class AllocationProblem:
    """What an allocator of one's own is given: numbers without units, in mm, in arrays that are read only.

    The allocator returns ``target_of_positioner``, an array of int, shape (n_positioners,), -1 for none; or a tuple of
    that and the elbows, an array of "right" or "left" of the same shape.

    Parameters
    ----------
    focal_plane : FocalPlane
        The positioners.
    xy : ndarray of float, shape (n_targets, 2)
        Targets on the focal plane, mm. Blank positions that were found for sky are the last rows.
    reachable : scipy.sparse.csr_array of bool, shape (n_positioners, n_targets)
        Which positioner may observe which target: reach, joint limits, fiber types, disabled units and forbidden pairs
        are all in it.
    rank : ndarray of int, shape (n_targets,)
        Class of each target, 0 the most important; what is not science has the largest number.
    priority : ndarray of float, shape (n_targets,)
        The priorities behind the classes, larger is more important; NaN for what is not science.
    kind : ndarray of str, shape (n_targets,)
        ``science``, ``standard`` or ``sky``.
    category : ndarray of str, shape (n_targets,)
        Names that requirements refer to; ``""`` for none.
    fiber_type : ndarray of str, shape (n_targets,)
        Fiber type that each target needs; ``""`` for any.
    required : ndarray of bool, shape (n_targets,)
        Targets that come before everything else.
    requirements : tuple of Requirement
        What the plan is to hold; what it lacks is reported.
    objective : {"priority", "count"}
        Class after class, or the number of science targets before the classes.
    time_limit : float
        Seconds to spend at most.
    parked_obstacles : bool
        Do idle equal-arm positioners stand in the way?
    rng : numpy.random.Generator
        The only source of random numbers to use, so that a plan can be made again.
    start : callable
        ``problem.start()`` makes the plan that the user's ``start`` stands for, that of ``lamost`` by default: a tuple
        of ``target_of_positioner`` and elbows.

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
    >>> rs.allocate([[14, 0], [20, 10], [12, 0]] * u.mm, plane, method=first).target_of_positioner
    array([0, 1])
    """

    focal_plane: FocalPlane
    xy: np.ndarray
    reachable: csr_array
    rank: np.ndarray
    priority: np.ndarray
    kind: np.ndarray
    category: np.ndarray
    fiber_type: np.ndarray
    required: np.ndarray
    requirements: tuple[Requirement, ...]
    objective: str
    time_limit: float
    parked_obstacles: bool
    rng: np.random.Generator
    start: Callable[[], tuple[np.ndarray, np.ndarray]]


def find_method(
    given: str | Callable, known: Iterable[str] = METHODS, what: str = "allocator"
) -> Callable[[Problem], Choice]:
    """Return the function from a problem to a choice: ours, that of a package, or the one given."""
    if isinstance(given, str) and given in METHODS and given in known:
        return METHODS[given]
    return partial(_ask, find_function(GROUP, given, known, what))


def packages(method: str | Callable, start: object = None) -> dict[str, str]:
    """Return name and version of the packages behind a method, and behind the plan that it may begin with."""
    found, own = {}, name_of(method)
    for name in (method, start) if own == "repair" or own not in METHODS else ():
        if isinstance(name, str) and name not in METHODS:
            found.update(find_plugin(GROUP, name, METHODS, "allocator").software)
    return found


def _ask(plugin: Plugin, problem: Problem) -> Choice:
    """Let a plugin solve a problem."""
    with plugin.answering():
        answer = plugin.value(_view(problem))
        target_of, elbows = answer if isinstance(answer, tuple) and len(answer) == 2 else (answer, None)
        target_of = _checked(problem, target_of)
        side = None if elbows is None else _sides(problem, target_of, elbows)
    if problem.watched is not None:  # sky that stuck fibers look at
        target_of = np.where(problem.watched >= 0, problem.watched, target_of)
    return Choice(target_of, side, meta={"software": plugin.software} if plugin.package else {})


def _view(problem: Problem) -> AllocationProblem:
    """Return what outsiders see of a problem."""
    n = len(problem.points)

    def column(values, default):
        values = np.full(n, default) if values is None else values.view()
        values.flags.writeable = False
        return values

    def start():
        if problem.start is None:
            raise InputError("there is no plan to begin with")
        choice = problem.start()
        target_of = np.where(problem.plane._usable, choice.target_of, -1)
        side = _usual_sides(problem, target_of) if choice.side is None else choice.side
        return target_of, np.where(side < 0, "left", "right")

    return AllocationProblem(
        problem.plane, column(problem.points, 0.0), problem.reach.matrix, column(problem.rank, 0),
        column(np.append(problem.classes, np.nan)[problem.rank], 0.0), column(problem.kind, "science"),
        column(problem.category, ""), column(problem.fibers, ""), column(problem.required, False),
        problem.requirements, problem.objective, problem.time_limit, problem.parked_obstacles, problem.rng, start,
    )  # fmt: skip


def _checked(problem: Problem, given: object) -> np.ndarray:
    """Return the target of each positioner, if it can be that."""
    n, n_targets = len(problem.plane), len(problem.points)
    target_of = _plain(given)
    if target_of.shape != (n,) or target_of.dtype.kind not in "iu":
        raise InputError(
            f"an allocator must return whole numbers of the shape ({n},), the target of each positioner or -1, or a "
            f"tuple of these and the elbows; got {type(given).__name__} of the shape {target_of.shape}"
        )
    strange = target_of[(target_of < -1) | (target_of >= n_targets)]
    if len(strange):
        raise InputError(f"targets must be rows from 0 to {n_targets - 1}, or -1 for none, got {strange[0]}")
    target_of = target_of.astype(np.int64)
    own = np.flatnonzero(target_of >= 0)
    used, counts = np.unique(target_of[own], return_counts=True)
    if (counts > 1).any():
        twice = used[counts > 1][0]
        who = np.flatnonzero(target_of == twice)
        raise InputError(f"target {twice} must have one positioner at most, got {who[0]} and {who[1]} (by row)")
    reach = problem.reach
    able = np.isin(target_of[own] * n + own, reach.target * n + reach.owner)
    if not able.all():
        first = own[~able][0]
        idle = not problem.plane._usable[first]
        why = "it is disabled or stuck" if idle else "it is out of reach, forbidden, or needs another fiber"
        raise InputError(f"positioner {first} (by row) cannot observe target {target_of[first]}: {why}")
    return target_of


def _sides(problem: Problem, target_of: np.ndarray, elbows: object) -> np.ndarray:
    """Return the elbows as +1 (right) and -1 (left), if the positioners allow them at their targets."""
    plane, own = problem.plane, np.flatnonzero(target_of >= 0)
    names = _plain(elbows)
    if names.shape != target_of.shape or not np.isin(names[own], ELBOWS).all():
        raise InputError(
            f"elbows must be 'right' or 'left' for each positioner with a target, shape ({len(plane)},), got {elbows!r}"
        )
    side, both = _usual_sides(problem, target_of), plane.positioner.handedness == "both"
    side[own] = np.where(names[own] == "left", -1.0, 1.0)
    allowed = np.full(len(own), both) | (names[own] == plane.positioner.handedness)
    for one in (1.0, -1.0):
        rows = np.flatnonzero(allowed & (side[own] == one))
        allowed[rows] = joints_allow(plane, own[rows], problem.points[target_of[own[rows]]], one)
    if not allowed.all():
        first = own[~allowed][0]
        raise InputError(f"positioner {first} (by row) cannot have the elbow {str(names[first])!r} at its target")
    return side


def _plain(given: object) -> np.ndarray:
    """Return an array from what may be none, which then has no column."""
    try:
        return to_plain(given)
    except (TypeError, ValueError):
        return np.empty((0, 0))


def _usual_sides(problem: Problem, target_of: np.ndarray) -> np.ndarray:
    """Return the elbows that positioners have where nothing says which."""
    tips = np.vstack([problem.points, [np.nan, np.nan]])[target_of]
    return problem.plane._sides(tips)
