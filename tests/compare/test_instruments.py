import pickle
import shutil
import warnings
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.stats import binom_conf_interval
from astropy.table import QTable
from matplotlib.patches import Rectangle
from scipy.sparse.csgraph import maximum_bipartite_matching
from scipy.spatial import cKDTree
from shapely import MultiPoint, Point, contains_xy
from shapely.ops import unary_union

import rfpsurvey as rs
from rfpsurvey._field.constraints import project_field
from rfpsurvey._studies.compare_allocators import synthetic_fields
from rfpsurvey._studies.intervals import quantile, wilson
from rfpsurvey._studies.run import rate_interval
from rfpsurvey.plot._comparisons import draw_instruments

MM = u.mm
CENTER = SkyCoord(30 * u.deg, -10 * u.deg)


def design(name="mine", l1=8.0, l2=17.0, rings=4, pitch=25.0):
    plane = rs.FocalPlane.hexagonal(rs.Positioner(l1 * MM, l2 * MM, 2.5 * MM), rings=rings, pitch=pitch * MM)
    return rs.Instrument(name, plane, plate_scale=1 * MM / u.arcmin)


@pytest.fixture(scope="module")
def sky():
    return rs.synthetic_catalog(
        "clustered", CENTER, 2.5 * u.deg, density=15 / u.deg**2, cluster_size=5, cluster_scale=0.1 * u.deg, rng=2
    )


@pytest.fixture(scope="module")
def centers():
    return SkyCoord([29.5, 30.5] * u.deg, [-10, -10] * u.deg)


@pytest.fixture(scope="module")
def table(sky, centers):
    return rs.compare_instruments(sky, [design(), design("wide", 8.25, 8.25)], center=centers)


def row_of(table, instrument, allocator):
    (row,) = table[(table["instrument"] == instrument) & (table["allocator"] == allocator)]
    return row


@pytest.mark.parametrize("allocator", ["lamost_rule", "optimal"])
def test_the_rows_are_means_of_tiles(table, sky, centers, allocator):
    row, mine = row_of(table, "mine", allocator), design()
    tiles = [rs.plan_tile(sky, mine, center, allocator=allocator) for center in centers]
    summaries = [tile.summary for tile in tiles]
    usable = [np.sum((t.table["status"] == "assigned") & ~t.table["in_collision"]) for t in tiles]
    assert row["targets"] == np.mean([s["n_reachable"] for s in summaries])
    assert (row["assigned"], row["usable"]) == (np.mean([s["n_assigned"] for s in summaries]), np.mean(usable))
    # the arms have different lengths, so that positioners without a target are not counted
    sums = {name: sum(s[name] for s in summaries) for name in ("n_colliding", "n_colliding_pairs", "n_assigned")}
    assert row["probability"] == pytest.approx(sums["n_colliding"] / sums["n_assigned"])
    assert row["pairs_per_positioner"] == pytest.approx(sums["n_colliding_pairs"] / sums["n_assigned"])
    if allocator == "lamost_rule":
        assert 0 < row["low"] < row["probability"] < row["high"] < 1
    else:
        assert row["low"] == row["probability"] == row["high"] == row["gap"] == 0
    radius = 2 * np.sin(mine.field_radius.to_value(u.rad) / 2)
    assert row["usable_per_solid_angle"].to_value(u.sr**-1) == pytest.approx(np.mean(usable) / (np.pi * radius**2))
    area = 3 * np.sqrt(3) / 2 * (4 * 25.0) ** 2
    assert row["usable_per_area"].to_value(MM**-2) == pytest.approx(np.mean(usable) / area)


def test_the_loss_is_against_a_maximum_matching(table, sky, centers):
    mine = design()
    most = 0
    for center in centers:
        xy = mine.projection(center).to_focal_plane(sky)
        most += np.count_nonzero(maximum_bipartite_matching(mine.focal_plane.reachable(xy)) >= 0)
    for allocator in ("lamost_rule", "optimal"):
        row = row_of(table, "mine", allocator)
        assert row["loss"] == pytest.approx(1 - 2 * row["usable"] / most)
    assert 0 < row_of(table, "mine", "optimal")["loss"] < 0.2 < row_of(table, "mine", "lamost_rule")["loss"]


