"""Functions that plots share: new axes, axes of focal planes in mm, legends below the axes, colors and markers.

Important differences are shown by color and by a marker, a hatch or a line style.
"""

import astropy.units as u
import numpy as np
from astropy.table import QTable
from matplotlib import colormaps, rcParams
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, FancyArrowPatch
from matplotlib.transforms import Affine2D, ScaledTranslation

from rfpsurvey._common.units import to_mm, to_plain
from rfpsurvey._field.tile import Tile
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.instrument import Instrument, as_focal_plane, as_instrument
from rfpsurvey.errors import InputError, InputTypeError, listed

# the palette of Okabe and Ito, whose colors color-blind people can distinguish
PATROL, ARM, IDLE, COLLISION, OBSTACLE = "#56B4E9", "#0072B2", "#8A8A8A", "#D55E00", "#444444"
SERIES = ("#D55E00", "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#000000", "#F0E442")
GROUP_COLORS = (
    *SERIES[:6],
    "#555555",
    "#F0E442",
    "#F2B58A",
    "#5E3C99",
    "#8C5A00",
    "#8FD9C0",
    "#8E3B6B",
    "#B9E1F7",
    "#C4C4C4",
    "#8A8300",
    "#8B1A1A",
    "#9DB7E8",
    "#FFD9A0",
    "#004D38",
    "#F3D0E4",
    "#1D3F6E",
    "#000000",
    "#C8D96F",
)
"""Fill colors of groups: the palette, then lighter or darker versions of its colors."""
FADED, FAINT = "#A8A8A8", "#8A8A8A26"
"""Color of positioners without a target, and color of the disks behind dots: a translucent gray, faint on any page."""
OUTLINE = "#222222"
MARKERS = "osD^vP*X"
OPEN_CIRCLE = {"marker": "o", "markerfacecolor": "none", "linestyle": "none"}
"""Style of legend entries that show a circle without a fill."""
HATCH = "//////"
"""Hatch of arms, disks and bars that show collisions or fibers lost to collisions."""
LEVELS = ("#FFFFFF", "#C9DFF0", "#93C0E0", "#5A9DCC", "#2474B6", "#0C4A8C", "#06234F")
"""Colors for points that 0, 1, 2, ... positioners reach. The lightness differs, so that prints in gray are legible."""
SEQUENTIAL, DIVERGING, PROBABILITY_COLORS = "viridis", "RdBu_r", "YlOrBr"


def light_scale():
    """Return the sequential color map without its darkest third, in which dark edges would not be visible."""
    return ListedColormap(colormaps[SEQUENTIAL](np.linspace(0.35, 1, 256)))


ORIENTATIONS = ("sky", "focal plane")
"""Orientations: east to the left as on the sky (x increases to the left), or x increasing to the right."""
LENGTH = 16  # points, length of an arrow
LABEL = 22  # points, distance of the letters N and E from the center of the compass
GROUND = LABEL / 2**0.5 + 5  # points, radius of the white disk below the arrows
MARGIN = 35  # points, distance of the center of the compass from both edges of the axes


def position_angle_of(result: object) -> float | None:
    """Return the position angle (degrees) at which a focal plane is drawn, or None for a tile with an unknown angle."""
    if isinstance(result, Tile):
        return result.provenance["parameters"].get("position_angle_deg")
    return 0.0


