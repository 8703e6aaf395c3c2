"""Functions that assign targets to positioners: `allocate`, and `assign` for arrays without units."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from time import perf_counter
from typing import TYPE_CHECKING, NamedTuple

import astropy.units as u
import numpy as np

from rfpsurvey._assignment.allocation import Allocation
from rfpsurvey._assignment.answer import AllocationAnswer, Level
from rfpsurvey._assignment.before_and_after import from_allocation, from_tile, is_plan, with_changes, with_sky
from rfpsurvey._assignment.clock import now
from rfpsurvey._assignment.constraints.constraint import EXACTLY
from rfpsurvey._assignment.constraints.motion import PATHS
from rfpsurvey._assignment.constraints.requirement import check_counts
from rfpsurvey._assignment.distribution import Motion
from rfpsurvey._assignment.methods import DEFAULT_ALLOCATOR
from rfpsurvey._assignment.options import AllocationOptions, as_options
from rfpsurvey._assignment.plugin import find_allocator, warn_of_unused_options
from rfpsurvey._assignment.problem import AllocationProblem
from rfpsurvey._assignment.rules import check_one_each, check_values, service_order, tie_order, to_subpriorities
from rfpsurvey._common.units import to_dimensionless, to_generator, to_numbers, to_plain, to_points_mm
from rfpsurvey._instruments.arms import check_plane
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.joint_motion import JointMotion
from rfpsurvey._instruments.motion import LAWS
from rfpsurvey._instruments.reach import Reach, elbow_names
from rfpsurvey._sky.arrays import has_role, to_kinds
from rfpsurvey.errors import InputError, InputTypeError, check_keywords, short, warn_no_effect

if TYPE_CHECKING:
    from rfpsurvey._instruments.path_report import PathReport

NO_POINTS = np.empty((0, 2))


class TargetColumns(NamedTuple):
    """Columns of the targets, shape (n_targets,); a column that is not given is None."""

    priority: np.ndarray | None = None
    kind: np.ndarray | None = None
    category: np.ndarray | None = None
    fiber_type: np.ndarray | None = None
    is_required: np.ndarray | None = None
    subpriority: np.ndarray | None = None


@check_keywords
def allocate(
    focal_plane: FocalPlane,
    xy: u.Quantity,
    *,
    allocator: AllocationOptions | str | Callable = DEFAULT_ALLOCATOR,
    priority: np.ndarray | None = None,
    fiber_type: np.ndarray | None = None,
    kind: np.ndarray | None = None,
    category: np.ndarray | None = None,
    required: np.ndarray | None = None,
    forbidden: np.ndarray | None = None,
    avoid: u.Quantity | None = None,
    subpriority: np.ndarray | None = None,
    rng: int | np.random.Generator | None = 0,
) -> Allocation:
    """Assign targets to positioners: at most one target per positioner, and at most one positioner per target.

    The purpose of an allocation is to observe science targets. Standards and sky positions are assigned to meet
    requirements; ``network_flow``, ``optimal`` and ``repair`` also assign standards and sky positions to positioners
    that would otherwise be idle. Only ``optimal`` and ``repair`` avoid collisions.

    Parameters
    ----------
    focal_plane : FocalPlane
        The positioners.
    xy : Quantity, shape (n_targets, 2)
        Positions of the targets on the focal plane, in catalog order. A target whose position is NaN is out of reach.
    allocator : AllocationOptions or str or callable, optional
        The allocator with its options, or only the allocator; see `AllocationOptions`.
    priority : array_like of float, shape (n_targets,), optional
        Priority of each target; larger values are more important. Targets with the same priority form a class.
    fiber_type : array_like of str, shape (n_targets,), optional
        Fiber type that each target requires; ``""`` means any type.
    kind : array_like of str, shape (n_targets,), optional
        Kind of each target: ``science`` (the default), ``standard`` or ``sky``.
    category : array_like of str, shape (n_targets,), optional
        Category of each target, such as ``sky_boss``; requirements can refer to categories.
    required : array_like of int, shape (k,), optional
        Rows of the targets that take precedence over all other targets. `AllocationOptions` has a parameter of the same
        name, which contains identifiers in place of rows.
    forbidden : array_like of int, shape (k, 2), optional
        Pairs of rows (positioner, target) that must not be assigned to each other.
    avoid : Quantity, shape (k, 2), optional
        Positions of other objects, such as stars that are not targets. Sky positions must be at least
        ``sky_separation`` away from these positions.
    subpriority : array_like of float, shape (n_targets,), optional
        Subpriority of each target: in a class, targets with larger values are served first. `AllocationOptions` has a
        parameter of the same name for random subpriorities. In this function, random subpriorities depend on the rows
        of the targets, because the function receives no identifiers.
    rng : int, Generator or None, optional
        Seed or generator for ``balanced``, which draws targets at random. With None, each call gives a different
        result.

    Returns
    -------
    Allocation
        The allocation. The same input gives the same allocation, unless the time limit ends a search.

    Raises
    ------
    InputError
        If an allocator, a kind of target or a fiber type is unknown, if an array has a wrong shape, if a unit is
        missing, if a number is out of range, if ``start`` was made for other targets or for another focal plane, or if
        an allocator that is not built in fails or returns an invalid allocation.

    Warns
    -----
    RfpsurveyWarning
        If an option that the allocator does not use is given, or if ``sky_separation`` is given but no requirement
        counts sky positions.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> targets = [[12, 0], [14, 0], [20, 10], [99, 0]] * u.mm
    >>> rs.allocate(plane, targets, allocator="lamost_rule").target_of_positioner
    array([0, 2])
    >>> best = rs.allocate(plane, targets, allocator="optimal")
    >>> best.n_assigned, best.gap
    (2, 0.0)
    """
    asked = as_options(allocator)
    options = asked.for_instrument(None)
    check_plane(focal_plane)
    points = to_points_mm(xy, "xy")
    n = len(points)
    named = focal_plane.fiber_types != ("",) and fiber_type is not None
    columns = TargetColumns(
        None if priority is None else check_one_each(to_numbers(priority, "priority"), n, "priority"),
        _labels(None if kind is None else to_kinds(kind, "kind"), n, "kind"),
        _labels(category, n, "category"),
        to_plain(fiber_type, "fiber_type").astype(str) if named else None,
        _marked(required, n),
    )
    order = None
    if subpriority is not None and options.subpriority is not None:
        raise InputError("subpriority must be given either as an array or in the options, got both")
    if subpriority is not None or options.subpriority is not None:
        rows = np.arange(n)
        if subpriority is None:
            values = to_subpriorities(options.subpriority, rows, None)
        else:
            values = check_values(subpriority, n, "subpriority")
        columns, order = columns._replace(subpriority=values), service_order(values, rows)
    elif options.breaks_ties:
        order = tie_order(points)
    avoided = NO_POINTS if avoid is None else to_points_mm(avoid, "avoid")
    arrays = {"required": required, "subpriority": subpriority}
    warn_of_unused_options([asked], focal_plane, rng, [name for name, values in arrays.items() if values is not None])
    if avoid is not None and options.sky_separation is None:
        warn_no_effect("avoid", "without sky_separation, the distance between sky positions and other objects")
    rng = to_generator(rng)
    points = points.copy()  # the allocation must not change if the caller changes the positions
    return assign(focal_plane, points, columns, options, rng, forbidden=forbidden, avoid=avoided, order=order)


def assign(
    focal_plane: FocalPlane,
    xy_mm: np.ndarray,
    columns: TargetColumns,
    options: AllocationOptions,
    rng: np.random.Generator,
    *,
    forbidden: np.ndarray | None = None,
    avoid: np.ndarray = NO_POINTS,
    tell: Callable[[float, str], None] | None = None,
    order: np.ndarray | None = None,
    excluded: np.ndarray | None = None,
    excludes_sky: Callable[[np.ndarray, np.ndarray | None], np.ndarray] | None = None,
    ids: np.ndarray | None = None,
    motion: JointMotion | None = None,
) -> Allocation:
    """Assign targets at positions in mm to positioners; the columns of the targets are not checked.

    During long searches, ``tell`` is called with the completed fraction and the stage. ``order``, which is required if
    there are subpriorities, contains the rows of the targets in the order of their precedence. ``excluded`` is whether
    each target must not be observed; ``excludes_sky`` returns this for added sky positions and their fiber types. A
    given tile is compared by the identifiers ``ids`` of the targets, or by positions if there are none. Planned paths
    use the joint ranges and speeds of ``motion``.
    """
    begin, deadline = perf_counter(), now() + options.seconds
    n = len(xy_mm)
    if order is not None:
        # Allocators break ties by the row of a target. If the targets are sorted in this way, plans do not depend on
        # the order of the catalog.
        xy_mm = xy_mm[order]
        columns = TargetColumns(*(None if values is None else values[order] for values in columns))
    reach = focal_plane.arrays.reach(xy_mm, columns.fiber_type)
    middle = perf_counter()
    classes, rank = _classes(columns.priority, n)
    if columns.kind is not None:
        classes, rank = _squeeze(classes, rank, has_role(columns.kind, "science"))
    check_counts(options.counts, focal_plane)
    _, kind, category, fiber_type, is_required, subpriority = columns
    about = rank, classes, kind, category, fiber_type, is_required, options, rng
    more = {"tell": tell, "subpriority": subpriority, "deadline": deadline}
    allowed = _allowed(reach, forbidden, n, order, excluded)
    problem = AllocationProblem(focal_plane, xy_mm, allowed, *about, **more)
    if options.sky_separation is not None:
        problem = with_sky(problem, float(options.sky_separation.to_value(u.mm)), avoid, excludes_sky)
    if options.motion_law in LAWS:
        problem = replace(problem, motion=Motion(problem))
    ids = ids if ids is None or order is None else ids[order]
    given = cache(partial(from_tile, getattr(options.start, "table", None), problem, ids))
    problem = replace(problem, start=partial(_make_start, problem, n, reach.covered, order, given))
    answer = find_allocator(options.allocator).function(problem)

    def finish(answer: AllocationAnswer, paths: "PathReport | None" = None) -> Allocation:
        return Allocation(
            options.name,
            **_finish(problem, answer, reach.covered, order),
            parked_obstacles=options.parked_obstacles,
            seconds={"reach": middle - begin, "allocation": perf_counter() - middle},
            excluded=excluded,
            paths=paths,
        )

    paths = None
    if options.motion_law == PATHS and options.method.abilities.motion == EXACTLY:
        from rfpsurvey._assignment.path_rounds import with_paths  # most scripts plan no paths

        answer, paths = with_paths(problem, answer, lambda answer: finish(answer).place_arms(focal_plane), motion)
    if is_plan(options.start) and options.method.improves:
        answer = with_changes(problem, answer, problem.start(with_lost=True).target_of_positioner)
    return finish(answer, paths)


def _classes(priority, n):
    """Return the distinct priorities, largest first, and the class of each target; class 0 is the most important."""
    if priority is None:
        return (0.0,), np.zeros(n, dtype=np.int64)
    classes, rank = np.unique(-priority, return_inverse=True)
    return tuple((-classes).tolist()), rank.reshape(-1).astype(np.int64)


def _squeeze(classes, rank, science):
    """Renumber the classes of science targets without gaps; all other targets form one class, which is the last."""
    used, new = np.unique(rank[science], return_inverse=True)
    squeezed = np.full(len(rank), len(used), dtype=np.int64)
    squeezed[science] = new.reshape(-1)
    return tuple(classes[k] for k in used), squeezed


def _labels(values, n, name):
    return None if values is None else check_one_each(to_plain(values, name).astype(str), n, name)


def _marked(required, n):
    """Convert the rows of the required targets to a boolean array over all targets."""
    rows = np.atleast_1d(to_dimensionless([] if required is None else required, "required"))
    if rows.size == 0:
        return None
    if rows.dtype.kind not in "iu" or rows.ndim != 1:
        raise InputTypeError(
            f"required must be row numbers of targets (whole numbers), got {rows.dtype.name} of the shape {rows.shape}"
            "; np.flatnonzero converts booleans to row numbers"
        )
    if rows.min() < 0 or rows.max() >= n:
        raise InputError(f"required must be row numbers of targets, 0 to {n - 1}, got {rows.min()} to {rows.max()}")
    marked = np.zeros(n, dtype=bool)
    marked[rows] = True
    return marked


def _allowed(reach: Reach, forbidden, n, order=None, excluded: np.ndarray | None = None) -> Reach:
    """Remove forbidden pairs and excluded targets; ``order`` is the catalog row of each target in ``reach``."""
    if excluded is not None and excluded.any():
        allowed = ~(excluded if order is None else excluded[order])
        reach = reach.where(allowed[reach.target])
    if forbidden is None:
        return reach
    text = "forbidden must be pairs (positioner, target) of row numbers, got"
    try:
        pairs = np.asarray(forbidden)
    except ValueError:
        raise InputError(f"{text} {short(forbidden)}") from None
    if pairs.size == 0:
        return reach
    if pairs.dtype.kind == "O":
        raise InputTypeError(f"{text} {short(forbidden)}")
    if pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.dtype.kind not in "iu":
        raise InputError(f"{text} the shape {pairs.shape}")
    if pairs.min() < 0 or pairs[:, 0].max() >= reach.n_positioners or pairs[:, 1].max() >= n:
        raise InputError(
            f"forbidden must contain rows of positioners from 0 to {reach.n_positioners - 1} and rows of "
            f"targets from 0 to {n - 1}"
        )
    owner, target = pairs.T.astype(np.int64)
    if order is not None:
        target = _scatter(np.arange(n), order)[target]
    return reach.where(~np.isin(reach.target * reach.n_positioners + reach.owner, target * reach.n_positioners + owner))


def _make_start(problem, n_given: int, in_reach, order, given, *, with_lost: bool = False) -> AllocationAnswer:
    """Return the plan from which `repair` starts; ``order`` is the catalog row of each target of the problem.

    ``given`` returns the plan of a given tile. If ``with_lost`` is true, targets of a given tile that cannot be kept
    are ``LOST`` instead of -1.
    """
    start = problem.options.start
    if isinstance(start, str):
        return find_allocator(start).function(problem)
    if hasattr(start, "table"):
        allocation = given()
        kept = allocation.target_of_positioner if with_lost else np.maximum(allocation.target_of_positioner, -1)
        return allocation._replace(target_of_positioner=kept)
    return from_allocation(start, problem, n_given, in_reach, order)


def _finish(problem: AllocationProblem, answer: AllocationAnswer, in_reach: np.ndarray, order) -> dict:
    """Return the attributes of an `Allocation`; added sky positions that no positioner observes are omitted.

    ``order`` is the catalog row of each given target of the problem; None if the rows are the same.
    """
    plane, target_of, n = problem.focal_plane, answer.target_of_positioner, len(in_reach)
    used = np.flatnonzero(target_of >= 0)
    added = np.unique(target_of[used][target_of[used] >= n])
    rows = np.append(np.arange(n), added)
    row_of = np.full(len(problem.xy) + 1, -1)  # the last element is for positioners without a target
    row_of[rows] = np.append(np.arange(n) if order is None else order, n + np.arange(len(added)))
    levels = answer.levels
    if levels is None:
        levels = [Level(name, value, float("nan")) for name, value in problem.values(target_of).items()]
    tips = np.full((len(plane), 2), np.nan)
    tips[used] = problem.xy.take(target_of[used], axis=0)
    fiber = problem.fiber_of(np.arange(len(plane)), target_of)
    types = np.full(len(plane), "", dtype=f"U{max(max(len(t) for t in plane.fiber_types), 1)}")
    types[used] = np.asarray(plane.fiber_types)[fiber[used]]
    positioner_of = np.full(len(rows), -1)
    positioner_of[row_of[target_of[used]]] = used
    elbows = answer.handedness
    return {
        "target_of_positioner": row_of[target_of],
        "positioner_of_target": positioner_of,
        "handedness": elbow_names(plane.arrays.sides(tips, fiber=fiber)) if elbows is None else elbows,
        "tips_mm": tips,
        "fiber_type": types,
        "in_reach": _scatter(in_reach, row_of[:n]),
        "xy_mm": _scatter(problem.xy[rows], row_of[rows]),
        "n_given": n,
        "added": added - n,
        "target_fiber_type": _scatter(problem.fiber_type[rows], row_of[rows]) if problem.several_fiber_types else None,
        "queues": answer.queues and (answer.queues[0], row_of[answer.queues[1]]),
        "levels": tuple(levels),
        "unmet": tuple(problem.shortfalls(target_of)),
        "counts": tuple(problem.verdicts(target_of)),
        "meta": {} if answer.meta is None else answer.meta,
    }


def _scatter(values: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Return values of targets in the order of the catalog; the input is in the order of the problem."""
    out = np.empty_like(values)
    out[order] = values
    return out
