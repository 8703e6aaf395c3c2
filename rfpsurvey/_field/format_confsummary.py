"""Configurations of SDSS-V: confSummary files in the yanny format, optionally with gzip compression."""

import gzip
import re
import tempfile
import warnings
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

import numpy as np
from astropy.table import QTable
from astropy.time import Time
from astropy.utils.exceptions import AstropyDeprecationWarning

from rfpsurvey._common.files import suffix_of
from rfpsurvey._common.io import writing_to
from rfpsurvey._common.read_documents import content_of, head_of, sentence
from rfpsurvey._common.read_tables import is_number
from rfpsurvey._common.units import check_columns, to_plain
from rfpsurvey._field import plan_values
from rfpsurvey._sky.arrays import last_role
from rfpsurvey._sky.time import to_moment, to_time
from rfpsurvey.errors import InputError, number_of

FORMAT, ENDINGS = "confsummary", (".par",)
# SDSS-V, which measures position angles from the north of date; `epoch` is the time of the observation
NORTH_OF_DATE, EPOCH_OF_OBSERVATION = "SDSS-V", True
INSTRUMENTS = {"APO": "sdss_apo", "LCO": "sdss_lco"}
MISSING = -999
FIBERS = ("BOSS", "APOGEE", "METROLOGY", "NONE")
TYPES = {"short": "i2", "int": "i4", "long": "i8", "float": "f4", "double": "f8"}
FIRST_DAY, LAST_DAY = 2_341_973, 2_561_117  # the years 1700 and 2300
MOST_BYTES = 2**30

STRUCT = """short positionerId; char holeId[28]; FIBERTYPE fiberType; short assigned; short on_target; short valid;
short decollided; double xwok; double ywok; double zwok; double xFocal; double yFocal; float alpha; float beta;
double racat; double deccat; float pmra; float pmdec; float parallax; double ra; double dec; float lambda_design;
float lambda_eff; float coord_epoch; short spectrographId; short fiberId; float mag[5]; char optical_prov[120];
float bp_mag; float gaia_g_mag; float rp_mag; float h_mag; long catalogid; long carton_to_target_pk; char cadence[400];
char firstcarton[400]; char program[400]; char category[400]; long sdssv_boss_target0; long sdssv_apogee_target0;
double delta_ra; double delta_dec;"""
"""Types and names of the columns of the table FIBERMAP in a new file."""
NATIVE = {
    "positioner": "holeId",
    "fiber_type": "fiberType",
    "target_id": "catalogid",
    "theta": "alpha",
    "phi": "beta",
    "ra": "racat",
    "dec": "deccat",
    "pm_ra": "pmra",
    "pm_dec": "pmdec",
    "ra_fiber": "ra",
    "dec_fiber": "dec",
}
"""Name of each column in a plan, and its name in a confSummary file.

A plan and a file contain the same values, except that missing numbers are -999 in a file, and NaN or -1 in a plan.
"""
BANDS = {"u": 0, "g": 1, "r": 2, "i": 3, "z": 4, "bp": "bp_mag", "gaia_g": "gaia_g_mag", "rp": "rp_mag", "h": "h_mag"}
"""Name of each band, and its index in the column ``mag`` or the name of its own column."""
REQUIRED = ("holeId", "fiberType", "assigned")
ANGLES = ("theta", "phi", "ra", "dec", "pm_ra", "pm_dec", "ra_fiber", "dec_fiber")


def recognizes(path: Path) -> bool:
    """Return whether a file is a yanny file with the table FIBERMAP, or has a name that ends in ``.par``."""
    if suffix_of(path) == ".par":
        return True
    head = head_of(path, 2**14)
    return head.startswith(b"#%yanny") and b"FIBERMAP" in head


