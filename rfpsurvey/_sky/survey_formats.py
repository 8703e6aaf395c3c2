"""Recognize target tables of surveys by their columns, and read these columns as the surveys define them."""

import re
from collections.abc import Iterable
from typing import NamedTuple

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table

from rfpsurvey._common.units import rows_of, to_labels
from rfpsurvey._sky.arrays import has_role
from rfpsurvey.errors import InputError, listed, warn

# Columns of DESI with numbers of visits. In desitarget, -1 means that no number was set, because the target is only a
# standard star or a sky position, or cannot be observed in the conditions of the file.
COUNTS = ("numobs_init", "numobs_more")

# Bits of DESI_TARGET (desitarget/data/targetmask.yaml). fiberassign assigns no science target, standard star or sky
# position whose bit BAD_SKY, BRIGHT_OBJECT or IN_BRIGHT_OBJECT is set.
SCIENCE = sum(1 << bit for bit in (0, 1, 2, 3, 60, 61, 62))
STANDARD = sum(1 << bit for bit in (33, 34, 35))
SKY = sum(1 << bit for bit in (32, 37))
STARS = re.compile(r"(sv\d_)?mws_target")
"""Name of the column whose bits 33 to 35 are the standard stars of the backup program, such as GAIA_STD_BRIGHT."""
UNUSABLE = sum(1 << bit for bit in (36, 50, 51))
BITS = re.compile(r"(sv\d_)?desi_target")

EXPOSURE = 900 * u.s
"""Time of one exposure of PFS if a target list states no other time (documentation of the PFS target uploader)."""
MOST_OFFSET = 900 * u.arcsec
"""Largest offset of a candidate of SDSS-V that is added; offsets are at most a few arcmin."""
SDSSV = "SDSS-V"
SDSSV_COLUMNS = {"cadence", "category", "carton", "cartonname", "program", "mapper", "inertial"}
SDSSV_COLUMNS |= {"can_offset", "delta_ra"}
"""Columns of candidates of SDSS-V; several of them identify lists without catalogid and rsid."""
NO_OFFSET = (-999.0, -999.99, -9999.0, -9999.99)
"""Codes for no offset."""


class SurveyFormat(NamedTuple):
    """The format of a target table of a survey."""

    name: str
    columns: dict  # name of the column with each role; a leading minus reverses the sign of its numbers
    bits: str | None = None  # name of the column ``DESI_TARGET``, whose bits state the kind of each target
    stars: str | None = None  # name of the column ``MWS_TARGET``, whose bits state further standard stars
    marks: tuple = ()  # names of further columns by which the format is recognized, or that are read
    times: bool = False  # whether the column of visits contains exposure times
    exposure: str = ""  # name of the column with the time of one exposure
    mode: str = ""  # name of the column whose values must be equal, because its targets cannot share a tile
    doubt: str = ""  # text of a warning, if a column of the format is missing


def find_format(names: Iterable[str]) -> SurveyFormat | None:
    """Return the survey format of a table with the given column names; None if the table has no such format."""
    lower = {name.lower(): name for name in reversed(list(names))}
    return _desi(lower) or _sdssv(lower) or _pfs(lower)


def _desi(lower: dict) -> SurveyFormat | None:
    """Return the format of DESI target files (``PRIORITY_INIT``, ``NUMOBS_INIT``) or DESI ledgers (``NUMOBS_MORE``)."""
    bits, stars = (next((lower[key] for key in lower if form.fullmatch(key)), None) for form in (BITS, STARS))
    if bits is None and not lower.keys() & {"priority_init", "numobs_init", "numobs_more"}:
        return None
    start, current = ("priority_init", "numobs_init"), ("priority", "numobs_more")
    pair, other_pair = (current, start) if lower.keys() & set(current) else (start, current)
    columns = {role: lower[name] for role, name in zip(("priority", "visits"), pair, strict=True) if name in lower}
    doubt = ""
    lacking = [k for k in (0, 1) if pair[k] not in lower and other_pair[k] in lower]
    if lower.keys() & {"visits", "n_visits", "nvisits"}:  # added by the user
        columns.pop("visits", None)
    elif lacking and columns:
        used, unused = next(iter(columns.values())), lower[other_pair[lacking[0]]]
        doubt = f"the table has the column {used} but not {pair[lacking[0]].upper()}; {unused} is not used instead, "
        doubt += f"because {used} and {unused} describe different times of a survey"
    if "targetid" in lower:
        columns["id"] = lower["targetid"]
    name = "DESI ledger" if "numobs_more" in lower else "DESI targets"
    return SurveyFormat(name, columns, bits, stars, doubt=doubt)


def _sdssv(lower: dict) -> SurveyFormat | None:
    """Return the format of candidates of SDSS-V, in which small priorities are more important."""
    typical = [name for name in lower if name in SDSSV_COLUMNS]
    identifiers = ("catalogid", "rsid", *(typical if len(typical) > 3 else ()))
    groups = (identifiers, ("fibertype", "fiber_type", "instrument"), ("cadence", "category", "carton", "cartonname"))
    marks = [next((lower[name] for name in group if name in lower), None) for group in groups]
    # rfpsurvey writes priorities with the sign that it uses, and names the identifiers id or target_id
    if "priority" not in lower or None in marks or lower.keys() & {"id", "target_id"}:
        return None
    offsets = ("delta_ra", "delta_dec")
    columns = {name: lower[name] for name in offsets} if lower.keys() >= {*offsets} else {}
    return SurveyFormat(f"{SDSSV} candidates", {"priority": f"-{lower['priority']}"} | columns, marks=tuple(marks))


