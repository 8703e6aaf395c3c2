"""
LAMOST over a spring block
==========================

This script places tiles on Tycho-2 stars, and plans a survey with these tiles::

    python docs/examples/scripts/lamost_spring.py [CATALOG]
"""

# sphinx_gallery_thumbnail_path = "_static/lamost_spring.png"

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import rfpsurvey as rs

DATA = Path(__file__).parents[3] / "data" / "tycho2_spring_60x20.ecsv.gz"


def main(path: str | Path = DATA) -> rs.Survey:
    """Place tiles where the stars of a catalog are, and plan them."""
    stars = rs.Catalog.read(path)
    tiles = rs.place_tiles(stars, "lamost", method="sdss", completeness=0.9)
    print(tiles, f"for a completeness of {tiles.summary['completeness']:.3f}, were every star in reach of a fiber")
    with ThreadPoolExecutor(2) as executor:
        survey = rs.plan_survey(stars, "lamost", tiles, allocator="repair", executor=executor, progress=True)
    print(survey)
    for outcome, number in survey.summary["outcomes"].items():
        print(f"{number:>8} {outcome}")
    survey.tiles.write("lamost_spring.ecsv", overwrite=True)
    rs.plot.plot_tiling(survey).figure.savefig("lamost_spring.png", dpi=150)
    return survey


if __name__ == "__main__":
    main(*sys.argv[1:])
