"""Projection under observing conditions."""

import astropy.units as u
import erfa
import numpy as np
import pytest
from astropy.coordinates import AltAz, EarthLocation, SkyCoord
from astropy.time import Time
from astropy.utils import iers
from raising import refused

import rfpsurvey as rs
from rfpsurvey._sky.conditions import SITES
from rfpsurvey._sky.projection import field_basis
from rfpsurvey.observing import ObservedField, ObservedPlane
from rfpsurvey.projection import FieldProjection

TIME = Time("2024-05-10T05:00:00")
EAST = 3 * u.hourangle
MAS = np.deg2rad(1 / 3.6e6)


@pytest.fixture(autouse=True)
def offline():
    """Let also the reference implementation work without the network."""
    with iers.conf.set_temp("auto_download", False):
        yield


def around(center, radius, n=60, seed=1):
    """Return unit vectors of random directions within a radius (rad) of a unit vector."""
    rng, x = np.random.default_rng(seed), np.cross(center, [0.6, 0.48, 0.64])
    x /= np.linalg.norm(x)
    y = np.cross(center, x)
    r, turn = np.tan(radius) * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    vectors = center + r[:, None] * (np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * y)
    return vectors / np.linalg.norm(vectors, axis=1)[:, None]


def to_coord(vectors):
    return SkyCoord(*vectors.T, representation_type="cartesian", frame="icrs")


def local(altaz):
    """Return unit vectors in the frame east, north, zenith."""
    az, alt = altaz.az.rad, altaz.alt.rad
    return np.column_stack([np.cos(alt) * np.sin(az), np.cos(alt) * np.cos(az), np.sin(alt)])


def conditions_at(time=TIME, **changes):
    given = {"wavelength": 0.4 * u.um, "guide_wavelength": 0.65 * u.um, "temperature": 5 * u.deg_C, "humidity": 0.3}
    return rs.ObservingConditions("apache point", time=time, **{**given, **changes})


def sdssv_conditions(scale="tai"):
    """Return the conditions of a configuration of 2024."""
    waves = {"wavelength": {"BOSS": 0.54 * u.um, "APOGEE": 1.6 * u.um}, "guide_wavelength": 0.6231 * u.um}
    site = EarthLocation.from_geodetic(-105.820278 * u.deg, 32.7802778 * u.deg, 2788 * u.m)
    time = Time(2460427.0, format="jd", scale=scale)
    return rs.ObservingConditions(site, time=time, pressure=720 * u.hPa, temperature=5 * u.deg_C, **waves)


def frame_of(conditions, wavelength):
    return AltAz(
        obstime=conditions.time,
        location=conditions.site,
        pressure=conditions.pressure,
        temperature=conditions.temperature,
        relative_humidity=conditions.humidity,
        obswl=wavelength,
    )


@pytest.mark.few(3)
@pytest.mark.parametrize("altitude", [5, 15, 30, 60, 85, 89.9, 90])
@pytest.mark.parametrize("azimuth", [0, 130])
def test_differential_refraction_agrees_with_astropy_to_1_mas(altitude, azimuth):
    conditions = conditions_at()
    place = AltAz(az=azimuth * u.deg, alt=altitude * u.deg, obstime=TIME, location=conditions.site)
    check_against_astropy(conditions, SkyCoord(place).icrs)


@pytest.mark.parametrize("dec", [90, 89.99, -20, 0])
def test_fields_at_the_pole_and_elsewhere_agree_with_astropy_to_1_mas(dec):
    check_against_astropy(conditions_at(), SkyCoord(200 * u.deg, dec * u.deg))


def check_against_astropy(conditions, center):
    basis = field_basis(center.ra.rad, center.dec.rad, 0.3)
    targets, field = around(basis[2], np.deg2rad(1.6)), ObservedField(basis, 1.0, None, conditions)
    xy = field.project(targets)
    seen = local(to_coord(targets).transform_to(frame_of(conditions, conditions.wavelength)))
    middle = local(to_coord(basis[2:]).transform_to(frame_of(conditions, conditions.guide_wavelength)))[0]
    # the angle from the observed center, and the angles between targets
    angle = np.arctan2(np.linalg.norm(np.cross(seen, middle), axis=1), seen @ middle)
    np.testing.assert_allclose(np.arctan(np.hypot(*xy.T)), angle, rtol=0, atol=MAS)
    flat = seen / (seen @ middle)[:, None] - middle
    turn = np.angle(np.vdot(flat @ field.frames[0][0] + 1j * (flat @ field.frames[0][1]), xy @ [1, 1j]))
    ours, theirs = xy @ [1, 1j], flat @ field.frames[0][0] + 1j * (flat @ field.frames[0][1])
    np.testing.assert_allclose(abs(turn), 0, atol=1e-9)
    np.testing.assert_allclose(np.abs(ours - theirs), 0, atol=MAS)


