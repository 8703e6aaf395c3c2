"""Descriptions of the columns of the tables of a survey, and of the numbers of its summary."""

from dataclasses import dataclass

import numpy as np

from rfpsurvey._descriptions import Column, Fact, facts_of
from rfpsurvey._methods import table_of
from rfpsurvey.errors import brief
from rfpsurvey.pipeline import OUTCOMES
from rfpsurvey.tile import TILE_FACTS, required_of


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
)
"""Counts of a tile if a constraint of the plan refers to the motion of the arms."""
LOST_TO_RULES = Count(LOST, COST_OF_RULES, card="NLOSTRUL", comment="science targets that rules cost")
"""Count of a tile if rules refer to the distribution of fibers, and the allocator complies with them.

Tiles of joint plans, and of earlier versions, do not have this count.
"""
ALSO_SCIENCE = Count("n_also_science", ALSO, card="NALSOSCI", comment="science targets that also meet requirements")
"""Count of a tile if it is not 0; files of tiles of earlier versions do not have this count."""
CARDS = {count.card for count in (*COUNTS, *MOTION, LOST_TO_RULES, ALSO_SCIENCE)}
TILES = table_of(
    Column("tile", "identifier of the tile"),
    Column("ra", "right ascension of the field center (ICRS)", "deg"),
    Column("dec", "declination of the field center (ICRS)", "deg"),
    Column("position_angle", "position angle of the +y axis, from north toward east", "deg"),
    Column("hour_angle", "hour angle of the field center at the midpoint of the exposure", "deg"),
    Column("time", "midpoint of the exposure (UTC)"),
    Column("round", "round in which the tile is planned; tiles of one round do not share targets"),
    Column("state", "planned, done (observed), partly (partly observed) or dropped"),
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
    *(fact for fact in TILE_FACTS if fact.name in ("n_unfolding_pairs", "n_needs_planner")),
    Fact("n_unmet", "unmet requirements, sum over tiles"),
    Fact("n_required_observed", "required targets observed", shown=required_of),
    Fact("outcomes", shown=lambda s: {f"targets {outcome}": n for outcome, n in s["outcomes"].items()}),
)
"""The numbers of the summary of a survey that are shown."""


def survey_facts(survey) -> dict:
    """Return the labels and values of the numbers of a survey, and the number of targets with each outcome."""
    tiles, names = survey.tiles, np.asarray(survey.tiles["tile"])
    at_zero = (np.asarray(tiles["ra"]) == 0) & (np.asarray(tiles["dec"]) == 0)
    is_unusual = {"without targets": np.isnan(tiles["completeness"]), "at ra 0, dec 0": at_zero}
    unusual = {label: brief(tuple(names[rows].tolist())) for label, rows in is_unusual.items() if rows.any()}
    return facts_of(SURVEY_FACTS, {**survey.summary, "unusual_tiles": unusual})
