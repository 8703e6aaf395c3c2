"""How results look in a notebook."""

from html import escape

__all__ = ["to_html"]


def to_html(result: object, facts: dict, table: object = None) -> str:
    """Return HTML of a result: its short text, a list of facts, and the first rows of a table.

    Parameters
    ----------
    result : object
        The result; its ``repr`` is the heading.
    facts : dict
        Names and values; what is no number or short text is left out.
    table : QTable, optional
        The table to show.

    Returns
    -------
    str
        HTML.
    """
    rows = "".join(
        f"<tr><th>{escape(str(name))}</th><td>{escape(_text(value))}</td></tr>"
        for name, value in facts.items()
        if isinstance(value, int | float | str) and len(str(value)) < 200
    )
    shown = "" if table is None else f"<div>{table._repr_html_()}</div>"
    return f"<p>{escape(repr(result).strip('<>'))}</p><table>{rows}</table>{shown}"


def _text(value) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
