"""Read tables, and TOML and JSON documents, of limited size; error messages are single sentences."""

from rfpsurvey._readers._archives import read_arrays
from rfpsurvey._readers._documents import check_size, parse_json, read_toml
from rfpsurvey._readers._fits import read_fits_bytes, read_fits_units
from rfpsurvey._readers._header import has_other_digits, is_number, parse_number
from rfpsurvey._readers._limits import (
    check_is_file,
    content_of,
    entries_of,
    head_of,
    is_present,
    open_file,
    reading,
    sentence,
)
from rfpsurvey._readers._parquet import import_parquet, read_parquet, table_of_arrow, unit_metadata
from rfpsurvey._readers._quantities import is_known, without_unit
from rfpsurvey._readers._table import FORMATS, META_KEY, read_table, read_tables, suffix_of, to_path

__all__ = [
    "FORMATS",
    "META_KEY",
    "check_is_file",
    "check_size",
    "content_of",
    "entries_of",
    "has_other_digits",
    "head_of",
    "import_parquet",
    "is_known",
    "is_number",
    "is_present",
    "open_file",
    "parse_json",
    "parse_number",
    "read_arrays",
    "read_fits_bytes",
    "read_fits_units",
    "read_parquet",
    "read_table",
    "read_tables",
    "read_toml",
    "reading",
    "sentence",
    "suffix_of",
    "table_of_arrow",
    "to_path",
    "unit_metadata",
    "without_unit",
]
