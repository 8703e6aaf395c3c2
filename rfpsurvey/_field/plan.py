"""Plan a field: project unit vectors of targets, assign the targets to fibers, and find the colliding arms."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from time import perf_counter
from typing import TYPE_CHECKING, NamedTuple

import astropy.units as u
import numpy as np

from rfpsurvey._assignment.allocate import TargetColumns, assign
from rfpsurvey._assignment.allocation import Allocation
from rfpsurvey._assignment.constraints.field import Verdict
from rfpsurvey._assignment.constraints.motion import PATHS
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._assignment.rules import FEWEST_FIRST, service_order, tie_order, to_subpriorities
from rfpsurvey._common.units import to_lonlat, values_at
from rfpsurvey._field.constraints import Applied, apply_constraints, project_field
from rfpsurvey._instruments.arms import Arms
from rfpsurvey._instruments.find_collisions import collisions_of
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._instruments.joint_motion import JointMotion
from rfpsurvey._instruments.motion import CollisionReport, find_motion
from rfpsurvey._instruments.reach import Reach
from rfpsurvey._sky.observed_field import ObservedField
from rfpsurvey._sky.projection import FieldProjection
from rfpsurvey.errors import InputError

if TYPE_CHECKING:
    from rfpsurvey._instruments.path_report import PathReport

PREFIX = "blank-sky-"
# DIGITS is the largest number of digits after the prefix of identifiers that are text. ROOM is the number of integers
# that are reserved for blank sky positions if identifiers are integers.
DIGITS, ROOM = 6, 1_000_000
# Number of points on a ring near the edge of a field, and the radius of the ring as a fraction of the field radius.
N_RING, RING = 72, 0.98


class BlankIds(NamedTuple):
    """Identifiers for blank sky positions; no target of the catalog has one of these identifiers."""

    first: int | str
    """The first identifier, if the identifiers are integers; each further identifier is smaller by 1.

    If the identifiers are text, this is the text before the number in each identifier.
    """
    dtype: np.dtype
    """Type of a column that contains the identifiers of targets and of blank positions."""

    def take(self, n: int) -> np.ndarray:
        """Return the first n identifiers."""
        if isinstance(self.first, str):
            return np.array([f"{self.first}{k}" for k in range(n)], dtype=self.dtype)
        return self.first - np.arange(n)


def blank_ids(parts: Iterable[np.ndarray]) -> BlankIds:
    """Return identifiers for blank sky that differ from all identifiers of a catalog.

    The catalog may consist of several parts; ``parts`` contains an array with the identifiers of each part.

    If the identifiers of the catalog are integers, the identifiers of blank sky are less than -1 and less than all
    identifiers of the catalog. If there are too few such integers, the identifiers of blank sky are greater than all
    identifiers of the catalog.

    If the identifiers of the catalog are text, the identifiers of blank sky begin with ``blank-sky-``. If identifiers
    of the catalog begin in this way, with or without underscores before ``blank-sky-``, the identifiers of blank sky
    begin with one underscore more than any of these identifiers.
    """
    lowest, highest, most, dtype = -1, -1, -1, None
    for ids in parts:
        dtype = ids.dtype if dtype is None else np.result_type(dtype, ids.dtype)
        if ids.dtype.kind == "i":
            lowest, highest = min(lowest, int(ids.min(initial=0))), max(highest, int(ids.max(initial=0)))
        else:
            plain = np.char.lstrip(ids, "_")
            alike = np.flatnonzero(np.char.startswith(plain, PREFIX))
            most = max(most, int((np.char.str_len(ids) - np.char.str_len(plain))[alike].max(initial=-1)))
    if dtype.kind == "i":
        if lowest - ROOM >= np.iinfo(np.int64).min:
            return BlankIds(lowest - 1, dtype)
        if highest + ROOM > np.iinfo(np.int64).max:
            raise InputError(
                f"ids must leave unused integers for blank sky positions, got ids from {lowest} to {highest}"
            )
        return BlankIds(highest + ROOM, dtype)
    prefix = "_" * (most + 1) + PREFIX
    return BlankIds(prefix, np.result_type(dtype, np.dtype(f"U{len(prefix) + DIGITS}")))


class FieldTargets(NamedTuple):
    """The targets of a field, one per row."""

    vectors: np.ndarray
    """Directions of the targets as ICRS unit vectors, shape (n, 3)."""
    id: np.ndarray
    """Identifiers of the targets (integers or text), shape (n,)."""
    columns: TargetColumns
    others: np.ndarray | None = None
    """Unit vectors of other targets, which are not assigned; blank sky positions must avoid these targets."""
    extra: dict | None = None
    """Additional columns of the plan; each key is the name of a column, and each value contains a value per target."""
    numbered: bool = False
    """Whether the identifiers are row numbers, because the catalog has no identifiers."""
    around: "FieldTargets | None" = None
    """Other targets in and around the field, which cannot be observed; None if no constraint uses the targets."""


@dataclass(frozen=True, eq=False)
class FieldReach:
    """A field to which the constraints have been applied, its targets on the focal plane, and the pairs in reach."""

    applied: Applied
    xy: np.ndarray
    """Positions of the targets in mm, shape (n, 2)."""
    fiber_type: np.ndarray | None
    """Fiber type that each target requires; None if all fibers can observe all targets."""
    seconds: float
    """Computing time of the projection."""

    @cached_property
    def pairs(self) -> Reach:
        """The pairs of a positioner and a target in its reach."""
        return self.applied.instrument.focal_plane.arrays.reach(self.xy, self.fiber_type)

    @property
    def allowed(self) -> Reach:
        """The pairs of the targets that may be observed."""
        excluded = self.applied.excluded
        return self.pairs if excluded is None else self.pairs.where(~excluded[self.pairs.target])


class FieldPlan(NamedTuple):
    """The plan of a field; each array has one value per positioner with a target, in the order of the focal plane."""

    instrument: Instrument
    """The instrument, whose obstacles include those of the constraints."""
    allocation: Allocation
    arms: Arms
    report: CollisionReport
    positioner: np.ndarray
    """Row in the focal plane of each positioner that has a target."""
    target: np.ndarray
    """Row of each positioner's target in the `FieldTargets`, or -1 if the target is blank sky."""
    id: np.ndarray
    lon_rad: np.ndarray
    lat_rad: np.ndarray
    """Declination (ICRS) of each target in radians; ``lon_rad`` is its right ascension, from 0 to 2 pi."""
    kind: np.ndarray
    """Kind of each target: ``science``, ``standard`` or ``sky``, or several roles, such as ``science+standard``."""
    carried: dict
    """Priority, category and additional columns of the targets, if the catalog has them. For blank sky, the value is
    NaN, empty text, False or -1, depending on the type of the column."""
    seconds: dict
    """Computing time of each stage of the pipeline, in seconds."""
    violations: dict[str, list[str]]
    """For the text of each constraint, sentences that state how the plan violates the constraint, except counts."""
    verdicts: Callable[[], list[Verdict]]
    """Function that returns the verdict of each constraint, except counts."""
    targets: FieldTargets
    """The targets that can be assigned, with their kinds and subpriorities in this plan."""


