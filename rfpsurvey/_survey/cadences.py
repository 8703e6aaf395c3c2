"""Cadences: visits of targets in epochs with windows of time and limits of the sky brightness."""

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.table import Table
from astropy.time import Time

from rfpsurvey._common.read_tables import read_table
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.frames import as_table
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey.errors import InputError, check_keywords, listed, number_of, short, warn

NIGHT = 0.5
"""Largest time between the exposures of an epoch in days."""
COLUMNS = ("delta_min", "delta_max", "n_exp", "skybrightness")
# Other names of columns, in the files of SDSS-V; upper case and lower case are not distinguished.
SYNONYMS = {"nexp": "n_exp", "nepochs": "n_epochs"}
MOST_VISITS = 255
NEVER = 1e9
"""Closing time (MJD) of windows that do not close."""


@check_keywords
@dataclass(frozen=True, eq=False)
class Cadences:
    """The cadences of targets, as a value of the parameter ``visits`` of `~rfpsurvey.plan_survey`.

    A cadence consists of epochs. Each epoch has a number of exposures, which are tiles of the same night: all of them
    are within 0.5 days of the first. The time between the first exposures of successive epochs has a lower and an upper
    limit, and the sky must not be brighter than a limit. Tiles are planned in the order of their times. A tile can
    observe only targets whose window is open. Of targets with the same priority, those whose window closes first come
    first (as subpriorities). The visits of an epoch count when its last exposure is made; the exposures of an epoch
    that is not completed in its night are lost, and the epoch begins again. A target whose window has closed is
    released: it is not observed any more.

    Parameters
    ----------
    table : Table, QTable or path-like
        Table with a row for each cadence, or its file. Columns: ``cadence`` (the name), and one value per epoch of
        ``delta_min`` and ``delta_max`` (days since the previous epoch; negative numbers stand for no limit),
        ``n_exp`` (exposures; also ``nexp``), and ``skybrightness`` (largest allowed brightness; optional). Several
        values are separated by blanks, or columns contain arrays. The optional column ``n_epochs`` (also ``nepochs``)
        states the number of epochs of each cadence; further elements of the arrays are not used. Names of columns
        can be in upper case, as in the files of SDSS-V. A cadence without epochs, such as those of SDSS-V for
        calibration, has no visits. A cadence of more than 255 exposures is refused only if a target has it.
    column : str, optional
        Further column of the catalog with the name of the cadence of each target; targets with empty text are observed
        once, at any time.

    Raises
    ------
    InputError
        If a column is missing, or if a value is not valid.

    Examples
    --------
    >>> from astropy.table import Table
    >>> import rfpsurvey as rs
    >>> table = Table({"cadence": ["twice"], "delta_min": ["0 20"], "delta_max": ["0 40"], "n_exp": ["1 1"]})
    >>> rs.survey.Cadences(table).names
    ['twice']
    """

    table: Table | str | os.PathLike
    column: str = "cadence"
    names: list = field(init=False, repr=False)

    def __post_init__(self):
        given = self.table
        table = read_table(given) if isinstance(given, str | os.PathLike) else as_table(given)[0]
        lower = {SYNONYMS.get(name.lower(), name.lower()): name for name in reversed(table.colnames)}
        if lacking := [name for name in ("cadence", *COLUMNS[:3]) if name not in lower]:
            raise InputError(f"a table of cadences must have the column {lacking[0]}, got {listed(table.colnames)}")
        known = {name.lower() for name in table.colnames}
        if twice := next((pair for pair in SYNONYMS.items() if known >= {*pair}), None):
            raise InputError(f"a table of cadences must have one of the columns {' and '.join(twice)}, got both")
        object.__setattr__(self, "_columns", lower)
        names = [str(name).strip() for name in table[lower["cadence"]].tolist()]
        if len(set(names)) < len(names):
            name = next(name for name in names if names.count(name) > 1)
            raise InputError(f"the name of a cadence must be unique, got {names.count(name)} rows for {name!r}")
        object.__setattr__(self, "table", table)
        object.__setattr__(self, "names", names)
        _ = self._epochs  # raises errors

    @cached_property
    def _epochs(self) -> list[np.ndarray]:
        """The values of ``COLUMNS`` for each epoch, one array per cadence."""
        epochs, columns = [], {}
        for role in (role for role in (*COLUMNS, "n_epochs") if role in self._columns):
            column = self.table[self._columns[role]]
            unit, wanted = getattr(column, "unit", None), u.day if role.startswith("delta") else u.one
            if unit is not None and not unit.is_equivalent(wanted):
                raise InputError(f"{role} of cadences must have {_UNITS[wanted]}, got {unit}")
            columns[role] = getattr(column, "value", column), 1.0 if unit is None else unit.to(wanted)
        n_epochs, _ = columns.pop("n_epochs", ([None] * len(self.names), 1.0))
        for k, (name, given) in enumerate(zip(self.names, n_epochs, strict=True)):
            n = None if given is None else _whole(given, f"n_epochs of cadence {name!r}")
            # files of SDSS-V fill the arrays of shorter cadences with zeros
            values = [
                factor * _numbers(column[k], f"{role} of cadence {name!r}", n)
                for role, (column, factor) in columns.items()
            ]
            if len(values) < len(COLUMNS):
                values.append(np.full(len(values[0]), np.inf))
            if len({len(numbers) for numbers in values} | {len(values[0]) if n is None else n}) > 1:
                raise InputError(f"the columns of cadence {name!r} must have one value per epoch, got other numbers")
            low, high, n, _ = values = np.array(values)
            closed = (high >= 0) & (high < low)
            closed[:1] = False
            if closed.any():
                k = np.flatnonzero(closed)[0]
                raise InputError(
                    f"delta_max of cadence {name!r} must be at least delta_min, got {high[k]:g} and {low[k]:g} in "
                    f"epoch {k + 1}: the window never opens"
                )
            if (bad := (n < 1) | (n % 1 > 0)).any():
                raise InputError(f"n_exp of cadence {name!r} must be whole numbers from 1, got {n[bad][0]:g}")
            epochs.append(values)
        return epochs

    @property
    def epochs(self) -> list[np.ndarray]:
        """The values of ``delta_min``, ``delta_max``, ``n_exp`` and ``skybrightness`` of the epochs of each cadence.

        The last element is for targets without a cadence, which are observed once.
        """
        return [*self._epochs, np.array([[-1.0], [-1.0], [1.0], [np.inf]])]

    @cached_property
    def _totals(self) -> np.ndarray:
        """The number of exposures of each cadence; the last element is for targets without a cadence."""
        return np.array([values[2].sum() for values in self.epochs], dtype=np.int64)

    @property
    def record(self) -> str:
        """A digest of the cadences, which surveys record."""
        text = repr([self.column, self.names, [values.tolist() for values in self._epochs]])
        return f"{number_of(len(self.names), 'cadence')}, digest {hashlib.sha256(text.encode()).hexdigest()[:16]}"

    def of(self, catalog: Catalog) -> np.ndarray:
        """Return the row of the cadence of each target; -1 for targets without a cadence, and for other kinds.

        Parameters
        ----------
        catalog : Catalog
            The targets.

        Returns
        -------
        ndarray of int, shape (n_targets,)
            One row per target.

        Raises
        ------
        InputError
            If the catalog lacks the column, if a name is unknown, or if a cadence has too many exposures.
        """
        extra = catalog.arrays.extra
        if self.column not in extra:
            raise InputError(
                f"the catalog must have the column {self.column!r} with the cadence of each target, got the further "
                f"columns {listed(extra)} (further columns are read by keep= or --set catalog.keep=NAME)"
            )
        row = self._rows_of(extra[self.column])
        return row if catalog.kind is None else np.where(has_role(catalog.kind, "science"), row, -1)

    def _rows_of(self, names: np.ndarray) -> np.ndarray:
        """Return the row of each of the named cadences; -1 for empty names."""
        text = np.char.strip(np.asarray(names).astype(str))
        names, place = np.unique(text, return_inverse=True)
        row_of = {name: k for k, name in enumerate(self.names)} | {"": -1}
        if unknown := [name for name in names.tolist() if name not in row_of]:
            raise InputError(f"the cadence of a target must be in the table of cadences, got {unknown[0]!r}")
        rows = np.array([row_of[name] for name in names.tolist()], dtype=np.int64)
        for name, n in zip(names.tolist(), self._totals[rows].tolist(), strict=True):
            if n > MOST_VISITS:
                raise InputError(f"a cadence of targets must have at most {MOST_VISITS} exposures, got {n} in {name!r}")
        return rows[place.reshape(-1)]

    def visits(self, catalog: Catalog, required: np.ndarray | None = None) -> np.ndarray:
        """Return the number of visits of each target: the exposures of all epochs of its cadence.

        Targets whose number of visits in the catalog is 0 have no visits, unless they are required.

        Parameters
        ----------
        catalog : Catalog
            The targets.
        required : ndarray of bool, shape (n_targets,), optional
            Whether each target is required.

        Returns
        -------
        ndarray of uint8, shape (n_targets,)
            The numbers; 1 for targets without a cadence.
        """
        totals = self._totals[self.of(catalog)].astype(np.uint8)
        has_none = False if catalog.visits is None else catalog.visits == 0
        return np.where(has_none if required is None else has_none & ~required, np.uint8(0), totals)


