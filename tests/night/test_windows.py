"""Windows of tiles, compared with astropy on a grid of times, and with the limits at their ends."""

from contextlib import ExitStack

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import AltAz, EarthLocation, SkyCoord, get_body
from astropy.table import QTable
from astropy.time import Time
from astropy.utils import iers

import rfpsurvey as rs
from rfpsurvey.night import REASONS, NightLimits, observing_windows, plan_night

DEG = u.deg
# longitude, latitude (deg) and height (m)
SITES = [
    (-111.6, 31.96, 2120),
    (117.58, 40.39, 950),
    (289.6, -24.63, 2669),
    (-155.48, 19.83, 4139),
    (15.6, 78.2, 10),
    (0, -89.99, 2800),
]
TOLERANCE, TOLERANCE_MOON = 0.003, 0.01  # deg


def random_scene(seed):
    """Return a site, a date, limits and tiles with times of their own."""
    rng = np.random.default_rng([seed, 79])
    lon, lat, height = SITES[seed % len(SITES)]
    site = EarthLocation.from_geodetic(lon * DEG, lat * DEG, height * u.m)
    day = int(rng.integers(58000, 61500))
    choices = {
        "min_altitude": rng.uniform(-5, 60) * DEG,
        "max_altitude": rng.uniform(60, 88) * DEG,
        "hour_angle": rng.uniform(0.5, 11) * u.hour,
        "moon_separation": rng.uniform(5, 100) * DEG,
        "moon_illumination": rng.uniform(0.1, 1),
        "horizon": [(rng.uniform(0, 360), rng.uniform(0, 50)) for _ in range(rng.integers(1, 7))],
    }
    limits = {name: value for name, value in choices.items() if rng.random() < 0.5}
    if "moon_illumination" in limits and rng.random() < 0.5:
        limits["moon_altitude"] = rng.uniform(-5, 30) * DEG
    limits["sun_altitude"] = rng.uniform(-20, 5) * DEG
    lon, lat = rng.uniform(0, 360, 10), np.rad2deg(np.arcsin(rng.uniform(-1, 1, 10)))
    tiles = QTable({"tile": np.arange(10) + 100, "ra": lon * DEG, "dec": lat * DEG})
    tiles["dec"][0] = rng.choice([-90, 90]) * DEG
    if rng.random() < 0.3:
        tiles["start"] = day + rng.uniform(0, 1, 10)
        tiles["end"] = tiles["start"] + rng.uniform(0.1, 2, 10)
    return site, day, limits, tiles


def margins_of(site, limits, tiles, times):
    """Return by how much each limit is met, in units of the tolerance, by astropy: pairs of a reason and an array."""
    frame, n = AltAz(obstime=times, location=site), len(times)
    coord = SkyCoord(tiles["ra"], tiles["dec"])
    place = coord[:, None].transform_to(frame[None])
    sun, moon = (get_body(name, times, site).transform_to(frame) for name in ("sun", "moon"))
    altitude, numbers = place.alt.deg, NightLimits(**limits)
    yield "the Sun is too high", np.tile((numbers.sun_altitude - sun.alt).to_value(DEG), (len(tiles), 1)) / TOLERANCE
    if "start" in tiles.colnames:
        own = np.minimum(times.mjd - tiles["start"][:, None], tiles["end"][:, None] - times.mjd)
        yield "outside the times of the tile", own * 86400
    lowest = 30 * DEG if numbers.min_altitude is None else numbers.min_altitude
    yield "too low", (altitude - lowest.to_value(DEG)) / TOLERANCE
    if numbers.hour_angle is not None:
        sine, cosine = np.sin(site.lat.rad), np.cos(site.lat.rad)
        up, north, east = (part.value for part in (place.cartesian.z, place.cartesian.x, place.cartesian.y))
        angle = np.rad2deg(np.arctan2(-east, cosine * up - sine * north))
        distance = np.clip(np.cos(coord.dec.rad), 1e-3, 1)[:, None]  # from the pole, where hour angles change quickly
        yield "hour angle too large", (numbers.hour_angle.to_value(DEG) - np.abs(angle)) / TOLERANCE * distance
    if numbers.max_altitude is not None:
        yield "too near to the zenith", (numbers.max_altitude.to_value(DEG) - altitude) / TOLERANCE
    if numbers.horizon is not None:
        azimuth, points = place.az.deg, np.array(limits["horizon"])
        here, least, most = (
            np.interp(azimuth + d, *points[np.argsort(points[:, 0])].T, period=360) for d in (0, -1, 1)
        )
        slack = 1 + np.maximum(np.abs(here - least), np.abs(most - here)) / np.cos(np.deg2rad(altitude))
        yield "below the horizon", (altitude - here) / TOLERANCE / slack
    if numbers.moon_illumination is not None:
        bodies = [get_body(name, times, site).cartesian.xyz.to_value(u.au) for name in ("sun", "moon")]
        back = bodies[1] - bodies[0]
        cosine = (bodies[1] * back).sum(axis=0) / np.linalg.norm(bodies[1], axis=0) / np.linalg.norm(back, axis=0)
        dark = np.maximum(
            (numbers.moon_illumination - (1 + cosine) / 2) / 1e-4,
            (numbers.moon_altitude - moon.alt).deg / TOLERANCE_MOON,
        )
        yield "the Moon is too bright", np.tile(dark, (len(tiles), 1))
    if numbers.moon_separation is not None:
        far = place.separation(moon[None]).deg - numbers.moon_separation.to_value(DEG)
        yield "too near to the Moon", np.maximum(far, -moon.alt.deg) / TOLERANCE_MOON
    assert n == altitude.shape[1]


