"""Targets that events add, drop or change."""

from dataclasses import replace

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from astropy.time import Time

from rfpsurvey._common.io import check_fits_text
from rfpsurvey._common.units import to_flags, to_labels, to_plain, to_vectors, to_visits, values_at
from rfpsurvey._field.targets import PLANNED_COLUMNS
from rfpsurvey._sky.arrays import to_kinds
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._survey.history.events import Events, to_date
from rfpsurvey._survey.work import VISITS_COLUMNS
from rfpsurvey.errors import InputError, brief, listed, number_of, warn

ROW, ID, DROPPED = "target_row", "target_id", "dropped"
IS_ADDED = 2
"""Value in the column ``dropped`` of targets with the state ``added``."""
IDS = ("target", "target_id", "targetid", "id")
NUMBERS = ("priority", "subpriority", "ra", "dec", "pmra", "pmdec")
TEXTS = ("kind", "category", "fiber_type")
LIMITS = ("only_tile", "only_until")
"""Columns of the only tile, and of the last date, on which an added target is wanted."""
ROLES = (*NUMBERS, *TEXTS, "visits", "state", DROPPED, *LIMITS)
UNITS = {**dict.fromkeys(("ra", "dec", "position_angle"), u.deg), **dict.fromkeys(("pmra", "pmdec"), u.mas / u.yr)}
DEFAULTS = {"kind": "science", "category": "", "fiber_type": "", "visits": np.uint8(1), "priority": 0.0}
# Missing value of a column, by the kind of its data type; -1 for integers.
MISSING = {"f": np.nan, "U": "", "b": False}
# Largest distance of a target that is recorded again from its position in the catalog: about 1 mas.
TOLERANCE_RAD = 5e-9


def target_changes(table: Table, events: Events, survey) -> tuple[QTable, int]:
    """Return the changes that a table of targets contains, with the row of each target, or raise an error.

    Missing values change nothing. Targets that the survey does not contain are added. The changes contain no rows that
    were already recorded; the second value is the number of these rows.
    """
    lower = {name.lower(): name for name in reversed(table.colnames)}
    name = next((lower[role] for role in IDS if role in lower), None)
    if name is None:
        raise InputError(
            f"a table of events must have a column tile or target, got the columns {listed(table.colnames)}"
        )
    kinds = kinds_of(survey)
    further = {column: kind for column, kind in kinds.items() if column not in ROLES and column.lower() in lower}
    if not further and not {*ROLES} & {*lower}:
        raise InputError(
            f"a table of targets must have one of the columns {listed(ROLES)}, got {listed(table.colnames)}"
        )
    ids = np.asarray(to_labels(table[name], name))
    texts = np.asarray(survey.outcomes[ID])
    if texts.dtype.kind == "U" and ids.dtype.kind in "iu" and np.isin(ids.astype(str), texts).all():
        ids = ids.astype(str)  # tables without types contain text that consists of digits as numbers
    values, first, counts = np.unique(ids, return_index=True, return_counts=True)
    if (counts > 1).any():
        raise InputError(
            f"a table must have one row for each target, got {counts.max()} rows for {values[counts.argmax()]}"
        )
    dates = [lower[role] for role in ("date", "night") if role in lower]
    used = {name, *dates, *(lower[role.lower()] for role in (*ROLES, *further) if role.lower() in lower)}
    if unused := [column for column in table.colnames if column not in used]:
        warn(f"columns that are not used: {listed(unused)}")
    ids, table = values, table[first]  # events do not depend on the order of rows
    given = {role: table[lower[role]] for role in ROLES if role in lower}
    if "n_partitions" in survey.provenance["catalog"]:
        raise InputError("targets must be changed only in a survey of a catalog in memory, got a partitioned catalog")
    rows, n = _rows_of(ids, events, survey)
    new = np.flatnonzero(rows < 0)
    rows[new] = n + np.arange(len(new))
    changes = QTable({ROW: rows, ID: ids})
    for role, column in given.items():
        if role in NUMBERS:
            changes[role] = to_numbers(column, role)
        elif role in (*TEXTS, *LIMITS):
            changes[role] = np.char.strip(np.ma.filled(np.ma.asarray(column).astype(str), "").astype(str))
    if "kind" in given:
        kind = np.asarray(changes["kind"])
        changes["kind"] = np.where(kind == "", "", to_kinds(np.where(kind == "", "science", kind), "kind"))
    for column, kind in further.items():
        changes[column] = _further(table[lower[column.lower()]], column, kind, survey.provenance["units"].get(column))
    visits = to_numbers(given["visits"], "visits") if "visits" in given else np.full(len(ids), np.nan)
    to_visits(visits[~np.isnan(visits)], int((~np.isnan(visits)).sum()))
    changes["visits"] = np.where(np.isnan(visits), -1, visits).astype(np.int16)
    changes[DROPPED] = _dropped(given, len(ids))
    changes["date"] = [*map(to_date, table[dates[0]])] if dates else [""] * len(ids)
    check_fits_text({f"values of {column!r}": changes[column] for column in changes.colnames}, "omit these targets")
    _check_numbers(changes, new, "priority" in kinds or _has_priority([*events.target_tables, (n, changes)]), ids)
    complete = [column for column in further if _given(changes[column])[new].all()]
    lacking = [column for column in kinds if column not in (*ROLES, *complete)]
    unknown = [name for name in survey.provenance.get("rule_columns", ()) if name in lacking and name not in further]
    if len(new) and unknown:
        raise InputError(
            f"a table with added targets must have the column {unknown[0]}, which the survey uses, got "
            f"{listed(table.colnames)}"
        )
    if len(new) and lacking:
        warn(f"the values of {listed(lacking)} are not recorded for all added targets; rules treat them as missing")
    first = events.target_tables[0][0] if events.target_tables else n
    placed = changes["ra"] if "ra" in changes.colnames else np.full(len(ids), np.nan)
    if not {"state", "dropped"} & {*given} and (np.isfinite(placed) & (rows < first)).any():
        raise InputError(
            "a table of targets must have a column state if it contains positions of targets of the first plan, got "
            f"{listed(table.colnames)}, which can be a catalog; omit the positions, or add the column state"
        )
    known = _known(changes, events)
    return changes[~known], int(known.sum())


