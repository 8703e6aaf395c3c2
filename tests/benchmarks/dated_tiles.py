"""Print the time and memory of a survey of DESI whose tiles have times.

Run ``python tests/benchmarks/dated_tiles.py`` to plan 100 tiles, one per week, with a million targets, in four
processes: without proper motions, with proper motions and one epoch, with the time of each tile, and with 300
positioners that break on different dates. ``--targets N`` and words such as ``still`` select other cases.
"""

import subprocess
import sys
import warnings

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from astropy.time import Time
from measure import arguments, peak_gb, timed

import rfpsurvey as rs

CASES = {
    "still": "no proper motions",
    "epoch": "proper motions, one epoch for all tiles",
    "times": "proper motions, the time of each tile",
    "states": "the same, and 300 positioners that break",
}


def main(case: str, n: int) -> None:
    """Plan the survey of a case, and print a line."""
    warnings.simplefilter("ignore")
    rng, start = np.random.default_rng(1), Time("2025-01-01")
    ra, dec = rng.uniform(150, 180, n), np.rad2deg(np.arcsin(rng.uniform(0, np.sin(np.deg2rad(25)), n)))
    motion, coord = rng.normal(0, 10, (2, n)) * u.mas / u.yr, SkyCoord(ra * u.deg, dec * u.deg)
    motion[:, 0] = [2000, -3000] * u.mas / u.yr
    if case != "still":
        epoch = Time(2016.0, format="jyear")
        coord = SkyCoord(coord.ra, coord.dec, pm_ra_cosdec=motion[0], pm_dec=motion[1], obstime=epoch)
    catalog = rs.Catalog(coord, priority=rng.integers(1, 4, n))
    x, y = np.meshgrid(155 + 2.2 * np.arange(10), 2 + 2.2 * np.arange(10))
    table = QTable({"ra": x.ravel() * u.deg, "dec": y.ravel() * u.deg})
    table["time"] = (start + 7 * np.arange(100) * u.day).isot
    tiling, desi = rs.Tiling.from_table(table), rs.Instrument.preset("desi")
    rs.plan_survey(catalog[:1000], desi, tiling.coord[:1], allocator="lamost_rule")  # compiles
    if case == "states":
        broken = rng.choice(desi.focal_plane.id, 300, replace=False)
        states = Table({"id": broken, "from": (start + rng.uniform(0, 700, 300) * u.day).isot})
        desi = desi.with_states(states, time=tiling.times)
    options = {"allocator": "lamost_rule", "epoch": 2026 if case == "epoch" else None}
    survey, seconds = timed(rs.plan_survey, catalog, desi, tiling, **options)
    print(f"{CASES[case]:<42}{seconds:6.1f} s {peak_gb():6.2f} GB {survey.summary['n_visits_observed']:8d} visits")


if __name__ == "__main__":
    given = arguments(__doc__, CASES, targets=1_000_000)
    if len(given.words) == 1:
        main(given.words[0], given.targets)
    else:
        for word in given.words:
            subprocess.run([sys.executable, __file__, word, "--targets", str(given.targets)], check=True)
