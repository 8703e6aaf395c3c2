"""The table of a plan, and the formats of files in which plans are stored.

Each format is a module, or an object of another package, with ``ENDINGS`` (the endings of its files) and four
functions: ``read(path)`` returns the table of a plan, ``write(plan, path, *, overwrite)`` writes a plan to a file,
``recognizes(path)`` returns whether a file has the format, and ``lost(plan)`` describes the data that the format cannot
represent. Further names are optional (`OPTIONAL`).
"""

import os
import re
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from astropy.table import MaskedColumn, QTable, Table

from rfpsurvey._common.files import has_ending, suffix_of, to_path
from rfpsurvey._common.plugins import find_plugin, plugin_names
from rfpsurvey._common.read_documents import check_is_file, reading, sentence
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._common.units import to_plain
from rfpsurvey._field.plan_values import ENTRIES, find_instrument_file, make_plan
from rfpsurvey.errors import InputError, InputTypeError, check_keywords, warn

FORMATS = ("confsummary", "fiberassign", "pfsdesign")
"""Names of the formats of other programs; the format ``name`` is the module ``_name``."""
TABLE = "table"
"""The format of this package, which is tested last."""
GROUP = "rfpsurvey.plan_formats"
"""Group of entry points of packages that add formats."""
PARTS = ("ENDINGS", "read", "write", "recognizes", "lost")
OPTIONAL = {
    "magnitudes": lambda plan: {},
    "neglected": lambda plan, sky: [],
    "NORTH_OF_DATE": "",
    "EPOCH_OF_OBSERVATION": False,
}
"""Names that a format can also have, which ``docs/plugins.rst`` describes, and what formats without them use."""

REQUIRED = ("positioner", "fiber_type", "target_id", "kind", "assigned", "x", "y")
FROM_TILE = {"id": "positioner", "tip_x": "x", "tip_y": "y"}
PRIVATE = {"struct", "formats", "columns", "comments", "guide_stars", "extensions"}
"""Entries of the ``meta`` of plans that were read from files; if these entries were edited, writing can fail."""
OMITTED = ("x", "y", "status", "elbow_x", "elbow_y", "in_collision", "colliding_with", "clearance", "arm_x", "arm_y")


@check_keywords
def read_plan(path: str | os.PathLike, format: str | None = None) -> QTable:  # noqa: A002
    """Read a plan that another program wrote.

    Parameters
    ----------
    path : str or path-like
        File in one of the formats ``confsummary`` (SDSS-V, ``confSummary-*.par``), ``fiberassign`` (DESI,
        ``fiberassign-*.fits``), ``pfsdesign`` (PFS, ``pfsDesign-0x*.fits``) and ``table`` (a plan that `write_plan`
        wrote as ECSV or FITS, or a tile of this package), or in a format of an installed package (:doc:`/plugins`).
    format : str, optional
        Name of the format; by default, the format is recognized from the file.

    Returns
    -------
    QTable
        Table with a row for each fiber in the file. Columns: ``positioner``, ``fiber_type`` (empty if the instrument
        has only one fiber type), ``target_id`` (-1 or empty for a fiber without a target), ``kind`` (``science``,
        ``sky``, ``standard`` or empty), ``assigned`` (whether the fiber has a target), and ``x``, ``y`` (position of
        the fiber on the focal plane; NaN if it is missing). The next columns are optional; they exist if the file
        contains these data: ``theta``, ``phi`` (joint angles), ``ra``, ``dec`` (ICRS), ``pm_ra``, ``pm_dec`` and
        ``priority``. All other columns of the file follow under their own names. The ``meta`` contains ``format``,
        ``instrument`` and ``header`` (all keywords of the file). The entries ``racen``, ``deccen`` (field center, deg),
        ``position_angle`` (deg), ``epoch``, ``north_of``, ``projection`` and ``conditions`` (as in the provenance of a
        tile) of the ``meta`` are missing if the file does not contain these data.

    Raises
    ------
    InputError
        If the file does not exist or is damaged, or if its format is unknown.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> rs.plans.read_plan("notes.txt")
    Traceback (most recent call last):
        ...
    rfpsurvey.errors.InputError: notes.txt: there is no such file
    """
    path = _existing(path)
    if format is None:
        format = recognize_plan(path)  # noqa: A001
        if format is None:
            if suffix_of(path) == ".fits":
                read_table(path)  # raises an error if the file is damaged
            raise InputError(f"{path}: the file must be a plan in one of the formats {', '.join(_names())}")
    module = _format(format)
    with reading(path, f"a plan in the format {format}"):
        plan = module.read(path)
    find_instrument_file(plan, path)
    return plan


