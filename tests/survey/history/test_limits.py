"""Targets of opportunity in random histories: what may be observed is counted again from the files of all tiles."""

import shutil
from datetime import date, timedelta

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable, Table
from astropy.time import Time
from living import CENTER, content, events, instrument, targets

import rfpsurvey as rs
from rfpsurvey._survey.joint import exposures

FIRST = date(2026, 1, 3)
JOINT = {name: rs.JointOptions(objective=name, iterations=2, patch_size=60) for name in ("visits", "finished")}
ALLOCATORS = {"optimal": "optimal", **JOINT, "large": JOINT["finished"]}
pytestmark = pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")


def day(number: int) -> str:
    return str(FIRST + timedelta(days=number))


def dated_tiles(rng, n: int, *, same: bool) -> QTable:
    """Return overlapping tiles, one per night at 5 h UTC in random order, of which the first two can be equal."""
    x, y = rng.uniform(-0.15, 0.15, (2, n)) * u.deg
    x[1], y[1] = (x[0], y[0]) if same else (x[1], y[1])
    places = CENTER.spherical_offsets_by(x, y)
    nights = rng.permutation(n)
    table = QTable({"tile": 11 + np.arange(n), "ra": places.ra, "dec": places.dec, "pass": 1 + np.arange(n) % 2})
    table["mjd"] = Time(str(FIRST)).mjd + nights + 5 / 24
    return table


def place_in(center, positioner: int):
    """Return a position 8 mm from the center of a positioner, whose reach is 16.5 mm, with 200 mm per degree."""
    x, y = instrument().focal_plane.arrays.xy[positioner]
    return center.spherical_offsets_by(((x + 8) / 200) * u.deg, (y / 200) * u.deg)


class Naive:
    """What a reader of the recorded tables knows: the tiles that were observed, and the limits of each added target."""

    def __init__(self, tiles):
        self.day = dict(zip(tiles["tile"].tolist(), tiles["mjd"].tolist(), strict=True))
        self.wanted, self.closed, self.made, self.last = {}, set(), {}, ""

    def allows(self, target: int, tile: int) -> bool:
        only, until = self.wanted[target]
        if until and (self.last > until or self.day[tile] >= Time(until).mjd + 1):
            return False
        return only in (None, tile)

    def is_over(self, target: int) -> bool:
        return not any(self.allows(target, tile) for tile in self.day if tile not in self.closed)

    def observe(self, survey, tile: int, night: str, rng) -> None:
        """Record that a tile was observed, and that some visits failed, but never that of the target 5000."""
        visits = survey.tile(tile)
        visits = visits[visits["observed"]]
        failed = (rng.random(len(visits)) < 0.2) & (visits["target_id"] != 5000)
        names = ["", *visits["positioner"][failed].tolist()]
        survey.record(events(tile=tile, date=night, state=["done", *[""] * (len(names) - 1)], positioner=names))
        self.closed.add(tile)
        self.last = night
        for name in visits["target_id"][~failed].tolist():
            self.made[name] = self.made.get(name, 0) + 1


