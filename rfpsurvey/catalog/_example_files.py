"""Find and read the files of the catalogs that come with the package."""

import os
from pathlib import Path

from astropy.table import QTable

from rfpsurvey import _io
from rfpsurvey.catalog._packed import unpack
from rfpsurvey.errors import InputError, check_choice

PREFIX = "example:"
EXAMPLES = {"anticenter": "tycho2_anticenter_r5.ecsv"}
# The first folder is in the wheel, where data/wheel.py writes it. The second folder is in the source tree.
_PLACES = ((Path(__file__).parent / "examples", ".packed"), (Path(__file__).parents[2] / "data", ".gz"))


def is_example(path: object) -> bool:
    """Return whether ``path`` is the name of an example catalog, such as "example:anticenter"."""
    return isinstance(path, str | os.PathLike) and os.fspath(path)[: len(PREFIX)] == PREFIX


def path_and_name(path: str | os.PathLike) -> tuple[Path, str]:
    """Return the path of a file or of an example catalog, and the name that results record in their provenance."""
    if not is_example(path):
        path = _io.to_path(path)
        return path, path.name
    name = os.fspath(path)
    file = EXAMPLES[check_choice(name.removeprefix(PREFIX), EXAMPLES, "example catalog")]
    paths = [folder / f"{file}{ending}" for folder, ending in _PLACES]
    found = next((path for path in paths if path.exists()), None)
    if found is None:
        raise InputError(f"the installation must contain {paths[0]}, but the file is missing: install rfpsurvey again")
    return found, name


def read_table(path: Path, hdu: int | str | None = None) -> QTable:
    """Read the table of a catalog from a file, which may be a compressed example catalog (``.packed``)."""
    if path.suffix != ".packed":
        return _io.read_table(path, hdu, "; to read another table, give hdu= or --set catalog.hdu=NAME", padded=False)
    if hdu is not None:
        raise InputError(f"hdu must be used only with FITS files, got {hdu!r} for an example catalog")
    return QTable.read(unpack(path.read_bytes()).splitlines(), format="ascii.ecsv")
