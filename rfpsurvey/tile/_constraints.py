"""Constraints on the plans of other programs: their obstacles, and sentences on the constraints that are violated."""

from dataclasses import dataclass

import numpy as np

from rfpsurvey._roles import count_also_science, to_kinds
from rfpsurvey._units import from_lonlat
from rfpsurvey.allocation import AllocationOptions, TargetColumns
from rfpsurvey.catalog import Finder
from rfpsurvey.collision import Arms, CollisionReport
from rfpsurvey.constraints import KINDS, CountedTargets, Requirement, Rule, sentences
from rfpsurvey.errors import InputError, warn
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.instrument import Instrument
from rfpsurvey.pipeline import Applied, FieldTargets, apply_constraints
from rfpsurvey.plans import further_columns
from rfpsurvey.projection import FieldProjection


@dataclass(frozen=True, eq=False)
class ScoredTargets(CountedTargets):
    """The targets that have a fiber in the plan of another program, from which requirements are counted."""

    focal_plane: FocalPlane
    xy: np.ndarray
    requirements: tuple[Requirement, ...]
    kind: np.ndarray | None
    category: np.ndarray | None
    fiber_type: np.ndarray | None

    def __post_init__(self):
        self._complete()


@dataclass(frozen=True, eq=False)
class ScoredConstraints:
    """The constraints that a score checks, applied to the targets that have a fiber."""

    options: AllocationOptions
    applied: Applied
    columns: TargetColumns
    xy: np.ndarray

    def summary(
        self,
        report: CollisionReport,
        arms: Arms,
        target_of: np.ndarray,
        who: np.ndarray,
        fibers: np.ndarray,
        stuck: np.ndarray,
    ) -> dict:
        """Return the entries of the summary of a score.

        ``target_of`` is the target of each positioner; ``who`` and ``fibers`` are the positioner and the fiber type of
        each target. The fibers of the positioners ``stuck``, which have no target, observe sky.
        """
        plane, n, more = self.applied.instrument.focal_plane, len(self.xy), len(stuck)
        added = {
            "kind": np.full(more, "sky"),
            "category": np.full(more, ""),
            "fiber_type": plane.arrays.first_type[stuck],
        }
        columns = {name: getattr(self.columns, name) for name in added}
        columns = {k: None if v is None else np.append(v, added[k]) for k, v in columns.items()}
        targets = ScoredTargets(plane, np.vstack([self.xy, np.zeros((more, 2))]), self.options.counts, **columns)
        target_of = target_of.copy()
        target_of[stuck] = n + np.arange(more)
        lacking = targets.shortfalls(target_of)
        owners, types = np.append(who, stuck), np.append(fibers, added["fiber_type"])
        sky, projection = arms.tip[stuck], None if self.applied.field is None else self.applied.field.projection
        vectors = np.full((more, 3), np.nan) if projection is None else projection.unproject(sky, added["fiber_type"])
        finished = report, arms, owners, types, np.arange(n), vectors, sky
        violations, verdicts = self.applied.checks(*finished)
        wrong = {shortfall.requirement for shortfall in lacking}
        numbers: dict = {}
        counts, kind = targets.verdicts(target_of), self.columns.kind
        n_both = 0 if kind is None else count_also_science(kind, [count.what for count in self.options.counts])
        for count in counts:
            numbers.setdefault(count.rule, []).append(count.number)
        unknown, constraints = "the plan does not have the kinds of its targets", self.options.all_constraints
        counts = [
            count if self._knows(group.requirement.what) else count.unknown(unknown)
            for count, group in zip(counts, targets.groups, strict=True)
        ]
        return {
            "n_constraints": len(constraints),
            "n_unmet": sum(bool(violations.get(str(c)) or wrong & {*c.counts}) for c in constraints),
            "requirements": numbers,
            **({"n_also_science": n_both} if n_both else {}),
            "unmet": sentences(lacking) + [text for texts in violations.values() for text in texts],
            "rules": [verdict.record for verdict in (*counts, *verdicts())],
        }

    def _knows(self, what: str) -> bool:
        """Return whether the plan states which targets have a kind or category."""
        kind, category = self.columns.kind, self.columns.category
        in_category = category is not None and (what not in KINDS or bool((category == what).any()))
        return in_category or (kind is not None and what in KINDS)


def _kinds_of(category: np.ndarray | None) -> np.ndarray | None:
    """Return the kinds of targets from categories such as ``sky_boss``; None if a category does not begin with one."""
    if category is None:
        return None
    kinds = np.full(len(category), "", dtype="U8")
    for kind in KINDS:
        kinds[np.char.startswith(category, kind)] = kind
    return kinds if (kinds != "").all() else None


def find_constraints(
    given: object,
    instrument: Instrument,
    projection: FieldProjection | None,
    find: Finder,
    rows: np.ndarray,
    ids: np.ndarray,
    sky_deg: np.ndarray,
    xy: np.ndarray,
    fiber_type: np.ndarray,
) -> ScoredConstraints:
    """Return the constraints on a plan; ``rows`` are the rows of the table of ``find`` that are scored."""
    options = AllocationOptions(constraints=given).for_instrument(instrument)
    for constraint in options.all_constraints:
        if projection is None and "obstacles" in constraint.parts:
            raise InputError(
                f"the constraint '{constraint}' can be checked only with positions on the sky: give "
                "positions='sky' (or --positions sky)"
            )
        # the verdicts of rules state the same
        if constraint.margin_rad and "exclusion" in constraint.parts and not isinstance(constraint, Rule):
            text = f"the constraint '{constraint}' is checked only with the targets that have a fiber"
            warn(f"{text}; the table has no others")
    kind, category = (find.labels(role) for role in ("kind", "category"))
    kind = _kinds_of(category) if kind is None else to_kinds(kind, "kind", strict=False)
    priority = find.numbers("priority")
    columns = [None if column is None else column[rows] for column in (priority, kind, category)]
    named = instrument.focal_plane.fiber_types != ("",)
    columns = TargetColumns(*columns, fiber_type=fiber_type if named else None)
    extra = {}
    if options.constraints:
        extra = {name: values[rows] for name, values in further_columns(find.table).items()}
    targets = FieldTargets(from_lonlat(*np.deg2rad(sky_deg)), ids, columns, None, extra)
    applied = apply_constraints(instrument, projection, options, targets, xy)
    return ScoredConstraints(options, applied, columns._replace(kind=applied.kind), xy)
