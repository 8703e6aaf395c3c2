"""Method of `Instrument` that marks positioners as broken, stuck or restored, as listed in a table."""

import hashlib
import os
import warnings
from bisect import bisect_left
from collections import Counter
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import astropy.units as u
import erfa
import numpy as np
from astropy.table import Column, Table
from astropy.time import Time

from rfpsurvey._common.read_tables import is_number, read_table
from rfpsurvey._common.units import check_columns, to_labels, to_plain
from rfpsurvey._instruments.as_built import MOST_ANGLE, MOST_DEVICE, N_PETALS, ROW, numbers, whole
from rfpsurvey._instruments.desi_state import moment_of
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey.errors import InputError, InputUnitsError, check_choice, close_to, listed, short, warn

if TYPE_CHECKING:
    from rfpsurvey._instruments.instrument import Instrument

LISTED = "layout.states"
"""Name of the entry of a description that lists the states of positioners, or names a table of them."""
SUMMARY = "states"
"""First word of the names of the values that summarize the states of positioners."""
STATES = ("broken", "stuck", "restored")
UNCHANGED = "unchanged"
"""State of rows that change nothing."""
WORDS = {**{state: state for state in STATES}, "ok": "restored", UNCHANGED: UNCHANGED}
PARTS = ("file", "time", *STATES, "unused_rows", "digest")
COLUMNS = ("id", "state", "from", "to", "theta", "phi")
DESI = ("LOCATION", "BROKEN", "STUCK")
"""Columns by which the table fiberstatus of DESI's fiberassign is recognized."""
FIRST_JD, LAST_JD = 2.3e6, 2.6e6
ALWAYS = datetime.min.replace(tzinfo=UTC), datetime.max.replace(tzinfo=UTC)
MOST_NAMES = 10
FORM = "%Y-%m-%dT%H:%M:%S"


@dataclass(frozen=True)
class Row:
    """One row of a table of states: the state of a positioner from one moment until another."""

    id: str
    state: str
    first: datetime
    end: datetime
    pose: tuple[float, float] | None  # theta and phi in degrees


class States:
    """The method that `Instrument` inherits, which marks broken, stuck and restored positioners."""

    def with_states(self, states: str | os.PathLike | Table, *, time: Time | str | None = None) -> "Instrument":
        """Return the instrument with broken, stuck or restored positioners (:doc:`/instruments`).

        Parameters
        ----------
        states : str, path-like or Table
            Table, or file with a table, that has one row for each state of a positioner. The column ``id`` contains
            the identifiers of the positioners. The optional column ``state`` contains ``broken`` (the default),
            ``stuck``, ``ok`` or ``restored``, or ``unchanged`` (the row has no effect). A broken positioner takes no
            target; it is an obstacle in the pose of the columns ``theta`` and ``phi``, or parked if the row states no
            pose. A stuck positioner takes no target either and is an obstacle in its pose, and its fiber can observe
            blank sky. The state ``ok``
            replaces a state that the instrument has. The optional columns ``from`` and ``to`` contain the time (UTC)
            at which the state begins and the time at which it has ended: a date and time as text in ISO 8601, a
            Julian date, or no value if there is no limit. Angles without a unit are in degrees. The table
            ``fiberstatus.ecsv`` of DESI's fiberassign is also accepted (:doc:`/as_built_others`).
        time : Time or str, optional
            Time at which the states are evaluated, in UTC; required if a row has a date. If several times are given,
            all of them must give the same states.

        Returns
        -------
        Instrument
            The instrument. Its ``values``, ``notes`` and ``provenance`` contain the numbers of broken and stuck
            positioners, the number of rows that do not apply at ``time``, and the name of the file.

        Raises
        ------
        InputError
            If a file cannot be read, if an identifier is not an identifier of a positioner, if a value is not valid,
            if rows for the same positioner overlap in time but differ, or if rows have dates and no time is given.

        Examples
        --------
        >>> import rfpsurvey as rs
        >>> from astropy.table import Table
        >>> table = Table({"id": [7, 8], "state": ["broken", "stuck"], "theta": [0, 30], "phi": [180, 90]})
        >>> lamost = rs.Instrument.preset("lamost").with_states(table)
        >>> facts = lamost.facts()
        >>> facts["positioners"], facts["usable_positioners"]
        (4000, 3998)
        """
        if isinstance(states, str | os.PathLike):
            table, what, name = read_table(states), str(states), Path(states).name
        else:
            from rfpsurvey._sky.frames import as_table

            table, what, name = as_table(states, index_as_id=False)[0], "states", "a table"
        return _apply(self, _rows(table, self.focal_plane, what), time, what, name)


