"""Selection probabilities of a survey with recorded events, compared with surveys of single realizations."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import Table

import rfpsurvey as rs
from rfpsurvey._survey.plan import prepare_request
from rfpsurvey._survey.selection.alternate import Generation, generations_of
from rfpsurvey.survey import SurveyState, VisitRule

INSTRUMENT = "sdss_apo"
one_or_two = pytest.mark.parametrize("n", [1, pytest.param(2, marks=pytest.mark.exhaustive)])
"""Number of realizations."""

TILES = SkyCoord([120.0, 120.7, 120.0, 120.7, 120.3] * u.deg, [30.0, 30.0, 30.6, 30.6, 30.3] * u.deg)


@pytest.fixture(autouse=True)
def _plans_are_made_before_the_observations(monkeypatch):
    """Set the date of all plans, so that each observation belongs to the last plan."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1764547200")  # 2025-12-01


@pytest.fixture(scope="module")
def stars():
    sky = rs.synthetic_catalog("poisson", "120.3 30.3", 1.8 * u.deg, density=60 / u.deg**2, rng=1)
    rng = np.random.default_rng(2)
    return rs.Catalog(sky.coord, priority=rng.integers(1, 3, len(sky)), visits=rng.integers(1, 3, len(sky)))


def observe(survey, tile, date, failed=(), fraction=1.0):
    """Record an observation of a tile, in which the given positioners fail if they have a target."""
    used = {*np.asarray(survey.tile(tile)["positioner"]).tolist()} & {*failed}
    survey.record(Table({"tile": [tile], "date": [date], "fraction": [fraction]}))
    if used:
        survey.record(Table({"tile": [tile] * len(used), "date": [date] * len(used), "positioner": sorted(used)}))


def live(plan, stars, failed):
    """Plan a survey, record three nights, plan the rest after each night, and return the last plan and its state."""
    survey = plan()
    observe(survey, 1, "2026-01-03", failed[1][-1])
    observe(survey, 4, "2026-01-03", fraction=0.5)
    observe(survey, 3, "2026-01-03", fraction=0.0)
    survey = plan(survey)
    observe(survey, 0, "2026-01-04", failed.get(0, [()])[-1])
    dropped = [5, *range(20, 600, 20)]
    table = Table({"target": [10**6, *dropped], "state": ["added", *["dropped"] * len(dropped)]})
    for name, value in {"ra": 120.3, "dec": 30.3, "priority": 5}.items():
        table[name] = [value, *[np.nan] * len(dropped)]
    survey.record(table)
    fewer = [*range(1, 600, 3)]  # some of these targets were observed twice
    survey.record(Table({"target": fewer, "visits": [1] * len(fewer)}))
    survey = plan(survey)
    observe(survey, 4, "2026-01-05", failed[4][-1])
    return plan(survey)


def live_and_correct(plan, stars, failed):
    """Plan a survey whose observations are completed and corrected after the rest was planned."""
    survey = plan()
    observe(survey, 1, "2026-01-03", failed[1][0])
    observe(survey, 4, "2026-01-03", fraction=0.5)
    survey = plan(survey)
    observe(survey, 0, "2026-01-04")
    observe(survey, 1, "2026-01-03", failed[1][-1])  # these failures are reported late
    survey = plan(survey)
    survey.record(Table({"tile": [0, 3], "date": ["2026-01-04", ""], "state": ["bad", "dropped"]}))
    survey = plan(survey)
    observe(survey, 2, "2026-01-05")
    return plan(survey)


def plans_of(state: SurveyState, allocator: rs.AllocationOptions) -> list[Generation]:
    def prepare(state):
        usual = {"passes": None, "epoch": None, "lost_in_collision": True, "executor": None}
        return prepare_request(state.catalog, INSTRUMENT, TILES, visits=state, allocator=allocator, **usual)

    return generations_of(state, prepare)


def drawn(generations: list[Generation], seed: int) -> dict[int, list[list[str]]]:
    """Return the positioners that fail in each observed tile of a realization, for each time in the order of reports.

    All reports on a tile add failures, so that the first of them is the shortest.
    """
    failed = {}
    for generation in generations:
        ids = generation.request.instrument.focal_plane.id
        for row, failures in generation.observed.items():
            fails = dict(zip(failures.rates, failures.draw((seed,))[:, 0], strict=True))
            assert row not in failed
            failed[row] = [ids[fails[names]].tolist() for names in sorted(fails, key=len)]
    return failed


def compare(life, stars, tmp_path, allocator, failed, rule=None, n=2, **options):
    """Compare realizations with surveys of the same seeds in which the positioners fail that the realizations draw.

    ``failed`` are the positioners that fail in the survey, for each tile and each time at which they are reported.
    Return the survey, its state and the realizations.
    """

    def repeat(folder, seed, subpriority, failed):
        asked = rs.AllocationOptions(allocator, subpriority=subpriority, **options)

        def plan(survey=None):
            given = {"visits": rule} if survey is None else {"visits": survey.state(stars, rule=rule), "resume": True}
            return rs.plan_survey(stars, INSTRUMENT, TILES, allocator=asked, folder=folder, rng=seed, **given)

        return life(plan, stars, failed)

    survey = repeat(tmp_path / "survey", 0, 1, failed)
    state = survey.state(stars, rule=rule)
    asked = rs.AllocationOptions(allocator, **options)
    found = rs.selection_probabilities(state, INSTRUMENT, TILES, n, allocator=asked)
    generations = plans_of(state, asked)
    for r, seed in enumerate(found.realizations["seed"].tolist()):
        own = repeat(tmp_path / f"{r}", seed, seed, drawn(generations, seed))
        np.testing.assert_array_equal(found.observed_in(r), np.asarray(own.outcomes["observed"]) > 0)
        assert found.realizations["n_observed"][r] == own.summary["n_visits_observed"]
    return survey, state, found