def add_compass(ax: Axes, position_angle: float | None, avoid: np.ndarray) -> None:
    """Draw arrows toward north and east in a corner of the axes, and write the position angle.

    The position angle (degrees) is the angle of +y from north toward east; the angle of +x is larger by 90 deg. Nothing
    is drawn if the position angle is None. The compass is drawn in the corner where it hides the fewest of the points
    ``avoid``, shape (n, 2), in mm.
    """
    if position_angle is None:
        return
    across, up = _corner(ax, avoid)
    inward = Affine2D().translate(MARGIN * (1 - 2 * across), MARGIN * (1 - 2 * up)).scale(1 / 72)
    points = inward + ax.figure.dpi_scale_trans + ScaledTranslation(across, up, ax.transAxes)
    # the sign of x is reversed on the screen if x increases to the left
    flip = -1 if ax.xaxis_inverted() else 1
    angle = np.deg2rad(position_angle)
    directions = {"N": (-flip * np.sin(angle), np.cos(angle)), "E": (flip * np.cos(angle), np.sin(angle))}
    toward = np.sum(list(directions.values()), axis=0)
    # the arrows occupy one quarter of a disk around the point where they meet
    ground = {"facecolor": "white", "alpha": 0.85, "linewidth": 0}
    ax.add_artist(Circle(tuple(LABEL / 2 * toward), GROUND, transform=points, zorder=8, **ground))
    style = {"arrowstyle": "-|>", "mutation_scale": 8, "shrinkA": 0, "shrinkB": 0, "color": OUTLINE, "linewidth": 1}
    text = {"ha": "center", "va": "center", "fontsize": "small", "color": OUTLINE, "zorder": 8.5}
    for name, (x, y) in directions.items():
        tip = (LENGTH * x, LENGTH * y)
        ax.add_artist(FancyArrowPatch((0, 0), tip, transform=points, zorder=8.5, gid=f"compass-{name}", **style))
        ax.text(LABEL * x, LABEL * y, name, transform=points, **text)
    label = ax.text(*(-12 * toward), f"PA {round(position_angle, 1):g}\N{DEGREE SIGN}", transform=points, **text)
    label.set(fontsize="x-small", bbox={**ground, "pad": 1})


def _corner(ax, avoid):
    """Return the corner, such as (0, 1), with the fewest points nearby; if there are no points, the upper left one."""
    corners = [(0, 1), (1, 1), (0, 0), (1, 0)]
    if len(avoid) == 0:
        return corners[0]
    size = ax.get_window_extent()
    points = 72 / ax.figure.dpi * np.array([size.width, size.height])  # size of the axes
    places = ax.transAxes.inverted().transform(ax.transData.transform(avoid)) * points

    def hidden(corner):
        center = np.array(corner) * points + MARGIN * (1 - 2 * np.array(corner))
        return int((np.hypot(*(places - center).T) < LABEL + 10).sum())

    return min(corners, key=hidden)


WIDTH = 7.0  # inches, width of a page
PAD = 0.08  # inches, margin around all parts of a figure
EQUAL_AREA, RARE = np.sqrt(np.pi) / 2, 0.2
"""Ratio of the sizes of a diamond and a dot of equal area, and the fraction below which diamonds have larger areas."""
LEFT, ABOVE_AND_BELOW = 0.8, 1.4  # inches, space around the axes for labels, the title and a legend


def new_figure(width: float, height: float, **pads: float) -> Figure:
    """Return a new figure without axes; ``pads`` are options of the layout engine."""
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.get_layout_engine().set(**{"w_pad": PAD, "h_pad": PAD, **pads})
    return figure


def new_axes(width: float = 7.0, height: float = 4.8, **options: object) -> Axes:
    """Return the axes of a new figure."""
    return new_figure(width, height).add_subplot(**options)


