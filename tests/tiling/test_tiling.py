"""Lists of tiles, and coverings without gaps."""

from functools import partial

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from astropy_healpix import HEALPix
from scipy.spatial import cKDTree

import rfpsurvey as rs
from rfpsurvey._sky.shapes import border_of, circle_around, distance_to, is_inside
from rfpsurvey._survey.tiling.cover import dither, hexagonal, lattice, spiral, widest_gap
from rfpsurvey._survey.tiling.tiling import as_tiling
from rfpsurvey.tiling import Centers, Fibers

DEG = u.deg
CENTERS = {"equator": (180, 0), "zero": (0.01, 30), "north pole": (0, 90), "south": (77, -89.5)}


def cap_points(center, radius_rad, n=60_000, seed=3):
    """Return random unit vectors in a circle."""
    rng = np.random.default_rng(seed)
    coord = SkyCoord(*center, unit="deg").directional_offset_by(
        rng.uniform(0, 360, n) * DEG, 2 * np.arcsin(np.sin(radius_rad / 2) * np.sqrt(rng.random(n))) * u.rad
    )
    return coord.cartesian.xyz.value.T


def vector(center):
    return SkyCoord(*center, unit="deg").cartesian.xyz.value


def angles(a, b):
    """Return the angle from each vector to the nearest center."""
    return 2 * np.arcsin(np.minimum(cKDTree(b).query(a)[0] / 2, 1))


def table(**more):
    return QTable({"RACEN": [10.0, 20.0, 350.0] * DEG, "DECCEN": [-5.0, 0.0, 5.0] * DEG, **more})


def test_usual_names_are_found():
    tiling = rs.Tiling.from_table(
        table(TILEID=[7, 8, 9], PASS=[0, 1, 1], PA=[0, 30, 0.5] * DEG, AIRMASS=[1.0, 1.1, 1.2])
    )
    assert tiling.table.colnames == ["tile", "ra", "dec", "position_angle", "pass", "AIRMASS"]
    assert (tiling.table["tile"].tolist(), tiling.table["pass"].tolist()) == ([7, 8, 9], [0, 1, 1])
    assert tiling.table["position_angle"].to_value(DEG).tolist() == [0, 30, 0.5]
    assert repr(tiling) == "<Tiling of 3 tiles in 2 passes>"
    bare = rs.Tiling.from_table(table())
    assert (bare.table["tile"].tolist(), bare.table["pass"].tolist()) == ([0, 1, 2], [1, 1, 1])
    assert (bare.coord.ra.deg.tolist(), bare.summary) == ([10, 20, 350], {})


def test_columns_and_units_can_be_given():
    t = Table({"a": [600.0], "b": [20.0], "who": ["x"], "turn": [90.0], "ra": [1.0]})
    names = {"ra": "a", "dec": "b", "tile": "who", "position_angle": "turn"}
    tiling = rs.Tiling.from_table(t, columns=names, units={"ra": "arcmin", "dec": "deg"})
    assert (tiling.table["ra"][0].to_value(DEG), tiling.table["tile"].tolist()) == (pytest.approx(10), ["x"])
    assert tiling.table["position_angle"][0] == 90 * DEG


@pytest.mark.parametrize("others", [{}, {"EBV_MED": [0.1] * u.mag}])
def test_centers_without_units_are_in_degrees(others):
    """Lists of tiles in which only another column has a unit were refused."""
    with pytest.warns(rs.RfpsurveyWarning, match="the assumed unit of RA and DEC is deg; to use other units, give"):
        tiling = rs.Tiling.from_table(QTable({"RA": [10.0], "DEC": [20.0], **others}))
    assert (tiling.coord.ra.deg, tiling.coord.dec.deg) == (10, 20)
    in_hours = QTable({"RA": [10.0], "DEC": [20.0], **others})
    tiling = rs.Tiling.from_table(in_hours, units={"ra": "hourangle", "dec": "deg"})
    assert tiling.coord.ra.deg == pytest.approx(150)


