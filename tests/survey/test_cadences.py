"""Surveys with cadences: visits in windows of time, compared with a second implementation."""

import warnings
from concurrent.futures import ThreadPoolExecutor

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from astropy.time import Time
from cadence_program import plan, scene, with_columns
from living import CENTER, content, instrument
from naive_cadences import TABLE, Naive

import rfpsurvey as rs
from rfpsurvey.survey import Cadences


@pytest.mark.parametrize("allocator", ["nearest", "repair", "optimal", "joint"])
@pytest.mark.parametrize("seed", [1, *(pytest.param(k, marks=pytest.mark.exhaustive) for k in range(2, 8))])
def test_every_visit_is_in_an_open_window(allocator, seed):
    """Each visit is allowed, each tile reaches no open target that a free fiber could observe, and all sums agree."""
    catalog, tiling = scene(seed)
    survey = plan(catalog, tiling, allocator=allocator)
    targets = [Naive(str(name)) for name in catalog.extra["cadence"]]
    days, brightness = np.asarray(tiling.table["mjd"]), np.asarray(tiling.table["skybrightness"])
    n_open, n_all = [], 0
    for tile in np.argsort(days).tolist():
        visits = survey._visits(tile)
        rows = np.asarray(visits["target_row"])
        allowed = [one.allows(days[tile], brightness[tile])[0] for one in targets]
        assert all(allowed[row] for row in rows), tile
        field = survey.tiles["n_in_field"][tile]
        apart = catalog.coord.separation(SkyCoord(tiling.table["ra"][tile], tiling.table["dec"][tile]))
        assert field == sum(np.array(allowed) & (apart <= instrument().field_radius))
        for row, observed in zip(rows, np.asarray(visits["observed"]), strict=True):
            if observed:
                targets[row].observe(days[tile])
                n_all += 1
        n_open.append(sum(allowed))
    done = np.array([sum(int(one.epochs[k][2]) for k in range(len(one.starts))) for one in targets])
    assert (survey.outcomes["observed"] == done).all()
    assert (survey.outcomes["n_epochs"] == [len(one.starts) for one in targets]).all()
    assert (survey.outcomes["released"] == [one.is_released(days.max()) for one in targets]).all()
    assert survey.summary["n_released"] == survey.outcomes["released"].sum()
    assert survey.summary["n_visits_observed"] == done.sum() == survey.tiles["n_observed"].sum() <= n_all
    assert survey.summary["n_complete"] == (done == survey.outcomes["requested"]).sum()
    assert (survey.outcomes["requested"] == [int(sum(e[2] for e in one.epochs)) for one in targets]).all()


def test_the_window_that_closes_first_has_precedence():
    """With one fiber, the choice of every tile is known."""
    robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    one = rs.Instrument("one", rs.FocalPlane([[0, 0]] * u.mm, robot), plate_scale=200 * u.mm / u.deg)
    names = ["twice", "thrice", "twice", "dark"]
    sky = SkyCoord(120 + np.array([0.01, 0.02, -0.02, 0.03]), [30.0] * 4, unit="deg")
    catalog = rs.Catalog(sky, id=np.arange(4), extra=QTable({"cadence": names}))
    days = 60000.0 + np.array([0, 1, 2, 3.5, 4.5, 5, 9])
    table = QTable({"tile": np.arange(7), "ra": [120.0] * 7 * u.deg, "dec": [30.0] * 7 * u.deg, "mjd": days})
    table["skybrightness"] = 0.3
    table["position_angle"] = np.arange(7) * u.deg
    survey = plan(catalog, rs.Tiling.from_table(table), one)
    targets, expected = [Naive(name) for name in names], []
    for tile, day in enumerate(days.tolist()):
        found = [(closes, k) for k, t in enumerate(targets) for ok, closes in [t.allows(day, 0.3)] if ok]
        row = int(survey._visits(tile)["target_row"][0])
        assert min(found)[0] == next(closes for closes, k in found if k == row)
        targets[row].observe(day)
        expected.append(row)
    assert len(set(expected)) > 2


