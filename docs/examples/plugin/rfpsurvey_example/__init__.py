"""An allocator, an instrument and a method of collision probability for rfpsurvey."""

from pathlib import Path

import astropy.units as u
import numpy as np

import rfpsurvey as rs

TOY = Path(__file__).with_name("toy.toml")


def rarest(problem):
    """Assign each target to its nearest free positioner, in the order of priority.

    In each priority class, the targets that the fewest positioners reach are first.
    """
    centers = problem.focal_plane.xy.to_value(u.mm)
    reach = problem.reachable.tocsc()  # positioners of each target
    target_of = np.full(len(centers), -1)
    for target in np.lexsort([np.diff(reach.indptr), problem.rank]):
        able = reach.indices[reach.indptr[target] : reach.indptr[target + 1]]
        free = able[target_of[able] < 0]
        if problem.kind[target] == "science" and len(free):
            distance = np.hypot(*(centers[free] - problem.xy[target]).T)
            target_of[free[distance.argmin()]] = target
    return target_of


def dice(question):
    """Estimate collision probabilities from random targets that are independent and uniform in each patrol area.

    Targets are drawn until the standard error is small enough.
    """
    plane, rng, n = question.focal_plane, question.rng, len(question.focal_plane)
    inner, outer = (r.to_value(u.mm) for r in (plane.positioner.inner_radius, plane.positioner.outer_radius))
    precision, hits, parts = question.precision, np.zeros(n), []
    while len(parts) < precision.max_iterations:
        r, angle = np.sqrt(rng.uniform(inner**2, outer**2, n)), rng.uniform(0, 2 * np.pi, n)
        tips = plane.xy + np.column_stack([r * np.cos(angle), r * np.sin(angle)]) * u.mm
        colliding = rs.find_collisions(plane, tips).in_collision
        hits += colliding
        parts.append(colliding.mean())
        error = np.std(parts) / np.sqrt(len(parts))
        if precision.standard_error and len(parts) >= 30 and error < precision.standard_error:
            break
    answer = {"per_positioner": hits / len(parts), "n": len(parts)}
    return answer | ({"standard_error": error} if len(parts) > 1 else {})


dice.estimand = "independent"