def _known(changes: QTable, events: Events) -> np.ndarray:
    """Return which rows contain only values that were already recorded, and warn of those that were changed since then.

    Rows without a date that were recorded before change a target again, except if they add the target.
    """
    stated = {name: np.asarray(changes[name]) for name in changes.colnames if name not in (ROW, ID, "date")}
    last = {name: np.full_like(values, MISSING.get(values.dtype.kind, -1)) for name, values in stated.items()}
    last[DROPPED][:] = 0
    known, repeated = np.ones(len(changes), dtype=bool), np.zeros(len(changes), dtype=bool)
    for _, table in events.target_tables:
        _, place_in_changes, place_in_table = np.intersect1d(changes[ROW], table[ROW], return_indices=True)
        same = np.asarray(changes["date"])[place_in_changes] == np.asarray(table["date"])[place_in_table]
        for name, values in stated.items():
            if name in table.colnames:
                recorded = np.asarray(table[name])[place_in_table]
                same &= ~_given(values[place_in_changes]) | (values[place_in_changes] == recorded)
                last[name] = _changed(last[name], place_in_changes, recorded)
            else:
                same &= ~_given(values[place_in_changes])
        repeated[place_in_changes] |= same
    for name, values in stated.items():
        same = values == last[name]
        if name == DROPPED:  # an added target is not dropped
            same = np.where(values == IS_ADDED, 0, values) == np.where(last[name] == IS_ADDED, 0, last[name])
        known &= ~_given(values) | same
    old = repeated & ~known & ((np.asarray(changes["date"]) != "") | (np.asarray(changes[DROPPED]) == IS_ADDED))
    if old.any():
        warn(
            f"{number_of(int(old.sum()), 'target')}, such as {changes[ID][old][0]}, were changed after this record, "
            "and the changes are kept; to undo them, record the target with another date, or with the state planned"
        )
    return known | old


def _given(values: np.ndarray) -> np.ndarray:
    """Return which values of a column are not missing."""
    values = np.asarray(values)
    return np.isfinite(values) if values.dtype.kind == "f" else values != ("" if values.dtype.kind == "U" else -1)


def _has_priority(tables: list[tuple[int, QTable]]) -> bool:
    """Return whether a priority was recorded; targets of a survey without priorities then have the priority 0."""
    return any(_given(table["priority"]).any() for _, table in tables if "priority" in table.colnames)


