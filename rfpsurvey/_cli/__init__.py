"""The command line: parse, call the library, write."""

from rfpsurvey._cli import instruments, plan, score
from rfpsurvey._cli._app import app, main

__all__ = ["app", "instruments", "main", "plan", "score"]
