"""Descriptions of the columns and of the summary of a survey, and the requirements that its tiles do not meet."""

import zlib
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from rfpsurvey._assignment.constraints.constraint import Constraint
from rfpsurvey._assignment.constraints.field import FAIL, NOT_CHECKABLE, PASS
from rfpsurvey._assignment.constraints.targets import KeepOut
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._common.descriptions import Column, Fact, facts_of, table_of
from rfpsurvey._field.facts import TILE_FACTS, required_of
from rfpsurvey._field.plan import FieldPlan
from rfpsurvey._field.verdicts import OUTCOMES
from rfpsurvey.errors import brief, listed, number_of


@dataclass(frozen=True)
class Count(Column):
    """A count of each tile, which is a column of the table of tiles, and a header card of the file of each tile.

    The comment of the card is by default the description without the words "number of".
    """

    card: str = ""
    comment: str = ""


N_FIELD, N_LOST, LOST = "NFIELD", "NLOST", "n_lost_to_rules"
IN_FIELD = "number of targets in the field that still require a visit"
IN_REACH = "number of targets that still require a visit and are in reach of a positioner"
COLLIDING = "number of usable positioners in collision that have a target"
UNMET = "number of requirements that are not met"
COST_OF_RULES = "number of science targets that the rules on the distribution of fibers cost"
ALSO = "number of positioners with a science target that also counts toward a requirement on standard stars or sky"
COUNTS = (
    Count("n_in_field", IN_FIELD, card=N_FIELD, comment="targets in the field with remaining visits"),
    Count("n_reachable", IN_REACH, card="NREACH", comment="targets in reach with remaining visits"),
    Count("n_assigned", "number of usable positioners with a target", card="NASSIGN"),
    Count("n_science", "number of positioners with a science target", card="NSCIENCE"),
    Count("n_standard", "number of positioners with a standard star", card="NSTANDAR"),
    Count("n_sky", "number of positioners with a sky position", card="NSKY"),
    Count("n_colliding", "number of positioners in collision", card="NCOLLIDE"),
    Count("n_colliding_assigned", COLLIDING, card=N_LOST, comment="usable positioners in collision with a target"),
    Count("n_counted", "number of positioners that have a target or are parked", card="NCOUNTED"),
    Count("n_colliding_pairs", "number of pairs of arms in collision", card="NPAIRS"),
    Count("n_obstacle_collisions", "number of collisions with obstacles", card="NOBSTACL"),
    Count("n_unmet", UNMET, card="NUNMET", comment=UNMET),
)
MOTION = (
    Count("n_unfolding_pairs", "number of pairs of arms that collide while they unfold", card="NUNFOLD"),
    Count("n_unfolding_obstacle_collisions", "number of collisions of unfolding arms with obstacles", card="NUNFOBST"),
    Count("n_needs_planner", "number of positioners that need a path planner", card="NPLANNER"),
    Count("n_without_path", "number of positioners with a target and without a path", card="NNOPATH"),
)
"""Counts of a tile if a constraint of the plan refers to the motion of the arms; the last one is for planned paths."""
LOST_TO_RULES = Count(LOST, COST_OF_RULES, card="NLOSTRUL", comment="science targets that rules cost")
"""Count of a tile if rules refer to the distribution of fibers, and the allocator complies with them.

Tiles of joint plans, and of earlier versions, do not have this count.
"""
ALSO_SCIENCE = Count("n_also_science", ALSO, card="NALSOSCI", comment="science targets that also meet requirements")
"""Count of a tile if it is not 0; files of tiles of earlier versions do not have this count."""
CARDS = {count.card for count in (*COUNTS, *MOTION, LOST_TO_RULES, ALSO_SCIENCE)}
PAST = "past"
"""State of a tile of a survey with cadences whose time passed without an observation."""
NOT_PLANNED = "dropped", PAST
"""States of tiles that are never observed."""
TILES = table_of(
    Column("tile", "identifier of the tile"),
    Column("ra", "right ascension of the field center (ICRS)", "deg"),
    Column("dec", "declination of the field center (ICRS)", "deg"),
    Column("position_angle", "position angle of the +y axis, from north toward east", "deg"),
    Column("hour_angle", "hour angle of the field center at the midpoint of the exposure", "deg"),
    Column("time", "time of the tile (UTC)"),
    Column("projection", "model of the projection of the tile"),
    Column("round", "round in which the tile is planned; tiles of one round do not share targets"),
    Column("state", "planned, done (observed), partly (partly observed), dropped or past (not observed in time)"),
    Column("date", "date of the last observation"),
    Column("n_failed", "number of failed visits to science targets of an observed tile"),
    *COUNTS,
    *MOTION,
    LOST_TO_RULES,
    ALSO_SCIENCE,
    Column("unmet", "requirements that are not met, with the numbers of missing targets"),
    Column("not_checkable", "constraints that are not checkable, because the plan lacks their data"),
    Column("n_observed", "number of successful visits to science targets"),
    Column("collision_rate", "n_colliding divided by n_counted"),
    Column("fiber_use", "n_assigned divided by the number of usable positioners"),
    Column("completeness", "successful visits divided by requested visits, for the targets in the field"),
)
OUTCOME = table_of(
    Column("target_id", "identifier of the target"),
    Column("requested", "number of requested visits"),
    Column("observed", "number of successful visits"),
    Column("outcome", f"code of the outcome: {', '.join(f'{k} {name}' for k, name in enumerate(OUTCOMES))}"),
    Column("n_epochs", "number of completed epochs of the cadence"),
    Column("released", "whether the window of the next epoch has closed, so that the cadence cannot be completed"),
)
FIBERS, COLLISIONS = "n_assigned", "n_colliding"
SURVEY_FACTS = (
    Fact("n_tiles", "tiles", zero=True),
    Fact("n_rounds", "rounds of non-overlapping tiles", "n_tiles", zero=True),
    Fact("unusual_tiles", of="n_tiles"),
    Fact("n_targets", "targets with requested visits", zero=True),
    Fact("n_visits_requested", "visits requested", zero=True),
    Fact("n_visits_observed", "observed", "n_visits_requested", zero=True),
    Fact("completeness", "completeness", zero=True),
    Fact("completeness_targets", "fraction of completed targets", "completeness", zero=True),
    Fact(FIBERS, "fibers assigned", zero=True),
    Fact("n_science", "to science targets", FIBERS, zero=True),
    Fact(ALSO_SCIENCE.name, "that also meet requirements", "n_science"),
    Fact("n_standard", "to standard stars", FIBERS),
    Fact("n_sky", "to sky", FIBERS),
    Fact("fiber_use", "fraction of usable positioners", FIBERS, zero=True),
    Fact("n_colliding_assigned", "in collision", FIBERS, zero=True),  # surveys of earlier versions lack this number
    Fact("collision_rate_assigned", "collision rate of assigned arms", FIBERS, zero=True),
    Fact(COLLISIONS, "positioners in collision", zero=True),
    Fact("margins", "margins", COLLISIONS),
    Fact("arm_model", "arm model", COLLISIONS, shown=lambda s: s.get("arm_model", "unknown")),
    Fact("collision_rate", "fraction of assigned and parked", COLLISIONS, zero=True),
    Fact("n_obstacle_collisions", "collisions with obstacles", COLLISIONS),
    *(fact for fact in TILE_FACTS if fact.name in ("n_unfolding_pairs", "n_needs_planner", "n_without_path")),
    Fact("n_unmet", "unmet requirements, sum over tiles"),
    Fact("n_required_observed", "required targets observed", shown=required_of),
    Fact("outcomes", shown=lambda s: {f"targets {outcome}": n for outcome, n in s["outcomes"].items()}),
)
"""The numbers of the summary of a survey that are shown."""