def check(survey, naive, top=None) -> int:
    """Compare a plan with the limits; return the number of planned visits of targets of opportunity."""
    assert len(rs.survey.verify_survey(survey.folder)) == 0
    n_planned = 0
    for tile in (tile for tile in naive.day if tile not in naive.closed):
        visits = survey.tile(tile)
        for name in visits["target_id"][visits["observed"]].tolist():
            if name in naive.wanted:
                assert naive.allows(name, tile)
                n_planned += 1
        if top is not None and naive.wanted[top][0] == tile and not naive.made.get(top):
            assert top in visits["target_id"][visits["observed"]]
    state = survey.state()
    table, expired = state.table, 0
    assert state.summary["n_visits_expired"] == table["expired"].sum()
    for row in table[np.isin(table["target_id"], [*naive.wanted])]:
        name = int(row["target_id"])
        made, (only, until) = naive.made.get(name, 0), naive.wanted[name]
        assert (row["only_tile"], row["until"]) == ("" if only is None else str(only), until)
        assert row["observed"] == made
        assert row["expired"] == int(made == 0 and naive.is_over(name))
        assert row["requested"] == 1 - row["expired"]
        expired += row["expired"]
    status = survey.status()
    assert status.meta["is_planned"]
    assert status["n_expired"][0] == expired
    assert (status["n_left"] == status["n_requested"] - status["n_observed"]).all()
    parts = status["n_planned"] + status["n_not_assigned"] + status["n_lost"] + status["n_impossible"]
    assert (status["n_left"] == parts).all()
    assert not (table["expired"][~np.isin(table["target_id"], [*naive.wanted])]).any()
    return n_planned


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.exhaustive) for k in range(1, 15))])
@pytest.mark.parametrize("name", ALLOCATORS)
def test_targets_of_opportunity_are_observed_only_where_they_are_wanted(seed, name, tmp_path, monkeypatch):
    if name == "large":  # the search is limited to chosen targets
        monkeypatch.setattr(exposures, "MOST_PAIRS", 0)
    rng, n = np.random.default_rng([seed, 7]), 5
    sky, tiles = targets(seed, n=40), dated_tiles(rng, n, same=seed % 2 == 0)
    sky = rs.Catalog(sky.coord, id=sky.id, priority=sky.priority if seed % 3 else None)
    centers = rs.Tiling.from_table(tiles).coord
    folder = tmp_path / "plan"
    survey = rs.plan_survey(sky, instrument(), rs.Tiling.from_table(tiles), allocator=ALLOCATORS[name], folder=folder)
    naive, order = Naive(tiles), [*rng.permutation([2, 3, 4]).tolist(), 0, 1]
    names = tiles["tile"].tolist()
    naive.observe(survey, names[order[0]], day(0), rng)
    rows = []
    for k in range(8):  # the tile of the most important target is observed at the end
        row = {0: order[-1], 3: order[2]}.get(k, order[rng.integers(1, n)])
        only = names[row] if k % 3 == 0 else None
        latest = Time(tiles["mjd"][row], format="mjd").isot[:10]
        until = max(latest, day(int(rng.integers(n)))) if k % 3 or (k and rng.random() < 0.5) else ""
        place = place_in(centers[row], int(rng.integers(7)))
        naive.wanted[5000 + k] = only, until
        rows.append((5000 + k, "added", place.ra.deg, place.dec.deg, 1000 - k, str(only or ""), until))
    survey.record(Table(rows=rows, names=["target", "state", "ra", "dec", "priority", "tile", "until"]))
    survey = survey.replan()
    n_planned = check(survey, naive, top=5000)
    for number, row in enumerate(order[1:], 1):
        state = {1: rng.choice(["done", "bad"]), 2: "dropped"}.get(number, "done")
        if state == "done":
            naive.observe(survey, names[row], day(number), rng)
        else:
            survey.record(events(tile=names[row], date=day(number) if state == "bad" else "", state=str(state)))
            naive.last = day(number) if state == "bad" else naive.last
            naive.closed |= {names[row]} if state == "dropped" else set()
        survey = survey.replan()
        check(survey, naive, top=5000)
    assert n_planned > 0
    assert naive.made[5000] == 1


def added(**columns) -> Table:
    """Return a table that adds the target 5000 in the center of the field."""
    columns = {"target": 5000, "state": "added", "ra": CENTER.ra.deg, "dec": CENTER.dec.deg, "priority": 9.0, **columns}
    return events(**{name: value for name, value in columns.items() if value is not None})


@pytest.fixture(scope="module")
def dated(tmp_path_factory):
    """Return the folder of a survey of tiles 11 to 16, one per night, of which three are not planned any more."""
    tiles, folder = dated_tiles(np.random.default_rng(0), 6, same=False), tmp_path_factory.mktemp("dated") / "plan"
    tiles["mjd"] = Time(str(FIRST)).mjd + np.arange(6) + 5 / 24
    rs.plan_survey(targets(), instrument(), rs.Tiling.from_table(tiles), allocator="nearest", folder=folder)
    states = {"tile": [11, 12, 13], "date": [day(0), day(1), day(1)], "state": ["done", "partly", "dropped"]}
    rs.Survey.read(folder).record(Table(states))
    return folder


@pytest.fixture
def survey(dated, tmp_path):
    """Return this survey in a folder of its own."""
    return rs.Survey.read(shutil.copytree(dated, tmp_path / "survey"))


