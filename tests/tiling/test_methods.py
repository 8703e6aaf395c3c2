"""Tiles for targets: all methods, compared with brute force."""

from dataclasses import replace
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from oracles import fewest_circles
from rfpsurvey._survey.tiling.centers import FreeFibers
from rfpsurvey.tiling import METHODS, Centers

DEG = u.deg
SEARCHES = [name for name, one in METHODS.items() if not one.needs_tiles]
GREEDY = ("max_density", "density_gradient", "mean_shift")
PLACES = {"equator": (180, 0), "zero": (0, 0), "north pole": (0, 90), "south pole": (40, -90), "middle": (123, 45)}


@pytest.fixture(params=SEARCHES)
def method(request):
    return request.param


@pytest.fixture(scope="module")
def stars(tycho):
    """Return every fourth star of the field."""
    return rs.Catalog.read(tycho)[::4]


def sky(center=(95, 23), radius=3, n=300, seed=1, kind="uniform", **options):
    center = SkyCoord(*center, unit="deg")
    return rs.synthetic_catalog(kind, center, radius * DEG, n_targets=n, rng=seed, **options)


def replay(catalog, tiling, radius, visits=1):
    """Serve all targets in each field in the order of the tiles, with separations computed by astropy."""
    left, rows = np.full(len(catalog), visits), []
    for center in tiling.coord:
        inside = (catalog.coord.separation(center) <= radius) & (left > 0)
        left[inside] -= 1
        rows.append((inside.sum(), inside.sum(), 1 - left.sum() / (visits * len(catalog))))
    return np.array(rows)


def test_two_clusters_take_two_tiles(method):
    clusters = [sky(center, 0.4, 50, seed) for seed, center in enumerate([(10, 5), (16, 5)])]
    coord = SkyCoord(np.concatenate([c.coord.ra for c in clusters]), np.concatenate([c.coord.dec for c in clusters]))
    options = {"n_tiles": 2} if method == "network_flow" else {}
    tiling = rs.place_tiles(coord, radius=1 * DEG, fibers=60, method=method, **options)
    if method in (*GREEDY, "network_flow"):
        assert tiling.table["n_new"].tolist() == [50, 50]
        order = np.argsort(tiling.coord.ra)
        assert (tiling.coord[order].separation(SkyCoord([10, 16] * DEG, [5, 5] * DEG)) < 0.7 * DEG).all()
    assert tiling.summary["completeness"] == 1
    assert len(tiling) >= 2


def test_fibers_limit_what_a_tile_serves(method):
    options = {"n_tiles": 6} if method == "network_flow" else {}
    if method in ("hexagonal", "spiral"):
        options = {"completeness": 1}
    tiling = rs.place_tiles(sky(radius=0.5, n=250), radius=1 * DEG, fibers=50, method=method, **options)
    assert (tiling.table["n_new"].max(), tiling.summary["completeness"]) == (50, 1)
    if method in GREEDY:
        assert tiling.table["n_new"].tolist() == [50] * 5
        assert (tiling.table["n_targets"].tolist(), tiling.summary["fiber_use"]) == ([250, 200, 150, 100, 50], 1)


def test_columns_agree_with_a_replay(method):
    catalog = sky(n=400, radius=5)
    tiling = rs.place_tiles(catalog, radius=1.2 * DEG, fibers=10_000, method=method)
    expected = replay(catalog, tiling, 1.2 * DEG)
    np.testing.assert_array_equal(tiling.table["n_targets"], expected[:, 0])
    np.testing.assert_array_equal(tiling.table["n_new"], expected[:, 1])
    np.testing.assert_allclose(tiling.table["completeness"], expected[:, 2])
    if method not in ("hexagonal", "spiral"):  # a covering keeps all of its tiles
        assert (tiling.table["n_new"] > 0).all()
    summary = tiling.summary
    assert (summary["n_tiles"], summary["n_on_tiles"]) == (len(tiling), tiling.table["n_new"].sum())
    assert summary["n_observed"] == tiling.table["n_new"].sum()
    if method != "network_flow":
        assert summary["completeness"] == 1


def test_coverings_observe_the_fullest_tile_first():
    catalog = sky(n=400, radius=5)
    tiling = rs.place_tiles(catalog, radius=1.2 * DEG, fibers=10_000)
    assert (np.diff(tiling.table["n_targets"]) <= 0).all()