def field_radius_rad(instrument: Instrument, projection: FieldProjection | ObservedField | None = None) -> float:
    """Return the radius (radians) of a circle that contains all targets of a field, with an allowance for rounding.

    Refraction and dispersion shift the edge of the field. These shifts are neglected unless ``projection`` is an
    `ObservedField`.
    """
    radius = instrument.field_radius.to_value(u.rad) * (1 + 1e-9)
    if not isinstance(projection, ObservedField):
        return radius
    # The ring is slightly inside the edge, so that all its points have an image under all observing conditions.
    turn = np.linspace(0, 2 * np.pi, N_RING, endpoint=False)[:, None]
    x, y, center = projection.basis
    ring = np.cos(RING * radius) * center + np.sin(RING * radius) * (np.cos(turn) * x + np.sin(turn) * y)
    static = FieldProjection(projection.basis, projection.focal_length, projection.distortion)
    types = (
        list(projection.distortion) if isinstance(projection.distortion, dict) else instrument.focal_plane.fiber_types
    )
    shift = 0.0
    for kind in types:
        seen = projection.unproject(static.project(ring, kind), kind)
        apart = np.linalg.norm(np.cross(seen, center), axis=1).max()
        shift = max(shift, np.arcsin(apart) - RING * radius)
    return float(radius + shift / RING**3)  # the shift increases at most with the cube of the distance from the center


def find_reach(
    instrument: Instrument, projection: FieldProjection, targets: FieldTargets, options: AllocationOptions
) -> FieldReach:
    """Apply constraints to a field, and project its targets; the parameters are as in `plan_field`."""
    applied, begin = apply_constraints(instrument, projection, options, targets), perf_counter()
    xy, fiber_type = project_field(applied.instrument, projection, targets.vectors, targets.columns.fiber_type)
    return FieldReach(applied, xy, fiber_type, perf_counter() - begin)


def with_subpriorities(targets: FieldTargets, options: AllocationOptions) -> FieldTargets:
    """Return the targets with the subpriorities of the options, which replace those of the catalog."""
    given, is_known = options.subpriority, targets.columns.subpriority is not None
    if given is None or (given == FEWEST_FIRST and is_known):  # a survey knows the remaining visits
        return targets
    values = to_subpriorities(given, targets.id, targets.extra)
    return targets._replace(columns=targets.columns._replace(subpriority=values))


