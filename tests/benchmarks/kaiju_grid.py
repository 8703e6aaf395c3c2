"""The grid of kaiju, the planner of SDSS-V, with the geometry of this package; only for comparisons.

The module requires https://github.com/sdss/kaiju 1.4.1 (BSD license), of which it contains no code.
"""

import numpy as np

__all__ = ["forbidden", "make_grid", "make_path_grid", "set_poses"]


def make_grid(plane):
    """Return a grid whose arms collide like those of ``plane`` (a segment to the fiber, with the same separation)."""
    from kaiju.cKaiju import RobotGrid

    unit = plane.positioner
    l1, l2 = unit.central_arm.to_value("mm"), unit.eccentric_arm.to_value("mm")
    grid = RobotGrid(unit.step.to_value("deg"))
    for i, (x, y) in enumerate(plane.xy.to_value("mm")):
        # flat focal plane: no offsets, no tilt, unit scale
        axes, fiber, clearance = np.eye(3).tolist(), [l2, 0.0], unit.clearance.to_value("mm")
        place = i, str(i), [x, y, 0.0], *axes, [0.0, 0.0, 0.0]
        grid.addRobot(*place, l1, 0.0, 0.0, 143.0, 1.0, *[fiber] * 3, [[0.0, 0.0], fiber], True, clearance, False)
    grid.initGrid()
    return grid


def set_poses(grid, theta, phi):
    """Set the angles of the joints, in radians."""
    robots = grid.robotDict
    for i, (a, b) in enumerate(zip(np.rad2deg(theta) % 360, np.rad2deg(phi), strict=True)):
        robots[i].setAlphaBeta(a, b)


def make_path_grid(plane, step, seed=1, zero=0.0, fiducials=True):
    """Return a grid that plans paths in steps of ``step`` deg, with the capsules and the separation of ``plane``.

    The planners of kaiju keep a distance of two buffers plus the largest displacement in two steps. The buffer of the
    grid is chosen so that this distance is the minimum separation of ``plane``. ``zero`` is the direction (deg) of
    alpha = 0; it is -90 for SDSS-V. With this direction, kaiju forbids some poses near fiducials (`forbidden`).
    """
    from kaiju.cKaiju import RobotGrid

    grid, columns = RobotGrid(step, 2 * step, seed), plane.arrays
    l1, buffer = plane.positioner.central_arm.to_value("mm"), 0.5 * (columns.separation - grid.maxDisplacement)
    c, s = np.cos(np.deg2rad(zero)), np.sin(np.deg2rad(zero))
    axes, capsule = [[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]], [[0.0, 0.0], [float(columns.length), 0.0]]
    fibers = [[14.314, 0.0], [14.965, -0.376], [14.965, 0.376]]
    for i, (x, y) in enumerate(plane.xy.to_value("mm")):
        place = i, str(i), [x, y, 0.0], *axes, [0.0, 0.0, 0.0]
        grid.addRobot(*place, l1, 0.0, 0.0, 143.0, 1.0, *fibers, capsule, True, float(buffer), False)
    for k, (x, y, radius) in enumerate(columns.obstacles if fiducials else ()):
        grid.addFiducial(k, [x, y, 143.0], float(radius + columns.clearance - buffer))
    for i in near_fiducial(plane) if fiducials and zero == -90 else ():
        grid.robotDict[int(i)].fiducialWatch = True
    grid.initGrid()
    return grid


def near_fiducial(plane):
    """Return the positioners with an adjacent fiducial in the direction -60 deg."""
    (x, y), (u, v) = plane.xy.to_value("mm").T, plane.arrays.obstacles[:, :2].T
    pitch = np.hypot(x - x[0], y - y[0])[1:].min()
    away = np.hypot(u - x[:, None] - 0.5 * pitch, v - y[:, None] + 0.75**0.5 * pitch)
    return np.flatnonzero(away.min(axis=1) < 1.0)


def forbidden(plane, alpha, beta):
    """Return the positioners whose poses (deg, alpha from -90 deg) kaiju forbids near fiducials (fiducialWatch)."""
    rows = near_fiducial(plane)
    return rows[beta[rows] < 41.2853 - 1.3085 * alpha[rows]]
