"""Allocation of targets to positioners: `allocate`, its options and results, and the built-in allocators."""

from typing import TYPE_CHECKING

from rfpsurvey._lazy import importer
from rfpsurvey.allocation._allocate import allocate, assign
from rfpsurvey.allocation._allocation import Allocation
from rfpsurvey.allocation._answer import AllocationAnswer, Level
from rfpsurvey.allocation._clock import end_on_interrupt
from rfpsurvey.allocation._constraints import recorded_constraints
from rfpsurvey.allocation._options import AllocationOptions, as_options
from rfpsurvey.allocation._plugin import packages
from rfpsurvey.allocation._problem import AllocationProblem, TargetColumns
from rfpsurvey.allocation._reasons import IDLE_REASONS, IdleReason, IdleReasons, find_idle_reasons
from rfpsurvey.allocation._subpriority import id_numbers, service_order, subpriorities, tie_order, to_subpriorities
from rfpsurvey.allocation._uses import ALLOCATORS, OPTIONS, given_options, warn_of_parked, warn_of_unused_options
from rfpsurvey.constraints import KINDS, Requirement, Shortfall, as_requirements, hint_of_name, sentences

if TYPE_CHECKING:
    from rfpsurvey.allocation._weighted import (
        GivenPlan,
        ListCandidates,
        RowPrices,
        TileCandidates,
        WeightedProblem,
        solve_weighted,
    )

__all__ = [
    "ALLOCATORS",
    "IDLE_REASONS",
    "KINDS",
    "OPTIONS",
    "Allocation",
    "AllocationAnswer",
    "AllocationOptions",
    "AllocationProblem",
    "GivenPlan",
    "IdleReason",
    "IdleReasons",
    "Level",
    "ListCandidates",
    "Requirement",
    "RowPrices",
    "Shortfall",
    "TargetColumns",
    "TileCandidates",
    "WeightedProblem",
    "allocate",
    "as_options",
    "as_requirements",
    "assign",
    "end_on_interrupt",
    "find_idle_reasons",
    "given_options",
    "hint_of_name",
    "id_numbers",
    "packages",
    "recorded_constraints",
    "sentences",
    "service_order",
    "solve_weighted",
    "subpriorities",
    "tie_order",
    "to_subpriorities",
    "warn_of_parked",
    "warn_of_unused_options",
]

_IMPORTED_ON_USE = {
    "_weighted": (
        "GivenPlan",
        "ListCandidates",
        "RowPrices",
        "TileCandidates",
        "WeightedProblem",
        "solve_weighted",
    )
}
__getattr__ = importer(__name__, _IMPORTED_ON_USE)