def test_max_density_is_the_densest_place(rng):
    """No point of a fine grid has more targets than the first tile."""
    catalog = sky(n=500, radius=4, kind="clustered", cluster_scale=0.5 * DEG)
    tiling = rs.place_tiles(catalog, radius=1 * DEG, fibers=10_000, method="max_density", n_tiles=1)
    center = SkyCoord(95 * DEG, 23 * DEG)
    grid = center.directional_offset_by(rng.uniform(0, 360, 4000) * DEG, 4 * np.sqrt(rng.random(4000)) * DEG)
    counts = (np.cos(np.deg2rad(1)) <= grid.cartesian.xyz.value.T @ catalog.arrays.vectors.T).sum(axis=1)
    assert tiling.table["n_new"][0] >= counts.max() - 1


def test_mean_shift_rests_at_the_mean():
    catalog = sky(n=300, radius=0.8, kind="clustered", cluster_scale=0.3 * DEG, cluster_size=20)
    tiling = rs.place_tiles(catalog, radius=2 * DEG, fibers=10_000, method="mean_shift")
    assert len(tiling) == 1
    mean = catalog.mean_direction
    assert tiling.coord[0].separation(mean) < 0.005 * DEG


def test_density_gradient_rests_on_the_hill(rng):
    """No point nearby has a larger smoothed density."""
    catalog = sky(n=300, radius=3, kind="clustered", cluster_scale=0.7 * DEG, cluster_size=20)
    tiling = rs.place_tiles(catalog, radius=2 * DEG, fibers=10_000, method="density_gradient", n_tiles=1)

    def density(place):
        d = catalog.coord.separation(place).deg
        return np.exp(-0.5 * d[d <= 3] ** 2).sum()

    top = density(tiling.coord[0])
    around = tiling.coord[0].directional_offset_by(rng.uniform(0, 360, 200) * DEG, rng.uniform(0.05, 1, 200) * DEG)
    assert top >= max(density(place) for place in around) - 0.05


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(3))
def test_no_method_beats_the_optimum(seed):
    catalog = sky(n=11, radius=2, seed=seed)
    best = fewest_circles(catalog, np.deg2rad(1))
    for name in SEARCHES:
        tiling = rs.place_tiles(catalog, radius=1 * DEG, fibers=11, method=name, completeness=1)
        assert tiling.summary["completeness"] == 1
        assert len(tiling) >= best
        if name == "max_density":
            assert len(tiling) <= best + 1


@pytest.mark.few(3)
def test_completeness_ends_the_placing(method, stars):
    tiling = rs.place_tiles(stars, "lamost", fibers=40, method=method, completeness=0.9)
    assert 0.9 <= tiling.summary["completeness"] < 0.96
    assert tiling.table["completeness"][-1] >= 0.9
    if method != "network_flow":
        assert (tiling.table["completeness"][:-1] < 0.9).all()
    # at most 40 targets per tile
    assert 0.9 * len(stars) / 40 <= len(tiling) <= 1.3 * 0.9 * len(stars) / 40
    again = rs.place_tiles(stars, "lamost", fibers=40, method=method, completeness=0.9)
    np.testing.assert_array_equal(tiling.table["ra"], again.table["ra"])
    np.testing.assert_array_equal(tiling.table["n_new"], again.table["n_new"])


@pytest.mark.few(3)
def test_n_tiles_ends_the_placing(method):
    tiling = rs.place_tiles(sky(n=400, radius=5), radius=1 * DEG, fibers=100, method=method, n_tiles=4)
    assert len(tiling) == 4
    words = "4 tiles reach a completeness of 0.[0-9]+, not 0.99; n_tiles=4 allows no more"
    with pytest.warns(rs.RfpsurveyWarning, match=words):
        rs.place_tiles(sky(n=400, radius=5), radius=1 * DEG, fibers=100, method=method, n_tiles=4, completeness=0.99)


@pytest.mark.few(2)
@pytest.mark.parametrize("name", [name for name in SEARCHES if name not in ("network_flow", "max_density")])
def test_the_sky_has_no_edge(name):
    """At RA = 0, at the poles and elsewhere, the same targets require about the same number of tiles."""
    center = SkyCoord(123 * DEG, 45 * DEG)
    base = sky((123, 45), 4, 800, kind="clustered", cluster_scale=0.3 * DEG).coord
    angle, away = center.position_angle(base), center.separation(base)
    numbers = {}
    for place, where in PLACES.items():
        moved = SkyCoord(*where, unit="deg").directional_offset_by(angle, away)
        tiling = rs.place_tiles(moved, radius=1 * DEG, fibers=60, method=name, completeness=0.95)
        numbers[place] = len(tiling)
        assert tiling.summary["completeness"] >= 0.95
    assert max(numbers.values()) - min(numbers.values()) <= 0.12 * min(numbers.values()) + 1, numbers