LATE = "until must be a date before whose end a tile can still observe the target, got {} for target 5000; the last rec"
STATED = (
    "a table that adds targets for single tiles must have a target and the state added in each row, got another row 1"
)
REFUSED = [
    (added(tile=99), "tile must be a tile of the survey, such as 11, got '99'"),
    (added(tile=11), "tile must be a tile that is not yet observed, got tile 11, which is observed"),
    (added(tile=12), "tile must be a tile that is not yet observed, got tile 12, which is partly observed"),
    (added(tile=13), "tile must be a tile that is not yet observed, got tile 13, which is dropped"),
    (added(tile=16, until=day(4)), LATE.format(day(4))),
    (added(until="2020-01-01"), LATE.format("2020-01-01")),
    (added(until=day(0)), LATE.format(day(0))),
    (added(until=day(2)), LATE.format(day(2))),  # the tiles until this date are partly observed or dropped
    (added(until="someday"), "until must be a date such as 2026-01-03, got 'someday'"),
    (added(tile=14, visits=2), "visits must be at most 1 for a target of a single tile, got 2 for target 5000"),
    (added(tile=14, kind="sky"), "tile and until must be given only for science targets, got target 5000"),
    (added(tile=14, target=1003), "tile and until must be given only for added targets, got target 1003"),
    (events(target=1003, until=day(9)), "tile and until must be given only for added targets, got target 1003"),
    (added(tile=14, target=[5000, 5001], state=["added", ""]), STATED),
]


@pytest.mark.parametrize(("table", "sentence"), REFUSED)
def test_limits_that_no_tile_can_meet_are_refused(survey, table, sentence):
    before = content(survey.folder)
    with pytest.raises(rs.InputError) as caught:
        survey.record(table)
    assert str(caught.value).startswith(sentence)
    assert content(survey.folder) == before


def test_dates_need_tiles_with_times(case, tmp_path):
    survey = rs.plan_survey(*case, allocator="nearest", folder=tmp_path / "plan")
    with pytest.raises(rs.InputError, match="until must be given only for targets of a survey whose tiles have times"):
        survey.record(added(until=day(9)))
    survey.record(added(tile=14))
    assert 5000 in survey.replan().tile(14)["target_id"].tolist()


def test_cadences_have_their_own_windows(case, tmp_path):
    tiles = dated_tiles(np.random.default_rng(0), 3, same=False)
    sky = rs.Catalog(case[0].coord, extra=QTable({"cadence": ["once"] * len(case[0])}))
    once = rs.survey.Cadences(Table({"cadence": ["once"], "delta_min": ["0"], "delta_max": ["0"], "n_exp": ["1"]}))
    survey = rs.plan_survey(sky, case[1], rs.Tiling.from_table(tiles), visits=once, folder=tmp_path / "plan")
    with pytest.raises(
        rs.InputError, match="tile and until must be given only for targets of a survey without cadence"
    ):
        survey.record(added(tile=11, priority=None, cadence="once"))


def test_limits_change_and_are_undone(survey):
    """The last recorded date counts, a repeated record changes nothing, and an undone record drops its target."""
    table = added(until=day(3))
    survey.record(table)
    assert survey.record(table)["n_known"] == 1
    survey.record(events(target=5000, until=day(5)))
    assert survey.state().limits.until.tolist() == [day(5)]
    with pytest.raises(rs.InputError, match="visits must be at most 1 for a target of a single tile, got 2"):
        survey.record(added(tile=15, visits=2))
    survey.record(added(tile=15))
    row = survey.state(targets()).table[-1]
    assert (row["only_tile"], row["until"], row["requested"]) == ("15", day(5), 1)
    survey = survey.replan()
    assert [tile for tile in (14, 15, 16) if 5000 in survey.tile(tile)["target_id"].tolist()] == [15]
    for number in (4, 3, 2):
        survey.undo(number)
    assert survey.state().table["requested"][-1] == 0
    assert survey.replan().status()["n_expired"][0] == 0


def test_limits_have_the_date_of_their_table(survey):
    survey.record(added(until=day(3), date=day(1)))
    survey.record(events(target=5000, until=day(5), date=day(2)))
    assert [survey.state(until=day(k)).limits.until.tolist() for k in (1, 2)] == [[day(3)], [day(5)]]
    assert survey.state(until=day(0)).limits is None


def test_a_rule_requests_one_visit_of_a_target_of_a_single_tile(survey):
    survey.record(Table({"target": [5000, 5001], "state": ["added"] * 2, "ra": [120.0] * 2, "dec": [30.0] * 2}
                        | {"priority": [9.0] * 2, "tile": ["14", ""]}))  # fmt: skip
    state = survey.state(rule=rs.survey.VisitRule(visits=3))
    assert state.requested[-2:].tolist() == [1, 3]


