"""Outcomes of targets, and verdicts on the constraints that plans of other programs violate."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from astropy.table import QTable

from rfpsurvey._assignment.allocate import TargetColumns
from rfpsurvey._assignment.constraints.counts import CountedTargets, sentences
from rfpsurvey._assignment.constraints.requirement import Requirement
from rfpsurvey._assignment.constraints.rule import Rule
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._common.descriptions import Column, describe, table_of
from rfpsurvey._common.units import exact_text, from_lonlat
from rfpsurvey._field.constraints import Applied, apply_constraints
from rfpsurvey._field.plan import FieldTargets
from rfpsurvey._field.plan_files import further_columns
from rfpsurvey._instruments.arms import Arms
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._instruments.motion import CollisionReport
from rfpsurvey._sky.arrays import KINDS, count_also_science, has_role, to_kinds
from rfpsurvey._sky.columns import Finder
from rfpsurvey._sky.projection import FieldProjection
from rfpsurvey.errors import InputError, warn


class Outcome(IntEnum):
    """Whether a target is observed and, if not, the reason."""

    NOT_REQUESTED = 0
    OBSERVED = 1
    PARTLY_OBSERVED = 2
    LOST_TO_A_COLLISION = 3
    IN_REACH_NOT_ASSIGNED = 4
    OUT_OF_REACH = 5
    IN_NO_FIELD = 6
    EXCLUDED_BY_A_CONSTRAINT = 7


OUTCOMES = tuple(outcome.name.lower().replace("_", " ") for outcome in Outcome)
# Up to MOST_CLASSES priorities or categories are counted separately. If there are more priorities, they are combined
# into at most N_RANGES ranges.
MOST_CLASSES, N_RANGES = 20, 10


def outcome_codes(
    in_reach: np.ndarray, excluded: np.ndarray | None, lost: np.ndarray, observed: np.ndarray
) -> np.ndarray:
    """Return the outcome of each target of a field, as an index into `OUTCOMES`.

    The masks mark the targets that a positioner can reach (``in_reach``), that constraints exclude (``excluded``; None
    if there are none), that are lost to a collision (``lost``), and that are observed (``observed``).
    """
    code = np.where(in_reach, Outcome.IN_REACH_NOT_ASSIGNED, Outcome.OUT_OF_REACH).astype(np.uint8)
    if excluded is not None:
        code[in_reach & excluded] = Outcome.EXCLUDED_BY_A_CONSTRAINT
    code[lost] = Outcome.LOST_TO_A_COLLISION
    code[observed] = Outcome.OBSERVED
    return code


def priority_classes(priority: np.ndarray | None, counts: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Return the priority class of each target, and the names of the classes, the most important class first.

    Each class is one priority or a range of priorities. Only targets for which ``counts`` is true define the classes.
    """
    if priority is None or not counts.any():
        return np.zeros(len(counts), dtype=np.uint8), [""]
    values, numbers = np.unique(priority[counts > 0], return_counts=True)
    group = np.arange(len(values))
    if len(values) > MOST_CLASSES:  # the ranges have similar numbers of targets
        before = np.cumsum(numbers) - numbers
        group = np.unique(before * N_RANGES // numbers.sum(), return_inverse=True)[1].reshape(-1)
    low = values[np.searchsorted(group, np.arange(group[-1] + 1))]
    high = values[np.searchsorted(group, np.arange(group[-1] + 1), side="right") - 1]
    names = [exact_text(a) if a == b else f"{exact_text(a)} to {exact_text(b)}" for a, b in zip(low, high, strict=True)]
    place = np.clip(np.searchsorted(low, priority, side="right") - 1, 0, len(low) - 1)
    return (len(low) - 1 - place).astype(np.uint8), names[::-1]


def category_classes(category: np.ndarray | None, counts: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Return the category class of each target, and the names of the classes, the largest class first.

    The size of a class is the number of its targets for which ``counts`` is true. If there are more than
    ``MOST_CLASSES`` categories, the smallest categories are combined into the last class.
    """
    if category is None or not counts.any():
        return np.zeros(len(counts), dtype=np.uint8), [""]
    values, place = np.unique(category, return_inverse=True)
    place = place.reshape(-1)
    numbers = np.bincount(place[counts > 0], minlength=len(values))
    order = np.argsort(-numbers, kind="stable")
    order = order[numbers[order] > 0]
    rank = np.full(len(values), len(order))
    rank[order] = np.arange(len(order))
    names = [str(values[k]) or "no category" for k in order]
    if len(names) > MOST_CLASSES:
        names = [*names[: MOST_CLASSES - 1], f"{len(names) - MOST_CLASSES + 1} others"]
    return np.minimum(rank, len(names) - 1).astype(np.uint8)[place], names


COMPLETENESS = table_of(
    Column("kind", "kind of the counted targets, or 'all' for every kind"),
    Column("category", "category of the counted targets, or 'all' for every category"),
    Column("priority", "priority of the counted targets, or 'all' for every priority"),
    Column("n_in_field", "number of targets in the field, without science targets of which no visits are requested"),
    Column("n_reachable", "number of targets in reach of a positioner"),
    Column("n_assigned", "number of targets with a positioner"),
    Column("n_observed", "number of targets with a positioner whose arm does not collide"),
    Column("completeness", "n_observed divided by n_in_field"),
)
LOST, OBSERVED, UNREACHED, UNUSED = (
    OUTCOMES[k] for k in (Outcome.LOST_TO_A_COLLISION, Outcome.OBSERVED, Outcome.OUT_OF_REACH, Outcome.NOT_REQUESTED)
)


def completeness_table(outcomes: QTable, kinds: dict) -> QTable:
    """Return a table with a row for each kind, each category, and each priority class of science targets.

    ``kinds`` are the `counts_by_kind`, since rules can remove a role of targets.
    """
    outcome = np.asarray(outcomes["outcome"])
    kind = np.asarray(outcomes["kind"]) if "kind" in outcomes.colnames else np.full(len(outcome), "science")
    science = has_role(kind, "science")
    masks = {
        "n_in_field": ~science | (outcome != UNUSED),  # science targets that are not requested are not counted
        "n_reachable": (outcome != UNREACHED) & (outcome != UNUSED),
        "n_assigned": (outcome == OBSERVED) | (outcome == LOST),
        "n_observed": outcome == OBSERVED,
    }
    rows = []

    def add(selected, most=None, **labels):
        counts = [int(np.count_nonzero(mask & selected)) for mask in masks.values()]
        if most is not None:
            counts[2:] = [min(counts[2], most["n_assigned"]), min(counts[3], most["n_observed"])]
        labels = [labels.get(name, "all") for name in ("kind", "category", "priority")]
        rows.append((*labels, *counts, counts[-1] / max(counts[0], 1)))

    for name in KINDS:
        if name == "science" or has_role(kind, name).any():
            add(has_role(kind, name), kinds.get(name), kind=name)
    if "category" in outcomes.colnames:
        class_of, names = category_classes(np.asarray(outcomes["category"]), masks["n_in_field"])
        for k, name in enumerate(names if len(names) > 1 else []):
            add(class_of == k, category=name)
    if "priority" in outcomes.colnames:
        class_of, names = priority_classes(np.asarray(outcomes["priority"]), science & masks["n_in_field"])
        for k, name in enumerate(names if len(names) > 1 else []):
            add(science & (class_of == k), kind="science", priority=name)
    return describe(QTable(rows=rows, names=list(COMPLETENESS)), COMPLETENESS)


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
