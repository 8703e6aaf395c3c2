"""Instruments, each with a focal plane, optics and the sources of all values; presets are data files."""

from rfpsurvey._instruments.compare_projections import ProjectionComparison, compare_projections
from rfpsurvey._instruments.instrument import Instrument, available_instruments

__all__ = ["Instrument", "ProjectionComparison", "available_instruments", "compare_projections"]
