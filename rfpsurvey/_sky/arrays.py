"""Roles of targets, and the columns of a catalog as arrays without units, with an index that finds targets in a circle.

The kind of a target with several roles joins them by plus signs. Extra columns are included in results, but allocators
do not read them.
"""

from collections.abc import Iterable, Mapping
from functools import cached_property
from itertools import combinations

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from astropy.utils.masked import Masked
from astropy.utils.shapes import ShapedLikeNDArray

from rfpsurvey._common.files import check_text
from rfpsurvey._common.read_tables import is_known, without_unit
from rfpsurvey._common.units import locked, to_plain, to_vectors
from rfpsurvey._kernels import sky
from rfpsurvey._kernels import sky as zones
from rfpsurvey._sky.time import to_time
from rfpsurvey.errors import InputError, InputTypeError, listed, short, warn

KINDS = ("science", "standard", "sky")
JOINED = tuple("+".join(names) for n in (2, 3) for names in combinations(KINDS, n))
"""Kinds of targets with several roles, such as ``science+standard``."""


def to_kinds(values: object, name: str, *, strict: bool = True) -> np.ndarray:
    """Convert text to kinds with their roles in the order of `KINDS`.

    If ``strict`` is true, other text is an error; otherwise, it remains unchanged.
    """
    values = to_plain(values, name).astype(str)
    kinds, rows = np.unique(values, return_inverse=True)
    ordered = []
    for kind in kinds.tolist():
        roles = {role.strip() for role in kind.lower().split("+")}
        if strict and not roles <= {*KINDS}:
            raise InputError(
                f"{name} must be science, standard or sky, or several of them joined by '+', such as "
                f"science+standard, got {short(kind)}"
            )
        ordered.append("+".join(role for role in KINDS if role in roles) if roles <= {*KINDS} else kind)
    ordered = np.array(ordered, dtype=str)
    # equal catalogs have the same digest only if the length of the text remains the same
    return ordered.astype(np.promote_types(ordered.dtype, values.dtype))[rows].reshape(values.shape)


def has_role(kind: np.ndarray, role: str) -> np.ndarray:
    """Return whether each target has a role; ``kind`` contains kinds as `to_kinds` returns them."""
    matches = kind == role
    if np.asarray(kind).dtype.itemsize > 4 * len("standard"):  # other kinds are too short for several roles
        for joined in JOINED:
            if role in joined.split("+"):
                matches = matches | (kind == joined)
    return matches


def count_also_science(kind: np.ndarray, counted: Iterable[str]) -> int:
    """Return the number of science targets that also have a role for which there is a requirement.

    ``counted`` contains the kinds and categories that requirements count.
    """
    has_counted = [has_role(kind, role) for role in {*KINDS[1:]}.intersection(counted)]
    return int((has_role(kind, "science") & np.any(has_counted, axis=0)).sum())


def without_science(kind: np.ndarray) -> np.ndarray:
    """Return kinds without the role science, for targets that have other roles."""
    return _without(kind, "science+")


def last_role(kind: np.ndarray) -> np.ndarray:
    """Return the last role of each target, for files that have one role for each target."""
    return np.array([roles.rpartition("+")[2] for roles in kind.tolist()], dtype=kind.dtype)


def without_role(kind: np.ndarray, role: str, where: np.ndarray) -> np.ndarray:
    """Return kinds in which the marked targets, which also have other roles, do not have a role."""
    return np.where(where, _without(_without(kind, f"{role}+"), f"+{role}"), kind)


def _without(kind: np.ndarray, text: str) -> np.ndarray:
    return np.char.replace(kind, text, "") if kind.size else kind


def count_roles(kind: np.ndarray) -> str:
    """Return text with the number of targets of each kind, or empty text if no target has several roles."""
    kinds, counts = np.unique(kind, return_counts=True)
    order = [roles for roles in (*JOINED, *KINDS) if roles in kinds]
    if not {*order} & {*JOINED}:
        return ""
    number = dict(zip(kinds.tolist(), counts.tolist(), strict=True))
    return "roles: " + ", ".join(f"{number[roles]} {roles.replace('+', ' and ')}" for roles in order)