def test_other_orders_workers_and_interruptions(tmp_path):
    catalog, tiling = scene(5)
    first = plan(catalog, tiling, folder=tmp_path / "a")
    with ThreadPoolExecutor(2) as executor:
        plan(catalog, tiling, folder=tmp_path / "b", executor=executor)
    assert content(tmp_path / "a") == content(tmp_path / "b")
    for name in ("tiles.fits", "completeness.ecsv", "outcomes.fits", *(f"tiles/000/{k:06d}.fits" for k in (3, 9))):
        (tmp_path / "b" / name).unlink()
    with pytest.warns(rs.RfpsurveyWarning, match="is planned again"):
        plan(catalog, tiling, folder=tmp_path / "b", resume=True)
    assert content(tmp_path / "a") == content(tmp_path / "b")
    order = np.random.default_rng(3).permutation(len(tiling))
    again = plan(catalog, rs.Tiling(tiling.table[order]))
    assert (again.outcomes["observed"] == first.outcomes["observed"]).all()
    with pytest.raises(rs.InputError, match="cadences"):
        plan(catalog, tiling, folder=tmp_path / "b", resume=True, visits=TABLE[::-1])
    with pytest.raises(rs.InputError, match="visits must be the Cadences of the survey in .*, got None"):
        first.state(catalog)


LAST = ["1 1", "2 2", "1 2 1", "1 1"]
WRONG = {
    "delta_max of cadence 'twice' must be at least delta_min": {"delta_max": ["0", "0 2", "0 30", "0 4 9", "0 -1"]},
    "the columns of cadence 'twice' must have one value per epoch": {"n_exp": ["1", "1", "2 2", "1 2 1", "1 1"]},
    "n_exp of cadence 'once' must be whole numbers from 1": {"n_exp": ["0", *LAST]},
    "a cadence of targets must have at most 255 exposures, got 300 in 'once'": {"n_exp": ["300", *LAST]},
    "n_epochs of cadence 'thrice' must be a whole number from 0, got '2.5'": {"n_epochs": [1, 2, 2, 2.5, 2]},
    "columns of cadence 'twice' must have one value per epoch": {"n_epochs": [1, 3, 2, 3, 2]},
    "n_exp of cadence 'once' must be numbers, got 'x'": {"n_exp": ["x", *LAST]},
    "delta_min of cadence 'once' must be finite numbers": {"delta_min": ["nan", "0 3", "0 2", "0 1 5", "0 -1"]},
    "the name of a cadence must be unique, got 2 rows for": {"cadence": ["once", "once", "pairs", "thrice", "dark"]},
    "a table of cadences must have one of the columns nexp and n_exp, got both": {"NEXP": ["1"] * 5},
}


def test_bad_cadences():
    wrong = {message: Table(TABLE, copy=True) for message in WRONG}
    for message, columns in WRONG.items():
        for name, value in columns.items():
            wrong[message][name] = value
    wrong["a table of cadences must have the column delta_max"] = TABLE["cadence", "delta_min"]
    wrong["the cadence of a target must be in the table of cadences, got"] = TABLE[:2]
    for message, table in wrong.items():
        with pytest.raises(rs.InputError, match=message):
            plan(*scene(1), visits=table)


def test_a_finished_survey_with_cadences_is_read_and_not_planned_again(tmp_path, monkeypatch):
    """Exposures of incomplete epochs do not count, so that each tile was read and prepared again."""
    survey = plan(*scene(1), folder=tmp_path / "survey")
    monkeypatch.setattr("rfpsurvey._survey.run.run_rounds", None)
    assert plan(*scene(1), folder=tmp_path / "survey", resume=True).summary == survey.summary


def padded(n_columns, upper):
    """Return the table of cadences in the layout of the files of SDSS-V, with a long cadence that no target has."""
    names = {"n_exp": "nexp"} if upper else {}
    values = {name: [text.split() for text in TABLE[name]] + [["1"] * n_columns] for name in TABLE.colnames[1:]}
    table = Table({"cadence": [*TABLE["cadence"], "long"], "nepochs": [len(row) for row in values["n_exp"]]})
    for name, rows in values.items():
        table[names.get(name, name)] = [[float(v) for v in row] + [0.0] * (n_columns - len(row)) for row in rows]
    table["nexp" if upper else "n_exp"][-1] = 8
    return Table(table, names=[name.upper() for name in table.colnames]) if upper else table


@pytest.mark.parametrize("upper", [False, True])
def test_cadences_in_the_layout_of_sdssv(tmp_path, upper):
    """Names in upper case, padded arrays, and a long cadence that no target has, were refused."""
    path = tmp_path / "rsCadences.fits"
    padded(174, upper).write(path)
    given, cadences = Cadences(TABLE), Cadences(path)
    assert cadences.names == [*given.names, "long"]
    for one, other in zip(given.epochs, [*cadences.epochs[:-2], cadences.epochs[-1]], strict=True):
        np.testing.assert_array_equal(one, other)
    catalog, tiling = scene(1)
    assert (given.visits(catalog) == cadences.visits(catalog)).all()
    for allocator in ("nearest", "joint"):
        plans = [plan(catalog, tiling, visits=v, allocator=allocator) for v in (given, cadences)]
        assert (plans[0].outcomes["observed"] == plans[1].outcomes["observed"]).all()
    long = rs.Catalog(catalog.coord[:1], extra=QTable({"cadence": ["long"]}))
    with pytest.raises(rs.InputError, match="at most 255 exposures, got 1392 in 'long'") as caught:
        cadences.visits(long)
    assert len(str(caught.value)) < 100


