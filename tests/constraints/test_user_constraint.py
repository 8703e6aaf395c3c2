"""The constraint in the example of the documentation, in tiles, surveys, tilings, selections and scores."""

import importlib.util
from dataclasses import dataclass
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from raising import refused

import rfpsurvey as rs
from rfpsurvey.allocation import METHODS

CENTER = SkyCoord("6h20m +23d")
EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "plugin" / "rfpsurvey_example" / "constraints.py"
SPEC = importlib.util.spec_from_file_location("example_constraints", EXAMPLE)
example = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(example)
AwayFromBright = example.AwayFromBright
RULE = AwayFromBright(14.0, 0.05)


@pytest.fixture(scope="module")
def sky(small):
    """Return targets with magnitudes and visits; bright stars have no requested visits and are targets of no field."""
    sky = rs.synthetic_catalog("uniform", CENTER, 1.3 * small.field_radius, n_targets=1500, rng=3)
    rng = np.random.default_rng(4)
    mag = rng.uniform(12, 20, len(sky))
    visits = np.where(mag < 14, rng.integers(0, 2, len(sky)), 1)
    kind = rng.choice(["science", "science", "sky"], len(sky))
    return rs.Catalog(sky.coord, kind=kind, visits=visits, extra=QTable({"mag": mag}))


def excluded(sky):
    """Return which targets are near a bright star of the catalog, from all distances."""
    return excluded_of(sky, sky.extra["mag"] < 14)


def excluded_of(sky, bright):
    coord = sky.coord
    return (coord[:, None].separation(coord[bright][None]).deg <= 0.05).any(axis=1) & ~bright


def options(allocator, **others):
    return rs.AllocationOptions(allocator, constraints=[RULE], **others)


@pytest.fixture
def tiles():
    return SkyCoord([CENTER, CENTER.directional_offset_by(40 * u.deg, 0.3 * u.deg)])


def rows_of(tile, sky):
    """Return the rows of the targets that have a fiber."""
    ids = np.asarray(tile.table["target_id"].filled(-1))
    return np.flatnonzero(np.isin(sky.id, ids[ids >= 0]))


@pytest.mark.parametrize("allocator", METHODS)
def test_no_tile_uses_an_excluded_target(sky, small, allocator):
    wrong, tile = excluded(sky), rs.plan_tile(sky, small, CENTER, allocator=options(allocator))
    used, others = rows_of(tile, sky), rows_of(rs.plan_tile(sky, small, CENTER, allocator=allocator), sky)
    assert wrong[others].any()
    assert not wrong[used].any()
    assert len(used) > 0.7 * len(others)
    assert tile.provenance["parameters"]["constraints"] == ["away_from_bright 14.0 0.05"]
    assert tile.summary["unmet"] == []


def test_excluded_targets_are_not_free_targets_of_idle_positioners(small):
    """The target at the center is next to a star, and the positioner there therefore has no target in reach."""
    places = [CENTER.directional_offset_by(0 * u.deg, r * u.deg) for r in (0.02, 0.021, 0.3)]
    sky = rs.Catalog(SkyCoord(places), visits=[1, 0, 1], extra=QTable({"mag": [18.0, 10.0, 18.0]}))
    tile = rs.plan_tile(sky, small, CENTER, allocator=options("nearest"))
    assert len(tile.idle) == 36
    assert set(tile.idle["n_in_reach"].tolist()) <= {0, 1}
    texts = {"no target in reach", "all targets in reach are assigned to other positioners"}
    assert set(tile.idle["reason"].tolist()) <= texts
    assert len(tile.idle_targets) == 0