def read(path: Path) -> QTable:
    """Return the plan that a file contains.

    ``x`` and ``y`` are coordinates on the wok, the plate that holds the positioners. They are read from ``xwok`` and
    ``ywok``. Files of 2021 and 2022 lack these columns; for such files, ``x`` and ``y`` are ``xFocal`` and ``yFocal``,
    rotated by the position angle. ``ra`` and ``dec`` are the catalog position of the target; ``ra_fiber`` and
    ``dec_fiber`` are the position of the fiber on the sky.
    """
    rows, struct, header = _parse(path)
    check_columns(rows, REQUIRED, f"{path}: the table FIBERMAP")
    n = len(rows["holeId"])
    _check_fibers(rows["holeId"], rows["fiberType"], path)
    site = header.get("observatory", "")
    if site not in INSTRUMENTS:
        raise InputError(f"{path}: observatory must be APO or LCO, got {site!r}")
    rotation = _number(header, "pa", path)
    if "xwok" in rows and "ywok" in rows:
        xy = _filled(rows.pop("xwok")), _filled(rows.pop("ywok"))
    elif "xFocal" in rows and "yFocal" in rows:
        if rotation is None:
            raise InputError(f"{path}: the header must have the position angle pa, got none")
        xy = plan_values.to_wok(_filled(rows["xFocal"]), _filled(rows["yFocal"]), rotation)
    else:
        raise InputError(f"{path}: the table FIBERMAP must have xwok and ywok, or xFocal and yFocal, got neither")
    assigned = rows.pop("assigned") == 1
    kind = _kinds(rows.get("category", np.full(n, "", dtype="U1")), assigned)
    columns = {"kind": kind, "assigned": assigned, "x": xy[0], "y": xy[1]}
    for name, native in NATIVE.items():
        if native in rows:
            values = rows.pop(native)
            columns[name] = _filled(values) if name in ANGLES else values
    ids = columns.get("target_id", np.full(n, -1))
    columns["target_id"] = np.where(ids == MISSING, -1, ids)
    rows = {**{name: columns.pop(name) for name in ("ra_fiber", "dec_fiber") if name in columns}, **rows}
    return plan_values.make_plan(
        columns,
        rows,
        format=FORMAT,
        instrument=INSTRUMENTS[site],
        header=header,
        racen=_number(header, "raCen", path),
        deccen=_number(header, "decCen", path),
        position_angle=rotation,
        epoch=_epoch(header, path),
        struct=[f"{kind} {name}" for name, kind in struct.items()],  # a list, because ECSV sorts the keys of a dict
        **plan_values.from_keywords(header),
    )


def write(plan: QTable, path: Path, *, overwrite: bool) -> None:
    """Write a plan as a confSummary file, which is compressed if its name ends in ``.par.gz``."""
    with writing_to(path, (".par",), overwrite=overwrite, gzipped=True) as temporary, _yanny() as module:
        rows, header = _native_rows(plan, path), _native_header(plan, path)
        plain = temporary.with_name("plain.par")
        enums = {"fiberType": ("FIBERTYPE", FIBERS)}
        module.write_ndarray_to_yanny(str(plain), rows, "FIBERMAP", enums, header, ["", path.name, ""])
        if path.suffix.lower() == ".gz":
            temporary.write_bytes(gzip.compress(plain.read_bytes(), mtime=0))
        else:
            plain.rename(temporary)


def file_name(_: QTable, tile: str) -> str:
    """Return the name of the file of a tile."""
    return f"confSummary-{tile}.par"


def lost(plan: QTable) -> list[str]:
    """Return a list of texts that describe which data this format cannot represent."""
    names = {*map(plan_values.own_name, _struct(plan)), *NATIVE, "kind", "assigned", "x", "y"}
    texts = plan_values.texts_of_lost(plan, names, FORMAT)
    if "category" in plan.colnames and (_categories(plan) != np.asarray(plan["category"]).astype(str)).any():
        texts.append("the categories that do not state the kind of their targets")
    return texts + ["the joint angles computed from nominal arm lengths"] * _is_nominal(plan)


def magnitudes(plan: QTable) -> dict[str, np.ndarray]:
    """Return the magnitudes of a plan by the names that SDSS-V uses in its design rules (``BANDS``)."""
    mag = np.asarray(plan["mag"]) if "mag" in plan.colnames else np.empty((len(plan), 0))
    by_index = {name: mag[:, at] for name, at in BANDS.items() if isinstance(at, int) and at < mag.shape[-1]}
    return by_index | {name: np.asarray(plan[at]) for name, at in BANDS.items() if at in plan.colnames}


