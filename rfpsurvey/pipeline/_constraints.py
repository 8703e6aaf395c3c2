"""Apply constraints to a field: their obstacles, the targets that they exclude, and the check of the finished plan."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from rfpsurvey._roles import JOINED, KINDS, without_role
from rfpsurvey._units import to_plain
from rfpsurvey.allocation import AllocationOptions
from rfpsurvey.collision import Arms, CollisionReport, place_arms
from rfpsurvey.constraints import Constraint, ConstraintField, Rule, Verdict, answer
from rfpsurvey.errors import InputError, InputTypeError, refusal, short
from rfpsurvey.focal_plane import with_circles
from rfpsurvey.instrument import Instrument
from rfpsurvey.projection import FieldProjection


def project_field(
    instrument: Instrument, projection: FieldProjection, vectors: np.ndarray, fiber_type: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the positions (mm) of targets on the focal plane, and the fiber type that each target requires.

    Instead of the fiber types, None is returned if all fibers can observe all targets.
    """
    fiber_type = required_types(instrument, len(vectors), fiber_type)
    return projection.project(vectors, fiber_type), fiber_type


def required_types(instrument: Instrument, n: int, fiber_type: np.ndarray | None) -> np.ndarray | None:
    """Return the fiber type that each of n targets requires; None if all fibers can observe all targets."""
    if instrument.focal_plane.fiber_types == ("",):
        return None  # all fibers have the same unnamed type, and can observe all targets
    if not isinstance(instrument.distortion, dict):
        return fiber_type
    # Each fiber type has its own image of the sky. A target that requires no fiber type uses the first fiber type.
    first = next(iter(instrument.distortion))
    given = np.full(n, "") if fiber_type is None else fiber_type
    return np.where(given == "", first, given)


if TYPE_CHECKING:
    from rfpsurvey.pipeline._field import FieldTargets


@dataclass(frozen=True, eq=False)
class Applied:
    """The result of applying constraints to a field."""

    instrument: Instrument
    """The instrument with the obstacles of the constraints."""
    excluded: np.ndarray | None
    """Whether each target of the field must not be observed; None if all of them may be observed."""
    excludes_sky: Callable | None
    """Function that returns which sky positions must not be observed, from their positions (mm) and fiber types."""
    constraints: tuple[Constraint, ...]
    field: ConstraintField
    kind: np.ndarray | None
    """Kind of each target, without the roles for which a rule excludes it; None if there are no kinds.

    A science target that is outside the magnitude limits of standards, for example, is only a science target.
    """
    obstacle_of: np.ndarray
    """Index of the constraint that added each of the last obstacles of the instrument."""

    def checks(
        self,
        report: CollisionReport,
        arms: Arms,
        positioner: np.ndarray,
        fiber_type: np.ndarray,
        target: np.ndarray,
        sky_vectors: np.ndarray,
        sky_xy: np.ndarray,
    ) -> tuple[dict[str, list[str]], Callable[[], list[Verdict]]]:
        """Return, for the text of each constraint, how a finished plan violates it; and a function for the verdicts.

        ``target`` contains the rows of the targets that have a fiber; the arrays ``sky_vectors`` and ``sky_xy``
        describe sky positions that were added between the targets and have a fiber. ``positioner`` and ``fiber_type``
        contain the rows of the positioners and the fiber types of these targets and, after them, of these sky
        positions.
        """
        if not self.constraints:
            return {}, list
        field, owner, n_covering = self._finished(report, positioner, fiber_type, target, sky_vectors, sky_xy)
        fields, names = {False: (field, owner)}, self.instrument.focal_plane.id.astype(str)
        with_idle = [isinstance(one, Rule) and one.with_idle for one in self.constraints]
        if any(with_idle):
            own, xy, vectors, types = idle_fibers(self.instrument, arms, field.projection)
            fields[True] = field.with_blank_sky(vectors, xy, types), np.append(owner, own)

        def plan(k: int) -> tuple:
            field, owner = fields[with_idle[k]]
            return field, owner >= 0, n_covering[k]

        @cache
        def verdict(k: int) -> Verdict:
            one = self.constraints[k]
            found = answer(one, partial(one.verdict, *plan(k)))
            if not isinstance(found, Verdict):
                raise InputTypeError(f"the verdict of the constraint '{one}' must be a Verdict, got {short(found)}")
            return replace(found, fibers=tuple(names[fields[with_idle[k]][1][found.rows]].tolist()))

        def violations(k: int) -> list[str]:
            one = self.constraints[k]
            if isinstance(one, Rule) and type(one).check is Rule.check:  # its sentences follow from its verdict
                return one.sentences(verdict(k))
            return sentences_of(one, *plan(k))

        rows, found = range(len(self.constraints)), {}
        for k in rows:  # two constraints can have the same text
            found.setdefault(str(self.constraints[k]), []).extend(violations(k))
        return found, lambda: [verdict(k) for k in rows]

    def _finished(self, report, positioner, fiber_type, target, sky_vectors, sky_xy) -> tuple:
        """Return the field of a finished plan, the positioner of each target, and the numbers of covering arms."""
        field = self.field.with_blank_sky(sky_vectors, sky_xy) if len(sky_xy) else self.field
        rows = np.append(target, np.arange(len(self.field.id), len(field.id)))
        owner, types = np.full(len(field.id), -1), np.append(field.fiber_type, fiber_type)[: len(field.id)]
        owner[rows], types[rows] = positioner, fiber_type
        field = replace(field, fiber_type=types)
        own, obstacle = report.obstacle_pairs.T
        first = len(self.instrument.focal_plane.arrays.obstacles) - len(self.obstacle_of)
        maker = np.append(self.obstacle_of, -1)[np.maximum(obstacle - first, -1)]
        n_covering = [
            report.motion.n_planner if "motion" in one.parts else len(np.unique(own[maker == k]))
            for k, one in enumerate(self.constraints)
        ]
        return field, owner, n_covering