@pytest.mark.few(2)
@pytest.mark.parametrize("seed", range(20))
def test_realizations_observe_targets_of_opportunity_only_where_they_are_wanted(seed, tmp_path):
    """Realizations are surveys in which the same tables are recorded; some targets expire after they were observed."""
    name = ("nearest", "lamost_rule", "repair", "optimal")[seed % 4]

    def live(folder, subpriority):
        rng = np.random.default_rng([seed, 9])
        tiles, asked = dated_tiles(rng, 5, same=True), rs.AllocationOptions(name, subpriority=subpriority)
        given = {"allocator": asked, "folder": folder}
        survey = rs.plan_survey(targets(seed, n=40), instrument(), rs.Tiling.from_table(tiles), **given)
        order = np.argsort(tiles["mjd"]).tolist()
        rows = []
        for k in range(30):  # the targets are as important as others, so that they are not observed in all realizations
            tile = order[rng.integers(1, 5)]
            place = CENTER.spherical_offsets_by(*(rng.uniform(-0.2, 0.2, 2) * u.deg))
            only, until = (str(tiles["tile"][tile]), "") if k % 3 == 0 else ("", day(int(rng.integers(2, 5))))
            rows.append((5000 + k, "added", place.ra.deg, place.dec.deg, 2, 1 + k % 2 * (k % 3 > 0), only, until))
        names = ["target", "state", "ra", "dec", "priority", "visits", "tile", "until"]
        for number in range(3):
            tile = tiles["tile"][order[number]]
            survey.record(events(tile=tile, date=day(number), state="done", generation=number + 1))
            if number == 0:
                survey.record(Table(rows=rows, names=names))
            survey = survey.replan()
        return survey

    survey = live(tmp_path / "plan", 1)
    found = survey.select(3)
    for r, one in enumerate(found.realizations["seed"].tolist()):
        own = live(tmp_path / f"{r}", one)
        np.testing.assert_array_equal(found.observed_in(r), np.asarray(own.outcomes["observed"]) > 0)
        assert found.realizations["n_observed"][r] == own.summary["n_visits_observed"]
    assert 0 < found.n_observed[-30:].sum() < 90
    np.testing.assert_array_equal(found.requested[-30:], [1 + k % 2 * (k % 3 > 0) for k in range(30)])


def test_a_column_of_the_catalog_remains_one(case, tmp_path):
    sky = rs.Catalog(case[0].coord, priority=case[0].priority, extra=QTable({"until": np.arange(60.0)}))
    survey = rs.plan_survey(sky, *case[1:], allocator="nearest", folder=tmp_path / "plan")
    with pytest.warns(rs.RfpsurveyWarning, match="the column 'until' is a column of the catalog"):
        survey.record(added(until=7.0))
    assert survey.state().catalog.extra["until"][-1] == 7
    assert survey.state().limits is None


@pytest.mark.parametrize("allocator", ["nearest", JOINT["finished"]])
def test_a_partly_observed_tile_keeps_targets_whose_date_has_passed(case, allocator, tmp_path):
    """The visit of the target expires, but it counts when the tile is finished after all."""
    tiles = dated_tiles(np.random.default_rng(0), 3, same=False)
    tiles["mjd"] = Time(str(FIRST)).mjd + np.arange(3) + 5 / 24
    options = {"allocator": allocator, "folder": tmp_path / "plan"}
    survey = rs.plan_survey(targets(), instrument(), rs.Tiling.from_table(tiles), **options)
    place = place_in(rs.Tiling.from_table(tiles).coord[0], 3)
    survey.record(added(ra=place.ra.deg, dec=place.dec.deg, priority=99.0, until=day(0)))
    survey = survey.replan()
    plan = survey.tile(11)
    assert 5000 in plan["target_id"][plan["observed"]].tolist()
    survey.record(events(tile=[11, 12], date=[day(0), day(1)], state=["partly", "done"]))
    survey = survey.replan()
    assert (survey.tile(11) == plan).all()
    row = survey.state().table[-1]
    assert (row["requested"], row["observed"], row["expired"]) == (0, 0, 1)
    survey.record(events(tile=11, date=day(2)))
    survey = survey.replan()
    row = survey.state().table[-1]
    assert (row["requested"], row["observed"], row["expired"]) == (1, 1, 0)
    assert len(rs.survey.verify_survey(survey.folder)) == 0
