"""The columns of a focal plane as read-only arrays without units (mm, radians), and data for collision kernels."""

from copy import copy
from functools import cached_property

import numpy as np

from rfpsurvey._common.units import locked, to_mm, to_points_mm, to_radian
from rfpsurvey._instruments.allowed import AllowedPoses, ArmSegments
from rfpsurvey._instruments.joints import MODELS, FiberOffsets, Joints, patrol_radii
from rfpsurvey._instruments.margins import FixedObstacles, to_polygons
from rfpsurvey._instruments.reach import Neighbors, Reach, accepted_types, find_reach, make_grid
from rfpsurvey._kernels import arms
from rfpsurvey._kernels import arms as reach

IN_USE = (
    "eccentric_arm",
    "equal_arms",
    "inner_radius",
    "outer_radius",
    "edges",
    "annuli",
    "geometry",
    "bounds",
    "angles",
)
"""Names of the arrays that depend on the fiber type that each positioner uses."""
SHARED = ("joints", "grid", "runs", "limits", "obstacle_pairs")
"""Names of the arrays that take long to compute and do not depend on the fiber type that each positioner uses."""


class FocalPlaneArrays(AllowedPoses, ArmSegments, FixedObstacles, Neighbors):
    """The columns of a focal plane as read-only arrays without units, in mm and radians.

    Each array is computed on first use and is then stored. Row i belongs to positioner i.

    Parameters
    ----------
    plane : FocalPlane
        The focal plane.

    Attributes
    ----------
    xy : ndarray of float, shape (n, 2)
        Centers of the positioners, mm.
    central_arm, eccentric_arm : ndarray of float, shape (n,)
        Arm lengths, mm. The eccentric arm is measured from the elbow to the fiber that the positioner uses.
    inner_radius, outer_radius : ndarray of float, shape (n,)
        Radii of the patrol area of the fiber that each positioner uses, without margins, mm.
    edges : tuple of two ndarray of float, shape (n,)
        Radii between which targets of each positioner may lie: the patrol area, reduced by the margins, mm.
    largest_radius : ndarray of float, shape (n,)
        Largest outer radius of the patrol areas of all fibers of each positioner, mm.
    equal_arms : ndarray of bool, shape (n,)
        Whether the two arms of each positioner have the same length.
    arm_reach : ndarray of float, shape (n,)
        Largest distance from the center of a positioner to a part of its arms that can collide, mm.
    usable : ndarray of bool, shape (n,)
        Whether each positioner may have a target: it is neither disabled nor stuck.
    stuck : ndarray of float, shape (n, 2)
        theta and phi of stuck positioners in radians, NaN for other positioners.
    is_stuck : ndarray of bool, shape (n,)
        Whether each positioner is stuck, that is, cannot move.
    obstacles : ndarray of float, shape (m, 3)
        Circles (x, y, radius) that no arm may touch, mm.
    obstacle_polygons : tuple of ndarray of float, shape (k, 2)
        Vertices of the convex polygons that no arm may touch, mm, in counter-clockwise order.
    hidden : ndarray of float, shape (k, 3)
        Circles (x, y, radius) where fibers receive no light, mm.
    first_type : ndarray of str, shape (n,)
        Fiber type that each positioner uses by default.
    first_index : ndarray of int, shape (n,)
        Index of ``first_type`` in ``fiber_types``.
    fiber_index : ndarray of int, shape (n,)
        Index in ``fiber_types`` of the fiber type that each positioner uses. It equals ``first_index``, unless the
        method `using` sets other indices.
    neighbors : ndarray of int, shape (k, 2)
        Row numbers of the pairs of positioners whose arms may collide, with a margin for rounding errors.
    obstacle_pairs : ndarray of int, shape (k, 2)
        Pairs (positioner, obstacle) that can touch, as row numbers; circles have lower numbers than polygons.
    n_sharing : ndarray of int, shape (n,)
        For each positioner, an upper limit of the number of other positioners whose patrol areas overlap its own.
    separation, clearance, length : float
        Minimum separation of two arms and clearance of an arm, including the margin ``arms``, and length of the segment
        that can collide, mm. The length is 0 for the arm models ``elbow_to_tip`` and ``fiber_tip``.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> arrays = rs.Instrument.preset("lamost").focal_plane.arrays
    >>> arrays.xy.shape, float(arrays.outer_radius[0]), len(arrays.neighbors)
    ((4000, 2), 16.5, 11769)
    """

    def __init__(self, plane):
        self.plane = plane
        numbers = plane.positioner.numbers
        margin = plane.margins.numbers["arms"]
        self.separation, self.clearance = numbers.separation + 2 * margin, numbers.clearance + margin
        self.model = MODELS[plane.positioner.arm_model]
        self.length = 0.0 if numbers.arm_length is None else numbers.arm_length

    @cached_property
    def xy(self) -> np.ndarray:
        return locked(to_points_mm(self.plane.xy, "xy"))

    @cached_property
    def central_arm(self) -> np.ndarray:
        plane = self.plane
        full = np.full(len(plane), plane.positioner.numbers.central_arm)
        return locked(full if plane.central_arm is None else to_mm(plane.central_arm, "central_arm"))

    @cached_property
    def eccentric_arm(self) -> np.ndarray:
        plane = self.plane
        if self.fibers is not None:
            return locked(self.fibers.length[self.fiber_index, np.arange(len(plane))])
        full = np.full(len(plane), plane.positioner.numbers.eccentric_arm)
        return locked(full if plane.eccentric_arm is None else to_mm(plane.eccentric_arm, "eccentric_arm"))

    @cached_property
    def equal_arms(self) -> np.ndarray:
        return locked(np.abs(self.central_arm - self.eccentric_arm) < arms.EQUAL_ARMS)

    @cached_property
    def inner_radius(self) -> np.ndarray:
        return locked(patrol_radii(self)[0])

    @cached_property
    def outer_radius(self) -> np.ndarray:
        return locked(patrol_radii(self)[1])

    @cached_property
    def annuli(self) -> np.ndarray:
        """Patrol areas of all positioners, in the form that the kernel ``reachable_pairs`` requires."""
        return locked(reach.annuli(self.geometry.cx, self.geometry.cy, *self.edges))

    @cached_property
    def fibers(self) -> FiberOffsets | None:
        """Positions of fibers relative to elbows; None if only the lengths of eccentric arms are given."""
        return None if self.plane.fiber_xy is None else FiberOffsets(self.plane, self.first_index)

    @cached_property
    def longest_arm(self) -> np.ndarray:
        """Largest distance from the elbow to a fiber that can observe targets, for each positioner."""
        return (
            self.eccentric_arm if self.fibers is None else self.fibers.length[: len(self.plane.fiber_types)].max(axis=0)
        )

    @cached_property
    def largest_radius(self) -> np.ndarray:
        return locked(self.central_arm + self.longest_arm)

    @cached_property
    def arm_reach(self) -> np.ndarray:
        outline, length = self.plane.positioner.outline, self.plane.positioner.numbers.arm_length
        if outline is not None:
            return locked(np.maximum(self.central_arm + outline.reach[0], outline.reach[1]))
        return locked(self.central_arm + (self.longest_arm if length is None else length))

    @cached_property
    def stuck(self) -> np.ndarray:
        plane = self.plane
        return locked(np.full((len(plane), 2), np.nan) if plane.stuck is None else to_radian(plane.stuck, "stuck"))

    @cached_property
    def is_stuck(self) -> np.ndarray:
        return locked(np.isfinite(self.stuck).all(axis=1))

    @cached_property
    def usable(self) -> np.ndarray:
        return locked(~self.plane.disabled & ~self.is_stuck)

    @cached_property
    def obstacles(self) -> np.ndarray:
        plane = self.plane
        return locked(np.empty((0, 3)) if plane.obstacles is None else to_mm(plane.obstacles, "obstacles"))

    @cached_property
    def obstacle_polygons(self) -> tuple[np.ndarray, ...]:
        return to_polygons(self.plane.obstacle_polygons)

    @cached_property
    def hidden(self) -> np.ndarray:
        plane = self.plane
        return locked(np.empty((0, 3)) if plane.hidden is None else to_mm(plane.hidden, "hidden"))

    @cached_property
    def first_type(self) -> np.ndarray:
        return locked(np.array([row.split("+")[0] for row in self.plane.fiber_type]))

    @cached_property
    def first_index(self) -> np.ndarray:
        return locked(np.array([self.plane.fiber_types.index(name) for name in self.first_type.tolist()]))

    def index_of(self, fiber_type: np.ndarray, own: np.ndarray | None = None) -> np.ndarray:
        """Return the index of each fiber type in ``fiber_types``; ``""`` means the first type of the positioner."""
        index = self.first_index.copy() if own is None else self.first_index[own]
        for k, name in enumerate(self.plane.fiber_types):
            index[fiber_type == name] = k
        return index

    @cached_property
    def fiber_index(self) -> np.ndarray:
        return self.first_index

    def using(self, fiber: np.ndarray | None) -> "FocalPlaneArrays":
        """Return the arrays for the case that positioner i uses fiber type number ``fiber[i]`` (None: no change)."""
        if fiber is None or np.array_equal(fiber, self.fiber_index):
            return self
        for name in SHARED:
            getattr(self, name)  # computed here, so that the copy does not compute it again
        arrays = copy(self)
        for name in IN_USE if self.fibers is not None else ("angles",):
            arrays.__dict__.pop(name, None)
        arrays.fiber_index = locked(fiber)
        return arrays

    @cached_property
    def offers(self) -> np.ndarray:
        """Bit mask of the fiber types of each positioner; 0 for positioners that cannot have a target."""
        plane = self.plane
        masks = dict.fromkeys(np.unique(plane.fiber_type).tolist(), 0)
        for row in masks:
            for name in row.split("+"):
                masks[row] |= 1 << plane.fiber_types.index(name)
        return np.where(self.usable, [masks[row] for row in plane.fiber_type], 0)

    @cached_property
    def grid(self) -> tuple:
        """Grid of square cells on the focal plane, with the positioners that reach into each cell."""
        return make_grid(self.xy, self.largest_radius)

    def reach(self, points: np.ndarray, fiber_type: np.ndarray | None = None) -> Reach:
        """Return the pairs of positioners and targets in reach; ``points`` are the positions of the targets in mm."""
        if self.any_hidden:
            points = np.where(self.is_hidden(points)[:, None], np.nan, points)
        return find_reach(self.plane, points, accepted_types(self.plane, fiber_type, len(points)))

    @cached_property
    def geometry(self) -> arms.Geometry:
        """Geometry of all positioners, in the form that the kernels for poses require."""
        plane = self.plane
        cx, cy = self.xy.T.copy()
        home = plane.positioner.numbers.home[0]
        lengths = self.central_arm.copy(), self.eccentric_arm.copy()
        return arms.Geometry(cx, cy, *lengths, float(np.cos(home)), float(np.sin(home)))

    def geometry_of(self, own: np.ndarray, fiber: np.ndarray | None = None) -> arms.Geometry:
        """Return the geometry of the positioners ``own``, given the indices of the fiber types that they use."""
        g = arms.Geometry(*(c[own] if isinstance(c, np.ndarray) else c for c in self.geometry))
        return g if fiber is None or self.fibers is None else g._replace(l2=self.fibers.length[fiber, own])

    @cached_property
    def bounds(self) -> arms.Bounds:
        """Lower and upper limits of the squared distance (mm^2) from the center to the fiber tip of each positioner."""
        return self.bounds_of(None)

    def bounds_of(
        self, own: np.ndarray | None, fiber: np.ndarray | None = None, side: np.ndarray | None = None
    ) -> arms.Bounds:
        """Return `bounds` for the positioners ``own`` with given fiber types and handedness (1: right, -1: left)."""
        inner, outer = patrol_radii(self, own, fiber, side)
        low = np.maximum(inner - self.reach_slack, 0.0) ** 2
        return arms.Bounds(low, (outer + self.reach_slack) ** 2, self.usable[self.rows_of(own, None)[0]])

    @cached_property
    def reach_slack(self) -> float:
        """Upper limit (mm) of the rounding error of the distance between fiber tip and center of a positioner."""
        return 1e-12 * float(self.largest_radius.max() + np.abs(self.xy).max())

    @cached_property
    def touch_slack(self) -> float:
        """Upper limit (mm) of the error of the distance between two extended arms, for arms of any length."""
        return 4 * (self.reach_slack + arms.EQUAL_ARMS)

    @cached_property
    def longest(self) -> float:
        """Upper limit (mm) of the length of a segment that can collide."""
        length = {arms.ELBOW_TO_TIP: self.longest_arm.max(), arms.CAPSULE: self.length, arms.FIBER_TIP: 0.0}[self.model]
        # arms of almost equal lengths are treated as arms of equal lengths, which displaces their elbow
        return (1.0 + 1e-12) * (float(length) + 2 * self.reach_slack + arms.EQUAL_ARMS)

    @cached_property
    def angles(self) -> tuple[np.ndarray, np.ndarray]:
        """Cosine and sine of the angle at the elbow from the fiber in use to the capsule axis, for each positioner."""
        return self.angles_of(np.arange(len(self.plane)), self.fiber_index)

    def angles_of(self, own: np.ndarray, fiber: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return cosine and sine of the angle at the elbow from fiber to capsule axis, for the positioners ``own``."""
        cosine, sine = self.plane.arrays._directions
        return (cosine[fiber], sine[fiber]) if self.fibers is None else (cosine[fiber, own], sine[fiber, own])

    @cached_property
    def _directions(self) -> tuple[np.ndarray, np.ndarray]:
        """Cosine and sine of `angles_of` for each fiber type and, if ``fibers`` is not None, for each positioner."""
        angle = self.plane.positioner.numbers.arm_angles(self.plane.fiber_types)
        if self.fibers is not None:
            angle = angle[:, None] - self.fibers.angle[: len(angle)]
        return np.cos(angle), np.sin(angle)

    @cached_property
    def joints(self) -> Joints | None:
        """Zero points and limits of joints; None if the focal plane has no columns for them and no ``fiber_xy``."""
        plane = self.plane
        given = plane.zero_points, plane.fiber_xy, plane.theta_range, plane.phi_range
        lengths = self.eccentric_arm[None] if self.fibers is None else self.fibers.length
        return None if all(v is None for v in given) else Joints(plane, self.fibers, self.central_arm, lengths)

    def to_joints(self, theta, phi, own=None, fiber=None) -> tuple[np.ndarray, np.ndarray]:
        """Convert angles from the convention of the kernels (see ``Joints``) to joint angles."""
        if self.joints is None:
            return theta, phi
        own, fiber = self.rows_of(own, fiber)
        return self.joints.from_kernel(theta, phi, own, fiber)

    def from_joints(self, theta, phi, own=None, fiber=None) -> tuple[np.ndarray, np.ndarray]:
        """Convert joint angles to the convention of the kernels (see ``Joints``)."""
        if self.joints is None:
            return theta, phi
        theta_zero, phi_zero = self.joints.zeros(*self.rows_of(own, fiber))
        return theta + theta_zero, phi + phi_zero

    def rows_of(self, own, fiber):
        """Return the rows ``own`` (None: all rows) and the fiber indices ``fiber`` (None: the fiber types in use)."""
        own = np.arange(len(self.plane)) if own is None else own
        return own, self.fiber_index[own] if fiber is None else fiber

    @cached_property
    def home(self) -> np.ndarray:
        """Joint angles theta and phi of parked positioners in radians, shape (2, n)."""
        numbers = self.plane.positioner.numbers
        if self.joints is None:
            return np.repeat(numbers.home[:, None], len(self.plane), axis=1)
        return self.joints.home(numbers.home, self.first_index, folded=self.plane.positioner.home is None)