def apply_constraints(
    instrument: Instrument,
    projection: FieldProjection | None,
    options: AllocationOptions,
    targets: "FieldTargets",
    xy: np.ndarray | None = None,
) -> Applied:
    """Return the obstacles that constraints add to a field, and the targets that they exclude.

    If ``targets`` are only those that have a fiber, their positions on the focal plane must be given as ``xy`` (mm).
    These targets keep all roles, because a finished plan states which fibers are on standards and sky positions.
    """
    constraints = tuple(one for one in options.all_constraints if one.uses_field)
    field = constraint_field(instrument, projection, targets, xy) if constraints else None
    circles, excluded, given = [np.empty((0, 3))], None, field
    for one in constraints:
        circles.append(circles_of(one, given) if "obstacles" in one.parts else circles[0])
        wrong, what = excluded_by(one, given), getattr(one, "what", "") if isinstance(one, Rule) else ""
        if wrong is not None and what in KINDS[1:] and xy is None:
            only = wrong & np.isin(given.kind, JOINED) & (given.category != what)
            field, wrong = replace(field, kind=without_role(field.kind, what, only)), wrong & ~only
        excluded = wrong if excluded is None else excluded if wrong is None else excluded | wrong
    sizes, circles = [len(one) for one in circles[1:]], np.vstack(circles)
    if len(circles):
        instrument = replace(
            instrument,
            focal_plane=with_circles(instrument.focal_plane, circles),
            plate_scale=None if instrument.distortion else instrument.plate_scale,
        )

    def excludes_sky(points: np.ndarray, fiber_type: np.ndarray | None) -> np.ndarray:
        wider = field.with_blank_sky(projection.unproject(points, fiber_type), points, fiber_type)
        parts = [excluded_by(one, wider) for one in constraints]
        parts = [part[len(field.id) :] for part in parts if part is not None]
        return np.any(parts, axis=0) if parts else np.zeros(len(points), dtype=bool)

    return Applied(
        instrument,
        None if excluded is None else excluded[: len(targets.id)],
        excludes_sky if any("exclusion" in one.parts for one in constraints) else None,
        constraints,
        field,
        targets.columns.kind if targets.columns.kind is None or field is None else field.kind[: len(targets.id)],
        np.repeat(np.arange(len(sizes)), sizes),
    )


def idle_fibers(instrument: Instrument, arms: Arms, projection: FieldProjection | None) -> tuple:
    """Return positioner, position (mm), direction and type of each fiber of positioners without a target.

    A position is NaN if the pose of the positioner is not known, and so is the direction without a projection.
    """
    plane, parts = instrument.focal_plane, []
    angles = {"theta": arms.theta * u.rad, "phi": arms.phi * u.rad}
    for name in plane.fiber_types:
        has = np.array([name in row.split("+") for row in plane.fiber_type.tolist()])
        types = np.where(has, name, plane.arrays.first_type) if name else None
        own = np.flatnonzero(~arms.assigned & has)
        xy = place_arms(plane, **angles, fiber_type=types).tip[own]
        xy[np.isnan(arms.tip[own, 0])] = np.nan
        vectors = np.full((len(own), 3), np.nan) if projection is None else projection.unproject(xy, name or None)
        parts.append((own, xy, vectors, np.full(len(own), name)))
    return tuple(np.concatenate(columns) for columns in zip(*parts, strict=True))


