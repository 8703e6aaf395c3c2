"""The grid of kaiju, the planner of SDSS-V, with the geometry of this package; only for comparisons.

The module requires https://github.com/sdss/kaiju 1.4.1 (BSD license), of which it contains no code.
"""

import numpy as np

__all__ = ["make_grid", "set_poses"]


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
