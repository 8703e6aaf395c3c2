"""What charts share: axes, frames in mm, legends below, circles by the thousand."""

from typing import TYPE_CHECKING

import numpy as np
from astropy.table import QTable

from rfpsurvey._units import to_mm, to_plain
from rfpsurvey.errors import InputError
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.instrument import Instrument, as_focal_plane, as_instrument

if TYPE_CHECKING:
    import astropy.units as u
    from matplotlib.axes import Axes

__all__ = [
    "add_circles", "check_columns", "focal_plane_axes", "labeled", "legend_below", "named_plane", "new_axes",
    "values_of",
]  # fmt: skip

WIDTH = 7.0  # inches: a page


def new_axes(width: float = 7.0, height: float = 4.8) -> "Axes":
    """Return axes in a figure of their own."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained").add_subplot()


def named_plane(thing: FocalPlane | Instrument | str) -> tuple[str, FocalPlane]:
    """Return the name of an instrument, empty for a bare focal plane, and its focal plane."""
    thing = as_instrument(thing) if isinstance(thing, str) else thing
    plane = as_focal_plane(thing)
    return ("" if plane is thing else thing.name), plane


def focal_plane_axes(ax: "Axes | None", centers: np.ndarray, outer: np.ndarray, region: "u.Quantity | None") -> "Axes":
    """Return axes that show a part of a focal plane to scale, in mm; all of it by default."""
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
        ax = new_axes(WIDTH, float(np.clip(WIDTH * tall / wide, WIDTH / 3, 1.5 * WIDTH)) + 0.9)
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    ax.set_aspect("equal")
    ax.set_xlabel("x (east at position angle 0) [mm]")
    ax.set_ylabel("y (north at position angle 0) [mm]")
    return ax


def add_circles(ax: "Axes", points: np.ndarray, radius: np.ndarray | float, **style: object) -> object:
    """Add circles in units of the data as one collection, and return it."""
    from matplotlib.collections import EllipseCollection

    size = np.broadcast_to(2 * np.asarray(radius, dtype=float), len(points))
    circles = EllipseCollection(size, size, 0, units="xy", offsets=points, offset_transform=ax.transData, **style)
    return ax.add_collection(circles)


def legend_below(ax: "Axes", handles: list, *, columns: int = 3, **options: object) -> None:
    """Put a legend below the labels of the x axis, where it hides no data."""
    from matplotlib import rcParams
    from matplotlib.transforms import ScaledTranslation

    if not handles:
        return
    points = 3.2 * rcParams["font.size"] + 4  # ticks, their labels and that of the axis
    below = ax.transAxes + ScaledTranslation(0, -points / 72, ax.figure.dpi_scale_trans)
    ax.legend(
        handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0), bbox_transform=below, borderaxespad=0,
        ncols=min(columns, len(handles)), fontsize="small", frameon=False, **options,
    )  # fmt: skip


def check_columns(table: QTable, columns: set[str], maker: str | None = None) -> None:
    """Refuse what is no table with these columns; ``maker`` is the function that makes one."""
    if not isinstance(table, QTable):
        raise InputError(f"table must be a QTable, got {type(table).__name__}")
    missing = ", ".join(sorted(columns - set(table.colnames)))
    if missing and maker:
        raise InputError(f"table must come from {maker}, but it has no {missing}")
    if missing:
        raise InputError(f"table must have the column {missing}; it has {', '.join(table.colnames)}")
    if len(table) == 0:
        raise InputError("table must have at least one row, got none")


def values_of(table: QTable, name: str) -> np.ndarray:
    """Return a column of numbers without its unit, masked ones as NaN."""
    try:
        return to_plain(table[name]).astype(float)
    except ValueError:
        raise InputError(f"{name} must be a column of numbers, got {table[name][0]!r} and others") from None


def labeled(table: QTable, name: str) -> str:
    """Return the label of a column, with its unit."""
    unit = getattr(table[name], "unit", None)
    words = {"ratio": "arm ratio"}.get(name, name.replace("_", " "))
    return f"{words} [{unit}]" if unit is not None and str(unit) else words