def early_violations(
    instrument: Instrument, projection: FieldProjection, options: AllocationOptions, targets: "FieldTargets"
) -> dict[str, list[str]]:
    """Return sentences, for the text of each constraint, on violations that no assignment of fibers can prevent."""
    early = [one for one in options.constraints if one.before_fibers]
    field, found = constraint_field(instrument, projection, targets) if early else None, {}
    for one in early:
        found.setdefault(str(one), []).extend(sentences_of(one, field, np.zeros(len(field.id), dtype=bool), 0))
    return found


def constraint_field(
    instrument: Instrument, projection: FieldProjection | None, targets: "FieldTargets", xy: np.ndarray | None = None
) -> ConstraintField:
    """Return the targets of a field and, after them, the targets around it, as constraints receive them.

    If ``around`` is None, no constraint uses the positions of targets on the focal plane, which are then NaN.
    """
    is_complete = xy is None
    if targets.around is None:
        parts, xy = [targets], [np.broadcast_to(np.nan, (len(targets.id), 2)) if xy is None else xy]
    else:
        parts = [targets, targets.around]
        xy = [project_field(instrument, projection, one.vectors, one.columns.fiber_type)[0] for one in parts]
    found = {"vectors": [one.vectors for one in parts], "xy": xy, "id": [one.id for one in parts]}
    found["is_available"] = [np.full(len(one.id), one is targets) for one in parts]
    for name, usual in (("kind", "science"), ("category", ""), ("priority", 0.0)):
        columns = [getattr(one.columns, name) for one in parts]
        found[name] = [np.full(len(one.id), usual) if c is None else c for one, c in zip(parts, columns, strict=True)]
    types = [required_types(instrument, len(one.id), one.columns.fiber_type) for one in parts]
    found["fiber_type"] = [np.full(len(one.id), "") if c is None else c for one, c in zip(parts, types, strict=True)]
    extra = {name: np.concatenate([one.extra[name] for one in parts]) for name in targets.extra or {}}
    columns = {name: np.concatenate(values) for name, values in found.items()}
    has_kinds = is_complete or targets.columns.kind is not None
    return ConstraintField(instrument, projection, **columns, extra=extra, is_complete=is_complete, has_kinds=has_kinds)


def circles_of(constraint: Constraint, field: ConstraintField) -> np.ndarray:
    """Return the obstacles of a constraint; raise an error if the constraint returns anything else."""
    found = answer(constraint, partial(constraint.obstacles, field))
    circles = np.asarray(found)
    shaped = circles.ndim == 2 and circles.shape[1] == 3 and circles.dtype.kind in "iuf"
    if not (shaped and np.isfinite(circles).all() and (circles[:, 2] >= 0).all()):
        text = f"the constraint '{constraint}' must return circles as finite numbers x, y and radius (mm), shape (k, 3)"
        raise refusal(text, found, np.ndarray, list)
    return circles


def sentences_of(constraint: Constraint, field: ConstraintField, has_fiber: np.ndarray, n_covering: int) -> list[str]:
    """Return the sentences of the check of a constraint; raise an error if the constraint returns anything else."""
    found = answer(constraint, partial(constraint.check, field, has_fiber, n_covering))
    if not (isinstance(found, list | tuple) and all(isinstance(one, str) for one in found)):
        raise InputTypeError(
            f"the check of the constraint '{constraint}' must return a list of text, got {short(found)}"
        )
    return list(found)


def excluded_by(constraint: Constraint, field: ConstraintField) -> np.ndarray | None:
    """Return the targets that a constraint excludes; raise an error if the constraint returns anything else."""
    if "exclusion" not in constraint.parts:
        return None
    found = answer(constraint, partial(constraint.excluded, field))
    if found is None:
        return None
    mask = to_plain(found)
    if mask.shape != (len(field.id),) or mask.dtype.kind != "b":
        text = f"the constraint '{constraint}' must return one boolean per target, shape ({len(field.id)},)"
        raise InputError(f"{text}, got {mask.dtype.name} of the shape {mask.shape}")
    return mask
