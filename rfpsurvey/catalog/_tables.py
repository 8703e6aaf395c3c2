"""A catalog as a table: coordinates, epochs and kinds from the columns that people use."""

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table
from astropy.time import Time

from rfpsurvey.catalog._columns import Finder
from rfpsurvey.catalog._time import to_time
from rfpsurvey.errors import InputError

__all__ = ["read_columns"]


def read_columns(table: Table, columns, units, frame, *, assume_units: bool) -> dict:
    """Return the arguments of a Catalog that a table describes."""
    if not isinstance(table, Table):
        raise InputError(f"table must be an astropy Table or QTable, got {type(table).__name__}")
    find = Finder(table, columns or {}, units or {}, assume_units)
    category = find.labels("category")
    kind = find.labels("kind")
    if kind is not None:
        kind = np.char.lower(np.where(kind == "", "science", kind))
    elif category is not None:
        kind = _kind_of_category(category)
    return {
        "coord": _coordinates(find, frame),
        "id": find.labels("id"),
        "priority": find.numbers("priority"),
        "kind": kind,
        "category": category,
        "fiber_type": find.labels("fiber_type"),
        "epoch": _epoch(find),
        "meta": _plain_meta(table.meta),
    }


def _coordinates(find: Finder, frame: str) -> SkyCoord:
    for column in find.table.columns.values():
        if isinstance(column, SkyCoord):
            return column
    roles = ("ra", "dec") if find.name_of("ra") and find.name_of("dec") else ("lon", "lat")
    names = [find.name_of(role) for role in roles]
    if names[0] is None or names[1] is None or (roles[0] == "lon" and frame == "icrs"):
        lacking = [role for role in ("ra", "dec") if find.name_of(role) is None]
        raise find.missing(" and ".join(lacking))
    texts = [np.asarray(find.table[name]).dtype.kind in "OTUS" for name in names]
    if all(texts):
        try:
            return SkyCoord(find.labels(roles[0]), find.labels(roles[1]), unit=(u.hourangle, u.deg), frame=frame)
        except ValueError as error:
            raise InputError(f"columns {names[0]!r} and {names[1]!r} are not sexagesimal: {error}") from error
    lon, lat = find.quantity(roles[0]), find.quantity(roles[1])
    bad = np.abs(lat) > 90 * u.deg
    if bad.any():
        raise InputError(f"column {names[1]!r} must lie between -90 and 90 deg, got {lat[bad][0]}")
    motion = {}
    if roles[0] == "ra" and find.name_of("pmra") and find.name_of("pmdec"):
        motion = {"pm_ra_cosdec": find.quantity("pmra"), "pm_dec": find.quantity("pmdec")}
    try:
        return SkyCoord(lon, lat, frame=frame, **motion)
    except ValueError as error:
        raise InputError(f"frame {frame!r} cannot be used: {error}") from error


def _epoch(find: Finder) -> Time | None:
    """Epoch from a column, or from the table's meta where it says so."""
    name = find.name_of("epoch")
    if name is None:
        value = find.table.meta.get("ref_epoch", find.table.meta.get("REF_EPOCH"))
        if value is None:
            return None
        word = str(value).split()[0].removeprefix("J")
        try:
            return to_time(float(word), "ref_epoch")
        except ValueError:
            return None
    column = find.table[name]
    if isinstance(column, Time):
        return column
    years = find.numbers("epoch")
    if np.isnan(years).any() or (years < 1700).any() or (years > 2300).any():
        raise InputError(f"column {name!r} (epoch) must hold Julian years, got {years.min()} to {years.max()}")
    return to_time(years[0] if len(years) and (years == years[0]).all() else years, name)


def _kind_of_category(category: np.ndarray) -> np.ndarray:
    """Return the kinds that categories such as sky_boss or standard_apogee speak of."""
    lower = np.char.lower(category)
    kind = np.full(len(lower), "science", dtype="U8")
    kind[np.char.startswith(lower, "standard") | np.char.startswith(lower, "std")] = "standard"
    kind[np.char.startswith(lower, "sky")] = "sky"
    return kind


def _plain_meta(meta: dict) -> dict:
    """Keep what JSON can say of a table's meta, without the comments that readers leave."""
    return {
        str(k): v for k, v in meta.items() if isinstance(v, str | int | float | bool) and not str(k).startswith("__")
    }
