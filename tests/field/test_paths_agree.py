"""All functions that plan a tile observe the same targets of the same catalog, and lose the same targets to collisions.

A tile is planned by `plan_tile`, by a survey of one tile, by a joint plan of one tile, by a tiling of one given tile,
and by selection probabilities of one realization. In random scenes, a survey plans several overlapping tiles; as the
reference, `plan_tile` plans one of them after the other.
"""

import os
from dataclasses import dataclass, replace
from functools import partial

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from astropy.time import Time

import rfpsurvey as rs
from rfpsurvey._assignment.methods import METHODS
from rfpsurvey._survey.selection.work import seeds_of
from rfpsurvey._survey.tiling.columns import conditions_of_tiles
from rfpsurvey._survey.tiling.problem import TilingState

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
    "extra": lambda rng: {"first": rng.permutation(N), "r": rng.uniform(12, 20, N)},
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
RULES = [AwayFrom(4, 0.05), "magnitude r 13 inf science", "bright_stars r 13:60,14:30", "distribution sky 1 50 20"]
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
    given = set(CASES[name])
    if name != "everything":  # the option and the column have the same name
        given = {*given - {"subpriority"}, *(("subpriority",) if "subpriority of the catalog" in given else ())}
    return make_scene(np.random.default_rng(7), given, CASES[name])


def make_random_scene(seed):
    """Return the same as `make_case` for three overlapping tiles, with random columns, options and rules."""
    rng = np.random.default_rng(seed)
    given, names = ({key for key in keys if rng.random() < 0.4} for keys in (sorted({*COLUMNS, "moving"}), OPTIONS))
    scene = make_scene(rng, {*given, "extra"}, names - {"constraints"}, offsets=rng.uniform(-0.12, 0.12, (2, 3)))
    return *scene[:3], scene[3] | {"constraints": [rule for rule in RULES if rng.random() < 0.3]}


def make_scene(rng, given, names, offsets=((0,), (0,))):
    """Return targets with the ``given`` columns, an instrument, tiles at offsets in degrees, and the named options."""
    where = CENTER.spherical_offsets_by(*rng.uniform(-0.3, 0.3, (2, N)) * u.deg)
    if "moving" in given:
        motion = rng.uniform(-3, 3, (2, N)) * u.arcsec / u.yr
        where = SkyCoord(where.ra, where.dec, pm_ra_cosdec=motion[0], pm_dec=motion[1], obstime=Time("J2000"))
    columns = {column: make(rng) for column, make in COLUMNS.items() if column in given}
    if "roles" in columns:
        columns["kind"] = columns.pop("roles")
    catalog = rs.Catalog(where, id=np.array([f"s{k}" for k in rng.permutation(N)]), **columns)
    options = {option: make(rng, catalog) for option, make in OPTIONS.items() if option in names}
    types = np.resize(["A+B", "A", "A+B", "B"], 19)
    positioner = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane.hexagonal(positioner, rings=2, pitch=17 * u.mm, fiber_type=types)
    centers, rows = CENTER.spherical_offsets_by(*offsets * u.deg), np.arange(len(offsets[0]))
    table = QTable({"tile": rows, "ra": centers.ra, "dec": centers.dec, "position_angle": (25 + 40 * rows) * u.deg})
    table["pass"] = rows
    if "moving" in given:
        table["time"] = [f"2026-10-0{row + 1}T08:00:00" for row in rows]
    tiling = rs.Tiling.from_table(table)
    if "moving" in given:
        tiling = tiling.with_conditions(rs.ObservingConditions("apache point", hour_angle=1 * u.hourangle))
    return catalog, rs.Instrument("small", plane, plate_scale=200 * u.mm / u.deg), tiling, options


