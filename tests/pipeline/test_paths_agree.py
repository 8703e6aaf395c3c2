"""All functions that plan a tile observe the same targets of the same catalog, and lose the same targets to collisions.

A tile is planned by `plan_tile`, by a survey of one tile, by a joint plan of one tile, by a tiling of one given tile,
and by selection probabilities of one realization.
"""

from dataclasses import dataclass, replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from astropy.time import Time

import rfpsurvey as rs
from rfpsurvey.allocation._methods import METHODS
from rfpsurvey.selection._state import seeds_of
from rfpsurvey.tiling import conditions_of_tiles
from rfpsurvey.tiling._problem import TilingState

pytestmark = pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")
ALLOCATORS = sorted(METHODS)
CENTER = SkyCoord(10 * u.deg, 40 * u.deg)
N = 160
# the seed of the only realization, with which all functions plan the tile
SEED = seeds_of(0, 1)[0]
COLUMNS = {
    "kind": lambda rng: rng.choice(["science", "science", "science", "standard", "sky"], N),
    "visits": lambda rng: rng.integers(0, 3, N),
    "priority": lambda rng: rng.integers(0, 3, N),
    "roles": lambda rng: rng.choice(["science", "science", "science+standard", "science+sky", "standard", "sky"], N),
    "category": lambda rng: rng.choice(["bright", "faint"], N),
    "fiber_type": lambda rng: rng.choice(["", "", "A", "B"], N),
    "subpriority": lambda rng: rng.random(N),
    "extra": lambda rng: {"first": rng.permutation(N)},
}


@dataclass(frozen=True)
class AwayFrom(rs.constraints.Constraint):
    """Exclude targets near the first targets, by the column ``first``, wherever these are and whoever observes them."""

    number: int
    radius_deg: float

    name = "away_from"

    @property
    def margin_rad(self):
        return np.deg2rad(self.radius_deg)

    def excluded(self, field):
        few = field.column("first") < self.number
        return field.is_near(field.vectors[few], self.margin_rad) & ~few


OPTIONS = {
    "constraints": lambda rng, catalog: [AwayFrom(9, 0.05)],
    "required": lambda rng, catalog: rng.choice(catalog.id, 25, replace=False).tolist(),
    "keep_out": lambda rng, catalog: [rs.Region.cap(one, 0.01 * u.deg) for one in catalog.coord[:10]],
    "requirements": lambda rng, catalog: ["standard=2", "sky=4", "bright=3", "faint=2-8"],
    "sky_separation": lambda rng, catalog: 0.5 * u.mm,
    "subpriority": lambda rng, catalog: "first",
}
# the columns of the catalog and the options of each case
CASES = {
    "plain": (),
    "visits": ("visits",),
    "kinds": ("kind", "visits"),
    "classes": ("priority", "category", "extra"),
    "fiber types": ("fiber_type",),
    "required": ("required", "kind", "visits", "priority"),
    "keep_out": ("keep_out",),
    "constraints": ("constraints", "extra", "visits"),
    "requirements": ("requirements", "kind", "category", "visits"),
    "roles": ("requirements", "roles", "visits", "priority"),
    "roles and required": ("requirements", "roles", "visits", "required", "sky_separation"),
    "sky_separation": ("sky_separation", "requirements", "kind", "category", "visits"),
    "subpriorities of the catalog": ("subpriority of the catalog", "priority"),
    "subpriority": ("subpriority", "extra", "priority"),
    "moving": ("moving", "visits"),
    "everything": (*(column for column in COLUMNS if column != "roles"), *OPTIONS, "moving"),
}


