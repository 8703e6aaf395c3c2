"""Paths of all arms, with the proof that no arms collide on them."""

import os
from dataclasses import dataclass, field, replace
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.table import QTable, Table, vstack

from rfpsurvey._common import io as _io
from rfpsurvey._common.descriptions import to_html
from rfpsurvey._common.files import has_ending, to_path
from rfpsurvey._common.read_tables import import_parquet, read_table
from rfpsurvey._common.units import check_columns, to_flags, to_plain, to_radian, to_unit
from rfpsurvey._instruments import moves as _moves
from rfpsurvey._instruments.arms import check_plane
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.path_arms import bodies_of
from rfpsurvey._kernels import joint_motion
from rfpsurvey.errors import InputError, listed, number_of

BEYOND = 1.0
"""Distances that exceed the minimum separation by more than this (mm) are not distinguished."""
WITHIN = 1e-3
"""Largest error (mm) of the smallest distance."""
MOST = np.deg2rad(36_000.0)
"""Largest angle (rad) of a joint; the time of the proof increases with the angles."""
COLUMNS = ("motion", "positioner", "time", "theta", "phi", "arrives", "assigned")
"""Columns of a table of paths that must exist."""


@dataclass(frozen=True, eq=False)
class Paths:
    """Paths of all arms from a plan to the folded poses, on which no arms collide.

    The path of an arm consists of straight pieces between break points: between two break points, both joints rotate at
    constant rates. When an object of this class is made, the paths are proven: at all times, all arms are farther from
    each other than the minimum separation, and farther from obstacles than the clearance. The proof refers to the
    geometry of the focal plane. It does not cover corrections of the positions of the fibers by a camera at the end.

    Parameters
    ----------
    focal_plane : FocalPlane
        The n positioners.
    start : ndarray of int, shape (n + 1,)
        The break points of positioner i are ``start[i]`` to ``start[i + 1] - 1``.
    time : Quantity, shape (k,)
        Time of each break point; the first time of all positioners is 0, and the last is the same.
    theta, phi : Quantity, shape (k,)
        Joint angles; phi is that of the fiber in ``fiber``. The angles are NaN for arms that are absent.
    arrives : ndarray of bool, shape (n,)
        Whether each arm that can move is folded at the end.
    assigned : ndarray of bool, shape (n,)
        Whether each positioner has a target.
    fiber : ndarray of int, shape (n,)
        Index in ``focal_plane.fiber_types`` of the fiber type that each positioner uses.
    groups : tuple of (list of str, str), optional
        The groups of positioners whose arms do not arrive, with a reason.
    meta : dict, optional
        How the paths were planned.

    Raises
    ------
    InputError
        If arms come too close to each other or to obstacles, if arms exceed their joint limits, if broken arms move, if
        times do not increase, or if angles of arms with a target are not finite.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8 * u.mm, 17 * u.mm, 2 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25, 0]] * u.mm, robot)
    >>> paths = rs.collision.find_paths(plane, [[16, -12], [14, 12]] * u.mm)
    >>> paths
    <Paths: 2 of 2 arms with a target arrive in 22.2 s, smallest distance 4.111 mm>
    """

    focal_plane: FocalPlane
    start: np.ndarray
    time: u.Quantity
    theta: u.Quantity
    phi: u.Quantity
    arrives: np.ndarray
    assigned: np.ndarray
    fiber: np.ndarray
    groups: tuple = ()
    meta: dict = field(default_factory=dict)

    def __post_init__(self):
        check_plane(self.focal_plane)
        columns, ids, knots = self._columns, self.focal_plane.id, self._knots
        pairs = near_pairs(knots, self._bodies, columns)
        if len(pairs):
            i, j = pairs[0]
            raise InputError(
                f"the arms of a path must not collide, but {number_of(len(pairs), 'pair')} of arms "
                f"come closer than the minimum separation, {columns.separation:.4g} mm; the first are those of the "
                f"positioners {ids[i]} and {ids[j]}"
            )
        hits = columns.obstacle_pairs[near_obstacles(knots, self._bodies, columns)]
        if len(hits):
            raise InputError(
                f"the arms of a path must not touch obstacles, but {number_of(len(hits), 'pair')} of an arm and an "
                f"obstacle come closer than the clearance; the first is that of the positioner {ids[hits[0, 0]]}"
            )
        moved, beyond = self._outside_limits()
        if moved.any():
            raise InputError(
                f"the arms of broken positioners must remain in their poses, but {number_of(int(moved.sum()), 'path')} "
                f"of broken positioners differ from them; the first is that of the positioner "
                f"{ids[int(np.argmax(moved))]}"
            )
        if beyond.any():
            n = number_of(int(beyond.sum()), "arm")
            raise InputError(
                f"the joint angles of a path must be within the joint limits, but {n} exceed them; the first is that "
                f"of the positioner {ids[int(np.argmax(beyond))]}"
            )

    @cached_property
    def _columns(self):
        return self.focal_plane.arrays.using(self.fiber)

    @cached_property
    def _sizes(self):
        """The sizes of all arms, and the angles from the fibers to the axes of the arms."""
        return bodies_of(self._columns, np.arange(len(self.fiber)), self.fiber)

    @property
    def _bodies(self):
        return self._sizes[0]

    @cached_property
    def _owner(self):
        return np.repeat(np.arange(len(self.fiber)), np.diff(self.start))

    @cached_property
    def _knots(self) -> joint_motion.Knots:
        """The paths in the convention of the kernels."""
        n, columns, owner = len(self.focal_plane), self._columns, self._owner
        time = to_unit(self.time, u.s, "time")
        angles = to_radian(self.theta, "theta"), to_radian(self.phi, "phi")
        theta, phi = columns.from_joints(*angles, owner, self.fiber[owner])
        first, last = self.start[:-1], self.start[1:] - 1
        inner = np.diff(time)[np.diff(owner) == 0]
        if (last <= first).any() or (time[first] != 0).any() or np.ptp(time[last]) > 0 or not (inner > 0).all():
            raise InputError(
                "the times of each positioner must increase from 0 s to the same last time, with at least two times"
            )
        finite, absent = (np.abs(angles) <= MOST).all(axis=0), np.isnan(angles).all(axis=0)
        finite, absent = (np.bincount(owner, kind, minlength=n) for kind in (finite, absent))
        bad = np.where(self.arrives | self.assigned, finite, np.maximum(finite, absent)) < np.diff(self.start)
        if bad.any():
            raise InputError(
                f"the joint angles of a path must be at most {np.rad2deg(MOST):.0f} deg, or all NaN for an absent arm "
                f"without a target, but those of {number_of(int(bad.sum()), 'positioner')} are not; the first is the "
                f"positioner {self.focal_plane.id[int(np.argmax(bad))]}"
            )
        return joint_motion.Knots(first.copy(), last + 1, time, theta, theta + phi + self._sizes[1][owner])

    def _outside_limits(self):
        """Return which positioners that cannot move leave their fixed pose, and which arms exceed the joint limits."""
        columns, owner, rows = self._columns, self._owner, np.arange(len(self.fiber))
        (moved, beyond), first = np.zeros((2, len(rows)), dtype=bool), self.start[:-1][owner]
        for k, name in enumerate(("theta", "phi")):
            joint, fixed = getattr(self, name).to_value(u.rad), columns.stuck[owner, k]
            away = np.where(columns.is_stuck[owner], np.abs(np.sin(0.5 * (joint - fixed))), 0.0)
            moves = (np.abs(joint - joint[first]) > 1e-9) | (away > 1e-6)  # false for arms that are absent
            moved[owner[moves & ~columns.usable[owner]]] = True
            low, high = (v[owner] for v in _moves.limits_of(columns, rows, k, f"{name}_range"))
            free = np.isinf(low) | ~columns.usable[owner] | np.isnan(joint)
            beyond[owner[~free & ((joint < low - 1e-6) | (joint > high + 1e-6))]] = True
        return moved, beyond

    @property
    def n_arriving(self) -> int:
        """Number of arms with a target that are folded at the end."""
        return int((self.arrives & self.assigned).sum())

    @property
    def duration(self) -> u.Quantity:
        """Duration of the motion."""
        return self.time[-1]

    @cached_property
    def smallest_distance(self) -> u.Quantity:
        """Lower limit of the distance of two arms on the whole paths, at most 0.001 mm below the smallest distance.

        Distances that exceed the minimum separation by more than 1 mm are not distinguished.
        """
        limits, pairs = self._columns.limits, _movable(self._columns)
        low, high = limits.separation, limits.separation + BEYOND
        middle = high
        while high - low > WITHIN:
            near = np.empty(len(pairs))
            joint_motion.find_near(self._knots, self._bodies, limits, pairs, middle, near)
            if not (near < np.inf).any():
                low = middle
            else:
                pairs, high = pairs[near < np.inf], min(near.min(), middle)
            middle = 0.5 * (low + high)
        return (low - limits.outline.offset) * u.mm

    @cached_property
    def table(self) -> QTable:
        """Table with a row for each break point of each arm, of the motion to the plan and of the motion to the folds.

        Columns: ``motion`` (``unfold``: from the folded poses to the plan; ``fold``: the exact reversal),
        ``positioner`` (identifier), ``fiber_type`` (if there are several), ``time`` (s), ``theta``, ``phi`` (deg),
        ``arrives`` and ``assigned``. The angles of arms that are absent are NaN.
        """
        owner, plane = self._owner, self.focal_plane
        columns = {"positioner": np.asarray(plane.id)[owner]}
        if len(plane.fiber_types) > 1:
            columns["fiber_type"] = np.array(plane.fiber_types)[self.fiber][owner]
        columns |= {"time": self.time.to(u.s), "theta": self.theta.to(u.deg), "phi": self.phi.to(u.deg)}
        columns |= {"arrives": self.arrives[owner], "assigned": self.assigned[owner]}
        fold = QTable({"motion": np.full(len(owner), "fold"), **columns})
        order = np.argsort(owner[::-1], kind="stable")
        unfold = fold[::-1][order]
        unfold["motion"] = np.full(len(unfold), "unfold")
        unfold["time"] = self.duration.to(u.s) - unfold["time"]
        table = vstack([unfold, fold])
        table.meta = {**self.meta, "groups": [[*ids, reason] for ids, reason in self.groups]}
        return table

    def write(self, path: str | os.PathLike, *, overwrite: bool = False) -> None:
        """Write the table of the paths as FITS, ECSV or Parquet.

        Parameters
        ----------
        path : str or path-like
            Path that ends in ``.fits``, ``.ecsv`` or ``.parquet``.
        overwrite : bool, optional
            Whether to replace an existing file.

        Raises
        ------
        InputError
            If the folder does not exist, if the file exists and ``overwrite`` is False, or if pyarrow is not installed.
        """
        if not has_ending(to_path(path), (".parquet",)):
            _io.write_table(self.table, path, overwrite=overwrite, name="PATHS")
            return
        import_parquet()
        with _io.writing_to(path, (".parquet",), overwrite=overwrite) as new_path:
            self.table.write(new_path, format="parquet")

    @classmethod
    def read(cls, path: str | os.PathLike, focal_plane: FocalPlane) -> "Paths":
        """Read and prove the paths of a file that `write` wrote.

        Parameters
        ----------
        path : str or path-like
            Path of the file.
        focal_plane : FocalPlane
            The positioners.

        Returns
        -------
        Paths
            The paths.

        Raises
        ------
        InputError
            If the file contains no paths, or paths of another focal plane, or if the proof fails.
        """
        return cls.from_table(read_table(path), focal_plane)

    @classmethod
    def from_table(cls, table: Table, focal_plane: FocalPlane) -> "Paths":
        """Return the paths of a table such as `table`, after a proof of both motions.

        Parameters
        ----------
        table : Table
            Table with the columns of `table`; ``fiber_type`` is optional.
        focal_plane : FocalPlane
            The positioners.

        Returns
        -------
        Paths
            The paths.

        Raises
        ------
        InputError
            If columns or positioners are missing, if the motions differ, or if the proof fails.
        """
        check_plane(focal_plane)
        check_columns(table.colnames, COLUMNS, "the table of paths")
        motion = to_plain(table["motion"], "motion").astype(str)
        both = [cls._from_rows(table[motion == name], focal_plane, name, table.meta) for name in ("fold", "unfold")]
        back = both[1]._reversed()
        if not (np.array_equal(back.start, both[0].start) and all(_close(both[0], back, k) for k in COLUMNS[2:5])):
            raise InputError("the motion unfold must be the exact reversal of the motion fold")
        return both[0]

    @classmethod
    def _from_rows(cls, table, plane, name, meta):
        if len(table) == 0:
            raise InputError(f"the table of paths must have rows with the motion {name!r}, got none")
        rows = {str(key): k for k, key in enumerate(plane.id)}
        given = to_plain(table["positioner"], "positioner").astype(str)
        unknown = sorted({key for key in given if key not in rows})
        if unknown:
            raise InputError(
                f"the paths must belong to the {len(plane)} positioners of the focal plane, which has no positioners "
                f"{listed(unknown[:5])}"
            )
        missing = sorted(set(rows) - set(given))
        if missing:
            raise InputError(f"the paths must contain all positioners; {listed(missing[:5])} are missing")
        owner = np.array([rows[key] for key in given])
        units = u.s, u.rad, u.rad
        time, theta, phi = (_to_unit(table[key], unit, key) for key, unit in zip(COLUMNS[2:5], units, strict=True))
        order = np.lexsort((time, owner))
        start = np.searchsorted(owner[order], np.arange(len(plane) + 1))
        first = order[start[:-1]]
        arrives, assigned = (to_flags(table[key], key)[first] for key in COLUMNS[5:])
        fiber = plane.arrays.first_index
        if "fiber_type" in table.colnames:
            fiber = plane.arrays.index_of(to_plain(table["fiber_type"], "fiber_type").astype(str)[first])
        angles = (np.rad2deg(v[order]) << u.deg for v in (theta, phi))
        groups = meta.get("groups", [])
        if not isinstance(groups, list) or not all(isinstance(g, list) and len(g) > 1 for g in groups):
            raise InputError(f"the entry groups of the paths must be lists of identifiers and a reason, got {groups}")
        groups = tuple(([str(i) for i in ids], str(reason)) for *ids, reason in groups)
        return cls(plane, start, time[order] << u.s, *angles, arrives, assigned, fiber, groups, dict(meta))

    def _reversed(self):
        """Return the same paths in the opposite direction."""
        owner = self._owner[::-1]
        order = np.argsort(owner, kind="stable")
        time, theta, phi = (v[::-1][order] for v in (self.duration - self.time, self.theta, self.phi))
        return replace(self, time=time, theta=theta, phi=phi)

    def _repr_html_(self) -> str:
        facts = {"arms with a target that arrive": self.n_arriving, "duration": self.duration}
        return to_html(self, {**facts, "smallest distance": self.smallest_distance}, self.table)

    def __repr__(self):
        n = number_of(int((self.assigned & self._columns.usable).sum()), "arm")
        return (
            f"<Paths: {self.n_arriving} of {n} with a target arrive in {self.duration.to_value(u.s):.1f} s, "
            f"smallest distance {self.smallest_distance.to_value(u.mm):.3f} mm>"
        )


