"""Scenes for paths of arms, and the arms of a table of paths at any time, by plain geometry."""

import astropy.units as u
import numpy as np
import shapely
from moving import MovingArm, ends, outline_distance, outline_parts, refined, segment_distance
from outlined import DESI_LIKE, capsule

import rfpsurvey as rs

MM, DEG = u.mm, u.deg
CLUSTERED = {  # targets per positioner, fraction of targets in clusters, seed
    "uniform 1a": (1, 0.0, 211),
    "uniform 1b": (1, 0.0, 212),
    "uniform 2a": (2, 0.0, 213),
    "uniform 2b": (2, 0.0, 214),
    "uniform 5a": (5, 0.0, 215),
    "uniform 5b": (5, 0.0, 216),
    "clustered 1": (1, 0.6, 217),
    "clustered 2a": (2, 0.6, 218),
    "clustered 2b": (2, 0.6, 219),
    "clustered 5": (5, 0.6, 220),
}


def targets(plane, name):
    """Return random targets (mm) for a scene: uniform, or many of them in clusters of the size of half the pitch."""
    per_positioner, clustered, seed = CLUSTERED[name]
    rng, n = np.random.default_rng(seed), per_positioner * len(plane)
    radius = np.hypot(*plane.xy.value.T).max() + 20
    xy, centers = (_in_circle(rng, k, radius) for k in (n, n // 20))
    members = np.flatnonzero(rng.random(n) < clustered)
    xy[members] = centers[rng.integers(len(centers), size=len(members))] + rng.normal(0, 11, (len(members), 2))
    return xy * MM


def _in_circle(rng, n, radius):
    r, angle = radius * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle)])


def _hexagonal(unit, pitch, **columns):
    plane = rs.FocalPlane.hexagonal(unit, rings=2, pitch=pitch * MM)
    return rs.FocalPlane(plane.xy, unit, **columns)


def _capsules():
    return _hexagonal(capsule(2, -3, length=14.5), 22.4, fiber_type=["B+A"] * 10 + ["A+B"] * 9)


def _as_built(rng):
    """Return positioners with zero points, joint limits, arm lengths and fibers of their own."""
    unit, n = rs.Positioner(7.4 * MM, 15 * MM, 2 * MM), 19
    theta, low = rng.uniform(-180, 180, n), rng.uniform(-5, 0, n)
    return _hexagonal(
        unit,
        22.4,
        central_arm=rng.normal(7.4, 0.05, n) * MM,
        fiber_xy=rng.normal([14.9, 0.4], 0.05, (n, 2)) * MM,
        zero_points=np.column_stack([theta, rng.normal(0, 2, n)]) * DEG,
        theta_range=np.column_stack([rng.uniform(-190, -180, n), rng.uniform(180, 200, n)]) * DEG,
        phi_range=np.column_stack([low, rng.uniform(180, 190, n)]) * DEG,
    )


def _troubles(unit, pitch, scale=1.0):
    """Return a plane with stuck and disabled positioners, and obstacles."""
    stuck = np.full((19, 2), np.nan)
    stuck[[4, 12]] = [40, 110], [-100, 90]
    half = 0.5 * pitch
    wall = np.array([[-30, 2.1 * pitch], [30, 2.1 * pitch], [30, 2.2 * pitch], [-30, 2.2 * pitch]])
    obstacles = [[half, pitch / np.sqrt(12), 1.2 * scale], [-pitch, pitch / np.sqrt(3), 0.8 * scale]]
    disabled = np.arange(19) == 7
    return _hexagonal(
        unit, pitch, stuck=stuck * DEG, disabled=disabled, obstacles=obstacles * MM, obstacle_polygons=[wall * MM]
    )


