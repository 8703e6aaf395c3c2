"""Centers from a list, limits of declination, excluded regions, progress."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

import rfpsurvey as rs
from rfpsurvey.tiling import METHODS, Centers

DEG = u.deg
SEARCHES = [name for name, one in METHODS.items() if not one.needs_tiles]
FEW = {"radius": 1 * DEG, "fibers": 50}


def sky(center=(95, 23), radius=3, n=300, seed=1):
    return rs.synthetic_catalog("uniform", SkyCoord(*center, unit="deg"), radius * DEG, n_targets=n, rng=seed)


@pytest.mark.parametrize("method", SEARCHES)
@pytest.mark.parametrize("limits", [(22.5, 23.5), pytest.param((23, 23), marks=pytest.mark.exhaustive)])
def test_declinations_hold(method, limits):
    catalog = sky()
    low, high = limits
    beyond = (catalog.coord.dec.deg < low - 1) | (catalog.coord.dec.deg > high + 1)
    assert beyond.any()
    where = Centers(declination=limits * DEG)
    with pytest.warns(rs.RfpsurveyWarning, match=f"{beyond.sum()} targets are out of reach of centers from"):
        tiling = rs.place_tiles(catalog, method=method, centers=where, **FEW)
    assert tiling.table["dec"].min() >= (low - 1e-9) * DEG
    assert tiling.table["dec"].max() <= (high + 1e-9) * DEG
    assert tiling.summary["n_beyond_declination"] == beyond.sum()
    assert tiling.summary["n_targets"] == tiling.summary["n_requested"] == 300
    assert tiling.summary["completeness"] == pytest.approx(tiling.summary["n_observed"] / 300)
    # the targets within reach of the strip are on tiles, except for narrow parts at its edge
    if method in ("hexagonal", "spiral"):
        inside = (catalog.coord.dec.deg >= low) & (catalog.coord.dec.deg <= high)
        assert tiling.summary["n_on_tiles"] >= inside.sum()


def test_coverings_reach_the_limit():
    """Centers beyond the limit are moved onto it."""
    region, where = rs.Region.parse("box 0 40 20 40"), Centers(declination=(-90 * DEG, 30 * DEG))
    words = "cover 0.[0-9]+ of the region; 0.[0-9]+ of it is out of reach of centers from -90"
    with pytest.warns(rs.RfpsurveyWarning, match=words):
        tiling = rs.place_tiles(region, radius=2 * DEG, centers=where)
    ra, dec = np.meshgrid(np.linspace(0, 40, 200), np.linspace(20, 30, 100))
    points = SkyCoord(ra.ravel(), dec.ravel(), unit="deg")
    assert points.match_to_catalog_sky(tiling.coord)[1].max() <= 2.001 * DEG
    assert tiling.table["dec"].max() <= 30 * DEG
    beyond = rs.Region.parse("box 0 40 32 40").area / region.area
    assert tiling.summary["fraction_beyond_declination"] == pytest.approx(beyond.value, abs=0.01)


def test_limits_restrict_a_list():
    stars = SkyCoord([95, 95, 96] * DEG, [22, 23, 24] * DEG)
    where = Centers(stars, declination=(22 * DEG, 23.5 * DEG))
    with pytest.warns(rs.RfpsurveyWarning, match="out of reach"):
        tiling = rs.place_tiles(sky(), method="max_density", centers=where, **FEW)
    assert set(tiling.table["dec"].value.round(9)) == {22, 23}


def test_given_tiles_are_kept_as_they_are():
    table = QTable({"TILEID": [7, 5, 9], "RA": [95, 96, 200] * DEG, "DEC": [23, 23.5, 0] * DEG, "PASS": [2, 1, 1]})
    table["PA"], table["PROGRAM"] = [10, 20, 30] * DEG, ["dark", "dark", "bright"]
    tiling = rs.place_tiles(sky(), method="given", centers=table, **FEW)
    assert (tiling.table["tile"].tolist(), tiling.table["pass"].tolist()) == ([7, 5, 9], [2, 1, 1])
    assert tiling.table["position_angle"].value.tolist() == [10, 20, 30]
    assert tiling.table["PROGRAM"].tolist() == ["dark", "dark", "bright"]
    n = (sky().coord.separation(tiling.coord[0]) <= 1 * DEG).sum()
    assert (tiling.table["n_targets"][0], tiling.table["n_new"][0]) == (n, min(n, 50))
    assert tiling.table["n_new"][2] == 0
    turned = rs.place_tiles(sky(), method="given", centers=Centers(table, position_angle=45 * DEG), **FEW)
    assert turned.table["position_angle"].value.tolist() == [45, 45, 45]
    assert len(rs.place_tiles(sky(), method="given", centers=table, n_tiles=1, **FEW)) == 1


def test_position_angles_of_given_tiles_reach_the_positioners():
    catalog = sky(radius=2, n=2000)
    table = QTable({"ra": [95, 95.5] * DEG, "dec": [23, 23] * DEG, "pa": [10, 55] * DEG})
    tiling = rs.place_tiles(catalog, "sdss_apo", method="given", centers=table)
    survey = rs.plan_survey(catalog, "sdss_apo", table, order="given")
    np.testing.assert_array_equal(tiling.table["n_new"], survey.tiles["n_observed"])
    flat = rs.place_tiles(catalog, "sdss_apo", method="given", centers=Centers(table, position_angle=0 * DEG))
    assert flat.table["n_new"].tolist() != tiling.table["n_new"].tolist()


def test_the_tiles_of_desi_are_measured_on_a_region(real_data):
    tiles = rs.Tiling.read(real_data("desi_tiles_main.ecsv.gz"))
    tiling = rs.place_tiles(rs.Region.parse("box 180 200 10 20"), "desi", method="given", centers=tiles)
    assert (len(tiling), tiling.summary["covering_fraction"]) == (len(tiles), 1)
    rng = np.random.default_rng(1)
    dec = np.rad2deg(np.arcsin(rng.uniform(*np.sin(np.deg2rad([10, 20])), 400)))
    points = SkyCoord(rng.uniform(180, 200, 400) * DEG, dec * DEG)
    near = tiles.coord[tiles.coord.separation(SkyCoord(190 * DEG, 15 * DEG)) < 20 * DEG]
    depth = (points[:, None].separation(near) <= tiling.summary["radius_deg"] * DEG).sum(axis=1)
    assert tiling.summary["mean_depth"] == pytest.approx(depth.mean(), rel=0.03)


@pytest.mark.parametrize("method", SEARCHES)
def test_several_regions_are_excluded(method):
    holes = [rs.Region.parse("cap 94 23 0.8"), rs.Region.parse("cap 96 23 0.8")]
    catalog = sky()
    out = holes[0].contains(catalog.coord) | holes[1].contains(catalog.coord)
    tiling = rs.place_tiles(catalog, method=method, exclude=holes, **FEW)
    assert tiling.summary["n_targets"] == 300 - out.sum()


def test_progress_is_told_after_each_tile(capsys):
    seen = []
    tiling = rs.place_tiles(sky(), method="max_density", progress=lambda *now: seen.append(now), **FEW)
    assert [reached for reached, _ in seen] == tiling.table["completeness"].tolist()
    assert {goal for _, goal in seen} == {1.0}
    seen = []
    rs.place_tiles(sky(), method="max_density", progress=lambda *now: seen.append(now), n_tiles=2, **FEW)
    assert (seen, capsys.readouterr().err) == ([(1, 2), (2, 2)], "")
    rs.place_tiles(sky(), progress=True, **FEW)
    assert "100" in capsys.readouterr().err.split("\r")[-1]


BAD = {
    "declination must be two angles, the lower and the upper limit, got 5": {"declination": 5},
    "declination must be a Quantity": {"declination": (1, 2)},
    "declination must have a unit convertible to deg": {"declination": (1, 2) * u.m},
    "from -90 to 90 deg, got 30 and -10 deg": {"declination": (30, -10) * DEG},
    "from -90 to 90 deg, got -91 and 10 deg": {"declination": (-91, 10) * DEG},
    "from -90 to 90 deg, got nan": {"declination": (np.nan, 10) * DEG},
    "position_angle must be a Quantity": {"position_angle": 5},
    "there is no column for ra and dec": {"coord": Table({"x": [1]})},
    "at least one finite direction inside the limits of declination": {
        "coord": SkyCoord(1 * DEG, 50 * DEG),
        "declination": (0, 10) * DEG,
    },
}
BAD_REQUESTS = {
    "'given' needs a list of tiles as centers, got none": {"method": "given"},
    "at least one target must be within reach of centers from -80 to -70 deg declination, got none": {
        "centers": Centers(declination=(-80, -70) * DEG)
    },
    r"exclude must be a Region or a list of Regions, got \[3\]": {"exclude": [3]},
    "centers must be a SkyCoord, a Tiling or a Table": {"centers": [1]},
}


def test_bad_centers_are_named():
    for message, options in BAD.items():
        with pytest.raises(rs.InputError, match=message):
            Centers(**options)
    for message, options in BAD_REQUESTS.items():
        with pytest.raises(rs.InputError, match=message):
            rs.place_tiles(sky(), **options, **FEW)


@pytest.mark.parametrize("name", ["sdss_apo", "must"])
def test_the_fraction_in_reach_is_that_of_random_points(name):
    """Regression: the covering of a field that is not a circle was stated to be complete."""
    model = rs.Instrument.preset(name)
    tiling = rs.place_tiles(rs.Region.cap("95 23", 3 * model.field_radius), model)
    points = rs.synthetic_catalog("uniform", "95 23", 3 * model.field_radius, n_targets=10_000, rng=2)
    in_reach = rs.selection.potential_assignments(points, model, tiling).n_tiles() > 0
    assert tiling.summary["covering_fraction"] == 1 > tiling.summary["fraction_in_reach"] + 0.05
    assert tiling.summary["fraction_in_reach"] == pytest.approx(in_reach.mean(), abs=0.01)


def test_the_fraction_in_reach_of_tiles_that_reach_nothing_new(small):
    """Regression: an instrument whose fibers have places on their arms caused an IndexError."""
    plane = small.focal_plane
    places = np.tile([plane.positioner.eccentric_arm.to_value(u.mm), 0], (len(plane), 1)) * u.mm
    built = replace(small, focal_plane=replace(plane, fiber_xy=places))
    region = rs.Region.cap("95 23", 0.3 * small.field_radius)
    centers = QTable({"ra": [95, 95, 200] * DEG, "dec": [23, 23, 0] * DEG, "position_angle": [0, 30, 0] * DEG})
    for model in (small, built):
        given = rs.place_tiles(region, model, method="given", centers=rs.Tiling.from_table(centers))
        assert given.summary["fraction_in_reach"] == pytest.approx(1, abs=0.05)
    assert rs.place_tiles(region, built, passes=2).summary["fraction_in_reach"] == 1


def test_the_fraction_in_reach_counts_all_fiber_types(small):
    """Regression: only the first of several fiber types with their own maps was counted."""
    types = np.where(np.arange(len(small.focal_plane)) % 2, "A", "B")
    plane = replace(small.focal_plane, fiber_type=types)
    scale = small.plate_scale.to_value(u.mm / u.deg)
    one_map = rs.projection.RadialMap("theta", [scale], max_angle=1.2 * small.field_radius)
    maps = {"A": one_map, "B": one_map}
    region = rs.Region.cap("95 23", 0.8 * small.field_radius)
    one = rs.place_tiles(region, small).summary["fraction_in_reach"]
    both = replace(small, focal_plane=plane, plate_scale=None, distortion=maps)
    assert rs.place_tiles(region, both).summary["fraction_in_reach"] == pytest.approx(one, abs=0.01)
