"""Compare figures with those in ``baseline``, made by the fixed version of matplotlib in ``tox -e figures``.

After an intended change, inspect the new figures, and keep them by

    tox -e figures -- --mpl-generate-path=tests/figures/baseline
"""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from matplotlib.figure import Figure
from statuses import status_table
from text_tables import text_table

import flat
import rfpsurvey as rs

CENTER = SkyCoord(95, 23, unit="deg")
kept = pytest.mark.mpl_image_compare(deterministic=True, savefig_kwargs={"dpi": 40}, style="default", tolerance=1)


def axes(width=7, height=7, projection=None):
    """Return axes without a layout engine, which would move the axes slightly whenever the figure is drawn."""
    return Figure(figsize=(width, height)).add_axes((0.16, 0.25, 0.68, 0.68), projection=projection)


def tile(instrument, **options):
    sky = rs.synthetic_catalog("uniform", CENTER, 1.4 * u.deg, n_targets=700, rng=1)
    return flat.plan_tile(sky, instrument, CENTER, **options)


@pytest.fixture(scope="module")
def worn():
    """Return an instrument with some disabled and stuck positioners."""
    apo, rng, stuck = rs.Instrument.preset("sdss_apo"), np.random.default_rng(2), np.full((500, 2), np.nan)
    stuck[rng.choice(500, 30, replace=False)] = 50, 100
    plane = replace(apo.focal_plane, stuck=stuck * u.deg, disabled=rng.random(500) < 0.05)
    return replace(apo, focal_plane=plane)


@pytest.fixture(scope="module")
def survey():
    unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane.hexagonal(unit, rings=3, pitch=25.6 * u.mm)
    sky = rs.synthetic_catalog("poisson", CENTER, 1 * u.deg, density=100 / u.deg**2, rng=3)
    sky = rs.Catalog(sky.coord, priority=np.arange(len(sky)) % 2)
    tiles = QTable({"ra": [94.7, 95.3, 94.7, 95.3] * u.deg, "dec": [23, 23, 23.3, 23.3] * u.deg, "pass": [1, 1, 2, 2]})
    return rs.plan_survey(
        sky, rs.Instrument("small", plane, plate_scale=200 * u.mm / u.deg), tiles, allocator="lamost_rule"
    )


@kept
def test_focal_plane_with_unequal_arms():
    return rs.plot.plot_focal_plane(tile("sdss_apo"), ax=axes()).figure


@kept
def test_part_of_a_focal_plane_with_equal_arms():
    region = [[-120, -120], [120, 120]] * u.mm
    return rs.plot.plot_focal_plane(tile("lamost", allocator="balanced"), ax=axes(), region=region).figure


@kept
def test_focal_plane_as_dots_at_a_position_angle():
    return rs.plot.plot_focal_plane(tile("pfs", position_angle=30 * u.deg), ax=axes()).figure


@kept
def test_part_of_a_worn_focal_plane(worn):
    return rs.plot.plot_focal_plane(tile(worn), ax=axes(), region=[[-90, -90], [90, 90]] * u.mm).figure


@pytest.fixture(scope="module")
def classes():
    """Return a tile with sky fibers, standard stars, categories and priorities."""
    rng, n = np.random.default_rng(4), 900
    coord = rs.synthetic_catalog("uniform", CENTER, 1.5 * u.deg, n_targets=n, rng=1).coord
    columns = {"kind": rng.choice(["science", "standard", "sky"], n, p=[0.8, 0.1, 0.1])}
    columns |= {"category": rng.choice(["qso", "lrg"], n), "priority": rng.integers(1, 4, n)}
    sky = rs.Catalog(coord, **columns, extra={"g": rng.normal(18, 1, n) * u.mag})
    asked = rs.AllocationOptions("lamost_rule", requirements=["sky=30", "standard=20"])
    return rs.plan_tile(sky, "sdss_apo", CENTER, allocator=asked)


@kept
def test_focal_plane_with_targets_by_outcome(classes):
    return rs.plot.plot_focal_plane(classes, targets="outcome", arms=False, ax=axes()).figure


@kept
def test_part_of_a_focal_plane_with_targets_by_priority(classes):
    region = [[-90, -90], [90, 90]] * u.mm
    return rs.plot.plot_focal_plane(classes, targets="priority", ax=axes(), region=region).figure


@kept
def test_targets_on_the_sky_by_kind(classes):
    return rs.plot.plot_targets(classes, color="kind", ax=axes()).figure


@kept
def test_quality(classes):
    room = {"left": 0.12, "right": 0.96, "bottom": 0.16, "top": 0.94, "wspace": 0.4, "hspace": 0.7}
    given = Figure(figsize=(11, 8)).subplots(2, 2, gridspec_kw=room).ravel()
    return rs.plot.plot_quality(classes, column="g", axes=given)[0].figure


@kept
def test_focal_plane_by_fiber_type(worn):
    return rs.plot.plot_focal_plane(worn, ax=axes(), region=[[-90, -90], [90, 90]] * u.mm, color="fiber_type").figure


@kept
def test_coverage(worn):
    return rs.plot.plot_coverage(worn, ax=axes(), n_pixels=200, region=[[0, -90], [180, 90]] * u.mm).figure


