"""Hexagonal lattices."""

import astropy.units as u
import numpy as np

from rfpsurvey._units import to_numbers, to_scalar
from rfpsurvey.errors import InputError, check_whole, items_of, refusal, short


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