class Windows:
    """The epochs that targets have completed, and their open windows, while the tiles are planned.

    ``row`` is the row of the cadence of each target, in the order of slots, or -1. In realizations, an element stands
    for a target in a realization. ``days`` is the time (MJD) of each tile.
    """

    def __init__(self, cadences: Cadences, row: np.ndarray, days: np.ndarray, brightness: np.ndarray):
        epochs = cadences.epochs
        self._n = np.array([values.shape[1] for values in epochs])
        self._values = np.full((4, len(epochs), self._n.max()), np.nan)
        for k, values in enumerate(epochs):
            self._values[:, k, : values.shape[1]] = values
        self._row, self._days, self._brightness = row, days, brightness
        self._epoch, self._made = np.zeros(len(row), dtype=np.int64), np.zeros(len(row), dtype=np.int64)
        self._begin, self._previous = np.full(len(row), np.nan), np.full(len(row), np.nan)
        self.released = np.zeros(len(row), dtype=bool)

    @property
    def n_epochs(self) -> np.ndarray:
        """Number of completed epochs of each target, in the order of slots."""
        return self._epoch

    def past(self) -> tuple[np.ndarray, ...]:
        """Return, for each target, the completed epochs, the exposures of the present epoch, and two times (MJD).

        They are the time of the first of these exposures, and that of the last completed epoch; NaN for none.
        """
        return self._epoch, self._made, np.where(self._made > 0, self._begin, np.nan), self._previous

    def counts(self) -> np.ndarray:
        """Return whether each target has completed all epochs, and the visits of its epochs, shape (n_targets, 2)."""
        total = np.nancumsum(self._values[2], axis=1)[self._row, np.maximum(self._epoch - 1, 0)]
        n = self._n[self._row]
        return np.column_stack([(self._epoch >= n) & (n > 0), np.where(self._epoch > 0, total, 0)]).astype(np.int64)

    def state(self, slot: np.ndarray, tile: int) -> tuple[np.ndarray, np.ndarray]:
        """Return whether the window of each target is open at a tile, and when it closes (MJD)."""
        now, row, epoch = self._days[tile], self._row[slot], self._epoch[slot]
        done = epoch >= self._n[row]
        low, high, _, limit = self._values[:, row, np.minimum(epoch, self._n[row] - 1)]
        since = now - self._previous[slot]
        is_late = (self._made[slot] > 0) & (now - self._begin[slot] > NIGHT)
        self._made[slot[is_late]] = 0  # the exposures of an epoch that was not completed in its night are lost
        begun, first = self._made[slot] > 0, epoch == 0
        with np.errstate(invalid="ignore"):
            too_late = ~first & ~begun & (high >= 0) & (since > high)
            is_open = begun | first | ((since >= low) & ~too_late)
        self.released[slot[too_late & ~done]] = True
        closing = np.where(first | (high < 0), NEVER, self._previous[slot] + high)
        closing = np.where(begun, self._begin[slot] + NIGHT, closing)
        return is_open & ~done & (self._brightness[tile] <= limit), closing

    def enter(self, slot: np.ndarray, tile: int) -> np.ndarray:
        """Record exposures; return the targets whose epochs are complete, repeated for each visit of the epoch."""
        now, row = self._days[tile], self._row[slot]
        first = self._made[slot] == 0
        self._begin[slot[first]] = now
        self._made[slot] += 1
        needed = self._values[2, row, self._epoch[slot]].astype(np.int64)
        complete = self._made[slot] >= needed
        slot, needed = slot[complete], needed[complete]
        self._previous[slot], self._made[slot] = self._begin[slot], 0
        self._epoch[slot] += 1
        return np.repeat(slot, needed)

    def observe(self, slot: np.ndarray, tile: int) -> None:
        """Record the exposures of an observed tile, except those of targets whose window was not open."""
        self.enter(slot[self.state(slot, tile)[0]], tile)

    def begin_as(self, other: "Windows", to_slots: Callable) -> None:
        """Begin with the epochs of all targets of another state; ``to_slots`` brings them into the order of slots."""
        for name in ("_epoch", "_made", "_begin", "_previous", "released"):
            setattr(self, name, to_slots(getattr(other, name)))

    def close(self) -> None:
        """Release the targets whose windows have closed at the time of the last tile."""
        if len(self._days):
            self.state(np.arange(len(self._row)), int(np.argmax(self._days)))


