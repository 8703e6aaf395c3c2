"""Apply constraints to a field: their obstacles, the targets that they exclude, and the check of the finished plan."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from rfpsurvey._assignment.constraints.constraint import Constraint
from rfpsurvey._assignment.constraints.field import ConstraintField, Verdict
from rfpsurvey._assignment.constraints.rule import Rule
from rfpsurvey._assignment.constraints.text import answer
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._common.units import to_plain
from rfpsurvey._instruments.arms import Arms, place_arms
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._instruments.margins import with_circles
from rfpsurvey._instruments.motion import CollisionReport
from rfpsurvey._sky.arrays import JOINED, KINDS, without_role
from rfpsurvey._sky.projection import FieldProjection
from rfpsurvey.errors import InputError, InputTypeError, refusal, short

if TYPE_CHECKING:
    from rfpsurvey._field.plan import FieldTargets


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
        field, positioner_of, n_covering = self._finished(report, positioner, fiber_type, target, sky_vectors, sky_xy)
        with_idle = [isinstance(constraint, Rule) and constraint.with_idle for constraint in self.constraints]
        plans = [(field, positioner_of)] * len(self.constraints)
        if any(with_idle):  # these rules also apply to the fibers of positioners without a target
            idle, xy, vectors, types = idle_fibers(self.instrument, arms, field.projection)
            whole = field.with_blank_sky(vectors, xy, types), np.append(positioner_of, idle)
            plans = [whole if has_idle else plan for plan, has_idle in zip(plans, with_idle, strict=True)]
        names = self.instrument.focal_plane.id.astype(str)

        @cache  # the sentences of a rule and the list of verdicts use the same verdict
        def verdict(k: int) -> Verdict:
            constraint, (field, positioner_of) = self.constraints[k], plans[k]
            given = answer(constraint, partial(constraint.verdict, field, positioner_of >= 0, n_covering[k]))
            if not isinstance(given, Verdict):
                raise InputTypeError(
                    f"the verdict of the constraint '{constraint}' must be a Verdict, got {short(given)}"
                )
            return replace(given, fibers=tuple(names[positioner_of[given.rows]].tolist()))

        violations: dict[str, list[str]] = {}
        for k, constraint in enumerate(self.constraints):
            if isinstance(constraint, Rule) and type(constraint).check is Rule.check:
                sentences = constraint.sentences(verdict(k))
            else:
                sentences = sentences_of(constraint, plans[k][0], plans[k][1] >= 0, n_covering[k])
            violations.setdefault(str(constraint), []).extend(sentences)  # two constraints can have the same text
        return violations, lambda: [verdict(k) for k in range(len(self.constraints))]

    def _finished(self, report, positioner, fiber_type, target, sky_vectors, sky_xy) -> tuple:
        """Return the field of a finished plan, the positioner of each target, and the numbers of covering arms."""
        field = self.field.with_blank_sky(sky_vectors, sky_xy) if len(sky_xy) else self.field
        rows = np.append(target, np.arange(len(self.field.id), len(field.id)))
        owner, types = np.full(len(field.id), -1), np.append(field.fiber_type, fiber_type)[: len(field.id)]
        owner[rows], types[rows] = positioner, fiber_type
        field = replace(field, fiber_type=types)
        covering, obstacle = report.obstacle_pairs.T
        # the obstacles of constraints follow those of the instrument, of which no constraint is the maker (-1)
        first = len(self.instrument.focal_plane.arrays.obstacles) - len(self.obstacle_of)
        maker = np.append(self.obstacle_of, -1)[np.maximum(obstacle - first, -1)]
        n_covering = [
            report.motion.n_failing if "motion" in constraint.parts else len(np.unique(covering[maker == k]))
            for k, constraint in enumerate(self.constraints)
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
    constraints = tuple(constraint for constraint in options.all_constraints if constraint.uses_field)
    field = constraint_field(instrument, projection, targets, xy) if constraints else None
    circles, excluded, given = [np.empty((0, 3))], None, field
    for constraint in constraints:  # each of them receives the field without the effects of the others
        circles.append(circles_of(constraint, given) if "obstacles" in constraint.parts else circles[0])
        wrong = excluded_by(constraint, given)
        what = getattr(constraint, "what", "") if isinstance(constraint, Rule) else ""
        # a rule on a role takes only this role from targets with several roles
        if wrong is not None and what in KINDS[1:] and xy is None:
            only = wrong & np.isin(given.kind, JOINED) & (given.category != what)
            field, wrong = replace(field, kind=without_role(field.kind, what, only)), wrong & ~only
        excluded = wrong if excluded is None else excluded if wrong is None else excluded | wrong
    sizes, circles = [len(drawn) for drawn in circles[1:]], np.vstack(circles)
    if len(circles):
        scale = None if instrument.distortion else instrument.plate_scale
        instrument = replace(instrument, focal_plane=with_circles(instrument.focal_plane, circles), plate_scale=scale)

    def excludes_sky(points: np.ndarray, fiber_type: np.ndarray | None) -> np.ndarray:
        wider = field.with_blank_sky(projection.unproject(points, fiber_type), points, fiber_type)
        parts = [excluded_by(constraint, wider) for constraint in constraints]
        parts = [part[len(field.id) :] for part in parts if part is not None]
        return np.any(parts, axis=0) if parts else np.zeros(len(points), dtype=bool)

    return Applied(
        instrument,
        None if excluded is None else excluded[: len(targets.id)],
        excludes_sky if any("exclusion" in constraint.parts for constraint in constraints) else None,
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
        idle = np.flatnonzero(~arms.assigned & has)
        xy = place_arms(plane, **angles, fiber_type=types).tip[idle]
        xy[np.isnan(arms.tip[idle, 0])] = np.nan
        vectors = np.full((len(idle), 3), np.nan) if projection is None else projection.unproject(xy, name or None)
        parts.append((idle, xy, vectors, np.full(len(idle), name)))
    return tuple(np.concatenate(columns) for columns in zip(*parts, strict=True))


def early_violations(
    instrument: Instrument, projection: FieldProjection, options: AllocationOptions, targets: "FieldTargets"
) -> dict[str, list[str]]:
    """Return sentences, for the text of each constraint, on violations that no assignment of fibers can prevent."""
    early, violations = [constraint for constraint in options.constraints if constraint.before_fibers], {}
    field = constraint_field(instrument, projection, targets) if early else None
    for constraint in early:
        sentences = sentences_of(constraint, field, np.zeros(len(field.id), dtype=bool), 0)
        violations.setdefault(str(constraint), []).extend(sentences)
    return violations


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
        xy = [project_field(instrument, projection, part.vectors, part.columns.fiber_type)[0] for part in parts]
    columns_of = {"vectors": [part.vectors for part in parts], "xy": xy, "id": [part.id for part in parts]}
    columns_of["is_available"] = [np.full(len(part.id), part is targets) for part in parts]
    optional = {name: [getattr(part.columns, name) for part in parts] for name in ("kind", "category", "priority")}
    optional["fiber_type"] = [required_types(instrument, len(part.id), part.columns.fiber_type) for part in parts]
    for name, values in optional.items():
        usual = {"kind": "science", "priority": 0.0}.get(name, "")
        columns_of[name] = [np.full(len(t.id), usual) if v is None else v for t, v in zip(parts, values, strict=True)]
    extra = {name: np.concatenate([part.extra[name] for part in parts]) for name in targets.extra or {}}
    columns = {name: np.concatenate(values) for name, values in columns_of.items()}
    has_kinds = is_complete or targets.columns.kind is not None
    return ConstraintField(instrument, projection, **columns, extra=extra, is_complete=is_complete, has_kinds=has_kinds)


def circles_of(constraint: Constraint, field: ConstraintField) -> np.ndarray:
    """Return the obstacles of a constraint; raise an error if the constraint returns anything else."""
    answered = answer(constraint, partial(constraint.obstacles, field))
    circles = np.asarray(answered)
    shaped = circles.ndim == 2 and circles.shape[1] == 3 and circles.dtype.kind in "iuf"
    if not (shaped and np.isfinite(circles).all() and (circles[:, 2] >= 0).all()):
        text = f"the constraint '{constraint}' must return circles as finite numbers x, y and radius (mm), shape (k, 3)"
        raise refusal(text, answered, np.ndarray, list)
    return circles


def sentences_of(constraint: Constraint, field: ConstraintField, has_fiber: np.ndarray, n_covering: int) -> list[str]:
    """Return the sentences of the check of a constraint; raise an error if the constraint returns anything else."""
    answered = answer(constraint, partial(constraint.check, field, has_fiber, n_covering))
    if not (isinstance(answered, list | tuple) and all(isinstance(sentence, str) for sentence in answered)):
        raise InputTypeError(
            f"the check of the constraint '{constraint}' must return a list of text, got {short(answered)}"
        )
    return list(answered)


def excluded_by(constraint: Constraint, field: ConstraintField) -> np.ndarray | None:
    """Return the targets that a constraint excludes; raise an error if the constraint returns anything else."""
    if "exclusion" not in constraint.parts:
        return None
    answered = answer(constraint, partial(constraint.excluded, field))
    if answered is None:
        return None
    mask = to_plain(answered)
    if mask.shape != (len(field.id),) or mask.dtype.kind != "b":
        text = f"the constraint '{constraint}' must return one boolean per target, shape ({len(field.id)},)"
        raise InputError(f"{text}, got {mask.dtype.name} of the shape {mask.shape}")
    return mask
