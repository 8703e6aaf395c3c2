"""A Sphinx extension that links to the documentation of other packages, without the network.

Each file of ``docs/inventories`` has the name of a package. Its first line is the address of the documentation of the
package. Each other line contains a domain and role, a name, and the page of this name. When the documentation is built,
these files are converted to inventories of intersphinx.
"""

import re
import zlib
from pathlib import Path

FOLDER = Path(__file__).parent / "inventories"
# words in the types of docstrings that have no link
PLAIN = ("array", "callable", "generator", "numpy", "scalar", "string")


def read(path):
    """Return the address of the documentation of a package, and its names as a list of (role, name, page)."""
    address, *lines = path.read_text().splitlines()
    return address, [line.split() for line in lines]


def write_inventories(folder):
    """Write the inventories, and return the value of ``intersphinx_mapping``."""
    folder.mkdir(parents=True, exist_ok=True)
    mapping = {}
    for path in sorted(FOLDER.glob("*.txt")):
        address, entries = read(path)
        lines = "".join(f"{name} {role} 1 {page} -\n" for role, name, page in entries)
        head = f"# Sphinx inventory version 2\n# Project: {path.stem}\n# Version: \n"
        head += "# The remainder of this file is compressed using zlib.\n"
        inventory = folder / f"{path.stem}.inv"
        inventory.write_bytes(head.encode() + zlib.compress(lines.encode()))
        mapping[path.stem] = (address, str(inventory))
    return mapping


def linked_types():
    """Return the types in docstrings that become links: classes of other packages, and classes on the page ``api``."""
    aliases = {word: word for word in PLAIN}
    aliases |= {"bool": ":class:`python:bool`", "unit-like": ":term:`astropy:unit-like`"}
    for path in FOLDER.glob("*.txt"):
        for role, name, _ in read(path)[1]:
            if role == "py:class" and "." in name:
                aliases[name.split(".")[-1]] = f":class:`~{name}`"
                aliases[name] = f":class:`{name}`"
    own = re.findall(r"^    ((?:\w+\.)?([A-Z]\w+))$", (FOLDER.parent / "api.rst").read_text(), re.MULTILINE)
    return aliases | {short: f":class:`{short} <rfpsurvey.{name}>`" for name, short in own}