@pytest.mark.filterwarnings("ignore:rng has no effect")
@pytest.mark.parametrize("allocator", ["nearest", "repair"])
def test_observations_that_were_corrected_are_repeated_as_they_were_known(stars, tmp_path, allocator):
    """Regression: realizations omitted partly observed tiles, plans after which an observation was corrected, and the
    order in which failures were reported."""
    names = rs.plan_tile(stars, INSTRUMENT, center=TILES[0]).table["id"].tolist()
    survey, state, found = compare(live_and_correct, stars, tmp_path, allocator, {1: [names[::6], names[::3]]})
    assert len(state.kept[1].failed) > 20
    assert len(state.begun) == 1
    kept = [0, 1, 2, 4]  # the last tile was dropped
    reached = rs.selection.potential_assignments(stars, INSTRUMENT, TILES, survey=survey)
    assert len(reached) == found.summary["n_tiles"] == 4
    alone = rs.selection.potential_assignments(stars, INSTRUMENT, TILES[kept]).n_tiles()
    np.testing.assert_array_equal(found.table["n_tiles"], alone)
    assert (reached.n_tiles() <= alone).all()


@pytest.mark.few(3)
@pytest.mark.filterwarnings("ignore:rng has no effect")
@pytest.mark.parametrize("allocator", ["nearest", "balanced", "lamost_rule", "repair"])
def test_each_realization_repeats_the_observations(stars, tmp_path, allocator):
    """The tiles that were observed are observed in each realization with its own plans and failures."""
    names = rs.plan_tile(stars, INSTRUMENT, center=TILES[0]).table["id"].tolist()
    _, state, found = compare(live, stars, tmp_path, allocator, {row: [names[::7]] for row in (1, 4)})
    assert state.kept[1].failed
    assert state.kept[4].failed
    assert (found.requested[5], found.requested[-1]) == (0, 1)


@pytest.mark.filterwarnings("ignore:rng has no effect", "ignore:.*requirement", "ignore:required targets")
@pytest.mark.parametrize(
    ("allocator", "kinds"),
    [
        ("nearest", ["science", "standard", "sky"]),
        *((name, ["science", "science+standard", "sky"]) for name in ("lamost_rule", "repair")),
    ],
)
@one_or_two
def test_visits_to_standards_are_not_counted(stars, tmp_path, allocator, kinds, n):
    """Regression: the numbers of visits to science targets counted those to standards in tiles that were observed."""
    kind = np.random.default_rng(3).choice(kinds, len(stars), p=[0.6, 0.3, 0.1])
    targets = rs.Catalog(stars.coord, priority=stars.priority, visits=stars.visits, kind=kind)
    more = {"required": targets.id[::10]} if allocator == "nearest" else {"requirements": ["standard=5", "sky=5"]}
    compare(live, targets, tmp_path, allocator, {1: [()], 4: [()]}, n=n, **more)


RULES = [VisitRule(after_success=3), VisitRule(retries=0), VisitRule(visits=2, after_success=4, retries=1)]
CASES = [(0, "nearest", live), (1, "repair", live), (1, "lamost_rule", live_and_correct), (2, "nearest", live)]


@pytest.mark.filterwarnings(
    "ignore:rng has no effect", "ignore:.*requirement", "ignore:required targets", "ignore:the first plan"
)
@pytest.mark.parametrize(("rule", "allocator", "life"), CASES)
@one_or_two
def test_rules_are_applied_to_the_visits_of_each_realization(stars, tmp_path, rule, allocator, life, n):
    """Some targets have no requested visits, some of these are required, and some have several roles."""
    rng, m = np.random.default_rng(3), len(stars)
    kind = rng.choice(["science", "science+standard", "standard", "sky"], m, p=[0.6, 0.2, 0.1, 0.1])
    targets = rs.Catalog(stars.coord, priority=stars.priority, visits=rng.integers(0, 3, m), kind=kind)
    names = rs.plan_tile(stars, INSTRUMENT, center=TILES[0]).table["id"].tolist()
    more = {"required": targets.id[::7]}
    more |= {} if allocator == "nearest" else {"requirements": ["standard=5", "sky=5"]}
    failed = {row: [[], names[::2]] for row in (0, 1, 4)}
    survey, state, _ = compare(life, targets, tmp_path, allocator, failed, RULES[rule], n=n, **more)
    assert (state.left != survey.state(targets).left).sum() > 10


def test_rules_with_a_table_or_a_function_are_refused(stars, tmp_path):
    options = rs.AllocationOptions("nearest", subpriority=1)
    survey = rs.plan_survey(stars, INSTRUMENT, TILES[:1], allocator=options, folder=tmp_path / "survey")
    for name, rule in {
        "table": VisitRule(retries=1, table=Table({"observed": [1], "visits": [3]})),
        "function": VisitRule(function=lambda table: {"visits": table["requested"]}),
    }.items():
        state = survey.state(stars, rule=rule)
        with pytest.raises(rs.InputError, match=f"without a table and without a function, got a {name}"):
            rs.selection_probabilities(state, INSTRUMENT, TILES[:1], 2, allocator="nearest")
