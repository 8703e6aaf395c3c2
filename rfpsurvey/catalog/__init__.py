"""Catalogs of targets, read from files and tables or synthetic."""

from rfpsurvey.catalog._arrays import CatalogArrays
from rfpsurvey.catalog._catalog import Catalog
from rfpsurvey.catalog._columns import UNITS, Finder
from rfpsurvey.catalog._extra import RESERVED
from rfpsurvey.catalog._frames import as_table, is_table
from rfpsurvey.catalog._index import SkyIndex, half_chord_squared
from rfpsurvey.catalog._partitions import PartitionedCatalog, as_catalog, partition_catalog
from rfpsurvey.catalog._synthetic import synthetic_catalog
from rfpsurvey.catalog._time import to_time

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
    "half_chord_squared",
    "is_table",
    "partition_catalog",
    "synthetic_catalog",
    "to_time",
]