@check_keywords
def write_plan(
    plan: object,
    path: str | os.PathLike,
    *,
    format: str | None = None,  # noqa: A002
    overwrite: bool = False,
) -> None:
    """Write a plan in the format of another program; if writing fails, no incomplete file remains.

    If the format cannot represent some data of the plan, a warning names these data.

    Parameters
    ----------
    plan : QTable or Tile
        A plan as `read_plan` returns it, or a tile.
    path : str or path-like
        Path of the new file.
    format : str, optional
        Name of the format, as in `read_plan`. By default, the format is the entry ``format`` in the ``meta`` of the
        plan, if ``path`` has an ending of this format. Otherwise, the format is ``table`` for the endings ``.ecsv`` and
        ``.fits``, ``confsummary`` for the ending ``.par``, and the format of an installed package for other endings.
    overwrite : bool, optional
        Whether to replace an existing file.

    Raises
    ------
    InputError
        If the format is unknown or cannot represent the plan, or if the file exists and ``overwrite`` is False.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> import rfpsurvey as rs
    >>> lamost = rs.Instrument.preset("lamost")
    >>> x, y = lamost.focal_plane.xy[:2].T
    >>> tile = rs.score_tile(QTable({"positioner": [0, 1], "x": x, "y": y}), lamost)
    >>> rs.plans.write_plan(tile, "plan.ecsv", overwrite=True)
    >>> rs.plans.read_plan("plan.ecsv")["positioner"][:2].tolist()
    [0, 1]
    """
    path, plan = to_path(path), as_plan(plan)
    module = _format_for(plan, path) if format is None else _format(format)
    try:
        lost = module.lost(plan)
        module.write(plan, path, overwrite=overwrite)
    except InputError:
        raise
    except (KeyError, ValueError, TypeError, AttributeError, IndexError) as error:
        if not PRIVATE & set(plan.meta):
            raise
        raise InputError(f"{path}: the plan cannot be written, because it is damaged: {sentence(error)}") from error
    if lost:
        warn(f"{path} was written without {', '.join(lost)}, which this format cannot hold")


def file_name(plan: QTable, tile: int | str, format: str) -> str:  # noqa: A002
    """Return the usual name of the file of a tile in a format."""
    module, name = _format(format), re.sub(r"[^\w.+-]", "_", str(tile))
    usual = getattr(module, "file_name", lambda plan, name: f"tile-{name}{module.ENDINGS[0]}")
    return usual(plan, name)


def recognize_plan(path: str | os.PathLike) -> str | None:
    """Return the name of the format of a file, or None if the file is not a plan.

    Parameters
    ----------
    path : str or path-like
        Path of the file.

    Returns
    -------
    str or None
        Name of the format.

    Raises
    ------
    InputError
        If the file does not exist.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> from pathlib import Path
    >>> _ = Path("stars.csv").write_text("ra,dec")
    >>> rs.plans.recognize_plan("stars.csv") is None
    True
    """
    return native_format(path) or (TABLE if _format(TABLE).recognizes(_existing(path)) else None)


def native_format(path: str | os.PathLike) -> str | None:
    """Return the name of the format of a plan file of another program, or None for any other file, such as a table."""
    path = _existing(path)
    for name in _names()[:-1]:
        try:
            if _format(name).recognizes(path):
                return name
        except InputError as error:
            if name in FORMATS:
                raise
            warn(f"{error}; other formats are still recognized")
    return None


def plan_roles(table: Table) -> dict[str, str]:
    """Return a dict from each role of a column of a plan to the name of this column.

    Roles state what columns contain, such as ``id``, ``ra`` and ``x``. If the table is not a plan, the dict is empty.
    """
    if not is_plan(table):
        return {}
    names = {"id": "target_id", "pmra": "pm_ra", "pmdec": "pm_dec", "epoch": "coord_epoch"}
    same_names = ("positioner", "fiber_type", "kind", "x", "y", "ra", "dec", "priority")
    return {role: name for role, name in {**{n: n for n in same_names}, **names}.items() if name in table.colnames}


def is_plan(table: object) -> bool:
    """Return whether a table is a plan, as ``read_plan`` returns it.

    Parameters
    ----------
    table : Table
        The table.

    Returns
    -------
    bool
        Whether the table has the columns and the ``meta`` of a plan.

    Examples
    --------
    >>> from astropy.table import QTable
    >>> import rfpsurvey as rs
    >>> rs.plans.is_plan(QTable({"positioner": [0]}))
    False
    """
    return (
        isinstance(table, Table) and isinstance(table.meta.get("header"), dict) and set(REQUIRED) <= {*table.colnames}
    )


