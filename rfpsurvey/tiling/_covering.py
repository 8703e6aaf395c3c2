"""Coverings of a circle on the sphere by equal circles; each covering is tested for gaps.

The center of the widest empty circle between points is the circumcenter of a Delaunay triangle, and the Delaunay
triangles of points on the sphere are the facets of their convex hull.
"""

import numpy as np

from rfpsurvey.errors import InputError

GOLDEN = np.pi * (3 - np.sqrt(5))
# Area of a regular hexagon inscribed in a circle of radius 1. No covering by equal circles has a larger area per
# circle.
HEXAGON = 1.5 * np.sqrt(3)
# The plastic number. Its inverse powers define shifts of passes that are as different as possible (Roberts 2018).
PLASTIC = 1.32471795724474602596
MOST = 500_000
# Centers extend by this number of radii beyond the circle, so that the border of the circle is covered like its
# interior.
MARGIN = 4.0


def basis_of(center: np.ndarray) -> np.ndarray:
    """Return a matrix with the rows east, north and center (unit vectors); at the poles, east is +y."""
    flat = np.hypot(center[0], center[1])
    east = np.array([-center[1], center[0], 0.0]) / flat if flat > 1e-12 else np.array([0.0, 1.0, 0.0])
    return np.array([east, np.cross(center, east), center])


def dither(number: int) -> np.ndarray:
    """Return the shift of a pass as fractions of the unit cell of the lattice; pass 0 (the first) is not shifted."""
    return (number * np.array([1 / PLASTIC, 1 / PLASTIC**2])) % 1.0


def lattice(center: np.ndarray, reach: float, pitch: float, shift: np.ndarray) -> np.ndarray:
    """Return a hexagonal lattice in Lambert's equal-area map around a center, out to ``reach``, sorted by distance."""
    limit = 2 * np.sin(min(reach, np.pi - 1e-9) / 2)
    n = int(np.ceil(limit / pitch * 2 / np.sqrt(3))) + 2
    i, j = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1), indexing="ij")
    i, j = i.ravel() + shift[0], j.ravel() + shift[1]
    x, y = pitch * (i + j / 2), pitch * j * np.sqrt(3) / 2
    r2 = x * x + y * y
    order = np.argsort(r2, kind="stable")
    order = order[r2[order] <= limit**2]
    x, y, r2 = x[order], y[order], r2[order]
    scale = np.sqrt(np.maximum(1 - r2 / 4, 0.0))
    return np.column_stack([scale * x, scale * y, 1 - r2 / 2]) @ basis_of(center)


def widest_gap(vectors: np.ndarray, center: np.ndarray, reach: float) -> float:
    """Return the radius of the widest circle that contains none of ``vectors`` and touches the given circle."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(vectors)
    middle = hull.equations[:, :3]
    # angles are computed from chords, because cosines are inaccurate for small angles
    half = np.linalg.norm(middle[:, None, :] - vectors[hull.simplices], axis=2).max(axis=1) / 2
    gap = 2 * np.arcsin(np.minimum(half, 1.0))
    away = 2 * np.arcsin(np.minimum(np.linalg.norm(middle - center, axis=1) / 2, 1.0))
    return float(gap[away - gap <= reach].max(initial=0.0))


def hexagonal(center: np.ndarray, reach: float, radius: float, number: int = 0) -> np.ndarray:
    """Cover a field, at most a hemisphere, without gaps: return centers on a hexagonal lattice with the largest pitch.

    Parameters
    ----------
    center : ndarray, shape (3,)
        Center of the circle to cover.
    reach : float
        Radius (radians) of the circle to cover, at most pi / 2.
    radius : float
        Radius of the covering circles in radians.
    number : int, optional
        Number of the pass, which determines the shift of the lattice.

    Returns
    -------
    ndarray, shape (n, 3)
        Centers, including the centers of circles that do not touch the given circle.
    """
    if reach > np.pi / 2 * (1 + 1e-9):
        raise InputError(
            f"the hexagonal lattice covers at most a hemisphere, but the field reaches {np.rad2deg(reach):.1f} deg "
            "from its center; use method='spiral'"
        )
    check_number(reach, radius)

    def make(pitch):
        return lattice(center, reach + MARGIN * radius, pitch, dither(number))

    # the upper limit is the pitch on a plane; on the sphere, the distortion of the map requires a smaller pitch
    low, high = 0.0, np.sqrt(3) * radius
    pitch = high
    for _ in range(40):
        gap = widest_gap(make(pitch), center, reach)
        if gap <= radius:
            low = pitch
            break
        high, pitch = pitch, pitch * min(radius / gap, 0.9999)
    for _ in range(8):
        if high - low <= 1e-4 * high:
            break
        pitch = (low + high) / 2
        if widest_gap(make(pitch), center, reach) <= radius:
            low = pitch
        else:
            high = pitch
    return make(low)


def spiral(center: np.ndarray, reach: float, radius: float, number: int = 0) -> np.ndarray:
    """Cover a field, at most the whole sky, without gaps: return centers on a Fibonacci spiral over the whole sphere.

    Parameters
    ----------
    center : ndarray, shape (3,)
        Center of the circle to cover.
    reach : float
        Radius (radians) of the circle to cover, at most pi.
    radius : float
        Radius of the covering circles in radians.
    number : int, optional
        Number of the pass, which determines the axis of the spiral.

    Returns
    -------
    ndarray, shape (n, 3)
        Centers, including the centers of circles that do not touch the given circle.
    """
    check_number(reach, radius)
    wide = min(reach + MARGIN * radius, np.pi)
    basis = basis_of(center)
    shift = dither(number)
    # the axis of each further pass is shifted within the cell of one circle, and the spiral is rotated
    x, y = radius * np.sqrt(3) * (shift[0] + shift[1] / 2), radius * 1.5 * shift[1]
    tilted = basis_of((lambda v: v / np.linalg.norm(v))(np.array([x, y, 1.0]) @ basis))
    turn = 2 * np.pi * shift[0]

    def make(n):
        used = n if wide >= np.pi else min(int(np.ceil(n * np.sin(min(wide + 2 * radius, np.pi) / 2) ** 2)) + 8, n)
        k = np.arange(used)
        z = 1 - (2 * k + 1) / n
        r, angle = np.sqrt((1 - z) * (1 + z)), GOLDEN * k + turn
        return np.column_stack([r * np.cos(angle), r * np.sin(angle), z]) @ tilted

    fewest = max(4 * np.pi / (HEXAGON * radius**2), 5)
    n = int(fewest * 1.05) + 1
    while (gap := widest_gap(make(n), center, reach)) > radius:
        fewest = n
        n = int(np.ceil(n * min(max((gap / radius) ** 2, 1.002), 1.2))) + 1
    for _ in range(8):
        middle = int((fewest + n) // 2)
        if n - fewest <= max(0.001 * n, 1):
            break
        if widest_gap(make(middle), center, reach) <= radius:
            n = middle
        else:
            fewest = middle
    return make(n)


def check_number(reach: float, radius: float) -> None:
    """Raise an error if the covering requires more than ``MOST`` tiles."""
    expected = 4 * np.pi * np.sin(min(reach + radius, np.pi) / 2) ** 2 / (HEXAGON * radius**2)
    if expected > MOST:
        raise InputError(
            f"radius must be larger: about {expected:.3g} tiles with the radius {np.rad2deg(radius):.3g} deg would "
            f"cover the field, but at most {MOST} tiles are allowed"
        )
