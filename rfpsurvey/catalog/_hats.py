"""The properties files of HATS catalogs and collections."""

from pathlib import Path

from rfpsurvey._readers import content_of, is_present
from rfpsurvey.catalog._time import to_time
from rfpsurvey.errors import InputError, warn

PROPERTIES = ("hats.properties", "properties")
COLLECTION = "collection.properties"
MOST_PROPERTIES = 2**20
# Roles of columns that properties name, with the current name and the former name of each property.
NAMED = {
    "ra": ("hats_col_ra", "hats_col_j2000_ra"),
    "dec": ("hats_col_dec", "hats_col_j2000_dec"),
    "id": ("hats_cols_survey_id",),
}
NO_TARGETS = {
    "margin": "copies of the targets near the edges of the pixels",
    "association": "pairs of rows of two catalogs",
    "index": "an index of another catalog",
    "map": "values of pixels",
}


def main_table(folder: Path) -> tuple[Path, str]:
    """Return the folder of the main table of a HATS collection, and text that lists the other tables.

    If the folder is not a collection, the folder itself and empty text are returned.
    """
    path = folder / COLLECTION
    if not is_present(path) or any(is_present(folder / name) for name in PROPERTIES):
        return folder, ""
    found = _read(path)
    url = found.get("hats_primary_table_url", "")
    main = folder / url
    if not url or "://" in url or not main.is_dir():
        raise InputError(f"{path}: hats_primary_table_url must be the folder of the main table, got {url!r}")
    margins, indexes = found.get("all_margins", "").split(), found.get("all_indexes", "").split()[1::2]
    left = [f"margin {name}" for name in margins] + [f"index {name}" for name in indexes]
    return main, f"main table {url}" + (f"; not read: {', '.join(left)}" if left else "")


def properties_of(folder: Path, first: Path) -> dict[str, str]:
    """Return the properties of a catalog; raise an error if the catalog does not contain targets.

    ``folder`` is the folder of the catalog or its folder ``dataset``, and ``first`` is the path of a partition.
    """
    top = next(path.parent for path in first.parents if path.name.startswith("Norder="))
    places = [folder, top] + ([top.parent] if top.name == "dataset" else [])
    paths = (place / name for place in places for name in PROPERTIES)
    path = next((path for path in paths if is_present(path)), None)
    if path is None:
        return {}
    found = _read(path)
    kind, main = found.get("dataproduct_type", ""), found.get("hats_primary_table_url", "")
    if kind in NO_TARGETS:
        remedy = f"; open the main table, {main}" if main else ""
        raise InputError(f"{path}: dataproduct_type must be object, got {kind}, which means {NO_TARGETS[kind]}{remedy}")
    if kind == "source":
        warn(f"{path}: dataproduct_type is source: each detection of an object is planned as a separate target")
    frame = found.get("hats_frame", "equatorial")
    if frame.lower() not in ("equatorial", "icrs", ""):
        raise InputError(f"{path}: hats_frame must be equatorial, because pixels must be in ICRS, got {frame}")
    if "hats_coordinate_epoch" in found:
        to_time(found["hats_coordinate_epoch"], f"{path}: hats_coordinate_epoch")
    return found


def columns_and_rows(found: dict[str, str]) -> tuple[dict[str, str], str | None]:
    """Return the column of each role that the properties name, and the number of rows (None if it is not stated)."""
    columns = {role: next((found[name] for name in names if name in found), "") for role, names in NAMED.items()}
    return {role: name for role, name in columns.items() if len(name.split()) == 1}, found.get("hats_nrows")


def _read(path: Path) -> dict[str, str]:
    """Return the names and values in a properties file."""
    try:
        text = content_of(path, most=MOST_PROPERTIES).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} must be text in UTF-8, got the byte 0x{error.object[error.start]:02x}") from None
    lines = (line.partition("=") for line in text.splitlines() if not line.lstrip().startswith(("#", "!")))
    return {key.strip(): value.strip() for key, sign, value in lines if sign}
