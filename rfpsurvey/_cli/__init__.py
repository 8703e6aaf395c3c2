"""The command line: parse, call the library, write."""

from rfpsurvey._cli import benchmark, instruments, plan, score
from rfpsurvey._cli._app import app, main

__all__ = ["app", "benchmark", "instruments", "main", "plan", "score"]
