"""Values of targets that depend on the numbers of their visits, and shares of finished targets of categories.

A joint plan maximizes the sum of the values. A *step* is a number of visits of a target with a larger value than that
of any smaller number. With shares, the smallest finished fraction of the categories is first as large as possible.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from astropy.table import Table

from rfpsurvey._survey.joint.network import Network
from rfpsurvey.errors import InputError, check_choice, listed

OBJECTIVES = "finished", "visits"
# Name of the column of categories, and number of units of a fraction of finished targets.
COLUMN, UNITS = "category", 10_000
# Largest ratio of the weights of two classes.
STEEPEST = 1e4


def to_objective(objective: object) -> str:
    """Return an objective as text after its check; a table becomes text such as ``"main:1=0.2 main:3=1"``."""
    if isinstance(objective, Table):
        columns = {"visits", "value"}
        if not columns <= {*objective.colnames}:
            raise InputError(
                "a table of values must have the columns visits and value, and can have the column category, got "
                f"{listed(objective.colnames) or 'no columns'}"
            )
        category = objective["category"] if "category" in objective.colnames else [""] * len(objective)
        words = []
        for name, visits, value in zip(category, objective["visits"], objective["value"], strict=True):
            words.append(f"{name}:{visits}={value}" if name else f"{visits}={value}")
            if " " in words[-1]:
                raise InputError(f"a category in a table of values must be one word, got {str(name)!r}")
        objective = " ".join(words)
    if not isinstance(objective, str) or "=" not in objective:
        return check_choice(objective, OBJECTIVES, "objective")
    values_in(objective)
    return objective


def values_in(text: str) -> dict[str, dict[int, float]]:
    """Return the value of each number of visits for each category; the category is empty if the values are of all."""
    values = {}
    for word in text.split():
        key, _, value = word.rpartition("=")
        category, _, visits = key.rpartition(":")
        try:
            number, worth = int(visits), float(value)
        except ValueError:
            number, worth = 0, np.nan
        if number < 1 or not 0 <= worth < np.inf:
            raise InputError(
                "objective must be 'visits', 'finished', or values of at least 0 for numbers of visits such as "
                f"'1=0.2 3=1' or 'main:2=1 guest:1=0.5', got {text!r}"
            )
        if number in values.setdefault(category, {}):
            raise InputError(f"objective must contain each number of visits once, got {key} twice")
        values[category][number] = worth
    if "" in values and len(values) > 1:
        raise InputError(f"objective must name a category for all values or for none, got {text!r}")
    for category, table in values.items():
        numbers = sorted(table)
        if any(table[a] > table[b] for a, b in pairwise(numbers)) or not max(table.values()):
            raise InputError(
                "the values of a category must not decrease with the number of visits, and must not all be 0, got "
                f"{' '.join(f'{n}={table[n]:g}' for n in numbers)}" + (f" for {category}" if category else "")
            )
    return values


class Steps(NamedTuple):
    """The steps of all targets of a network, as compressed rows."""

    indptr: np.ndarray
    number: np.ndarray  # number of visits, with those of fixed tiles
    value: np.ndarray  # in addition to that of no visits of this plan
    base: np.ndarray  # value of each target before all tiles
    target: np.ndarray

    def reached(self, made: np.ndarray) -> np.ndarray:
        """Return the number of steps that each target reaches with a number of visits."""
        return np.bincount(self.target[self.number <= made[self.target]], minlength=len(self.base))

    def value_of(self, reached: np.ndarray) -> np.ndarray:
        """Return the value of each target that reaches a number of steps, without ``base``."""
        return np.where(reached > 0, np.append(self.value, 0.0)[self.indptr[:-1] + reached - 1], 0.0)

    def number_of(self, reached: np.ndarray) -> np.ndarray:
        """Return the number of visits that is required to reach a number of steps."""
        return np.where(reached > 0, np.append(self.number, 0)[self.indptr[:-1] + reached - 1], 0)

    @property
    def is_whole(self) -> bool:
        """Whether all values are whole numbers."""
        return bool((self.value % 1 == 0).all() and (self.base % 1 == 0).all())

    @property
    def smallest_gain(self) -> float:
        """Smallest difference between the values of two steps of a target, at most 1."""
        is_first = np.append(-1, self.target[:-1]) != self.target if len(self.target) else np.empty(0, dtype=bool)
        return float(np.where(is_first, self.value, np.diff(self.value, prepend=0.0)).min(initial=1.0))


def steps_of(network: Network, objective: str, builder, category: np.ndarray | None) -> Steps:
    """Return the steps of the targets of a network; ``category`` is the category of each target in order of slots."""
    n = len(network.slot)
    goals = np.flatnonzero((network.rank_of_target < network.n_classes) & (network.visits > 0))
    if objective == "finished":
        numbers = network.visits[goals].astype(np.int64)
        return Steps(starts_of(goals, n), numbers, np.ones(len(goals)), np.zeros(n), goals)
    values, slots = values_in(objective), network.slot[goals]
    names = np.full(len(goals), "") if "" in values else category[slots]
    before = (builder.wanted.astype(np.int64) - builder.left)[slots]
    base, rows = np.zeros(n), []
    for name, table in values.items():
        numbers = np.array(sorted(table))
        worth = _worth(table)
        mine = names == name
        had = worth[np.searchsorted(numbers, before[mine], side="right")]
        base[goals[mine]] = had
        # the steps that this plan can reach, with more value than the step before
        new = (worth[1:] > np.maximum(worth[:-1], had[:, None])) & (numbers > before[mine][:, None])
        new &= numbers <= (before[mine] + network.visits[goals[mine]])[:, None]
        k, step = np.nonzero(new)
        rows.append((goals[mine][k], numbers[step] - before[mine][k], worth[1 + step] - had[k]))
    target, number, value = (np.concatenate(column) for column in zip(*rows, strict=True))
    order = np.lexsort((number, target))
    return Steps(starts_of(target, n), number[order].astype(np.int64), value[order], base, target[order])


def class_weights(n: int, most: float = np.inf) -> np.ndarray:
    """Return the weight of the value of a target of each of n classes: higher priorities take precedence.

    ``most`` is the largest ratio of the weights of a class and of the next one.
    """
    return min(most, STEEPEST ** (1.0 / max(n - 1, 1))) ** np.arange(n - 1, -1, -1.0)


def starts_of(index: np.ndarray, n: int) -> np.ndarray:
    """Return where the rows 0 to n begin in an array of row numbers after it is sorted."""
    return np.concatenate([[0], np.cumsum(np.bincount(index, minlength=n))])


def worth_of(objective: str, visits: np.ndarray, category: np.ndarray | None) -> np.ndarray:
    """Return the value of each target with a number of visits, or 1 if the objective is no table of values."""
    if "=" not in objective:
        return np.ones(len(visits))
    values, worth = values_in(objective), np.zeros(len(visits))
    for name, table in values.items():
        mine = np.full(len(visits), True) if category is None or not name else category == name
        worth[mine] = _worth(table)[np.searchsorted(sorted(table), visits[mine], side="right")]
    return worth


def _worth(table: dict[int, float]) -> np.ndarray:
    """Return the values of no visits, and of at least each number of visits of a table."""
    return np.append(0.0, [table[number] for number in sorted(table)])


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
