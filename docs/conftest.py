"""These files are scripts, not modules with doctests."""

collect_ignore = ["check_docstrings.py", "conf.py"]
