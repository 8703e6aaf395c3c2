"""Outcomes of targets, and the classes (by priority or by category) for which completeness is computed."""

from enum import IntEnum

import numpy as np

from rfpsurvey._units import exact_text


class Outcome(IntEnum):
    """Whether a target is observed and, if not, the reason."""

    NOT_REQUESTED = 0
    OBSERVED = 1
    PARTLY_OBSERVED = 2
    LOST_TO_A_COLLISION = 3
    IN_REACH_NOT_ASSIGNED = 4
    OUT_OF_REACH = 5
    IN_NO_FIELD = 6
    EXCLUDED_BY_A_CONSTRAINT = 7


OUTCOMES = tuple(outcome.name.lower().replace("_", " ") for outcome in Outcome)
# Up to MOST_CLASSES priorities or categories are counted separately. If there are more priorities, they are combined
# into at most N_RANGES ranges.
MOST_CLASSES, N_RANGES = 20, 10


def outcome_codes(
    in_reach: np.ndarray, excluded: np.ndarray | None, lost: np.ndarray, observed: np.ndarray
) -> np.ndarray:
    """Return the outcome of each target of a field, as an index into `OUTCOMES`.

    The masks mark the targets that a positioner can reach (``in_reach``), that constraints exclude (``excluded``; None
    if there are none), that are lost to a collision (``lost``), and that are observed (``observed``).
    """
    code = np.where(in_reach, Outcome.IN_REACH_NOT_ASSIGNED, Outcome.OUT_OF_REACH).astype(np.uint8)
    if excluded is not None:
        code[in_reach & excluded] = Outcome.EXCLUDED_BY_A_CONSTRAINT
    code[lost] = Outcome.LOST_TO_A_COLLISION
    code[observed] = Outcome.OBSERVED
    return code


def priority_classes(priority: np.ndarray | None, counts: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Return the priority class of each target, and the names of the classes, the most important class first.

    Each class is one priority or a range of priorities. Only targets for which ``counts`` is true define the classes.
    """
    if priority is None or not counts.any():
        return np.zeros(len(counts), dtype=np.uint8), [""]
    values, numbers = np.unique(priority[counts > 0], return_counts=True)
    group = np.arange(len(values))
    if len(values) > MOST_CLASSES:  # the ranges have similar numbers of targets
        before = np.cumsum(numbers) - numbers
        group = np.unique(before * N_RANGES // numbers.sum(), return_inverse=True)[1].reshape(-1)
    low = values[np.searchsorted(group, np.arange(group[-1] + 1))]
    high = values[np.searchsorted(group, np.arange(group[-1] + 1), side="right") - 1]
    names = [exact_text(a) if a == b else f"{exact_text(a)} to {exact_text(b)}" for a, b in zip(low, high, strict=True)]
    place = np.clip(np.searchsorted(low, priority, side="right") - 1, 0, len(low) - 1)
    return (len(low) - 1 - place).astype(np.uint8), names[::-1]


def category_classes(category: np.ndarray | None, counts: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Return the category class of each target, and the names of the classes, the largest class first.

    The size of a class is the number of its targets for which ``counts`` is true. If there are more than
    ``MOST_CLASSES`` categories, the smallest categories are combined into the last class.
    """
    if category is None or not counts.any():
        return np.zeros(len(counts), dtype=np.uint8), [""]
    values, place = np.unique(category, return_inverse=True)
    place = place.reshape(-1)
    numbers = np.bincount(place[counts > 0], minlength=len(values))
    order = np.argsort(-numbers, kind="stable")
    order = order[numbers[order] > 0]
    rank = np.full(len(values), len(order))
    rank[order] = np.arange(len(order))
    names = [str(values[k]) or "no category" for k in order]
    if len(names) > MOST_CLASSES:
        names = [*names[: MOST_CLASSES - 1], f"{len(names) - MOST_CLASSES + 1} others"]
    return np.minimum(rank, len(names) - 1).astype(np.uint8)[place], names
