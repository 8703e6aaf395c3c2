"""Positioners with outlines and capsules, and arms with outlines as shapes of shapely."""

import astropy.units as u
import numpy as np
import shapely

import rfpsurvey as rs

WEDGE = [[0, -0.9], [3.2, -0.8], [3.4, 0.0], [3.2, 0.8], [0, 0.9]] * u.mm
HEEL = ([[0.1, -1.0], [0.1, -2.0], [1.0, -1.7]] * u.mm, 0.05 * u.mm)
BODY = [[5.0, -0.5], [4.4, -2.5], [1.8, -2.8], [0.9, -0.4]] * u.mm
DISC = ([[3.0, 0.0]] * u.mm, 2.1 * u.mm)
DESI_LIKE = rs.Positioner(
    3 * u.mm,
    3 * u.mm,
    0.1 * u.mm,
    arm_model="outline",
    outline=rs.positioner.ArmOutline(eccentric=(WEDGE, HEEL), central=(BODY, DISC)),
)


def capsule(b, a, length=14.7, arm=15):
    """Return a positioner whose fibers B and A are at the angles ``b`` and ``a`` (deg) from the axis of a capsule."""
    angles = {"B": b * u.deg, "A": a * u.deg}
    lengths = 7.4 * u.mm, arm * u.mm, 2 * u.mm
    return rs.Positioner(*lengths, arm_model="capsule", arm_length=length * u.mm, arm_angle=angles)


def placed(unit: rs.Positioner, center, elbow, tip) -> tuple[shapely.Geometry, shapely.Geometry]:
    """Return the eccentric and the central arm as shapes of shapely."""
    shapes = []
    for parts, origin, end in ((unit.outline.eccentric, elbow, tip), (unit.outline.central, center, elbow)):
        ux, uy = (end - origin) / np.hypot(*(end - origin))
        found = []
        for part in parts:
            vertices, radius = part if isinstance(part, tuple) else (part, 0 * u.mm)
            points = vertices.to_value(u.mm) @ np.array([[ux, uy], [-uy, ux]]) + origin
            core = shapely.Point(points[0]) if len(points) == 1 else shapely.MultiPoint(points).convex_hull
            found.append((core, radius.to_value(u.mm)))
        shapes.append(found)
    return tuple(shapes)
