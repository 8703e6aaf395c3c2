"""Who observes what: a table of methods behind `allocate`."""

from rfpsurvey.allocation._allocate import METHODS, Allocation, allocate

__all__ = ["METHODS", "Allocation", "allocate"]
