"""Small figures of results in notebooks: points in a few colors as SVG, whose size does not depend on their number."""

from html import escape

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._common.units import from_lonlat

SIZE, CELLS, EDGE = 240, 160, 4
"""Width of a figure in pixels, number of cells along each side, and margin in cells; a cell contains one point."""
BLUE, RED, GRAY, LIGHT = "#0072B2", "#D55E00", "#8A8A8A", "#56B4E9"


def dots(xy: np.ndarray, groups: dict[str, tuple[str, np.ndarray]], *, radius: float = 0.0) -> str:
    """Return a figure in HTML with points in the plane, x to the right and y upward.

    Parameters
    ----------
    xy : ndarray, shape (n, 2)
        Points; points that are not finite are not drawn.
    groups : dict
        Label, and color and mask of the points, of each group; the last ones are on top. The legend contains the
        numbers of points.
    radius : float, optional
        Radius of the points; by default, it follows from their number.

    Returns
    -------
    str
        The figure.
    """
    finite = np.isfinite(xy).all(axis=1)
    low, high = (extreme(xy[finite], axis=0) if finite.any() else np.zeros(2) for extreme in (np.min, np.max))
    scale = (CELLS - 2 * EDGE) / max((high - low + 2 * radius).max(), 1e-300)
    cells = np.full(xy.shape, -1)
    cells[finite] = np.rint(CELLS / 2 + (xy[finite] - (low + high) / 2) * scale * [1, -1]).astype(int)
    width = 2 * radius * scale or min(max(CELLS / np.sqrt(len(xy) + 1) * 0.7, 1.0), 8.0)
    paths, legend = [], []
    for label, (color, mask) in groups.items():
        path = "".join(f"M{x} {y}h0" for x, y in np.unique(cells[mask & finite], axis=0).tolist())
        paths.append(
            f'<path d="{path}" stroke="{color}" stroke-width="{width:.3g}" stroke-linecap="round"/>' if path else ""
        )
        legend.append(f'<span style="color:{color}">&#9679;</span> {int(mask.sum())} {escape(label)}')
    words = escape(", ".join(f"{int(mask.sum())} {label}" for label, (_, mask) in groups.items()))
    return f"{_svg(''.join(paths), words)}<div>{' '.join(legend)}</div>"


def ring(inner: float, outer: float) -> str:
    """Return a figure of the annulus between two radii."""
    wide, narrow = CELLS / 2 - EDGE, (CELLS / 2 - EDGE) * inner / outer
    middle = f'cx="{CELLS // 2}" cy="{CELLS // 2}"'
    area = f'<circle {middle} r="{(wide + narrow) / 2:.4g}" stroke="{LIGHT}" stroke-width="{wide - narrow:.4g}"/>'
    return _svg(area, "patrol area of a positioner")


def _svg(content: str, words: str) -> str:
    box = f'width="{SIZE}" height="{SIZE}" viewBox="0 0 {CELLS} {CELLS}" role="img" fill="none"'
    return f'<svg {box} aria-label="{words}">{content}</svg>'


def points_in_cap(center: np.ndarray, radius: float, n: int) -> np.ndarray:
    """Return evenly spread directions around a center (unit vector) as unit vectors, shape (n, 3)."""
    turn, height = np.arange(n) * np.pi * (3 - np.sqrt(5)), 1 - (np.arange(n) + 0.5) / n * (1 - np.cos(radius))
    west, north = _axes(center)
    across = np.sqrt(np.maximum(1 - height**2, 0))[:, None]
    return height[:, None] * center + across * (np.cos(turn)[:, None] * west + np.sin(turn)[:, None] * north)


def _axes(center: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the unit vectors toward west and north at a direction."""
    west = np.array([center[1], -center[0], 0.0]) if np.hypot(*center[:2]) > 1e-9 else np.array([0.0, -1.0, 0.0])
    west /= np.linalg.norm(west)
    return west, np.cross(west, center)


def around(vectors: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Return the distances of directions from a center toward west and north (rad), shape (n, 2)."""
    center = center / max(np.linalg.norm(center), 1e-300)
    west, north = _axes(center)
    offset = np.column_stack([vectors @ west, vectors @ north])
    length = np.linalg.norm(offset, axis=1)
    return offset * (np.arctan2(length, vectors @ center) / np.maximum(length, 1e-300))[:, None]


def figure_of_tiles(table: QTable) -> str:
    """Return a small figure of tiles on the sky, around their mean direction, for notebooks; east is to the left."""
    vectors = from_lonlat(table["ra"].to_value(u.rad), table["dec"].to_value(u.rad))
    states = np.asarray(table["state"]).astype(str) if "state" in table.colnames else np.full(len(table), "tiles")
    colors = {"tiles": BLUE, "planned": BLUE, "done": GRAY, **dict.fromkeys(["dropped", "past", "partly"], LIGHT)}
    groups = {name: (colors.get(name, RED), states == name) for name in dict.fromkeys(states.tolist())}
    return dots(around(vectors, vectors.sum(axis=0)), groups)
