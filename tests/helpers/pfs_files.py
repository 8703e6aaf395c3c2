"""Files of PFS made from its data model: calibrations (dots, fiducials, interference limits, cobras) and designs."""

import numpy as np
from astropy.io import fits
from astropy.table import Table

from rfpsurvey._field.format_pfsdesign_write import design_id
from rfpsurvey._instruments.pfs_files import pfs_fibers

PITCH = 8.0
OFFSET = -0.16, 2.26


def centers():
    """Return nominal centers of cobras 1 to 2394, from the definition of the identifiers, cobra by cobra."""
    found = []
    for field in range(3):
        turn = np.deg2rad(-120 * field)
        for module in range(14):
            for cobra in range(57):
                x = -PITCH * np.sqrt(3) / 2 * (1 + cobra % 2) - module * PITCH * np.sqrt(3)
                y = PITCH / 2 * (1 - cobra) + module * PITCH
                found.append([x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)])
    return np.array(found)


def write_files(folder, limits=None):
    """Write dots, fiducials and interference limits to a folder; ``limits`` maps cobras to their limits."""
    xy = centers() + OFFSET
    rows = [f"{k},{float(x)!r},{float(y)!r},0.75" for k, (x, y) in enumerate(xy, 1)]
    (folder / "black_dots_mm-2024-11-05.csv").write_text("spotId,x,y,r\n" + "\n".join(rows) + "\n")
    angle = np.linspace(0, 2 * np.pi, 96)
    rows = [f"{k},{230 * np.cos(a):.3f},{230 * np.sin(a):.3f},0" for k, a in enumerate(angle, 1)]
    rows[57] = "58,,,1"
    (folder / "fiducial_positions_20240513.csv").write_text("fiducialId,x_mm,y_mm,flag\n" + "\n".join(rows) + "\n")
    given = {cobra: ",".join(map(str, values)) for cobra, values in (limits or {7: (5.34, 26.95, 141)}).items()}
    rows = [f"{k},{given.get(k, ',,')}" for k in range(1, 2395)]
    header = "# Cobra/fiducial interference limits\ncobra_id,theta_limit_1,theta_limit_2,max_phi_angle\n"
    (folder / "cobraInterference_20260731.csv").write_text(header + "\n".join(rows) + "\n")
    return folder


def cobra_columns(seed=0):
    """Return columns of a calibration model: real cobras differ from the nominal ones by such amounts."""
    rng = np.random.default_rng(seed)
    n = 2394
    xy = centers() + rng.normal(0, 0.05, (n, 2))
    theta = rng.uniform(0, 360, n)
    return {
        "Status": np.ones(n, dtype=int),
        "Module_Id": np.arange(n) // 57 + 1,
        "Positioner_Id": np.arange(n) % 57 + 1,
        "Global_base_pos_x": xy[:, 0],
        "Global_base_pos_y": xy[:, 1],
        "CCW_Global_base_ori_z": theta,
        "CW_Global_base_ori_z": (theta + rng.uniform(10, 25, n)) % 360,
        "Joint2_CCW_limit_angle": rng.uniform(-4, 0, n),
        "Joint2_CW_limit_angle": rng.uniform(178, 184, n),
        "Link1_Link_Length": rng.normal(2.375, 0.02, n),
        "Link2_Link_Length": rng.normal(2.375, 0.02, n),
    }


def write_cobras(path, columns):
    """Write a calibration model in XML with the elements that the data model names."""
    parts = []
    for k in range(len(columns["Status"])):
        texts = [f"<{name}>{values[k]}</{name}>" for name, values in columns.items()]
        parts.append(
            f"<ARM_DATA_CONTAINER><DATA_HEADER>{''.join(texts[:3])}</DATA_HEADER>"
            f"<KINEMATICS>{''.join(texts[3:])}</KINEMATICS></ARM_DATA_CONTAINER>"
        )
    path.write_text(f"<?xml version='1.0' encoding='UTF-8'?>\n<ARM_DATA>{''.join(parts)}</ARM_DATA>")
    return path


