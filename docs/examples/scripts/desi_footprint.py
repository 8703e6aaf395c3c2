"""
DESI's footprint
================

This script plans DESI's real list of tiles with synthetic targets that require one to four visits. The script writes
its results after each tile, and can be resumed::

    python docs/examples/scripts/desi_footprint.py desi_tiles_main.ecsv.gz [n_targets] [folder]

The list of tiles is from https://github.com/desihub/desisurveyops.
"""

# sphinx_gallery_thumbnail_path = "_static/desi_footprint.png"

import sys
from concurrent.futures import ThreadPoolExecutor

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

import rfpsurvey as rs


def main(path: str, n_targets: float = 1e6, folder: str = "desi_survey") -> rs.Survey:
    """Plan the tiles of a list with synthetic targets."""
    tiles = rs.Tiling.read(path)
    pole = SkyCoord(0 * u.deg, 90 * u.deg)
    # The tiles cover about two fifths of the sky. Targets outside all tiles are reported, and add no computing time.
    targets = rs.synthetic_catalog("poisson", pole, 180 * u.deg, n_targets=float(n_targets), rng=1)
    visits = np.random.default_rng(1).integers(1, 5, len(targets))
    with ThreadPoolExecutor(2) as executor:
        survey = rs.plan_survey(
            targets,
            "desi",
            tiles,
            allocator="nearest",
            visits=visits,
            folder=folder,
            resume=True,
            executor=executor,
            progress=True,
        )
    print(survey)
    survey.completeness.pprint_all()
    rs.plot.plot_completeness(survey).figure.savefig("desi_footprint.png", dpi=150)
    return survey


if __name__ == "__main__":
    main(*sys.argv[1:]) if sys.argv[1:] else sys.exit(__doc__)
