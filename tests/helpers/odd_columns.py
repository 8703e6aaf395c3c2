"""Names, contents and units of columns that users keep, and that files of some formats cannot contain."""

import astropy.units as u
import numpy as np
from astropy.table import MaskedColumn

MINE = u.def_unit("counts_of_mine")
TEXTS = {
    "line break": ["a\nb", 'a\n"b,c'],
    "carriage return": ["a\rb", "a\r\nb"],
    "NUL": ["a\0b", "a\0c"],
    "bell and delete": ["a\x07", "b\x7f"],
    "form feed": ["a\x0cb", "a\x0bb"],
    "tab": ["a\tb", "\tb"],
    "line separator": ["\u2028", "a"],
    "next line": ["a\x85b", "a\x1cb"],
    "blanks at both ends": [" a", "b  "],
    "only blanks": ["   ", "b"],
    "blanks inside": ["a  b", "a b"],
    "wide blanks": ["\u2003a", "a\xa0b"],
    "empty": ["", "nan"],
    "all empty": ["", ""],
    "accents": ["é", "ü"],
    "beyond the basic plane": ["\U0001f52d", "\u202eb"],
    "half of a pair": ["\ud800", "b"],
    "words for missing values": ["--", "None"],
    "words for booleans": ["True", "False"],
    "numbers as text": ["007", "1e3"],
    "quotes": ["'", '"'],
    "doubled quotes": ['""', '"a"'],
    "commas": ["a,b", ",,"],
    "comments": ["#a", "# b"],
    "slashes and percent": ["a\\nb", "%s/&"],
    "YAML": ["{a: 1}", "- !!python/object"],
    "long text": ["a" * 3000, "b"],
    "bytes": np.array([b"ab", b"c"]),
    "bytes in UTF-8": np.array(["é".encode(), b"c"]),
    "bytes in no encoding": np.array([b"ab\xff", b"c"]),
    "objects of text": np.array(["a\nb", None], dtype=object),
    "masked text": MaskedColumn(["a", "b"], mask=[True, False]),
}
NUMBERS = {
    "longdouble": np.array([1, 1 + 2**-60], dtype=np.longdouble),
    "half": np.array([1, 2], dtype=np.float16),
    "largest": np.array([1.7e308, 5e-324]),
    "not finite": np.array([np.nan, -np.inf]),
    "bytes of numbers": np.array([1, 255], dtype=np.uint8),
    "large integers": np.array([2**62 + 1, -(2**62) - 1]),
    "unsigned": np.array([1, 2**63 - 1], dtype=np.uint64),
    "booleans": np.array([True, False]),
    "masked": MaskedColumn([1, 2], mask=[True, False]),
    "all masked": MaskedColumn([1.5, 2], mask=[True, True]),
    "objects of numbers": np.array([1, 2.5], dtype=object),
    "big-endian": np.array([1, 2], dtype=">i2"),
    "integers with a unit": np.array([1, 2]) * u.one * u.mm,
    "unit of the user": [1, 2] * MINE,
    "unit with a factor": [1, 2] * u.Unit("3.7e-5 erg / (s cm2 Angstrom)"),
    "magnitudes": [1, 2] * u.mag,
    "logarithmic": u.Magnitude([1, 2] * u.ABmag),
    "nanomaggies": [1, 2] * u.Unit(u.nmgy) ** -2,
    "percent": [1, 2] * u.percent,
}
NAMES = ["", " ", " a", "a ", "a b,#'\"", "UPPER" * 60, "a\nb", "a\0b", "é", "unit", "value", "name", "meta", "TFORM1"]
NAMES += ["1", "status", "ID", "__serialized_columns__", "%", "a.b", "mask", "info", "\u2028", "data", "shape"]

COLUMNS = {name: (name.replace(" ", "_"), column) for name, column in (TEXTS | NUMBERS).items()}
COLUMNS |= {f"the name {name[:20]!r}": (name, [1, 2]) for name in NAMES}
COLUMNS["a quantity with the name unit"] = "unit", [1.0, 2.0] * u.Unit("erg / (s cm2 Angstrom)")
"""For each description, the name of a column and its values in two rows."""
