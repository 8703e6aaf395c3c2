"""Focal planes made of modules, and hexagonal lattices, which arrange positioners and modules."""

import astropy.units as u
import numpy as np
import scipy  # its subpackages are imported on first use

from rfpsurvey._common.units import to_numbers, to_points_mm, to_radian, to_scalar
from rfpsurvey._instruments.positioner import Positioner
from rfpsurvey.errors import InputError, check_switch, check_whole, items_of, number_of, refusal, short


def hexagonal_cells(pitch, *, rings=None, count=None, radius=None, inner_radius=0 * u.mm, vacant=(), rows_along="x"):
    """Return centers in mm, shape (n, 2), and cells (q, k), shape (n, 2), of a hexagonal lattice."""
    step = to_scalar(pitch, u.mm, "pitch", low=0, high=1e6)
    if (rings is None) == (count is None) and not (rings is None and radius is not None):
        given = f"rings={rings}, count={count}, radius={radius}"
        raise InputError(f"either rings or count must be given, or only radius, got {given}")
    for name, value, least, most in (("rings", rings, 0, 500), ("count", count, 1, 1_000_000)):
        if value is not None:  # numbers such as 3.0 are also whole numbers
            is_whole = isinstance(value, float) and value.is_integer()
            check_whole(int(value) if is_whole else value, name, least, most)
    if not (isinstance(rows_along, str) and rows_along in ("x", "y")):
        raise refusal("rows_along must be 'x' or 'y'", rows_along, str)
    text = "vacant must be a list of cells (q, k)"
    vacant = [to_numbers(cell, "vacant") for cell in items_of(vacant, text)]
    if any(cell.shape != (2,) for cell in vacant):
        raise InputError(f"{text}, got {short(vacant)}")
    hole = to_scalar(inner_radius, u.mm, "inner_radius", low=0, closed=True)
    edge = np.inf if radius is None else to_scalar(radius, u.mm, "radius", low=0)
    if rings is not None:
        n = int(rings)
    elif count is not None:
        area = count * np.sqrt(3) / 2 * step**2 + np.pi * hole**2 + len(vacant) * step**2
        n = int(np.sqrt(area / np.pi) / (step * np.sqrt(3) / 2)) + 3
    else:
        n = int(edge / (step * np.sqrt(3) / 2)) + 2
    k, q = (a.ravel() for a in np.mgrid[-n : n + 1, -n : n + 1])
    inside = np.abs(q + k) <= n
    k, q = k[inside], q[inside]
    xy = cell_centers(q, k, step, rows_along)
    r = np.hypot(*xy.T)
    # Several cells can have the same distance from the origin. Rounded distances in units of the pitch are compared, so
    # that rounding errors have no effect.
    keep = (np.round(r / step, 9) >= np.round(hole / step, 9)) & (np.round(r / step, 9) <= np.round(edge / step, 9))
    cells = np.column_stack([q, k])
    for cell in vacant:
        hit = (cells == cell).all(axis=1)
        if not hit.any():
            raise InputError(f"vacant cell ({cell[0]:g}, {cell[1]:g}) is not on the lattice of {n} rings")
        keep &= ~hit
    if count is not None:
        angle = np.round(np.mod(np.arctan2(xy[:, 1], xy[:, 0]), 2 * np.pi), 9)
        order = np.lexsort((angle, np.round(r / step, 9)))
        order = order[keep[order]][: int(count)]
        if len(order) < count:
            raise InputError(f"only {len(order)} cells lie within radius {radius}, fewer than count = {count}")
        keep[:] = False
        keep[order] = True
    return xy[keep], cells[keep]


def cell_centers(q: np.ndarray, k: np.ndarray, pitch: float, rows_along: str) -> np.ndarray:
    """Return the centers of the cells (q, k) of a hexagonal lattice, shape (n, 2), in the unit of ``pitch``."""
    xy = pitch * np.column_stack([q + k / 2, np.sqrt(3) / 2 * k])
    return xy[:, ::-1].copy() if rows_along == "y" else xy


MOST_ROWS = 200


