"""Functions that several figures of the page on speed and accuracy use."""

import sys
from functools import cache
from itertools import pairwise, product

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from astropy.coordinates import SkyCoord
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from matplotlib.transforms import Bbox
from PIL import Image

import rfpsurvey as rs
from rfpsurvey._instruments.instrument import as_instrument

COLORS = ("#0072B2", "#D55E00", "#009E73", "#AA4499", "#000000", "#B8860B", "#6E6E6E")
SITES = {"lamost": "xinglong", "sdss_apo": "apache point", "moons": "paranal", "pfs": "mauna kea"}
# Directions in which a label can be placed next to its point.
SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1))


def start():
    """Return the instrument and its pitch; the first argument of the script names the instrument."""
    plt.rcParams.update({"font.size": 10, "axes.titlesize": 10, "axes.labelsize": 10, "xtick.labelsize": 10})
    plt.rcParams.update({"ytick.labelsize": 10, "legend.fontsize": 10})
    return make_instrument(*sys.argv[1:2] or ["sdss_apo"])


@cache
def make_instrument(name):
    """Return an instrument whose arms are segments, which the approximate methods need, and its pitch."""
    instrument = as_instrument(name)
    if instrument.focal_plane.positioner.outline is not None:
        instrument = instrument.with_arm_model("elbow_to_tip")
    return instrument, instrument.facts()["pitch"]


def simple_plane(instrument, pitch, *, rings, scale=1.0):
    """Return a small focal plane whose arms have the lengths of the instrument's arms, times a factor."""
    unit = instrument.focal_plane.positioner
    arms = rs.Positioner(scale * unit.central_arm, scale * unit.eccentric_arm, unit.min_separation / 2)
    return rs.FocalPlane.hexagonal(arms, rings=rings, pitch=pitch)


def finish(figure):
    """Write the figure to the file that the second argument of the script names, with a palette of colors."""
    if sys.argv[2:]:
        figure.set_dpi(120)
        figure.canvas.draw()
        image = Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB")
        image.quantize(128, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(sys.argv[2], optimize=True)


def conditions_at(name, altitude):
    """Return conditions with a field at an altitude (deg), and the center of the field, which can be at the zenith."""
    site, given = SITES.get(name, "kitt peak"), {"exposure_time": 15 * u.min}
    latitude = rs.ObservingConditions(site, hour_angle=0 * u.deg).site.lat.rad
    # with declination = latitude: sin(altitude) = sin(lat)^2 + cos(lat)^2 cos(hour angle)
    cosine = (np.sin(np.deg2rad(altitude)) - np.sin(latitude) ** 2) / np.cos(latitude) ** 2
    conditions = rs.ObservingConditions(site, hour_angle=np.arccos(cosine) * u.rad, **given)
    return conditions, SkyCoord(0 * u.deg, latitude * u.rad)


def tolerance(instrument):
    """Return the largest position error (um) that is negligible for the instrument; NaN if it is unknown."""
    found = rs.instrument.compare_projections(instrument, *conditions_at(instrument.name, 80)[::-1]).tolerance
    return np.nan if found is None else found.to_value(u.um)


def plain(value, _=None):
    """Return a number without an exponent, which would be too small to read."""
    return f"{value:,.10g}"


def percent(value, _=None):
    """Return a fraction as a percentage."""
    return f"{100 * value:.10g} %"


FACTOR = "max(p / true p, true p / p) - 1"
"""Label of axes with errors of probabilities."""


def excess(ratio):
    """Return how much the factor between an estimated and the true probability exceeds 1, given their ratio.

    For small errors, this is the relative error. Unlike the relative error, it has no upper limit if the estimate is
    too small.
    """
    return max(ratio, 1 / ratio) - 1


def point_down(ax, x, y, color):
    """Draw an arrow that points down from a point whose error is smaller than the test can find."""
    arrow = {"arrowstyle": "<-", "color": color}
    ax.annotate("", (x, y), (0, -18), textcoords="offset points", arrowprops=arrow)


def micrometers(value, _=None):
    """Return a length (um) with a unit."""
    return f"{value / 1000:.4g} mm" if value >= 1000 else f"{value:.4g} um"


def duration(value, _=None):
    """Return a time (s) with a unit."""
    scale, unit = next(((s, n) for s, n in ((1, "s"), (1e-3, "ms"), (1e-6, "us")) if value >= 0.999 * s), (1e-9, "ns"))
    return f"{value / scale:.3g} {unit}"


def logarithmic(axis, form, most=5):
    """Give an axis a logarithmic scale with at most the given number of labels."""
    axis.axes.set(**{f"{axis.axis_name}scale": "log"})
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1,) if high > 100 * low else (1, 3), numticks=most))
    axis.set_major_formatter(FuncFormatter(form))
    axis.set_minor_locator(NullLocator())


def label(ax, entries, gap=6):
    """Write texts next to points or lines, where they hide no other text and as few points as possible.

    Each entry is a text, its style, and the points (x, y), next to one of which the text is written.
    """
    figure = ax.figure
    figure.canvas.draw()
    renderer, scale, frame = figure.canvas.get_renderer(), figure.dpi / 72, ax.get_window_extent()
    points = np.vstack([_dense(ax.transData.transform(line.get_xydata())) for line in ax.lines if line.get_label()])
    boxes = [text.arrow_patch.get_window_extent(renderer) for text in ax.texts]
    for text, style, anchors in entries:
        written = ax.annotate(text, (0, 0), xycoords="figure pixels", ha="center", va="center", **style)
        written.set_in_layout(False)
        size = written.get_window_extent(renderer)
        best = (np.inf,)
        for anchor, far, (right, up) in product(ax.transData.transform(anchors), (1, 2.5, 4), SIDES):
            near = gap * scale * far * (1 if 0 in (right, up) else 0.7)
            x = anchor[0] + right * (near + size.width / 2)
            y = anchor[1] + up * (near + size.height / 2)
            box = Bbox.from_bounds(x - size.width / 2, y - size.height / 2, size.width, size.height)
            outside = max(frame.x0 - box.x0, box.x1 - frame.x1, frame.y0 - box.y0, box.y1 - frame.y1, 0)
            inside = np.sum(np.all((points > box.min - 2) & (points < box.max + 2), axis=1))
            hidden = sum(1000 for other in boxes if box.overlaps(other))
            best = min(best, (hidden + inside + 3 * far + 100 * outside, x, y))
        written.xy = ax.transData.inverted().transform(best[1:])
        written.xycoords, written.anncoords = "data", "data"
        written.set_position(written.xy)
        boxes.append(Bbox.from_bounds(*(best[1:] - np.array([size.width, size.height]) / 2), size.width, size.height))


def _dense(points):
    """Return points on the lines between points (pixels) that are at most 3 pixels apart."""
    parts = [points]
    for first, last in pairwise(points):
        length = np.hypot(*(last - first))
        if np.isfinite(length):
            parts.append(first + np.linspace(0, 1, int(length / 3) + 2)[:, None] * (last - first))
    return np.vstack(parts)
