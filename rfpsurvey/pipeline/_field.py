"""Plan a field: project unit vectors of targets, assign the targets to fibers, and find the colliding arms."""

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import astropy.units as u
import numpy as np

from rfpsurvey._units import to_lonlat, values_at
from rfpsurvey.allocation import (
    Allocation,
    AllocationOptions,
    TargetColumns,
    assign,
    service_order,
    tie_order,
    to_subpriorities,
)
from rfpsurvey.collision import Arms, CollisionReport, collisions_of, find_motion
from rfpsurvey.constraints import Verdict
from rfpsurvey.focal_plane import FocalPlane, Reach
from rfpsurvey.instrument import Instrument
from rfpsurvey.observing import ObservedField
from rfpsurvey.pipeline._blank_sky import BlankIds
from rfpsurvey.pipeline._constraints import Applied, apply_constraints
from rfpsurvey.pipeline._project import project_field
from rfpsurvey.projection import FieldProjection

# Number of points on a ring near the edge of a field, and the radius of the ring as a fraction of the field radius.
N_RING, RING = 72, 0.98


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


class FieldReach(NamedTuple):
    """The pairs of positioners and targets in reach, with the positions of the targets on the focal plane."""

    instrument: Instrument
    """The instrument, whose obstacles include those of the constraints."""
    xy: np.ndarray
    """Positions of the targets in mm, shape (n, 2)."""
    fiber_type: np.ndarray | None
    """Fiber type that each target requires; None if all fibers can observe all targets."""
    pairs: Reach
    excluded: np.ndarray | None = None
    """Whether each target must not be observed; None if all targets may be observed."""

    @property
    def allowed(self) -> Reach:
        """The pairs of the targets that may be observed."""
        return self.pairs if self.excluded is None else self.pairs.where(~self.excluded[self.pairs.target])


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
    """Return the pairs of a positioner and a target of a field in its reach; the parameters are as in `plan_field`."""
    applied = apply_constraints(instrument, projection, options, targets)
    instrument = applied.instrument
    xy, fiber_type = project_field(instrument, projection, targets.vectors, targets.columns.fiber_type)
    pairs = instrument.focal_plane.arrays.reach(xy, fiber_type)
    return FieldReach(instrument, xy, fiber_type, pairs, applied.excluded)


def _assign(applied: Applied, projection, targets, options, rng, tell=None) -> Allocation:
    """Assign the targets of a field, to which the constraints have been applied."""
    instrument = applied.instrument
    begin = perf_counter()
    xy, fiber_type = project_field(instrument, projection, targets.vectors, targets.columns.fiber_type)
    others = {} if targets.others is None else {"avoid": projection.project(targets.others)}
    seconds = perf_counter() - begin
    columns = targets.columns._replace(fiber_type=fiber_type)
    values = columns.subpriority
    if options.subpriority is not None:
        values = to_subpriorities(options.subpriority, targets.id, targets.extra)
    if values is not None:
        columns, others["order"] = columns._replace(subpriority=values), service_order(values, targets.id)
    elif options.breaks_ties:
        others["order"] = tie_order(xy, None if targets.numbered else targets.id)
    others |= {"excluded": applied.excluded, "excludes_sky": applied.excludes_sky}
    others["ids"] = None if targets.numbered else targets.id
    allocation = assign(instrument.focal_plane, xy, columns, options, rng, tell=tell, **others)
    allocation.seconds["projection"] = seconds
    return allocation


def find_all_collisions(plane: FocalPlane, arms: Arms, options: AllocationOptions) -> CollisionReport:
    """Find the collisions of a plan and, if a constraint refers to the motion of the arms, those of the motion."""
    report, law = collisions_of(plane, arms.segments.T, arms.assigned, arms.parked), options.motion_law
    if not law:
        return report
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
    applied = apply_constraints(instrument, projection, options, targets)
    instrument, targets = applied.instrument, targets._replace(columns=targets.columns._replace(kind=applied.kind))
    allocation = _assign(applied, projection, targets, options, rng, tell)
    begin = perf_counter()
    arms = allocation.place_arms(instrument.focal_plane)
    middle = perf_counter()
    report = find_all_collisions(instrument.focal_plane, arms, options)
    seconds = {**allocation.seconds, "arms": middle - begin, "collisions": perf_counter() - middle}
    positioner = np.flatnonzero(allocation.target_of_positioner >= 0)
    target = allocation.target_of_positioner[positioner]
    given = target < allocation.n_given
    rows = target[given]
    roles = np.full(len(rows), "science") if targets.columns.kind is None else targets.columns.kind[rows]
    kind = np.full(len(target), "sky", dtype=np.promote_types("U8", roles.dtype))
    kind[given] = roles
    ids, vectors = targets.id[rows], targets.vectors.take(rows, axis=0)
    if not given.all():
        found, known = target[~given], (ids, vectors)
        types = None if allocation.target_fiber_type is None else allocation.target_fiber_type[found]
        ids, vectors = np.empty(len(target), dtype=blank.dtype), np.empty((len(target), 3))
        ids[given], vectors[given] = known
        ids[~given] = blank.take(len(found))
        vectors[~given] = projection.unproject(allocation.xy_mm[found], types)
    lon, lat = to_lonlat(vectors)
    owners = np.append(positioner[given], positioner[~given])
    blanks = vectors[~given], allocation.xy_mm[target[~given]]
    finished = report, arms, owners, allocation.fiber_type[owners], target[given], *blanks
    target = np.where(given, target, -1)
    columns = {"priority": targets.columns.priority, "category": targets.columns.category, **(targets.extra or {})}
    carried = {name: values_at(values, target) for name, values in columns.items() if values is not None}
    lon += np.where(lon < 0, 2 * np.pi, 0.0)
    checks = applied.checks(*finished)
    return FieldPlan(
        instrument, allocation, arms, report, positioner, target, ids, lon, lat, kind, carried, seconds, *checks
    )
