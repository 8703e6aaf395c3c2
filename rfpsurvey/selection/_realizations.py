"""The realizations of a survey: their seeds, and their division into blocks that are planned together."""

from dataclasses import dataclass, replace

import numpy as np

from rfpsurvey._kernels.realizations import MOST
from rfpsurvey.selection._rules import RULES
from rfpsurvey.survey import Request


def seeds_of(seed: int, n: int) -> list[int]:
    """Return the seeds of n realizations; if n is increased, the first seeds remain the same."""
    return [int(word) >> 1 for word in np.random.SeedSequence(seed).generate_state(n, np.uint64)]


def request_of(request: Request, seed: int) -> Request:
    """Return the request of the survey of one realization."""
    return replace(request, options=replace(request.options, subpriority=seed), seed=seed)


def in_batch(request: Request) -> bool:
    """Return whether all realizations of a block can be planned together."""
    options = request.options
    # the rules do not meet requirements, which some of the allocators with a rule ignore as well
    simple = options.sky_separation is None and not (options.counts and options.method.uses("requirements"))
    return isinstance(options.allocator, str) and options.allocator in RULES and simple


@dataclass(frozen=True)
class Block:
    """Realizations that are planned together.

    Parameters
    ----------
    number : int
        Number of the block.
    first, last : int
        Number of the first realization, and one more than the number of the last realization.
    """

    number: int
    first: int
    last: int

    def __len__(self):
        return self.last - self.first


def blocks_of(n: int, *, together: bool) -> list[Block]:
    """Divide n realizations into blocks, and return the blocks."""
    size = MOST if together else 1
    return [Block(k, first, min(first + size, n)) for k, first in enumerate(range(0, n, size))]
