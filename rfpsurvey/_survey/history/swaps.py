"""Swaps: positioners that observed another target than planned."""

import numpy as np

from rfpsurvey._survey.work import reach_of
from rfpsurvey.errors import InputError, listed, warn

MOST_LISTED = 10


def with_swaps(visits: np.ndarray, swaps: dict[str, list]) -> np.ndarray:
    """Return the visits of a plan after swaps; a positioner without a planned target has an additional row.

    ``swaps`` contains the row, the identifier and the kind of the observed target of each positioner. The columns
    ``ra``, ``dec`` and those of the catalog are not changed, and are 0 or empty in additional rows.
    """
    if not swaps:
        return visits
    names = visits["positioner"].astype(str).tolist()
    names += [name for name in swaps if name not in names]
    values = [[name, row, target, kind, True, False] for name, (row, target, kind) in swaps.items()]
    columns = ("positioner", "target_row", "target_id", "kind", "observed", "in_collision")
    changed = {name: np.array(part) for name, part in zip(columns, zip(*values, strict=True), strict=True)}
    kinds = [(name, visits.dtype[name]) for name in visits.dtype.names]
    kinds = [(k, np.promote_types(t, changed[k].dtype) if k in changed and t.kind == "U" else t) for k, t in kinds]
    swapped, place = np.zeros(len(names), dtype=kinds), [names.index(name) for name in swaps]
    for name, kind in kinds:
        swapped[name][: len(visits)] = visits[name]
        if name in changed:
            swapped[name][place] = changed[name].astype(kind)
    return swapped


def with_swaps_of(columns: dict, rows: list[int], event, history):
    """Return an event with the swaps in some rows of a table."""
    if not rows:
        return event
    tile = event.tile
    if event.state != "done":
        raise InputError(
            f"the state of tile {tile} must be done if swaps are recorded, because they belong to the observation that "
            f"finishes the tile, got {event.state}"
        )
    request, swaps, far = history.request(), {}, []
    job = request.job(event.row, np.ones_like(request.builder.left))
    targets, ids = job.field.targets, job.field.targets.id.astype(str)
    positioners, pairs = request.instrument.focal_plane.id.astype(str).tolist(), reach_of(job).pairs
    for k in rows:
        name, target = (columns[role][k] if columns[role] else "" for role in ("positioner", "target"))
        if not (name and target):
            raise InputError(f"a swap must have a positioner and a target, got {name or target!r} only in tile {tile}")
        if name not in positioners:
            raise InputError(f"positioner must be a positioner of the instrument, got {name!r}")
        index = np.flatnonzero(ids == target)
        if len(index) != 1:
            raise InputError(
                f"target must be one target in the field of tile {tile}, got {target!r}, which is the identifier of "
                f"{len(index) or 'none'}"
            )
        if not ((pairs.owner == positioners.index(name)) & (pairs.target == index[0])).any():
            far.append(f"{name} ({target})")
        kind = "science" if targets.columns.kind is None else str(targets.columns.kind[index[0]])
        if name in swaps:
            raise InputError(f"positioner must be in one row of swaps of tile {tile}, got {name!r} in several rows")
        swaps[name] = [int(job.field.row[index[0]]), target, kind]
    event = event._replace(swaps=dict(sorted(swaps.items())))
    observed, _ = history.events.observed(event.after(history.earlier(event)))
    row, n = np.unique(observed["target_row"][observed["target_row"] >= 0], return_counts=True)
    if (n > 1).any():
        twice = observed["target_id"][observed["target_row"] == row[n > 1][0]][0]
        raise InputError(f"a target of tile {tile} must be observed by one positioner, got several for {twice}")
    if far:
        warn(f"targets of swaps of tile {tile} are out of reach of their positioners: {listed(far, MOST_LISTED)}")
    return event