def make_case(name):
    """Return a catalog, an instrument, a tiling of one tile, and the options of a case."""
    rng, given = np.random.default_rng(7), set(CASES[name])
    where = CENTER.spherical_offsets_by(*rng.uniform(-0.3, 0.3, (2, N)) * u.deg)
    if "moving" in given:
        motion = rng.uniform(-3, 3, (2, N)) * u.arcsec / u.yr
        where = SkyCoord(where.ra, where.dec, pm_ra_cosdec=motion[0], pm_dec=motion[1], obstime=Time("J2000"))
    if name != "everything":  # the option and the column have the same name
        given = {*given - {"subpriority"}, *(("subpriority",) if "subpriority of the catalog" in given else ())}
    columns = {column: make(rng) for column, make in COLUMNS.items() if column in given}
    if "roles" in columns:
        columns["kind"] = columns.pop("roles")
    catalog = rs.Catalog(where, id=np.array([f"s{k}" for k in rng.permutation(N)]), **columns)
    options = {option: make(rng, catalog) for option, make in OPTIONS.items() if option in CASES[name]}
    types = np.resize(["A+B", "A", "A+B", "B"], 19)
    positioner = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane.hexagonal(positioner, rings=2, pitch=17 * u.mm, fiber_type=types)
    table = QTable({"tile": [0], "ra": [10] * u.deg, "dec": [40] * u.deg, "position_angle": [25] * u.deg})
    if "moving" in given:
        table["time"] = ["2026-10-01T08:00:00"]
    tiling = rs.Tiling.from_table(table)
    if "moving" in given:
        tiling = tiling.with_conditions(rs.ObservingConditions("apache point", hour_angle=1 * u.hourangle))
    return catalog, rs.Instrument("small", plane, plate_scale=200 * u.mm / u.deg), tiling, options


def by_tile(catalog, instrument, tiling, asked):
    """Return the ids of the observed and of the lost targets in the plan of `plan_tile`, and of the blank sky."""
    conditions = conditions_of_tiles(tiling)
    rng = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(0,)))
    options = {"conditions": None if conditions is None else conditions[0], "allocator": asked, "rng": rng}
    tile = rs.plan_tile(catalog, instrument, CENTER, position_angle=25 * u.deg, **options)
    table = tile.table[tile.table["status"] == "assigned"]
    return by_outcome(table["target_id"], table["in_collision"])


def by_survey(catalog, instrument, tiling, asked, order="color"):
    """Return the same as `by_tile` for a survey of one tile."""
    survey = rs.plan_survey(catalog, instrument, tiling, allocator=asked, order=order, rng=SEED)
    visits = survey.tile(0)
    return by_outcome(visits["target_id"], ~np.asarray(visits["observed"]))


def by_outcome(ids, lost):
    ids, lost = np.asarray(ids).astype(str), np.asarray(lost)
    return set(ids[~lost].tolist()), set(ids[lost].tolist())


def by_tiling(catalog, instrument, tiling, asked, monkeypatch):
    """Return the ids of the science targets that the only tile of a tiling observes."""
    found, observe = [], TilingState.observe

    def record(state, *rest, **more):
        found.extend(catalog.id[state.problem.index.order[observe(state, *rest, **more)]].tolist())

    with monkeypatch.context() as patch:
        patch.setattr(TilingState, "observe", record)
        rs.place_tiles(catalog, instrument, method="given", centers=tiling, allocator=asked, rng=SEED)
    return set(found)


def by_selection(catalog, instrument, tiling, asked):
    """Return the ids of the science targets that the only realization observes, and the number of lost targets."""
    found = rs.selection_probabilities(catalog, instrument, tiling, 1, allocator=asked, rng=0)
    assert found.realizations["seed"].tolist() == [SEED]
    return set(found.target_id[found.observed_in(0)].tolist()), int(found.realizations["n_lost"][0])


