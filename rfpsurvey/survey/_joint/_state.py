"""The state of the search for a joint plan, which is stored in the folder of a survey."""

import io
from typing import NamedTuple

import numpy as np

from rfpsurvey._readers import read_arrays
from rfpsurvey.errors import InputError, warn

STATE = "joint/state.npz"


class State(NamedTuple):
    """The state of a search after an iteration."""

    plans: list
    """For each tile, the slot of the target and the handedness of each positioner."""
    bounds: np.ndarray
    next_size: np.ndarray
    size: float
    iteration: int
    seconds: float
    """Duration of the search if its time is limited, otherwise 0, so that equal searches have equal files."""
    steps: np.ndarray
    """Iteration, visits and bounds of each step, one row per step."""
    prices: list
    """For each level, the prices of all sets (see `Search.prices`); None for a level without prices."""
    bounds_of_all: np.ndarray
    limits: np.ndarray
    """Largest sum of each rule (see `Search`)."""


def write_state(folder, plans: list, search) -> None:
    """Write the state of a search to the folder of a survey."""
    seconds = search.seconds if np.isfinite(search.options.seconds) else 0.0
    columns = {
        "slot": np.concatenate([plan.slot for plan in plans]),
        "side": np.concatenate([plan.side for plan in plans]),
        "size": np.array([len(plan.slot) for plan in plans]),
        "numbers": np.array([search.size, search.iteration, seconds]),
        "bounds": search.bounds,
        "next_size": search.next_size,
        "steps": np.array([[step.iteration, *step.visits, *step.bound] for step in search.steps]),
    }
    if len(search.limits):
        columns |= {"bounds_of_all": search.bounds_of_all, "limits": search.limits}
    for k, price in enumerate(search.prices):
        if price is not None:
            columns[f"price{k}"] = price
    content = io.BytesIO()
    np.savez(content, **columns)
    folder.put_file(STATE, content.getvalue())


def read_state(folder, n_tiles: int, n_positioners: int, n_levels: int) -> State | None:
    """Return the stored state of a search; None if the folder contains no state, or if the state is damaged."""
    content, n = folder.file(STATE), n_tiles * n_positioners
    if content is None:
        return None
    one_per_level = ("f8", (n_levels,))
    expected = {
        "slot": ("i8", (n,)),
        "side": ("i1", (n,)),
        "numbers": ("f8", (3,)),
        "bounds": one_per_level,
        "next_size": one_per_level,
        "steps": ("f8", (None, 1 + 2 * n_levels)),
        "bounds_of_all?": one_per_level,
        "limits?": ("f8", (None,)),
        **{f"price{k}?": ("f8", (None,)) for k in range(n_levels)},
    }
    try:
        found = read_arrays(io.BytesIO(content), expected, "the archive")
        if not all(np.isfinite(found[name]).all() for name in ("numbers", "next_size")) or found["numbers"].min() < 0:
            raise InputError("the archive must contain finite numbers of at least 0, got others")
        size, iteration, seconds = found["numbers"].tolist()
        plans = list(zip(*(found[name].reshape(n_tiles, n_positioners) for name in ("slot", "side")), strict=True))
        prices = [found.get(f"price{k}") for k in range(n_levels)]
        columns = (found[name] for name in ("bounds", "next_size"))
        more = found.get("bounds_of_all", found["bounds"]), found.get("limits", np.empty(0))
        return State(plans, *columns, size, int(iteration), seconds, found["steps"], prices, *more)
    except InputError as error:
        text = f"the search for a joint plan starts again, because its stored state cannot be read: {error}"
        warn(text)
        return None