def _pfs(lower: dict) -> SurveyFormat | None:
    """Return the format of target lists of PFS, in which 0 is the highest priority and visits follow from times."""
    lower = {name if name == "ob_code" else name.removeprefix("ob_"): column for name, column in lower.items()}
    if not lower.keys() >= {"ob_code", "priority", "exptime"} or lower.keys() & {"id", "target_id"}:
        return None
    marks = tuple(lower[name] for name in ("ob_code", "exptime", "single_exptime", "resolution") if name in lower)
    columns = {"priority": f"-{lower['priority']}", "visits": lower["exptime"]}
    names = {"ra": "ra", "dec": "dec", "pmra": "pmra", "pmdec": "pmdec", "epoch": "epoch", "id": "obj_id"}
    columns |= {role: lower[name] for role, name in names.items() if lower.get(name, "").lower().startswith("ob_")}
    columns |= {} if lower.keys() & {"obj_id", "objid"} else {"id": lower["ob_code"]}
    times = not lower.keys() & {"visits", "n_visits", "nvisits"}  # added by the user
    if not times:
        del columns["visits"]
    single, mode = lower.get("single_exptime", ""), lower.get("resolution", "")
    return SurveyFormat("PFS targets", columns, marks=marks, times=times, exposure=single, mode=mode)


def survey_of_north(statement: str) -> str:
    """Return the survey whose format begins a statement, if it measures position angles from the north of date."""
    return SDSSV if statement.startswith(SDSSV) else ""


def visits_of_times(table: Table, name: str, exposure: str) -> tuple[np.ndarray, str]:
    """Return the numbers of visits of the targets of PFS, and a remark on the time of one exposure.

    The number is the exposure time of the target over the time of one exposure (900 s if missing), rounded up.
    """
    total = _times(table[name], name)
    single = _times(table[exposure], exposure, EXPOSURE.value) if exposure else EXPOSURE.value
    # 1.1 h / 0.1 h is slightly more than 11 in floating-point arithmetic
    return np.ceil(total / single * (1 - 1e-9)), f" (divided by {exposure or EXPOSURE}, rounded up)"


def _times(column, name: str, missing: float = np.nan) -> np.ndarray:
    """Return the times in a column in seconds, or ``missing``; raise an error if a time is not a positive number."""
    unit = getattr(column, "unit", None) or u.s
    try:
        values = np.ma.filled(np.ma.asarray(getattr(column, "value", column)).astype(float), np.nan) * unit.to(u.s)
    except (TypeError, ValueError):
        raise InputError(f"column {name!r} must hold exposure times in seconds, got text or the unit {unit}") from None
    values = np.where(np.isnan(values), missing, values)
    if (wrong := ~(np.isfinite(values) & (values > 0))).any():
        raise InputError(f"column {name!r} must hold positive exposure times, got other values in {rows_of(wrong)}")
    return values


def check_mode(table: Table, name: str, option: str) -> None:
    """Raise an error if the targets or pointings of a table need different modes of the spectrographs."""
    modes, counts = np.unique(to_labels(table[name], f"column {name!r}").astype(str), return_counts=True)
    if len(modes) > 1:
        got = listed(f"{mode or 'no value'} ({n})" for mode, n in zip(modes.tolist(), counts.tolist(), strict=True))
        raise InputError(
            f"column {name!r} must have one value in all rows, because different values cannot share an exposure, got "
            f"{got}; plan them one after the other, for example with select={{{name!r}: {str(modes[-1])!r}}} or --set "
            f"{option}.select.{name}={modes[-1]}"
        )


def shifted(coord: SkyCoord, offsets: list[u.Quantity]) -> tuple[SkyCoord, int]:
    """Return the positions of the fibers of targets of SDSS-V, and the number of targets with an offset.

    The offsets are angles on the sky toward east and north (robostrategy).
    """
    east, north = (np.where(np.abs(offset) <= MOST_OFFSET, offset, 0 * u.arcsec) for offset in offsets)
    large = np.any([(np.abs(d) > MOST_OFFSET) & ~np.isin(d.value.round(2), NO_OFFSET) for d in offsets], axis=0)
    if large.any():
        text = f"delta_ra and delta_dec must be at most {MOST_OFFSET:g}, got larger values in {rows_of(large)}"
        warn(f"{text}, which are not added to the positions")
    n = np.count_nonzero((east != 0) | (north != 0))
    if not n:
        return coord, 0
    icrs = coord.icrs
    motion = {name: getattr(icrs, name) for name in ("pm_ra_cosdec", "pm_dec") if "s" in icrs.data.differentials}
    moved = SkyCoord(icrs.ra, icrs.dec).spherical_offsets_by(east, north)
    return SkyCoord(moved.ra, moved.dec, **motion), n


def is_unusable(bits: np.ndarray) -> np.ndarray:
    """Return whether each position is unusable, because it is a bad sky position or close to a bright object."""
    return (bits & UNUSABLE) != 0


def kinds_and_visits(bits: np.ndarray, stars: np.ndarray, visits: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the kind and the requested number of visits of targets of DESI.

    ``bits`` and ``stars`` are the columns ``DESI_TARGET`` and ``MWS_TARGET``. A standard star without requested visits
    as a science target is only a standard star. No visits of unusable positions are requested.
    """
    visits = np.ones(len(bits)) if visits is None else visits
    standard, wanted = ((bits | stars) & STANDARD) != 0, ((bits & SCIENCE) != 0) & (visits > 0)
    unusable, has_both = is_unusable(bits), standard & wanted
    kind = np.where(standard & ~wanted, "standard", np.where((bits & SKY) != 0, "sky", "science"))
    kind = np.where(has_both, "science+standard", kind) if has_both.any() else kind
    kind[unusable] = "science"
    return kind, np.where(unusable, 0, np.where(has_role(kind, "science"), visits, 1))
