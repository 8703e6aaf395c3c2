"""Instruments, each with a focal plane, optics and the sources of all values; presets are data files."""

from rfpsurvey.instrument._compare_projections import ProjectionComparison, choose_projection, compare_projections
from rfpsurvey.instrument._desi_tables import MOST_DEVICE, N_PETALS, impossible_sentence
from rfpsurvey.instrument._facts import arm_classes, arm_facts, fact_texts
from rfpsurvey.instrument._instrument import (
    Instrument,
    as_focal_plane,
    as_instrument,
    available_instruments,
    every_instrument,
)
from rfpsurvey.instrument._pfs_files import PFI_ANGLE, pfs_engineering_fibers, pfs_fibers
from rfpsurvey.instrument._states import describe_states

__all__ = [
    "MOST_DEVICE",
    "N_PETALS",
    "PFI_ANGLE",
    "Instrument",
    "ProjectionComparison",
    "arm_classes",
    "arm_facts",
    "as_focal_plane",
    "as_instrument",
    "available_instruments",
    "choose_projection",
    "compare_projections",
    "describe_states",
    "every_instrument",
    "fact_texts",
    "impossible_sentence",
    "pfs_engineering_fibers",
    "pfs_fibers",
]
