"""Read TOML and JSON documents of limited size and depth."""

import json
import re
from pathlib import Path

from rfpsurvey._readers._limits import check_is_file, content_of, sentence, warn_of_open_end
from rfpsurvey.errors import InputError, short

MOST_TOML, MOST_JSON = 2**20, 2**24
MOST_DEPTH, MOST_VALUES = 32, 100_000
# Integers in TOML have 64 bits. Larger integers in other documents can be seeds, but must be representable as floats.
MOST_TOML_INTEGER, MOST_INTEGER = 2**63 - 1, 2**1000
# Matches the beginning of a key that has more than `MOST_DEPTH` parts, which are separated by dots. A match can begin
# only at the start of a word, so that the time of the search is proportional to the length of the text.
LONG_KEY = re.compile(rf"""(?<![\w"'-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){{{MOST_DEPTH}}}""")


def read_toml(path: Path) -> dict:
    """Return the content of a TOML file."""
    import tomllib

    check_is_file(path)
    content = content_of(path, most=MOST_TOML, kind="TOML")
    if content[-1:].isdigit():  # a document that ends within another value is not valid
        warn_of_open_end(path, content)
    try:
        text = content.decode("utf-8")
        long = LONG_KEY.search(text)
        if long:
            number = text.count("\n", 0, long.start()) + 1
            raise InputError(f"{path}: a key in line {number} must have at most {MOST_DEPTH} parts, got more")
        found = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: values must be nested at most {MOST_DEPTH} levels deep, got more") from None
    except InputError:
        raise
    except ValueError as error:  # the text is not UTF-8 or not TOML, or a number has too many digits
        raise InputError(f"{path} cannot be read as TOML: {sentence(error)}") from error
    check_size(found, path, most_integer=MOST_TOML_INTEGER)
    return found


def parse_json(text: object, what: object) -> dict:
    """Return the object in a JSON text; ``what`` describes the text in error messages."""
    if not isinstance(text, str):
        raise InputError(f"{what} must be an object in JSON, got {type(text).__name__}")
    if len(text) > MOST_JSON:
        raise InputError(f"{what} must have at most {MOST_JSON} characters, got {len(text)}")
    try:
        found = json.loads(text)
    except RecursionError:
        raise InputError(f"{what} must be nested at most {MOST_DEPTH} levels deep, got more") from None
    except ValueError as error:
        raise InputError(f"{what} must be an object in JSON: {sentence(error)}") from None
    if not isinstance(found, dict):
        raise InputError(f"{what} must be an object in JSON, got {type(found).__name__}")
    check_size(found, what)
    return found


def check_size(
    found: object, what: object, *, most_values: int = MOST_VALUES, most_integer: int = MOST_INTEGER
) -> None:
    """Raise an error if a document has too many values or nested levels, or an integer that is too large.

    A value that occurs twice counts twice.
    """
    todo, n = [(found, 0)], 0
    while todo:
        value, depth = todo.pop()
        inner = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ()
        n += len(inner)
        if depth > MOST_DEPTH:
            raise InputError(f"{what}: values must be nested at most {MOST_DEPTH} levels deep, got more")
        if n > most_values:
            raise InputError(f"{what}: there must be at most {most_values} values, got more")
        wide = next((child for child in inner if isinstance(child, int) and abs(child) > most_integer), None)
        if wide is not None:
            raise InputError(
                f"{what}: integers must be from {-most_integer:.4g} to {most_integer:.4g}, got {short(wide)}"
            )
        todo.extend((child, depth + 1) for child in inner if isinstance(child, dict | list | tuple))