@pytest.mark.parametrize("suffix", ["csv", "tsv", "parquet"])
def test_files_that_cannot_have_units_are_in_degrees(tmp_path, suffix):
    path, given = tmp_path / f"t.{suffix}", Table({"field": ["a", "b"], "ra": [10.0, 11.0], "dec": [20.0, 20.0]})
    if suffix == "parquet":
        pytest.importorskip("pyarrow")
        given.to_pandas().to_parquet(path)
    else:
        given.write(path, format="ascii.csv" if suffix == "csv" else "ascii.tab")
    tiling = rs.Tiling.read(path)  # without a warning, which would fail the test
    assert (tiling.coord.ra.deg.tolist(), tiling.table["tile"].tolist()) == ([10, 11], ["a", "b"])


@pytest.mark.parametrize("kind", [bool, np.uint8, str])
def test_tiles_that_are_not_part_of_desi_are_omitted_with_a_warning(kind):
    """Tiles outside the footprint of DESI, which DESI's lists contain, were planned."""
    is_part = np.array([1, 0, 1]).astype(kind)
    given = Table({"TILEID": [7, 8, 9], "RA": [10.0, 20.0, 30.0], "DEC": [0.0, 5.0, 10.0], "IN_DESI": is_part})
    with pytest.warns(rs.RfpsurveyWarning, match=r"^1 of 3 tiles \(IN_DESI = 0\) are omitted, because they are not"):
        tiling = rs.Tiling.from_table(given)
    assert (tiling.table["tile"].tolist(), tiling.coord.dec.deg.tolist()) == ([7, 9], [0, 10])
    assert tiling.table.meta["omitted"] == "1 of 3 tiles (IN_DESI = 0)"
    all_in = rs.Tiling.from_table(given[::2])  # without a warning, which would fail the test
    assert all_in.table.meta["omitted"] == "0 of 2 tiles (IN_DESI = 0)"
    assert all_in.table.meta["columns"] == {"tile": "TILEID", "ra": "RA", "dec": "DEC"}
    with pytest.raises(rs.InputError, match=r"must be part of DESI's survey \(IN_DESI = 1\), got 1 other tiles"):
        rs.Tiling.from_table(given, select={"TILEID": 8})  # a tiling without tiles was returned


def test_the_list_of_tiles_of_desi_is_read(real_data):
    """The list was refused, because only the column EBV_MED has a unit."""
    path = real_data("desi/tiles-main-head.ecsv")
    tiling, table = rs.Tiling.read(path), Table.read(path)
    assert tiling.table["tile"].tolist() == table["TILEID"][table["IN_DESI"]].tolist()
    assert (tiling.coord.ra.deg == table["RA"]).all()
    assert (tiling.coord.dec.deg == table["DEC"]).all()
    assert (as_tiling(table).coord.ra == tiling.coord.ra).all()
    assert (Centers(table).tiling.coord.ra == tiling.coord.ra).all()


@pytest.mark.parametrize("suffix", [".ecsv", ".fits.gz"])
def test_write_then_read(tmp_path, suffix):
    first = rs.place_tiles(rs.Region.parse("cap 95 23 8"), "lamost", passes=2, centers=Centers(position_angle=30 * DEG))
    path = tmp_path / f"tiles{suffix}"
    first.write(path)
    second = rs.Tiling.read(path)
    assert second.table.colnames == first.table.colnames
    for name in first.table.colnames:
        np.testing.assert_array_equal(second.table[name], first.table[name])
    assert second.summary == first.summary
    with pytest.raises(rs.InputError, match="exists"):
        first.write(path)


def test_an_empty_tiling_is_one(tmp_path):
    empty = rs.Tiling.from_table(table()[:0])
    assert len(empty) == 0
    empty.write(tmp_path / "e.fits")
    assert (len(rs.Tiling.read(tmp_path / "e.fits")), empty.coverage(1 * DEG, nside=2).tolist()) == (0, [0] * 48)


def test_what_stands_for_a_tiling():
    coord = SkyCoord([1, 2] * DEG, [3, 4] * DEG)
    for thing in (coord, QTable({"ra": coord.ra, "dec": coord.dec}), as_tiling(coord)):
        np.testing.assert_allclose(as_tiling(thing).coord.dec.deg, [3, 4])
    galactic = as_tiling(coord.galactic)
    np.testing.assert_allclose(galactic.coord.ra.deg, [1, 2])
    with pytest.raises(rs.InputError, match="tiles must be a Tiling, a Table or a SkyCoord, got list"):
        as_tiling([1])


