"""Histogram of selection probabilities."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from rfpsurvey.errors import InputTypeError, number_of
from rfpsurvey.plot._axes import legend_below, new_axes
from rfpsurvey.plot._style import LEVELS, OUTLINE
from rfpsurvey.selection import SelectionProbabilities

N_BINS = 20


def plot_selection(found: SelectionProbabilities, *, ax: Axes | None = None, **kwargs: object) -> Axes:
    """Plot a histogram of the probabilities with which the targets of a survey are observed.

    The colors of the bars show the number of tiles in which at least one positioner reaches the target. Targets that no
    tile reaches are not drawn.

    Parameters
    ----------
    found : SelectionProbabilities
        Selection probabilities to plot.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default, a new figure is created.
    **kwargs
        Passed to ``Axes.bar``, for example ``linewidth``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes. The title states the numbers of targets that all realizations and that no realization observed.

    Raises
    ------
    InputError
        If ``found`` does not contain selection probabilities.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=4000, rng=1)
    >>> found = rs.selection_probabilities(sky, "desi", SkyCoord(["6h20m"], ["+23d"]), n_realizations=64)
    >>> rs.plot.plot_selection(found).get_xlabel()
    'selection probability'
    """
    if not isinstance(found, SelectionProbabilities):
        raise InputTypeError(f"found must be SelectionProbabilities, got {type(found).__name__}")
    ax = new_axes(7, 4.5) if ax is None else ax
    asked = (found.requested > 0) & ~found.unreachable
    bins = np.minimum((found.probability[asked] * N_BINS).astype(int), N_BINS - 1)
    level = np.minimum(found.n_tiles[asked], len(LEVELS) - 1).astype(int)
    x, below, handles = (np.arange(N_BINS) + 0.5) / N_BINS, np.zeros(N_BINS), []
    for k in np.unique(level).tolist():
        number = np.bincount(bins[level == k], minlength=N_BINS)
        label = f"{k} or more tiles" if k == len(LEVELS) - 1 else number_of(k, "tile")
        style = {"color": LEVELS[k], "edgecolor": OUTLINE, "linewidth": 0.5, **kwargs}
        ax.bar(x, number, 1 / N_BINS, bottom=below, **style)
        handles.append(Patch(facecolor=LEVELS[k], edgecolor=OUTLINE, linewidth=0.5, label=f"{label}: {number.sum()}"))
        below += number
    s = found.summary
    title = f"{number_of(s['n_targets'], 'target')}, {number_of(s['n_realizations'], 'realization')}: "
    title += f"{s['n_always_observed']} always observed, {s['n_never_observed']} never"
    title += f" ({s['n_unreachable']} in reach of no tile, not drawn)" if s["n_unreachable"] else ""
    ax.set(
        xlim=(0, 1), ylim=(0, 1.05 * max(below.max(), 1)), xlabel="selection probability", ylabel="number of targets"
    )
    ax.set_title(title, fontsize="small")
    legend_below(ax, handles, title="number of tiles that reach the target", title_fontsize="small")
    return ax