def test_the_report_lists_the_constraints(sky, small, tmp_path):
    tile = rs.plan_tile(sky, small, CENTER, allocator=options("nearest"))
    rs.write_report(tile, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert "away_from_bright 14.0 0.05" in text
    assert "All constraints are met." in text


def test_bright_stars_outside_the_field_count_too(small):
    """The star is outside the field and has no visits; the only target is at the edge of the field."""
    edge, step = small.field_radius, 1 * u.arcsec
    places = [CENTER.directional_offset_by(30 * u.deg, r) for r in (edge - 10 * u.arcsec, edge + step, 0 * u.deg)]
    sky = rs.Catalog(SkyCoord(places), visits=[1, 0, 1], extra=QTable({"mag": [18.0, 10.0, 18.0]}))
    seen = []

    class Seen(AwayFromBright):
        def excluded(self, field):
            seen.append(super().excluded(field)[field.is_available].tolist())
            return super().excluded(field)

    rs.plan_tile(sky, small, CENTER, allocator=rs.AllocationOptions(constraints=Seen(14.0, 20 / 3600)))
    rs.plan_survey(sky, small, CENTER, allocator=rs.AllocationOptions(constraints=Seen(14.0, 20 / 3600)))
    assert seen
    assert all(one == [True, False] for one in seen)


@pytest.mark.parametrize("allocator", METHODS)
def test_surveys_and_tiles_exclude_the_same_targets(sky, small, tiles, allocator, tmp_path):
    wrong = excluded(sky)
    survey = rs.plan_survey(sky, small, tiles, allocator=options(allocator), folder=tmp_path / "survey")
    row = np.asarray(survey.targets["target_row"])
    assert not wrong[row].any()
    assert len(row) > 30
    assert not survey.tiles["n_unmet"].any()
    assert survey.summary["unmet"] == []
    assert survey.provenance["parameters"]["constraints"] == ["away_from_bright 14.0 0.05"]
    again = rs.plan_survey(sky, small, tiles, allocator=options(allocator), folder=tmp_path / "survey", resume=True)
    assert again.targets["target_row"].tolist() == row.tolist()
    with pytest.raises(rs.InputError, match="constraints"):
        rs.plan_survey(sky, small, tiles, allocator=allocator, folder=tmp_path / "survey", resume=True)


def test_a_catalog_in_partitions_gives_the_same_survey(sky, small, tiles, tmp_path):
    """A catalog in partitions has no further columns, such as magnitudes; here, the priority replaces the magnitude."""

    class Bright(AwayFromBright):
        def excluded(self, field):
            bright = field.priority < self.limit
            return field.is_near(field.vectors[bright], self.margin_rad) & ~bright

    magnitude = np.floor(np.asarray(sky.extra["mag"]))
    sky = rs.Catalog(sky.coord, 7 + np.arange(len(sky)), priority=magnitude, kind=sky.kind, visits=sky.visits)
    parts = rs.catalog.partition_catalog(sky, tmp_path / "parts", order=6)
    assert len(list((tmp_path / "parts").rglob("*.parquet"))) > 1 or len(parts) == len(sky)
    asked = rs.AllocationOptions("optimal", constraints=Bright(14.0, 0.05))
    whole, parted = (rs.plan_survey(one, small, tiles, allocator=asked) for one in (sky, parts))
    assert not excluded_of(sky, sky.priority < 14)[np.asarray(whole.targets["target_row"])].any()
    ids = [
        sorted(zip(*(one.targets[c].tolist() for c in ("tile", "target_id")), strict=True)) for one in (whole, parted)
    ]
    assert ids[0] == ids[1]
    with pytest.raises(rs.InputError, match="must have the column 'mag', but its further columns are: none"):
        rs.plan_survey(parts, small, tiles, allocator=options("optimal"))


def test_joint_plans_exclude_the_same_targets(sky, small, tiles):
    science = sky[np.flatnonzero(sky.kind == "science")]
    wrong = excluded(science)
    survey = rs.plan_survey(science, small, tiles, allocator=rs.JointOptions(allocator=options("optimal")))
    assert not wrong[np.asarray(survey.targets["target_row"])].any()


def test_placed_tiles_serve_only_targets_that_are_not_excluded(sky, small):
    tiling = rs.place_tiles(sky, small, method="max_density", allocator=options("lamost_rule"), n_tiles=2)
    survey = rs.plan_survey(sky, small, tiling, allocator=options("lamost_rule"))
    plain = rs.place_tiles(sky, small, method="max_density", allocator="lamost_rule", n_tiles=2)
    served = survey.summary["n_visits_observed"]
    assert tiling.summary["n_observed"] == served
    assert 0 < served < plain.summary["n_observed"]


@pytest.mark.parametrize("allocator", ["nearest", "lamost_rule", "balanced", "optimal"])
def test_no_realization_selects_an_excluded_target(sky, small, tiles, allocator):
    times = rs.selection_probabilities(sky, small, tiles, 4, allocator=options(allocator)).n_observed
    assert not times[excluded(sky)].any()
    assert times.sum() > 100


def test_added_sky_positions_are_not_near_bright_stars(sky, small):
    science = sky[np.flatnonzero(sky.kind == "science")]
    bright, near = science.coord[science.extra["mag"] < 14], []
    for one in ({}, {"constraints": RULE}):
        asked = rs.AllocationOptions("optimal", requirements="sky=12", sky_separation=5 * u.arcsec, **one)
        tile = rs.plan_tile(science, small, CENTER, allocator=asked).table
        tile = tile[np.asarray(tile["kind"]) == "sky"]
        coord = SkyCoord(tile["ra"], tile["dec"])
        near.append((len(coord), int((coord[:, None].separation(bright[None]).deg < 0.05).any(axis=1).sum())))
    assert near[0][1] > 0
    assert near[1] == (12, 0)


def test_a_score_states_which_targets_are_excluded(sky, small):
    plan, text = rs.plan_tile(sky, small, CENTER, allocator="optimal"), "away_from_bright 16.0 0.1"
    with pytest.warns(rs.RfpsurveyWarning, match=f"'{text}' is checked only with the targets that have a fiber"):
        score = rs.score_tile(plan.table, small, constraints=[AwayFromBright(16.0, 0.1), "sky=3", "required 3 99999"])
    assert score.provenance["parameters"]["constraints"] == ["sky=3", "required 3 99999", text]
    used = rows_of(plan, sky)
    coord, bright = sky.coord[used], np.asarray(sky.extra["mag"])[used] < 16
    near = (coord[:, None].separation(coord[bright][None]).deg < 0.1).any(axis=1) & ~bright
    unmet = score.summary["unmet"]
    assert unmet[0] == "sky targets: 0 of 3, 3 missing"
    assert unmet[1].startswith("required targets without a fiber: ")
    assert unmet[2].startswith(f"{text}: {near.sum()} excluded targets have a fiber (")
    assert len(unmet) == 3
    assert [score.summary[name] for name in ("n_constraints", "n_unmet", "requirements")] == [3, 3, {"sky=3": [0]}]


def test_collision_probabilities_refuse_constraints(small):
    with pytest.raises(rs.InputError, match="no other constraints, since a collision probability describes random"):
        rs.collision_probability(small.focal_plane, method="monte_carlo", allocator=options("lamost_rule"))


BOOLEANS = "the constraint 'wrong' must return one boolean per target, shape"
CIRCLES = "the constraint 'wrong' must return circles as finite numbers x, y and radius"
LIST = "the check of the constraint 'wrong' must return a list of text, got"
MARGIN = "margin_rad of the constraint 'wrong' must be a number from 0 to pi, got"
WRONG_ANSWERS = [
    ("excluded", lambda field: field.extra["color"], "the constraint 'wrong' failed: KeyError: 'color'"),
    ("excluded", lambda field: field.column("color"), "must have the column 'color', but its further columns are: mag"),
    ("excluded", lambda field: [True], BOOLEANS),
    ("excluded", lambda field: field.xy[:, 0], BOOLEANS),
    *(
        ("obstacles", lambda _, circles=circles: circles, CIRCLES)
        for circles in (None, "x", [0, 0, 5.0], [[0, 0, np.nan]], [[0, 0, -1.0]], [[0, 0]])
    ),
    *(("check", lambda *_, found=found: found, LIST) for found in (None, "text", [1])),
    *(("margin_rad", margin, MARGIN) for margin in (-0.1, np.nan, np.inf, 4.0, "wide")),
]


@pytest.mark.filterwarnings("ignore:.*has no effect")
@pytest.mark.parametrize(("attribute", "answer", "words"), WRONG_ANSWERS)
def test_a_wrong_answer_names_the_constraint(sky, small, attribute, answer, words):
    """Regression: a margin that was negative or not a number was accepted."""
    own = {"name": "wrong", attribute: (lambda _, *given: answer(*given)) if callable(answer) else answer}
    wrong = dataclass(frozen=True)(type("Wrong", (rs.constraints.Constraint,), own))

    def plan():
        rs.plan_tile(sky, small, CENTER, allocator=rs.AllocationOptions("nearest", constraints=wrong()))

    refused(words, plan)


def test_a_constraint_that_is_no_dataclass_is_refused_before_planning():
    class Plain(rs.constraints.Constraint):
        name = "plain"

    with pytest.raises(rs.InputError, match="a constraint must be a frozen dataclass, got the class Plain"):
        rs.AllocationOptions(constraints=Plain())


@pytest.mark.filterwarnings("ignore:.*has no effect")
def test_two_constraints_with_arrays_are_different_constraints(sky, small):
    @dataclass(frozen=True)
    class Zones(rs.constraints.Constraint):
        circles: np.ndarray
        name = "zones"

        def obstacles(self, field):
            return self.circles

    far = np.full((2000, 3), 1.0) + [1e5, 0, 0]
    moved = far.copy()
    moved[1000] += 1
    assert str(Zones(far)) != str(Zones(moved))
    pair = rs.AllocationOptions("nearest", constraints=[Zones(far), Zones(moved)])
    assert len(rs.plan_tile(sky, small, CENTER, allocator=pair).table) > 0


def test_a_constraint_that_no_allocator_honors_causes_one_warning(sky, small):
    @dataclass(frozen=True)
    class Few(rs.constraints.Constraint):
        most: int
        name = "few"

        def check(self, field, has_fiber, n_covering):
            n = int(has_fiber.sum())
            return [f"{self}: {n} targets have a fiber"] if n > self.most else []

    asked = rs.AllocationOptions("optimal", constraints=Few(3))
    with pytest.warns(rs.RfpsurveyWarning, match="'few 3' has no effect with the allocator 'optimal', except") as told:
        tile = rs.plan_tile(sky, small, CENTER, allocator=asked)
    assert len(told) == 1
    assert tile.summary["unmet"] == [f"few 3: {tile.summary['n_assigned']} targets have a fiber"]
    with pytest.warns(rs.RfpsurveyWarning):
        survey = rs.plan_survey(sky, small, CENTER, allocator=asked)
    assert (survey.tiles["n_unmet"].tolist(), survey.tiles["unmet"].tolist()) == ([1], ["few 3: 1 violation"])
    assert survey.summary["unmet"] == ["constraint few 3: 1 violation in 1 of 1 tile (0)"]
