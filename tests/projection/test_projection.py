import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import FK5, Galactic, SkyCoord
from raising import refused
from scipy.optimize import brentq

import rfpsurvey as rs
from oracles import tangent_plane_mm

CENTERS = [(95, 23), (0, 0), (359.99, -45), (10, 90), (200, -90), (180, 89.9)]
ARCSEC = u.arcsec
MAPS = {
    "theta": rs.projection.RadialMap("theta", [243.02389, 4.05206956, 0.0300642306], max_angle=1.65 * u.deg),
    "tan_theta": rs.projection.RadialMap(
        "tan_theta", [256.668, 8.3145, -1.1717], max_angle=0.72 * u.deg, unit_tangent=0.014, factor=0.99995
    ),
    "sine": rs.projection.RadialMap("sine", [1.3658, 6.09425e-3, 6.5e-4], max_angle=1.5 * u.deg, radius=9208 * u.mm),
}


def around(center, radius_deg, n, rng):
    """Return points within a circle, computed by astropy."""
    r = radius_deg * np.sqrt(rng.random(n))
    return center.directional_offset_by(rng.uniform(0, 360, n) * u.deg, r * u.deg)


@pytest.mark.parametrize("position_angle", [0, 40, -137.5])
@pytest.mark.parametrize("center", CENTERS)
def test_agrees_with_astropy_wcs(center, position_angle, rng):
    center = SkyCoord(*center, unit="deg")
    coord = around(center, 2.5, 500, rng)
    plane = rs.projection.TangentPlane(center, 20 * u.m / u.rad, position_angle * u.deg)
    expected = tangent_plane_mm(coord, center, 20000 * np.pi / 180, position_angle)
    np.testing.assert_allclose(plane.to_focal_plane(coord).to_value(u.mm), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("distortion", [None, *MAPS])
@pytest.mark.parametrize("center", CENTERS)
def test_round_trip(center, distortion, rng):
    center, radial = SkyCoord(*center, unit="deg"), MAPS.get(distortion)
    scale = 20 * u.m / u.rad if radial is None else None
    plane = rs.projection.TangentPlane(center, scale, 17 * u.deg, radial)
    radius = 2.5 if radial is None else radial.max_angle.value * 0.9999
    coord = around(center, radius, 300, rng)
    back = plane.to_sky(plane.to_focal_plane(coord))
    assert back.separation(coord).to_value(ARCSEC).max() < 1e-8
    xy = plane.to_focal_plane(coord)
    np.testing.assert_allclose(plane.to_focal_plane(back).value, xy.value, atol=1e-9)


def test_position_angle_turns_y_from_north_toward_east():
    center = SkyCoord(30, 40, unit="deg")
    for angle in (0, 30, 90, 200):
        plane = rs.projection.TangentPlane(center, 200 * u.mm / u.deg, angle * u.deg)
        up = plane.to_focal_plane(center.directional_offset_by(angle * u.deg, 0.5 * u.deg))
        right = plane.to_focal_plane(center.directional_offset_by((angle + 90) * u.deg, 0.5 * u.deg))
        np.testing.assert_allclose(up.value, [[0, np.tan(np.deg2rad(0.5)) * 200 * 180 / np.pi]], atol=1e-9)
        np.testing.assert_allclose(right.value, [[np.tan(np.deg2rad(0.5)) * 200 * 180 / np.pi, 0]], atol=1e-9)


@pytest.mark.parametrize("frame", [FK5(equinox="J2026"), Galactic()])
def test_north_is_that_of_the_frame_of_the_center(frame):
    center = SkyCoord(269.59, 66.55, unit="deg").transform_to(frame)
    plane = rs.projection.TangentPlane(center, 200 * u.mm / u.deg, 40 * u.deg)
    up = plane.to_focal_plane(center.directional_offset_by(40 * u.deg, 1 * u.deg))
    np.testing.assert_allclose(up.value, [[0, np.tan(np.deg2rad(1)) * 200 * 180 / np.pi]], atol=1e-8)


def test_what_is_90_degrees_away_has_no_image():
    center = SkyCoord(10, 20, unit="deg")
    plane = rs.projection.TangentPlane(center, 200 * u.mm / u.deg)
    for angle in (0, 77, 180, 290):
        far = SkyCoord([center.directional_offset_by(angle * u.deg, r * u.deg) for r in (90, 90.001, 135, 180)])
        assert np.isnan(plane.to_focal_plane(far).value).all()
        near = center.directional_offset_by(angle * u.deg, 89.9 * u.deg)
        assert np.isfinite(plane.to_focal_plane(near).value).all()


def test_beyond_the_map_there_is_no_image():
    center = SkyCoord(10, 20, unit="deg")
    plane = rs.projection.TangentPlane(center, distortion=MAPS["sine"])
    inside, outside = (center.directional_offset_by(33 * u.deg, r * u.deg) for r in (1.4999, 1.5001))
    assert np.isfinite(plane.to_focal_plane(inside).value).all()
    assert np.isnan(plane.to_focal_plane(outside).value).all()
    assert np.isnan(plane.to_sky([[400, 0]] * u.mm).ra.value).all()


@pytest.mark.parametrize("form", MAPS)
def test_radial_map_keeps_the_azimuth_and_follows_the_formula(form, rng):
    radial = MAPS[form]
    theta, c = np.linspace(0, radial.max_angle.value, 50), radial.coefficients
    t = np.tan(np.deg2rad(theta)) / 0.014 if form == "tan_theta" else theta
    p = sum(ck * t ** (2 * k + 1) for k, ck in enumerate(c))
    expected = {"theta": p, "tan_theta": 0.99995 * p, "sine": 9208 * np.sin(np.deg2rad(p))}[form]
    np.testing.assert_allclose(radial.to_radius(theta * u.deg).value, expected, rtol=1e-13, atol=1e-12)
    center = SkyCoord(50, -30, unit="deg")
    xy = rs.projection.TangentPlane(center, distortion=radial).to_focal_plane(
        center.directional_offset_by(25 * u.deg, theta[1:] * u.deg)
    )
    np.testing.assert_allclose(np.arctan2(xy[:, 0], xy[:, 1]).to_value(u.deg), 25, atol=1e-9)
    np.testing.assert_allclose(np.hypot(*xy.T).value, expected[1:], rtol=1e-11)


@pytest.mark.parametrize("form", MAPS)
def test_inverse_of_the_radial_map_agrees_with_brentq(form):
    radial = MAPS[form]
    limit = radial.max_angle.value
    for r in np.linspace(0, radial.to_radius(radial.max_angle).value, 11)[1:-1]:
        theta = brentq(lambda a, r=r: radial.to_radius(a * u.deg).value - r, 0, limit, xtol=1e-15, rtol=1e-15)
        assert radial.to_angle(r * u.mm).value == pytest.approx(theta, rel=1e-13)


def test_a_map_that_turns_over_is_refused():
    with pytest.raises(rs.InputError, match="must increase from the center"):
        rs.projection.RadialMap("theta", [1, -1], max_angle=1 * u.deg)  # the radial map has a maximum at 0.577 deg
    rs.projection.RadialMap("theta", [1, -1], max_angle=0.57 * u.deg)


@pytest.mark.parametrize("tiny", [1e-320, -1e-320, 1e-310])
def test_subnormal_coefficients_have_no_effect(tiny):
    """Regression: a coefficient of 1e-320 ended in an error of NumPy."""
    maps = [rs.projection.RadialMap("theta", [243.0, 4.05, *end], max_angle=1.6 * u.deg) for end in ([], [tiny])]
    assert maps[0].to_radius(1.5 * u.deg) == maps[1].to_radius(1.5 * u.deg)
    refused("the radial map must increase", rs.projection.RadialMap, "theta", [1, -1, tiny], max_angle=1 * u.deg)
    with pytest.raises(rs.InputError, match="must increase"):
        # the sine form is not defined beyond 90 deg
        rs.projection.RadialMap("sine", [60.0], max_angle=1.6 * u.deg, radius=1 * u.m)
    refused("must increase", rs.projection.RadialMap, "theta", [-1.0], max_angle=1 * u.deg)


def test_each_fiber_type_has_its_map():
    center = SkyCoord(10, 20, unit="deg")
    both = rs.projection.TangentPlane(center, distortion={"BOSS": MAPS["sine"], "APOGEE": MAPS["theta"]})
    coord = center.directional_offset_by([10, 20, 30] * u.deg, [0.5, 0.6, 0.7] * u.deg)
    got = both.to_focal_plane(coord, ["BOSS", "APOGEE", ""])
    for k, name in enumerate(("sine", "theta", "sine")):
        alone = rs.projection.TangentPlane(center, distortion=MAPS[name]).to_focal_plane(coord)
        np.testing.assert_array_equal(got[k].value, alone[k].value)
    assert both.to_sky(got, ["BOSS", "APOGEE", ""]).separation(coord).to_value(ARCSEC).max() < 1e-8
    refused("unknown fiber type 'X'; choose one of: APOGEE, BOSS", both.to_focal_plane, coord, "X")


def test_focal_length_is_another_way_to_say_plate_scale():
    plane = rs.projection.TangentPlane.from_focal_length(SkyCoord(1, 2, unit="deg"), 20 * u.m)
    assert plane.plate_scale.to_value(u.mm / u.deg) == pytest.approx(349.0658504)


BAD_INPUT = [
    ({"plate_scale": 17.5}, "plate_scale must be a Quantity with a unit convertible to mm / rad, got 17.5"),
    ({"plate_scale": 5 * u.mm}, "plate_scale must have a unit convertible to mm / rad, got mm"),
    ({"plate_scale": -5 * u.mm / u.deg}, "plate_scale must be one finite value above 0 mm / rad, got -5"),
    ({}, "requires plate_scale or distortion"),
    ({"distortion": "no"}, "distortion must be a RadialMap, a DistortionMap, or a dict"),
    ({"plate_scale": 1 * u.mm / u.deg, "distortion": MAPS["theta"]}, "must be the plate scale of the distortion"),
    ({"plate_scale": 1 * u.mm / u.deg, "rotation": 5}, "rotation must be a Quantity"),
    ({"plate_scale": 1 * u.mm / u.deg, "rotation": [5, 6] * u.deg}, "rotation must be one value, got the shape"),
    ({"plate_scale": 1 * u.mm / u.deg, "rotation": np.nan * u.deg}, "rotation must be one finite value"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_INPUT)
def test_bad_input_is_named(arguments, message):
    refused(message, lambda: rs.projection.TangentPlane(SkyCoord(0, 0, unit="deg"), **arguments))


BAD_MAPS = [
    ({"max_angle": 90 * u.deg}, "max_angle must be one finite value above 0 rad and below 1.5708 rad"),
    ({"unit_angle": 0 * u.deg}, "unit_angle must be one finite value above 0"),
    ({"unit_tangent": -1.0}, "unit_tangent must be one finite value above 0"),
    ({"factor": np.nan}, "factor must be one finite value above 0"),
    ({"coefficients": 5}, "coefficients must be a sequence of numbers"),
    ({"coefficients": []}, "coefficients must be one or more finite numbers"),
    ({"form": "cubic"}, "unknown form of radial map 'cubic'; choose one of: sine, tan_theta, theta"),
    ({"form": "sine"}, "radius must be given for the form 'sine' and only for this form"),
    ({"form": "sine", "radius": -9 * u.m}, "radius must be one finite value above 0 mm"),
    ({"form": "sine", "radius": 1 * u.m, "coefficients": [-100]}, "must increase from the center"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD_MAPS)
def test_bad_maps_are_named(arguments, message):
    good = {"form": "theta", "coefficients": [200.0], "max_angle": 1 * u.deg}
    refused(message, lambda: rs.projection.RadialMap(**{**good, **arguments}))


def test_distances_and_representations_do_not_matter(rng):
    """Regression: rows without a valid parallax were lost, and a center in cartesian coordinates raised an error."""
    center = SkyCoord(10, 20, unit="deg")
    coord = around(center, 2, 4, rng)
    plane = rs.projection.TangentPlane(center, 200 * u.mm / u.deg, 10 * u.deg)
    expected = plane.to_focal_plane(coord)
    for frame in ("icrs", "galactic", "fk5"):
        other = coord.transform_to(frame)
        lon, lat = other.spherical.lon, other.spherical.lat
        far = SkyCoord(lon, lat, distance=[np.nan, np.inf, 1, 0] * u.pc, frame=frame)
        np.testing.assert_allclose(plane.to_focal_plane(far).value, expected.value, atol=1e-9)
    cartesian = SkyCoord(center, representation_type="cartesian")
    again = rs.projection.TangentPlane(cartesian, 200 * u.mm / u.deg, 10 * u.deg)
    np.testing.assert_allclose(again.to_focal_plane(coord).value, expected.value, atol=1e-9)


def test_center_must_be_one_coordinate():
    refused("center must be a SkyCoord, got", rs.projection.TangentPlane, (0, 0), 1 * u.mm / u.deg)
    with pytest.raises(rs.InputError, match="coord must be a SkyCoord"):
        rs.projection.TangentPlane(SkyCoord(0, 0, unit="deg"), 1 * u.mm / u.deg).to_focal_plane([1, 2])


@pytest.mark.parametrize("form", MAPS)
def test_the_center_of_a_distorted_field_has_an_image(form):
    for place in ((10, 20), (0, 0)):  # at (0, 0), the field angle is exactly 0
        center = SkyCoord(*place, unit="deg")
        plane = rs.projection.TangentPlane(center, distortion=MAPS[form])
        np.testing.assert_allclose(plane.to_focal_plane(center).value, [[0, 0]], atol=1e-9)
        assert plane.to_sky([[0, 0]] * u.mm).separation(center)[0].to_value(ARCSEC) < 1e-8
    assert np.isnan(MAPS[form].to_radius([-0.1] * u.deg).value).all()


def test_units_of_a_map_and_rotation_of_a_focal_length():
    in_deg = rs.projection.RadialMap("theta", [200.0, 3.0], max_angle=1 * u.deg)
    in_arcmin = rs.projection.RadialMap(
        "theta", [200.0 / 60, 3.0 / 60**3], max_angle=1 * u.deg, unit_angle=1 * u.arcmin
    )
    for angle in (0.1, 0.7, 1.0):
        assert in_arcmin.to_radius(angle * u.deg).value == pytest.approx(in_deg.to_radius(angle * u.deg).value)
    # the radial map has a maximum at tan(theta) = 0.577, theta = 30 deg
    refused("must increase", rs.projection.RadialMap, "tan_theta", [1, -1], max_angle=30.1 * u.deg)
    rs.projection.RadialMap("tan_theta", [1, -1], max_angle=29.9 * u.deg)
    center = SkyCoord(1, 2, unit="deg")
    turned = rs.projection.TangentPlane.from_focal_length(center, 20 * u.m, 90 * u.deg)
    east = turned.to_focal_plane(center.directional_offset_by(90 * u.deg, 1 * u.deg))
    np.testing.assert_allclose(east.value, [[0, 20000 * np.tan(np.deg2rad(1))]], atol=1e-8)


def test_fiber_types_must_be_as_many_as_targets(presets):
    projection = presets["sdss_apo"].projection(SkyCoord(95, 23, unit="deg"))
    assert isinstance(projection.distortion, dict)
    with pytest.raises(rs.InputError, match=r"fiber_type must have the shape \(2,\), got \(1,\)"):
        projection.to_focal_plane(SkyCoord([95, 95.1], [23, 23], unit="deg"), fiber_type=["BOSS"])
