"""Data of the interactive map of tiles."""

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table

from rfpsurvey.report._blocks import View
from rfpsurvey.report._pack import pack

DECIMALS = 4
"""Number of decimals of positions in degrees, and of fractions."""
WIDE = 70
"""If a tile is farther than this angle (degrees) from the mean direction of all tiles, the map shows the whole sky."""
COLUMNS = (
    "tile",
    "pass",
    "round",
    "position_angle",
    "n_targets",
    "n_new",
    "n_in_field",
    "n_reachable",
    "n_assigned",
    "n_observed",
    "n_colliding",
    "collision_rate",
    "fiber_use",
    "completeness",
)


def sky_view(table: Table, radius_deg: float, still: list) -> View:
    """Return the interactive map of the tiles in a table, with fields of the given radius."""
    centers = SkyCoord(table["ra"], table["dec"])
    x, y, z = centers.cartesian.xyz.value.mean(axis=1)
    known = np.hypot(np.hypot(x, y), z) > 1e-9
    center = SkyCoord(np.arctan2(y, x) * u.rad, np.arctan2(z, np.hypot(x, y)) * u.rad)
    whole = not known or bool(centers.separation(center).max() > WIDE * u.deg)
    columns = [name for name in COLUMNS if name in table.colnames and table[name].ndim == 1]
    data = {
        "n": len(table),
        "radius": float(radius_deg),
        "whole": whole,
        # right ascension and declination at the center of the map
        "center": [round(float(center.ra.deg), 6), 0.0 if whole else round(float(center.dec.deg), 6)],
        "observed": "n_observed" in table.colnames,
        "ra": pack(table["ra"].to_value(u.deg), DECIMALS),
        "dec": pack(table["dec"].to_value(u.deg), DECIMALS),
        "columns": {name: pack(table[name], DECIMALS) for name in columns},
        "units": {name: str(getattr(table[name], "unit", None) or "") for name in columns},
    }
    return View("sky_map", "Tiles on the sky", data, still)
