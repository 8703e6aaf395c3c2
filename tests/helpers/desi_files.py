"""Files of DESI with random values, which follow the data models of desimodel, desimeter and fiberassign."""

import gzip
import json

import numpy as np
from astropy.io import fits
from astropy.table import Table

import rfpsurvey as rs

ANGLES = ("OFFSET_T", "OFFSET_P", "MIN_T", "MAX_T", "MIN_P", "MAX_P")
START = "2020-01-01T00:00:00"
PHI = [[-1.0, -0.5], [3.5, -0.9], [3.7, 0.0], [3.5, 0.8], [-1.0, 0.5]]


def locations(per_petal=500):
    """Return locations and CS5 positions (mm) of positioners on the lattice of the preset, with numbered devices."""
    plane = rs.Instrument.preset("desi").focal_plane
    petal, xy = plane.spectrograph, plane.xy.to_value("mm")
    rows = np.concatenate([np.flatnonzero(petal == p)[:per_petal] for p in range(10)])
    device = np.tile(np.arange(per_petal), 10)
    return 1000 * petal[rows] + device, xy[rows]


def metrology(path, *, per_petal=500, others=True, edit=None):
    """Write a file of the metrology in the format of desimeter, with two rows of other devices."""
    ids, xy = locations(per_petal)
    table = Table({"PETAL_ID": ids // 1000 + 2, "PETAL_LOC": ids // 1000, "DEVICE_LOC": ids % 1000})
    table["DEVICE_TYPE"], table["PINHOLE_ID"] = "POS", 0
    table["X_FP"], table["Y_FP"] = xy.T
    table["Z_FP"], table["LOCATION"], table["DEVICE_ID"] = 0.0, ids, "M00001"
    if others:
        table.add_row((2, 0, 11, "FIF", 1, 5.0, 5.0, 0.0, 11, "P018"))
        table.add_row((2, 0, 541, "GIF", 1, 5.0, 6.0, 0.0, 541, "P053"))
    if edit is not None:
        edit(table)
    table.write(path, format="ascii.csv")
    return table


def focal_plane(path, *, per_petal=500, equal=False, edit=None, seed=1):
    """Write the table of a focal plane of desimodel, which includes the row of a fiducial."""
    ids, xy = locations(per_petal)
    rng, n = np.random.default_rng(seed), len(ids)
    table = Table({"PETAL": ids // 1000, "DEVICE": ids % 1000, "LOCATION": ids, "PETAL_ID": ids // 1000 + 2})
    table["DEVICE_ID"], table["DEVICE_TYPE"], table["FIBER"] = "M00001", "POS", np.arange(n)
    table["OFFSET_X"], table["OFFSET_Y"] = xy.T
    table["OFFSET_T"], table["OFFSET_P"] = rng.uniform(-180, 180, n), rng.normal(0, 3, n)
    table["LENGTH_R1"], table["LENGTH_R2"] = (
        (np.full(n, 3.0), np.full(n, 3.0)) if equal else rng.normal(3, 0.03, (2, n))
    )
    table["MAX_T"], table["MIN_T"], table["MAX_P"], table["MIN_P"] = 190.0, -185.0, 190.0, -10.0
    for name in table.colnames[7:]:
        table[name].unit = "mm" if name.startswith(("LENGTH", "OFFSET_X", "OFFSET_Y")) else "degrees"
    table.add_row((0, 11, 11, 2, "P018", "FIF", -1, 5, 5, 0, 0, 0, 0, 0, 0, 0, 0))
    table["DEVICE"][-1], table["LOCATION"][-1] = 542, 542
    if edit is not None:
        edit(table)
    table.write(path, format="ascii.ecsv")
    return table


def state(path, plane, events=(), *, edit=None):
    """Write a log of events.

    All positioners work at first; an event is a dict with TIME, LOCATION and the changed values.
    """
    n = len(plane)
    table = Table({"TIME": np.full(n, START, dtype="U25"), "LOCATION": np.array(plane["LOCATION"])})
    table["STATE"], table["POS_T"], table["POS_P"] = np.zeros(n, int), 0.0, 0.0
    for name in ("MIN_P", "MAX_P", "MIN_T", "MAX_T"):
        table[name] = np.array(plane[name])
    table["EXCLUSION"] = np.full(n, "default", dtype="U16")
    for event in events:
        row = dict(zip(table.colnames, table[list(table["LOCATION"]).index(event["LOCATION"])], strict=True))
        table.add_row({**row, **event})
    if edit is not None:
        edit(table)
    table.write(path, format="ascii.ecsv")
    return table


def exclusions(path, names=("default",), scale=1.0):
    """Write polygons; the half width of the phi polygon is 0.9 mm times ``scale``."""
    outline = [[x, scale * y] for x, y in PHI]
    shape = {"segments": [[*outline, outline[0]]], "circles": []}
    content = {name: dict.fromkeys(("theta", "phi", "gfa", "petal"), shape) for name in names}
    text = json.dumps(content).encode()
    path.write_bytes(gzip.compress(text) if path.name.endswith(".gz") else text)


def tile(path, *, per_petal=500, edit=None, seed=2, header=None):
    """Write a file of fiberassign with all of its extensions; x and y are within reach."""
    ids, xy = locations(per_petal)
    rng, n = np.random.default_rng(seed), len(ids)
    table = Table({"TARGETID": rng.integers(1, 2**60, n), "PETAL_LOC": (ids // 1000).astype("i2")})
    table["DEVICE_LOC"], table["LOCATION"] = (ids % 1000).astype("i4"), ids.astype("i4")
    table["FIBER"], table["FIBERSTATUS"] = np.arange(n, dtype="i4"), np.zeros(n, "i4")
    table["TARGET_RA"], table["TARGET_DEC"] = rng.uniform(169, 171, n), rng.uniform(-8, -6, n)
    table["PMRA"], table["PMDEC"] = rng.normal(0, 5, (2, n)).astype("f4")
    table["REF_EPOCH"], table["LAMBDA_REF"] = np.full(n, 2015.5, "f4"), np.full(n, 5400, "f4")
    table["FA_TARGET"] = np.ones(n, "i8")
    table["FA_TYPE"] = rng.choice([1, 2, 3, 4, 16], n).astype("u1")
    table["OBJTYPE"] = np.where(table["FA_TYPE"] >= 4, "SKY", "TGT")
    radius, angle = 5 * np.sqrt(rng.uniform(0, 1, n)), rng.uniform(0, 2 * np.pi, n)
    table["FIBERASSIGN_X"] = (xy[:, 0] + radius * np.cos(angle)).astype("f4")
    table["FIBERASSIGN_Y"] = (xy[:, 1] + radius * np.sin(angle)).astype("f4")
    table["PRIORITY"], table["SUBPRIORITY"] = rng.integers(1, 4000, n).astype("i4"), rng.uniform(0, 1, n)
    table["OBSCONDITIONS"], table["BRICKNAME"] = np.full(n, 63, "i4"), "1702m070"
    table["FLUX_G"] = rng.uniform(0, 9, n).astype("f4")
    idle = np.arange(n) % 7 == 0
    table["FIBERSTATUS"][idle], table["OBJTYPE"][idle], table["FA_TYPE"][idle] = 1, "", 0
    table["TARGETID"][idle] = -(4403 * 5000 + ids[idle])
    table["FIBERSTATUS"][1], table["FIBERSTATUS"][2], table["FIBERSTATUS"][3] = 2, 4, 8
    if edit is not None:
        edit(table)
    units = {"TARGET_RA": "deg", "TARGET_DEC": "deg", "PMRA": "mas/yr", "PMDEC": "mas/yr", "LAMBDA_REF": "Angstrom"}
    units |= {"FIBERASSIGN_X": "mm", "FIBERASSIGN_Y": "mm", "FLUX_G": "nanomaggy"}
    cards = {"TILEID": 4403, "TILERA": 170.239, "TILEDEC": -7.093, "FIELDROT": 0.0210480650645507}
    cards |= {"FA_PLAN": "2022-07-01T00:00:00.000", "FA_HA": -6.72, "FA_VER": "5.4.0", **(header or {})}
    monitor = Table({"FIBER": np.arange(20, dtype="i4"), "LOCATION": np.arange(20) // 2 * 1000 + 461})
    stars = Table({"TARGETID": rng.integers(1, 2**60, 9), "GFA_LOC": np.zeros(9, "i2"), "MORPHTYPE": ["PSF"] * 9})
    targets = Table({"TARGETID": table["TARGETID"], "RA": table["TARGET_RA"], "DEC": table["TARGET_DEC"]})
    reachable = table["TARGETID", "FIBER", "LOCATION"]
    primary = fits.PrimaryHDU()
    primary.header.update({**cards, "FAARGS": "--doclean n --dr dr9 " * 8, "OBSCON": "DARK|GRAY"})
    found = [primary]
    for name, one in {
        "FIBERASSIGN": table,
        "SKY_MONITOR": monitor,
        "GFA_TARGETS": stars,
        "TARGETS": targets,
        "POTENTIAL_ASSIGNMENTS": reachable,
    }.items():
        hdu = fits.table_to_hdu(Table(one, copy=True))
        for k, column in enumerate(one.colnames, 1):
            if column in units and name == "FIBERASSIGN":
                hdu.header[f"TUNIT{k}"] = units[column]
        hdu.header.update({"EXTNAME": name, **cards})
        found.append(hdu)
    fits.HDUList(found).writeto(path)
    return table


def folder_with_state(folder, *, per_petal):
    """Write a focal plane with few positioners, its state with events, and its exclusions; return the folder."""
    table = focal_plane(folder / "desi-focalplane_2020-01-01T00:00:00.ecsv", per_petal=per_petal)
    events = [
        {"TIME": "2021-01-01T00:00:00+00:00", "LOCATION": 1003, "STATE": 2, "POS_T": 10.0, "POS_P": 100.0},
        {"TIME": "2022-01-01T00:00:00", "LOCATION": 1003, "STATE": 0},
        {"TIME": "2022-01-01T00:00:00", "LOCATION": 1004, "STATE": 4, "POS_T": 1.0, "POS_P": 90.0},
        {"TIME": "2023-01-01T00:00:00", "LOCATION": 1005, "STATE": 8, "MIN_P": 100.0, "EXCLUSION": "retracted"},
    ]
    state(folder / "desi-state_2020-01-01T00:00:00.ecsv", table, events)
    exclusions(folder / "desi-exclusion_2020-01-01T00:00:00.json.gz", ("default", "retracted"))
    return folder