class Modular:
    """The part of `FocalPlane` that makes focal planes from modules."""

    @classmethod
    def from_modules(
        cls,
        positioner: Positioner,
        *,
        centers: u.Quantity,
        places: u.Quantity,
        rotation: u.Quantity | None = None,
        outline: u.Quantity | None = None,
        wall: u.Quantity | None = None,
        **columns,
    ):
        """Make a focal plane from equal modules, such as the triangular modules of MUST.

        The identifiers of the positioners are numbers such as 1263: place 63 of module 12. Modules and places are
        numbered from 1, in the order of the arguments. Requirements can count fibers per module (``sky=2/module``).

        Parameters
        ----------
        positioner : Positioner
            Geometry common to all positioners.
        centers : Quantity, shape (m, 2)
            Centers of the modules on the focal plane.
        places : Quantity, shape (k, 2)
            Centers of the positioners of a module that is not rotated, relative to its center.
        rotation : Quantity, shape (m,), optional
            Angle by which each module is rotated counter-clockwise; 0 by default.
        outline : Quantity, shape (v, 2), optional
            Corners of the convex outline of a module that is not rotated, relative to its center.
        wall : Quantity, optional
            Thickness of walls along the outline, outside of it, which no arm may touch; no walls by default.
        **columns
            Further arguments of `FocalPlane`, such as ``fiber_type`` and ``central_arm``; columns with k values apply
            to all modules.

        Returns
        -------
        FocalPlane
            The focal plane.

        Raises
        ------
        InputError
            If an argument is not valid, or if modules overlap.

        Examples
        --------
        >>> import astropy.units as u
        >>> import rfpsurvey as rs
        >>> robot = rs.Positioner(1.8 * u.mm, 1.8 * u.mm, clearance=1 * u.mm)
        >>> places = rs.focal_plane.triangle(6.2 * u.mm, 11, corners=False)
        >>> plane = rs.FocalPlane.from_modules(
        ...     robot, centers=[[0, 0], [0, -43]] * u.mm, rotation=[0, 180] * u.deg, places=places
        ... )
        >>> len(plane), plane.id[-1]
        (126, np.int64(263))
        """
        xy, turn = to_points_mm(centers, "centers"), np.zeros(len(centers))
        if rotation is not None:
            turn = to_radian(rotation, "rotation")
            if turn.shape != (len(xy),):
                raise InputError(f"rotation must have the shape ({len(xy)},), got {turn.shape}")
        points = to_points_mm(places, "places")
        for name, values in (("centers", xy), ("places", points), ("rotation", turn)):
            if len(values) == 0 or not np.isfinite(values).all():
                got = values[~np.isfinite(values)][0] if len(values) else "none"
                raise InputError(f"{name} of modules must be finite, got {got}")
        edge = hull_of(points) if outline is None else _checked_outline(outline, points)
        _check_overlap(xy, turn, edge)
        if wall is not None:
            if outline is None:
                raise InputError("walls must be given with the outline of a module, got no outline")
            walls = walls_of(xy, turn, edge, to_scalar(wall, u.mm, "wall", low=0))
            columns["obstacle_polygons"] = [*(columns.get("obstacle_polygons") or ()), *walls]
        m, k = len(xy), len(points)
        for name in {*columns} - {"obstacles", "hidden", "obstacle_polygons", "margins"}:
            given = columns[name]
            is_dict = isinstance(given, dict)
            columns[name] = {key: _repeated(v, k, m) for key, v in given.items()} if is_dict else _repeated(given, k, m)
        if isinstance(columns.get("groups", {}), dict):
            columns["groups"] = {"module": np.repeat(np.arange(1, m + 1), k), **columns.get("groups", {})}
        step = 10 ** len(str(k))
        columns.setdefault("id", (step * np.arange(1, m + 1)[:, None] + np.arange(1, k + 1)).ravel())
        return cls(_placed(xy, turn, points).reshape(-1, 2) * u.mm, positioner, **columns)