def design(n=60, **changes):
    """Return the tables of a small design of version 3, made from the data model."""
    fiber, _ = pfs_fibers()
    cobra = np.arange(1, n + 1)
    rng = np.random.default_rng(5)
    target = np.where(np.arange(n) % 5 == 4, 4, np.array([1, 1, 2, 3, 4])[np.arange(n) % 5])
    has = target != 4
    xy = np.where(has[:, None], centers()[:n] + rng.uniform(-2, 2, (n, 2)), np.nan)
    columns = {
        "fiberId": np.append(fiber[cobra - 1], [1]).astype("i4"),
        "tract": np.ones(n + 1, "i4"),
        "patch": np.full(n + 1, "1,1"),
        "ra": np.append(np.where(has, 150 + xy[:, 1] / 320, np.nan), np.nan),
        "dec": np.append(np.where(has, -2 - xy[:, 0] / 320, np.nan), np.nan),
        "catId": np.append(np.where(has, 2, -1), -1).astype("i4"),
        "objId": np.append(np.where(has, 10**15 + cobra, -1), -1).astype("i8"),
        "targetType": np.append(target, 5).astype("i4"),
        "pfiNominal": np.vstack([xy, [np.nan, np.nan]]).astype("f4"),
        "fiberStatus": np.ones(n + 1, "i4"),
        **changes,
    }
    filters = np.array(["g_ps1", "none"])
    flux = {"fiberId": np.repeat(columns["fiberId"][:-1], 2), "psfFlux": rng.random(2 * n).astype("f4")}
    flux["filterName"] = np.tile(filters, n)
    stars = {
        "objId": np.arange(3) + 10**17,
        "epoch": np.full(3, "J2016.0"),
        "ra": 150 + rng.random(3),
        "agX": [1.5, 2, 3],
    }
    return columns, flux, stars


def _form(values):
    values = np.asarray(values)
    letters = {"i4": "J", "i8": "K", "f4": "E", "f8": "D"}
    if values.dtype.kind == "U":
        return f"{values.dtype.itemsize // 4}A"
    return ("2" if values.ndim == 2 else "") + letters[values.dtype.str[1:]]


def write_design(path, tables=None, leave_out=(), **cards):
    """Write a design; ``cards`` changes the header, and ``leave_out`` names missing columns and tables."""
    columns, flux, stars = tables or design()
    header = fits.Header({"RA": 150.0, "DEC": -2.0, "POSANG": 0.0, "ARMS": "br", "DSGN_NAM": "test", "DAMD_VER": 3})
    numeric = columns["ra"].dtype.kind == "f"
    header["W_PFDSGN"] = design_id(columns["fiberId"], columns["ra"], columns["dec"]) if numeric else 1
    header["HIERARCH TargetType.SCIENCE"] = 1, "science target"
    for name, value in cards.items():
        if value is None:
            del header[name]
        else:
            header[name] = value
    units = [fits.PrimaryHDU(header=header)]
    for name, table in {"DESIGN": columns, "PHOTOMETRY": flux, "GUIDESTARS": stars}.items():
        made = [fits.Column(k, _form(v), array=np.asarray(v)) for k, v in table.items() if k not in leave_out]
        if name not in leave_out:
            units.append(fits.BinTableHDU.from_columns(made, header if name != "GUIDESTARS" else None, name=name))
    fits.HDUList(units).writeto(path)
    return path


def target_list(n=4, **columns):
    """Return a target list of PFS, as the target uploader defines it."""
    table = Table({"ob_code": [f"ob{k}" for k in range(n)], "obj_id": 4000 + np.arange(n)})
    table["ra"], table["dec"] = 150 + 0.01 * np.arange(n), np.full(n, 2.0)
    rest = {"exptime": [900.0, 901.0, 1963.5, 450.0], "priority": [0, 1, 5, 9], "resolution": ["L"] * 4}
    for name, values in {**rest, **columns}.items():
        table[name] = values
    return table