def neglected(plan: QTable, sky: bool) -> list[str]:
    """Return a text if a score of the sky positions of assigned rows neglects offsets of the targets."""
    if not sky or not {"delta_ra", "delta_dec"} <= {*plan.colnames}:
        return []
    offsets = np.array([to_plain(plan[name]) for name in ("delta_ra", "delta_dec")])
    n = int((~np.isin(offsets, (0, MISSING)) & np.isfinite(offsets)).any(axis=0).sum())
    return [f"the offsets delta_ra and delta_dec of {number_of(n, 'target')} are neglected"] if n else []


@contextmanager
def _yanny():
    """Provide the module that reads yanny files, and ignore the warnings that its import and its functions cause."""
    with warnings.catch_warnings():
        text = r"[\s\S]*The TestRunner(Base)? class is deprecated"
        warnings.filterwarnings("ignore", text, AstropyDeprecationWarning)
        warnings.filterwarnings("ignore", "'maxsplit' passed as positional", DeprecationWarning)
        try:
            module = import_module("pydl.pydlutils.yanny")
        except ImportError as error:
            raise InputError(
                f"confSummary files need another package: {error} (pip install 'rfpsurvey[sdss]')"
            ) from error
        yield module


def _parse(path: Path):
    """Return the columns of FIBERMAP, their types, and the header of a file."""
    try:
        text = content_of(path).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} cannot be read as yanny: {sentence(error)}") from None
    if not text.endswith("\n"):
        raise InputError(f"{path}: the last line must end with a line break, got none; the file may be truncated")
    n = len(re.findall(r"(?mi)^\s*FIBERMAP\s", text))
    if "FIBERMAP;" in text and n == 0:
        raise InputError(f"{path}: the table FIBERMAP must have at least one row, got none")
    widths = sum(map(int, re.findall(r"\[(\d{1,12})\]", text.partition("FIBERMAP;")[0])))
    # four bytes per character in memory; a small file can declare columns that would fill the memory
    if 4 * widths * n > max(MOST_BYTES, 64 * len(text)):
        raise InputError(f"{path}: {n} rows of text must fit into memory, got {widths} characters in each row")
    with _yanny() as module, tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy.par"
        copy.write_text(text, encoding="utf-8", newline="")
        try:
            contents = module.yanny(str(copy))
            rows = contents["FIBERMAP"]
            struct = {name: contents.type("FIBERMAP", name) for name in contents.columns("FIBERMAP")}
            header = {key: str(contents[key]) for key in contents.pairs()}
            columns = {
                name: np.char.decode(rows[name], "utf-8") if rows[name].dtype.kind == "S" else np.array(rows[name])
                for name in struct
            }
        except KeyError:
            raise InputError(f"{path}: the file must have a complete definition of the table FIBERMAP") from None
        except Exception as error:  # the reader can raise any exception
            raise InputError(f"{path} cannot be read as yanny: {sentence(error)}") from error
    return columns, struct, header


def _check_fibers(holes: np.ndarray, types: np.ndarray, path: Path) -> None:
    """Raise an error if a fiber has several rows, or if robots have different numbers of rows."""
    fibers, counts = np.unique(np.array([holes, types]).astype(str), axis=1, return_counts=True)
    if (counts > 1).any():
        twice = " ".join(fibers[:, counts > 1][:, 0])
        raise InputError(f"{path}: each fiber must have one row, got several for {twice}")
    _, counts = np.unique(holes, return_counts=True)
    if (counts != counts[0]).any():
        raise InputError(
            f"{path}: every holeId must occur in the same number of rows, got {counts.min()} to {counts.max()}; "
            "the file may be truncated"
        )


def _number(header: dict, name: str, path: Path) -> float | None:
    """Return the value of a header keyword as a number, or None if the keyword or its value is missing."""
    text = header.get(name, str(MISSING))
    if not is_number(text):
        raise InputError(f"{path}: {name} in the header must be a number, got {text!r}")
    if not np.isfinite(value := float(text)):
        raise InputError(f"{path}: {name} in the header must be a finite number, got {text!r}")
    return None if value == MISSING else value


