"""How much slower instruments as built are than the presets of the same instruments.

Run it as ``python tests/benchmarks/as_built_speed.py FOLDER``, with the folder that ``RFPSURVEY_TEST_DATA`` names. Each
row is the median of alternating repeats, in milliseconds of processor time, and the median of the ratios.
"""

import sys
import tempfile
from functools import partial
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from measure import alternated

import rfpsurvey as rs
from rfpsurvey.probability import Precision

CENTER = SkyCoord("06h20m00s +23d00m00s")
REPEATS = 7
PAIRS = {
    "SDSS-V": ("sdss_apo", "sdssv_apo_2024"),
    "DESI": ("desi", "desi/fp-metrology.csv.gz"),
    "PFS": ("pfs", "pfs"),
}


def work(instrument):
    """Return the calls to measure, by name."""
    plane, rng = instrument.focal_plane, np.random.default_rng(0)
    arrays, n = plane.arrays, len(plane)
    r = np.sqrt(rng.uniform(arrays.inner_radius**2 + 1, arrays.outer_radius**2 - 1, n))
    angle = rng.uniform(0, 2 * np.pi, n)
    free = rs.FocalPlane(plane.xy, plane.positioner) if arrays.joints is None else plane
    tips = (arrays.xy + (r * [np.cos(angle), np.sin(angle)]).T) * u.mm
    _, phi = free.inverse(tips)
    tips[~np.isfinite(phi)] = np.nan  # beyond the joint limits
    catalog = rs.synthetic_catalog("uniform", CENTER, instrument.field_radius, n_targets=4 * n, rng=1)
    sky = rs.synthetic_catalog("uniform", CENTER, 3 * instrument.field_radius, n_targets=20 * n, rng=2)
    tiles = sky.coord[:20]
    xy = instrument.projection(CENTER).to_focal_plane(catalog)

    precision = {"precision": Precision(standard_error=0.0005), "rng": 1, "progress": False}

    def survey():
        with tempfile.TemporaryDirectory() as folder:
            options = {"allocator": "lamost_rule", "folder": Path(folder) / "survey", "progress": False}
            rs.plan_survey(sky, instrument, tiles, **options)

    return {
        "find_collisions": lambda: rs.find_collisions(plane, tips),
        "reach": lambda: plane.arrays.reach(xy.value),
        "plan_tile, lamost": lambda: rs.plan_tile(catalog, instrument, CENTER, allocator="lamost_rule"),
        "plan_tile, optimal": lambda: rs.plan_tile(catalog, instrument, CENTER, allocator="optimal"),
        "survey of 20 tiles": survey,
        **{
            f"probability, {name}": partial(rs.collision_probability, plane, method=name, **precision)
            for name in ("conditional", "quadrature")
        },
    }


def main(folder):
    """Print the table."""
    print(f"{'instrument':10} {'work':26} {'nominal':>9} {'as built':>9} {'ratio':>6}")
    for title, (name, path) in PAIRS.items():
        both = work(rs.Instrument.preset(name)), work(rs.Instrument.read(folder / path))
        for what in both[0]:
            seconds = alternated([calls[what] for calls in both], REPEATS)
            nominal, built = 1000 * np.median(seconds, axis=0)
            print(f"{title:10} {what:26} {nominal:9.2f} {built:9.2f} {np.median(seconds[:, 1] / seconds[:, 0]):6.2f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