def check(name, allocator, monkeypatch):
    """Compare all functions that plan a tile, for one case and one allocator."""
    catalog, instrument, tiling, options = make_case(name)
    asked = rs.AllocationOptions(allocator, **options)
    observed, lost = by_survey(catalog, instrument, tiling, asked)
    is_science = np.ones(N, dtype=bool) if catalog.kind is None else np.char.find(catalog.kind, "science") >= 0
    science = set(catalog.id[is_science].tolist())
    assert len(observed & science) >= 4
    assert by_tile(catalog, instrument, tiling, asked) == (observed, lost)
    assert by_tiling(catalog, instrument, tiling, asked, monkeypatch) == observed & science
    if allocator == "optimal":
        assert by_survey(catalog, instrument, tiling, rs.JointOptions(allocator=asked)) == (observed, lost)
    if options.get("subpriority") is None:
        seeded = replace(asked, subpriority=SEED)
        observed, lost = by_tile(catalog, instrument, tiling, seeded)
        assert by_selection(catalog, instrument, tiling, asked) == (observed & science, len(lost))
    if catalog.visits is not None:
        unwanted = set(catalog.id[catalog.visits == 0].tolist()) - {*options.get("required", ())}
        assert not unwanted & (observed | lost)


@pytest.mark.parametrize("name", [name for name in CASES if name != "everything"])
def test_the_same_targets_are_observed_in_each_case(name, monkeypatch):
    check(name, "lamost_rule", monkeypatch)


@pytest.mark.parametrize("allocator", ALLOCATORS)
def test_the_same_targets_are_observed_by_each_allocator(allocator, monkeypatch):
    check("everything", allocator, monkeypatch)
    check("visits", allocator, monkeypatch)


def test_added_sky_positions_of_a_tile_avoid_targets_without_requested_visits():
    """Regression: `plan_tile` ignored targets with 0 visits when it added sky positions between the targets."""
    catalog, instrument, _, _ = make_case("visits")
    asked = rs.AllocationOptions("lamost_rule", requirements="sky=12", sky_separation=6 * u.mm)
    tile = rs.plan_tile(catalog, instrument, CENTER, allocator=asked)
    table = tile.table[np.asarray(tile.table["kind"]) == "sky"]
    assert len(table) >= 8
    targets = instrument.projection(CENTER).plain.project(catalog.arrays.vectors)
    sky = np.column_stack([table[name].to_value(u.mm) for name in ("tip_x", "tip_y")])
    assert np.linalg.norm(sky[:, None] - targets, axis=2).min() > 6 - 1e-9


@pytest.mark.exhaustive
@pytest.mark.parametrize("allocator", ALLOCATORS)
@pytest.mark.parametrize("name", CASES)
def test_the_same_targets_are_observed_in_each_case_by_each_allocator(name, allocator, monkeypatch):
    check(name, allocator, monkeypatch)


@pytest.mark.parametrize("allocator", ALLOCATORS)
@pytest.mark.parametrize("name", ["keep_out", "constraints", "requirements", "required", "everything"])
def test_a_tile_and_a_survey_state_the_same_unmet_constraints(name, allocator):
    """Regression: surveys did not count keep-out circles that arms cover as constraints that are not met."""
    catalog, instrument, tiling, options = make_case(name)
    if "keep_out" in options:  # a circle that at least one arm always covers
        options["keep_out"].append(rs.Region.cap(CENTER, 0.2 * u.deg))
    asked = rs.AllocationOptions(allocator, **options)
    conditions = conditions_of_tiles(tiling)
    where = {"conditions": None if conditions is None else conditions[0], "position_angle": 25 * u.deg}
    rng = np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(0,)))
    unmet = rs.plan_tile(catalog, instrument, CENTER, allocator=asked, rng=rng, **where).summary["unmet"]
    # a survey does not count required targets that are outside of the field of a tile
    unmet = [text for text in unmet if not text.startswith("required targets outside the field")]
    covering = [text for text in unmet if text.startswith("keep_out ")]
    assert len(covering) == ("keep_out" in options)
    survey = rs.plan_survey(catalog, instrument, tiling, allocator=asked, rng=SEED)
    assert survey.tiles["n_unmet"].tolist() == [len(unmet)] == [survey.summary["n_unmet"]]
    expected = ["constraint keep_out: 1 violation in 1 of 1 tile (0)"] * len(covering)
    assert [text for text in survey.summary["unmet"] if "keep_out" in text] == expected
