"""Conversion of DESI's exclusion polygons to the outline of a positioner."""

import astropy.units as u
import numpy as np

from rfpsurvey.positioner import ArmOutline, divide_polygon


def find_outline(polygons: dict) -> ArmOutline:
    """Return the outline of a positioner from its exclusion polygons in CS5.

    The polygons ``phi`` are in the frame of the eccentric arm, and the polygons ``theta`` are in the frame of the
    central arm. Circles become discs. The lines of the polygons need not be closed, because the program fiberassign
    tests only whether lines intersect. Here, all lines that are not closed are connected at their nearest ends to form
    one closed polygon.
    """
    return ArmOutline(_parts(polygons["phi"]), _parts(polygons.get("theta", {"segments": [], "circles": []})))


def _parts(shape: dict) -> list:
    """Return the convex parts of a shape that consists of lines and circles."""
    lines = [np.array(line, dtype=float).reshape(-1, 2) for line in shape["segments"] if len(line)]
    closed = [line for line in lines if len(line) > 3 and np.allclose(line[0], line[-1])]
    open_lines = [line for line in lines if not any(line is one for one in closed)]
    rings = [line[:-1] for line in closed] + ([_joined(open_lines)] if open_lines else [])
    parts = [part for ring in rings for part in _divided(ring)]
    return parts + [
        (np.array([center], dtype=float) * u.mm, float(radius) * u.mm) for center, radius in shape["circles"]
    ]


def _divided(ring: np.ndarray) -> tuple:
    """Return the convex parts of a polygon; a polygon with fewer than three vertices is one part."""
    return (ring * u.mm,) if len(ring) < 3 else divide_polygon(ring * u.mm)


def _joined(lines: list[np.ndarray]) -> np.ndarray:
    """Return the vertices of all lines as one sequence; each line starts near the end of the preceding line."""
    found, *others = lines
    while others:
        gaps = [[np.hypot(*(line[end] - found[-1])) for end in (0, -1)] for line in others]
        k, end = np.unravel_index(np.argmin(gaps), (len(others), 2))
        line = others.pop(k)
        found = np.concatenate([found, line[::-1] if end else line])
    return found