def _epoch(header: dict, path: Path) -> str | None:
    """Return the epoch of the observation, a Julian date in the header, as a Julian year; None if it is missing."""
    text = header.get("epoch", str(MISSING))
    if is_number(text):
        day = _number(header, "epoch", path)
        if day is not None and not FIRST_DAY < day < LAST_DAY:
            limits = f"a Julian date from {FIRST_DAY} to {LAST_DAY}"
            raise InputError(f"{path}: epoch in the header must be {limits}, got {text}")
        time = None if day is None else Time(day, format="jd")
    else:
        time = to_time(text, f"{path}: epoch in the header")
    return None if time is None else f"J{time.jyear:.6f}"


def _filled(values: np.ndarray) -> np.ndarray:
    """Return a column as float64, with NaN for missing values."""
    return np.where(values == MISSING, np.nan, values.astype(float))


def _coded(values: np.ndarray) -> np.ndarray:
    """Return numbers with the code for missing values in place of NaN and infinity."""
    return np.where(np.isfinite(values), values, MISSING)


def _is_nominal(plan: QTable) -> bool:
    return plan.meta["format"] == "tile" and plan.meta["header"].get("layout") != "as built"


def _struct(plan: QTable) -> dict[str, str]:
    """Return the names and types of the columns of the file to write.

    If the plan was read from a confSummary file, the new file has the columns of that file; otherwise, it has the
    default columns ``STRUCT``.
    """
    if "struct" in plan.meta:
        return {name: kind for kind, name in (entry.split() for entry in plan.meta["struct"])}
    pairs = (entry.split() for entry in STRUCT.replace("\n", " ").split(";") if entry.strip())
    return {name.partition("[")[0]: kind + name[name.find("[") :] * ("[" in name) for kind, name in pairs}


def _native_rows(plan: QTable, path: Path) -> np.ndarray:
    """Return the rows of the file as a structured array."""
    plan_values.check_instrument(plan, path, "a confSummary file", *INSTRUMENTS.values())
    struct, n, fields = _struct(plan), len(plan), []
    check_columns(struct, REQUIRED, f"{path}: the table FIBERMAP")
    given = _given(plan, struct)
    _check_fibers(given["holeId"], given["fiberType"], path)
    for name, kind in struct.items():
        base, sizes = kind.partition("[")[0], [int(size) for size in re.findall(r"\[(\d+)\]", kind)]
        values = given.get(name)
        if base in TYPES:
            shape = tuple(sizes)
            values = np.full((n, *shape), MISSING) if values is None else np.asarray(values)
            fields.append(
                (name, TYPES[base], shape, plan_values.to_type(values, TYPES[base], f"{path}: the column {name!r}"))
            )
        else:
            values = np.full(n, "") if values is None else np.asarray(values).astype(str)
            _check_text(values, name, path)
            width = max(*sizes[-1:], 1, np.char.str_len(values).max(initial=1))
            fields.append((name, f"S{width}", tuple(sizes[:-1]), np.char.encode(values, "ascii")))
    rows = np.empty(n, dtype=[(name, dtype, shape) if shape else (name, dtype) for name, dtype, shape, _ in fields])
    for name, *_, values in fields:
        rows[name] = values
    return rows