def apply_entry(instrument: "Instrument", folder: Path, time: Time | str | None) -> "Instrument":
    """Return the instrument with the states that its own description lists, or that a file in ``folder`` contains."""
    entry = instrument.values[LISTED]
    values = {name: value for name, value in instrument.values.items() if name != LISTED}
    instrument, origin = replace(instrument, values=values), {part: entry[part] for part in ("status", "source")}
    if isinstance(entry["value"], str):
        path = folder / entry["value"]
        rows = _rows(read_table(path), instrument.focal_plane, str(path))
        return _apply(instrument, rows, time, str(path), path.name, origin)
    names = dict.fromkeys(name for row in entry["value"] for name in row)
    for name in names:
        check_choice(name, COLUMNS, f"key of {LISTED}")
    table = Table({name: _cells([row.get(name) for row in entry["value"]]) for name in names})
    rows = _rows(table, instrument.focal_plane, LISTED)
    return _apply(instrument, rows, time, LISTED, "the description", origin)


def describe_states(instrument: "Instrument") -> str:
    """Return sentences with the numbers of broken and stuck positioners; empty text if no states were given."""
    texts = []
    for prefix in _prefixes(instrument.values):
        known = {part: instrument.values.get(f"{prefix}.{part}", {}).get("value") for part in PARTS}
        counts = ", ".join(f"{known[state]} {state}" for state in STATES if known[state] or state != "restored")
        at = f" at {known['time']} (UTC)" if known["time"] else ""
        texts.append(f"States of positioners from {known['file']}{at}: {counts}.")
        if known["unused_rows"]:
            texts.append(f"Rows that do not apply at this time: {known['unused_rows']}.")
    return " ".join(texts)


def _prefixes(values: dict) -> list[str]:
    """Return the first words of the names of the values that summarize states, one for each table of states."""
    return [name.removesuffix(".file") for name in values if name.startswith(SUMMARY) and name.endswith(".file")]


def _apply(instrument, rows: list[Row], time, what: str, name: str, origin: dict | None = None) -> "Instrument":
    """Return the instrument with the states of the rows that apply at a time."""
    plane = instrument.focal_plane
    index = {str(name): k for k, name in enumerate(plane.id.tolist())}
    _check_ids(rows, index, what, instrument.name)
    _check_overlaps(rows, what)
    moments = moments_at(time)
    used = [row for row in rows if _applies(row, moments, what)]
    disabled, stuck = plane.disabled.copy(), plane.arrays.stuck.copy()
    for row in used:
        k = index[row.id]
        disabled[k] = row.state == "broken"
        stuck[k] = np.nan if row.pose is None else np.deg2rad(row.pose)
    counts = Counter({row.id: row.state for row in used}.values())
    summary = {
        "file": name,
        "time": _time_text(moments) if moments and any((row.first, row.end) != ALWAYS for row in rows) else None,
        **{state: counts[state] for state in STATES},
        "unused_rows": sum(row.state != UNCHANGED for row in rows) - len(used),
        "digest": hashlib.sha256("\n".join(sorted(map(repr, rows))).encode()).hexdigest()[:16],
    }
    earlier = len(_prefixes(instrument.values))
    prefix = f"{SUMMARY}_{earlier + 1}" if earlier else SUMMARY
    origin = origin or {"status": "assumed", "source": f"with_states, {name}"}
    values = {f"{prefix}.{part}": {"value": value, **origin} for part, value in summary.items() if value is not None}
    changed = replace(
        instrument,
        focal_plane=replace(plane, disabled=disabled, stuck=stuck * u.rad),
        values={**instrument.values, **values},
    )
    text = describe_states(replace(changed, values=values))
    return replace(changed, notes=f"{instrument.notes.rstrip()} {text}".strip())


def _applies(row: Row, moments: list[datetime], what: str) -> bool:
    """Return whether a row applies at the given moments; raise an error if it applies only at some of them."""
    if row.state == UNCHANGED or (row.first, row.end) == ALWAYS:
        return row.state != UNCHANGED
    if not moments:
        raise InputError(
            f"{what}: the time of the observation must be given, because rows have dates (columns from and to), got no "
            "time; give time= (or --set instrument.state_time=DATE)"
        )
    n = bisect_left(moments, row.end) - bisect_left(moments, row.first)
    if 0 < n < len(moments):
        raise InputError(
            f"{what}: states must be the same at all times ({_time_text(moments)}), but the state of {row.id} changes; "
            "plan the tiles before and after the change separately, or choose one time with time= or "
            "--set instrument.state_time=DATE"
        )
    return n > 0


