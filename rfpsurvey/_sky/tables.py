"""Read coordinates, epochs and kinds of a catalog from the columns of a table."""

import astropy.units as u
import numpy as np
from astropy.coordinates import Angle, SkyCoord, frame_transform_graph
from astropy.table import QTable, Table
from astropy.time import Time

from rfpsurvey._common.read_tables import is_number
from rfpsurvey._common.units import rows_of, to_labels
from rfpsurvey._sky.arrays import count_roles, has_role, pick_columns, result_name, to_kinds
from rfpsurvey._sky.columns import Finder
from rfpsurvey._sky.frames import as_table, select_rows
from rfpsurvey._sky.survey_formats import (
    COUNTS,
    check_mode,
    find_format,
    is_unusable,
    kinds_and_visits,
    shifted,
    visits_of_times,
)
from rfpsurvey._sky.time import FIRST, LAST, moving, to_time
from rfpsurvey.errors import InputError, InputTypeError, check_choice, number_of, short, warn

PER_TARGET = ("id", "priority", "kind", "category", "fiber_type", "visits", "subpriority")
EQUATORIAL = ("icrs", "fk5", "fk4", "fk4noeterms")


def read_columns(table: Table, columns, units, frame, fill, keep, select=None, *, assume_units=False) -> dict:
    """Read the columns of a table, and return them as a dict of arguments for `Catalog`.

    With ``assume_units``, columns without a unit are assumed to have the default unit of their role. Without this
    option, default units are assumed only if no column of positions or proper motions has a unit. A warning is then
    issued, except for tables that cannot have units, such as DataFrames, and for tables of surveys.
    """
    columns, units, fill = ({} if mapping is None else mapping for mapping in (columns, units, fill))
    table, is_plain = as_table(table, columns)
    table, ledger = _last_entries(table)
    table, selected = select_rows(table, select)
    assume_units = assume_units or is_plain
    extra = None if keep is None else pick_columns(table, keep, _names_in_results(table, columns, frame))
    find, roles = Finder(table, columns, units, fill=fill), catalog_roles(frame)
    find.assume_units = assume_units or not find.has_units(roles)
    category = find.labels("category")
    kind, (visits, unset) = find.labels("kind"), _visits(find)
    if kind is not None:
        kind = to_kinds(np.where(kind == "", "science", kind), f"column {find.name_of('kind')!r} (kind)")
    elif find.format is not None and find.format.bits is not None:
        bits = _bits(find, find.format.bits)
        kind, visits = kinds_and_visits(bits, _bits(find, find.format.stars, fill=True), visits)
        unset &= ~is_unusable(bits)
    elif category is not None:
        kind = _kind_of_category(category)
    if (unset := unset if kind is None else unset & has_role(kind, "science")).any():
        text = f"column {find.name_of('visits')!r} (visits) is negative (not set) in {rows_of(unset)}"
        warn(f"{text}, which are not standard stars or sky positions; no visits of these targets are requested")
    if find.format is not None and find.format.mode:
        check_mode(table, find.format.mode, "catalog")
    coord = _with_offsets(find, _coordinates(find, frame))
    find.warn_of_doubt()
    meta = _plain_meta(table.meta)
    if mixed := _sky_coords(find):
        roles = [role for role in roles if role not in ("ra", "dec", "lon", "lat", "pmra", "pmdec")]
    meta["columns"] = find.statement(roles, [keep] if isinstance(keep, str) else keep or [], mixed) + selected
    meta["columns"] += "" if kind is None or not (text := count_roles(kind)) else f"; {text}"
    if find.assumed:
        meta["assumed_units"] = ", ".join(f"{find.name_of(role)} in {unit}" for role, unit in find.assumed.items())
        if not (assume_units or find.format):
            warn(
                f"the positions and proper motions have no units: the assumed units are {meta['assumed_units']}; to "
                "use other units, give units= or --set catalog.units.ra=UNIT"
            )
    return {
        "coord": coord,
        "id": _ids(find),
        "priority": find.complete("priority"),
        "subpriority": find.complete("subpriority"),
        "kind": kind,
        "category": category,
        "fiber_type": find.labels("fiber_type"),
        "visits": visits,
        "epoch": _epoch(find, coord),
        "meta": meta | ({"ledger": ledger} if ledger else {}),
        "extra": extra,
    }


