"""Validate the docstrings of all public names against the numpydoc standard; print what is wrong and exit with 1."""

import inspect
import sys
import tomllib
from pathlib import Path

from numpydoc.validate import validate

import rfpsurvey

CONFIG = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["tool"]["numpydoc_validation"]


def public_names():
    """Yield the dotted names of public objects and their public methods and properties."""
    for name in rfpsurvey.__all__:
        thing = getattr(rfpsurvey, name)
        if name.startswith("_") or (inspect.isclass(thing) and issubclass(thing, Exception)):
            continue
        yield f"rfpsurvey.{name}"
        if inspect.isclass(thing):
            for member, value in vars(thing).items():
                documented = callable(value) or isinstance(value, property | classmethod)
                if documented and not member.startswith("_"):
                    yield f"rfpsurvey.{name}.{member}"


if __name__ == "__main__":
    problems = [
        f"{name}: {code} {text}"
        for name in public_names()
        for code, text in validate(name)["errors"]
        if code in CONFIG["checks"]
    ]
    print("\n".join(problems) or "docstrings: all well")
    sys.exit(bool(problems))
