"""Find the columns of a target table by common names and UCDs."""

from dataclasses import dataclass, field

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table

from rfpsurvey._common.read_tables import is_number
from rfpsurvey._common.units import rows_of, to_labels, to_numbers, to_plain
from rfpsurvey._sky.survey_formats import SurveyFormat, find_format
from rfpsurvey.errors import InputError, check_choice, listed, refusal, short, warn

# A role is the meaning of a column, such as "ra". For each role: the common names of its column, in order of preference
# (case is ignored), and the beginning of the UCD of its column.
ROLES = {
    "ra": (
        "ra ra_icrs raj2000 ra_j2000 _raj2000 radeg ra_deg target_ra _ra alpha alpha_j2000 right_ascension",
        "pos.eq.ra",
    ),
    "dec": (
        "dec de_icrs dej2000 decj2000 dec_j2000 _dej2000 dedeg decdeg dec_deg target_dec _de delta delta_j2000 "
        "declination",
        "pos.eq.dec",
    ),
    "lon": ("l glon gal_lon elon lon", "pos.galactic.lon"),
    "lat": ("b glat gal_lat elat lat", "pos.galactic.lat"),
    "pmra": ("pmra pm_ra pmra_cosdec pm_ra_cosdec pmra_icrs mu_ra", "pos.pm;pos.eq.ra"),
    "pmdec": ("pmdec pm_dec pmde pmdec_icrs mu_dec", "pos.pm;pos.eq.dec"),
    "epoch": ("ref_epoch epoch refepoch epoch_ref gaia_epoch", "meta.ref;time.epoch"),
    "id": (
        "id source_id source target_id targetid tyc catalogid objid obj_id object_id designation rsid name identifier "
        "target",
        "meta.id;meta.main",
    ),
    "priority": ("priority target_priority", ""),
    "kind": ("kind target_kind", ""),
    "category": ("category target_category", ""),
    "fiber_type": ("fiber_type fibertype instrument", ""),
    "subpriority": ("subpriority", ""),
    "visits": ("visits n_visits nvisits n_exposures", ""),
    "delta_ra": ("", ""),
    "delta_dec": ("", ""),
    "positioner": ("positioner positioner_id hole_id holeid hole robot_id robotid fiber_id fiberid location id", ""),
    "x": ("tip_x x_mm x_focal xfocal x_wok xwok fiberassign_x x", ""),
    "y": ("tip_y y_mm y_focal yfocal y_wok ywok fiberassign_y y", ""),
}
UNITS = dict.fromkeys(("ra", "dec", "lon", "lat"), u.deg)
UNITS |= {"pmra": u.mas / u.yr, "pmdec": u.mas / u.yr, "x": u.mm, "y": u.mm}
# Text that marks missing values (case is ignored).
NOTHING = ("", "null", "none", "na", "n/a", "--", "---")
# Roles whose missing values can be filled, and whether the values of each role are numbers.
FILLED = {
    **{"priority": True, "subpriority": True, "visits": True},
    **{"kind": False, "category": False, "fiber_type": False},
}
# Largest number of columns without a role that a statement on the columns lists.
MOST_LISTED = 20
# One degree per day: no object outside the solar system moves this fast.
MOST_MOTION = 1.3e9 * u.mas / u.yr