def _last_entries(table: Table) -> tuple[Table, str]:
    """Return the last row of each target in a DESI ledger, and text that states the number of other rows.

    Each change of a target adds a row at the end of a DESI ledger, so the last row states the current priority and
    number of visits. Other tables are returned unchanged, with empty text.
    """
    name, format_ = next((c for c in table.colnames if c.lower() == "targetid"), None), find_format(table.colnames)
    if name is None or format_ is None or format_.name != "DESI ledger":
        return table, ""
    ids = to_labels(table[name], f"column {name!r}")
    # the first entry in reverse order
    last = len(ids) - 1 - np.unique(ids[::-1], return_index=True)[1]
    if len(last) == len(ids):
        return table, ""
    said = f"{len(ids) - len(last)} of {len(ids)} rows of the DESI ledger are earlier entries of the same targets"
    warn(f"{said}; only the last entry of each target was read")
    return table[np.sort(last)], said


def catalog_roles(frame: str) -> tuple[str, ...]:
    """Return the roles of the columns that a catalog with coordinates in the given frame uses."""
    equatorial = ("ra", "dec", "pmra", "pmdec")
    return (
        *("priority", "subpriority", "visits", "kind", "category", "fiber_type", "id", "delta_ra", "delta_dec"),
        *(equatorial if str(frame).lower() in EQUATORIAL else ("lon", "lat")),
        "epoch",
    )


def _visits(find: Finder) -> tuple[np.ndarray | None, np.ndarray]:
    """Return the requested numbers of visits, and a mask of the rows in which DESI has not set this number.

    No visits are requested in these rows.
    """
    if find.format is not None and find.format.times and "visits" not in find.given:
        visits, find.remarks["visits"] = visits_of_times(find.table, find.name_of("visits"), find.format.exposure)
        return visits, np.zeros(len(visits), dtype=bool)
    visits = find.complete("visits")
    if visits is None or find.name_of("visits").lower() not in COUNTS:
        return visits, np.zeros(len(find.table), dtype=bool)
    unset = visits < 0
    if unset.any():
        find.remarks["visits"] = f" (negative, no visits requested: {rows_of(unset)})"
    return np.where(unset, 0, visits), unset


def _bits(find: Finder, name: str | None, *, fill: bool = False) -> np.ndarray:
    """Return the bits in a column such as ``DESI_TARGET`` of a table of DESI; 0 without this column.

    With ``fill``, 0 replaces missing values.
    """
    if name is None:
        return np.zeros(len(find.table), dtype=np.int64)
    bits = to_labels(np.ma.filled(find.table[name], 0) if fill else find.table[name], f"column {name!r}")
    if bits.dtype.kind != "i":
        raise InputError(f"column {name!r} must hold integers, whose bits state the kinds of targets, got text")
    return bits


def _ids(find: Finder) -> np.ndarray | None:
    """Return the identifiers of all rows, or None if the table has no column of identifiers."""
    ids = find.labels("id")
    if ids is not None and ids.dtype.kind == "U" and (ids == "").any():
        warn(
            f"column {find.name_of('id')!r} (id) is empty in {rows_of(ids == '')}; to use another column, give "
            "columns={'id': ...} or --column id=..."
        )
    return ids


def _names_in_results(table, columns, frame):
    """Return the names of the columns that all results contain anyway, with unchanged names and values."""
    has_coordinates = any(isinstance(column, SkyCoord) for column in table.columns.values())
    roles = ["id", "priority", "kind", "category"]
    roles += ["ra", "dec"] if frame.lower() == "icrs" and not has_coordinates else []
    find = Finder(table, columns)
    names = {role: find.name_of(role) for role in roles if not find.columns.get(role, "").startswith("-")}
    return {name for role, name in names.items() if name and name.lower() in (role, "target_id")}


def has_units(table: Table) -> bool:
    """Return whether any column of a table has a unit."""
    return any(getattr(column, "unit", None) is not None for column in table.columns.values())