def test_parked_arms_count_where_arms_are_equal(table, sky, centers):
    wide = design("wide", 8.25, 8.25)
    tiles = [rs.plan_tile(sky, wide, center, allocator="lamost_rule").summary for center in centers]
    assert sum(t["n_parked"] for t in tiles) > 0
    counted = sum(t["n_assigned"] + t["n_parked"] for t in tiles)
    found = row_of(table, "wide", "lamost_rule")["probability"]
    assert found == pytest.approx(sum(t["n_colliding"] for t in tiles) / counted)


@pytest.mark.parametrize(("name", "kind"), [("moons", 3), ("desi", 2)])
def test_what_instruments_are(name, kind):
    found = rs.compare_instruments("uniform", [name], n_realizations=1, allocators="nearest")[0]
    plane = rs.Instrument.preset(name).focal_plane
    pitch = np.median(cKDTree(plane.xy.value).query(plane.xy.value, k=2)[0][:, 1])
    cell = np.sqrt(3) / 2 * pitch**2
    assert (found["positioners"], found["type"]) == (len(plane), kind)
    arms = plane.positioner.central_arm.value * plane.positioner.eccentric_arm.value
    # the footprint ends at the outermost centers, and some cells have no positioner
    assert found["multiplicity"] == pytest.approx(4 * np.pi * arms / cell, rel=0.06)
    assert found["footprint"].value == pytest.approx(len(plane) * cell, rel=0.1)
    assert sum(found[f"reach_{k}"] for k in range(4)) == pytest.approx(1)


@pytest.mark.exhaustive
def test_synthetic_skies_are_as_crowded_as_asked():
    mine, options = design(rings=6), {"n_realizations": 20, "allocators": "nearest", "rng": 3}
    reach = unary_union([Point(c).buffer(25.0, 64) - Point(c).buffer(9.0, 64) for c in mine.focal_plane.xy.value])
    for kind in ("uniform", "poisson"):
        found = rs.compare_instruments(kind, mine, targets_per_positioner=30.0, **options)
        expected = 30.0 * len(mine.focal_plane) / mine.focal_plane.footprint.value * reach.area
        assert found["targets"][0] == pytest.approx(expected, abs=5 * np.sqrt(expected / 20))
        assert "expected number of targets in the footprint, per positioner, is the same" in found.meta["comparable"]
    found = rs.compare_instruments("poisson", mine, density=2000 / u.deg**2, **options)
    expected = 2000 * reach.area / 3600
    assert found["targets"][0] == pytest.approx(expected, abs=5 * np.sqrt(expected / 20))
    assert found.meta["density_per_deg2"] == 2000


@pytest.mark.exhaustive
def test_workers_change_nothing_but_the_seconds():
    def table(**options):
        two = [design(rings=2), design("wide", 8.25, 8.25, rings=2)]
        found = rs.compare_instruments("poisson", two, n_realizations=2, **options)
        found.remove_column("seconds")
        return found

    alone = table(rng=5)
    with ThreadPoolExecutor(2) as pool:
        together = table(rng=5, executor=pool)
    for name in alone.colnames:
        np.testing.assert_array_equal(alone[name], together[name])
    assert (table(rng=6)["targets"] != alone["targets"]).any()


def test_an_instrument_has_the_same_skies_whatever_it_is_compared_with():
    options = {"n_realizations": 2, "allocators": "nearest", "rng": 3}
    alone = rs.compare_instruments("poisson", [design("wide", 8.25, 8.25)], **options)
    among = rs.compare_instruments("poisson", [design(), design("wide", 8.25, 8.25)], **options)
    for name in ("targets", "usable", "probability"):
        assert alone[name][0] == among[name][1]


@pytest.mark.parametrize("name", ["pfs", "sdss_apo"])
def test_the_footprint_holds_as_many_targets_as_asked_though_optics_distort(name):
    model = rs.Instrument.preset(name)
    each = 1e5 / len(model.focal_plane)
    (field,) = synthetic_fields("uniform", [model], None, each, None, 1, 3)
    xy = project_field(model, model.projection(field.center).plain, field.catalog.arrays.vectors)[0]
    hull = MultiPoint(model.focal_plane.xy.value).convex_hull
    inside = contains_xy(hull, *xy.T).sum()
    assert inside == pytest.approx(1e5, rel=0.008)  # three standard errors


class Copies(Executor):
    """An executor that copies the work and the tasks, as processes do."""

    def map(self, work, *tasks):
        work, tasks = pickle.dumps(work), [pickle.dumps(task) for task in zip(*tasks, strict=True)]
        return [pickle.loads(work)(*pickle.loads(task)) for task in tasks]


