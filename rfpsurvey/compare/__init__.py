"""Comparisons of several allocators, or of several instruments, on the same sky."""

from rfpsurvey.compare._allocators import compare_allocators
from rfpsurvey.compare._instruments import PARTS, compare_instruments, parts_of

__all__ = ["PARTS", "compare_allocators", "compare_instruments", "parts_of"]