def _sky_coords(find: Finder) -> list[str]:
    """Return the names of the columns of `SkyCoord` objects, or an empty list if columns of coordinates are given."""
    given = {"ra", "dec", "lon", "lat"} & set(find.columns)
    return [] if given else [name for name in find.table.colnames if isinstance(find.table[name], SkyCoord)]


def _coordinates(find: Finder, frame: str) -> SkyCoord:
    if mixed := _sky_coords(find):
        if len(mixed) > 1:
            raise InputError(
                f"the table must have a single column of coordinates, got {', '.join(mixed)}; remove all but one"
            )
        return find.table[mixed[0]]
    if not isinstance(frame, str):
        raise InputTypeError(f"frame must be the name of a frame such as 'icrs', got {short(frame)}")
    frame = frame.lower()
    check_choice(frame, frame_transform_graph.get_names(), "frame")
    equatorial = frame in EQUATORIAL
    if not equatorial:
        _check_frame(frame)
    roles = ("ra", "dec") if equatorial else ("lon", "lat")
    lacking = [role for role in roles if find.name_of(role) is None]
    if lacking:
        raise find.missing(" and ".join(lacking) + ("" if equatorial else f" of the frame {frame!r}"))
    lon, lat = (_angle(find, role, u.hourangle if role == "ra" else u.deg) for role in roles)
    motion = _motion(find, equatorial=equatorial)
    for role, values, most in ((roles[1], lat, 90), (roles[0], lon, 360)):
        if (far := np.abs(values) > most * u.deg).any():
            name = find.name_of(role)
            raise InputError(f"column {name!r} must lie between -{most} and {most} deg, got {values[far][0]}")
    try:
        return SkyCoord(lon, lat, frame=frame, **motion)
    except ValueError as error:
        raise InputError(f"frame {frame!r} cannot be used: {error}") from error


def _with_offsets(find: Finder, coord: SkyCoord) -> SkyCoord:
    """Return the positions plus the offsets of candidates of SDSS-V, if the table has offsets."""
    roles = ("delta_ra", "delta_dec")
    if None in [find.name_of(role) for role in roles]:
        return coord
    offsets = [np.nan_to_num(find.numbers(role)) * (find.unit_of(role) or u.arcsec) for role in roles]
    coord, n = shifted(coord, offsets)
    find.remarks["delta_dec"] = f" (added to the positions of {number_of(n, 'target')})"
    return coord


def _check_frame(frame: str) -> None:
    """Raise an error if a frame, such as altaz, depends on an observer or on a time."""
    try:
        SkyCoord(0 * u.deg, 0 * u.deg, frame=frame).transform_to("icrs")
    except Exception as error:  # a frame can raise any exception
        raise InputError(
            f"frame must be a frame that has a fixed relation to ICRS, such as icrs, fk5 or galactic, got {frame!r}"
        ) from error


def _angle(find: Finder, role: str, unit: u.UnitBase) -> u.Quantity:
    """Return the column with this role in degrees; ``unit`` is the unit of sexagesimal text that states no unit."""
    if not find.is_text(role):
        return find.quantity(role)
    column_unit, texts = find.unit_of(role), find.texts(role)
    unit = column_unit if column_unit is not None and column_unit.is_equivalent(u.deg) else unit
    there = texts != ""
    angles = np.full(len(texts), np.nan)
    decimal = [text for text in texts[there].tolist() if is_number(text)] if column_unit is None else []
    try:
        if decimal:
            raise ValueError("this is neither of them")
        angles[there] = Angle(texts[there].tolist(), unit).to_value(u.deg)
    except ValueError as error:
        what = f"column {find.name_of(role)!r} ({role}) must hold decimal numbers or sexagesimal text"
        not_decimal = [text for text in texts[there].tolist() if not is_number(text)]
        text = _not_an_angle(not_decimal, unit)
        if decimal and not text:
            raise InputError(f"{what}, the same in all rows, got {decimal[0]!r} and {not_decimal[0]!r}") from None
        remedy = "; replace the decimal comma with a point" if text.replace(",", "", 1).isdecimal() else f": {error}"
        raise InputError(f"{what}, got {text!r}{remedy}") from error
    return angles * u.deg


def _not_an_angle(texts: list[str], unit: u.UnitBase) -> str:
    """Return the first text in a column that is not an angle."""
    for text in texts:
        try:
            Angle(text, unit)
        except ValueError:
            return text
    return ""


