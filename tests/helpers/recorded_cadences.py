"""Observations of surveys with cadences, and a second implementation of the epochs that follow from them."""

import numpy as np
from astropy.table import Table
from astropy.time import Time
from naive_cadences import Naive


def text(day):
    return Time(np.floor(day), format="mjd").isot[:10]


def outcomes(rng, survey, tiling, generation=None):
    """Return a table of random outcomes of the first open tiles, and the time, state and failures of each tile.

    ``generation`` is the number of the plan that the table names.
    """
    days, names = np.asarray(tiling.table["mjd"]), np.asarray(survey.tiles["tile"])
    states = survey.tiles["state"] if generation else ["planned"] * len(days)
    first = [k for k in np.argsort(days).tolist() if states[k] in ("planned", "partly")]
    rows, meaning = [], {}
    for tile in first[: int(rng.integers(1, max(len(first), 2)))]:
        state = rng.choice(["done", "done", "done", "bad", "partly", ""])
        # the date of the tile, that of its night, or another date
        shift = int(rng.choice([0, 0, 0, -1, 1, 4]))
        if not state:
            continue
        rows.append((names[tile], text(days[tile] + shift), state, "", ""))
        failed = [str(p) for p in survey._visits(tile)["positioner"] if state == "done" and rng.random() < 0.2]
        rows += [(names[tile], text(days[tile] + shift), "", p, "lost") for p in failed]
        meaning[tile] = days[tile] + (0 if shift == -1 else shift), state, failed
    if not rows:
        return None, meaning
    table = Table(rows=rows, names=["tile", "date", "state", "positioner", "reason"])
    if generation:
        table["generation"] = generation
    return table, meaning


def naive_state(catalog, plans, meaning, brightness):
    """Return all targets after the recorded observations, and the time of the last observation."""
    targets, now = [Naive(str(name)) for name in catalog.extra["cadence"]], -np.inf
    for tile, (day, state, failed) in sorted(meaning.items(), key=lambda item: (item[1][0], item[0])):
        now = max(now, day)
        columns = (plans[tile][name] for name in ("target_row", "positioner", "observed"))
        for row, positioner, is_counted in zip(*columns, strict=True):
            is_made = is_counted and state == "done" and str(positioner) not in failed
            if is_made and row >= 0 and targets[row].allows(day, brightness[tile])[0]:
                targets[row].observe(day)
    return targets, now


def counted(targets):
    return [int(sum(epoch[2] for epoch in target.epochs[: len(target.starts)])) for target in targets]