@dataclass
class Finder:
    """Finds the columns of a table that have a given role, such as ``ra`` or ``priority``."""

    table: Table
    # the keys of all dictionaries are roles
    columns: dict = field(default_factory=dict)  # column names; a leading minus reverses the sign of the numbers
    units: dict = field(default_factory=dict)  # units of the columns that have no unit in the table
    assume_units: bool = False  # whether columns without a unit have the default unit, as in formats without units
    fill: dict = field(default_factory=dict)  # values that replace missing values
    assumed: dict = field(default_factory=dict, init=False)  # default units of the columns whose unit was assumed
    remarks: dict = field(default_factory=dict, init=False)  # text that the statement on the columns includes
    format: SurveyFormat | None = field(default=None, init=False)  # of the table, if it is that of a known survey
    given: frozenset = field(default=frozenset(), init=False)  # roles whose columns are given by ``columns``

    def __post_init__(self):
        for given, what in ((self.columns, "column"), (self.units, "unit"), (self.fill, "value")):
            if not isinstance(given, dict):
                name = "fill" if what == "value" else f"{what}s"
                raise refusal(f"{name} must be a dict from role to {what}", given, dict)
        for role, value in self.fill.items():
            check_choice(role, FILLED, "column role to fill")
            if FILLED[role] and not is_number(value):
                raise InputError(f"the value of fill for {role} must be a number, got {short(value)}")
        for role, name in self.columns.items():
            check_choice(role, ROLES, "column role")
            if not isinstance(name, str):
                raise InputError(f"the value of columns for {role} must be the name of a column, got {short(name)}")
        for role in self.units:
            check_choice(role, UNITS, "column role with a unit")
        self.format, self.given = find_format(self.table.colnames), frozenset(self.columns)
        if self.format is not None:
            self.columns = {**self.format.columns, **self.columns}

    def name_of(self, role: str) -> str | None:
        """Return the name of the column with this role, or None if no column has this role."""
        if role in self.columns:
            name = self.columns[role].removeprefix("-")
            if name not in self.table.colnames:
                raise InputError(f"there is no column {name!r} for {role}; {self.listing()}")
            return name
        lower = {c.lower(): c for c in reversed(self.table.colnames) if not isinstance(self.table[c], SkyCoord)}
        names, ucd = ROLES[role]
        for name in names.split():
            if name in lower:
                return lower[name]
        if ucd:
            for main in (True, False):  # a column that is marked as the main one takes precedence
                for column in self.table.colnames:
                    column_ucd = _ucd(self.table[column])
                    if column_ucd.startswith(ucd) and (not main or "meta.main" in column_ucd):
                        return column
        return None

    def unit_of(self, role: str) -> u.UnitBase | None:
        """Return the unit of the column with this role, from the table or from ``units``; None if there is no unit."""
        name = self.name_of(role)
        unit = getattr(self.table[name], "unit", None)
        unit = None if unit is None or u.Unit(unit) == u.dimensionless_unscaled else _unit(unit, role)
        try:
            given = _unit(self.units[role], role) if role in self.units else None
            if isinstance(given, u.UnrecognizedUnit):
                raise ValueError
        except (ValueError, TypeError):
            raise InputError(f"the value of units for {role} must be a unit, got {short(self.units[role])}") from None
        if unit is not None and given is not None and unit != given:
            raise InputError(
                f"column {name!r} has the unit {unit} in the table, but the unit {given} in the argument units"
            )
        return unit or given

    def has_units(self, roles: tuple[str, ...]) -> bool:
        """Return whether the table states a unit for any column of positions or proper motions with these roles."""
        names = [self.name_of(role) for role in roles if role in UNITS]
        units = [getattr(self.table[name], "unit", None) for name in names if name is not None]
        return any(unit is not None and u.Unit(unit) != u.dimensionless_unscaled for unit in units)

    def quantity(self, role: str) -> u.Quantity | None:
        """Return the column with this role as a Quantity in the default unit of the role; masked values become NaN."""
        name = self.name_of(role)
        if name is None:
            return None
        values = self._decimal(role)
        unit = self.unit_of(role)
        if unit is None:
            if not self.assume_units:
                raise InputError(
                    f"column {name!r} has no unit; state the unit, for example units={{{role!r}: '{UNITS[role]}'}} "
                    f"or --set catalog.units.{role}={str(UNITS[role]).replace(' ', '')}"
                )
            unit = self.assumed[role] = UNITS[role]
        try:
            values = u.Quantity(values, unit).to(UNITS[role])
        except (TypeError, ValueError):  # the unit is unknown or cannot be converted
            raise InputError(
                f"column {name!r} ({role}) must have a unit convertible to {UNITS[role]}, got {unit}"
            ) from None
        return self._bounded(role, values) if role in ("pmra", "pmdec") else values

    def _bounded(self, role: str, motion: u.Quantity) -> u.Quantity:
        """Return proper motions with NaN in place of infinity; raise an error if a value is out of range."""
        motion = np.where(np.isfinite(motion), motion, np.nan)
        fast = np.abs(motion) > MOST_MOTION
        if fast.any():
            raise InputError(
                f"column {self.name_of(role)!r} ({role}) must lie between -{MOST_MOTION:.0f} and {MOST_MOTION:.0f}, "
                f"got {motion[fast][0]:g}"
            )
        return motion

    def _decimal(self, role: str) -> np.ndarray:
        """Return the column with this role as float64; text that contains decimal numbers is converted."""
        name = self.name_of(role)
        values = self._plain(role)
        if role == "priority" and values.dtype.kind in "iu":
            values = to_numbers(values, f"column {name!r} ({role})")
        try:
            if values.dtype.kind == "U":
                values = np.where(np.isin(np.char.lower(np.char.strip(values)), NOTHING), "nan", values)
            sign = -1.0 if self.columns.get(role, "").startswith("-") else 1.0
            return sign * values.astype(float) + 0.0  # the sum replaces -0.0 by 0.0
        except (TypeError, ValueError):
            what = f"numbers in {UNITS[role]}" if role in UNITS else "numbers"
            row, text = next((k, str(v)) for k, v in enumerate(values.flat) if not is_number(v))
            text = f"column {name!r} ({role}) must hold {what}, but holds text such as {text[:60]!r} (row {row + 1})"
            raise InputError(text) from None

    def _plain(self, role: str) -> np.ndarray:
        """Return the column with this role as numbers or text, one value per row."""
        self._check_shape(role)
        name = self.name_of(role)
        return to_plain(self.table[name], f"column {name!r} ({role})")

    def _check_shape(self, role: str) -> None:
        name = self.name_of(role)
        shape = self.table[name].shape[1:]
        if shape:
            sizes = " x ".join(map(str, shape))
            raise InputError(f"column {name!r} ({role}) must have one value per row, got {sizes} values per row")

    def texts(self, role: str) -> np.ndarray:
        """Return the column with this role as text; missing values become empty text."""
        texts = self.labels(role)
        return np.where(np.isin(np.char.lower(texts), NOTHING), "", texts)

    def is_text(self, role: str) -> bool:
        """Return whether the column with this role contains text other than decimal numbers."""
        try:
            self._decimal(role)
        except InputError:
            return True
        return False

    def numbers(self, role: str) -> np.ndarray | None:
        """Return the column with this role as float64; the value in ``fill``, or NaN, replaces missing values."""
        if self.name_of(role) is None:
            return None
        values = self._decimal(role)
        return np.where(np.isnan(values), float(self.fill[role]), values) if role in self.fill else values

    def complete(self, role: str) -> np.ndarray | None:
        """Return the column with this role as float64; raise an error if a row has no value."""
        values = self.numbers(role)
        if values is not None and (lacking := np.isnan(values)).any():
            raise InputError(
                f"column {self.name_of(role)!r} ({role}) must have a number in every row, but {rows_of(lacking)} have "
                f"none; state a value for these rows, for example fill={{{role!r}: 0}} or --set catalog.fill.{role}=0"
            )
        return values

    def labels(self, role: str) -> np.ndarray | None:
        """Return the column with this role as integers or text; masked text becomes empty."""
        name = self.name_of(role)
        if self.columns.get(role, "").startswith("-"):
            raise InputError(
                f"columns: a leading minus is allowed only for columns of numbers, got {role} = {self.columns[role]}"
            )
        if name is None:
            return None
        self._check_shape(role)
        labels = to_labels(self.table[name], f"column {name!r} ({role})")
        return np.where(labels == "", str(self.fill[role]), labels) if role in self.fill else labels

    def missing(self, what: str, option: str = "--column ") -> InputError:
        """Return the exception for a required column that is missing; ``option`` is the option that names a column."""
        text = f"there is no column for {what}; {self.listing()}"
        if what in ("ra and dec", "ra", "dec") and self.name_of("lon") and self.name_of("lat"):
            return InputError(
                f"{text}; give the frame of the longitudes and latitudes, for example frame='galactic' or "
                "--set catalog.frame=galactic"
            )
        role = what.split()[0]
        remedy = (
            f"; state its name, for example columns={{{role!r}: ...}} or {option}{role}=..."
            if self.table.colnames
            else ""
        )
        return InputError(text + remedy)

    def warn_of_doubt(self) -> None:
        """Warn if a survey format is recognized, but columns of this format are missing and are not given."""
        if self.format is not None and self.format.doubt and not set(self.format.columns) & self.given:
            warn(f"{self.format.doubt}; to use other columns, give columns= or --column")

    def statement(self, roles: tuple[str, ...], keep: list[str] = (), coord: list[str] = ()) -> str:
        """Return text that states the column of each role, and that lists the columns that are not used.

        ``keep`` lists the columns that results include, and ``coord`` those that contain `SkyCoord` objects.
        """
        names = {role: self.name_of(role) for role in roles}
        if names.get("kind", "") is None and self.format is not None:
            names["kind"] = self.format.bits
        signs = {role: " (reversed sign)" for role, name in self.columns.items() if name.startswith("-")}
        said = [
            f"{role}: {name or 'none'}{signs.get(role, '')}{self.remarks.get(role, '')}"
            for role, name in names.items()
            if name or role in ("priority", "visits")
        ]
        said += [f"coord: {name}" for name in coord]
        used = {*names.values(), *keep, *coord}
        if (form := self.format) is not None:
            used |= {form.mode, form.stars if form.bits and names.get("kind") == form.bits else ""}
            used |= {form.exposure if form.times and "visits" not in self.given else ""}
        unused = [name for name in self.table.colnames if name not in used]
        more = len(unused) - MOST_LISTED
        unused = unused[:MOST_LISTED] + ([f"and {more} more"] if more > 0 else [])
        parts = [", ".join(said), f"kept: {', '.join(keep)}" if keep else ""]
        parts += [f"not used: {', '.join(unused)}" if unused else ""]
        start = "" if self.format is None else f"{self.format.name}: "
        return start + "; ".join(part for part in parts if part)

    def listing(self) -> str:
        """Return a phrase that lists the columns of the table."""
        return f"the columns are: {listed(self.table.colnames)}"


def _unit(given: object, role: str) -> u.UnitBase:
    """Convert text such as ``Degrees`` to a unit; for right ascensions, the unit hour is replaced by hour angle."""
    unit = u.Unit(given, parse_strict="silent")
    if isinstance(unit, u.UnrecognizedUnit):
        known = u.Unit(str(given).strip().lower().removesuffix("s"), parse_strict="silent")
        unit = unit if isinstance(known, u.UnrecognizedUnit) else known
    return u.Unit(u.hourangle * unit.to(u.hour)) if role == "ra" and unit.is_equivalent(u.hour) else unit


def _ucd(column) -> str:
    meta = getattr(getattr(column, "info", column), "meta", None) or {}
    return str(meta.get("ucd", "")).lower()