def test_bad_catalogs_and_tiles(tmp_path):
    catalog, tiling = scene(1)
    without = [name for name in tiling.table.colnames if name not in ("mjd", "skybrightness")]
    bare = rs.Tiling(tiling.table[without])
    unknown = np.where(np.arange(len(tiling)) == 3, np.nan, tiling.table["mjd"])
    for message, options in {
        "the catalog must have the column 'other'": {"visits": Cadences(TABLE, column="other")},
        "fixed must not be given for a joint plan with cadences": {"allocator": rs.JointOptions(fixed=tmp_path)},
        "tiles of a survey with cadences must have one of the columns time, date and mjd": {"tiling": bare},
        "must have the column skybrightness": {"tiling": rs.Tiling(tiling.table[[*without, "mjd"]])},
        "the mjd of every tile must be known, got 1 without": {"tiling": with_columns(tiling, mjd=unknown)},
        "the date of tiles must be times": {"tiling": with_columns(bare, date="soon")},
    }.items():
        with pytest.raises(rs.InputError, match=message):
            plan(catalog, **{"tiling": tiling, **options})


def test_the_cadences_of_sdssv(real_data):
    """All published cadences are read, and their targets need as many visits as the table states."""
    path = real_data("sdssv_rules/cadences.ecsv")
    cadences, table = Cadences(path), Table.read(path)
    assert len(cadences.names) == 243
    n = len(table)
    sky = SkyCoord(np.linspace(0, 10, n), np.zeros(n), unit="deg")
    catalog = rs.Catalog(sky, extra=QTable({"cadence": np.asarray(table["cadence"])}))
    expected = [0 if one is np.ma.masked else sum(map(int, one.split())) for one in table["n_exp"]]
    assert cadences.visits(catalog).tolist() == expected
    assert max(expected) > 20
    assert expected.count(0) == 2


def test_the_command(tmp_path, run):
    catalog, tiling = scene(2)
    table = Table({"id": catalog.id, "ra": catalog.coord.ra, "dec": catalog.coord.dec, "priority": catalog.priority})
    table["cadence"] = np.asarray(catalog.extra["cadence"])
    table.write(tmp_path / "targets.ecsv")
    TABLE.write(tmp_path / "cadences.ecsv")
    tiling.write(tmp_path / "tiles.ecsv")
    words = ["survey", tmp_path / "targets.ecsv", "--tiles", tmp_path / "tiles.ecsv", "--instrument", "moons"]
    words += ["--allocator", "nearest", "--set", f"cadences={tmp_path / 'cadences.ecsv'}", "--folder"]
    code, _, err = run(*words, tmp_path / "survey")
    assert code == 0, err
    survey = rs.Survey.read(tmp_path / "survey")
    own = plan(catalog, tiling, "moons")
    assert survey.summary["n_visits_observed"] == own.summary["n_visits_observed"] > 0
    code, _, err = run(*words, tmp_path / "other", "--set", "catalog.visits=2")
    assert code == 2
    assert "cadences must be used without catalog.visits" in err


def test_missing_values_of_tiles_and_other_units():
    """Regression: masked times and brightnesses were 0, text raised a ValueError, and hours were read as days."""
    catalog, tiling = scene(1)
    usual, days = plan(catalog, tiling).summary["n_visits_observed"], np.asarray(tiling.table["mjd"])
    is_third, ones = np.arange(len(days)) == 3, np.ones(len(days))
    for message, columns in (
        ("the mjd of every tile must be known, got 1 without", {"mjd": np.ma.array(days, mask=is_third)}),
        *(
            ("the skybrightness of every tile must be known, got 1 without", {"skybrightness": value})
            for value in (np.ma.array(ones, mask=is_third), np.where(is_third, np.nan, 1))
        ),
        ("the skybrightness of tiles must be numbers", {"skybrightness": np.full(len(days), "dark")}),
        ("the mjd of tiles must have the unit d, got mm", {"mjd": days * u.mm}),
        ("the skybrightness of tiles must have no unit, got mag", {"skybrightness": ones * u.mag}),
        ("must have one of the columns time, date and mjd, got mjd, date", {"date": "2026-01-03"}),
    ):
        with pytest.raises(rs.InputError, match=message):
            plan(catalog, with_columns(tiling, **columns))
    for name, value in (("mjd", (days * u.day).to(u.hour)), ("time", Time(days, format="mjd"))):
        others = tiling.table[[one for one in tiling.table.colnames if one != "mjd"]]
        found = plan(catalog, with_columns(rs.Tiling(others), **{name: value}))
        assert found.summary["n_visits_observed"] == usual


