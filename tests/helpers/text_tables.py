"""Tables that tests write as text."""

from astropy.table import QTable

__all__ = ["text_table"]


def text_table(text, meta=None, **units):
    """Return the table of a text whose first line contains the names of the columns, some of which have units."""
    table = QTable.read(text.strip().splitlines(), format="ascii.basic")
    table.meta = meta or {}
    for name, unit in units.items():
        table[name] = table[name] * unit
    return table