def test_visits_take_as_many_tiles(method):
    catalog = sky(n=30, radius=0.2)
    options = {"completeness": 1} if method in ("hexagonal", "spiral", "network_flow") else {}
    tiling = rs.place_tiles(catalog, radius=1 * DEG, fibers=30, method=method, visits=3, **options)
    assert tiling.summary["n_observed"] == 90
    np.testing.assert_allclose(tiling.table["completeness"], replay(catalog, tiling, 1 * DEG, 3)[:, 2])
    if method in GREEDY:
        assert (tiling.table["n_new"].tolist(), tiling.table["pass"].tolist()) == ([30] * 3, [1, 2, 3])
    wanted = rs.Catalog(catalog.coord, visits=np.repeat([0, 1, 2], 10))
    assert rs.place_tiles(wanted, radius=1 * DEG, fibers=30, method=method, **options).summary["n_requested"] == 30


def test_priority_comes_first(method):
    catalog = sky(n=60, radius=0.3)
    priority = np.arange(60) % 3
    catalog = rs.Catalog(catalog.coord, priority=priority)
    serve = FreeFibers(20, priority.astype(float), None)
    assert sorted(priority[serve(None, np.arange(60), SimpleNamespace(chances=None))]) == [2] * 20
    tiling = rs.place_tiles(catalog, radius=1 * DEG, fibers=20, method=method, n_tiles=1)
    assert tiling.table["n_new"].tolist() == [20]


def test_pairs_too_close_take_two_tiles(method):
    ra = np.array([10, 10.01, 10.2, 10.4, 10.41, 10.42])
    coord = SkyCoord(ra * DEG, np.zeros(6) * DEG)
    options = {"n_tiles": 2} if method == "network_flow" else {"completeness": 1}
    tiling = rs.place_tiles(coord, radius=1 * DEG, fibers=rs.tiling.Fibers(6, 50 * u.arcsec), method=method, **options)
    # the first and the last of the three targets in a row are observed together
    assert (tiling.table["n_new"][0], tiling.summary["n_isolated"]) == (4, 1)
    assert tiling.summary["completeness_isolated"] == 1
    if method in GREEDY:
        assert tiling.table["n_new"].tolist() == [4, 2]


def test_network_flow_needs_fewer_tiles_than_the_lattice(stars):
    options = {"fibers": 250, "completeness": 0.95}
    lattice, network = (rs.place_tiles(stars, "lamost", method=m, **options) for m in ("hexagonal", "network_flow"))
    assert len(network) < len(lattice)


def test_network_flow_finds_the_fewest_tiles():
    """With one tile less, the completeness is not reached."""
    catalog, options = sky(n=300, radius=5, seed=0), {"radius": 1 * DEG, "fibers": 40, "method": "network_flow"}
    tiling = rs.place_tiles(catalog, completeness=0.95, **options)
    less = rs.place_tiles(catalog, n_tiles=len(tiling) - 1, **options)
    assert less.summary["completeness"] < 0.95 <= tiling.summary["completeness"]


def test_real_focal_planes_look_beside_a_hole():
    """The only target is out of reach of all positioners, and the tile is shifted slightly."""
    plane = rs.FocalPlane([[40.0, 0.0]] * u.mm, rs.Positioner(8 * u.mm, 17 * u.mm, 2 * u.mm))
    one = rs.Instrument("one", plane, plate_scale=60 * u.um / u.arcsec)
    tiling = rs.place_tiles(SkyCoord([10.0] * DEG, [5.0] * DEG), one, method="mean_shift", allocator="nearest")
    assert tiling.summary["completeness"] == 1


