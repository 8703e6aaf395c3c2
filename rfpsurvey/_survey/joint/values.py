"""Values of targets that depend on the numbers of their visits; a joint plan maximizes the sum of the values.

A *step* is a number of visits of a target with a larger value than that of any smaller number.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from astropy.table import Table

from rfpsurvey._survey.joint.network import Network
from rfpsurvey.errors import InputError, check_choice, listed

OBJECTIVES = "finished", "visits"
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
