from functools import partial

import astropy.units as u
import numpy as np
import pytest
import shapely
from astropy.coordinates import SkyCoord
from astropy_healpix import HEALPix
from raising import refused

import rfpsurvey as rs
from rfpsurvey._sky import shapes as _healpix
from rfpsurvey._sky.shapes import circle_around, distance_to, is_inside

DEG = u.deg


def everywhere(n, seed=1):
    """Return random directions on the sphere."""
    rng = np.random.default_rng(seed)
    return SkyCoord(rng.uniform(0, 360, n) * DEG, np.rad2deg(np.arcsin(rng.uniform(-1, 1, n))) * DEG)


def gnomonic(coord, center):
    """Return gnomonic positions, in which great circles are straight lines; NaN on the opposite hemisphere."""
    x, y, z = coord.transform_to(center.skyoffset_frame()).cartesian.xyz.value
    x = np.where(x > 0.05, x, np.nan)
    return np.column_stack([y / x, z / x])


REGIONS = {
    "cap": "cap 3 -5 12",
    "cap at the pole": "cap 0 90 20",
    "more than a hemisphere": "cap 120 30 130",
    "box": "box 180 240 25 45",
    "box over zero": "box 350 10 -20 20",
    "box to the pole": "box 30 90 60 90",
    "ring": "box 0 360 -10 10",
    "cap as a box": "box 0 360 70 90",
    "octant": "polygon 0 0 90 0 0 90",
    "over zero": "polygon 350 -5 10 -5 0 15",
    "around the pole": "polygon 0 80 90 80 180 80 270 80",
    "not convex": "polygon 10 0 40 0 40 30 25 5 10 30",
    "half around": "polygon 0 0 60 0 120 0 180 0 240 0 240 20 180 20 120 20 60 20 0 20",
    "sky": "sky",
}


@pytest.mark.parametrize("text", REGIONS.values(), ids=REGIONS.keys())
def test_the_area_is_the_share_of_random_directions(text):
    region = rs.Region.parse(text)
    share = region.contains(everywhere(50_000)).mean()
    expected = (region.area / (4 * np.pi * u.sr)).to_value("")
    assert share == pytest.approx(expected, abs=4 * np.sqrt(abs(expected * (1 - expected)) / 50_000) + 1e-12)


def test_areas_in_closed_form():
    assert rs.Region.whole_sky().area.to_value(u.sr) == pytest.approx(4 * np.pi)
    assert rs.Region.parse("polygon 0 0 90 0 0 90").area.to_value(u.sr) == pytest.approx(np.pi / 2)
    assert rs.Region.parse("box 0 360 0 90").area.to_value(u.sr) == pytest.approx(2 * np.pi)
    tiny = rs.Region.parse("polygon 10 20 10.0001 20 10.0001 20.0001 10 20.0001").area
    assert tiny.to_value(u.deg**2) == pytest.approx(1e-8 * np.cos(np.deg2rad(20.00005)), rel=1e-6)
    assert rs.Region.healpix([0, 5, 5], 4).area.to_value(u.sr) == pytest.approx(2 * 4 * np.pi / 192)
    assert rs.Region.cap(SkyCoord(0 * DEG, 0 * DEG), 1 * u.arcsec).area.to_value(u.arcsec**2) == pytest.approx(np.pi)


@pytest.mark.parametrize("center", [(0, 0), (120, 35), (0, 89), (359.9, -60)])
@pytest.mark.parametrize("reverse", [False, True])
def test_polygons_agree_with_shapely(center, reverse, rng):
    """The comparison uses gnomonic positions, stars with 9 points, and 3000 directions."""
    center = SkyCoord(*center, unit="deg")
    corners = center.directional_offset_by(np.arange(18) * 20 * DEG, np.tile([20, 6], 9) * DEG)
    corners = corners[::-1] if reverse else corners
    region = rs.Region.polygon(corners)
    points = center.directional_offset_by(rng.uniform(0, 360, 3000) * DEG, rng.uniform(0, 40, 3000) * DEG)
    flat = shapely.Polygon(gnomonic(corners, center))
    expected = shapely.contains(flat, shapely.points(gnomonic(points, center)))
    assert 300 < expected.sum() < 2500
    np.testing.assert_array_equal(region.contains(points), expected)
    assert not region.contains(center.directional_offset_by(0 * DEG, 180 * DEG))[0]


def test_boxes_agree_with_right_ascension_and_declination(rng):
    points = everywhere(20_000)
    for _ in range(20):
        a, b = rng.uniform(0, 360, 2)
        c, d = np.sort(rng.uniform(-90, 90, 2))
        inside, ra = (points.dec.deg >= c) & (points.dec.deg <= d), points.ra.deg
        inside &= (ra >= a) & (ra <= b) if a < b else (ra >= a) | (ra <= b)
        region = rs.Region.box(ra=(a * DEG, b * DEG), dec=(c * DEG, d * DEG))
        np.testing.assert_array_equal(region.contains(points), inside)
    assert rs.Region.parse("box 10 20 80 90").contains(SkyCoord(200 * DEG, 90 * DEG))[0]


