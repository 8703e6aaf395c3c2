"""Catalogs of targets, which are read from files, converted from tables, or synthetic."""

from rfpsurvey.catalog._arrays import CatalogArrays, SkyIndex, half_chord_squared
from rfpsurvey.catalog._catalog import Catalog
from rfpsurvey.catalog._columns import UNITS, Finder
from rfpsurvey.catalog._example_files import is_example
from rfpsurvey.catalog._extra import RESERVED
from rfpsurvey.catalog._frames import as_table, is_table, select_rows
from rfpsurvey.catalog._origin import EXACT, write_exactly
from rfpsurvey.catalog._partitions import PartitionedCatalog, as_catalog, partition_catalog
from rfpsurvey.catalog._survey_formats import check_mode, survey_of_north
from rfpsurvey.catalog._synthetic import example_catalog, synthetic_catalog
from rfpsurvey.catalog._tables import read_columns
from rfpsurvey.catalog._time import choose_epoch, epoch_text, move_vectors, to_moment, to_time

__all__ = [
    "Catalog",
    "CatalogArrays",
    "PartitionedCatalog",
    "example_catalog",
    "partition_catalog",
    "synthetic_catalog",
]