def kinds_of(survey) -> dict[str, str]:
    """Return the kinds of the data types of the optional columns of the catalog of a survey, by name."""
    if "target_columns" in survey.provenance:
        return survey.provenance["target_columns"]
    visits = next(iter(survey), QTable())  # earlier versions did not write the columns
    reserved = {*VISITS_COLUMNS, "tile"} - {*PLANNED_COLUMNS}
    return {name: visits[name].dtype.kind for name in visits.colnames if name not in reserved}


def _further(column, name: str, kind: str, unit: str | None) -> np.ndarray:
    """Return the values of a further column of the catalog, of the kind that it has there; -1 for missing integers."""
    missing = np.ma.getmaskarray(np.ma.asarray(getattr(column, "value", column)))
    if kind == "U":
        return np.char.strip(np.where(missing, "", np.asarray(to_plain(column, name)).astype(str)))
    if kind == "b":
        return flag_codes(column, name)
    if kind in "iu" and np.asarray(column).dtype.kind in "iu":
        return np.where(missing, -1, np.asarray(column).astype(np.int64))
    values = to_numbers(getattr(column, "value", column) if unit is None else column, name, unit and u.Unit(unit))
    if kind in "iu" and (values[np.isfinite(values)] % 1).any():
        raise InputError(f"{name} must be whole numbers, as in the catalog, got {values[values % 1 > 0][0]:g}")
    return np.where(np.isfinite(values), values, -1).astype(np.int64) if kind in "iu" else values


def apply_changes(
    catalog: Catalog, tables: list[tuple[int, QTable]], until: str | None = None, visits: int = 1
) -> tuple[Catalog, np.ndarray]:
    """Return the catalog after the recorded changes up to a date, and whether each target was dropped.

    The rows of the first catalog remain the same. Targets that were added later than this date are dropped.
    ``visits`` is the requested number of visits of added targets for which no number is recorded.
    """
    first = tables[0][0]
    if len(catalog) != first:
        raise InputError(
            f"the catalog must be that of the recorded events, with {number_of(first, 'target')}, got "
            f"{number_of(len(catalog), 'target')}"
        )
    changes = _stacked([table for _, table in tables])
    rows = np.asarray(changes[ROW])
    new = np.flatnonzero(rows >= first)
    new = new[np.unique(rows[new], return_index=True)[1]]  # a target that was added can be changed later
    catalog = _joined(catalog, changes[new], visits) if len(new) else catalog
    _check_same(catalog, changes, rows)
    late = np.zeros(len(rows), dtype=bool) if until is None else np.asarray(changes["date"]) > until
    dropped, changed = np.zeros(len(catalog), dtype=bool), {}
    dropped[rows[new[late[new]]]] = True
    changes, rows = changes[~late], rows[~late]
    for name in ("priority", "subpriority", "visits", *TEXTS):
        values, column = np.asarray(changes[name]), getattr(catalog, name)
        if not _given(values).any():
            continue
        if column is None and name not in DEFAULTS:
            warn(f"the recorded values of {name} have no effect, because the catalog has no column {name}")
            continue
        changed[name] = _changed(np.full(len(catalog), DEFAULTS[name]) if column is None else column, rows, values)
    for name in () if catalog.extra is None else {*changes.colnames} & {*catalog.extra.colnames}:
        extra = changed.setdefault("extra", catalog.extra.copy())
        extra[name] = _changed(extra[name], rows, np.asarray(changes[name]))
    catalog = replace(catalog, numbered=False, **changed) if changed else catalog
    state = np.asarray(changes[DROPPED])
    dropped[rows[state >= 0]] = state[state >= 0] == 1
    return catalog, dropped


def _changed(column, rows: np.ndarray, values: np.ndarray) -> np.ndarray | u.Quantity:
    """Return a column with other values, except missing values, in some rows; the last of several values remains."""
    changed, given = np.array(getattr(column, "value", column)), _given(values)
    changed = changed.astype(np.result_type(changed, values)) if changed.dtype.kind == "U" else changed
    changed[rows[given]] = values[given]
    return _like(changed, column)