@pytest.mark.few(1)
@pytest.mark.parametrize("instrument", ["lamost", "moons"])
def test_a_real_focal_plane_serves_what_plan_tile_assigns(stars, instrument):
    near = stars.within(SkyCoord("6h20m +23d"), 3 * DEG)
    where = Centers(position_angle=20 * DEG)
    options = {"method": "max_density", "n_tiles": 2, "centers": where, "allocator": "lamost_rule"}
    kept = rs.tiling.Fibers(lost_in_collision=False)
    tiling = rs.place_tiles(near, instrument, fibers=kept, **options)
    tile = rs.plan_tile(near, instrument, tiling.coord[0], position_angle=20 * DEG, allocator="lamost_rule")
    assert tiling.table["n_new"][0] == tile.summary["n_assigned"]
    lost = rs.place_tiles(near, instrument, **options)
    n_lost = (tile.table["in_collision"] & (tile.table["kind"] == "science")).sum()
    assert lost.table["n_new"][0] == tile.summary["n_assigned"] - n_lost
    assert tiling.table["n_targets"][0] == tile.summary["n_in_field"]
    some = rs.place_tiles(near, instrument, method="max_density", allocator="lamost_rule", n_tiles=1, fibers=7)
    assert some.table["n_new"].tolist() == [7]


@pytest.mark.few(3)
def test_real_focal_planes_end(method):
    """The methods also end if positioners cannot reach every target of the last tiles."""
    catalog = sky(n=60, radius=0.6)
    tiling = rs.place_tiles(catalog, "moons", method=method, allocator="nearest")
    assert tiling.summary["completeness"] > 0.8
    if method not in ("hexagonal", "spiral"):  # a covering keeps all of its tiles
        assert (tiling.table["n_new"] > 0).all()


@pytest.mark.parametrize("covering", ["hexagonal", "spiral"])
def test_passes_that_are_asked_for_are_made(covering, stars):
    """Each pass covers all targets, although the fibers of one pass suffice for all of them."""
    tiling = rs.place_tiles(stars, radius=1 * u.deg, fibers=10_000, method=covering, passes=3)
    assert set(tiling.table["pass"]) == {1, 2, 3}
    for number in (1, 2, 3):
        centers = tiling.coord[tiling.table["pass"] == number]
        separation = stars.coord[:, None].separation(centers)
        assert separation.min(axis=1).max() <= 1 * u.deg
        assert separation.min(axis=0).max() <= 1 * u.deg  # no tile is empty
    assert tiling.summary["completeness"] == 1


@pytest.mark.few(2)
def test_centers_are_chosen_from_a_list(method, stars):
    near = stars.within(SkyCoord("6h20m +23d"), 5 * DEG)
    bright = near.coord[::15]
    # repeated positions of a star count once
    bright = SkyCoord(np.append(bright.ra, bright.ra), np.append(bright.dec, bright.dec))
    tiling = rs.place_tiles(near, "lamost", fibers=250, method=method, centers=bright, completeness=0.9)
    assert tiling.summary["completeness"] >= 0.9
    assert tiling.summary["n_on_tiles"] >= tiling.summary["n_observed"]
    assert max(c.separation(bright).min().arcsec for c in tiling.coord) < 1e-3


@pytest.mark.few(2)
def test_centers_too_few_are_a_warning(method):
    catalog = sky(n=100, radius=5)
    options = {"radius": 1 * DEG, "fibers": 100, "method": method}
    with pytest.warns(rs.RfpsurveyWarning, match="tiles reach a completeness of 0.[0-9]+, not 0.9"):
        tiling = rs.place_tiles(catalog, centers=catalog.coord[:3], completeness=0.9, **options)
    assert len(tiling) >= 1
    expected = np.min([catalog.coord.separation(c).deg for c in catalog.coord[:3]], axis=0) <= 1
    if method != "network_flow":
        assert tiling.summary["n_observed"] == expected.sum()


def test_no_center_near_any_target_is_a_warning(method):
    far = SkyCoord([200] * DEG, [-60] * DEG)
    with pytest.warns(rs.RfpsurveyWarning, match="no tile observes any target"):
        tiling = rs.place_tiles(sky(n=20), radius=1 * DEG, fibers=20, method=method, centers=far)
    assert len(tiling) == 0
    assert "n_new" in tiling.table.colnames


@pytest.mark.few(2)
def test_what_does_not_count(method):
    catalog = sky(n=200, radius=3)
    hole = rs.Region.parse("cap 95 23 1.5")
    tiling = rs.place_tiles(catalog, radius=1 * DEG, fibers=200, method=method, exclude=hole)
    assert tiling.summary["n_targets"] == (~hole.contains(catalog.coord)).sum()
    kinds = rs.Catalog(catalog.coord, kind=np.where(np.arange(200) % 4 == 0, "sky", "science"))
    assert rs.place_tiles(kinds, radius=1 * DEG, fibers=200, method=method).summary["n_targets"] == 150


