"""Read tables, and TOML and JSON documents, of limited size; error messages are single sentences."""

from rfpsurvey._readers._documents import check_size, parse_json, read_arrays, read_toml
from rfpsurvey._readers._fits import read_fits_bytes, read_fits_units
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
from rfpsurvey._readers._quantities import has_other_digits, is_known, is_number, parse_number, without_unit
from rfpsurvey._readers._table import (
    FORMATS,
    META_KEY,
    ZIPPED,
    has_ending,
    is_csv,
    is_fits,
    lacks_units,
    read_table,
    read_tables,
    suffix_of,
    to_path,
)
