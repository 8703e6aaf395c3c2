"""The answer that every allocator returns, and the objectives of a plan."""

from typing import NamedTuple

import numpy as np

from rfpsurvey._common.units import exact_text

SUBPRIORITIES = "subpriorities"
"""Name of the last objective: the sum of the subpriorities of the science targets that have a fiber."""


class Level(NamedTuple):
    """One objective of a plan; earlier objectives take precedence over all later ones.

    Parameters
    ----------
    name : str
        Name of the objective, such as ``science`` or ``priority 2``.
    value : float
        Value of the objective in the plan; larger is better.
    bound : float
        Upper bound of the value for all plans with the same values of the earlier objectives; NaN if it is unknown.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, robot)
    >>> rs.allocate(plane, [[12, 0], [14, 0]] * u.mm, allocator="optimal").levels
    (Level(name='science', value=1.0, bound=1.0),)
    """

    name: str
    value: float
    bound: float


class Objectives(NamedTuple):
    """The objectives of a plan, in order of precedence.

    An objective is the number of assigned targets of the classes ``first`` to ``stop - 1``, unless it has the name
    ``required targets`` or ``requirements`` (minus the number of fibers that are missing for the requirements).
    """

    names: tuple[str, ...]
    first: np.ndarray
    stop: np.ndarray

    @classmethod
    def of(cls, special: list[str], classes: np.ndarray, *, all_first: bool, any_last: bool) -> "Objectives":
        """Return the objectives ``special``, the science targets by class, and others before and after the classes.

        Before the classes, the number of all science targets can be an objective; after them, that of all targets.
        """
        n, n_any = len(classes), int(any_last)
        numbers = ["science"] if n == 1 else [f"priority {exact_text(value)}" for value in classes]
        names = (*special, *["science"] * all_first, *numbers, *["any target"] * n_any)
        first = [0] * (len(special) + all_first), np.arange(n), [0] * n_any
        stop = [0] * len(special), [n] * all_first, np.arange(1, n + 1), [n + 1] * n_any
        return cls(names, *(np.concatenate(parts).astype(np.int64) for parts in (first, stop)))


class AllocationAnswer(NamedTuple):
    """The return value of every allocator, whether it is built in or comes from another package.

    Parameters
    ----------
    target_of_positioner : ndarray of int, shape (n_positioners,)
        Row of the target of each positioner, -1 if the positioner has no target.
    handedness : ndarray of str, shape (n_positioners,), optional
        Handedness of each arm, "right" or "left". If it is None, each positioner has its default handedness.
    queues : tuple of ndarray, optional
        If the targets were drawn from queues: two arrays ``indptr`` and ``targets``. The queue of positioner ``i`` is
        ``targets[indptr[i]:indptr[i + 1]]``.
    levels : list of Level, optional
        Value and bound of each objective. With None, rfpsurvey computes the values, and the bounds are NaN.
    meta : dict, optional
        Information about the search of the allocator, which is copied to the ``meta`` of the
        `~rfpsurvey.allocation.Allocation`.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> rs.allocation.AllocationAnswer([2, -1, 0]).target_of_positioner
    [2, -1, 0]
    """

    target_of_positioner: np.ndarray
    handedness: np.ndarray | None = None
    queues: tuple[np.ndarray, np.ndarray] | None = None
    levels: list[Level] | None = None
    meta: dict | None = None
