"""Shares of finished targets: the smallest finished fraction of the categories is as large as possible.

Integer programs maximize the smallest fraction, then the next one while the smallest is kept, and so on. A further
variable, a whole number, is the smallest fraction in units of 1 / ``UNITS``.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array, hstack, vstack

from rfpsurvey._assignment.solver import maximize, with_errors
from rfpsurvey._assignment.weighted import WeightedProblem
from rfpsurvey._survey.joint.values import values_in
from rfpsurvey.errors import InputError, listed

COLUMN, UNITS = "category", 10_000


def weights_in(text: str) -> dict[str, float]:
    """Return the weight of each category in a text such as ``"main=2 guest=1"``; no weights for ``"category"``."""
    if text == COLUMN:
        return {}
    weights = {}
    for word in text.split():
        name, _, value = word.rpartition("=")
        if name in weights:
            raise InputError(f"share must have one weight for each category, got several for {name!r}")
        try:
            weights[name] = float(value)
        except ValueError:
            weights[name] = np.nan
        if not name or not 0 < weights[name] < np.inf:
            raise InputError(
                f"share must be 'category', or weights above 0 of categories such as 'main=2 guest=1', got {text!r}"
            )
    if not weights:
        raise InputError(f"share must be 'category', or weights of categories, got {text!r}")
    return weights


def check_categories(joint, category: np.ndarray | None, wanted: np.ndarray) -> None:
    """Raise an error if options of a joint plan need categories that the targets do not have.

    ``wanted`` is the requested number of visits of each science target.
    """
    for name, is_given in {
        "share requires": joint.share,
        "values of categories require": ":" in joint.objective,
    }.items():
        if is_given and category is None:
            raise InputError(f"{name} a catalog with categories, got a catalog without the column category")
    names = set() if category is None else {*category[wanted > 0].tolist()}
    if joint.share and (unknown := sorted({*weights_in(joint.share)} - names)):
        raise InputError(
            f"share must name categories of targets with requested visits ({listed(sorted(names), 8)}), got "
            f"{listed(unknown)}"
        )
    values = {*values_in(joint.objective)} if ":" in joint.objective else {""}
    if "" not in values and not names <= values <= {*category.tolist()}:
        raise InputError(
            "objective must contain values of all categories of targets "
            f"({listed(sorted(names), 8)}) and of no others, got {listed(sorted(values), 8)}"
        )


@dataclass(frozen=True, eq=False)
class Shares:
    """The category of each target, and the number of targets and the weight of each category."""

    names: tuple[str, ...]
    group: np.ndarray  # -1 for targets that do not count
    size: np.ndarray
    weight: np.ndarray
    before: np.ndarray  # number of targets that were finished before, which are not in the network

    @classmethod
    def of(cls, text: str, category: np.ndarray, counted: np.ndarray, is_finished: np.ndarray) -> "Shares":
        """Return the shares of the targets that are ``counted``; all arrays are in the order of slots.

        ``is_finished`` is whether all visits of each target were made before.
        """
        weights = weights_in(text)
        names, group = np.unique(np.append(category[counted], category[is_finished]), return_inverse=True)
        group, n = group.reshape(-1), int(counted.sum())
        if unknown := sorted({*weights} - {*names.tolist()}):
            raise InputError(
                f"share must name categories of targets in the fields ({listed(names.tolist(), 8)}), got "
                f"{listed(unknown)}"
            )
        of_slot = np.full(len(counted), -1)
        of_slot[counted] = group[:n]
        size, before = (np.bincount(some, minlength=len(names)) for some in (group, group[n:]))
        return cls(tuple(names.tolist()), of_slot, size, np.array([weights.get(name, 1.0) for name in names]), before)

    def on(self, slot: np.ndarray) -> "Shares":
        """Return the shares with the category of each target with a slot, or a negative number."""
        known = (slot >= 0) & (slot < len(self.group))
        return replace(self, group=np.where(known, self.group[np.where(known, slot, 0)], -1))

    def count(self, done: np.ndarray) -> np.ndarray:
        """Return the number of finished targets of each category."""
        return self.before + np.bincount(self.group[(done > 0) & (self.group >= 0)], minlength=len(self.names))

    def fractions(self, number: np.ndarray) -> np.ndarray:
        """Return the finished fraction of each category divided by its weight."""
        return number / (self.size * self.weight)

    def record(self, done: np.ndarray, bound: float) -> dict:
        """Return the finished targets of each category, and an upper bound of the smallest weighted fraction."""
        number = self.count(done)
        rows = [
            {"category": name, "weight": float(w), "n_targets": int(n), "n_complete": int(k), "fraction": float(k / n)}
            for name, w, n, k in zip(self.names, self.weight, self.size, number, strict=True)
        ]
        return {"shares": rows, "bound_of_smallest": float(min(bound, (1.0 / self.weight).min()))}


def solve_balanced(
    problem: WeightedProblem, goals: np.ndarray, shares: Shares, outside: np.ndarray, rounds: int, deadline: float
) -> tuple[np.ndarray | None, float]:
    """Return the candidate of each positioner in a plan with balanced shares, and a bound of the smallest fraction.

    Parameters
    ----------
    problem : WeightedProblem
        The program; the last candidates are two for each of the targets ``goals``: it is finished, or it is not.
    goals : ndarray of int
        Targets that the program can finish.
    shares : Shares
        The categories.
    outside : ndarray of int
        Number of targets of each category that are finished whatever the program chooses.
    rounds : int
        Number of fractions that are maximized, one after the other.
    deadline : float
        Value of `now` at which the search ends.
    """
    n, m = len(problem.weight), len(problem.start) - 1
    single = csr_array((np.ones(n), (np.repeat(np.arange(m), np.diff(problem.start)), np.arange(n))), shape=(m, n))
    finished = n - 2 * len(goals) + 2 * np.arange(len(goals))
    row = shares.group[goals]
    counts = csr_array((np.ones(len(goals)), (row, finished)), shape=(len(shares.names), n))
    scale, least = shares.size * shares.weight, np.zeros(len(shares.names))
    chosen, bound, is_free, settings = None, np.inf, np.ones(len(scale), dtype=bool), {"integral": True}
    settings |= {"presolve": True, "nodes": problem.nodes}
    top = hstack([vstack([single, problem.sets]), csr_array((m + problem.sets.shape[0], 1))])
    high = np.concatenate([np.ones(m), problem.most, np.full(len(scale), np.inf)])
    most = np.append(np.ones(n), float(np.ceil(UNITS * (1.0 / shares.weight).max())))
    for k in range(rounds + 1):
        # the last program maximizes the weights
        is_last = k == rounds or not is_free.any()
        unit = np.where(is_free & (not is_last), scale / UNITS, 0.0)
        matrix = vstack([top, hstack([counts, csr_array(-unit[:, None])])], format="csr")
        low = np.concatenate([np.ones(m), np.full(problem.sets.shape[0], -np.inf), least - outside])
        goal = np.append(problem.weight, 0.0) if is_last else np.append(np.zeros(n), 1.0)
        x, limit = maximize((matrix, low, high), goal, most, deadline, gap=problem.gap if is_last else 0.0, **settings)
        if k == 0 and np.isfinite(limit):
            bound = (with_errors(limit, n) + 1.0) / UNITS
        if x is None:
            break
        chosen = np.flatnonzero(x[:n] > 0.5)
        if is_last:
            break
        number = outside + counts @ x[:n]
        fractions = np.where(is_free, shares.fractions(number), np.inf)
        worst = fractions <= fractions.min() + 1.0 / UNITS
        # the smallest fraction is kept; all others are at least as large
        least = np.where(worst, number, np.maximum(least, np.floor(fractions.min() * scale * (1 - 1e-9))))
        is_free &= ~worst
    return (chosen if chosen is not None and len(chosen) == m else None), bound