class Picky:
    """An allocator that accepts only one focal plane, and is not equal to its copies."""

    __hash__ = None

    def __call__(self, problem):
        assert len(problem.focal_plane) == 61
        return np.full(61, -1)


def test_allocators_that_are_objects():
    methods = [Picky(), "nearest"]
    options = {"n_realizations": 2, "executor": Copies()}
    found = rs.compare_instruments("poisson", design(), allocators=methods, **options)
    assert found["assigned"][0] == 0 < found["assigned"][1]


def test_what_cannot_be_compared_is_said_before_any_work_is_done():
    line = rs.FocalPlane([[0, 0], [50, 0], [100, 0]] * MM, design().focal_plane.positioner)
    flat = rs.Instrument("flat", line, plate_scale=1 * MM / u.arcmin)

    def never(problem):
        raise AssertionError

    with pytest.raises(rs.InputError, match="flat: the footprint must have at least three centers"):
        rs.compare_instruments("poisson", [design(), flat], allocators=[never])


def test_an_option_without_an_effect_is_warned_of_once():
    """Regression: the warning was repeated for each field and each allocator."""
    options = {"options": rs.AllocationOptions(sky_separation=10 * u.arcsec), "allocators": ["lamost_rule", "nearest"]}
    few = rs.synthetic_catalog("uniform", CENTER, 0.2 * u.deg, n_targets=200, rng=1)
    for compare, *given, more in (
        (rs.compare_instruments, "poisson", [design(), design("wide")], {"n_realizations": 2}),
        (rs.compare_allocators, few, "moons", CENTER, {}),
    ):
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            compare(*given, **options, **more)
        assert [str(one.message).partition(" because")[0] for one in told] == ["sky_separation has no effect"]


def test_the_interval_of_positioners_that_have_no_neighbors_is_that_of_independent_trials():
    plane = rs.FocalPlane(
        np.column_stack([np.arange(400) * 100.0, np.zeros(400)]) * MM, design().focal_plane.positioner
    )
    hits = (np.arange(400) % 10 == 0).astype(float)
    value, low, high = rate_interval(plane, [hits, hits], 0.95)
    assert value == 0.1
    # the unbiased variance of each field is p (1 - p) / 399, with 399 degrees of freedom
    np.testing.assert_allclose([low, high], wilson(0.1, 798, quantile(0.95, 798)), rtol=1e-9)
    np.testing.assert_allclose([low, high], binom_conf_interval(80, 800, 0.95, "wilson"), rtol=1e-3)


def test_the_interval_of_positioners_that_collide_in_pairs_is_that_of_half_as_many_trials():
    x = np.arange(200) * 100.0
    centers = np.column_stack([np.concatenate([x, x + 25]), np.zeros(400)])
    plane = rs.FocalPlane(centers * MM, design().focal_plane.positioner)
    hits = np.tile(np.arange(200) % 10 == 0, 2).astype(float)
    _, low, high = rate_interval(plane, [hits], 0.9)
    np.testing.assert_allclose([low, high], wilson(0.1, 199, quantile(0.9, 199)), rtol=1e-9)
    away = np.where(np.arange(400) < 100, np.nan, hits)  # positioners that are not counted
    value, low, high = rate_interval(plane, [away], 0.9)
    assert value == pytest.approx(np.nanmean(away))
    assert low < value < high
    none = rate_interval(plane, [np.zeros(400)], 0.9)
    assert none[:2] == (0, 0)
    assert 0 < none[2] < 0.02
    assert np.isnan(rate_interval(plane, [np.full(400, np.nan)], 0.9)).all()


