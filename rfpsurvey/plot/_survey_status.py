"""Plot of the status of a survey: tiles and visits by date, and the visits of each class of targets."""

import numpy as np
from astropy.table import QTable
from matplotlib.axes import Axes
from matplotlib.dates import ConciseDateFormatter, date2num
from matplotlib.ticker import MaxNLocator

from rfpsurvey.plot._axes import check_columns, legend_below, legend_line, new_grid
from rfpsurvey.plot._bars import by_name, class_label, stacked_bars
from rfpsurvey.plot._names import short_names
from rfpsurvey.plot._style import ARM, COLLISION, FADED, HATCH, MARKERS, PATROL, SERIES

PIECES = {
    "n_observed": ("observed", {"color": ARM}),
    "n_planned": ("planned", {"color": PATROL}),
    "n_not_assigned": ("in reach, not assigned", {"color": FADED, "alpha": 0.5}),
    "n_lost": ("lost to a collision", {"color": COLLISION, "hatch": HATCH}),
    "n_impossible": ("out of reach or excluded", {"color": "white", "edgecolor": "0.5"}),
}
"""Label and style of each part of the bars."""
MOST_ROWS, MOST_CLASSES = 16, 6


def plot_survey_status(status: QTable, *, axes: "np.ndarray | None" = None, **kwargs: object) -> np.ndarray:
    """Plot the observed tiles and visits by date, and the visits of each class of targets.

    Parameters
    ----------
    status : QTable
        Table of `rfpsurvey.survey.survey_status`.
    axes : array_like of matplotlib.axes.Axes, shape (2,), optional
        Axes to draw on; by default, a new figure is created.
    **kwargs
        Passed to ``Axes.barh`` for the bars of the classes, for example ``height``.

    Returns
    -------
    ndarray of matplotlib.axes.Axes, shape (2,)
        The axes: progress by date, and visits of each class.

    Raises
    ------
    InputError
        If the table is not a status of a survey.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> from tempfile import TemporaryDirectory
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=4000, rng=1)
    >>> with TemporaryDirectory() as folder:
    ...     survey = rs.plan_survey(sky, "desi", SkyCoord(["6h20m"], ["+23d"]), folder=f"{folder}/survey")
    ...     status = rs.survey.survey_status(survey, survey.state(sky))
    >>> rs.plot.plot_survey_status(status)[0].get_ylabel()
    'visits'
    """
    check_columns(status, {"priority", "n_requested", *PIECES}, "survey_status")
    axes = new_grid(1, 2, (13, 4.6))[1][0] if axes is None else np.asarray(axes)
    _draw_progress(axes[0], status)
    _draw_classes(axes[1], status, kwargs)
    return axes


def _draw_progress(ax: Axes, status: QTable) -> None:
    """Draw the numbers of observed visits and tiles up to each date."""
    progress = status.meta["progress"]
    dates = [one for one in progress["date"] if one]
    first = len(progress["date"]) - len(dates)
    x = date2num(np.array(dates, dtype="datetime64[D]")) if dates else np.array([])
    handles = []
    for k, (name, values) in enumerate(list(progress["n_observed"].items())[: 1 + MOST_CLASSES]):
        look = {"color": "k", "marker": "."} if k == 0 else {"ls": ":", "color": SERIES[(k - 1) % len(SERIES)]}
        look |= {} if k == 0 else {"marker": MARKERS[(k - 1) % len(MARKERS)], "markersize": 4}
        label = "all visits" if k == 0 else f"priority {name}"
        ax.plot(x, values[first:], **look)
        handles.append(legend_line(label, **look))
    tiles = ax.twinx()
    tiles.step(x, progress["n_tiles"][first:], where="post", color="0.6", zorder=0)
    handles.append(legend_line("tiles (right axis)", color="0.6"))
    total = sum(n for one in status.meta["tiles"] for state, n in one.items() if state not in ("pass", "dropped"))
    tiles.set(ylim=(0, 1.03 * max(total, 1)), ylabel="tiles")
    tiles.yaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set(ylim=(0, 1.03 * max(int(status["n_requested"][0]), 1)), ylabel="visits", xlabel="date")
    if not dates:
        ax.set_xticks([])
        ax.annotate("no observation with a date", (0.5, 0.5), xycoords="axes fraction", ha="center", color="0.4")
    else:
        locator = MaxNLocator(6, integer=True)  # whole days
        ax.xaxis.set_major_locator(locator)
        ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))
        ax.set_xlim(x[0] - 1, x[-1] + 1)
    legend_below(ax, handles, columns=4)


def _draw_classes(ax: Axes, status: QTable, kwargs: dict) -> None:
    """Draw a bar for each class: the fractions of its visits that are observed, planned, and neither."""
    rows = status[:MOST_ROWS]
    pieces = tuple((np.asarray(rows[name], float), *look) for name, look in PIECES.items())
    names, y = short_names([class_label(row) for row in by_name(rows)]), -np.arange(len(rows), dtype=float)
    stacked_bars(ax, y, np.asarray(rows["n_requested"]), pieces, names, np.asarray(rows["n_observed"]), kwargs)
    more = len(status) - len(rows)
    ax.set_xlabel("fraction of the requested visits" + (f"; {more} more classes not shown" if more else ""))
