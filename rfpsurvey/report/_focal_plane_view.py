"""Data of the interactive view of a focal plane, which shows one or several plans of a tile."""

from collections.abc import Mapping

import astropy.units as u
import numpy as np

from rfpsurvey.allocation import IDLE_REASONS
from rfpsurvey.errors import InputError, InputTypeError
from rfpsurvey.report._blocks import View
from rfpsurvey.report._pack import pack, pack_texts
from rfpsurvey.report._text import text_of
from rfpsurvey.tile import Tile

MM, DEG, SKY = 3, 3, 6
"""Numbers of decimals of lengths in mm, of angles in degrees, and of positions on the sky in degrees."""
PLAN_COLUMNS = {
    "ra": SKY,
    "dec": SKY,
    "theta": DEG,
    "phi": DEG,
    "tip_x": MM,
    "tip_y": MM,
    "clearance": MM,
    "kind": None,
    "fiber_type": None,
    "spectrograph": None,
    "category": None,
    "priority": None,
}
"""Columns of the table of a tile that the view shows, with their numbers of decimals."""


def focal_plane_view(plans: Mapping[str, Tile], still: list, max_rows: int | None = None) -> View:
    """Return the interactive view of one or several plans of a tile; the keys of ``plans`` are their names."""
    return View("focal_plane", "Focal plane", {**view_data(plans), "max_rows": max_rows}, still)


def name_of(tile: Tile) -> str:
    """Return the name of the plan of a tile, which is the name of its allocator."""
    return str(tile.provenance["parameters"]["allocator"])


def check_plans(result: object, plans: Mapping[str, Tile] | None) -> dict[str, Tile]:
    """Return all plans of a page by name; raise an error unless they are tiles with the same positioners."""
    if plans is not None and not isinstance(plans, Mapping):
        raise InputTypeError(f"plans must be a dict of names to tiles, got {type(plans).__name__}")
    tiles = {}
    if isinstance(result, Tile):
        name = name_of(result)
        tiles[f"{name} (first)" if plans and name in plans else name] = result
    for key, tile in (plans or {}).items():
        if not isinstance(tile, Tile):
            raise InputTypeError(f"plans must be a dict of names to tiles, got {type(tile).__name__} for {key!r}")
        first = next(iter(tiles.values()), tile)
        if any(not np.array_equal(np.asarray(first[c]), np.asarray(tile[c])) for c in ("id", "x", "y")):
            raise InputError(f"all plans must have the same positioners, got different ones in the plan {key!r}")
        tiles[str(key)] = tile
    return tiles


def view_data(plans: Mapping[str, Tile]) -> dict:
    """Return the data that the script of the view draws."""
    tile = next(iter(plans.values()))
    table, geometry = tile.table, tile.table.meta["geometry"]
    return {
        "n": len(table),
        "instrument": text_of(tile.instrument),
        "position_angle": tile.provenance["parameters"].get("position_angle_deg"),
        "separation": geometry["min_separation_mm"],
        "arm_model": geometry.get("arm_model", ""),
        "obstacles": geometry["obstacles_mm"],
        "polygons": geometry.get("obstacle_polygons_mm", []),
        "id": pack_texts([text_of(name) for name in table["id"].tolist()]),
        "x": pack(table["x"].to_value(u.mm), MM),
        "y": pack(table["y"].to_value(u.mm), MM),
        "inner": pack(np.broadcast_to(np.asarray(geometry["inner_radius_mm"], float), len(table)), MM),
        "outer": pack(np.broadcast_to(np.asarray(geometry["outer_radius_mm"], float), len(table)), MM),
        "reasons": list(IDLE_REASONS),
        "plans": [_plan(name, one) for name, one in plans.items()],
    }


def _plan(name, tile):
    """Return the name and the columns of one plan, and its idle positioners with their free targets."""
    table = tile.table
    centers = np.array([table["x"].to_value(u.mm), table["y"].to_value(u.mm)])
    columns = {
        "status": pack(table["status"]),
        # the identifier is empty for positioners without a target
        "target_id": pack(np.ma.filled(np.ma.asarray(table["target_id"]).astype(str), "")),
        "colliding_with": pack(table["colliding_with"]),
    }
    for key, decimals in PLAN_COLUMNS.items():
        if key in table.colnames:
            columns[key] = pack(table[key], decimals)
    for axis, center in zip("xy", centers, strict=True):
        columns[f"elbow_d{axis}"] = pack(table[f"elbow_{axis}"].to_value(u.mm) - center, MM)
        if not np.array_equal(table[f"arm_{axis}"].value, table[f"tip_{axis}"].value, equal_nan=True):
            columns[f"arm_{axis}"] = pack(table[f"arm_{axis}"].to_value(u.mm), MM)
    return {"name": text_of(name), "columns": columns, **_idle(tile)}


def _idle(tile):
    """Return the reasons why positioners are idle, and the free targets in reach of idle positioners.

    Each reason and each free target is a list that begins with the row of the positioner.
    """
    if tile.idle is None:
        return {"idle": None, "free": []}
    row_of = {name: k for k, name in enumerate(tile.table["id"].tolist())}
    codes = {reason: k for k, reason in enumerate(IDLE_REASONS)}
    idle, free = tile.idle, tile.idle_targets
    counts = (idle[c].tolist() for c in ("n_in_reach", "n_free", "n_possible"))
    rows = [row_of[name] for name in idle["id"].tolist()]
    found = zip(rows, (codes[reason] for reason in idle["reason"].tolist()), *counts, strict=True)
    kinds = free["kind"].tolist() if "kind" in free.colnames else ["science"] * len(free)
    columns = (
        [row_of[name] for name in free["id"].tolist()],
        [text_of(name) for name in free["target_id"].tolist()],
        np.round(free["x"].to_value(u.mm), MM).tolist(),
        np.round(free["y"].to_value(u.mm), MM).tolist(),
        kinds,
        free["possible"].astype(int).tolist(),
        [text_of(text) for text in free["colliding_with"].tolist()],
    )
    return {"idle": [list(row) for row in found], "free": [list(row) for row in zip(*columns, strict=True)]}