def test_pixels_agree_with_astropy_healpix():
    points, pixels = everywhere(20_000), np.arange(50, 90)
    for order in ("nested", "ring"):
        expected = np.isin(HEALPix(8, order=order, frame="icrs").skycoord_to_healpix(points), pixels)
        np.testing.assert_array_equal(rs.Region.healpix(pixels, 8, order=order).contains(points), expected)


@pytest.mark.few(3)
@pytest.mark.parametrize("text", REGIONS.values(), ids=REGIONS.keys())
def test_distances_and_the_circle_around(text):
    """Compare with the nearest of many directions inside the region."""
    from scipy.spatial import cKDTree

    region, points = rs.Region.parse(text), everywhere(300_000)
    xyz, inside = points.cartesian.xyz.value.T, region.contains(points)
    center, radius = circle_around(region)
    assert (2 * np.arcsin(np.minimum(np.linalg.norm(xyz[inside] - center, axis=1) / 2, 1)) <= radius + 1e-9).all()
    distance = distance_to(region, xyz[:2000])
    near = 2 * np.arcsin(np.minimum(cKDTree(xyz[inside]).query(xyz[:2000])[0] / 2, 1))
    assert (distance <= near + 1e-9).all()
    assert (distance >= near - np.deg2rad(1.5)).all()
    assert (distance[inside[:2000]] == 0).all()
    assert (distance[~inside[:2000]] > 0).all()


def test_samples_are_the_pixels_inside():
    hp = HEALPix(64, order="nested", frame="icrs")
    centers = hp.healpix_to_skycoord(np.arange(hp.npix))
    # the edges of the octant contain centers of pixels
    shapes = [rs.Region.parse(text) for name, text in REGIONS.items() if name != "octant"]
    for region in (*shapes, rs.Region.healpix([3, 700], 8), rs.Region.healpix([5], 256)):
        near = _healpix.centers(64, _healpix.pixels_near(64, partial(distance_to, region), 0.0))
        assert is_inside(region, near).sum() == region.contains(centers).sum()


BAD_REGIONS = [
    (lambda: rs.Region.parse("circle 1 2 3"), "unknown kind of region 'circle'; choose one of: box, cap, polygon"),
    (lambda: rs.Region.parse("cap 1 2"), "must have the form 'cap RA DEC RADIUS'"),
    (lambda: rs.Region.parse("box 1 2 3 x"), "must have the form 'box RA1 RA2 DEC1 DEC2'"),
    (lambda: rs.Region.parse("cap 1 92 3"), "declinations must lie between"),
    (lambda: rs.Region.parse(""), "unknown kind of region ''"),
    (lambda: rs.Region.parse("box 1 2 30 20"), "dec must be .lower, upper., got .30, 20. deg"),
    (lambda: rs.Region.parse("box 5 5 0 20"), "ra must be two different angles that are at most 360 deg apart"),
    (lambda: rs.Region.parse("box 5 6 0 91"), "dec must be one finite value"),
    (lambda: rs.Region.parse("polygon 0 0 1 1"), "at least 3 vertices, got 2"),
    (lambda: rs.Region.parse("polygon 0 0 10 10 10 0 0 10"), "cross or touch"),
    (lambda: rs.Region.parse("polygon 0 0 10 0 10 10 5 0 0 10"), "cross or touch"),
    (lambda: rs.Region.parse("polygon 0 0 10 0 10 0 5 5"), "vertices 2 and 3 of the polygon are the same"),
    (lambda: rs.Region.parse("polygon 0 0 180 0 10 20"), "are opposite"),
    (lambda: rs.Region.box(ra=(1, 2), dec=(1 * DEG, 2 * DEG)), "ra must be a Quantity"),
    (lambda: rs.Region.box(ra=1 * DEG, dec=(1 * DEG, 2 * DEG)), "ra must be two angles"),
    (lambda: rs.Region.cap(SkyCoord([1, 2] * DEG, [3, 4] * DEG), 1 * DEG), "center must be one direction"),
    (lambda: rs.Region.cap(SkyCoord(1 * DEG, 3 * DEG), 1 * u.mm), "radius must have a unit convertible to deg"),
    (lambda: rs.Region.healpix([], 8), "one or more whole numbers"),
    (lambda: rs.Region.healpix([768], 8), "pixels must be from 0 to 767"),
    (lambda: rs.Region.healpix([1], 6), "power of two"),
    (lambda: rs.Region.healpix([1], 8, "nest"), "unknown order of pixels 'nest'"),
]


@pytest.mark.parametrize(("make", "message"), BAD_REGIONS)
def test_bad_regions_are_named(make, message):
    refused(message, make)


def test_the_circle_around_the_whole_sky_has_a_radius_of_180_deg():
    center, radius = circle_around(rs.Region.parse("box 0 360 -90 90"))
    assert radius == np.pi
    assert np.linalg.norm(center) == pytest.approx(1)