def test_another_brightness_is_another_survey(tmp_path):
    """Regression: a finished survey was planned again if only the brightness of its tiles had changed."""
    catalog, tiling = scene(1)
    plan(catalog, tiling, folder=tmp_path / "survey")
    before = content(tmp_path / "survey")
    with pytest.raises(rs.InputError, match="dates"):
        plan(catalog, with_columns(tiling, skybrightness=0.3), folder=tmp_path / "survey", resume=True)
    assert content(tmp_path / "survey") == before


def test_targets_whose_window_was_never_open_have_an_outcome():
    """Regression: the outcome of such targets was that they are in no field."""
    catalog, tiling = scene(1)
    catalog = rs.Catalog(catalog.coord, extra=QTable({"cadence": np.full(len(catalog), "dark")}))
    tiling = with_columns(tiling, skybrightness=1.0)
    with (
        pytest.warns(rs.RfpsurveyWarning, match="no target was observed"),
        pytest.warns(rs.RfpsurveyWarning, match=r"80 targets will not be observed, .* has exposures: dark$"),
    ):
        survey = plan(catalog, tiling)
    usual = plan(catalog, tiling, visits=1)
    assert survey.summary["n_visits_observed"] == 0
    for name in ("in no field", "out of reach"):
        assert survey.summary["outcomes"].get(name) == usual.summary["outcomes"].get(name)


@pytest.mark.parametrize("allocator", ["nearest", "lamost_rule", "repair", "network_flow", "optimal"])
def test_closing_windows_have_precedence_with_every_allocator(allocator):
    """Regression: windows that never close made the differences between all others too small for ``optimal``."""
    plane = rs.FocalPlane([[0, 0]] * u.mm, instrument().focal_plane.positioner)
    robot = rs.Instrument("one", plane, plate_scale=200 * u.mm / u.deg)
    sky = SkyCoord(120 + np.linspace(-0.03, 0.03, 9), np.full(9, 30.0), unit="deg")
    names = ["pairs", "twice", "once", "thrice", "twice", "once", "thrice", "once", "once"]
    table = Table({"cadence": ["once", "twice", "thrice", "pairs"], "delta_min": ["0", "0 1", "0 1", "0 1"]})
    table["delta_max"], table["n_exp"] = ["0", "0 60", "0 40", "0 -1"], ["1", "1 1", "1 1", "1 1"]
    catalog = rs.Catalog(sky, id=np.arange(9), extra=QTable({"cadence": names}))
    n = 12
    tiles = QTable({"ra": [120.0] * n * u.deg, "dec": [30.0] * n * u.deg, "pass": np.arange(n)})
    tiles["mjd"] = 60000.0 + 2 * np.arange(n)
    survey = plan(catalog, rs.Tiling.from_table(tiles), robot, table, allocator=allocator)
    starts = {}
    closes = {"once": np.inf, "twice": 60, "thrice": 40, "pairs": np.inf}
    done = {"once": 1, "twice": 2, "thrice": 2, "pairs": 2}
    visited = {k: [] for k in range(9)}
    for tile, day in enumerate(2 * np.arange(n)):
        row = int(survey._visits(tile)["target_row"][0])
        urgent = {k: start + closes[names[k]] for k, start in starts.items() if len(visited[k]) < done[names[k]]}
        best = min([*urgent.values(), np.inf])
        assert urgent.get(row, np.inf) == best
        visited[row].append(day)
        starts[row] = day