def by_tile(catalog, instrument, tiling, asked, seed=SEED):
    """Return the ids of the observed and of the lost targets of each tile, and of the blank sky, by `plan_tile`.

    A tile receives the visits that remain after the tiles before it.
    """
    conditions = conditions_of_tiles(tiling) or [None] * len(tiling.table)
    required, ids, visits = {*asked.required}, catalog.id.tolist(), requested_visits(catalog, asked)
    kind = ["science"] * N if catalog.kind is None else catalog.kind.tolist()
    plans = []
    for row, tile in enumerate(tiling.table):
        plan = rs.plan_tile(
            replace(catalog, visits=np.array(visits), kind=np.array(kind)),
            instrument,
            SkyCoord(tile["ra"], tile["dec"]),
            position_angle=tile["position_angle"],
            conditions=conditions[row],
            allocator=replace(asked, required=sorted(required)),
            rng=np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(row,))),
        )
        table = plan.table[plan.table["status"] == "assigned"]
        plans.append(by_outcome(table["target_id"], table["in_collision"]))
        for k in np.flatnonzero(np.isin(ids, [*plans[-1][0]])):
            visits[k] -= "science" in kind[k]
            if visits[k] == 0:
                required -= {ids[k]}
                _, *others = kind[k].split("+")
                kind[k], visits[k] = "+".join(others) or kind[k], int(others != [])
    return plans


def requested_visits(catalog, asked):
    """Return the requested visits of all targets; at least one visit of each required target is requested."""
    visits = np.ones(N, dtype=int) if catalog.visits is None else catalog.visits
    return np.maximum(visits, np.isin(catalog.id, [*asked.required])).tolist()


def by_survey(catalog, instrument, tiling, asked, seed=SEED, **options):
    """Return the same as `by_tile` for a survey."""
    survey = rs.plan_survey(catalog, instrument, tiling, allocator=asked, rng=seed, **options)
    return outcomes_of(survey)


def outcomes_of(survey):
    visits = [survey.tile(tile) for tile in survey.tiles["tile"]]
    return [by_outcome(table["target_id"], ~np.asarray(table["observed"])) for table in visits]


def by_outcome(ids, lost):
    ids, lost = np.asarray(ids).astype(str), np.asarray(lost)
    return set(ids[~lost].tolist()), set(ids[lost].tolist())


def by_history(catalog, instrument, tiling, asked, folder):
    """Return the same as `by_survey`, if the rest of the survey is planned again after the observation of each tile."""
    plan = partial(rs.plan_survey, catalog, instrument, tiling, allocator=asked, rng=SEED, folder=folder)
    survey = plan()
    for tile in tiling.table["tile"].tolist():
        survey.record([{"tile": tile, "date": f"2026-01-{3 + tile:02d}"}])
        survey = plan(visits=survey.state(catalog), resume=True)
    return outcomes_of(survey)


def by_score(instrument, tiling, asked, folder):
    """Return the outcomes of the survey in a folder, with collisions that `score_tile` finds."""
    survey, plans = rs.Survey.read(folder), []
    where = {"constraints": [one for one in asked.all_constraints if one.name == "keep_out"]}
    conditions = conditions_of_tiles(tiling) or [None] * len(tiling.table)
    for row, tile in enumerate(tiling.table):
        where |= {"center": SkyCoord(tile["ra"], tile["dec"]), "position_angle": tile["position_angle"]}
        table = rs.score_tile(survey.tile(row), instrument, conditions=conditions[row], **where).table
        table = table[table["status"] == "assigned"]
        plans.append(by_outcome(table["target_id"], table["in_collision"]))
    return plans


def by_tiling(catalog, instrument, tiling, asked, monkeypatch, *, lost=True):
    """Return the ids of the science targets that each tile of a tiling observes; ``lost`` ones do not count."""
    found, observe = [], TilingState.observe

    def record(state, *rest, **more):
        slots = observe(state, *rest, **more)
        found.append({*catalog.id[state.problem.index.order[slots]].tolist()})

    with monkeypatch.context() as patch:
        patch.setattr(TilingState, "observe", record)
        options = {"method": "given", "fibers": rs.tiling.Fibers(lost_in_collision=lost), "rng": SEED}
        rs.place_tiles(catalog, instrument, centers=tiling, allocator=asked, **options)
    return found


def by_selection(catalog, instrument, tiling, asked, number):
    """Return the ids of the science targets that each realization observes, and its number of lost targets."""
    found = rs.selection_probabilities(catalog, instrument, tiling, number, allocator=asked, rng=0)
    assert found.realizations["seed"].tolist() == seeds_of(0, number)
    observed = [{*found.target_id[found.observed_in(row)].tolist()} for row in range(number)]
    return list(zip(observed, found.realizations["n_lost"].tolist(), strict=True))


def agree(found, expected):
    """Compare the plans of tiles, or the results of realizations, and print their number."""
    assert found == expected
    print(len(expected), "compared")