@kept
def test_collision_map(worn):
    estimate = flat.collision_probability(worn, method="quadrature", max_iterations=32)
    return rs.plot.plot_collision_map(estimate, worn, ax=axes()).figure


@kept
def test_collision_map_of_a_tile(worn):
    return rs.plot.plot_collision_map(tile(worn), ax=axes()).figure


@kept
def test_probability():
    ratio = np.linspace(1, 3, 9)
    table = QTable({"ratio": ratio, "value": ratio**2 / 20, "low": ratio**2 / 22, "high": ratio**2 / 19})
    table["closed_form"] = ratio / 40
    return rs.plot.plot_probability(table, values=["value", "closed_form"], ax=axes(6, 5)).figure


@kept
def test_residuals():
    ratio, pitch = np.random.default_rng(1).uniform((1, 25), (2, 35), (40, 2)).T
    table = QTable({"ratio": ratio, "pitch": pitch * u.mm, "value": ratio, "closed_form": pitch / 20})
    return rs.plot.plot_residuals(table, ax=axes(6, 5)).figure


@kept
def test_allocators():
    text = "allocator science usable missing seconds\nbalanced 820 640 12 0.0012\nnetwork_flow 900 655 0 0.21\n"
    text += "optimal 860 860 0 14"
    table = text_table(text, {"blind_science": 905, "instrument": "mine"}, seconds=u.s)
    return rs.plot.plot_allocators(table, ax=axes(7, 5)).figure


@kept
def test_tiles_by_completeness(survey):
    return rs.plot.plot_tiling(survey, ax=axes(6, 5)).figure


@kept
def test_tiles_of_two_passes_with_targets_and_a_region(survey):
    tiling = rs.Tiling(survey.tiles["tile", "ra", "dec", "position_angle", "pass"])
    sky = rs.synthetic_catalog("uniform", CENTER, 0.7 * u.deg, n_targets=200, rng=1)
    region = rs.Region.cap(CENTER, 0.5 * u.deg)
    return rs.plot.plot_tiling(tiling, radius=0.4 * u.deg, targets=sky, region=region, ax=axes(6, 5)).figure


@kept
def test_tiles_on_the_whole_sky():
    rng = np.random.default_rng(1)
    table = QTable({"ra": rng.uniform(0, 360, 200) * u.deg, "dec": rng.uniform(-60, 60, 200) * u.deg})
    table["pass"] = np.arange(200) % 3 + 1
    return rs.plot.plot_tiling(rs.Tiling.from_table(table), radius=4 * u.deg, ax=axes(8, 4.5, "aitoff")).figure


@kept
def test_completeness(survey):
    return rs.plot.plot_completeness(survey, ax=axes(6, 5)).figure


SPEED = """
method n_points time n_colliding_true misclassified max_error
exact "" 0.04 1100 0 1e-15
sampled 5 0.03 1100 0.02 1.2
sampled 65 0.8 1100 0 0.07
sweep 9 13 1100 1.7 4.2
"""
ACCURACY = """
method estimand effort time error error_error truth_error
closed_form independent 0 1 0.3 0 0.0005
conditional allocated 4 9 0.02 0.002 0.0005
conditional allocated 64 120 0.004 0.0006 0.0005
quadrature independent 64 40 0.003 0.0004 0.0005
quadrature independent 256 160 0.0007 0.0001 0.0005
"""


@kept
def test_speed_against_accuracy():
    meta = {"instrument": "lamost", "n_positioners": 4000, "machine": "a processor, 2 cores"}
    table, figure = text_table(SPEED, meta, time=u.ms, max_error=u.mm), Figure(figsize=(9, 9))
    return rs.plot.plot_speed_accuracy(table, axes=tuple(figure.subplots(2, sharex=True)))[0].figure


@kept
def test_probability_against_time():
    table = text_table(ACCURACY, {"instrument": "mine", "n_positioners": 37, "repeats": 30}, time=u.ms)
    figure, room = Figure(figsize=(9, 5)), {"top": 0.8, "wspace": 0.35}
    return rs.plot.plot_probability_accuracy(table, axes=tuple(figure.subplots(1, 2, gridspec_kw=room)))[0].figure


@kept
def test_status_of_a_survey():
    figure, room = Figure(figsize=(11, 5)), {"bottom": 0.25, "left": 0.07, "right": 0.91, "wspace": 0.45}
    return rs.plot.plot_survey_status(status_table(), axes=figure.subplots(1, 2, gridspec_kw=room))[0].figure


@kept
def test_instruments_side_by_side():
    table = rs.compare_instruments("uniform", ["sdss_apo", "pfs"], n_realizations=1, rng=1)
    return rs.plot.plot_instruments(table, ax=Figure(figsize=(7, 5)).add_axes((0.24, 0.25, 0.64, 0.66))).figure


@kept
def test_front_of_designs():
    scan = {"central_arm": 8.25 * u.mm, "ratio": [1.0, 2.0], "pitch": [22.0, 32.0] * u.mm, "clearance": 2.25 * u.mm}
    return rs.plot.plot_designs(flat.explore_designs(n_designs=64, rng=1, **scan), ax=axes()).figure