SURVEY_RESULT = ("completeness", "completeness_targets", "n_visits_observed", "n_visits_requested", "n_targets")
SURVEY_RESULT += ("n_tiles", "unusual_tiles", FIBERS, COLLISIONS, "n_unmet", "n_required_observed", "n_without_path")
"""The numbers of the shortest summary of a survey."""


def survey_facts(survey, *, is_short: bool = False) -> dict:
    """Return the labels and values of the numbers of a survey, and the number of targets with each outcome."""
    tiles, names = survey.tiles, np.asarray(survey.tiles["tile"])
    at_zero = (np.asarray(tiles["ra"]) == 0) & (np.asarray(tiles["dec"]) == 0)
    is_unusual = {"without targets": np.isnan(tiles["completeness"]), "at ra 0, dec 0": at_zero}
    unusual = {label: brief(tuple(names[rows].tolist())) for label, rows in is_unusual.items() if rows.any()}
    values = {**survey.summary, "unusual_tiles": unusual}
    return facts_of(SURVEY_FACTS, values, SURVEY_RESULT if is_short else None)


MISSING, EXCESS, VIOLATED = "missing", "too many", "violations"
TAG = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ"
REQUIRED = "required targets"
MOST_TILES = 5
"""Largest number of tiles that a sentence lists."""