def _part_of(name):
    """Return 19 neighboring positioners of a preset."""
    plane = rs.Instrument.preset(name).focal_plane
    xy = plane.xy.to_value(MM)
    rows = np.argsort(np.hypot(*(xy - xy[len(xy) // 3]).T), kind="stable")[:19]
    return rs.FocalPlane(plane.xy[np.sort(rows)], plane.positioner)


SEGMENT = rs.Positioner(7.4 * MM, 15 * MM, 1.5 * MM, step=0.1 * DEG)
SMALL = {
    "segments": lambda: _hexagonal(SEGMENT, 22.4),
    "crowded": lambda: _hexagonal(rs.Positioner(11 * MM, 17 * MM, 2 * MM), 20),
    "left": lambda: _hexagonal(rs.Positioner(7.4 * MM, 15 * MM, 1.5 * MM, handedness="left"), 22.4),
    "both hands": lambda: _hexagonal(rs.Positioner(8 * MM, 8 * MM, 2 * MM, handedness="both"), 25),
    "equal arms": lambda: _hexagonal(rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM), 25.6),
    "capsules": _capsules,
    "fiber tips": lambda: _hexagonal(rs.Positioner(7.4 * MM, 15 * MM, 2.2 * MM, arm_model="fiber_tip"), 22.4),
    "outlines": lambda: _hexagonal(DESI_LIKE, 9.5),
    "as built": lambda: _as_built(np.random.default_rng(5)),
    "desi": lambda: _part_of("desi"),
    "pfs": lambda: _part_of("pfs"),
    "moons": lambda: _part_of("moons"),
    "troubles": lambda: _troubles(SEGMENT, 22.4),
    "troubles of outlines": lambda: _troubles(DESI_LIKE, 9.5, 0.4),
}


class Replay:
    """The arms of a table of paths at any time, from the columns of the table and of the focal plane."""

    def __init__(self, plane, table, motion="fold"):
        self.plane, self.unit, n = plane, plane.positioner, len(plane)
        self.rows = {str(key): table[(table["motion"] == motion) & (table["positioner"] == key)] for key in plane.id}
        # the angles of arms that are absent are NaN
        self.present = np.flatnonzero([np.isfinite(self.rows[str(key)]["theta"].value).any() for key in plane.id])
        self.xy = plane.xy.to_value(MM)
        self.l1 = np.full(n, self.unit.central_arm.value) if plane.central_arm is None else plane.central_arm.value
        zero = np.zeros((n, 2)) if plane.zero_points is None else plane.zero_points.to_value(u.rad)
        self.zero, self.fiber = zero, np.column_stack([np.full(n, self.unit.eccentric_arm.to_value(MM)), np.zeros(n)])
        if plane.fiber_xy is not None:
            given = plane.fiber_xy
            self.fiber = (next(iter(given.values())) if isinstance(given, dict) else given).to_value(MM)
        self.axis, self.inner, self.length = np.zeros(n), np.zeros(n), np.hypot(*self.fiber.T)
        if self.unit.arm_model in ("capsule", "outline"):
            shape, given = self.unit.outline, self.unit.arm_angle
            self.length[:] = (self.unit.arm_length if shape is None else shape.length).to_value(MM)
            for i in self.present:
                row = self.rows[str(plane.id[i])]
                name = row["fiber_type"][0] if "fiber_type" in row.colnames else plane.fiber_type[i]
                angle = given[str(name)] if isinstance(given, dict) else given
                self.axis[i] = 0.0 if angle is None else angle.to_value(u.rad)
        else:
            self.axis = np.arctan2(*self.fiber.T[::-1])
            if self.unit.arm_model == "fiber_tip":
                self.inner = self.length.copy()
        self.duration = float(max(row["time"][-1].to_value(u.s) for row in self.rows.values() if len(row)))

    def angles(self, i, t):
        """Return theta and phi of a joint (rad) at the times t, from 0 to 1."""
        row = self.rows[str(self.plane.id[i])]
        when = row["time"].to_value(u.s)
        return [np.interp(t * self.duration, when, row[name].to_value(u.rad)) for name in ("theta", "phi")]

    def arm(self, i, t):
        """Return the positions of the elbow and the directions of the eccentric arm."""
        theta, phi = self.angles(i, t)
        theta = theta + self.zero[i, 0]
        elbow = (self.xy[i, k] + self.l1[i] * way(theta) for k, way in enumerate((np.cos, np.sin)))
        return *elbow, theta + phi + self.zero[i, 1]

    def tip(self, i, t):
        """Return the positions of the fiber."""
        x, y, psi = self.arm(i, t)
        c, s, (fx, fy) = np.cos(psi), np.sin(psi), self.fiber[i]
        return np.stack([x + c * fx - s * fy, y + s * fx + c * fy], axis=-1)

    def moving(self, i, t):
        x, y, psi = self.arm(i, t)
        return MovingArm(x, y, 0.0, 0.0, self.inner[i], self.length[i], i), psi + self.axis[i]

    def segment(self, i, t):
        arm, psi = self.moving(i, t)
        return ends(arm.x, arm.y, psi, arm.inner, arm.length)

    def rates(self, i):
        """Return the largest rates of theta and phi, rad / s."""
        row = self.rows[str(self.plane.id[i])]
        when = np.diff(row["time"].to_value(u.s))
        return [np.abs(np.diff(row[name].to_value(u.rad)) / when).max() for name in ("theta", "phi")]

    def speed(self, i):
        """Return a limit of the speed (mm / duration) of all points of an arm."""
        theta, phi = self.rates(i)
        reach = self.length[i] if self.unit.outline is None else 1.5 * max(self.unit.outline.reach)
        return self.duration * (self.l1[i] * theta + reach * (theta + phi))

    def closest(self, n, within=0.5):
        """Return the least distances of all pairs of arms that can meet; those below ``within`` plus D are refined."""
        found, times = {}, np.linspace(0, 1, n)
        outlined = self.unit.outline is not None
        limit = self.unit.min_separation.to_value(MM) + within
        reach = self.l1 + (max(self.unit.outline.reach) if outlined else self.length)
        lines = {}
        if not outlined:
            lines = {i: shapely.linestrings(self.segment(i, times)) for i in self.present}
        tree = shapely.STRtree(shapely.points(self.xy[self.present]))
        for i in self.present:
            for j in self.present[tree.query(shapely.Point(self.xy[i]), "dwithin", distance=2 * reach.max() + limit)]:
                if j <= i:
                    continue
                gaps = self.outline_gap(i, j, times) if outlined else shapely.distance(lines[i], lines[j])
                least = gaps.min()
                if least < limit:

                    def at(t, i=i, j=j):
                        if outlined:
                            return self.outline_gap(i, j, t)
                        return segment_distance(self.segment(i, t), self.segment(j, t))

                    least = min(least, refined(at, times, self.speed(i) + self.speed(j), 1))
                found[i, j] = least
        return found

    def outline_gap(self, i, j, t):
        (one, a), (two, b) = self.moving(i, t), self.moving(j, t)
        return outline_distance(self.plane, one, two, a, b)

    def to_obstacles(self, n=1000):
        """Return the least distance from an arm to an obstacle."""
        times, least = np.linspace(0, 1, n), np.inf
        circles = () if self.plane.obstacles is None else self.plane.obstacles.to_value(MM)
        shapes = [(shapely.Point(x, y), r) for x, y, r in circles]
        shapes += [(shapely.Polygon(polygon.to_value(MM)), 0.0) for polygon in self.plane.obstacle_polygons or ()]
        for i in self.present:
            if self.unit.outline is None:
                parts = [(shapely.linestrings(self.segment(i, times)), 0.0, True)]
            else:
                parts = outline_parts(self.plane, *self.moving(i, times))
            for shape, radius in shapes:
                gaps = [shapely.distance(part, shape).min() - radius - size for part, size, _ in parts]
                least = min(least, *gaps)
        return least


def dense_plane(seed, rings=2):
    """Return positioners whose arms reach 1.8 times their distance, and targets (mm) with priorities from 1 to 3."""
    unit, rng = rs.Positioner(14 * MM, 16.6 * MM, 1.5 * MM), np.random.default_rng(seed)
    plane = rs.FocalPlane.hexagonal(unit, rings=rings, pitch=17 * MM)
    xy = _in_circle(rng, 2 * len(plane), 17 * rings + 25)
    return plane, xy * MM, rng.integers(1, 4, len(xy))