@pytest.mark.few(12)
@pytest.mark.parametrize("seed", range(240))
def test_windows_are_those_of_astropy(seed):
    """On a grid of minutes, windows contain all times within the limits by a tolerance, and no other times."""
    site, day, limits, tiles = random_scene(seed)
    windows = observing_windows(tiles, site, Time(day, format="mjd"), NightLimits(**limits), shortest=0 * u.s)
    noon = day + 0.5 - ((site.lon.deg + 180) % 360 - 180) / 360
    mjd = noon + np.arange(1, 1440) / 1440
    inside = np.zeros((10, len(mjd)), dtype=bool)
    for tile, start, end in zip(windows.arrays.tile, windows.arrays.start, windows.arrays.end, strict=True):
        inside[tile] |= (mjd >= start) & (mjd <= end)
    least, reasons = np.full(inside.shape, np.inf), windows.reasons()["reason"]
    for reason, margin in margins_of(site, limits, tiles, Time(mjd, format="mjd")):
        least = np.minimum(least, margin)
        order = np.array([REASONS.index(text) for text in reasons])
        assert ((order > 0) & (order <= REASONS.index(reason)))[(least < -1).all(axis=1)].all()
        assert ((order == 0) | (order > REASONS.index(reason)))[for_two_minutes(least).any(axis=1)].all()
    assert not (inside & (least < -1)).any()
    assert inside[:, 1:-1][for_two_minutes(least)].all()
    assert ((reasons == "") == np.isin(np.arange(10), windows.arrays.tile)).all()
    starts, tile = windows.arrays.start, windows.arrays.tile
    assert (windows.arrays.end[:-1] < starts[1:])[tile[1:] == tile[:-1]].all()


@pytest.mark.few(12)
@pytest.mark.parametrize("seed", range(240))
def test_each_end_of_a_window_is_at_a_limit(seed):
    """At the ends of windows, the limit that is met least is met by less than its tolerance, by astropy."""
    site, day, limits, tiles = random_scene(seed)
    windows = observing_windows(tiles, site, Time(day, format="mjd"), NightLimits(**limits), shortest=0 * u.s)
    tile, _, *ends = windows.arrays
    tile, mjd = np.tile(tile, 2), np.concatenate(ends)
    if len(mjd):
        margins = [margin for _, margin in margins_of(site, limits, tiles, Time(mjd, format="mjd"))]
        least = np.min(margins, axis=0)[tile, np.arange(len(mjd))]
        noon = np.isin(mjd, windows.sky(0).noon + np.array([0.0, 1.0]))
        assert (np.abs(least)[~noon] <= 1).all()
        assert (least[noon] >= -1).all()


