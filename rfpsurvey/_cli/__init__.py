"""The subcommands of the program ``rfpsurvey``, which parse options, call the library, and write the results."""

from rfpsurvey._cli._main import app, main

__all__ = ["app", "main"]