def test_surveys_with_cadences_refuse_what_does_not_support_them(tmp_path):
    """Regression: selection probabilities ignored cadences."""
    catalog, tiling = scene(1)
    survey = plan(catalog, tiling, folder=tmp_path / "survey")
    with pytest.raises(rs.InputError, match="catalog must be the state of a survey with cadences .*, got a catalog"):
        rs.selection_probabilities(catalog, instrument(), survey, 2, allocator="nearest")
    with pytest.raises(rs.InputError, match="added tiles of a survey with cadences must have times, .*, got 99"):
        survey.record([{"tile": 99, "state": "added", "ra": 120.1, "dec": 30.0}])
    assert not (tmp_path / "survey/events").exists()
    few = rs.Catalog(catalog.coord, visits=np.where(np.arange(len(catalog)) % 2, 0, 3), extra=catalog.extra)
    with pytest.warns(rs.RfpsurveyWarning, match="the visits of the catalog have no effect"):
        found = plan(few, tiling)
    assert (found.outcomes["requested"][1::2] == 0).all()
    assert (found.outcomes["observed"][1::2] == 0).all()


@pytest.mark.parametrize("allocator", ["optimal", "joint"])
def test_a_required_target_whose_number_of_visits_is_0_has_its_whole_cadence(allocator):
    """Regression: one visit of such a target was requested; its cadence was complete after one epoch, and joint plans
    ended with a traceback."""
    extra = QTable({"cadence": ["x"] * 2})
    points = CENTER.spherical_offsets_by([-0.06, 0.06] * u.deg, [0, 0] * u.deg)
    catalog = rs.Catalog(points, id=[1, 2], visits=[1, 0], extra=extra)
    cadences = Table({"cadence": ["x"], "delta_min": ["0 1"], "delta_max": ["0 2"], "n_exp": ["1 1"]})
    places = {"ra": [CENTER.ra.deg] * 3 * u.deg, "dec": [CENTER.dec.deg] * 3 * u.deg, "pass": [1, 2, 3]}
    tiling = rs.Tiling.from_table(QTable({**places, "mjd": [60000.0, 60001, 60002]}))
    asked = rs.AllocationOptions("optimal", required=[2])
    asked = rs.JointOptions(allocator=asked) if allocator == "joint" else asked
    survey = plan(catalog, tiling, visits=cadences, allocator=asked)
    for name in ("requested", "observed", "n_epochs"):
        assert survey.outcomes[name].tolist() == [2, 2]


def test_units_of_times_in_cadences():
    """Regression: times in hours were used as days."""
    columns = {"cadence": ["x"], "n_exp": np.array([[1, 1]])}
    times = {"delta_min": np.array([[0.0, 24.0]]) * u.hour, "delta_max": np.array([[0.0, 48.0]]) * u.hour}
    assert Cadences(QTable({**columns, **times})).epochs[0][:2].tolist() == [[0, 1], [0, 2]]
    times["delta_min"] = np.array([[0.0, 24.0]]) * u.mm
    with pytest.raises(rs.InputError, match="delta_min of cadences must have the unit d, got mm"):
        Cadences(QTable({**columns, **times}))


@pytest.mark.parametrize("seed", range(6))
def test_cadences_that_no_tile_can_begin_are_named(seed):
    """The warning names the cadences of which a target that all tiles reach would complete no epoch."""
    rng, table = np.random.default_rng(seed), Table(TABLE, copy=True)
    table["n_exp"] = [" ".join(map(str, rng.integers(1, 4, len(text.split())))) for text in TABLE["n_exp"]]
    table["skybrightness"] = [" ".join(map(str, rng.uniform(0, 1, len(text.split())))) for text in TABLE["n_exp"]]
    catalog, tiling = scene(seed, n=30, n_tiles=8)
    days, brightness = (np.asarray(tiling.table[name]) for name in ("mjd", "skybrightness"))
    names = set()
    for row, name in zip(table, table["cadence"], strict=True):
        n, limit = (float(row[column].split()[0]) for column in ("n_exp", "skybrightness"))
        nights = [[b for d, b in zip(days, brightness, strict=True) if 0 <= d - day <= 0.5] for day in days]
        if name in catalog.extra["cadence"] and not any(sum(b <= limit for b in night) >= n for night in nights):
            names.add(name)
    with warnings.catch_warnings(record=True) as issued:
        warnings.simplefilter("always")
        survey = plan(catalog, tiling, visits=table)
    texts = [str(w.message) for w in issued if "will not be observed" in str(w.message)]
    assert [{*text.split(": ")[-1].split(", ")} for text in texts] == [names] * bool(names)
    has_epochs = {*np.asarray(catalog.extra["cadence"])[np.asarray(survey.outcomes["n_epochs"]) > 0].tolist()}
    assert not has_epochs & names
    n = np.isin(catalog.extra["cadence"], [*names]).sum()
    assert not names or texts[0].startswith(f"{n} target")
