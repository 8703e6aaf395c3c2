"""Method of `Instrument` that marks positioners as broken, stuck or restored, as listed in a table."""

import hashlib
import os
from bisect import bisect_left, bisect_right
from collections import Counter
from dataclasses import replace
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.table import Column, Table
from astropy.time import Time

from rfpsurvey._common.read_tables import read_table
from rfpsurvey._instruments.desi_state import moment_of
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.state_tables import (
    ALWAYS,
    COLUMNS,
    FORM,
    STATES,
    UNCHANGED,
    Row,
    check_ids,
    check_overlaps,
    rows_of_states,
)
from rfpsurvey.errors import InputError, check_choice, short

if TYPE_CHECKING:
    from rfpsurvey._instruments.instrument import Instrument

LISTED = "layout.states"
"""Name of the entry of a description that lists the states of positioners, or names a table of them."""
SUMMARY = "states"
"""First word of the names of the values that summarize the states of positioners."""
PARTS = ("file", "time", *STATES, "unused_rows", "digest")


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
            ``fiberstatus.ecsv`` of DESI's fiberassign is also accepted (:ref:`as-built-desi`).
        time : Time or str, optional
            Time at which the states are evaluated, in UTC; required if a row has a date. If several times are given,
            such as ``Tiling.times``, and the states differ between them, the states of the rows apply at the time of
            each tile of a survey, or at the time that is given to `at_time`.

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
        return _apply(self, rows_of_states(table, self.focal_plane, what), time, what, name)

    @cached_property
    def _at_changes(self) -> dict[int, "Instrument"]:
        """The instruments that `instruments_at` has made, by the number of changes before them."""
        return {}

    def at_time(self, time: Time | str) -> "Instrument":
        """Return the instrument with the states of its positioners at a time.

        Parameters
        ----------
        time : Time or str
            Time at which the states are evaluated, in UTC.

        Returns
        -------
        Instrument
            The instrument; the same instrument if its states do not depend on time.

        Raises
        ------
        InputError
            If ``time`` is not one time.

        Examples
        --------
        >>> import rfpsurvey as rs
        >>> from astropy.table import Table
        >>> from astropy.time import Time
        >>> table = Table({"id": [7], "from": ["2026-03-01"]})
        >>> lamost = rs.Instrument.preset("lamost").with_states(table, time=Time(["2026-02-01", "2026-04-01"]))
        >>> [lamost.at_time(time).facts()["usable_positioners"] for time in ("2026-02-01", "2026-04-01")]
        [4000, 3999]
        """
        if len(moments_at(time)) != 1:
            raise InputError(f"time must be one time, got {short(time)}")
        dated = {prefix: entry for prefix in _prefixes(self.values) if (entry := self.values.get(f"{prefix}.rows"))}
        values = {k: entry for k, entry in self.values.items() if k.rpartition(".")[0] not in dated}
        instrument = replace(self, values=values) if dated else self
        for prefix, entry in dated.items():
            name, rows = self.values[f"{prefix}.file"]["value"], list(map(Row.from_record, entry["value"]))
            origin = {part: entry[part] for part in ("status", "source")}
            instrument = _apply(instrument, rows, time, name, name, origin)
        return instrument


def apply_entry(instrument: "Instrument", folder: Path, time: Time | str | None) -> "Instrument":
    """Return the instrument with the states that its own description lists, or that a file in ``folder`` contains."""
    entry = instrument.values[LISTED]
    values = {name: value for name, value in instrument.values.items() if name != LISTED}
    instrument, origin = replace(instrument, values=values), {part: entry[part] for part in ("status", "source")}
    if isinstance(entry["value"], str):
        path = folder / entry["value"]
        rows = rows_of_states(read_table(path), instrument.focal_plane, str(path))
        return _apply(instrument, rows, time, str(path), path.name, origin)
    names = dict.fromkeys(name for row in entry["value"] for name in row)
    for name in names:
        check_choice(name, COLUMNS, f"key of {LISTED}")
    table = Table({name: _cells([row.get(name) for row in entry["value"]]) for name in names})
    rows = rows_of_states(table, instrument.focal_plane, LISTED)
    return _apply(instrument, rows, time, LISTED, "the description", origin)