def moments_at(time: object) -> list[datetime]:
    """Return the different times at which states are evaluated, in ascending order, or raise an error."""
    if time is None:
        return []
    from rfpsurvey._sky.time import to_time

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        return sorted({moment_of(moment, "time") for moment in to_time(time, "time").ravel()})


def _time_text(moments: list[datetime]) -> str:
    texts = [f"{moment:{FORM}}" for moment in (moments[0], moments[-1])]
    return texts[0] if len(moments) == 1 else " to ".join(texts)


def _check_ids(rows: list[Row], index: dict[str, int], what: str, instrument: str) -> None:
    """Raise an error if an identifier is not an identifier of a positioner."""
    unknown = list(dict.fromkeys(row.id for row in rows if row.id not in index))
    if unknown:
        raise InputError(
            f"{what}: id must be identifiers of positioners of {instrument}, such as {listed(list(index)[:3])}, got "
            f"{listed(map(repr, unknown), MOST_NAMES)}"
        )


def _check_overlaps(rows: list[Row], what: str) -> None:
    """Raise an error if rows for the same positioner overlap in time but state different states or poses."""
    last = {}
    for row in sorted((row for row in rows if row.state != UNCHANGED), key=lambda row: (row.first, row.end)):
        before = last.get(row.id)
        if before is not None and row.first < before.end and (row.state, row.pose) != (before.state, before.pose):
            raise InputError(
                f"{what}: rows of a positioner that overlap in time must have the same state and pose, got "
                f"{before.state} and {row.state} for {row.id}; change the dates in the columns from and to"
            )
        if before is None or row.end > before.end:
            last[row.id] = row


def _rows(table: Table, plane: FocalPlane, what: str) -> list[Row]:
    """Return the rows of a table of states, or raise an error if a value is not valid."""
    if {*DESI} <= {*table.colnames}:
        table = _of_desi(table.copy(), plane, what)
    names = table.colnames
    check_columns(names, ["id"], f"{what}: the table")
    for name in names:
        if name not in COLUMNS and (hint := close_to(name, set(COLUMNS) - set(names), 0.6)):
            warn(f"{what}: the column {name!r} is not used; {hint}")
    for name in set(COLUMNS) & set(names):
        if np.ndim(table[name]) != 1:
            raise InputError(f"{what}: column {name!r} must have one value per row, got the shape {table[name].shape}")
    n = len(table)
    ids = to_labels(table["id"], f"{what}: column 'id'").astype(str).tolist()
    states = ["broken"] * n
    if "state" in names:
        states = to_plain(table["state"], f"{what}: column 'state'").astype(str).tolist()
        states = [check_choice(word.strip().lower() or "broken", WORDS, f"state in {what}") for word in states]
    dates = [_dates(table, name, limit, what) for name, limit in zip(("from", "to"), ALWAYS, strict=True)]
    poses = np.column_stack([_angles(table, name, what) for name in ("theta", "phi")]).tolist()
    rows = []
    for key, word, first, end, pose in zip(ids, states, *dates, poses, strict=True):
        state = WORDS[word]
        given = [value for value in pose if value == value]
        if first >= end:
            raise InputError(f"{what}: to must be later than from, got {first:{FORM}} and {end:{FORM}} for {key}")
        if len(given) == 1 or (state == "stuck" and not given) or (state == "restored" and given):
            rule = {"stuck": "both values", "broken": "both values or none", "restored": "no values"}[state]
            raise InputError(
                f"{what}: theta and phi must have {rule} for a positioner that is {word}, got {listed(given)} for {key}"
            )
        rows.append(Row(key, state, first, end, tuple(given) or None))
    return rows