class CountOfRule(NamedTuple):
    """The name of a number of missing targets, of targets above a maximum, or of violations, in the plan of a tile."""

    what: str
    """Text of the constraint."""
    word: str
    """Text on the number; ``not checkable`` if it is 1 for a plan that lacks the data of the constraint."""

    def text(self, n: int) -> str:
        """Return text on the number, such as "sky=20: 3 missing"."""
        return f"{self.what}: {n} {self.word.removesuffix('s') if n == 1 else self.word}"


def is_unknown(name: str | CountOfRule) -> bool:
    """Return whether a number states that a constraint is not checkable."""
    return isinstance(name, CountOfRule) and name.word == NOT_CHECKABLE


def shortfall_cards(options: AllocationOptions) -> dict[str, tuple[CountOfRule, str]]:
    """Return header cards of the file of a tile for the targets that requirements lack, as in ``COUNTS``.

    Each requirement has a card for the number of missing targets and, if it has a maximum, a card for the number of
    targets above the maximum. All keep-out circles together have a card, and so has each constraint that is more than
    counts and has no short form. A constraint with a verdict of its own has a card that states if it is not checkable.
    The names of cards depend on the texts of constraints, so that files of tiles with other constraints are recognized.
    """
    cards, tags = {}, _tags([*map(str, options.counts), *map(str, options.constraints)])
    for requirement in options.counts:
        tag = tags[str(requirement)]
        cards[f"MISS{tag}"] = CountOfRule(str(requirement), MISSING), "targets that a requirement lacks"
        if requirement.maximum is not None:
            cards[f"MORE{tag}"] = CountOfRule(str(requirement), EXCESS), "targets above the maximum of a requirement"
    if options.required_ids:
        cards["MISSREQ"] = CountOfRule(REQUIRED, MISSING), "required targets of the field without a fiber"
    if options.keep_out:
        cards["VIOLKEEP"] = CountOfRule(KeepOut.name, VIOLATED), "violations of keep-out circles"
    for constraint in options.constraints:
        if constraint.uses_field:
            text = str(constraint)
            cards[f"VIOL{tags[text]}"] = CountOfRule(text, VIOLATED), "violations of a constraint"
            if type(constraint).verdict is not Constraint.verdict:
                cards[f"NOTC{tags[text]}"] = CountOfRule(text, NOT_CHECKABLE), "1 if the constraint is not checkable"
    return cards


