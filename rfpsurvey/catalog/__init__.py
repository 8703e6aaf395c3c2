"""Targets: real catalogs from files and tables, and synthetic ones."""

from rfpsurvey.catalog._catalog import Catalog
from rfpsurvey.catalog._columns import Finder
from rfpsurvey.catalog._synthetic import synthetic_catalog

__all__ = ["Catalog", "Finder", "synthetic_catalog"]