def triangle(pitch: u.Quantity, rows: int, *, corners: bool = True) -> u.Quantity:
    """Return the places of a triangular module: a triangular lattice whose tip points toward +y.

    Parameters
    ----------
    pitch : Quantity
        Distance between neighboring places.
    rows : int
        Number of rows; the lattice has ``rows (rows + 1) / 2`` places.
    corners : bool, optional
        Whether the three places at the corners have positioners.

    Returns
    -------
    Quantity, shape (k, 2)
        The places relative to the centroid of the triangle, from the lowest row to the tip and from -x to +x.

    Raises
    ------
    InputError
        If an argument is not valid.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> len(rs.focal_plane.triangle(6.2 * u.mm, 11, corners=False))
    63
    """
    step, n = to_scalar(pitch, u.mm, "pitch", low=0, high=1e6), check_whole(rows, "rows", 1, MOST_ROWS)
    check_switch(corners, "corners")
    row = np.repeat(np.arange(n), n - np.arange(n))
    place = np.concatenate([np.arange(n - k) for k in range(n)])
    xy = step * np.column_stack([place + (row - n + 1) / 2, np.sqrt(3) / 2 * (row - (n - 1) / 3)])
    is_corner = (row == n - 1) | ((row == 0) & np.isin(place, (0, n - 1)))
    return xy[np.ones(len(xy), dtype=bool) if corners else ~is_corner] * u.mm


def grouped_modules(side: float, gap: float, group_gap: float, most: float, *, whole: bool) -> tuple:
    """Return the flat grid of triangular modules in groups of four: centers, rotations and corners (mm, rad).

    Four modules form a larger triangle: one at the center, and three around it at the distance ``gap``; ``group_gap``
    is the distance between the modules of adjacent groups, less twice ``gap``. Groups (or modules, if ``whole`` is
    false) whose centers are farther than ``most`` from the origin are omitted. The corners are points between the
    modules, where fiducials have their place.
    """
    edge = 2 * side + np.sqrt(3) * (group_gap + 2 * gap)
    n = int(most / edge) + 3
    j, i = (part.ravel() for part in np.mgrid[-n : n + 1, -n : n + 1])
    corner = edge * np.column_stack([i + j / 2, np.sqrt(3) / 2 * j])
    centers, turns = [], []
    for sign in (1, -1):  # groups whose tip points toward +y, and toward -y
        group = corner + np.array([edge / 2, sign * edge / np.sqrt(12)])
        radius = sign * (side / np.sqrt(3) + gap)
        around = [[0, 0], *([radius * np.cos(a), radius * np.sin(a)] for a in np.radians([90, 210, 330]))]
        modules = group[:, None, :] + np.array(around)
        far = np.hypot(*group.T)[:, None] if whole else np.hypot(*modules.transpose(2, 0, 1))
        keep = np.broadcast_to(far <= most, modules.shape[:2])
        up = np.broadcast_to(np.array([-sign, sign, sign, sign]), modules.shape[:2])
        centers.append(modules[keep])
        turns.append(np.where(up[keep] > 0, 0.0, np.pi))
    centers, turns = np.concatenate(centers), np.concatenate(turns)
    order = np.lexsort((np.round(centers[:, 0], 6), np.round(centers[:, 1], 6)))
    centers, turns = centers[order], turns[order]
    if not len(centers):
        raise InputError(f"the modules must have centers within {most:g} mm of the axis, got none")
    # corners of modules lie on a lattice with half the edge of a group
    j, i = (part.ravel() for part in np.mgrid[-4 * n : 4 * n + 1, -4 * n : 4 * n + 1])
    lattice = edge / 2 * np.column_stack([i + j / 2, np.sqrt(3) / 2 * j])
    apart, _ = scipy.spatial.cKDTree(centers).query(lattice)
    farthest = edge / np.sqrt(3) - side / np.sqrt(3) - gap  # of the corners of a group from its outer modules
    return centers, turns, lattice[apart < 1.01 * farthest]


def onto_surface(xy: np.ndarray, surface: np.ndarray) -> np.ndarray:
    """Return points of a flat grid (mm) after their distances from the axis become lengths along a curved surface.

    ``surface`` is the radius of curvature of a sphere, or an array of points (R, Z) of the profile, which begins at the
    axis. The result is the projection of the points on the surface along the axis.
    """
    far = np.hypot(*xy.T)
    if np.ndim(surface) == 0:
        most, to_radius = float(surface) * np.pi / 2, lambda arc: surface * np.sin(arc / surface)
    else:
        steps = np.diff(surface, axis=0)
        if surface[0, 0] != 0 or (steps[:, 0] <= 0).any():
            raise InputError(
                "the points of the focal surface must begin at R = 0, and R must increase, got other points"
            )
        length = np.concatenate([[0], np.cumsum(np.hypot(*steps.T))])
        most, to_radius = length[-1], lambda arc: np.interp(arc, length, surface[:, 0])
    if far.max() > most:
        raise InputError(
            f"the focal surface must extend to all modules, at {far.max():g} mm, got one up to {most:g} mm"
        )
    return xy * (to_radius(far) / np.where(far > 0, far, 1))[:, None]