@pytest.mark.few(4)
@pytest.mark.parametrize("seed", range(60))
def test_nights_have_the_times_of_the_sun_and_the_moon(seed):
    """The Sun is at its limit in the evening and in the morning, and the Moon rises and sets, by astropy."""
    site, day, limits, tiles = random_scene(seed)
    dark, bright = limits["sun_altitude"], limits["sun_altitude"] + 3 * DEG
    limits = {"dark": NightLimits(sun_altitude=dark), "": NightLimits(sun_altitude=bright)}
    windows = observing_windows(tiles, site, Time(day, format="mjd"), limits)
    night, noon = windows.nights[0], windows.sky(0).noon

    def altitude(name, mjd):
        times = Time(mjd, format="mjd")
        return get_body(name, times, site).transform_to(AltAz(obstime=times, location=site)).alt.deg

    grid = noon + np.linspace(0, 1, 145)
    is_dark = altitude("sun", grid) < bright.to_value(DEG) - TOLERANCE
    rises = np.sign(np.diff(np.sign(altitude("moon", grid))))
    if night["evening"].mask:
        assert not is_dark.any()
    elif is_dark.any():
        evening, morning = night["evening"].mjd, night["morning"].mjd
        assert evening <= grid[is_dark].min()
        assert morning >= grid[is_dark].max()
        for mjd in {evening, morning} - {noon, noon + 1}:
            assert abs(altitude("sun", mjd) - bright.to_value(DEG)) < TOLERANCE
    for name, sign in (("moonrise", 1), ("moonset", -1)):
        if night[name].mask:
            assert not (rises == sign).any()
        else:
            mjd = night[name].mjd
            assert abs(altitude("moon", mjd)) < TOLERANCE_MOON
            assert (altitude("moon", mjd + 0.002) - altitude("moon", mjd - 0.002)) * sign > 0


YEARS = [1905, 1962, 2028, 2036, 2099, 2250]


@pytest.mark.parametrize("year", YEARS)
def test_years_beyond_the_tables_need_no_network(year, monkeypatch):
    """No file is downloaded with the default configuration of astropy, and there are no warnings of ERFA."""

    def download(*args, **options):
        raise AssertionError("a download was attempted")

    monkeypatch.setattr(iers.iers, "download_file", download)
    monkeypatch.setattr("socket.socket.connect", download)
    tiles = QTable({"ra": [95] * DEG, "dec": [23] * DEG})
    changed = {"auto_download": True, "auto_max_age": 30.0, "iers_degraded_accuracy": "error"}
    with ExitStack() as stack:
        for name, value in changed.items():
            stack.enter_context(iers.conf.set_temp(name, value))
        limits = NightLimits(moon_separation=1 * DEG)
        windows = observing_windows(tiles, "kitt peak", f"{year}-01-03", limits)
        assert windows.reasons()["reason"].tolist() == [""]
        assert windows.nights["n_tiles"].tolist() == [len(windows.table)] == [1]
        night = plan_night(tiles, f"{year}-01-03", instrument="desi", limits=limits)
        assert night.as_text()["start"][0].startswith(f"{year}-01-0")


def test_wrong_values_are_refused():
    tiles = SkyCoord([0] * DEG, [0] * DEG)
    windows = observing_windows(tiles, "paranal", "2027-01-03")
    for given, text in (
        ({"n_nights": 0}, "n_nights must be a whole number from 1"),
        ({"shortest": -1 * u.s}, "shortest must be from 0 to 24 h, got -1.0 s"),
        ({"shortest": 60}, "shortest must be a Quantity with a unit"),
        ({"limits": {}}, "limits must be given for tiles without a program (the key ''), got none"),
        (
            {"limits": {"dark": NightLimits()}},
            "limits must be given for tiles without a program (the key ''), got dark",
        ),
    ):
        with pytest.raises(rs.InputError) as refusal:
            observing_windows(tiles, "paranal", "2027-01-03", **given)
        assert text in str(refusal.value)
    with pytest.raises(rs.InputError, match="date must be one of the dates from 2027-01-03 on, got '2027-01-05'"):
        windows.reasons("2027-01-05")


def for_two_minutes(least):
    """Return whether all limits are met by their tolerances at a time, and at the minutes before and after it."""
    met = least > 1
    return met[:, 1:-1] & met[:, :-2] & met[:, 2:]
