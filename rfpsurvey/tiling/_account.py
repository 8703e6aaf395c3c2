"""The summary of a tiling, and warnings about goals that it does not reach."""

import numpy as np

from rfpsurvey.catalog import SkyIndex
from rfpsurvey.errors import warn
from rfpsurvey.tiling._centers import Declinations
from rfpsurvey.tiling._problem import TilingState


def warn_of_rest(state: TilingState, n_away: int, limits: Declinations) -> None:
    """Issue a warning for goals that are not reached, and for targets that no tile reaches."""
    problem, n = state.problem, len(state.rows)
    sentences = []
    goal = problem.completeness
    if goal is not None and state.completeness < goal - 1e-12:
        limit = "" if problem.n_tiles is None or n < problem.n_tiles else f"; n_tiles={n} allows no more tiles"
        sentences.append(f"{n} tiles reach a completeness of {state.completeness:.4f}, not {goal:g}{limit}")
    if n_away:
        sentences.append(f"{n_away} targets are out of reach{limits.words}; they count as not observed")
    if not n:
        sentences.append("no tile observes any target")
    for sentence in sentences:
        warn(sentence)


def account_of(state: TilingState, neighbors, n_away: int) -> dict:
    """Return the summary of a tiling; ``n_away`` targets cannot be reached within the declination limits."""
    problem = state.problem
    wanted, made = problem.wanted, problem.wanted - state.left
    n = len(state.rows)
    depth = SkyIndex(state.table["center"]).sum_near(problem.index.vectors[wanted > 0], problem.radius, np.ones(n))
    account = {
        "n_targets": int(np.count_nonzero(wanted)) + n_away,
        **({} if problem.where.limits.anywhere else {"n_beyond_declination": n_away}),
        "n_on_tiles": int(np.count_nonzero(depth)),
        "n_requested": int(wanted.sum()) + problem.n_beyond,
        "n_observed": int(made.sum()),
        "completeness": float(state.completeness),
        "fiber_use": float(made.sum() / max(n * problem.fibers, 1)),
    }
    if neighbors is not None:
        some = np.flatnonzero(wanted > 0)
        indptr, other = neighbors
        # only neighbors with requested visits can be too close
        near = (
            np.add.reduceat(np.append(wanted[other] > 0, 0), np.minimum(indptr[:-1], len(other))) * np.diff(indptr) > 0
        )
        alone = some[~near[some]]
        account["n_isolated"] = len(alone)
        account["completeness_isolated"] = float(made[alone].sum() / max(wanted[alone].sum(), 1))
    return account