def _given(plan: QTable, struct: dict) -> dict:
    """Return the columns of a plan with the names, the units and the code for missing values of a confSummary file."""
    plain = {name: np.asarray(getattr(plan[name], "value", plan[name])) for name in plan.colnames}
    x, y = (np.where(np.isfinite(plain[name]), plain[name], np.nan) for name in ("x", "y"))
    given = {name: plain[plan_values.own_name(name)] for name in struct if plan_values.own_name(name) in plain}
    for name, native in NATIVE.items():
        if name in plain and not (name in ("theta", "phi") and _is_nominal(plan)):
            given[native] = _coded(plain[name]) if name in ANGLES else plain[name]
    ids = plain["target_id"]
    if ids.dtype.kind == "U":
        none = np.isin(ids, ("", "-1"))
        if not np.char.isdecimal(ids[~none]).all():
            raise InputError("catalogid must be whole numbers, got text for the identifiers of targets")
        ids = plan_values.to_type(np.where(none, "-1", ids), "i8", "catalogid")
    if (ids[plain["assigned"].astype(bool)] == MISSING).any():
        raise InputError(f"catalogid must differ from {MISSING} for all targets, because {MISSING} means no target")
    given["catalogid"] = np.where(ids == -1, MISSING, ids)
    given["assigned"] = plain["assigned"].astype(int)
    given.setdefault("valid", np.isfinite(x).astype(int))
    epoch = plan.meta.get("epoch")
    year = MISSING if epoch is None else to_time(epoch, "epoch").jyear
    for name, value in {"coord_epoch": year, "on_target": 0, "decollided": 0}.items():
        given.setdefault(name, np.full(len(plan), value))
    first = [t if t else "BOSS" for t in plain["fiber_type"].tolist()]
    given["fiberType"] = np.array([t if t in FIBERS else "NONE" for t in first])
    category = _categories(plan)
    joined = [f"{c}_{t.lower()}" for c, t in zip(category.tolist(), first, strict=True)]
    given["category"] = np.where(np.isin(category, ("sky", "standard")), joined, category)
    given["xwok"], given["ywok"] = _coded(x), _coded(y)
    angle = plan.meta.get("position_angle")
    focal = (np.full(len(plan), np.nan),) * 2 if angle is None else plan_values.to_wok(x, y, -angle)
    for name, values in zip(("xFocal", "yFocal"), focal, strict=True):
        recorded = given.get(name, np.full(len(plan), np.nan))
        given[name] = np.where(np.isnan(values) | (np.abs(recorded - values) < 1e-9), recorded, values)
        given[name] = _coded(given[name])
    return given


def _kinds(category: np.ndarray, assigned: np.ndarray) -> np.ndarray:
    """Return the kinds of targets, which their categories state, such as ``sky_boss``."""
    is_kind = [np.char.startswith(category, word) for word in ("sky", "standard")]
    return np.select(is_kind, ("sky", "standard"), np.where(assigned, "science", ""))


def _categories(plan: QTable) -> np.ndarray:
    """Return the category of each target or, if it states another kind than that of the target, this kind."""
    kind = last_role(np.asarray(plan["kind"]).astype(str))
    category = np.asarray(plan["category"] if "category" in plan.colnames else kind).astype(str)
    return np.where((kind == "") | (_kinds(category, plan["assigned"]) == kind), category, kind)


def _check_text(values: np.ndarray, name: str, path: Path) -> None:
    """Raise an error for text that yanny files cannot contain."""
    for text in np.unique(values).tolist():
        if not (text.isascii() and (text.isprintable() or not text)) or '"' in text or text[:1] == "{" or "\\" in text:
            raise InputError(f"{path}: yanny files cannot hold the text {text!r} of {name!r}; change it")


def _native_header(plan: QTable, path: Path) -> dict[str, str]:
    """Return the header of a confSummary file; a plan that was read from such a file keeps the header of that file."""
    meta = plan.meta
    if meta["format"] == FORMAT:
        header = dict(meta["header"])
    else:
        epoch = meta.get("epoch")
        header = {
            "instruments": "BOSS APOGEE",
            "epoch": MISSING if epoch is None else to_time(epoch, f"{path}: epoch").jd,
            "observatory": next(site for site, name in INSTRUMENTS.items() if name == meta["instrument"]),
            "raCen": meta.get("racen", MISSING),
            "decCen": meta.get("deccen", MISSING),
            "pa": meta.get("position_angle", MISSING),
        }
        if "time" in meta.get("conditions", {}):
            header["obstime"] = to_moment(meta["conditions"]["time"], "time").strftime("%a %b %d %H:%M:%S %Y")
    header = plan_values.without_keywords(header) | plan_values.to_keywords(meta)
    header = {key: str(value) for key, value in header.items()}
    _epoch(header, path)  # raises an error for a value that cannot be read again
    for key, text in header.items():
        _check_text(np.array([text]), key, path)
        if "#" in text or re.search(r"\s", key) or key.upper() == "FIBERMAP":
            raise InputError(f"{path}: yanny files cannot hold the keyword {key!r} with the value {text!r}; change it")
    return header