def _assign(reach: FieldReach, projection, targets, options, rng, tell) -> Allocation:
    """Assign the targets of a field to which the constraints have been applied."""
    applied, others = reach.applied, {}
    if targets.others is not None:
        others["avoid"] = projection.project(targets.others)
    columns = targets.columns._replace(fiber_type=reach.fiber_type)
    if columns.subpriority is not None:
        others["order"] = service_order(columns.subpriority, targets.id)
    elif options.breaks_ties:
        others["order"] = tie_order(reach.xy, None if targets.numbered else targets.id)
    others |= {"excluded": applied.excluded, "excludes_sky": applied.excludes_sky}
    others |= {"ids": None if targets.numbered else targets.id, "motion": applied.instrument.motion}
    return assign(applied.instrument.focal_plane, reach.xy, columns, options, rng, tell=tell, **others)


def find_all_collisions(
    plane: FocalPlane,
    arms: Arms,
    options: AllocationOptions,
    joints: JointMotion | None,
    paths: "PathReport | None" = None,
) -> CollisionReport:
    """Find the collisions of a plan and, if a constraint refers to the motion of the arms, those of the motion.

    Planned paths use the ranges and speeds of ``joints``; ``paths`` are those that are already known.
    """
    report, law = collisions_of(plane, arms.segments.T, arms.assigned, arms.parked), options.motion_law
    if not law:
        return report
    if law == PATHS:
        from rfpsurvey._instruments.path_report import report_paths  # most scripts plan no paths

        return replace(report, motion=paths or report_paths(plane, arms, joints))
    return replace(report, motion=find_motion(plane, arms, law=law, parked_obstacles=options.parked_obstacles))


def plan_field(
    instrument: Instrument,
    projection: FieldProjection,
    targets: FieldTargets,
    options: AllocationOptions,
    rng: np.random.Generator,
    blank: BlankIds | None = None,
    tell: Callable[[float, str], None] | None = None,
) -> FieldPlan:
    """Plan a field: assign targets, place the arms, and find the arms that collide.

    Parameters
    ----------
    instrument : Instrument
        The instrument.
    projection : FieldProjection
        Projection of the sky onto the focal plane.
    targets : FieldTargets
        The targets.
    options : AllocationOptions
        Options, as `AllocationOptions.for_instrument` returns them.
    rng : Generator
        Random number generator.
    blank : BlankIds, optional
        Identifiers of blank sky; required if the options have a ``sky_separation``.
    tell : callable, optional
        Function that is called during long searches with the completed fraction and the name of the stage.

    Returns
    -------
    FieldPlan
        The plan.
    """
    reach = find_reach(instrument, projection, targets, options)
    applied, instrument = reach.applied, reach.applied.instrument
    targets = with_subpriorities(targets._replace(columns=targets.columns._replace(kind=applied.kind)), options)
    allocation = _assign(reach, projection, targets, options, rng, tell)
    begin = perf_counter()
    arms = allocation.place_arms(instrument.focal_plane)
    middle = perf_counter()
    report = find_all_collisions(instrument.focal_plane, arms, options, instrument.motion, allocation.paths)
    seconds = {
        "projection": reach.seconds,
        **allocation.seconds,
        "arms": middle - begin,
        "collisions": perf_counter() - middle,
    }
    positioner = np.flatnonzero(allocation.target_of_positioner >= 0)
    target = allocation.target_of_positioner[positioner]
    given = target < allocation.n_given
    rows = target[given]
    roles = np.full(len(rows), "science") if targets.columns.kind is None else targets.columns.kind[rows]
    kind = np.full(len(target), "sky", dtype=np.promote_types("U8", roles.dtype))
    kind[given] = roles
    ids, vectors = targets.id[rows], targets.vectors.take(rows, axis=0)
    if not given.all():
        blank_rows, known = target[~given], (ids, vectors)
        types = None if allocation.target_fiber_type is None else allocation.target_fiber_type[blank_rows]
        ids, vectors = np.empty(len(target), dtype=blank.dtype), np.empty((len(target), 3))
        ids[given], vectors[given] = known
        ids[~given] = blank.take(len(blank_rows))
        vectors[~given] = projection.unproject(allocation.xy_mm[blank_rows], types)
    lon, lat = to_lonlat(vectors)
    owners = np.append(positioner[given], positioner[~given])
    blanks = vectors[~given], allocation.xy_mm[target[~given]]
    finished = report, arms, owners, allocation.fiber_type[owners], target[given], *blanks
    target = np.where(given, target, -1)
    columns = {"priority": targets.columns.priority, "category": targets.columns.category, **(targets.extra or {})}
    carried = {name: values_at(values, target) for name, values in columns.items() if values is not None}
    lon += np.where(lon < 0, 2 * np.pi, 0.0)
    about = *applied.checks(*finished), targets._replace(others=None, around=None)
    return FieldPlan(
        instrument, allocation, arms, report, positioner, target, ids, lon, lat, kind, carried, seconds, *about
    )