def _repeated(value: object, k: int, m: int) -> object:
    """Return a column with k values, those of one module, for m modules; other values unchanged."""
    if isinstance(value, list | tuple) and value:
        value = u.Quantity(value) if isinstance(value[0], u.Quantity) else np.asarray(value)
    if not isinstance(value, np.ndarray) or value.ndim == 0 or len(value) != k or m == 1:
        return value
    return np.concatenate([value] * m)


def _checked_outline(outline: u.Quantity, places: np.ndarray) -> np.ndarray:
    """Return the outline of a module counter-clockwise; raise an error if it is not convex or misses a place."""
    points = to_points_mm(outline, "outline")
    if not np.isfinite(points).all():
        raise InputError(f"outline of a module must be finite, got {points[~np.isfinite(points)][0]}")
    hull = hull_of(points)
    if len(points) < 3 or len(hull) < len(points) or np.linalg.matrix_rank(points - points[0], tol=1e-9) < 2:
        raise InputError("outline of a module must be the corners of a convex polygon, got other points")
    along = np.roll(hull, -1, axis=0) - hull
    apart = places[:, None, :] - hull
    outside = (along[:, 0] * apart[..., 1] - along[:, 1] * apart[..., 0] < -1e-9).any(axis=1)
    if outside.any():
        raise InputError(f"outline of a module must contain all places, got {int(outside.sum())} places outside")
    return hull


def hull_of(points: np.ndarray) -> np.ndarray:
    """Return the corners of the convex hull of points; all points if they lie on a line."""
    if len(points) < 3 or np.linalg.matrix_rank(points - points[0], tol=1e-9 * (1 + np.abs(points).max())) < 2:
        return points
    return points[scipy.spatial.ConvexHull(points).vertices]


def walls_of(xy: np.ndarray, turn: np.ndarray, outline: np.ndarray, thickness: float) -> list[u.Quantity]:
    """Return a polygon along each edge of each module, outside of its outline."""
    first, last = outline, np.roll(outline, -1, axis=0)
    along = (last - first) / np.hypot(*(last - first).T)[:, None]
    out = thickness * np.column_stack([along[:, 1], -along[:, 0]])  # corners are in counter-clockwise order
    strips = np.stack([first, first + out, last + out, last], axis=1)
    return [wall * u.mm for wall in _placed(xy, turn, strips.reshape(-1, 2)).reshape(-1, 4, 2)]


def _placed(xy: np.ndarray, turn: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the points of each module on the focal plane, shape (m, k, 2)."""
    cos, sin = np.cos(turn), np.sin(turn)
    matrix = np.stack([np.stack([cos, -sin], axis=1), np.stack([sin, cos], axis=1)], axis=1)
    return xy[:, None, :] + np.einsum("mab,kb->mka", matrix, points)


def _check_overlap(xy: np.ndarray, turn: np.ndarray, outline: np.ndarray) -> None:
    """Raise an error if the outlines of two modules overlap, because no edge of either of them separates them."""
    if len(outline) < 3:
        return
    shapes = _placed(xy, turn, outline)
    along = np.roll(shapes, -1, axis=1) - shapes
    normals = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    pairs = scipy.spatial.cKDTree(xy).query_pairs(2 * np.hypot(*outline.T).max(), output_type="ndarray")
    apart = np.zeros(len(pairs), dtype=bool)
    for first, second in (pairs.T, pairs.T[::-1]):
        axes = normals[first]
        far = np.einsum("pab,pcb->pac", axes, shapes[first]).max(axis=2)
        apart |= (np.einsum("pab,pcb->pac", axes, shapes[second]).min(axis=2) >= far - 1e-9 * np.abs(far)).any(axis=1)
    if not apart.all():
        i, j = pairs[~apart][0] + 1
        n = number_of(int((~apart).sum()), "pair")
        raise InputError(f"modules must not overlap, got {n} of modules that do, such as modules {i} and {j}")