def _to_unit(column, unit, name):
    """Return the values of a column in a unit; a column of a file without units is in s or deg."""
    known = getattr(column, "unit", None) is not None
    return to_unit(column if known else np.asarray(column) << (u.s if unit == u.s else u.deg), unit, name)


def _close(first, second, name):
    """Return whether a column of two paths differs only by rounding."""
    a, b = getattr(first, name), getattr(second, name).to(getattr(first, name).unit)
    return np.allclose(a.value, b.value, rtol=0, atol=1e-9, equal_nan=True)


def near_pairs(knots, bodies, columns) -> np.ndarray:
    """Return the pairs of positioners whose arms come closer than the minimum separation on their paths.

    Pairs of broken positioners, which do not move, are omitted.
    """
    pairs, limits = _movable(columns), columns.limits
    near = np.empty(len(pairs))
    joint_motion.find_near(knots, bodies, limits, pairs, limits.separation, near)
    return pairs[near < np.inf]


def near_obstacles(knots, bodies, columns) -> np.ndarray:
    """Return which pairs (arm, obstacle) come closer than the clearance on the paths of the arms."""
    pairs = columns.obstacle_pairs
    near = np.empty(len(pairs))
    joint_motion.find_near_obstacles(knots, bodies, columns.limits, pairs, columns.obstacles, columns.clearance, near)
    return (near < np.inf) & columns.usable[pairs[:, 0]]


def _movable(columns):
    """Return the pairs of neighbors of which at least one is usable."""
    return columns.neighbors[columns.usable[columns.neighbors].any(axis=1)]
