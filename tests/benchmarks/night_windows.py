"""Print the time and the memory for the windows of DESI's tiles in a year: python tests/benchmarks/night_windows.py."""

import argparse
import os
import resource
from pathlib import Path
from time import process_time

import astropy.units as u

import rfpsurvey as rs
from rfpsurvey.night import night_limits, observing_windows


def desi_tiles(program=None):
    """Return the tiles of DESI's main survey, from the folder that RFPSURVEY_TEST_DATA names."""
    path = Path(os.environ["RFPSURVEY_TEST_DATA"]) / "desi_tiles_main.ecsv.gz"
    tiling = rs.Tiling.read(path, units={"ra": u.deg, "dec": u.deg})
    return tiling if program is None else rs.Tiling(tiling.table[tiling.table["program"] == program])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--nights", type=int, default=365)
    n_nights, tiles = parser.parse_args().nights, desi_tiles()
    observing_windows(tiles, "kitt peak", "2027-01-03", night_limits("desi"))
    begin = process_time()
    windows = observing_windows(tiles, "kitt peak", "2027-01-03", night_limits("desi"), n_nights=n_nights)
    seconds, memory = process_time() - begin, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"{windows}: {seconds:.1f} s of processor time, {memory:.2f} GB")
