"""Completeness of a survey as a function of the number of tiles."""

import numpy as np
from astropy.coordinates import SkyCoord
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from rfpsurvey.errors import InputTypeError
from rfpsurvey.plot._axes import new_axes
from rfpsurvey.plot._sky import plot_tiling, radius_of
from rfpsurvey.plot._sky_map import is_wide
from rfpsurvey.plot._style import MARKERS, SERIES
from rfpsurvey.survey import Survey


def plot_completeness(survey: Survey, *, ax: Axes | None = None, **kwargs: object) -> Axes:
    """Plot the completeness of a survey against the number of tiles, with a marker for each priority after each pass.

    Parameters
    ----------
    survey : Survey
        Survey to plot.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on; by default, a new figure is created.
    **kwargs
        Passed to ``Axes.plot`` for the line of all visits, for example ``linewidth``.

    Returns
    -------
    matplotlib.axes.Axes
        The axes.

    Raises
    ------
    InputError
        If ``survey`` is not a survey.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("poisson", SkyCoord("6h20m +23d"), 1 * u.deg, density=500 / u.deg**2, rng=1)
    >>> survey = rs.plan_survey(sky, "moons", SkyCoord([94.9, 95.1] * u.deg, [23, 23] * u.deg))
    >>> rs.plot.plot_completeness(survey).get_xlabel()
    'tiles'
    """
    if not isinstance(survey, Survey):
        raise InputTypeError(f"survey must be a Survey, got {type(survey).__name__}")
    ax = new_axes(7, 4.5) if ax is None else ax
    tiles, after = survey.tiles, survey.completeness
    if "category" in after.colnames:
        after = after[after["category"] == "all"]
    order = np.lexsort((np.arange(len(tiles)), tiles["round"]))
    share = np.cumsum(tiles["n_observed"][order]) / max(survey.summary["n_visits_requested"], 1)
    ax.plot(np.arange(len(tiles) + 1), np.append(0, share), **{"color": "k", "label": "all visits", **kwargs})
    classes = [name for name in dict.fromkeys(after["priority"]) if name != "all"]
    for k, name in enumerate(classes):
        rows = after["priority"] == name
        style = {"color": SERIES[k % len(SERIES)], "marker": MARKERS[k % len(MARKERS)], "ls": ":", "clip_on": False}
        ax.plot(after["n_tiles"][rows], after["completeness"][rows], label=f"priority {name}", **style)
    every = after["priority"] == "all"
    complete = after["n_complete"][every] / np.maximum(after["n_targets"][every], 1)
    ax.plot(after["n_tiles"][every], complete, "kX", clip_on=False, label="fraction of complete targets")
    for number, end in zip(after["pass"][every], after["n_tiles"][every], strict=True):
        ax.axvline(end, color="0.8", lw=0.8, zorder=0)
        ax.annotate(
            f"pass {number}", (end, 0.01), rotation=90, ha="right", va="bottom", fontsize="x-small", color="0.4"
        )
    ax.set(xlim=(0, 1.03 * len(tiles)), ylim=(0, 1.02), xlabel="tiles", ylabel="completeness")
    ax.legend(fontsize="small", loc="best")
    return ax


def draw_survey(survey: Survey) -> Figure:
    """Return a figure with two panels: a map of the tiles, colored by completeness, and the completeness curve."""
    wide = is_wide(SkyCoord(survey.tiles["ra"], survey.tiles["dec"]), radius_of(survey))
    figure = Figure(figsize=(14, 4.8), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.15, h_pad=0.1)
    left, right = figure.add_gridspec(1, 2, width_ratios=(1.3, 1))
    plot_tiling(survey, ax=figure.add_subplot(left, projection="aitoff" if wide else None))
    plot_completeness(survey, ax=figure.add_subplot(right))
    return figure
