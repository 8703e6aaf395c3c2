"""Benchmarks, which measure the speed and the errors of the methods of this package."""

from rfpsurvey._studies.benchmark_collisions import benchmark_batches, benchmark_collisions
from rfpsurvey._studies.benchmark_probability import benchmark_densities, benchmark_probability

__all__ = ["benchmark_batches", "benchmark_collisions", "benchmark_densities", "benchmark_probability"]
