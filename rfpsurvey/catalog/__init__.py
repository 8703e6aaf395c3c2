"""Catalogs of targets, which are read from files, converted from tables, or synthetic."""

from rfpsurvey.catalog._arrays import CatalogArrays
from rfpsurvey.catalog._catalog import Catalog
from rfpsurvey.catalog._columns import UNITS, Finder
from rfpsurvey.catalog._epoch import choose_epoch, epoch_text
from rfpsurvey.catalog._example_files import is_example
from rfpsurvey.catalog._examples import example_catalog
from rfpsurvey.catalog._extra import RESERVED
from rfpsurvey.catalog._frames import as_table, is_table, select_rows
from rfpsurvey.catalog._index import SkyIndex, half_chord_squared
from rfpsurvey.catalog._motion import move_vectors
from rfpsurvey.catalog._partitions import PartitionedCatalog, as_catalog, partition_catalog
from rfpsurvey.catalog._survey_formats import check_mode
from rfpsurvey.catalog._synthetic import synthetic_catalog
from rfpsurvey.catalog._tables import read_columns
from rfpsurvey.catalog._time import to_moment, to_time

__all__ = [
    "RESERVED",
    "UNITS",
    "Catalog",
    "CatalogArrays",
    "Finder",
    "PartitionedCatalog",
    "SkyIndex",
    "as_catalog",
    "as_table",
    "check_mode",
    "choose_epoch",
    "epoch_text",
    "example_catalog",
    "half_chord_squared",
    "is_example",
    "is_table",
    "move_vectors",
    "partition_catalog",
    "read_columns",
    "select_rows",
    "synthetic_catalog",
    "to_moment",
    "to_time",
]
