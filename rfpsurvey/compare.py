"""Compare several allocators on the same field, or several instruments with comparable targets."""

from rfpsurvey._studies.compare_allocators import compare_allocators
from rfpsurvey._studies.compare_instruments import compare_instruments

__all__ = ["compare_allocators", "compare_instruments"]