def _motion(find: Finder, *, equatorial: bool) -> dict:
    """Return the proper motions of a table, if there are any, as arguments of SkyCoord."""
    names = [find.name_of(role) for role in ("pmra", "pmdec")]
    if names == [None, None]:
        return {}
    if not equatorial:
        warn(
            f"the proper motions {names} are ignored, because they refer to an equatorial frame, but the coordinates "
            "are in another frame"
        )
        return {}
    if None in names:
        raise find.missing("pmra" if names[0] is None else "pmdec")
    return {"pm_ra_cosdec": find.quantity("pmra"), "pm_dec": find.quantity("pmdec")}


def _epoch(find: Finder, coord: SkyCoord) -> Time | None:
    """Return the epoch from a column or from the metadata of the table, or None if the table has no usable epoch."""
    name = find.name_of("epoch")
    if name is None:
        meta = {str(k).lower(): v for k, v in find.table.meta.items()}
        words = str(meta.get("ref_epoch", "")).split()
        try:
            return to_time(words[0], "ref_epoch") if words else None
        except InputError:
            return None
    if isinstance(find.table[name], Time):
        return find.table[name] if find.table[name].ndim == 1 else None
    moves = moving(coord)
    try:
        years = _years(find, moves)
    except InputError:
        if moves.any():
            raise
        return None
    usable = (years > FIRST) & (years < LAST)
    if (moves & ~usable).any():
        worst = years[moves & ~usable]
        raise InputError(
            f"column {name!r} (epoch) must hold Julian years for targets with a proper motion, "
            f"but {len(worst)} of these targets have other values, such as {worst[0]:g}"
        )
    if not usable.any():
        return None
    years = np.where(usable, years, years[usable][0])
    return to_time(years[0] if (years == years[0]).all() else years, name)


def _years(find: Finder, moves: np.ndarray) -> np.ndarray:
    """Return the column of epochs as Julian years, with NaN for missing epochs; text such as J2016.0 is converted.

    Text that is no epoch is an error for targets with a proper motion, and is regarded as missing for other targets.
    """
    if not find.is_text("epoch"):
        return find.numbers("epoch")
    texts, rows = np.unique(find.texts("epoch"), return_inverse=True)
    years = np.full(len(texts), np.nan)
    for k, text in enumerate(texts.tolist()):
        try:
            years[k] = to_time(text, f"column {find.name_of('epoch')!r} (epoch)").jyear if text else np.nan
        except InputError:
            if moves[rows == k].any():
                raise
    return years[rows]


def catalog_table(catalog) -> QTable:
    """Return a table with all columns of a catalog."""
    icrs = catalog.coord.icrs
    table = QTable({"id": catalog.id, "ra": icrs.ra.to(u.deg), "dec": icrs.dec.to(u.deg)}, meta=dict(catalog.meta))
    if catalog.has_proper_motion:
        table["pmra"] = icrs.pm_ra_cosdec.to(u.mas / u.yr)
        table["pmdec"] = icrs.pm_dec.to(u.mas / u.yr)
    if catalog.epoch is not None:
        table["ref_epoch"] = np.broadcast_to(catalog.epoch.jyear, len(catalog)) * u.yr
    for name in PER_TARGET[1:]:
        if getattr(catalog, name) is not None:
            table[name] = getattr(catalog, name)
    for name in [] if catalog.extra is None else catalog.extra.colnames:
        table[result_name(name)] = catalog.extra[name]
    return table


def _kind_of_category(category: np.ndarray) -> np.ndarray:
    """Return the kind of each target according to its category; for example, sky_boss implies the kind sky."""
    lower = np.char.lower(category)
    kind = np.full(len(lower), "science", dtype="U8")
    kind[np.char.startswith(lower, "standard") | np.char.startswith(lower, "std")] = "standard"
    kind[np.char.startswith(lower, "sky")] = "sky"
    return kind


def _plain_meta(meta: dict) -> dict:
    """Return the values in the ``meta`` of a table that JSON can represent, without comments that file readers add."""
    return {
        str(k): v for k, v in meta.items() if isinstance(v, str | int | float | bool) and not str(k).startswith("__")
    }