RESERVED = {"tile", "id", "positioner", "spectrograph", "x", "y", "status", "target_id", "target_row", "ra", "dec"}
RESERVED |= {"kind", "category", "priority", "fiber_type", "theta", "phi", "elbow_x", "elbow_y", "tip_x", "tip_y"}
RESERVED |= {"in_collision", "colliding_with", "needs_planner", "without_path", "clearance", "arm_x", "arm_y"}
RESERVED |= {"outcome", "observed"}
"""Names of the columns of results, which ``_field/table.py`` (`TILE_COLUMNS`, `OUTCOMES_COLUMNS`) and
``_survey/work.py`` (`VISITS_COLUMNS`) describe; a test compares them."""
MOST_EXACT = 2**53
COLUMN_KINDS = {"b": "b", "i": "i", "u": "i", "f": "f", "U": "U", "S": "U"}


def pick_columns(table: Table, keep: object, used: set) -> QTable | None:
    """Return the columns of a table whose names are in ``keep`` but not in ``used``, or None if there are none."""
    if keep is None:
        return None
    if not isinstance(keep, str | list | tuple):
        raise InputTypeError(f"keep must be a list of column names, got {short(keep)}")
    names = [keep] if isinstance(keep, str) else list(keep)
    for name in names:
        if name not in table.colnames:
            raise InputError(
                f"columns that are kept, or that a rule uses, must be columns of the table ({listed(table.colnames)}), "
                f"got {name!r}"
            )
    names = [name for name in names if name not in used]
    return extra_columns({name: table[name] for name in names}, len(table)) if names else None


def extra_columns(columns: object, n: int) -> QTable | None:
    """Convert columns to numbers, quantities, booleans or text, with one value for each of n targets.

    Missing numbers become NaN, and missing text becomes empty. The columns can be written to all formats of files
    except for characters outside ASCII: text has no blanks at its ends, and numbers have at most 64 bits.
    """
    if columns is None:
        return None
    if not isinstance(columns, Mapping | Table):
        raise InputTypeError(f"extra must be a dict or a table of columns, got {type(columns).__name__}")
    names = columns.colnames if isinstance(columns, Table) else list(columns)
    for name in map(str, names):
        if not name.isprintable() or name != name.strip() or not name:
            raise InputError(f"the name of a column in keep must be text without blanks at its ends, got {name!a}")
    extra = QTable({str(name): _plain(columns[name], str(name)) for name in names})
    if len(extra) != n:
        raise InputError(f"columns of extra must have one value for each of the {n} targets, got {len(extra)} values")
    return extra


def result_name(name: str) -> str:
    """Return the name of an extra column in results: the prefix ``target_`` is added to names in ``RESERVED``.

    The comparison of names ignores case, because FITS does not distinguish column names that differ only in case.
    """
    while name.lower() in RESERVED:
        name = f"target_{name}"
    return name


def _plain(column, name):
    if isinstance(column, ShapedLikeNDArray) and not isinstance(column, Masked):  # such as Time and SkyCoord
        raise InputError(
            f"column {name!r} in keep must contain numbers, text or booleans, got a {type(column).__name__}"
        )
    unit = getattr(column, "unit", None)
    values, missing = getattr(column, "value", column), np.ma.getmaskarray(np.ma.asarray(column))
    if isinstance(column, Masked):
        values, missing = getattr(column.unmasked, "value", column.unmasked), np.asarray(column.mask)
    values = np.asarray(values)
    values = values.astype(values.dtype.newbyteorder("="), copy=False)
    if values.dtype.kind == "O":
        values, missing = _of_objects(values, missing, name)
    if values.ndim != 1 or values.dtype.kind not in COLUMN_KINDS:
        raise InputError(
            f"column {name!r} in keep must contain one number, text or boolean per target, got the type "
            f"{values.dtype} and the shape {values.shape}"
        )
    kind = COLUMN_KINDS[values.dtype.kind]
    if kind == "U":
        values = np.char.strip(np.where(missing, "", to_plain(values, f"column {name!r} in keep")))
        check_text(values, f"column {name!r} in keep")
        return values
    if kind == "f" and values.dtype.itemsize not in (4, 8):  # files contain numbers of 32 or 64 bits
        values = values.astype(float)
    if missing.any() and kind == "i" and np.abs(values[~missing].astype(float)).max(initial=0) >= MOST_EXACT:
        raise InputError(
            f"column {name!r} in keep must not have missing values: missing values become NaN, but floats cannot "
            "represent the integers of this column exactly"
        )
    if missing.any():
        values = np.where(missing, np.nan, values.astype(float))
    elif kind == "i":
        if values.max(initial=0) >= 2**63:
            raise InputError(f"column {name!r} in keep must contain integers below 2**63, got {values.max()}")
        values = values.astype(np.int64)
    if unit is None or unit == u.dimensionless_unscaled:
        return values
    if values.dtype.kind == "i" and without_unit(values, f"the column {name!r}", unit):
        return values
    if not is_known(unit):
        warn(f"the column {name!r} is kept without its unit, {unit}, whose name astropy does not know")
        return values
    return values.astype(float) * u.Unit(unit)