def new_grid(rows: int, columns: int, size: tuple[float, float], **options: object) -> tuple[Figure, np.ndarray]:
    """Return a new figure and its axes, shape (rows, columns)."""
    figure = Figure(figsize=size, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def named_plane(instrument: FocalPlane | Instrument | str) -> tuple[str, FocalPlane]:
    """Return the name and the focal plane of an instrument; a focal plane without an instrument has an empty name."""
    instrument = as_instrument(instrument) if isinstance(instrument, str) else instrument
    plane = as_focal_plane(instrument)
    return ("" if plane is instrument else instrument.name), plane


def focal_plane_axes(
    ax: Axes | None,
    centers: np.ndarray,
    outer: np.ndarray,
    region: u.Quantity | None,
    orientation: str,
    *,
    beside: float = 0.0,
) -> Axes:
    """Return axes that show a focal plane, or a part of it, to scale in mm.

    ``beside`` is the width in inches that is reserved for a color bar.
    """
    if orientation not in ORIENTATIONS:
        raise InputError(f"orientation must be {' or '.join(map(repr, ORIENTATIONS))}, got {orientation!r}")
    if region is None:
        margin = 1.05 * np.max(outer)
        low, high = centers.min(axis=0) - margin, centers.max(axis=0) + margin
    else:
        corners = to_mm(region, "region")
        if corners.shape != (2, 2) or not np.isfinite(corners).all() or (corners[0] == corners[1]).any():
            raise InputError(f"region must be two finite corners ((x0, y0), (x1, y1)), got {region}")
        low, high = corners.min(axis=0), corners.max(axis=0)
    if ax is None:
        wide, tall = high - low
        inside = WIDTH - LEFT - beside
        ax = new_axes(WIDTH, float(np.clip(inside * tall / wide, inside / 3, 1.5 * inside)) + ABOVE_AND_BELOW)
    across = (high[0], low[0]) if orientation == "sky" else (low[0], high[0])
    ax.set(xlim=across, ylim=(low[1], high[1]), aspect="equal", xlabel="x [mm]", ylabel="y [mm]")
    return ax


def limits_of(ax: Axes) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest x and y and the largest x and y that axes show, even if x increases to the left."""
    corners = np.sort(np.array([ax.get_xlim(), ax.get_ylim()]), axis=1)
    return corners[:, 0], corners[:, 1]


def points_per_unit(ax: Axes) -> float:
    """Return the approximate length of a data unit in points (1/72 inch), on axes with equal scales."""
    low, high = limits_of(ax)
    size = ax.get_window_extent()
    return 72 / ax.figure.dpi * float(np.min(np.array([size.width, size.height]) / (high - low)))


def diamond_size(size: float, fraction: float, most: float) -> float:
    """Return the size of diamonds among dots of the given size, of which ``fraction`` are diamonds instead.

    A few diamonds are up to ``most`` times as large as dots. Many diamonds have the same area as dots, so that they
    cover the part of the plot that corresponds to their fraction.
    """
    return size * float(np.clip(EQUAL_AREA * np.sqrt(RARE / max(fraction, 1e-9)), EQUAL_AREA, most))


def spacing_of(centers: np.ndarray, outer: np.ndarray) -> float:
    """Return the median distance between neighboring centers; for one positioner, return its patrol diameter."""
    from scipy.spatial import cKDTree

    if len(centers) <= 1:
        return 2 * float(np.max(outer, initial=1.0))
    return float(np.median(cKDTree(centers).query(centers, k=2)[0][:, 1]))


def add_circles(ax: Axes, points: np.ndarray, radius: np.ndarray | float, **style: object) -> object:
    """Draw circles, whose radii are in data units, as one collection, and return this collection."""
    size = np.broadcast_to(2 * np.asarray(radius, dtype=float), len(points))
    circles = EllipseCollection(size, size, 0, units="xy", offsets=points, offset_transform=ax.transData, **style)
    return ax.add_collection(circles)


def legend_below(ax: Axes, handles: list, *, columns: int = 3, **options: object) -> None:
    """Place a legend below the labels of the x axis, so that it hides no data."""
    if not handles:
        return
    points = 3.2 * rcParams["font.size"] + 4  # ticks, tick labels and axis label
    below = ax.transAxes + ScaledTranslation(0, -points / 72, ax.figure.dpi_scale_trans)
    place = {"loc": "upper center", "bbox_to_anchor": (0.5, 0), "bbox_transform": below, "borderaxespad": 0}
    options |= {"ncols": min(columns, len(handles)), "fontsize": "small", "frameon": False}
    ax.legend(handles=handles, **place, **options)


def legend_line(label: str, **style: object) -> Line2D:
    """Return a legend entry with a line or a marker."""
    return Line2D([], [], label=label, **style)


def check_columns(table: QTable, columns: set[str], maker: str | None = None) -> None:
    """Raise an error unless a table has the given columns; ``maker`` is the function that returns such tables."""
    if not isinstance(table, QTable):
        raise InputTypeError(f"table must be a QTable, got {type(table).__name__}")
    missing = ", ".join(sorted(columns - set(table.colnames)))
    if missing and maker:
        raise InputError(f"table must come from {maker}, got one without the column {missing}")
    if missing:
        raise InputError(f"table must have the column {missing}; it has {listed(table.colnames)}")
    if len(table) == 0:
        raise InputError("table must have at least one row, got none")


def values_of(table: QTable, name: str) -> np.ndarray:
    """Return a column of numbers without its unit; masked values become NaN."""
    try:
        return to_plain(table[name]).astype(float)
    except ValueError:
        raise InputError(f"{name} must be a column of numbers, got values such as {table[name][0]!r}") from None


def labeled(table: QTable, name: str) -> str:
    """Return the axis label of a column, with its unit."""
    unit = getattr(table[name], "unit", None)
    words = {"ratio": "arm ratio"}.get(name, name.replace("_", " "))
    return f"{words} [{unit}]" if unit is not None and str(unit) else words
