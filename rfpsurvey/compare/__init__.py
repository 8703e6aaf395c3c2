"""Compare several allocators on the same field, or several instruments with comparable targets."""

from rfpsurvey.compare._allocators import compare_allocators
from rfpsurvey.compare._instruments import COMPARED, PARTS, compare_instruments, parts_of

__all__ = ["COMPARED", "PARTS", "compare_allocators", "compare_instruments", "parts_of"]