WHOLE = "pass must be a whole number for every tile, got"
BAD = {
    "there is no column for dec; the columns are: ra": QTable({"ra": [1.0] * DEG}),
    "column 'DEC' has no unit; state the unit, for example units={'dec': 'deg'} or --set tiles.units.dec=deg": QTable(
        {"ra": [1.0] * DEG, "DEC": [1.0]}
    ),
    "table must be an astropy Table, a QTable or a DataFrame, got": [1],
    "but 1 occurs 2 times": table(tile=[1, 2, 1]),
    "ra must lie between": QTable({"ra": [1, 361.0] * DEG, "dec": [0, 0] * DEG}),
    "dec must lie between": QTable({"ra": [1.0] * DEG, "dec": [np.nan] * DEG}),
    "tiles a and b are the same: pass 1, .* deg; to observe a field several times, number its tiles in": QTable(
        {"tile": ["a", "b"], "ra": [0, 360.0] * DEG, "dec": [5, 5] * DEG}
    ),
    f"{WHOLE} 1.5": table(PASS=[1, 1.5, 2]),
    f"{WHOLE} 1e": table(PASS=[1, 1e30, 2]),
}


def test_bad_lists_are_named():
    tiling = rs.Tiling.from_table(table())
    for message, call in (
        *((message, partial(rs.Tiling.from_table, given)) for message, given in BAD.items()),
        ("unknown column role of a tiling 'field'", lambda: rs.Tiling.from_table(table(), columns={"field": "RACEN"})),
        ("there is no column 'nope'", lambda: rs.Tiling.from_table(table(), columns={"ra": "nope"})),
        ("lacks tile, dec, position_angle, pass", lambda: rs.Tiling(QTable({"ra": [1.0] * DEG}))),
        ("nside must be a power of two", lambda: tiling.coverage(1 * DEG, nside=3)),
        ("radius must be a Quantity", lambda: tiling.coverage(1)),
    ):
        with pytest.raises(rs.InputError, match=message):
            call()


def test_a_pass_or_a_program_makes_another_tile():
    same = {"ra": [1.0, 1.0] * DEG, "dec": [2.0, 2.0] * DEG}
    assert len(rs.Tiling.from_table(QTable({**same, "pass": [1, 2]}))) == 2
    assert len(rs.Tiling.from_table(QTable({**same, "PROGRAM": ["dark", "bright"]}))) == 2
    assert len(rs.Tiling.from_table(QTable({**same, "pa": [0, 60] * DEG}))) == 2


def test_coverage_agrees_with_brute_force():
    tiling = as_tiling(SkyCoord([0, 3, 359, 100, 20] * DEG, [0, 1, -1, 90, -88] * DEG))
    hp = HEALPix(32, order="nested", frame="icrs")
    pixels = hp.healpix_to_skycoord(np.arange(hp.npix))
    expected = sum((pixels.separation(c) <= 4 * DEG).astype(int) for c in tiling.coord)
    found = tiling.coverage(4 * DEG, nside=32)
    assert found.max() == 3
    np.testing.assert_array_equal(found, expected)


def test_the_tiles_of_desi(real_data):
    """The list of tiles states the area that they cover."""
    tiling = rs.Tiling.read(real_data("desi_tiles_main.ecsv.gz"))
    assert (len(tiling), set(tiling.table["program"])) == (21615, {"DARK", "BRIGHT"})
    assert set(tiling.table["pass"]) == set(range(7))
    covered = (tiling.coverage(1.6 * DEG, nside=128) > 0).mean() * 4 * np.pi * u.sr
    assert covered.to_value(u.deg**2) == pytest.approx(tiling.table.meta["sky_area_deg2"], abs=0.01)


@pytest.mark.few(24)
@pytest.mark.parametrize("number", [0, 5])
@pytest.mark.parametrize("make", [hexagonal, spiral])
@pytest.mark.parametrize("center", CENTERS.values(), ids=CENTERS.keys())
@pytest.mark.parametrize(("reach", "radius"), [(10, 1.5), (1, 2.5), (60, 7), (0.02, 0.003), (0, 1)])
def test_no_gap(make, center, reach, radius, number):
    reach, radius = np.deg2rad([reach, radius])
    centers = make(vector(center), reach, radius, number)
    assert angles(cap_points(center, reach), centers).max() <= radius