STAR = {"catalog": CENTER.reshape(1)}
BAD = {
    "instruments must contain at least one instrument, got none": {"instruments": []},
    "must have different names, got several instruments with the name 'lamost'": {"instruments": ["lamost"] * 2},
    "unknown instrument 'most'": {"instruments": ["lamost", "most"]},
    "the name of a preset or the path of a TOML file, got 5": {"instruments": [5]},
    "none.toml": {"instruments": ["none.toml"]},
    "unknown kind of synthetic sky 'clustered'": {"catalog": "clustered"},
    "allocators must name at least one allocator, got none": {"allocators": []},
    "unknown allocator 'best'": {"allocators": ["best"]},
    "must be given as allocators=, got the argument allocator": {"allocator": "lamost_rule"},
    "targets_per_positioner must be a positive number, got -1": {"targets_per_positioner": -1},
    "n_realizations must be a whole number from 1 to 1000000, got 0": {"n_realizations": 0},
    "density must be a Quantity": {"density": 5},
    "n_realizations cannot be used with a catalog": {**STAR, "n_realizations": 2},
    "targets_per_positioner cannot be used": {**STAR, "targets_per_positioner": 2},
    "targets_per_positioner or density, not both": {"density": 5 / u.deg**2, "targets_per_positioner": 2},
    "density must be one finite value above 0": {"density": -5 / u.deg**2},
    "center must be a SkyCoord with one direction or a list .* got 5": {**STAR, "center": 5},
    "center must be coordinates such as .* got 'here'": {**STAR, "center": "here"},
    "at least one target with finite coordinates, got none": {"catalog": CENTER.reshape(1)[:0]},
    "mine: no target lies within": {**STAR, "center": SkyCoord("5h +5d")},
}


def test_bad_input_is_named():
    for message, arguments in BAD.items():
        with pytest.raises(rs.InputError, match=message):
            rs.compare_instruments(**{"instruments": [design()], **arguments})


def test_names_are_told_apart_by_the_user():
    one = design(rings=2)
    found = rs.compare_instruments("poisson", [one, replace(one, name="other")], n_realizations=1, allocators="nearest")
    assert list(found["instrument"]) == ["mine", "other"]


def test_chart(table):
    ax = rs.plot.plot_instruments(table, height=0.5)
    bars = [p for p in ax.patches if isinstance(p, Rectangle)]
    widths = np.array([bar.get_width() for bar in bars]).reshape(3, -1)
    np.testing.assert_allclose(widths.sum(axis=0), 1)
    np.testing.assert_allclose(widths[0], table["usable"] / table["positioners"])
    assert ({bar.get_height() for bar in bars}, ax.get_yticklabels()[0].get_text()) == ({0.5}, "mine, lamost_rule")
    assert "hatch" in bars[len(table)].properties()
    assert bars[len(table)].get_hatch()
    assert f"{table['loss'][0]:.3f}" in {t.get_text() for t in ax.texts}
    mixed = rs.plot.plot_instruments(table[[0, 2, 1, 3]])
    places = np.sort([bar.get_y() for bar in mixed.patches][:4])
    assert np.diff(places).min() >= 1 - 1e-9
    figure = draw_instruments(table)
    left, _, right = figure.axes
    parts = np.array([bar.get_width() for bar in left.patches]).reshape(4, -1)
    np.testing.assert_allclose(parts[1], [table["reach_1"][0], table["reach_1"][2]])
    assert right.get_xlabel() == "collision probability\n(95 % interval)"
    with pytest.raises(rs.InputError, match="must come from compare_instruments, got one without the column allocator"):
        rs.plot.plot_instruments(table[["instrument", "positioners"]])


@pytest.mark.exhaustive
def test_command(run, tmp_path):
    presets = Path(rs.__file__).parent / "presets"
    text = (presets / "lamost.toml").read_text().replace('name = "lamost"', 'name = "short"')
    (tmp_path / "short.toml").write_text(text.replace("value = 8.25", "value = 7.5"))
    shutil.copy(presets / "sdss_apo.toml", tmp_path / "robots.toml")
    output, plot = tmp_path / "table.ecsv", tmp_path / "chart.png"
    models = tmp_path / "short.toml", tmp_path / "robots.toml", "pfs"
    words = "--n-realizations", 1, "--targets-per-positioner", 0.5, "--output", output, "--plot", plot
    code, out, err = run("compare", *models, *words)
    assert (code, err) == (0, "")
    table = QTable.read(output)
    assert list(dict.fromkeys(table["instrument"])) == ["short", "sdss_apo", "pfs"]
    assert f"{row_of(table, 'short', 'lamost_rule')['loss']:.4g}" in out
    assert "numbers of targets and values per field or solid angle cannot" in " ".join(out.split())
    assert plot.stat().st_size > 5000
    code, out, err = run("compare", "pfs", "--output", output)
    assert code == 2
    assert "exists" in err
    code, _, err = run("compare", "pfs", "--catalog", output, "--density", 5)
    assert code == 2
