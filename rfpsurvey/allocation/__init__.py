"""Allocation of targets to positioners: `allocate`, its options and results, and the built-in allocators."""

from typing import TYPE_CHECKING

from rfpsurvey._lazy import importer
from rfpsurvey.allocation._allocate import TargetColumns, allocate, assign
from rfpsurvey.allocation._allocation import Allocation
from rfpsurvey.allocation._answer import AllocationAnswer, Level
from rfpsurvey.allocation._clock import end_on_interrupt
from rfpsurvey.allocation._constraints import recorded_constraints
from rfpsurvey.allocation._methods import DEFAULT_ALLOCATOR, METHODS, OPTIONS, Allocator, name_of_best
from rfpsurvey.allocation._options import AllocationOptions, as_options
from rfpsurvey.allocation._plugin import packages
from rfpsurvey.allocation._problem import AllocationProblem
from rfpsurvey.allocation._reasons import IDLE_REASONS, IdleReason, IdleReasons, find_idle_reasons
from rfpsurvey.allocation._rules import RuleProblem
from rfpsurvey.allocation._subpriority import (
    id_numbers,
    service_order,
    subpriorities,
    subpriorities_of,
    tie_order,
    to_subpriorities,
)
from rfpsurvey.allocation._uses import warn_of_lacks, warn_of_parked, warn_of_unused_options
from rfpsurvey.constraints import KINDS, Requirement, Shortfall

if TYPE_CHECKING:
    from rfpsurvey.allocation._weighted import (
        GivenPlan,
        ListCandidates,
        RowPrices,
        TileCandidates,
        WeightedProblem,
        no_rules,
        solve_weighted,
    )

__all__ = [
    "DEFAULT_ALLOCATOR",
    "IDLE_REASONS",
    "KINDS",
    "METHODS",
    "OPTIONS",
    "Allocation",
    "AllocationAnswer",
    "AllocationOptions",
    "AllocationProblem",
    "Allocator",
    "GivenPlan",
    "IdleReason",
    "IdleReasons",
    "Level",
    "ListCandidates",
    "Requirement",
    "RowPrices",
    "RuleProblem",
    "Shortfall",
    "TargetColumns",
    "TileCandidates",
    "WeightedProblem",
    "allocate",
    "as_options",
    "assign",
    "end_on_interrupt",
    "find_idle_reasons",
    "id_numbers",
    "name_of_best",
    "no_rules",
    "packages",
    "recorded_constraints",
    "service_order",
    "solve_weighted",
    "subpriorities",
    "subpriorities_of",
    "tie_order",
    "to_subpriorities",
    "warn_of_lacks",
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
        "no_rules",
        "solve_weighted",
    ),
}
__getattr__ = importer(__name__, _IMPORTED_ON_USE)
