"""The commands of the command line, which parse options, call the library, and write the results."""

from rfpsurvey._cli import (
    benchmark,
    benchmark_probability,
    compare,
    compare_allocators,
    convert,
    design,
    instruments,
    plan,
    probability,
    reproduce,
    score,
    select,
    survey,
    tile,
)
from rfpsurvey._cli._app import app, main

__all__ = [
    "app",
    "benchmark",
    "benchmark_probability",
    "compare",
    "compare_allocators",
    "convert",
    "design",
    "instruments",
    "main",
    "plan",
    "probability",
    "reproduce",
    "score",
    "select",
    "survey",
    "tile",
]
