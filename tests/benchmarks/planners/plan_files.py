"""Read plans of fibers that other programs wrote, without rfpsurvey: the positioner and the target of each fiber.

* Tables (FITS, ECSV, CSV) with the columns ``positioner`` and ``target``, or ``id`` and ``target_id``.
* fiberassign, DESI: extension FIBERASSIGN, columns LOCATION and TARGETID (negative without a target).
* confSummary and confSummaryF, SDSS-V (Yanny, .par): structure FIBERMAP, columns holeId and catalogid where the column
  ``assigned`` is 1.
* pfsDesign and pfsConfig, PFS: extension DESIGN (CONFIG), columns cobraId (or fiberId) and objId of science targets,
  sky positions and flux standards. The column ``fiber`` of the positioners of a scene connects fibers and cobras.
"""

import gzip
import re
import shlex
from pathlib import Path

import numpy as np
from astropy.io import fits
from astropy.table import Table

PFS_KINDS = {1: "science", 12: "science", 2: "sky", 3: "standard"}
"""``targetType`` of pfsDesign; the others are fibers without a target, engineering fibers, and so on."""


def read_plan(path: Path, positioners: Table) -> Table:
    """Return the columns ``positioner`` and ``target`` of a plan, and others that the file has.

    Other columns are ``side``, ``tile``, ``x`` and ``y`` (mm), ``kind`` and ``fiber_type``. Without a target, there is
    no row. ``positioners`` are those of the scene.
    """
    if ".par" in path.suffixes:
        return read_yanny_plan(path)
    if ".fits" in path.suffixes:
        with fits.open(path, memmap=False) as file:
            names = {hdu.name for hdu in file}
            for name, read in (("FIBERASSIGN", of_fiberassign), ("DESIGN", of_pfs), ("CONFIG", of_pfs)):
                if name in names:
                    return read(Table(file[name].data), positioners)
    return of_table(Table.read(path, **({"hdu": 1} if ".fits" in path.suffixes else {})))


def of_table(table: Table) -> Table:
    """Return the plan in a table of rfpsurvey or of this comparison."""
    other = {"positioner": "id", "target": "target_id", "side": "handedness", "tile": "tile"}
    columns = {name: table[old] for name, old in other.items() if old in table.colnames}
    columns |= {name: table[name] for name in other if name in table.colnames}
    if not {"positioner", "target"} <= set(columns):
        raise ValueError(f"a plan must have the columns positioner and target, got {', '.join(table.colnames)}")
    filled = {name: np.ma.filled(np.ma.asarray(one), "" if name == "side" else -1) for name, one in columns.items()}
    plan = Table(filled)
    return plan[np.array([str(one) not in ("-1", "", "--") for one in plan["target"]], dtype=bool)]


def of_fiberassign(table: Table, positioners: Table) -> Table:
    """Return the plan in the extension FIBERASSIGN."""
    used = table[np.asarray(table["TARGETID"]) >= 0]
    plan = Table({"positioner": used["LOCATION"], "target": used["TARGETID"]})
    if {"FIBERASSIGN_X", "FIBERASSIGN_Y"} <= set(table.colnames):
        plan["x"], plan["y"] = used["FIBERASSIGN_X"], used["FIBERASSIGN_Y"]
    return plan


def of_pfs(table: Table, positioners: Table) -> Table:
    """Return the plan in the extension DESIGN or CONFIG; fibers that belong to no cobra are left out."""
    kinds = np.asarray(table["targetType"])
    if "cobraId" in table.colnames:
        cobras = np.asarray(table["cobraId"])
    elif "fiber" in positioners.colnames:
        of_fiber = dict(zip(np.asarray(positioners["fiber"]).tolist(), positioners["id"].tolist(), strict=True))
        cobras = np.array([of_fiber.get(one, -1) for one in np.asarray(table["fiberId"]).tolist()])
    else:
        raise ValueError("the positioners of the scene must have the column fiber, to find the cobras of a PFS design")
    rows = np.isin(kinds, list(PFS_KINDS)) & np.isin(cobras, np.asarray(positioners["id"]))
    used = table[rows]
    xy = np.asarray(used["pfiNominal"], dtype=float)
    return Table(
        {
            "positioner": cobras[rows],
            "target": np.asarray(used["objId"]),
            "x": xy[:, 0],
            "y": xy[:, 1],
            "kind": [PFS_KINDS[int(one)] for one in used["targetType"]],
        }
    )


def read_yanny_plan(path: Path) -> Table:
    """Return the plan in a confSummary file."""
    text = gzip.decompress(path.read_bytes()).decode() if path.suffix == ".gz" else path.read_text()
    rows = [row for row in yanny_rows(text, "FIBERMAP") if row["assigned"] == "1"]
    in_wok = bool(rows) and "xwok" in rows[0]
    angle = 0.0 if in_wok else np.deg2rad(float(re.search(r"^pa\s+(\S+)", text, re.MULTILINE).group(1)))
    names = ("xwok", "ywok") if in_wok else ("xFocal", "yFocal")
    xy = np.array([float(row[names[0]]) + 1j * float(row[names[1]]) for row in rows], dtype=complex)
    xy *= np.exp(1j * angle)  # older files: along east and north instead of along the plane
    kinds = [row["category"].partition("_")[0] for row in rows]
    return Table(
        {
            "positioner": np.array([row["holeId"] for row in rows], dtype=str),
            "target": np.array([f"{row['catalogid']}" for row in rows], dtype=str),
            "x": xy.real,
            "y": xy.imag,
            "kind": np.array([one if one in ("sky", "standard") else "science" for one in kinds], dtype=str),
            "fiber_type": np.array([row["fiberType"] for row in rows], dtype=str),
        }
    )


def yanny_rows(text: str, name: str) -> list[dict[str, str]]:
    """Return the rows of a structure of a Yanny file as text; arrays are left as one text in braces."""
    body = re.search(r"typedef\s+struct\s*\{([^}]*)\}\s*" + name + r"\s*;", text)
    if body is None:
        raise ValueError(f"the file must define the structure {name}, got none")
    names = re.findall(r"(\w+)\s*(?:\[[^\]]*\]\s*)*;", body.group(1))
    rows = []
    for line in text.splitlines():
        if line.upper().startswith(name + " "):
            packed = re.sub(r"\{([^}]*)\}", lambda found: '"' + found.group(1).replace('"', "") + '"', line)
            values = shlex.split(packed)[1:]
            if len(values) != len(names):
                raise ValueError(f"a row of {name} must have {len(names)} values, got {len(values)}")
            rows.append(dict(zip(names, values, strict=True)))
    return rows