@pytest.mark.few(2)
@pytest.mark.parametrize("center", CENTERS.values(), ids=CENTERS.keys())
def test_the_widest_gap_is_what_dense_points_find(center):
    """The lattice is also tested without one of its centers, since a proof must then find the gap."""
    reach = np.deg2rad(8)
    centers = lattice(vector(center), 2 * reach, np.deg2rad(2), dither(2))
    for vectors in (centers, np.delete(centers, 5, axis=0)):
        gap = widest_gap(vectors, vector(center), reach)
        seen = angles(cap_points(center, reach, 300_000), vectors).max()
        assert seen <= gap
        assert seen >= 0.98 * gap


def test_a_spiral_covers_the_whole_sky():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(200_000, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    for radius in (1.6, 20, 80):
        tiling = rs.place_tiles(rs.Region.whole_sky(), radius=radius * DEG, method="spiral")
        assert np.rad2deg(angles(points, tiling.vectors).max()) <= radius
        assert tiling.summary["covering_fraction"] == 1


SHAPES = [
    "cap 95 23 8",
    "cap 0 90 5",
    "box 350 10 -5 5",
    "box 0 360 80 90",
    "polygon 0 0 40 0 40 20 10 5 0 20",
    "box 180 181 -20 20",
    "polygon 10 0 40 0.001 70 0 40 -0.001",
    "cap 10 10 0.1",
]


@pytest.mark.few(8)
@pytest.mark.parametrize("method", ["hexagonal", "spiral"])
@pytest.mark.parametrize("text", SHAPES)
def test_every_pass_covers_the_region(method, text):
    region = rs.Region.parse(text)
    tiling = rs.place_tiles(region, radius=2 * DEG, method=method, passes=2)
    center, reach = circle_around(region)
    place = np.rad2deg(np.arctan2(center[1], center[0])), np.rad2deg(np.arcsin(center[2]))
    points = cap_points(place, reach, 100_000)
    points = np.vstack([points[is_inside(region, points)], border_of(region) if region.kind != "cap" else center[None]])
    for number in (1, 2):
        tiles = tiling.vectors[tiling.table["pass"] == number]
        assert np.rad2deg(angles(points, tiles).max()) <= 2 * (1 + 1e-9)
    # no tile is superfluous
    assert np.rad2deg(distance_to(region, tiling.vectors).max()) <= 2
    assert tiling.summary["covering_fraction"] == 1
    first, second = (tiling.vectors[tiling.table["pass"] == number] for number in (1, 2))
    assert angles(first, second).min() > 1e-3


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["hexagonal", "spiral"])
def test_pixels_are_covered_to_their_edges(method):
    tiling = rs.place_tiles(rs.Region.healpix([270, 300], 8), radius=2 * DEG, method=method)
    fine = HEALPix(8 * 32, order="nested").healpix_to_xyz((np.array([[270], [300]]) * 32**2 + np.arange(32**2)).ravel())
    assert np.rad2deg(angles(np.transpose(fine), tiling.vectors).max()) <= 2


def test_a_polygon_may_be_closed():
    corners = [0, 40, 40, 0, 0] * DEG, [0, 0, 20, 20, 0] * DEG
    assert rs.Region.polygon(SkyCoord(*corners)).area == rs.Region.polygon(SkyCoord(*(c[:4] for c in corners))).area


def test_a_covering_is_close_to_the_best():
    """Every covering of the plane by equal circles has an area of at least 2 pi / sqrt(27) times the covered area."""
    region = rs.Region.parse("cap 200 40 30")
    hexagons = rs.place_tiles(region, radius=1.5 * DEG)
    depth = len(hexagons) * 4 * np.pi * np.sin(np.deg2rad(0.75)) ** 2 / region.area.to_value(u.sr)
    assert 1.209 < depth < 1.35
    assert 1.209 < hexagons.summary["mean_depth"] < 1.25
    assert len(rs.place_tiles(rs.Region.parse("cap 200 40 1.4"), radius=1.5 * DEG)) == 1


def test_what_is_excluded_needs_no_tile():
    region, hole = rs.Region.parse("cap 95 23 8"), rs.Region.parse("cap 95 23 4")
    tiling = rs.place_tiles(region, radius=1 * DEG, exclude=hole)
    points = cap_points((95, 23), np.deg2rad(8))
    points = points[~is_inside(hole, points)]
    assert np.rad2deg(angles(points, tiling.vectors).max()) <= 1
    # the central tile and those of the first ring are completely inside
    assert len(tiling) == len(rs.place_tiles(region, radius=1 * DEG)) - 7
    with pytest.raises(rs.InputError, match="nothing is left"):
        rs.place_tiles(hole, radius=1 * DEG, exclude=region)


