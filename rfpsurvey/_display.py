"""Representations of results in notebooks."""

from html import escape
from importlib import import_module

import astropy.units as u

DECIMALS = {u.deg: 6, u.mm: 4, u.arcsec: 3}


def to_html(result: object, facts: dict, table: object = None) -> str:
    """Return HTML that shows a result: a heading, properties of the result, and the first rows of a table.

    Parameters
    ----------
    result : object
        The result; its ``repr`` is the heading.
    facts : dict
        Names and values of properties of the result. Values that are not numbers or short text are omitted.
    table : QTable, optional
        Table whose first rows are shown.

    Returns
    -------
    str
        The HTML.
    """
    rows = "".join(
        f"<tr><th>{escape(str(name))}</th><td>{escape(_text(value))}</td></tr>"
        for name, value in facts.items()
        if isinstance(value, int | float | str) and len(str(value)) < 200
    )
    shown = "" if table is None else f"<div>{rounded(table)._repr_html_()}</div>"
    return f"<p>{escape(repr(result).strip('<>'))}</p><table>{rows}</table>{shown}"


def show(result: object, **options: object) -> object:
    """Return the interactive view of a result for a notebook.

    The subpackage ``report`` imports the classes of results. To avoid a circular import, this function imports
    ``report`` only when it is called.

    Parameters
    ----------
    result : object
        The result, such as a tile or a survey.
    **options
        Passed to ``rfpsurvey.report.notebook_view``.

    Returns
    -------
    object
        An object with the HTML of the view.
    """
    return import_module("rfpsurvey.report").notebook_view(result, **options)


def plot(function: str, result: object, **options: object) -> object:
    """Draw a result with a function of the subpackage ``plot``, which is imported only when it is needed.

    Parameters
    ----------
    function : str
        Name of the function, such as ``plot_tiling``.
    result : object
        The result, such as a tile or a survey.
    **options
        Passed to the function.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.
    """
    return getattr(import_module("rfpsurvey.plot"), function)(result, **options)


def rounded(table: object) -> object:
    """Return a copy of a table that is displayed with few digits; the values are not rounded."""
    table = table.copy(copy_data=False)
    for column in table.itercols():
        if getattr(column.dtype, "kind", "") == "f":
            column.info.format = f".{DECIMALS[column.unit]}f" if getattr(column, "unit", None) in DECIMALS else ".4g"
    return table


def _text(value) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