@pytest.mark.parametrize(("hour", "dec"), [(0, 0.6), (3, 0.4), (-5, 1.2), (2, np.pi / 2), (-1, -0.3), (4.8, 0.3)])
def test_refraction_at_an_hour_angle_is_that_of_spherical_trigonometry(hour, dec):
    """The reference shifts each direction toward the zenith by the exact solution of the formula of refraction.

    ERFA solves it approximately, which is not exact to 1 mas below an altitude of about 10 deg.
    """
    conditions = rs.ObservingConditions("kitt peak", hour_angle=hour * u.hourangle, wavelength=0.6 * u.um)
    a, b = erfa.refco(conditions.pressure.value, 10.0, 0.2, 0.6)
    latitude, basis = conditions.site.lat.rad, field_basis(0.7, dec, 0.0)
    targets, zenith_lon = around(basis[2], 0.02), 0.7 + np.deg2rad(15 * hour)
    zenith = np.array([np.cos(latitude) * np.cos(zenith_lon), np.cos(latitude) * np.sin(zenith_lon), np.sin(latitude)])

    def raised(vectors):
        distance = np.arccos(vectors @ zenith)
        lower = distance
        for _ in range(50):  # the formula is in the observed zenith distance
            lower = distance - a * np.tan(lower) - b * np.tan(lower) ** 3
        up = zenith - (vectors @ zenith)[:, None] * vectors
        up /= np.linalg.norm(up, axis=1)[:, None]
        shift = (distance - lower)[:, None]
        return np.cos(shift) * vectors + np.sin(shift) * up

    seen, middle = raised(targets), raised(basis[2:])[0]
    ours = np.arctan(np.hypot(*ObservedField(basis, 1.0, None, conditions).project(targets).T))
    np.testing.assert_allclose(ours, np.arccos(seen @ middle), rtol=0, atol=MAS)


@pytest.mark.parametrize(
    ("distance", "refraction", "error"),
    [(20, 21.19, 0.02), (45, 58.16, 0.03), (60, 100.51, 0.04), (74, 200.35, 0.06), (80, 319.13, 0.7)],
)
def test_refraction_is_that_of_a_ray_trace(distance, refraction, error):
    """The reference values are those of Hohenkerk and Sinclair (1985), in arcsec, by observed zenith distance."""
    site = EarthLocation.from_geodetic(0 * u.deg, 50 * u.deg, 0 * u.m)
    true = np.deg2rad(distance + refraction / 3600)
    conditions = rs.ObservingConditions(
        site,
        hour_angle=0 * u.deg,
        wavelength=0.574 * u.um,
        pressure=1005 * u.hPa,
        temperature=280.15 * u.K,
        humidity=0.8,
    )
    field = ObservedField(field_basis(1.0, site.lat.rad - true, 0.0), 1.0, None, conditions)
    assert abs(np.rad2deg(np.arccos(field.frames[0][2, 2])) - distance) < error / 3600