def _tags(texts: list[str]) -> dict[str, str]:
    """Return four letters or digits for each text, which depend on the text; those of different texts are different."""
    tags: dict[str, str] = {}  # FITS keywords, such as MISS and a tag, have at most eight characters
    for text in dict.fromkeys(texts):
        number = zlib.crc32(text.encode())
        while (tag := "".join(TAG[number // 36**k % 36] for k in range(4))) in tags.values():
            number += 1
        tags[text] = tag
    return tags


def counts_in(cards: dict[str, int], counted: dict[str, tuple[str | CountOfRule, str]]) -> dict[str | CountOfRule, int]:
    """Return the counts in the header cards of a tile; constraints that the tile did not have are not checkable."""
    counts = {}
    for card, (name, _) in counted.items():
        counts[name] = cards.get(card, int(is_unknown(name)))
        if card not in cards and isinstance(name, CountOfRule):
            counts[name._replace(word=NOT_CHECKABLE)] = 1
    return counts


def shortfall_counts(plan: FieldPlan, options: AllocationOptions) -> dict[CountOfRule, int]:
    """Return the numbers of missing targets, of targets above maxima, and of violations, for the cards of a tile."""
    counts = {name: 0 for name, _ in shortfall_cards(options).values()}
    if any(map(is_unknown, counts)):
        checked = [constraint for constraint in options.all_constraints if constraint.uses_field]
        for constraint, verdict in zip(checked, plan.verdicts(), strict=True):
            if verdict.verdict == NOT_CHECKABLE:
                counts[CountOfRule(str(constraint), NOT_CHECKABLE)] = 1
    for lack in plan.allocation.unmet:
        what = REQUIRED if lack.requirement is None else str(lack.requirement)
        n_missing = lack.requested - lack.found
        counts[CountOfRule(what, MISSING if n_missing > 0 else EXCESS)] += abs(n_missing)
    for text, sentences in plan.violations.items():
        name = CountOfRule(text, VIOLATED)
        if name not in counts:  # the count of keep-out circles has their name only
            name = CountOfRule(text.partition(" ")[0], VIOLATED)
        if name in counts:
            counts[name] += len(sentences)
    return counts


def texts_of(lacking: dict[CountOfRule, np.ndarray], *, unknown: bool = False) -> list[str]:
    """Return, for each tile, text such as "sky=20: 3 missing, standard=5: 1 missing"; empty if nothing is missing.

    If ``unknown`` is true, the text contains only the constraints that are not checkable.
    """
    lacking = {name: values for name, values in lacking.items() if is_unknown(name) == unknown}
    rows = zip(*(values.tolist() for values in lacking.values()), strict=True)
    return [
        ", ".join(name.what if unknown else name.text(n) for name, n in zip(lacking, row, strict=True) if n)
        for row in rows
    ]


def rule_records(lacking: dict[CountOfRule, np.ndarray], tiles: np.ndarray, kept: np.ndarray | slice) -> list[dict]:
    """Return, for each constraint, the numbers of tiles with each verdict, and the tiles that fail.

    ``kept`` selects the tiles that are not dropped.

    Required targets are no constraint on a single tile, because later tiles can observe them.
    """
    verdicts_of, tiles = {}, tiles[kept]
    for name, values in lacking.items():
        if name.what != REQUIRED:
            verdicts = verdicts_of.setdefault(name.what, np.zeros((2, len(tiles)), dtype=bool))
            verdicts[int(is_unknown(name))] |= values[kept] > 0
    records = []
    for what, (fails, unknown) in verdicts_of.items():
        counts = {PASS: ~(fails | unknown), FAIL: fails, NOT_CHECKABLE: unknown}
        records.append({"rule": what, **{name: int(tiles_of.sum()) for name, tiles_of in counts.items()}})
        records[-1]["tiles"] = listed(tiles[fails].tolist(), MOST_TILES) if fails.any() else ""
    return records


def sentences_of(lacking: dict[CountOfRule, np.ndarray], tiles: np.ndarray) -> list[str]:
    """Return a sentence for each requirement that tiles do not meet, which names the first of these tiles."""
    sentences = []
    for name, values in lacking.items():
        rows = np.flatnonzero(values)
        if len(rows) and name.what != REQUIRED and not is_unknown(name):  # later tiles can observe required targets
            where = f"{len(rows)} of {number_of(len(tiles), 'tile')} ({listed(tiles[rows].tolist(), MOST_TILES)})"
            kind = "constraint" if name.word == VIOLATED else "requirement"
            sentences.append(f"{kind} {name.text(int(values.sum()))} in {where}")
    return sentences
