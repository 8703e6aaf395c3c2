"""Allocation of targets to positioners: `allocate`, its options and results, and the built-in allocators."""

from rfpsurvey._assignment.allocate import allocate
from rfpsurvey._assignment.allocation import IDLE_REASONS, Allocation, IdleReasons, find_idle_reasons
from rfpsurvey._assignment.answer import AllocationAnswer, Level
from rfpsurvey._assignment.clock import end_on_interrupt
from rfpsurvey._assignment.methods import METHODS
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._assignment.problem import AllocationProblem
from rfpsurvey._assignment.rules import subpriorities

__all__ = [
    "IDLE_REASONS",
    "METHODS",
    "Allocation",
    "AllocationAnswer",
    "AllocationOptions",
    "AllocationProblem",
    "IdleReasons",
    "Level",
    "allocate",
    "end_on_interrupt",
    "find_idle_reasons",
    "subpriorities",
]