def as_plan(plan: object) -> QTable:
    """Return the plan of a tile; a plan is returned unchanged.

    Parameters
    ----------
    plan : QTable or Tile
        A plan, a tile, or the table of a tile.

    Returns
    -------
    QTable
        The plan, with a row for each positioner of the tile.

    Raises
    ------
    InputError
        If ``plan`` is neither a tile nor a plan.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> import rfpsurvey as rs
    >>> lamost = rs.Instrument.preset("lamost")
    >>> x, y = lamost.focal_plane.xy[:2].T
    >>> tile = rs.score_tile(QTable({"positioner": [0, 1], "x": x, "y": y}), lamost)
    >>> int(rs.plans.as_plan(tile)["assigned"].sum())
    2
    """
    if is_plan(plan):
        return plan
    table = getattr(plan, "table", plan)
    if not isinstance(table, QTable) or not is_tile(table):
        raise InputTypeError(f"a plan must be a table that read_plan returned, or a Tile, got {type(plan).__name__}")
    parameters = table.meta["provenance"]["parameters"]
    has_target = np.isin(table["status"], ("assigned", "out_of_reach"))
    none = np.full(len(table), "")
    columns = {
        **{name: np.asarray(table[name]) if name in table.colnames else none for name in ("fiber_type", "kind")},
        "positioner": np.asarray(table["id"]),
        "target_id": _filled(table["target_id"], has_target),
        "assigned": has_target,
        "x": table["tip_x"],
        "y": table["tip_y"],
        **{name: table[name] for name in ("theta", "phi", "ra", "dec", "priority") if name in table.colnames},
    }
    further = {name: table[name] for name in table.colnames if name not in {*columns, *OMITTED, *FROM_TILE}}
    return make_plan(
        columns,
        further,
        format="tile",
        instrument=table.meta["provenance"]["instrument"]["name"],
        header={"layout": table.meta["provenance"]["instrument"].get("layout", "")},
        racen=parameters.get("ra_deg"),
        deccen=parameters.get("dec_deg"),
        position_angle=parameters.get("position_angle_deg"),
        epoch=parameters.get("epoch"),
        **{name: parameters.get(name) for name in ENTRIES}
        | {"instrument_digest": table.meta["provenance"]["instrument"].get("digest")},
    )


def further_columns(table: Table) -> dict[str, np.ndarray]:
    """Return the columns of a plan with one value per row, and its magnitudes by the names of the bands."""
    plain = {name: to_plain(table[name]) for name in table.colnames if table[name].ndim == 1}
    return format_of(table).magnitudes(table) | plain


def format_of(table: Table) -> SimpleNamespace:
    """Return the optional functions and facts (`OPTIONAL`) of the format of a plan; the usual ones for other tables."""
    name = table.meta.get("format")
    module = _format(name) if name in _names() else None
    return SimpleNamespace(**{part: getattr(module, part, usual) for part, usual in OPTIONAL.items()})


def is_tile(table: Table) -> bool:
    """Return whether a table describes a tile of this package."""
    provenance = table.meta.get("provenance")
    return {"status", "in_collision", "target_id"} <= {*table.colnames} and isinstance(provenance, dict)


def _filled(ids, has_target) -> np.ndarray:
    """Return identifiers with -1 or empty text for positioners without a target."""
    values = np.asarray(ids.filled() if isinstance(ids, MaskedColumn) else ids)
    return np.where(has_target, values, -1 if values.dtype.kind == "i" else "")


def _existing(path: object) -> Path:
    path = to_path(path)
    check_is_file(path)
    return path


def _names() -> list[str]:
    """Return the names of all formats, in the order in which files are tested."""
    return [*FORMATS, *sorted(plugin_names(GROUP) - {*FORMATS, TABLE}), TABLE]


def _format(name: str) -> object:
    """Return the module of a format; the functions of another package raise only errors that name the package."""
    if isinstance(name, str) and name in (*FORMATS, TABLE):
        return import_module(f"rfpsurvey._field.format_{name}")
    plugin = find_plugin(GROUP, name, (*FORMATS, TABLE), "format of plans")
    if lacking := [part for part in PARTS if not hasattr(plugin.value, part)]:
        raise InputError(f"{plugin} must have {', '.join(PARTS)}, but lacks {', '.join(lacking)}")

    def guarded(function):
        def call(*given, **options):
            with plugin.answering():
                return function(*given, **options)

        return call

    parts = {name: getattr(plugin.value, name) for name in (*PARTS, *OPTIONAL) if hasattr(plugin.value, name)}
    return SimpleNamespace(**{name: guarded(part) if callable(part) else part for name, part in parts.items()})


def _format_for(plan: QTable, path: Path) -> object:
    """Return the format of the plan if it fits the ending of the path, otherwise ``table`` or the first that fits."""
    names, endings = _names(), set()
    format_of_plan = plan.meta.get("format")
    # packages are imported only if no other format fits
    for name in dict.fromkeys([*([format_of_plan] if format_of_plan in names else []), TABLE, *names]):
        module = _format(name)
        if has_ending(path, module.ENDINGS):
            return module
        endings.update(module.ENDINGS)
    raise InputError(f"{path}: the name of a plan must end in one of {', '.join(sorted(endings))} (or with .gz)")
