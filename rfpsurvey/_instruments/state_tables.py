"""Tables of the states of positioners, which list broken, stuck and restored positioners by date."""

from dataclasses import dataclass, field
from datetime import UTC, date, datetime

import astropy.units as u
import numpy as np
from astropy.table import Table
from astropy.time import Time

from rfpsurvey._common.read_tables import is_number
from rfpsurvey._common.units import check_columns, to_labels, to_plain
from rfpsurvey._instruments.as_built import MOST_ANGLE, MOST_DEVICE, N_PETALS, ROW, numbers, whole
from rfpsurvey._instruments.desi_state import moment_of
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey.errors import InputError, InputUnitsError, check_choice, close_to, listed, short, warn

STATES = ("broken", "stuck", "restored")
UNCHANGED = "unchanged"
"""State of rows that change nothing."""
WORDS = {**{state: state for state in STATES}, "ok": "restored", UNCHANGED: UNCHANGED}
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
    limits: tuple[float, ...] | None = field(default=None, repr=False)  # of theta and of phi in degrees

    @property
    def record(self) -> list:
        """The row as a list of numbers and text."""
        angles = [None if values is None else list(values) for values in (self.pose, self.limits)]
        return [self.id, self.state, self.first.isoformat(), self.end.isoformat(), *angles]

    @classmethod
    def from_record(cls, record: list) -> "Row":
        """Return the row with a record."""
        name, state, first, end, *angles = record
        angles = [None if values is None else tuple(values) for values in angles]
        return cls(name, state, *map(datetime.fromisoformat, (first, end)), *angles)


def check_ids(rows: list[Row], index: dict[str, int], what: str, instrument: str) -> None:
    """Raise an error if an identifier is not an identifier of a positioner."""
    unknown = list(dict.fromkeys(row.id for row in rows if row.id not in index))
    if unknown:
        raise InputError(
            f"{what}: id must be identifiers of positioners of {instrument}, such as {listed(list(index)[:3])}, got "
            f"{listed(map(repr, unknown), MOST_NAMES)}"
        )


def check_overlaps(rows: list[Row], what: str) -> None:
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


def rows_of_states(table: Table, plane: FocalPlane, what: str) -> list[Row]:
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