def _of_objects(values, missing, name):
    """Convert a column of Python objects, as in pandas, to text or numbers."""
    missing = missing | np.array([v is None or v is np.ma.masked or v != v for v in values.tolist()], dtype=bool)
    known = values[~missing].tolist()
    if all(isinstance(v, str) for v in known):
        return np.array([v if isinstance(v, str) else "" for v in values.tolist()], dtype=str), missing
    if all(isinstance(v, int | float | np.number) for v in known):
        return np.array([0.0 if gone else float(v) for v, gone in zip(values.tolist(), missing, strict=True)]), missing
    raise InputError(f"column {name!r} in keep must contain numbers or text, got objects of other types")


# Largest number of zones, and mean number of directions in a square whose side is the height of a zone.
MOST_ZONES = 1800
PER_SQUARE = 25.0
# Number of directions that are copied or converted together; astropy makes many temporary arrays of this length.
BLOCK = 1 << 18


class SkyIndex:
    """Unit vectors sorted by zones of declination.

    The index of a direction in the sorted list is called the *position* of the direction. ``order[k]`` is the row,
    in the parameter ``vectors``, of the direction that has the position k.

    Parameters
    ----------
    vectors : ndarray, shape (n, 3)
        Unit vectors of the directions to sort.
    """

    def __init__(self, vectors: np.ndarray):
        n = len(vectors)
        self.n_zones = int(np.clip(np.sqrt(max(n, 1) / PER_SQUARE), 1, MOST_ZONES))
        self.key = np.empty(n)
        zones.make_keys(vectors, self.n_zones, self.key)
        # The type is int32 if possible, because this array uses much of the memory of a large catalog.
        self.order = np.argsort(self.key, kind="stable").astype(np.int32 if n < 2**31 else np.int64)
        self.key = self.key[self.order]
        self.vectors = np.empty((n, 3))
        for first in range(0, n, BLOCK):  # `take` is fast, but it makes a copy of the indices with 64 bits
            rows = slice(first, first + BLOCK)
            vectors.take(self.order[rows], axis=0, out=self.vectors[rows], mode="clip")

    def __len__(self):
        return len(self.order)

    @cached_property
    def _everything(self):
        return np.ones(len(self), dtype=np.uint8)

    def near(self, center: np.ndarray, radius_rad: float, left: np.ndarray | None = None) -> np.ndarray:
        """Return the positions (in the sorted list) of the directions inside a circle, in the order of their rows.

        Parameters
        ----------
        center : ndarray, shape (3,)
            Unit vector of the center of the circle.
        radius_rad : float
            Angular radius of the circle, in radians.
        left : ndarray, shape (n,), optional
            Value for the direction at each position, such as a number of remaining visits. Directions with the value 0
            are omitted.

        Returns
        -------
        ndarray of int
            Positions of these directions in the sorted list.
        """
        limit = half_chord_squared(radius_rad)
        left = self._everything if left is None else left
        size = 4096
        while True:
            out = np.empty(size, dtype=np.int64)
            n = zones.find_near(self.vectors, self.key, self.n_zones, center, radius_rad, limit, left, out)
            if n <= size:
                return out[:n][np.argsort(self.order[out[:n]])]
            size = n

    def sum_near(self, centers: np.ndarray, radius_rad: float, weight: np.ndarray) -> np.ndarray:
        """Return the sum of the weights of the directions in a circle about each center, shape (m,)."""
        out = np.empty(len(centers))
        limit = half_chord_squared(radius_rad)
        centers = np.ascontiguousarray(centers)
        zones.sum_near(self.vectors, self.key, self.n_zones, centers, radius_rad, limit, weight, out)
        return out


