"""Catalogs of targets, which are read from files, converted from tables, or synthetic."""

from rfpsurvey._sky.arrays import CatalogArrays
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.partitions import PartitionedCatalog, partition_catalog
from rfpsurvey._sky.synthetic import example_catalog, synthetic_catalog

__all__ = [
    "Catalog",
    "CatalogArrays",
    "PartitionedCatalog",
    "example_catalog",
    "partition_catalog",
    "synthetic_catalog",
]