def _stacked(tables: list[QTable]) -> QTable:
    """Return the rows of all tables, with missing values where a table lacks a column."""
    columns, names = {}, [name for table in tables for name in (*table.colnames, "priority", "subpriority", *TEXTS)]
    for name in dict.fromkeys(names):
        kinds = [table[name].dtype.kind for table in tables if name in table.colnames]
        missing = MISSING.get(kinds[0] if kinds else "U" if name in TEXTS else "f", -1)
        columns[name] = np.concatenate(
            [np.asarray(table[name]) if name in table.colnames else np.full(len(table), missing) for table in tables]
        )
    return QTable(columns)


def _rows_of(ids: np.ndarray, events: Events, survey) -> tuple[np.ndarray, int]:
    """Return the row of each target (-1 for new targets), and the number of targets of the survey."""
    known = np.asarray(survey.outcomes[ID])
    if known.dtype.kind != ids.dtype.kind:
        needed, given = ("text", "numbers") if known.dtype.kind == "U" else ("numbers", "text")
        raise InputError(f"the identifiers of targets must be {needed}, as in the catalog, got {given}")
    parts, numbers = [known], [np.arange(len(known))]
    for n, table in events.target_tables:
        rows = np.asarray(table[ROW])
        keep = rows >= max(n, len(known))
        parts.append(np.asarray(table[ID])[keep])
        numbers.append(rows[keep])
    known, number = np.concatenate(parts), np.concatenate(numbers)
    n_targets, used = len(known), np.isin(known, ids)
    known, number = known[used], number[used]
    values, times = np.unique(known, return_counts=True)
    if (times > 1).any():
        raise InputError(
            f"the identifier of a target must be unique, but the survey has {times.max()} targets "
            f"{values[times.argmax()]}"
        )
    rows = np.full(len(ids), -1, dtype=np.int64)
    _, place_in_ids, place_in_known = np.intersect1d(ids, known, return_indices=True)
    rows[place_in_ids] = number[place_in_known]
    return rows, n_targets


def _check_numbers(changes: QTable, new: np.ndarray, has_priority: bool, ids: np.ndarray) -> None:
    """Raise an error if numbers are not valid, or if new targets lack a position or columns that other targets have."""
    for name in {*NUMBERS} & {*changes.colnames}:
        if np.isinf(np.asarray(changes[name])).any():
            raise InputError(f"{name} must be finite numbers, got inf")
    if not len(new):
        return
    if not {"ra", "dec"} <= {*changes.colnames}:
        raise InputError(
            "target must be a target of the survey, or have the columns ra and dec, got "
            f"{brief(tuple(ids[new].tolist()))}"
        )
    for name in ("dec", "priority", "ra") if has_priority else ("dec", "ra"):
        bad = new if name not in changes.colnames else new[~np.isfinite(np.asarray(changes[name])[new])]
        if len(bad):
            raise InputError(
                f"{name} must be a finite number for every new target, got none for {brief(tuple(ids[bad].tolist()))}"
            )
    dec = np.asarray(changes["dec"])[new]
    if (np.abs(dec) > 90).any():
        raise InputError(f"dec must lie between -90 and 90 deg, got {dec[np.abs(dec) > 90][0]:g}")


def to_numbers(column, name: str, unit: u.UnitBase | None = None) -> np.ndarray:
    """Return the values of a column in a unit, by default degrees, mas / yr or no unit; NaN for missing values."""
    unit, given = unit or UNITS.get(name), getattr(column, "unit", None)
    try:
        values = np.ma.filled(np.ma.asarray(getattr(column, "value", column)).astype(float), np.nan)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be numbers: {error}") from None
    if given is None:
        return values
    try:
        return (values * u.Unit(given)).to_value(unit or u.dimensionless_unscaled)
    except u.UnitConversionError:
        raise InputError(f"{name} must have the unit {unit or 'of a plain number'}, got {given}") from None


def flag_codes(column, name: str) -> np.ndarray:
    """Return 1 for true, 0 for false, and -1 for missing values of a column, which can be empty text."""
    missing = np.ma.getmaskarray(np.ma.asarray(column))
    if np.asarray(column).dtype.kind == "U":
        missing = missing | (np.char.strip(np.asarray(column)) == "")
    if np.asarray(column).dtype.kind == "f":
        missing = missing | np.isnan(np.asarray(column))
    return np.where(missing, -1, to_flags(column, name)).astype(np.int16)


