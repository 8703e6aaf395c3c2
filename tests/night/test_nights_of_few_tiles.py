"""Nights of a few tiles in long slots, compared with all orders whose exposures astropy allows."""

from functools import cache

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import AltAz, EarthLocation, SkyCoord, get_body
from astropy.table import QTable
from astropy.time import Time

from rfpsurvey.night import NightLimits, plan_night

DEG, SITES = u.deg, [(-111.6, 31.96, 2120), (117.58, 40.39, 950), (289.6, -24.63, 2669), (-155.48, 19.83, 4139)]
SLOT, OVERHEAD, N_TILES = 1 / 72, 25 / 1440, 8  # days


def random_night(seed):
    """Return a site, a day, limits and tiles of which some cannot be observed at the same times."""
    rng = np.random.default_rng([seed, 80])
    lon, lat, height = SITES[seed % 4]
    site, day = EarthLocation.from_geodetic(lon * DEG, lat * DEG, height * u.m), int(rng.integers(58000, 61500))
    limits = {"min_altitude": rng.uniform(25, 45) * DEG, "sun_altitude": -15 * DEG}
    limits |= {"hour_angle": rng.uniform(0.5, 3) * u.hourangle} if seed % 2 else {"moon_separation": 60 * DEG}
    midnight = Time(day + 1, format="mjd").sidereal_time("mean", 0).deg  # at local midnight, to a degree
    tiles = QTable({"tile": np.arange(N_TILES), "ra": (midnight + rng.uniform(-60, 60, N_TILES)) % 360 * DEG})
    tiles["dec"] = np.clip(lat + rng.uniform(-30, 30, N_TILES), -89, 89) * DEG
    tiles["merit"] = rng.uniform(0.5, 3, N_TILES)
    tiles["exposure_time"] = rng.uniform(30, 160, N_TILES) * u.min
    return site, day, limits, tiles, rng.uniform(1, 3)


def margins_by_astropy(scene, mjd):
    """Return the altitudes of tiles, and the angles by which they meet the limits (deg)."""
    site, _, limits, tiles, _ = scene
    times, coord = Time(mjd, format="mjd"), SkyCoord(tiles["ra"], tiles["dec"])
    frame = AltAz(obstime=times, location=site)
    place = coord[:, None].transform_to(frame[None])
    sun, moon = (get_body(name, times, site).transform_to(frame) for name in ("sun", "moon"))
    margins = [place.alt - limits["min_altitude"], (limits["sun_altitude"] - sun.alt)[None]]
    if "hour_angle" in limits:
        x, y, z = place.cartesian.xyz.value
        angle = np.arctan2(-y, np.cos(site.lat.rad) * z - np.sin(site.lat.rad) * x)
        margins.append(limits["hour_angle"] - np.abs(angle) * u.rad)
    else:
        margins.append(np.maximum(place.separation(moon[None]) - limits["moon_separation"], -moon.alt[None]))
    return place.alt.deg, np.minimum.reduce([margin.to_value(DEG) + np.zeros(place.shape) for margin in margins])


def slots_by_astropy(scene, first, slack, mjd, altitude, least):
    """Return the number of slots of each tile and first slot (0: not possible); limits are met by ``slack`` (deg)."""
    *_, tiles, exponent = scene
    slots = np.zeros((N_TILES, 72), dtype=int)
    for tile in range(N_TILES):
        usual = tiles["exposure_time"][tile].to_value(u.day)
        for slot in range(72):
            begin, exposure = first + slot * SLOT, usual
            for _ in range(20):
                at_midpoint = np.interp(begin + exposure / 2, mjd, altitude[tile])
                exposure = usual * np.sin(np.deg2rad(max(at_midpoint, 1))) ** -exponent
            times = np.append(mjd[(mjd > begin) & (mjd < begin + exposure)], [begin, begin + exposure])
            if begin + exposure < mjd[-1] and (np.interp(times, mjd, least[tile]) >= slack).all():
                slots[tile, slot] = np.ceil((exposure + OVERHEAD) / SLOT)
    return slots


def best_of_all(slots, merit):
    """Return the largest sum of merits of any order."""

    @cache
    def best(slot, used):
        if slot >= slots.shape[1]:
            return 0.0
        values = [best(slot + 1, used)]
        for tile in np.flatnonzero(slots[:, slot]).tolist():
            if not used >> tile & 1:
                values.append(merit[tile] + best(slot + int(slots[tile, slot]), used | 1 << tile))
        return max(values)

    return best(0, 0)


@pytest.mark.few(4)
@pytest.mark.parametrize("seed", range(200))
def test_the_optimum_is_that_of_all_orders(seed):
    scene = random_night(seed)
    site, day, limits, tiles, exponent = scene
    given = {"limits": NightLimits(**limits), "site": site, "overhead": OVERHEAD * u.day, "airmass_exponent": exponent}
    nights = {
        method: plan_night(tiles, Time(day, format="mjd"), **given, method=method, slot=SLOT * u.day)
        for method in ("greedy", "exact")
    }
    starts = nights["exact"].windows.arrays.start
    if len(starts) == 0:
        return
    noon = day + 0.5 - ((site.lon.deg + 180) % 360 - 180) / 360
    mjd = np.arange(noon, noon + 1, 1 / 1440)
    known = mjd, *margins_by_astropy(scene, mjd)
    # limits that are met by 0.05 deg are certainly met, and others are certainly not if they are missed by this angle
    least, most = (
        best_of_all(slots_by_astropy(scene, starts.min(), slack, *known), tiles["merit"]) for slack in (0.05, -0.05)
    )
    assert least - 1e-9 <= nights["exact"].summary["merit"] <= most + 1e-9
    assert nights["exact"].summary["is_optimum"]
    assert nights["greedy"].summary["merit"] <= most + 1e-9
    assert nights["greedy"].summary["bound"] >= least - 1e-9
