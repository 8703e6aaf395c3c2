"""Failed visits of a tile, from a file of SDSS-V that states which fibers were on target."""

import os
from pathlib import Path

import numpy as np
from astropy.table import Table
from astropy.time import Time

from rfpsurvey._io import to_path
from rfpsurvey.errors import InputError, number_of, warn
from rfpsurvey.plans import native_format, read_plan


def is_configuration(table: object) -> bool:
    """Return whether the table of observations is the path of a plan of another program."""
    return isinstance(table, str | os.PathLike) and native_format(to_path(table)) is not None


def visits_of_configuration(path: str | os.PathLike, survey, tile: object) -> Table:
    """Return a table of the visits of a tile, which states whether each of them was successful.

    A visit failed if its fiber was not on target, had no target, or had another target than in the survey.
    """
    path = Path(path)
    plan = read_plan(path)
    if "on_target" not in plan.colnames:
        raise InputError(
            f"{path} must state which fibers were on target (a confSummaryF file of SDSS-V), got a plan in the format "
            f"{plan.meta['format']}"
        )
    if tile is None:
        raise InputError(f"tile must be given for {path}: the tile of the survey that it observed, got none")
    visits = survey.tile(tile)
    used = plan[np.asarray(plan["assigned"])]
    row_of = {name: row for row, name in enumerate(np.asarray(used["positioner"]).astype(str).tolist())}
    on_target, ids = np.asarray(used["on_target"]) == 1, np.asarray(used["target_id"]).astype(str).tolist()
    reasons, n_same, n_science = [], 0, 0
    for name, target, row in zip(
        np.asarray(visits["positioner"]).astype(str).tolist(),
        np.asarray(visits["target_id"]).astype(str).tolist(),
        visits["target_row"].tolist(),
        strict=True,
    ):
        found = row_of.get(name)
        same = found is not None and (row < 0 or ids[found] == target)
        n_same, n_science = n_same + (same and row >= 0), n_science + (row >= 0)
        reasons.append(
            "no target in the file"
            if found is None
            else "another target in the file"
            if not same
            else ""
            if on_target[found]
            else "not on target"
        )
    if n_science and not n_same:
        raise InputError(
            f"{path} must be the file of tile {tile}, got a file in which no fiber has its target of the survey"
        )
    if not on_target.any():
        warn(f"no fiber of {path} was on target; therefore, all visits of tile {tile} are recorded as failed")
    others = len({*row_of} - {*np.asarray(visits["positioner"]).astype(str).tolist()})
    if others:
        warn(f"{number_of(others, 'fiber')} of {path} with a target have no target in tile {tile}, and are ignored")
    mjd = plan.meta["header"].get("MJD")
    date = "" if mjd is None else Time(float(mjd), format="mjd", scale="utc").isot[:10]
    good = np.array([not one for one in reasons], dtype=bool)
    columns = {"positioner": visits["positioner"], "target": visits["target_id"], "good": good, "reason": reasons}
    return Table({**columns, "date": [date] * len(visits)})
