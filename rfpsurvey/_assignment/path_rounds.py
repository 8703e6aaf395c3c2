"""Plans in which the arm of each target has a planned path: combinations of targets without paths are changed."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from rfpsurvey._assignment.answer import AllocationAnswer, Level
from rfpsurvey._assignment.methods import repaired
from rfpsurvey._assignment.objectives import conditional_bounds, matching_limits, with_subpriorities
from rfpsurvey._assignment.problem import AllocationProblem
from rfpsurvey._instruments.arms import Arms
from rfpsurvey._instruments.joint_motion import JointMotion
from rfpsurvey._instruments.path_report import PathReport, report_paths
from rfpsurvey._instruments.reach import elbow_names

ROUNDS, PATIENCE = 10, 3
"""Largest numbers of rounds in which plans are changed where arms have no path, in all and without a better plan."""


def with_paths(
    problem: AllocationProblem,
    answer: AllocationAnswer,
    place: Callable[[AllocationAnswer], Arms],
    motion: JointMotion | None,
) -> tuple[AllocationAnswer, PathReport]:
    """Return an answer in which all arms with targets have planned paths, and these paths.

    ``place`` returns the arms of an answer.

    Where no path is found, the combination of the targets of the two arms is avoided in the next rounds, which change
    the plan by local moves. This is a heuristic: the bounds of the objectives are those of plans without paths. In the
    best of these plans, arms without a path lose their targets.
    """
    first, avoided, best, n_rounds, n_best = answer, [], None, 0, 0
    if getattr(problem.options.allocator, "keeps_targets", False):
        used = np.isin(np.arange(len(problem.xy)), answer.target_of_positioner)
        problem = replace(problem, pairs=problem.only(used))
    while True:
        report = report_paths(problem.focal_plane, place(answer), motion)
        if not n_rounds and not report.n_failing:
            return answer, report
        kept = np.where(report.without_path, -1, answer.target_of_positioner)
        if best is None or tuple(problem.level_values(kept)) > tuple(problem.level_values(best[0])):
            best, n_best = (kept, answer, report), n_rounds
        if not report.n_failing or n_rounds == min(ROUNDS, n_best + PATIENCE):
            break
        answer = _with_elbows(problem, answer)
        target_of, side = answer.target_of_positioner, np.where(answer.handedness == "left", -1.0, 1.0)
        groups = _groups(problem, report, target_of)
        avoided += [tuple((k, target_of[k], side[k]) for k in rows) for rows in groups]
        changed = replace(problem, start=lambda now=answer, **_: now, avoided=tuple(avoided))
        answer, n_rounds = repaired(changed, steady=True), n_rounds + 1
    _, answer, report = best
    while report.n_failing:
        target_of = answer.target_of_positioner.copy()
        for rows in _groups(problem, report, target_of):
            _give_up(problem, target_of, rows)
        answer = answer._replace(target_of_positioner=target_of)
        report = report_paths(problem.focal_plane, place(answer), motion)
    target_of = answer.target_of_positioner
    n_lost = int((first.target_of_positioner >= 0).sum() - (target_of >= 0).sum())
    meta = {**(first.meta or {}), "n_path_rounds": n_rounds, "n_lost_to_paths": n_lost}
    return answer._replace(levels=_levels(problem, first.levels, target_of), meta=meta, queues=None), report


def _groups(problem, report, target_of):
    """Return the rows of the positioners with targets in each group without a path, and of single positioners.

    In a group of an arm without a target, the arm with a target may arrive. Such a group is omitted.
    """
    row_of = {str(name): k for k, name in enumerate(problem.focal_plane.id)}
    groups = [[row_of[name] for name in ids] for ids, _ in report.paths.groups]
    groups = [rows for rows in groups if report.without_path[rows].any()]
    groups += [[k] for k in np.flatnonzero(report.without_path) if not any(k in rows for rows in groups)]
    usable = problem.focal_plane.arrays.usable & (target_of >= 0)
    return [rows for group in groups if (rows := [k for k in group if usable[k]])]


def _with_elbows(problem, answer):
    """Return an answer that contains the elbows of all arms."""
    if answer.handedness is not None:
        return answer
    plane, target_of = problem.focal_plane, answer.target_of_positioner
    points = np.append(problem.xy, [[np.nan, np.nan]], axis=0)[target_of]
    fiber = problem.fiber_of(np.arange(len(plane)), target_of)
    return answer._replace(handedness=elbow_names(plane.arrays.sides(points, fiber=fiber)))


def _give_up(problem, target_of, rows):
    """Take the target, in place, from the arm with the least important target, unless an arm has lost its target."""
    if (target_of[rows] >= 0).all():
        importance = [(problem.is_required[target_of[k]], -problem.rank[target_of[k]]) for k in rows]
        target_of[rows[min(range(len(rows)), key=importance.__getitem__)]] = -1


def _levels(problem, levels, target_of):
    """Return the objectives of a changed plan, with the bounds that the search proved for plans without paths."""
    if levels is None:
        return None
    values, proven = problem.level_values(target_of), {level.name: level for level in levels}
    # a bound is valid for plans with the same values of all earlier objectives
    same = [proven[name].value == value for name, value in zip(problem.level_names, values, strict=True)]
    n_same = len(same) if all(same) else same.index(False) + 1
    bounds = conditional_bounds(problem, values, matching_limits(problem, None), 0)
    bounds[:n_same] = [proven[name].bound for name in problem.level_names[:n_same]]
    pairs = zip(problem.level_names, values.tolist(), np.maximum(bounds, values).tolist(), strict=True)
    return with_subpriorities(problem, [Level(*row) for row in pairs], target_of)
