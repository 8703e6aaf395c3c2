"""Division of polygons that are not convex into convex parts."""

import astropy.units as u
import numpy as np

from rfpsurvey._common.units import to_points_mm
from rfpsurvey.errors import InputError, short

MOST = 500
"""Largest number of vertices; the computing time grows with the third power of the number of vertices."""


def divide_polygon(vertices: u.Quantity) -> tuple[u.Quantity, ...]:
    """Divide a polygon into convex polygons, which can be parts of an `~rfpsurvey.positioner.ArmOutline`.

    The parts do not overlap, and all their vertices are vertices of the polygon.

    Parameters
    ----------
    vertices : Quantity, shape (k, 2)
        Vertices of a polygon whose edges do not cross, clockwise or counter-clockwise.

    Returns
    -------
    tuple of Quantity
        Counter-clockwise vertices of each part, in mm.

    Raises
    ------
    InputError
        If the vertices are not finite, if there are fewer than 3 or more than 500 vertices, or if edges cross.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> bracket = [[0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]] * u.mm
    >>> len(rs.positioner.divide_polygon(bracket))
    2
    """
    points = to_points_mm(vertices, "vertices")
    if not 3 <= len(points) <= MOST or not np.isfinite(points).all():
        raise InputError(f"vertices must be 3 to {MOST} finite points, got {short(vertices)}")
    xy = points.tolist()
    ring = [k for k in range(len(xy)) if xy[k] != xy[k - 1]]
    # twice the signed area, which is negative if the vertices are clockwise
    if sum(xy[a][0] * xy[b][1] - xy[a][1] * xy[b][0] for a, b in zip(ring, ring[1:] + ring[:1], strict=True)) < 0:
        ring.reverse()
    parts = None if _crosses(xy, ring) else _triangles(xy, ring)
    if not parts:
        raise InputError(f"vertices must define a polygon whose edges do not cross, got {short(vertices)}")
    return tuple(points[part] * u.mm for part in _merged(xy, parts))


def _bend(xy, a, b, c) -> float:
    """Return twice the area of the triangle a, b, c; the sign is positive if the vertices are counter-clockwise."""
    (ax, ay), (bx, by), (cx, cy) = xy[a], xy[b], xy[c]
    return (bx - ax) * (cy - by) - (by - ay) * (cx - bx)


def _crosses(xy, ring) -> bool:
    """Return whether two edges of a polygon cross."""
    edges = list(zip(ring, ring[1:] + ring[:1], strict=True))
    return any(
        _bend(xy, a, b, c) * _bend(xy, a, b, d) < 0 and _bend(xy, c, d, a) * _bend(xy, c, d, b) < 0
        for k, (a, b) in enumerate(edges)
        for c, d in edges[:k]
    )


def _triangles(xy, ring) -> list[list[int]]:
    """Return triangles that fill a polygon (ear clipping), or an empty list if the polygon cannot be divided."""
    ring, triangles = list(ring), []
    while len(ring) > 2:
        for k, corner in enumerate(ring):
            before, after = ring[k - 1], ring[(k + 1) % len(ring)]
            bend = _bend(xy, before, corner, after)
            if bend == 0 or (bend > 0 and not _contains_any(xy, before, corner, after, ring)):
                break
        else:
            return []
        if bend > 0:  # a corner without a bend is removed without a triangle
            triangles.append([before, corner, after])
        del ring[k]
    return triangles


def _contains_any(xy, a, b, c, ring) -> bool:
    """Return whether a counter-clockwise triangle contains another vertex of the polygon."""
    corners = [xy[a], xy[b], xy[c]]
    return any(
        xy[p] not in corners and _bend(xy, a, b, p) >= 0 and _bend(xy, b, c, p) >= 0 and _bend(xy, c, a, p) >= 0
        for p in ring
    )


def _merged(xy, parts) -> list[list[int]]:
    """Return fewer, larger parts: two parts that share an edge are merged if their union is convex."""
    k = 0
    while k < len(parts):
        for j in range(k + 1, len(parts)):
            if union := _union(xy, parts[k], parts[j]):
                parts[k] = union
                del parts[j]
                break
        else:
            k += 1
    return parts


def _union(xy, first, second) -> list[int]:
    """Return the union of two parts, or an empty list if they share no edge or if their union is not convex."""
    # neighbors have a common edge in opposite directions, because both are counter-clockwise
    edges = {(b, a): k for k, (a, b) in enumerate(zip(second, second[1:] + second[:1], strict=True))}
    for k, edge in enumerate(zip(first, first[1:] + first[:1], strict=True)):
        if edge in edges:
            inserted = [second[(edges[edge] + i) % len(second)] for i in range(2, len(second))]
            union = first[: k + 1] + inserted + first[k + 1 :]
            n = len(union)
            bends = [_bend(xy, union[i - 1], union[i], union[(i + 1) % n]) for i in range(n)]
            return union if min(bends) >= 0 else []
    return []
