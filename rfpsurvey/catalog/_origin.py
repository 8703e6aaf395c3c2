"""The origin of a catalog: how its file was read, or a file that contains exactly its columns."""

from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

from rfpsurvey._io import write_table
from rfpsurvey._units import to_plain
from rfpsurvey.catalog._example_files import is_example
from rfpsurvey.catalog._tables import PER_TARGET
from rfpsurvey.catalog._time import to_time

EXACT = "RFPSURVEY"
"""Name of the table in a file that `write_exactly` wrote, whose columns are read without any interpretation."""
NUMBERED, EXTRA = "row_id", "extra_"
"""Name of the column of identifiers that are row numbers, and beginning of the names of further columns."""


def write_exactly(catalog, path: Path, *, overwrite: bool = False) -> None:
    """Write a FITS file that `Catalog.read` reads with ``hdu=EXACT`` as an equal catalog."""
    icrs = catalog.coord.icrs
    table = QTable({NUMBERED if catalog.numbered else "id": catalog.id, "ra": icrs.ra.to(u.deg)})
    table["dec"] = icrs.dec.to(u.deg)
    if catalog.has_proper_motion:
        table["pmra"], table["pmdec"] = icrs.pm_ra_cosdec.to(u.mas / u.yr), icrs.pm_dec.to(u.mas / u.yr)
    if catalog.epoch is not None:
        table["ref_epoch"] = np.broadcast_to(catalog.epoch.jyear, len(catalog)) * u.yr
    for name in PER_TARGET[1:]:
        if (values := getattr(catalog, name)) is not None:
            table[name] = values
    for name in () if catalog.extra is None else catalog.extra.colnames:
        table[EXTRA + name] = catalog.extra[name]
    write_table(table, path, overwrite=overwrite, name=EXACT)


def exact_columns(table: Table) -> dict:
    """Return the arguments of `Catalog` for the table of a file that `write_exactly` wrote."""
    motion = {"pm_ra_cosdec": table["pmra"], "pm_dec": table["pmdec"]} if "pmra" in table.colnames else {}
    given = {"coord": SkyCoord(table["ra"], table["dec"], **motion), "numbered": NUMBERED in table.colnames}
    if "ref_epoch" in table.colnames and len(table):
        years = table["ref_epoch"].to_value(u.yr)
        given["epoch"] = to_time(years[0] if (years == years[0]).all() else years, "ref_epoch")
    given |= {name: to_plain(table[name]) for name in PER_TARGET if name in table.colnames}
    given |= {"id": to_plain(table[NUMBERED])} if given["numbered"] else {}
    extra = [name for name in table.colnames if name.startswith(EXTRA)]
    return given | ({"extra": {name.removeprefix(EXTRA): table[name] for name in extra}} if extra else {})


def origin_of(path: Path, name: str, given: dict) -> dict:
    """Return the arguments with which a file or a folder was read, as text and numbers, with the absolute path."""
    found = {key: value for key, value in given.items() if value and (key, value) != ("frame", "icrs")}
    if "units" in found:
        found["units"] = {role: str(unit) for role, unit in found["units"].items()}
    if "keep" in found:
        found["keep"] = [found["keep"]] if isinstance(found["keep"], str) else [*found["keep"]]
    return {"path": name if is_example(name) else str(path.resolve()), **found}
