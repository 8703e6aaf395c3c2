"""The one door of target allocation."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from time import perf_counter

import astropy.units as u
import numpy as np

from rfpsurvey._plugins import name_of
from rfpsurvey._units import to_flags, to_generator, to_plain, to_points_mm, to_scalar
from rfpsurvey.allocation._allocation import Allocation
from rfpsurvey.allocation._methods import METHODS
from rfpsurvey.allocation._plugin import find_method
from rfpsurvey.allocation._problem import Choice, Level, Problem
from rfpsurvey.allocation._requirements import KINDS, Requirement, as_requirements
from rfpsurvey.allocation._sky import with_sky
from rfpsurvey.collision import check_plane
from rfpsurvey.errors import InputError, RfpsurveyWarning, check_choice
from rfpsurvey.focal_plane import FocalPlane, Reach

__all__ = ["OBJECTIVES", "allocate"]

OBJECTIVES = ("priority", "count")


def allocate(
    xy: u.Quantity,
    focal_plane: FocalPlane,
    *,
    method: str | Callable = "balanced",
    priority: np.ndarray | None = None,
    fiber_type: np.ndarray | None = None,
    kind: np.ndarray | None = None,
    category: np.ndarray | None = None,
    requirements: Requirement | str | list | None = None,
    required: np.ndarray | None = None,
    forbidden: np.ndarray | None = None,
    sky_separation: u.Quantity | None = None,
    avoid: u.Quantity | None = None,
    objective: str = "priority",
    time_limit: u.Quantity = 60 * u.s,
    start: Allocation | str = "lamost",
    parked_obstacles: bool = True,
    rng: int | np.random.Generator | None = 0,
) -> Allocation:
    """Assign targets to positioners: one target a positioner, one positioner a target.

    Science targets are what a plan is for; standards and sky positions serve requirements, and beyond these fill
    positioners that would be idle (``sdss``, ``optimal``, ``repair``). Only ``optimal`` and ``repair`` look at
    collisions, and leave none.

    Parameters
    ----------
    xy : Quantity, shape (n_targets, 2)
        Targets on the focal plane, in catalog order; NaN is out of reach.
    focal_plane : FocalPlane
        The positioners.
    method : {"balanced", "nearest", "lamost", "sdss", "optimal", "repair"} or str or callable, optional
        ``balanced``: science targets in catalog order, each to the positioner in reach with the shortest queue, then
        the nearest, then the lowest row; one target of each queue, drawn uniformly, is observed. No priorities.
        ``nearest``: class after class, the closest pair of positioner and target first.
        ``lamost``: class after class from the top priority, every free positioner nominates its nearest
        unassigned target of the class until nobody nominates; a target nominated by several goes to the
        one with the fewest unassigned targets (of any class) in reach, then the nearest, then the lowest row. Then, for
        one requirement after the other, idle positioners take what is lacking, and after them those with
        the least important targets, which are released.
        ``sdss``: network flow: as many as possible class after class, arms may collide; then the least sum of squared
        distances from the centers. ``optimal``: as many as possible class after class such that no arm with a target
        collides with another arm or an obstacle, with a proof. Idle arms that stay in the way (parked equal-arm
        units with ``parked_obstacles``, disabled and stuck units) count as other arms; two idle arms that collide
        with each other, or an idle arm at an obstacle, are not its concern and stay as they are.
        ``repair``: the plan ``start``, its collisions ended by local moves. Another name is that
        of an allocator of an installed package; a function of an `AllocationProblem` is taken as it is.
    priority : array_like of float, shape (n_targets,), optional
        Larger is more important; targets of one value form a class.
    fiber_type : array_like of str, shape (n_targets,), optional
        Fiber type that each target needs; ``""`` means any.
    kind : array_like of str, shape (n_targets,), optional
        ``science`` (all, by default), ``standard`` or ``sky``.
    category : array_like of str, shape (n_targets,), optional
        Names that requirements refer to, such as ``sky_boss``.
    requirements : list of Requirement or str, optional
        What the plan must hold, such as ``["sky=20/spectrograph", "standard=5/spectrograph"]``. Minima come before
        science, are met as far as possible and reported in ``unmet``. ``balanced`` and ``nearest`` only report.
    required : array_like of bool, shape (n_targets,), optional
        Targets that come before everything else (``sdss``, ``optimal``).
    forbidden : array_like of int, shape (k, 2), optional
        Pairs (positioner, target), by row, that must not be.
    sky_separation : Quantity, optional
        With it, positions at least so far (on the focal plane) from all targets serve as sky, too, also those that
        stuck positioners look at. They are looked for where requirements on ``sky`` ask for some.
    avoid : Quantity, shape (k, 2), optional
        Further points from which such sky keeps as far, such as stars that nobody wants to observe.
    objective : {"priority", "count"}, optional
        Class after class, or the number of science targets before the classes (``sdss``, ``optimal``).
    time_limit : Quantity, optional
        ``sdss`` and ``optimal`` then return the best plan so far, with its gap.
    start : Allocation or str, optional
        For ``repair``, and allocators that ask for it: the plan to begin with, or the method that makes it.
    parked_obstacles : bool, optional
        Do idle equal-arm positioners stand in the way?
    rng : int, Generator or None, optional
        Seed or source of the draw of ``balanced``; None draws anew each time.

    Returns
    -------
    Allocation
        The same input gives the same allocation, unless the time limit cuts a search short.

    Raises
    ------
    InputError
        If a name is unknown, a shape does not fit, a unit is missing, a number is impossible, ``start`` belongs to
        other targets or another focal plane, or an allocator that is not ours fails or returns what cannot be.

    Warns
    -----
    RfpsurveyWarning
        If ``sky_separation`` is given, and no requirement asks for sky.

    References
    ----------
    Chen et al. (2024), arXiv:2409.07288, "General Methods for Evaluating Collision Probability of Different Types of
    Theta-phi Positioners", Section 4.2 (balanced, lamost). Blanton et al. 2003, AJ 125, 2276 (network flow).

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> targets = [[12, 0], [14, 0], [20, 10], [99, 0]] * u.mm
    >>> rs.allocate(targets, plane, method="lamost").target_of_positioner
    array([0, 2])
    >>> best = rs.allocate(targets, plane, method="optimal")
    >>> best.n_assigned, best.gap
    (2, 0.0)
    """
    solve = find_method(method)
    check_choice(objective, OBJECTIVES, "objective")
    check_plane(focal_plane)
    points = to_points_mm(xy, "xy")
    n = len(points)
    begin = perf_counter()
    reach = focal_plane._reach(points, fiber_type)
    middle = perf_counter()
    classes, rank = _classes(priority, n)
    kind = _labels(kind, n, "kind")
    if kind is not None:
        science, *others = (kind == word for word in KINDS)
        strange = kind[~(science | others[0] | others[1])]
        if len(strange):
            check_choice(str(strange[0]), KINDS, "kind of target")
        classes, rank = _squeeze(classes, rank, science)
    requirements = as_requirements(requirements)
    for one in requirements:
        if one.fiber_type and focal_plane.fiber_types == ("",):
            raise InputError(f"the positioners have no fiber types, got the requirement {str(one)!r}")
        if one.fiber_type:
            check_choice(one.fiber_type, focal_plane.fiber_types, f"fiber type of the requirement {str(one)!r}")
    named = focal_plane.fiber_types != ("",) and fiber_type is not None
    problem = Problem(
        focal_plane, points, _allowed(reach, forbidden, n), rank, classes, kind, _labels(category, n, "category"),
        np.asarray(fiber_type, dtype=str) if named else None, _flags(required, n), requirements,
        objective=objective, time_limit=to_scalar(time_limit, u.s, "time_limit", low=0),
        parked_obstacles=bool(parked_obstacles), rng=to_generator(rng),
    )  # fmt: skip
    if sky_separation is not None:
        if not any(one.what == "sky" and one.minimum for one in requirements):
            text = "sky_separation changes nothing: no requirement asks for sky, such as 'sky=20/spectrograph'"
            warnings.warn(text, RfpsurveyWarning, stacklevel=2)
        others = np.empty((0, 2)) if avoid is None else to_points_mm(avoid, "avoid")
        problem = with_sky(problem, to_scalar(sky_separation, u.mm, "sky_separation", low=0), others)
    problem = replace(problem, start=partial(_as_choice, start, problem, n, reach.covered))
    choice = solve(problem)
    found = _finish(problem, choice, n)
    end = perf_counter()
    return Allocation(
        name_of(method), **found, in_reach=reach.covered, parked_obstacles=bool(parked_obstacles),
        seconds={"reach": middle - begin, "allocation": end - middle},
    )  # fmt: skip


def _classes(priority, n):
    """Priorities, the largest first, and the class of each target, 0 the most important."""
    if priority is None:
        return (0.0,), np.zeros(n, dtype=np.int64)
    try:
        values = to_plain(priority).astype(float)
    except ValueError as error:
        raise InputError(f"priority must be numbers: {error}") from None
    if values.shape != (n,):
        raise InputError(f"priority must have one value a target, shape ({n},), got {values.shape}")
    if np.isnan(values).any():
        raise InputError(f"priority must be numbers, but {int(np.isnan(values).sum())} of {n} are NaN")
    classes, rank = np.unique(-values, return_inverse=True)
    return tuple((-classes).tolist()), rank.reshape(-1).astype(np.int64)


def _squeeze(classes, rank, science):
    """Keep the classes of science targets; all others come after them."""
    used, new = np.unique(rank[science], return_inverse=True)
    squeezed = np.full(len(rank), len(used), dtype=np.int64)
    squeezed[science] = new.reshape(-1)
    return tuple(classes[k] for k in used), squeezed


def _labels(values, n, name):
    if values is None:
        return None
    labels = to_plain(values).astype(str)
    if labels.shape != (n,):
        raise InputError(f"{name} must have one value a target, shape ({n},), got {labels.shape}")
    return labels


def _flags(required, n):
    if required is None:
        return None
    try:
        flags = to_flags(required, "required")
    except TypeError:
        raise InputError(f"required must hold truth values, got {required!r}") from None
    if flags.shape != (n,):
        raise InputError(f"required must have one value a target, shape ({n},), got {flags.shape}")
    return flags if flags.any() else None


def _allowed(reach: Reach, forbidden, n) -> Reach:
    """Take forbidden pairs out."""
    if forbidden is None:
        return reach
    try:
        pairs = np.asarray(forbidden)
    except ValueError:
        raise InputError(f"forbidden must be rows (positioner, target) of whole numbers, got {forbidden!r}") from None
    if pairs.size == 0:
        return reach
    if pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.dtype.kind not in "iu":
        raise InputError(f"forbidden must be rows (positioner, target) of whole numbers, got the shape {pairs.shape}")
    if pairs.min() < 0 or pairs[:, 0].max() >= reach.n_positioners or pairs[:, 1].max() >= n:
        raise InputError(
            f"forbidden must name positioners 0 to {reach.n_positioners - 1} and targets 0 to {n - 1} by their rows"
        )
    own, target = pairs.T.astype(np.int64)
    return reach.where(~np.isin(reach.target * reach.n_positioners + reach.owner, target * reach.n_positioners + own))


def _as_choice(start, problem: Problem, n_given: int, in_reach: np.ndarray) -> Choice:
    """Return the plan that `repair` begins with."""
    if isinstance(start, str):
        return find_method(start, set(METHODS) - {"repair"}, "allocator to start with")(problem)
    if not isinstance(start, Allocation):
        raise InputError(f"start must be an Allocation or the name of a method, got {start!r}")
    plane, points = problem.plane, problem.points[:n_given]
    same = (len(start.target_of_positioner), start.n_given) == (len(plane), n_given)
    same = same and np.array_equal(start.in_reach, in_reach)
    same = same and np.array_equal(start.xy.to_value(u.mm)[:n_given], points, equal_nan=True)
    if same:
        own = np.flatnonzero((start.target_of_positioner >= 0) & plane._usable)
        r = np.hypot(*(start.tips.to_value(u.mm)[own] - plane._xy_mm[own]).T)
        slack = plane._columns.reach_slack
        same = not ((r > plane._outer_mm[own] + slack) | (r < plane._inner_mm[own] - slack)).any()
    if not same:
        raise InputError("start must be an allocation of the same targets to the same focal plane")
    target_of = np.where(start.target_of_positioner < start.n_given, start.target_of_positioner, -1)
    return Choice(target_of, np.where(start.handedness == "left", -1.0, 1.0))


def _finish(problem: Problem, choice: Choice, n: int) -> dict:
    """Columns of the allocation; sky positions that nobody uses are left out."""
    plane, target_of = problem.plane, choice.target_of
    used = np.flatnonzero(target_of >= 0)
    rows = np.concatenate([np.arange(n), np.unique(target_of[used][target_of[used] >= n])])
    new = np.full(len(problem.points) + 1, -1)  # the last one for no target
    new[rows] = np.arange(len(rows))
    points = problem.points[rows]
    values = problem.values(target_of)
    levels = [Level(name, value, float("nan")) for name, value in values.items()]
    unmet = tuple(problem.shortfalls(target_of))
    tips = np.full((len(plane), 2), np.nan)
    tips[used] = problem.points[target_of[used]]
    side = plane._sides(tips) if choice.side is None else choice.side
    fiber = np.asarray(plane.fiber_types)[problem.fiber_of(used, target_of[used])] if len(used) else []
    types = np.full(len(plane), "", dtype=f"U{max(max(len(t) for t in plane.fiber_types), 1)}")
    types[used] = fiber
    target_of = new[target_of]
    positioner_of = np.full(len(rows), -1)
    positioner_of[target_of[used]] = used
    return {
        "target_of_positioner": target_of,
        "positioner_of_target": positioner_of,
        "handedness": np.where(side < 0, "left", "right"),
        "tips": tips * u.mm,
        "fiber_type": types,
        "xy": points << u.mm,
        "n_given": n,
        "wanted": None if problem.wanted is None else problem.wanted[rows],
        "queues": choice.queues,
        "levels": tuple(levels if choice.levels is None else choice.levels),
        "unmet": unmet,
        "meta": {} if choice.meta is None else choice.meta,
    }