@pytest.mark.few(7)
@pytest.mark.parametrize("coord", [[(5, 5)], [(5, 5)] * 7, [(0, 0), (180, 0)], [(10, 90), (0, -90), (0, 0)]])
def test_few_targets(method, coord):
    """All methods end for one target, for several equal targets, and for antipodal targets."""
    if method == "hexagonal" and len(set(coord)) > 1:
        pytest.skip("beyond a hemisphere")
    coord = SkyCoord(np.array(coord, dtype=float) * DEG)
    options = {"n_tiles": len(set(coord.ra.deg))} if method == "network_flow" else {}
    tiling = rs.place_tiles(coord, radius=2 * DEG, fibers=10, method=method, **options)
    assert tiling.table["n_new"].sum() > 0
    if method != "network_flow":
        assert tiling.summary["completeness"] == 1


NO_TARGET = "at least one science target that requires a visit and is not in a region of exclude"
BAD = {
    "unknown method to place tiles 'greedy'; choose one of: ": {"method": "greedy"},
    "completeness must be a number above 0 and at most 1, got 0": {"completeness": 0},
    "completeness must be a number above 0 and at most 1, got 95": {"completeness": 95},
    "n_tiles must be a whole number of at least 1": {"n_tiles": 0},
    "fibers must be a whole number of at least 1": {"fibers": 1.5},
    "an instrument or the number of fibers": {"fibers": None},
    "an instrument or the radius": {"radius": None},
    "an allocator needs the positioners of an instrument": {"allocator": "lamost_rule"},
    "visits must be one number or have the shape": {"visits": [1, 2]},
    "visits must be whole numbers from 1 to 255, got 0": {"visits": 0},
    NO_TARGET: {"visits": [0] * 20},
    f"{NO_TARGET}.*": {"exclude": rs.Region.whole_sky()},
    "unknown allocator 'magic'": {"instrument": "lamost", "allocator": "magic"},
    "min_separation must not be given with an allocator": {
        "instrument": "lamost",
        "allocator": "lamost_rule",
        "fibers": rs.tiling.Fibers(20, 1 * u.arcsec),
    },
    "centers must be a SkyCoord, a Tiling or a Table, got 5": {"centers": 5},
    "rng must be a seed": {"rng": -1},
}


def test_bad_requests_are_named():
    for message, options in BAD.items():
        with pytest.raises(rs.InputError, match=message):
            rs.place_tiles(sky(n=20), **{"radius": 1 * DEG, "fibers": 20, **options})
    with pytest.raises(rs.InputError, match="min_separation must be a Quantity"):
        rs.tiling.Fibers(20, 55)


def test_nothing_to_observe_is_an_error(small):
    with pytest.raises(rs.InputError, match="catalog must be a Catalog, SkyCoord, Table, DataFrame or Region, got 5"):
        rs.place_tiles(5, "lamost")
    dead = replace(small, focal_plane=replace(small.focal_plane, disabled=np.ones(len(small.focal_plane), bool)))
    with pytest.raises(rs.InputError, match="small must have at least one positioner that is not disabled or stuck"):
        rs.place_tiles(sky(n=20), dead)
    with pytest.raises(rs.InputError, match="the catalog must have at least one target with finite coordinates"):
        rs.place_tiles(SkyCoord([] * DEG, [] * DEG), "lamost")


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["max_density", "density_gradient", "mean_shift"])
def test_a_target_that_no_tile_can_serve_keeps_nobody_from_the_others(method):
    """The target is at the only center near it, inside the hole of the patrol area."""
    plane = rs.FocalPlane([[0, 0]] * u.mm, rs.Positioner(5 * u.mm, 8 * u.mm, 2 * u.mm))
    ring = rs.Instrument("ring", plane, plate_scale=200 * u.mm / u.deg)
    centers = SkyCoord([95, 100] * u.deg, [23, 23] * u.deg)
    targets = SkyCoord([centers[0], centers[1].directional_offset_by(0 * u.deg, 0.04 * u.deg)])
    tiling = rs.place_tiles(targets, ring, method=method, allocator="balanced", centers=centers)
    assert tiling.coord.ra.deg.tolist() == pytest.approx([100])
    assert (tiling.table["n_new"].tolist(), tiling.summary["n_observed"]) == ([1], 1)
