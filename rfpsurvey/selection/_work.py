"""Plan one tile for all realizations of a block, which is a group of realizations that are planned together."""

from typing import NamedTuple

import astropy.units as u
import numpy as np

from rfpsurvey._kernels import arms
from rfpsurvey._kernels import realizations as kernels
from rfpsurvey.collision import find_collisions, make_setup, make_workspace
from rfpsurvey.focal_plane import FocalPlaneArrays, Reach, elbow_names
from rfpsurvey.pipeline import apply_constraints, project_field
from rfpsurvey.selection._rules import RULES, Field
from rfpsurvey.survey import Job, projection_of, work

__all__ = ["BlockDone", "BlockJob", "Poses", "find_reach", "plan_alone", "plan_together", "reach_counts"]


class BlockJob(NamedTuple):
    """The input of `plan_together` and `plan_alone`: one tile, and the realizations for which it is planned."""

    job: Job
    """The tile and its field, which contains the targets with remaining visits in at least one realization."""
    tile: int
    """Row of the tile in the tiling."""
    left: np.ndarray
    """Remaining visits of each target of the field, shape (n, n_realizations)."""
    seeds: tuple[int, ...]
    """Seed of each realization."""


class BlockDone(NamedTuple):
    """The result of `plan_together` and `plan_alone`: the visits of a tile in each realization."""

    mask: np.ndarray
    """For each target of the field, a mask whose bit r is 1 if realization r visits the target."""
    counts: np.ndarray
    """For each realization, the number of positioners with a target, and the number of targets lost to a collision."""


def plan_together(given: BlockJob) -> BlockDone:
    """Plan a tile for all realizations of a block; the pairs in reach and the poses of arms are computed once."""
    job, n = given.job, len(given.seeds)
    instrument, columns, pairs, xy, fiber_type = find_reach(job)
    plane = instrument.focal_plane
    mask, counts = np.zeros(len(given.left), dtype=np.uint32), np.zeros((n, 2), dtype=np.int64)
    field = Field.of(columns, pairs, job.field.targets, given)
    if len(field.pairs.owner) == 0:
        return BlockDone(mask, counts)
    chosen = np.empty((n, len(plane)), dtype=np.int64)
    RULES[job.model.options.allocator](field, chosen)
    lost = np.zeros(chosen.shape, dtype=bool)
    if job.model.lost_in_collision:
        poses = Poses(plane, columns, xy, fiber_type, field.pairs, job.model.options.parked_obstacles)
        poses.find_lost(chosen, lost)
    kernels.mark_visits(chosen, lost, field.pairs.target, mask, counts)
    return BlockDone(mask, counts)


def find_reach(job: Job):
    """Return the pairs of positioners and targets in reach, with the data from which they are computed.

    The returned tuple contains the instrument, including the obstacles of constraints; the arrays of
    its focal plane; the pairs; the positions (mm) of the targets on the focal plane; and the fiber types that the
    targets require, or None.
    """
    projection, model = projection_of(job), job.model
    targets = job.field.targets
    applied = apply_constraints(model.instrument, projection, model.options, targets)
    instrument, columns = applied.instrument, applied.instrument.focal_plane.arrays
    xy, fiber_type = project_field(instrument, projection, targets.vectors, targets.columns.fiber_type)
    pairs = columns.reach(xy, fiber_type)
    pairs = pairs if applied.excluded is None else pairs.where(~applied.excluded[pairs.target])
    return instrument, columns, pairs, xy, fiber_type


def reach_counts(job: Job) -> np.ndarray:
    """Return the number of positioners that reach each target of a field."""
    return np.diff(find_reach(job)[2].indptr)


def plan_alone(given: BlockJob) -> BlockDone:
    """Plan a tile for a single realization, with the function that plans the tiles of surveys."""
    done = work(given.job)
    mask = np.zeros(len(given.left), dtype=np.uint32)
    mask[done.target[(done.target >= 0) & done.observed]] = 1
    return BlockDone(mask, np.array([[len(done.observed), np.count_nonzero(~done.observed)]]))


class Poses:
    """The poses of arms at all targets in reach, from which the collisions of each realization are found.

    Parameters
    ----------
    plane : FocalPlane
        The positioners.
    columns : FocalPlaneArrays
        The arrays of the focal plane.
    xy : ndarray, shape (n_targets, 2)
        Positions of the targets, mm.
    fiber_type : ndarray of str, shape (n_targets,), or None
        Required fiber types.
    pairs : Reach
        The pairs of positioners and targets in reach.
    parked_obstacles : bool
        Whether positioners without a target are parked, and are obstacles for other arms. Only positioners with two
        arms of equal length can be parked.
    """

    def __init__(self, plane, columns: FocalPlaneArrays, xy, fiber_type, pairs: Reach, parked_obstacles: bool):
        own, self._plane, self._columns = pairs.owner, plane, columns
        self._parked = parked_obstacles
        self._points, self._fiber = xy[pairs.target], columns.first_index[own]
        if fiber_type is not None:
            self._fiber = columns.index_of(fiber_type[pairs.target], own)
        self._side = columns.sides(self._points, own, self._fiber)
        self._segments = np.empty((4, len(own)))
        arms.place(self._points, columns.geometry_of(own, self._fiber), self._side, self._segments)
        arms.shape(self._segments, columns.model, columns.length, *columns.angles_of(own, self._fiber))
        self._idle = columns.idle(parked_obstacles).segments.copy()
        arms.shape(self._idle, columns.model, columns.length, *columns.angles)

    def find_lost(self, chosen: np.ndarray, lost: np.ndarray) -> None:
        """Mark the positioners that lose their target to a collision, in each realization (row of ``chosen``)."""
        columns = self._columns
        if len(columns.runs) + len(columns.obstacle_pairs) == 0:
            return
        setup = make_setup(columns, self._parked)
        uncertain = np.empty(len(chosen), dtype=bool)
        kernels.find_lost(
            chosen,
            self._segments,
            self._idle,
            setup,
            columns.obstacle_slack,
            make_workspace(self._plane),
            lost,
            uncertain,
        )
        for r in np.flatnonzero(uncertain):
            lost[r] = self._lost_exactly(chosen[r])

    def _lost_exactly(self, pair: np.ndarray) -> np.ndarray:
        """Return which positioners lose their target; exact arithmetic is used if rounding could change the result."""
        used = np.flatnonzero(pair >= 0)
        tips, side = np.full((len(pair), 2), np.nan), np.ones(len(pair))
        tips[used], side[used] = self._points[pair[used]], self._side[pair[used]]
        types = self._columns.first_type.astype(object)
        types[used] = np.array(self._plane.fiber_types, dtype=object)[self._fiber[pair[used]]]
        report = find_collisions(
            self._plane,
            tips << u.mm,
            handedness=elbow_names(side),
            fiber_type=types.astype(str),
            parked_obstacles=self._parked,
        )
        return report.in_collision & (pair >= 0)
