"""Benchmarks, which measure the speed and the errors of the methods of this package."""

from rfpsurvey.benchmark._collisions import benchmark_batches, benchmark_collisions
from rfpsurvey.benchmark._common import random_tips
from rfpsurvey.benchmark._probability import benchmark_densities, benchmark_probability

__all__ = [
    "benchmark_batches",
    "benchmark_collisions",
    "benchmark_densities",
    "benchmark_probability",
    "random_tips",
]
