"""Outlines of positioners: convex polygons and capsules that move with the arms, and the division of other polygons."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

import astropy.units as u
import numpy as np

from rfpsurvey._common.units import ByValue, locked, to_points_mm, to_scalar
from rfpsurvey._kernels.outlines import NO_OUTLINE, Outline
from rfpsurvey.errors import InputError, InputTypeError, check_keywords, short

MOST = 1e6
"""Largest coordinate and radius, mm."""
MOST_VERTICES = 500
"""Largest number of vertices that are divided; the time grows with the third power of their number."""
SAME = 1e-9
"""Tolerance (mm). Vertices that are closer to each other than this length are merged. If the outline of a polygon bends
inward by less than about this length, the polygon counts as convex."""
PERIMETER = 1e-9
"""A polygon counts as convex only if its perimeter exceeds the perimeter of its convex hull by at most this fraction
plus the tolerance ``SAME``."""
FAR = 1e30
"""A very large length (mm). For an arm without parts, half of each side length of the bounding rectangle is set to
minus this length. The computed distance from this rectangle to any other rectangle is then very large."""
ROUNDED_UP = 1.0 + 1e-12
"""Factor that enlarges upper limits to allow for rounding errors."""


@check_keywords
@dataclass(frozen=True, eq=False)
class ArmOutline(ByValue):
    """The shape of both arms of a positioner, as convex polygons and capsules.

    Each part consists of a convex polygon and of all points within ``radius`` of this polygon. A polygon of two
    vertices is a segment, and a polygon of one vertex is a point, so parts with a radius can be capsules and
    discs. Shapes that are not convex consist of several parts, which can overlap.
    `~rfpsurvey.positioner.divide_polygon` divides a polygon that is not convex into such parts.

    Two positioners collide if the gap between an eccentric part of one positioner and any part of the other
    positioner is less than the minimum separation. Central parts do not collide with each other.

    Parameters
    ----------
    eccentric : sequence of Quantity or (Quantity, Quantity)
        Parts that move with the eccentric arm. Each part is an array of vertices of shape (k, 2), or a pair of such an
        array and a radius. The origin is the elbow, and the x axis points along the arm toward the fiber.
    central : sequence of Quantity or (Quantity, Quantity), optional
        Parts that move with the central arm. The origin is the center of the positioner, and the x axis points toward
        the elbow.

    Attributes
    ----------
    parts : tuple of (ndarray of float, shape (k, 2), float)
        Counter-clockwise vertices and radius of each part, as numbers in mm; eccentric parts are first.
    n_eccentric : int
        Number of eccentric parts.

    Raises
    ------
    InputError
        If a part is not convex, if a coordinate or a radius is out of range, or if no eccentric part has a vertex on
        the fiber's side of the elbow.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> arm = [[-1, -1], [4, -1], [4, 1], [-1, 1]] * u.mm
    >>> rs.positioner.ArmOutline([arm], central=[([[0, 0], [3, 0]] * u.mm, 2 * u.mm)])
    <ArmOutline: 1 eccentric part, 1 central part, length 4 mm>
    """

    eccentric: Sequence
    central: Sequence = ()

    def __post_init__(self):
        parts = []
        for name in ("eccentric", "central"):
            given = getattr(self, name)
            if isinstance(given, u.Quantity) or not isinstance(given, Sequence):
                raise InputTypeError(f"{name} must be a list of parts, got {short(given)}")
            object.__setattr__(self, name, tuple(given))
            parts += [to_part(part, f"{name}[{k}]") for k, part in enumerate(given)]
        object.__setattr__(self, "parts", tuple(parts))
        object.__setattr__(self, "n_eccentric", len(self.eccentric))
        if not self.n_eccentric:
            raise InputError("eccentric must contain at least one part, got none")
        if not self.length > 0 * u.mm:
            raise InputError(f"eccentric must have a vertex with x above 0 mm, got at most {self.length}")

    def __repr__(self):
        counts = {"eccentric": len(self.eccentric), "central": len(self.central)}
        texts = [f"{n} {name} part{'' if n == 1 else 's'}" for name, n in counts.items() if n]
        return f"<ArmOutline: {', '.join(texts)}, length {self.length.value:.6g} mm>"

    @cached_property
    def length(self) -> u.Quantity:
        """Largest x of the vertices of all eccentric parts.

        The segment that extends from the elbow along the arm by this length is the core of the outline.
        """
        return max(float(vertices[:, 0].max()) for vertices, _ in self.parts[: self.n_eccentric]) * u.mm

    @cached_property
    def reach(self) -> tuple[float, float]:
        """Largest distances (mm) of eccentric parts from the elbow and of central parts from the center."""
        far = [float(np.hypot(*vertices.T).max()) + radius for vertices, radius in self.parts]
        n = self.n_eccentric
        return max(far[:n]), max(far[n:], default=0.0)

    def mirrored(self) -> "ArmOutline":
        """Return the mirror image about the x axis, for a positioner with the opposite handedness.

        Returns
        -------
        ArmOutline
            The outline with the opposite signs of all y coordinates.
        """
        parts = [((vertices * [1, -1]) * u.mm, radius * u.mm) for vertices, radius in self.parts]
        return ArmOutline(parts[: self.n_eccentric], parts[self.n_eccentric :])

    def to_dict(self) -> dict:
        """Return a dict of the vertices and radii of all parts (mm), as in the description of an instrument."""
        parts = [{"vertices": vertices.tolist(), "radius": radius} for vertices, radius in self.parts]
        return {"eccentric": parts[: self.n_eccentric], "central": parts[self.n_eccentric :]}

    @classmethod
    def from_dict(cls, value: dict, unit: u.UnitBase = u.mm) -> "ArmOutline":
        """Return the outline for a dict of the form that `to_dict` returns; its numbers are in the unit ``unit``.

        Parameters
        ----------
        value : dict
            ``eccentric`` and, optionally, ``central``: lists of dicts with ``vertices`` and, optionally, ``radius``.
        unit : Unit, optional
            Unit of all numbers.

        Returns
        -------
        ArmOutline
            The outline.

        Raises
        ------
        InputError
            If a part is not valid.
        """
        arms = {
            arm: [(part["vertices"] * unit, part.get("radius", 0.0) * unit) for part in parts]
            for arm, parts in value.items()
        }
        return cls(**arms)


def make_outline(outline: ArmOutline | None, centers: np.ndarray, central_arm: np.ndarray) -> Outline:
    """Return the outline of positioners as read-only arrays for the compiled functions.

    ``outline`` is None if the arm model is not ``outline``. ``centers`` and ``central_arm`` are the centers, shape
    (n, 2), and the lengths of the central arms of the positioners, in mm.
    """
    parts = () if outline is None else outline.parts
    centers = locked(np.column_stack([np.asarray(centers, dtype=float), 1.0 / central_arm]))
    start = np.zeros(len(parts) + 1, dtype=np.int64)
    start[1:] = np.cumsum([len(vertices) for vertices, _ in parts])
    if not parts:
        return NO_OUTLINE
    vertices = np.hstack([with_normals(vertices) for vertices, _ in parts])
    circles = np.column_stack([*(_circle(vertices, radius) for vertices, radius in parts), np.zeros(4)])
    table = np.hstack([vertices, np.vstack([circles, start])])
    length, n = float(outline.length.value), outline.n_eccentric
    # the distance of two cores exceeds the gap of their outlines at most by these largest distances from the cores
    eccentric = max(_from_core(vertices, 0.0, length) + radius for vertices, radius in parts[:n])
    central = [
        float(np.hypot(vertices[:, 0] - arm, vertices[:, 1]).max()) + radius
        for vertices, radius in parts[n:]
        for arm in (central_arm.min(), central_arm.max())  # the distance is convex in the arm length
    ]
    offset = (eccentric + max([eccentric, *central])) * ROUNDED_UP
    scale = 2.0 * float(np.hypot(vertices[0], vertices[1]).max()) + offset
    boxes = _box(parts[:n]), _box(parts[n:])
    table, n_vertices = locked(np.ascontiguousarray(table)), vertices.shape[1]
    return Outline(table, locked(start), n_vertices, n, offset, 1.0 / length, scale, *boxes, centers)


def _box(parts):
    """Return the center and half the side lengths of the smallest rectangle, parallel to the axes, around all parts."""
    if not parts:
        return (0.0, 0.0, -FAR, -FAR)
    low = np.min([vertices.min(axis=0) - radius for vertices, radius in parts], axis=0)
    high = np.max([vertices.max(axis=0) + radius for vertices, radius in parts], axis=0)
    return (*(0.5 * (low + high)).tolist(), *(0.5 * (high - low) * ROUNDED_UP).tolist())


def _from_core(vertices, low, high):
    """Return the largest distance of the vertices from the segment of the x axis between ``low`` and ``high``."""
    x, y = vertices.T
    return float(np.hypot(x - np.clip(x, low, high), y).max())


def with_normals(vertices):
    """Return x and y of the vertices, and the normal (x, y) and the length of the edge that starts at each vertex."""
    dx, dy = (np.roll(vertices, -1, axis=0) - vertices).T
    length = np.hypot(dx, dy)
    if len(vertices) == 1:
        return np.array([*vertices.T, [1.0], [0.0], [0.0]])
    return np.array([*vertices.T, dy / length, -dx / length, length])


def _circle(vertices, radius):
    """Return the radius of a part, and the center (x, y) and the radius of a circle that contains the part."""
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    return radius, *middle, (float(np.hypot(*(vertices - middle).T).max()) + radius) * ROUNDED_UP


def to_part(part: object, name: str) -> tuple[np.ndarray, float]:
    """Return the vertices of a part in counter-clockwise order, and its radius (mm); messages contain ``name``."""
    radius = 0.0
    if isinstance(part, tuple) and len(part) == 2:
        part, radius = part
        radius = to_scalar(radius, u.mm, f"the radius of {name}", low=0, high=MOST, closed=True)
    points = to_points_mm(part, name)
    if len(points) == 0 or not (np.abs(points) < MOST).all():
        raise InputError(f"{name} must be finite vertices with coordinates below {MOST:g} mm, got {short(part)}")
    hull = _hull(points)
    # a polygon that bends inward or crosses itself is longer than its hull, or has vertices inside of it
    if not (_closed_length(points) <= _closed_length(hull) * (1 + PERIMETER) + SAME and _on_outline(points, hull)):
        raise InputError(
            f"{name} must be a convex polygon, got {short(part)}; divide_polygon divides other polygons into "
            "convex polygons"
        )
    return locked(hull), radius


def _hull(points):
    """Return the vertices of the exact convex hull in counter-clockwise order; merge vertices closer than ``SAME``."""
    hull = np.array(convex_hull([(Fraction(x), Fraction(y)) for x, y in points.tolist()]), dtype=float)
    while len(hull) > 1:
        gaps = np.hypot(*(np.roll(hull, -1, axis=0) - hull).T)
        if gaps.min() > SAME:
            break
        hull = np.delete(hull, np.argmin(gaps), axis=0)
    return hull


def convex_hull(points: list[tuple]) -> list[tuple]:
    """Return the vertices of the convex hull in counter-clockwise order, without vertices on straight edges."""
    hull, ordered = [], sorted(set(points))
    # Andrew's monotone chain: the lower hull from left to right, and the upper hull from right to left
    for run in (ordered, ordered[::-1]):
        chain = []
        for point in run:
            while len(chain) > 1 and orientation(chain[-2], chain[-1], point) <= 0:
                chain.pop()
            chain.append(point)
        hull += chain[:-1]
    return hull or ordered


def orientation(a: tuple, b: tuple, p: tuple) -> Fraction | int:
    """Return twice the signed area of the triangle a, b, p, exactly for exact coordinates."""
    return (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0])


def _closed_length(points):
    """Return the length of the closed line through points in their order."""
    return float(np.hypot(*(np.roll(points, -1, axis=0) - points).T).sum())


def _on_outline(points, hull):
    """Return whether all points are close to an edge of a convex polygon."""
    x, y, nx, ny, length = with_normals(hull)
    dx, dy = points[:, :1] - x, points[:, 1:] - y
    along = dy * nx - dx * ny
    distance = np.hypot(dx * nx + dy * ny, along - np.clip(along, 0.0, length))
    return bool((distance.min(axis=1) <= 4 * SAME).all())


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
    if not 3 <= len(points) <= MOST_VERTICES or not np.isfinite(points).all():
        raise InputError(f"vertices must be 3 to {MOST_VERTICES} finite points, got {short(vertices)}")
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
    return orientation(xy[b], xy[c], xy[a])


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