def warn_of_cadences(cadences: Cadences, row: np.ndarray, days: np.ndarray, brightness: np.ndarray) -> None:
    """Warn of cadences whose first epoch no tiles can complete; ``row`` is the row of the cadence of each target."""
    hopeless = []
    for k in np.unique(row[row >= 0]).tolist():
        epochs = cadences.epochs[k]
        if epochs.shape[1]:
            n, times = int(epochs[2, 0]), np.sort(days[brightness <= epochs[3, 0]])
            hopeless += [] if (times[n - 1 :] - times[: max(len(times) - n + 1, 0)] <= NIGHT).any() else [k]
    if hopeless:
        n, names = int(np.isin(row, hopeless).sum()), listed([cadences.names[k] for k in hopeless], 8)
        warn(
            f"{number_of(n, 'target')} will not be observed, because no night has as many tiles, with an allowed sky "
            f"brightness, as the first epoch of the cadence has exposures: {names}"
        )


def days_of(tiling: Tiling) -> np.ndarray:
    """Return the time of each tile (MJD) from its column ``time``, ``date`` or ``mjd``."""
    there = [name for name in ("mjd", "time", "date") if name in tiling.table.colnames]
    if len(there) != 1:
        raise InputError(
            "tiles of a survey with cadences must have one of the columns time, date and mjd, got "
            f"{listed(there or tiling.table.colnames)}"
        )
    column, name = tiling.table[there[0]], there[0]
    if name == "mjd":
        return _known(column, name)
    try:
        return (column if isinstance(column, Time) else Time(np.ma.filled(column, "").astype(str))).mjd
    except ValueError as error:
        raise InputError(f"the {name} of tiles must be times such as 2026-01-03T05:00: {error}") from None


