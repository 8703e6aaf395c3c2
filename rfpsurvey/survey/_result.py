"""Tables of a survey: tiles, completeness, and what became of each target."""

import numpy as np
from astropy.table import QTable

from rfpsurvey.survey._bookkeeping import OUTCOMES, Bookkeeping
from rfpsurvey.tile import model_sentence

__all__ = ["completeness_table", "outcome_table", "tile_table"]


def tile_table(request, state: Bookkeeping, round_of: np.ndarray, counts: dict, outcomes: QTable) -> QTable:
    """Return a row for each tile, with the summary and the provenance of the survey."""
    table = QTable(request.tiling.table[["tile", "ra", "dec", "position_angle", "pass"]])
    table["round"] = round_of
    for name, values in counts.items():
        table[name] = values
    n_usable = int(request.instrument.focal_plane.arrays.usable.sum())
    table["collision_rate"] = counts["n_colliding"] / np.maximum(counts["n_counted"], 1)
    table["fiber_use"] = counts["n_assigned"] / max(n_usable, 1)
    centers, near = request.tiling.vectors, request.source.sum_near
    wanted, done = (near(centers, request.radius_rad, visits) for visits in (state.wanted, state.done()))
    table["completeness"] = done / np.where(wanted > 0, wanted, np.nan)
    outcome_counts = np.bincount(outcomes["outcome"], minlength=len(OUTCOMES))
    table.meta = {
        "summary": _summary(request, state, counts, outcome_counts, n_usable),
        "provenance": request.provenance,
    }
    return table


def _summary(request, state, counts, outcome_counts, n_usable) -> dict:
    wanted, observed = int(state.n_wanted.sum()), int(state.n_observed.sum())
    targets, complete = int(state.n_targets.sum()), int(state.n_complete.sum())
    total = {name: int(values.sum()) for name, values in counts.items()}
    return {
        "n_tiles": len(request.tiling),
        "n_rounds": len(request.rounds),
        "n_targets": targets,
        "n_complete": complete,
        "n_visits_wanted": wanted,
        "n_visits_observed": observed,
        "completeness": observed / max(wanted, 1),
        "completeness_targets": complete / max(targets, 1),
        "outcomes": {name: int(n) for name, n in zip(OUTCOMES, outcome_counts, strict=True) if n},
        "n_fibers": n_usable * len(request.tiling),
        "n_assigned": total["n_assigned"],
        "n_science": total["n_science"],
        "fiber_use": total["n_assigned"] / max(n_usable * len(request.tiling), 1),
        "n_colliding": total["n_colliding"],
        "n_colliding_pairs": total["n_colliding_pairs"],
        "n_obstacle_collisions": total["n_obstacle_collisions"],
        "collision_rate": total["n_colliding"] / max(total["n_counted"], 1),
        "n_unmet": total["n_unmet"],
        "model": model_sentence(request.instrument),
    }


def completeness_table(request, state: Bookkeeping) -> QTable:
    """Return a row for each pass and class of priority, and for all classes where there are several."""
    wanted, targets = state.n_wanted, state.n_targets
    observed, complete = np.cumsum(state.n_observed, axis=0), np.cumsum(state.n_complete, axis=0)
    n_tiles = np.cumsum(np.bincount(request.number, minlength=len(request.passes)))
    several = len(state.classes) > 1
    rows = []
    for k, number in enumerate(request.passes):
        figures = [(wanted.sum(), targets.sum(), observed[k].sum(), complete[k].sum(), "all")]
        if several:
            figures += zip(wanted, targets, observed[k], complete[k], state.classes, strict=True)
        rows += [(number, n_tiles[k], name, t, w, o, c, o / max(w, 1)) for w, t, o, c, name in figures]
    names = ("pass", "n_tiles", "priority", "n_targets", "n_wanted", "n_observed", "n_complete", "completeness")
    return QTable(rows=rows, names=names)


def outcome_table(request, state: Bookkeeping) -> QTable:
    """Return a row for each target, in the order of the catalog."""
    source = request.source
    table = QTable({"target_id": source.ids()}, copy=False)
    table["wanted"], table["observed"] = source.by_row(state.wanted), source.by_row(state.done())
    table["outcome"] = source.by_row(state.outcomes())
    table.meta = {"outcome": {str(k): name for k, name in enumerate(OUTCOMES)}}
    return table
