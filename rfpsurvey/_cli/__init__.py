"""The subcommands of the program ``rfpsurvey``, which parse options, call the library, and write the results."""

from rfpsurvey._cli.process import main
from rfpsurvey._common.lazy import importer

__all__ = ["app", "main"]

__getattr__ = importer(__name__, {"application": ("app",)})  # an interrupt during these imports has a message