def half_chord_squared(radius_rad: float) -> float:
    """Return the square of half the chord of an angle, slightly increased to allow for rounding errors."""
    return np.sin(0.5 * min(radius_rad, np.pi)) ** 2 * (1 + 1e-15)


class CatalogArrays:
    """The columns of a catalog as read-only arrays without units, which are computed on first use and then stored.

    Parameters
    ----------
    catalog : Catalog
        The catalog.

    Attributes
    ----------
    vectors : ndarray of float, shape (n, 3)
        Unit vectors in the directions of the targets, in the frame ICRS.
    repeated_ids : bool
        Whether any two targets have the same identifier.
    extra : dict
        Values of the extra columns of the catalog, without units. The keys are the names that the columns have in
        results; for example, the key of a column ``ra`` is ``target_ra``.
    extra_units : dict
        Units of the extra columns as text, with the same keys as ``extra``. The text is empty for a column without a
        unit.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> catalog = rs.Catalog(SkyCoord([0, 90] * u.deg, [0, 0] * u.deg))
    >>> catalog.arrays.vectors
    array([[1., 0., 0.],
           [0., 1., 0.]])
    """

    def __init__(self, catalog):
        # The catalog itself is not stored, because a circular reference would delay the release of its memory.
        self._coord, self._id, self._epoch = catalog.coord, catalog.id, catalog.epoch
        names = [] if catalog.extra is None else catalog.extra.colnames
        columns = {result_name(name): catalog.extra[name] for name in names}
        self.extra = {name: np.asarray(getattr(column, "value", column)) for name, column in columns.items()}
        self.extra_units = {name: str(getattr(column, "unit", None) or "") for name, column in columns.items()}

    @cached_property
    def vectors(self) -> np.ndarray:
        vectors = np.empty((len(self._coord), 3))
        for first in range(0, len(vectors), BLOCK):
            block = slice(first, first + BLOCK)
            vectors[block] = to_vectors(self._coord[block])
        return locked(vectors)

    @cached_property
    def repeated_ids(self) -> bool:
        ids = self._id
        if ids.dtype.kind == "i" and (ids[1:] > ids[:-1]).all():
            return False
        return len(np.unique(ids)) < len(ids)

    def rows_within(self, center: SkyCoord, radius_rad: float) -> np.ndarray:
        """Return the row numbers of the targets inside a circle on the sky."""
        mask = np.empty(len(self._id), dtype=bool)
        center = to_vectors(center, "center", scalar=True)[0]
        sky.within(self.vectors, center, half_chord_squared(radius_rad), mask)
        return np.flatnonzero(mask)

    def rows_near(self, center: SkyCoord, radius_rad: float, time: object) -> np.ndarray:
        """Return the row numbers of all targets that could be inside a circle on the sky at another epoch.

        The radius of the circle is increased by the largest angle by which any target moves until this epoch.
        """
        # A small additional margin allows for rounding errors.
        return self.rows_within(center, radius_rad + self.farthest_rad(time) * (1 + 1e-9) + 1e-12)

    def farthest_rad(self, time: object) -> float:
        """Return an upper limit of the angle (rad) by which any target moves until another epoch."""
        if "s" not in self._coord.data.differentials or self._epoch is None:
            return 0.0
        icrs = self._coord.icrs
        speed = np.nan_to_num(np.hypot(icrs.pm_ra_cosdec, icrs.pm_dec).to_value(u.rad / u.yr))
        years = np.abs((to_time(time, "epoch").tdb - self._epoch.tdb).to_value(u.yr))
        return float(np.max(speed * years, initial=0.0))