def describe_states(instrument: "Instrument") -> str:
    """Return sentences with the numbers of broken and stuck positioners; empty text if no states were given."""
    texts = []
    for prefix in _prefixes(instrument.values):
        known = {part: instrument.values.get(f"{prefix}.{part}", {}).get("value") for part in PARTS}
        if f"{prefix}.rows" in instrument.values:
            texts.append(f"States of positioners from {known['file']} at the time of each tile.")
            continue
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
    check_ids(rows, index, what, instrument.name)
    check_overlaps(rows, what)
    moments, origin = moments_at(time), origin or {"status": "assumed", "source": f"with_states, {name}"}
    if is_dated(instrument) or any(0 < _n_moments(row, moments) < len(moments) for row in rows):
        return with_rows(instrument, rows, name, origin)
    used = [row for row in rows if _applies(row, moments, what)]
    disabled, stuck = plane.disabled.copy(), plane.arrays.stuck.copy()
    has_limits = any(row.limits is not None for row in used)
    ranges = {name: getattr(plane, name).copy() for name in ("theta_range", "phi_range") if has_limits}
    for row in used:
        k = index[row.id]
        disabled[k] = row.state == "broken"
        stuck[k] = np.nan if row.pose is None else np.deg2rad(row.pose)
        if row.limits is not None:
            ranges["theta_range"][k], ranges["phi_range"][k] = row.limits[:2] * u.deg, row.limits[2:] * u.deg
    counts = Counter({row.id: row.state for row in used}.values())
    summary = {
        "file": name,
        "time": _time_text(moments) if moments and any((row.first, row.end) != ALWAYS for row in rows) else None,
        **{state: counts[state] for state in STATES},
        "unused_rows": sum(row.state != UNCHANGED for row in rows) - len(used),
        "digest": _digest(rows),
    }
    values = _summary(instrument, summary, origin)
    changed = replace(
        instrument,
        focal_plane=replace(plane, disabled=disabled, stuck=stuck * u.rad, **ranges),
        values={**instrument.values, **values},
    )
    text = describe_states(replace(changed, values=values))
    return replace(changed, notes=f"{instrument.notes.rstrip()} {text}".strip())


def with_rows(instrument: "Instrument", rows: list[Row], name: str, origin: dict | None = None) -> "Instrument":
    """Return the instrument with rows that apply at the time of each tile."""
    origin = origin or {"status": "published", "source": name}
    parts = {"file": name, "rows": [row.record for row in rows if row.state != UNCHANGED], "digest": _digest(rows)}
    return replace(instrument, values={**instrument.values, **_summary(instrument, parts, origin)})


def _summary(instrument: "Instrument", parts: dict, origin: dict) -> dict:
    """Return the values of an instrument that summarize a further table of states."""
    earlier = len(_prefixes(instrument.values))
    prefix = f"{SUMMARY}_{earlier + 1}" if earlier else SUMMARY
    return {f"{prefix}.{part}": {"value": value, **origin} for part, value in parts.items() if value is not None}


def _digest(rows: list[Row]) -> str:
    return hashlib.sha256("\n".join(sorted(map(repr, rows))).encode()).hexdigest()[:16]


def _applies(row: Row, moments: list[datetime], what: str) -> bool:
    """Return whether a row applies at the given moments, between which no state changes."""
    if row.state == UNCHANGED or (row.first, row.end) == ALWAYS:
        return row.state != UNCHANGED
    if not moments:
        raise InputError(
            f"{what}: the time of the observation must be given, because rows have dates (columns from and to), got no "
            "time; give time= (or --set instrument.state_time=DATE)"
        )
    return _n_moments(row, moments) > 0


def _n_moments(row: Row, moments: list[datetime]) -> int:
    """Return the number of the given moments at which a row applies; 0 for rows that change nothing."""
    return 0 if row.state == UNCHANGED else bisect_left(moments, row.end) - bisect_left(moments, row.first)


def is_dated(instrument: "Instrument") -> bool:
    """Return whether the states of positioners depend on the time of each tile."""
    return any(f"{prefix}.rows" in instrument.values for prefix in _prefixes(instrument.values))


def states_of(plane: FocalPlane) -> np.ndarray:
    """Return a row for each positioner, with numbers that are equal for equal states."""
    ranges = [limits.to_value(u.rad) for limits in (plane.theta_range, plane.phi_range) if limits is not None]
    return np.column_stack([plane.disabled, plane.arrays.stuck, *ranges])


def at_one_time(instrument: "Instrument") -> "Instrument":
    """Return the instrument, or raise an error if the states of its positioners depend on the time of each tile."""
    if is_dated(instrument):
        text = "the states of positioners must be those of one time, got an instrument whose states change with time"
        raise InputError(f"{text}; use its method at_time, or give --set instrument.state_time=DATE")
    return instrument


def instruments_at(instrument: "Instrument", times: Time) -> list["Instrument"]:
    """Return the instrument at each of several times; times between which no state changes share an object."""
    entries = (instrument.values.get(f"{prefix}.rows", {"value": []}) for prefix in _prefixes(instrument.values))
    rows = [Row.from_record(record) for entry in entries for record in entry["value"]]
    changes, known = sorted({moment for row in rows for moment in (row.first, row.end)}), instrument._at_changes
    numbers = [bisect_right(changes, moment_of(time, "time")) for time in times]
    for k, time in zip(numbers, times, strict=True):
        known[k] = known[k] if k in known else instrument.at_time(time)
    return [known[k] for k in numbers]


def moments_at(time: object) -> list[datetime]:
    """Return the different times at which states are evaluated, in ascending order, or raise an error."""
    if time is None:
        return []
    from rfpsurvey._sky.time import any_year, to_time

    with any_year():
        return sorted({moment_of(moment, "time") for moment in to_time(time, "time").ravel()})


def _time_text(moments: list[datetime]) -> str:
    texts = [f"{moment:{FORM}}" for moment in (moments[0], moments[-1])]
    return texts[0] if len(moments) == 1 else " to ".join(texts)


def _cells(values: list) -> object:
    """Return the values of a key of inline rows as numbers, with NaN where the key is missing, or as objects."""
    if all(value is None or isinstance(value, int | float) for value in values):
        return np.array([np.nan if value is None else value for value in values])
    return Column(values, dtype=object)