def test_centers_restrict_coverings():
    region = rs.Region.parse("cap 95 23 5")
    stars = rs.synthetic_catalog("poisson", SkyCoord(95 * DEG, 23 * DEG), 8 * DEG, density=2 / DEG**2, rng=1).coord
    tiling = rs.place_tiles(region, radius=2.5 * DEG, centers=stars)
    assert angles(tiling.vectors, stars.cartesian.xyz.value.T).max() < 1e-9
    assert tiling.summary["covering_fraction"] == 1
    with pytest.warns(rs.RfpsurveyWarning, match="the allowed centers cover 0.[0-9]+ of the region"):
        poor = rs.place_tiles(region, radius=2.5 * DEG, centers=stars[:2])
    points = cap_points((95, 23), np.deg2rad(5))
    share = np.mean(angles(points, poor.vectors) <= np.deg2rad(2.5))
    assert poor.summary["covering_fraction"] == pytest.approx(share, abs=0.01)


BAD_REQUESTS = {
    "unknown method to place tiles 'hexagon'; choose one of: ": {"method": "hexagon"},
    "the method 'network_flow' needs targets, got a Region; methods that cover regions: hexagonal, spiral": {
        "method": "network_flow"
    },
    "completeness applies only to targets": {"completeness": 0.9},
    "n_tiles applies only to targets": {"n_tiles": 5},
    "a part of the region must be within reach of centers from 50": {"centers": Centers(declination=(50, 60) * DEG)},
    "passes must be a whole number from 1 to 10000, got 0": {"passes": 0},
    "radius must be a Quantity": {"radius": 2},
    "radius must be one finite value above 0 deg and below 90 deg": {"radius": 95 * DEG},
    "radius must be larger: about": {"radius": 1 * u.arcsec},
    "an instrument or the radius of a tile": {"radius": None},
    "centers must contain at least one": {"centers": SkyCoord([] * DEG, [] * DEG)},
    "exclude must be a Region": {"exclude": 5},
    "unknown instrument 'lamots'": {"instrument": "lamots"},
}
LOST = "lost_in_collision has no effect without the positioners"
NO_EFFECT = {
    "fibers has no effect on a region, which has no targets": {"fibers": 5},
    "visits has no effect on a region": {"visits": 2},
    "rng has no effect on a region": {"rng": 2},
    "allocator has no effect on a region": {"instrument": "lamost", "allocator": "lamost_rule"},
    LOST: {"fibers": Fibers(lost_in_collision=False)},
}
NO_EFFECT_ON_TARGETS = {
    "passes has no effect with .*; only hexagonal and spiral use it": {"method": "max_density", "passes": 2},
    "passes has no effect if n_tiles or completeness is given": {"n_tiles": 3, "passes": 2},
    "rng has no effect without the positioners of an allocator": {"rng": 4},
    LOST: {"fibers": Fibers(9, lost_in_collision=False)},
    "rng has no effect with the allocator": {"instrument": "lamost", "fibers": None, "radius": None, "rng": 4},
}


def test_bad_requests_for_a_region_are_named():
    for message, options in BAD_REQUESTS.items():
        with pytest.raises(rs.InputError, match=message):
            rs.place_tiles(rs.Region.parse("cap 95 23 8"), **{"radius": 2 * DEG, **options})


def test_options_without_effect_cause_one_warning():
    region = rs.Region.parse("cap 95 23 3")
    sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 1 * DEG, n_targets=30, rng=1)
    for given, texts, more in ((region, NO_EFFECT, {}), (sky, NO_EFFECT_ON_TARGETS, {"fibers": 9})):
        for words, options in texts.items():
            with pytest.warns(rs.RfpsurveyWarning, match=words) as told:
                rs.place_tiles(given, **{"radius": 2 * DEG, **more, **options})
            assert len(told) == 1


def test_the_hexagonal_lattice_does_not_go_around():
    with pytest.raises(rs.InputError, match="hemisphere, but the field reaches 180.0 deg .* use method='spiral'"):
        rs.place_tiles(rs.Region.whole_sky(), radius=2 * DEG)