def test_without_air_the_projection_is_the_static_one(presets):
    for name, kind in (("lamost", None), ("sdss_apo", "APOGEE")):
        conditions = rs.ObservingConditions("apache point", hour_angle=EAST, pressure=0 * u.hPa)
        targets = around(field_basis(1.0, 0.9, 0.4)[2], 0.02)
        static = presets[name].field_projection(1.0, 0.9, 0.4).project(targets, kind)
        seen = presets[name].field_projection(1.0, 0.9, 0.4, conditions).project(targets, kind)
        np.testing.assert_allclose(seen, static, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", rs.available_instruments())
@pytest.mark.parametrize("hours", [0, 4.2])
def test_the_round_trip_is_exact_and_the_center_stays(presets, name, hours):
    instrument = presets[name]
    waves = {kind: (0.5 + 0.3 * k) * u.um for k, kind in enumerate(instrument.focal_plane.fiber_types)}
    first = next(iter(waves.values()))
    conditions = rs.ObservingConditions(
        "kitt peak",
        hour_angle=hours * u.hourangle,
        wavelength=waves,
        guide_wavelength=first,
        exposure_time=20 * u.min,
        projection="full",
    )
    center = field_basis(5.0, 0.5, 1.0)[2]
    field = instrument.field_projection(5.0, 0.5, 1.0, conditions)
    vectors = around(center, 0.95 * instrument.field_radius.to_value(u.rad))
    for kind in instrument.focal_plane.fiber_types:
        xy = field.project(vectors, kind)
        np.testing.assert_allclose(field.project(field.unproject(xy, kind), kind), xy, rtol=0, atol=1e-9)
    np.testing.assert_allclose(field.project(center[None], next(iter(waves))), 0, atol=1e-4)


def test_fiber_types_are_displaced_by_dispersion_toward_the_zenith(presets):
    waves = {"BOSS": 0.4 * u.um, "APOGEE": 1.6 * u.um}
    conditions = conditions_at(wavelength=waves, guide_wavelength=0.4 * u.um)
    moved = ObservedField(field_basis(3.5, 0.1, 0.0), 1e6, None, conditions)
    center = moved.basis[2:]
    blue, red = moved.project(center, "BOSS")[0], moved.project(center, "APOGEE")[0]
    np.testing.assert_allclose(blue, 0, atol=1e-4)
    seen = [to_coord(center).transform_to(frame_of(conditions, wave)).alt.rad[0] for wave in (0.4 * u.um, 1.6 * u.um)]
    assert seen[0] > seen[1]
    zenith = moved.frames[0][:2, 2] / np.hypot(*moved.frames[0][:2, 2])
    np.testing.assert_allclose(red, -zenith * np.tan(seen[0] - seen[1]) * 1e6, atol=1e-3)
    types = np.array(["APOGEE", "", "BOSS"])
    np.testing.assert_allclose(moved.project(np.repeat(center, 3, axis=0), types), [red, blue, blue], atol=1e-9)


@pytest.mark.parametrize("when", [{"time": TIME}, {"hour_angle": EAST}])
def test_the_field_does_not_rotate_in_the_mean(when):
    conditions, basis = rs.ObservingConditions("apache point", **when), field_basis(3.3, 0.4, 0.5)
    turn = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    targets = basis[2] + 1e-3 * (np.cos(turn)[:, None] * basis[0] + np.sin(turn)[:, None] * basis[1])
    targets /= np.linalg.norm(targets, axis=1)[:, None]
    xy = ObservedField(basis, 1e5, None, conditions).project(targets) @ [1, 1j]
    still = FieldProjection(basis, 1e5).project(targets) @ [1, 1j]
    assert abs(np.angle(np.vdot(still, xy))) < 1e-9
    assert np.abs(xy - still).max() > 1e-3


def test_an_exposure_gives_the_mean_positions(presets):
    """The positions at an instant are those of another hour angle; the reference has many instants."""
    basis = field_basis(0.2, 0.3, 0.0)
    targets = around(basis[2], 0.02)

    def at(hours, **more):
        return ObservedField(
            basis, 1e4, None, rs.ObservingConditions("paranal", hour_angle=hours * u.hourangle, **more)
        )

    long, rate = at(3.0, exposure_time=1 * u.hour).project(targets), 1.00273781191135448
    moments = (np.arange(40) + 0.5) / 40 - 0.5
    mean = np.mean([at(3.0 + rate * moment).project(targets) for moment in moments], axis=0)
    np.testing.assert_allclose(long, mean, rtol=0, atol=2e-5)
    assert np.abs(long - at(3.0).project(targets)).max() > 1e-4


def test_the_plane_states_altitude_azimuth_and_rotation():
    conditions, center = conditions_at(exposure_time=30 * u.min), SkyCoord("14h +52d")
    plane = rs.Instrument.preset("sdss_apo").projection(center, 30 * u.deg, conditions)
    assert isinstance(plane, ObservedPlane)
    seen = center.transform_to(frame_of(conditions, conditions.guide_wavelength))
    assert abs(plane.altitude - seen.alt) < 1e-6 * u.deg
    assert abs(plane.azimuth - seen.az) < 1e-6 * u.deg
    zenith = SkyCoord(AltAz(az=0 * u.deg, alt=90 * u.deg, obstime=TIME, location=conditions.site)).icrs
    assert abs(plane.parallactic_angle - center.position_angle(zenith).wrap_at(180 * u.deg)) < 0.02 * u.deg
    angles = [
        rs.Instrument.preset("sdss_apo").projection(center, conditions=conditions_at(TIME + dt)).parallactic_angle
        for dt in (-15 * u.min, 15 * u.min)
    ]
    change = (angles[1] - angles[0]).wrap_at(180 * u.deg)
    assert abs(plane.field_rotation - change) < 0.02 * abs(change)
    back = plane.to_sky(plane.to_focal_plane(SkyCoord(["14h +52.5d"])), "BOSS")
    assert back.separation(SkyCoord("14h +52.5d"))[0] < 1e-9 * u.deg


def test_the_inverse_needs_few_steps(presets):
    """Regression: the steps continued as long as rounding errors were not exactly 0."""
    conditions = rs.ObservingConditions("xinglong", hour_angle=2 * u.hourangle, exposure_time=15 * u.min)
    field = presets["lamost"].projection(SkyCoord("6h20m +23d"), conditions=conditions).plain
    calls, original = [], field._observe
    field._observe = lambda *arguments: calls.append(1) or original(*arguments)
    field.unproject(presets["lamost"].focal_plane.arrays.xy)
    assert 3 < len(calls) < 12


def test_the_radius_of_a_plane_is_0_by_default():
    """A field whose center is just above the horizon is allowed if its radius is unknown."""
    center, plate = SkyCoord(0 * u.deg, 0 * u.deg), {"plate_scale": 1 * u.mm / u.deg}
    conditions = rs.ObservingConditions("paranal", hour_angle=89.6 * u.deg)
    assert 0 * u.deg < ObservedPlane(center, **plate, conditions=conditions).altitude < 1 * u.deg
    refused("above the horizon", lambda: ObservedPlane(center, **plate, conditions=conditions, field_radius=1 * u.deg))
    for radius in (-1 * u.deg, 91 * u.deg):
        with pytest.raises(rs.InputError, match="field_radius must be"):
            ObservedPlane(center, **plate, conditions=conditions, field_radius=radius)


def similarity(xy, other):
    """Return the distances that remain after the best shift, rotation and scale, and the scale and the angle."""
    a, b = xy @ [1, 1j], other @ [1, 1j]
    a, b = a - a.mean(), b - b.mean()
    factor = np.vdot(a, b) / np.vdot(a, a)
    return np.abs(factor * a - b), abs(factor), np.angle(factor)


@pytest.mark.few(1)
@pytest.mark.parametrize("scale", ["tai", "utc"])
def test_positions_of_a_sdssv_configuration_are_reproduced(real_data, scale):
    from rfpsurvey.plans import read_plan

    folder = real_data("sdssv_apo_2024")
    plan = read_plan(folder / "confSummary-test.par.gz")
    instrument, conditions = rs.Instrument.from_sdssv(folder), sdssv_conditions(scale)
    site, center = conditions.site, SkyCoord(plan.meta["racen"], plan.meta["deccen"], unit="deg")
    for kind, n, bound in (("BOSS", 483, 0.003), ("APOGEE", 7, 0.01)):
        part = plan[((np.asarray(plan["fiber_type"]) == kind) & (np.asarray(plan["on_target"]) == 1))]
        assert len(part) == n
        targets = SkyCoord(part["ra_fiber"], part["dec_fiber"], unit="deg")
        wok = np.column_stack([part["x"].to_value("mm"), part["y"].to_value("mm")])
        seen = instrument.projection(center, conditions=conditions).to_focal_plane(targets, kind)
        left, factor, angle = similarity(seen.value, wok)

        assert left.max() < bound
        assert abs(factor - 1) < 3e-4
        # position angles of the file are measured at the refracted place, from the pole of date without refraction
        plane = instrument.projection(center, conditions=conditions)
        hour, dec = erfa.ae2hd(plane.azimuth.rad, plane.altitude.rad, site.lat.rad)
        expected = plane.parallactic_angle.rad - erfa.hd2pa(hour, dec, site.lat.rad)
        assert angle == pytest.approx(expected, abs=np.deg2rad(1e-3))
        assert angle == pytest.approx(np.deg2rad(0.0916), abs=np.deg2rad(0.02))
        if kind == "BOSS":
            static = instrument.projection(center).to_focal_plane(targets, kind)
            assert np.median(similarity(static.value, wok)[0]) == pytest.approx(0.042, abs=1e-3)


def test_the_field_of_a_sdssv_configuration_of_2021_was_below_the_horizon(real_data):
    """Its positions therefore cannot be reproduced."""
    from rfpsurvey.plans import read_plan

    folder = real_data("sdssv_apo_2021")
    plan = read_plan(folder / "confSummary-998.par.gz")
    time = Time(float(plan.meta["header"]["epoch"]), format="jd", scale="tai")
    center = SkyCoord(plan.meta["racen"], plan.meta["deccen"], unit="deg")
    with pytest.raises(rs.InputError, match="altitude -5.38.* deg of its center at 2022-01-01"):
        rs.Instrument.from_sdssv(folder).projection(
            center, conditions=rs.ObservingConditions("apache point", time=time)
        )


def test_nothing_is_downloaded(presets, monkeypatch):
    def refuse(*args, **kwargs):
        raise AssertionError("a download was tried")

    monkeypatch.setattr("astropy.utils.data.download_file", refuse)
    monkeypatch.setattr(iers.iers, "download_file", refuse, raising=False)
    with iers.conf.set_temp("auto_download", True):
        for when in ({"time": TIME}, {"time": Time("2026-11-01T09:00:00")}):
            rs.ObservingConditions("paranal", **when)
            ObservedField(field_basis(0, -1.4, 0), 1.0, None, rs.ObservingConditions("paranal", **when))


def test_the_pressure_follows_from_the_height_of_the_site():
    # the standard atmosphere: 700 hPa at 3012 m
    site = EarthLocation.from_geodetic(0 * u.deg, 0 * u.deg, 3012 * u.m)
    assert abs(rs.ObservingConditions(site, hour_angle=EAST).pressure - 700 * u.hPa) < 1 * u.hPa


def test_sites_are_near_their_published_places():
    for name in SITES:
        conditions = rs.ObservingConditions(name.title(), hour_angle=3 * u.hour)
        assert abs(conditions.hour_angle - 45 * u.deg) < 1e-9 * u.deg
        assert name in repr(conditions).lower()
        assert conditions.record["height_m"] > 900


def test_a_sdssv_configuration_is_scored_from_its_positions_on_the_sky(real_data):
    from rfpsurvey.plans import read_plan

    folder = real_data("sdssv_apo_2024")
    plan = read_plan(folder / "confSummary-test.par.gz")
    plan, instrument = plan[np.asarray(plan["on_target"]) == 1], rs.Instrument.from_sdssv(folder)
    conditions, place = sdssv_conditions(), {"positions": "sky", "position_angle": 0.0916 * u.deg}
    place |= {"columns": {"ra": "ra_fiber", "dec": "dec_fiber"}, "units": {"ra": "deg", "dec": "deg"}}
    given = rs.score_tile(plan, instrument)
    rows = {name: row for row, name in enumerate(given["id"].astype(str))}
    rows = [rows[name] for name in plan["positioner"].astype(str)]
    wok, left = np.column_stack([given["tip_x"].value, given["tip_y"].value])[rows], {}
    for name, seen in (("static", None), ("observed", conditions)):
        tile = rs.score_tile(plan, instrument, conditions=seen, **place)
        left[name], *_ = similarity(np.column_stack([tile["tip_x"].value, tile["tip_y"].value])[rows], wok)
    assert len(rows) == 490
    assert left["observed"].max() < 0.001
    assert np.median(left["static"]) == pytest.approx(0.042, abs=1e-3)
    for name in ("n_assigned", "n_out_of_reach", "n_colliding_pairs"):
        assert tile.summary[name] == given.summary[name]


def test_conditions_at_other_times():
    at_time, at_angle = conditions_at(), rs.ObservingConditions("paranal", hour_angle=EAST, exposure_time=600 * u.s)
    assert abs(at_time.shifted(90 * u.min).time - TIME - 90 * u.min) < 1 * u.ns
    turned = at_angle.shifted(-2 * u.hour).hour_angle
    assert abs(turned - (3 - 2 * 1.00273781) * u.hourangle) < 1e-6 * u.deg
    still = at_angle.without_exposure
    assert still.exposure_time == 0 * u.s
    assert {**still.record, "exposure_time_s": 600.0} == at_angle.record
    assert at_time.at_guide_wavelength.compensator == "ideal"
    assert at_time.at_hour_angle(EAST).date == at_time.time