def brightness_of(cadences: Cadences, tiling: Tiling) -> np.ndarray:
    """Return the sky brightness of each tile; 0 if the cadences do not limit it."""
    name = next((name for name in ("skybrightness", "sky_brightness") if name in tiling.table.colnames), None)
    if not any(np.isfinite(values[3]).any() for values in cadences._epochs):
        return np.zeros(len(tiling))
    if name is None:
        raise InputError(
            "tiles of a survey with cadences that limit the sky brightness must have the column skybrightness, got "
            f"{listed(tiling.table.colnames)}"
        )
    return _known(tiling.table[name], name)


_UNITS = {u.day: "the unit d", u.one: "no unit"}


def _known(column, name: str) -> np.ndarray:
    """Return the numbers of a column of tiles; raise an error if a number is missing."""
    if isinstance(column, u.Quantity):
        unit = u.day if name == "mjd" else u.one
        if not column.unit.is_equivalent(unit):
            raise InputError(f"the {name} of tiles must have {_UNITS[unit]}, got {column.unit}")
        column = column.to_value(unit)
    try:
        values = np.ma.filled(np.ma.asarray(column).astype(float), np.nan)
    except (TypeError, ValueError) as error:
        raise InputError(f"the {name} of tiles must be numbers: {error}") from None
    if not np.isfinite(values).all():
        raise InputError(f"the {name} of every tile must be known, got {int((~np.isfinite(values)).sum())} without")
    return values


def _whole(value: object, name: str) -> int:
    """Return a number of epochs; raise an error if it is not a whole number from 0."""
    n = _numbers(value, name)
    if n.size != 1 or n[0] < 0 or n[0] % 1:
        raise InputError(f"{name} must be a whole number from 0, got {short(str(value))}")
    return int(n[0])


def _numbers(value: object, name: str, n: int | None = None) -> np.ndarray:
    """Return the numbers in a value: text with blanks, an array, or one number; none for missing values.

    Only the first n numbers are returned if ``n`` is given.
    """
    if value is np.ma.masked:
        return np.empty(0)
    try:
        parts = str(value).split() if isinstance(value, str) else np.ma.filled(np.ma.asarray(value, float), np.nan)
        numbers = np.atleast_1d(np.array(parts, dtype=float))[:n]
    except ValueError:
        raise InputError(f"{name} must be numbers, got {short(str(value))}") from None
    if not np.isfinite(numbers).all():
        raise InputError(f"{name} must be finite numbers, got {short(str(value))}")
    return numbers