def _dropped(given: dict, n: int) -> np.ndarray:
    """Return 1 for dropped targets, 0 for targets that are observed again, 2 for added ones, and -1 for others."""
    if "dropped" in given:
        return flag_codes(given["dropped"], "dropped")
    if "state" not in given:
        return np.full(n, -1, dtype=np.int16)
    words = np.ma.filled(np.ma.asarray(given["state"]).astype(str), "").tolist()
    codes = {"dropped": 1, "planned": 0, "added": IS_ADDED, "": -1}
    for word in words:
        if word not in codes:
            raise InputError(f"the state of a target must be dropped, planned or added, got {word!r}")
    return np.array([codes[word] for word in words], dtype=np.int16)


def _check_same(catalog: Catalog, table: QTable, rows: np.ndarray) -> None:
    """Raise an error if the recorded targets are not those of the catalog."""
    different = np.flatnonzero(catalog.id[rows] != np.asarray(table[ID]))
    if len(different):
        raise InputError(
            f"the catalog must be that of the recorded events, got the target {catalog.id[rows[different[0]]]} in row "
            f"{rows[different[0]]} instead of {table[ID][different[0]]}"
        )
    if {"ra", "dec"} <= {*table.colnames}:
        given = np.isfinite(np.asarray(table["ra"])) & np.isfinite(np.asarray(table["dec"]))
        place = SkyCoord(np.asarray(table["ra"])[given], np.asarray(table["dec"])[given], unit="deg")
        apart = np.linalg.norm(to_vectors(place) - to_vectors(catalog.coord[rows[given]]), axis=1)
        if (apart > TOLERANCE_RAD).any():
            worst = rows[given][np.argmax(apart)]
            warn(
                f"{(apart > TOLERANCE_RAD).sum()} recorded positions of targets, such as that of target "
                f"{catalog.id[worst]}, differ from the catalog and are not used; to move a target, drop it, and add "
                "one with another identifier"
            )


def _joined(catalog: Catalog, new: QTable, visits: int) -> Catalog:
    """Return a catalog with further targets, whose positions refer to the epoch of the catalog."""
    n, icrs, epoch = len(new), catalog.coord.icrs, catalog.epoch
    if epoch is not None and not epoch.isscalar:
        warn("the catalog has an epoch for each target; the last epoch is assumed for added targets")
        epoch = Time(np.concatenate([epoch.jyear, np.full(n, epoch.jyear.max())]), format="jyear")
    names = {"ra": "ra", "dec": "dec"}
    names |= {"pm_ra_cosdec": "pmra", "pm_dec": "pmdec"} if catalog.has_proper_motion else {}
    coordinates = {}
    for coordinate, name in names.items():
        added = np.asarray(new[name]) if name in new.colnames else np.full(n, np.nan)
        coordinates[coordinate] = np.concatenate([getattr(icrs, coordinate).to_value(UNITS[name]), added]) * UNITS[name]
    columns = {"id": np.concatenate([catalog.id, np.asarray(new[ID])])}
    for name in ("priority", "subpriority", "visits", *TEXTS):
        added, present = np.asarray(new[name]), getattr(catalog, name)
        default, lacking = np.uint8(visits) if name == "visits" else DEFAULTS.get(name, 0.0), ~_given(added)
        if present is None and (name not in DEFAULTS or lacking.all()):
            continue
        if name not in DEFAULTS and lacking.any():
            warn(f"the {name} of {number_of(int(lacking.sum()), 'added target')} is not recorded; 0 is assumed")
        present = np.full(len(catalog), default) if present is None else present
        columns[name] = np.concatenate([present, np.where(lacking, default, added)])
    rows = np.append(np.arange(len(catalog)), np.full(n, -1))  # row -1 stands for missing values
    extra = None if catalog.extra is None else catalog.extra[rows]
    for name, column in () if extra is None else catalog.extra.items():
        extra[name] = _like(values_at(np.asarray(getattr(column, "value", column)), rows), column)
    coord = SkyCoord(**coordinates)
    return replace(catalog, coord=coord, extra=extra, epoch=epoch, numbered=False, **columns)


def _like(values: np.ndarray, column) -> np.ndarray | u.Quantity:
    """Return values with the unit of a column."""
    unit = getattr(column, "unit", None)
    return values if unit is None else values * unit
