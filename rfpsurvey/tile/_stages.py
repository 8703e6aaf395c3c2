"""The stages from targets on the focal plane to collisions, which one tile and every tile of a survey go through."""

from time import perf_counter
from typing import NamedTuple

import astropy.units as u
import numpy as np

from rfpsurvey.allocation import Allocation, allocate
from rfpsurvey.collision import Arms, CollisionReport, find_collisions
from rfpsurvey.focal_plane import FocalPlane

__all__ = ["Stages", "run_stages"]


class Stages(NamedTuple):
    """What the stages made, and how long they took."""

    allocation: Allocation
    posed: Arms
    report: CollisionReport
    seconds: dict


def run_stages(focal_plane: FocalPlane, xy_mm: np.ndarray, **options) -> Stages:
    """Assign targets, place the arms and find their collisions; the options are those of `allocate`."""
    allocation = allocate(xy_mm << u.mm, focal_plane, **options)
    begin = perf_counter()
    posed = allocation.place_arms(focal_plane)
    middle = perf_counter()
    report = find_collisions(focal_plane, posed)
    seconds = {**allocation.seconds, "arms": middle - begin, "collisions": perf_counter() - middle}
    return Stages(allocation, posed, report, seconds)
