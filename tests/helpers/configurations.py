"""Recorded configurations of SDSS-V, read from the text of their files, and an independent projection of stars."""

import gzip
import shlex

import astropy.units as u
import numpy as np
from astropy.table import QTable

import rfpsurvey as rs


def rows_of(path, assigned="1"):
    """Return the rows of FIBERMAP as dicts, from the text of the file; by default, only the assigned rows."""
    text = gzip.decompress(path.read_bytes()).decode()
    struct = text.partition("typedef struct {")[2].partition("}")[0]
    names = [(line.split()[1].partition("[")[0], line) for line in struct.split(";") if line.strip()]
    found = []
    for line in text.splitlines():
        if not line.startswith("FIBERMAP "):
            continue
        words, row = shlex.split(line.replace("{", " { ").replace("}", " } "))[1:], {}
        for name, declared in names:
            if words[0] == "{":
                end = words.index("}")
                row[name], words = words[1:end], words[end + 1 :]
            else:
                row[name], words = words[0], words[1:]
            assert ("char" in declared) or name in ("fiberType",) or row[name]
        if assigned is None or row["assigned"] == assigned:
            found.append(row)
    return found


def spot(row):
    return float(row["xFocal"]), float(row["yFocal"])


def stars_around(center, n=20_000, radius=1.7, seed=1):
    rng = np.random.default_rng(seed)
    apart = radius * np.sqrt(rng.uniform(0, 1, n)) * u.deg
    coord = center.directional_offset_by(rng.uniform(0, 360, n) * u.deg, apart)
    return rs.Catalog(coord, extra=QTable({"gaia_g": rng.uniform(10, 21, n)}))


def places(coord, center, angle_deg, model, fiber="Boss", factor=0.9998082):
    """Return positions in the frame of the wok (mm), from an offset frame of astropy and the published polynomial."""
    seen = coord.transform_to(center.skyoffset_frame(rotation=angle_deg * u.deg))
    theta, lon, lat = center.separation(coord).deg, seen.lon.rad, seen.lat.rad
    turn = np.arctan2(np.sin(lat), np.cos(lat) * np.sin(lon))
    row = model[(model["direction"] == "focal") & (np.char.upper(model["waveCat"]) == fiber.upper())][0]
    p = sum(row[f"c{k}"] * theta ** (2 * k + 1) for k in range(5))
    r = factor * row["R"] * np.sin(np.deg2rad(p))
    return r * np.cos(turn), r * np.sin(turn)
