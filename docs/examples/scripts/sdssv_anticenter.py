"""
SDSS-V over the anticenter
==========================

This script plans a survey of Tycho-2 stars around the Galactic anticenter without collisions. Bright stars have
priority and require two visits::

    python docs/examples/scripts/sdssv_anticenter.py [CATALOG]
"""

# sphinx_gallery_thumbnail_path = "_static/sdssv_anticenter.png"

import sys
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable

import rfpsurvey as rs

DATA = Path(__file__).parents[3] / "data" / "tycho2_anticenter_r8.ecsv.gz"


def main(path: str | Path = DATA, passes: int = 6) -> rs.Survey:
    """Plan several passes over a catalog with priorities."""
    table = QTable.read(path, format="ascii.ecsv")
    magnitude = table["vt_mag"].to_value(u.mag)
    # three priority classes; stars brighter than 8 mag require two visits
    table["priority"] = np.select([magnitude < 8, magnitude < 11], [3, 2], 1)
    table["visits"] = np.where(magnitude < 8, 2, 1)
    stars = rs.Catalog.from_table(table)
    tiles = rs.place_tiles(stars, "sdss_apo", method="hexagonal", passes=int(passes))
    survey = rs.plan_survey(stars, "sdss_apo", tiles, allocator="optimal", epoch=2026.5, progress=True)
    print(survey)
    survey.completeness.pprint_all()
    rs.plot.plot_completeness(survey).figure.savefig("sdssv_anticenter.png", dpi=150)
    return survey


if __name__ == "__main__":
    main(*sys.argv[1:])