def check(scene, allocator, monkeypatch, number=1):
    """Compare all functions that plan the tiles of a scene, and return the plan.

    Selection probabilities have a ``number`` of realizations.
    """
    *given, options = scene
    catalog, asked = given[0], rs.AllocationOptions(allocator, **options)
    plan, science = by_survey(*given, asked), science_of(catalog)
    assert sum(len(observed & science) for observed, _ in plan) >= 4
    agree(by_tile(*given, asked), plan)
    agree(by_tiling(*given, asked, monkeypatch), science_visits(catalog, asked, plan))
    kept = science_visits(catalog, asked, by_survey(*given, asked, lost_in_collision=False))
    agree(by_tiling(*given, asked, monkeypatch, lost=False), kept)
    if allocator == "optimal" and len(plan) == 1:
        agree(by_survey(*given, rs.JointOptions(allocator=asked)), plan)
    if options.get("subpriority") is None:
        plans = [by_tile(*given, replace(asked, subpriority=seed), seed) for seed in seeds_of(0, number)]
        agree(by_selection(*given, asked, number), [in_all_tiles(tiles, science) for tiles in plans])
    if catalog.visits is not None:
        unwanted = set(catalog.id[catalog.visits == 0].tolist()) - {*options.get("required", ())}
        assert not any(unwanted & (observed | lost) for observed, lost in plan)
    return plan


def science_of(catalog):
    is_science = np.ones(N, dtype=bool) if catalog.kind is None else np.char.find(catalog.kind, "science") >= 0
    return set(catalog.id[is_science].tolist())


def science_visits(catalog, asked, plan):
    """Return the ids of the targets that each tile observes as science targets, whose requested visits remained."""
    left, found = dict(zip(catalog.id.tolist(), requested_visits(catalog, asked), strict=True)), []
    for observed, _ in plan:
        found.append({name for name in observed & science_of(catalog) if left[name] > 0})
        left.update({name: left[name] - 1 for name in found[-1]})
    return found


def in_all_tiles(plan, science):
    """Return the science targets that any tile observes, and the number of lost targets of all tiles."""
    return set().union(*(observed for observed, _ in plan)) & science, sum(len(lost) for _, lost in plan)


@pytest.mark.parametrize("allocator", ["lamost_rule", pytest.param("repair", marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("name", [name for name in CASES if name != "everything"])
def test_the_same_targets_are_observed_in_each_case(name, allocator, monkeypatch):
    """Regression: tiles of `place_tiles` did not observe required standards without a requirement."""
    check(make_case(name), allocator, monkeypatch)


@pytest.mark.parametrize("allocator", ALLOCATORS)
def test_the_same_targets_are_observed_by_each_allocator(allocator, monkeypatch):
    check(make_case("everything"), allocator, monkeypatch)
    check(make_case("visits"), allocator, monkeypatch)


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


@pytest.mark.few(2)
@pytest.mark.parametrize("seed", range(int(os.environ.get("RFPSURVEY_SCENES", 3))))
@pytest.mark.parametrize("allocator", sorted([*ALLOCATORS, "joint"], reverse=True))
def test_the_same_targets_are_observed_in_random_surveys(allocator, seed, monkeypatch, tmp_path):
    *given, options = scene = make_random_scene(seed)
    asked = first = rs.AllocationOptions("optimal" if allocator == "joint" else allocator, **options)
    order = "color" if allocator == "joint" else "given"
    if allocator == "joint":
        asked = rs.JointOptions(iterations=1, allocator=first)
        plan, science = by_survey(*given, asked), science_of(given[0])
        if "subpriority" not in options:
            seeded = [replace(asked, allocator=replace(first, subpriority=seed)) for seed in seeds_of(0, 2)]
            plans = [by_survey(*given, one, seed) for one, seed in zip(seeded, seeds_of(0, 2), strict=True)]
            agree(by_selection(*given, asked, 2), [in_all_tiles(tiles, science) for tiles in plans])
    else:
        plan = check(scene, allocator, monkeypatch, 2)
        agree(by_history(*given, asked, tmp_path / "history"), plan)
    agree(by_survey(*given, asked, order=order, folder=tmp_path / "survey"), plan)
    agree(by_score(*given[1:], first, tmp_path / "survey"), plan)


@pytest.mark.parametrize("allocator", ["lamost_rule", "repair"])
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