def _of_desi(table: Table, plane: FocalPlane, what: str) -> Table:
    """Return a table of states for the table fiberstatus of fiberassign, whose x axis has the opposite direction."""
    check_columns(table.colnames, [*DESI, "X", "Y"], f"{what}: the table")
    if plane.id.dtype.kind not in "iu" or ((plane.id // 1000 >= N_PETALS) | (plane.id % 1000 > MOST_DEVICE)).any():
        raise InputError(
            f"{what}: the identifiers of positioners must be LOCATIONs of DESI (1000 times the petal plus the device) "
            f"for a table of fiberassign, got {listed(plane.id[-2:].tolist())}; use DESI as built "
            "(Instrument.from_desi, or --instrument with the path of a file such as fp-metrology.csv)"
        )
    ids, broken, stuck = (whole(table, name, what) for name in DESI)
    table[ROW], row_of = np.arange(1, len(table) + 1), {str(name): k for k, name in enumerate(plane.id.tolist())}
    known = np.isin(ids.astype(str), list(row_of))
    # rows of unknown positioners are refused later
    poses = np.where((stuck != 0) & ~known, 0.0, np.nan)[:, None].repeat(2, axis=1)
    fixed = np.flatnonzero((stuck != 0) & known)
    places = [sign * numbers(table[fixed], name, u.mm, what) for sign, name in ((-1, "X"), (1, "Y"))]
    for k, place in zip(fixed.tolist(), np.column_stack(places), strict=True):
        row, xy = row_of[str(ids[k])], np.full((len(plane), 2), np.nan)
        xy[row] = place
        poses[k] = [angles[row].to_value(u.deg) for angles in plane.inverse(xy * u.mm)]
        if np.isnan(poses[k]).any() and not broken[k]:  # a broken positioner needs no pose
            raise InputError(
                f"{what}: X and Y of a stuck fiber must be a position in reach of the positioner, got "
                f"{-place[0]:g} and {place[1]:g} mm for {ids[k]}"
            )
    states = np.where(broken != 0, "broken", np.where(stuck != 0, "stuck", UNCHANGED))
    states_table = Table({"id": ids, "state": states, "theta": poses[:, 0], "phi": poses[:, 1]})
    for name, column in (("from", "START_DATE"), ("to", "END_DATE")):
        if column in table.colnames:
            states_table[name] = table[column]
    return states_table


def _dates(table: Table, name: str, limit: datetime, what: str) -> list[datetime]:
    """Return the times in a column, or a limit where there is no time."""
    if name not in table.colnames:
        return [limit] * len(table)
    column, what = table[name], f"{what}: column {name!r}"
    if isinstance(column, Time):
        values = [None if missing else value for value, missing in zip(column, column.mask, strict=True)]
    elif column.dtype.kind == "M":
        values = np.asarray(column).astype("datetime64[us]").tolist()
    else:
        values = column.tolist() if column.dtype.kind == "O" else to_plain(column, what).tolist()
    return [limit if _is_empty(value) else _moment(value, what) for value in values]


def _is_empty(value: object) -> bool:
    return value is None or value is np.ma.masked or value != value or (isinstance(value, str) and not value.strip())


def _moment(value: object, what: str) -> datetime:
    """Return the time of a Time, of a Julian date, or of a date and time as text."""
    if isinstance(value, str) and is_number(value):
        value = float(value)
    if isinstance(value, int | float) and FIRST_JD < value < LAST_JD:
        value = Time(value, format="jd", scale="utc")
    elif isinstance(value, date):
        value = value.isoformat()
    return moment_of(value.strip() if isinstance(value, str) else value, f"{what} must hold Julian dates, or")


def _angles(table: Table, name: str, what: str) -> np.ndarray:
    """Return the angles in a column in degrees; NaN if there is no such column."""
    if name not in table.colnames:
        return np.full(len(table), np.nan)
    column, what = table[name], f"{what}: column {name!r}"
    unit = getattr(column, "unit", None) or u.deg
    if not unit.is_equivalent(u.deg):
        raise InputUnitsError(f"{what} must have a unit convertible to deg, got {unit}")
    values = to_plain(column, what)
    try:
        values = np.where(values == "", "nan", values) if values.dtype.kind == "U" else values
        degrees = (values.astype(float) * unit).to_value(u.deg)
    except ValueError:
        raise InputError(f"{what} must hold angles in degrees, got {short(values.tolist())}") from None
    for wrong in degrees[np.abs(degrees) > MOST_ANGLE]:
        raise InputError(f"{what} must hold angles from {-MOST_ANGLE:g} to {MOST_ANGLE:g} deg, got {wrong:g}")
    return degrees


def _cells(values: list) -> object:
    """Return the values of a key of inline rows as numbers, with NaN where the key is missing, or as objects."""
    if all(value is None or isinstance(value, int | float) for value in values):
        return np.array([np.nan if value is None else value for value in values])
    return Column(values, dtype=object)
