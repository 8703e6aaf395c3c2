"""Interactive views of plans and of tiles on the sky, in notebooks and in pages, and the blocks that replace them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from html import escape

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

from rfpsurvey._assignment.allocation import IDLE_REASONS
from rfpsurvey._field.tile import Tile
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey.errors import InputError, InputTypeError, check_whole, listed
from rfpsurvey.report._blocks import SKY, Page, Picture, Rows, Section, Text, View, pack, pack_texts, text_of
from rfpsurvey.report._html import html_of

MM = 3
"""Number of decimals of lengths in mm, and of angles of arms in degrees."""
NUMBERS = ("ra", "dec", "theta", "phi", "tip_x", "tip_y", "clearance")
CLASSES = ("kind", "fiber_type", "spectrograph", "category", "priority")
"""Columns of the table of a tile that the view shows: numbers with a unit, and classes of targets and fibers."""

FEWEST = 10
"""Smallest number of targets from which the page computes positions on the sky."""


def focal_plane_view(plans: Mapping[str, Tile], still: list, max_rows: int | None = None) -> View:
    """Return the interactive view of one or several plans of a tile; the keys of ``plans`` are their names."""
    return View("focal_plane", "Focal plane", {**view_data(plans), "max_rows": max_rows}, still)


def check_plans(result: object, plans: Mapping[str, Tile] | None) -> dict[str, Tile]:
    """Return all plans of a page by name; raise an error unless they are tiles with the same positioners."""
    if plans is not None and not isinstance(plans, Mapping):
        raise InputTypeError(f"plans must be a dict of names to tiles, got {type(plans).__name__}")
    tiles = {}
    if isinstance(result, Tile):
        name = str(result.provenance["parameters"]["allocator"])
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
        "sky": _sky(tile),
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
        "plans": [_plan(name, tile_of_plan) for name, tile_of_plan in plans.items()],
    }


def _sky(tile):
    """Return the complex polynomial from the focal plane (mm) to the tangent plane of the center of the field (rad).

    It is fitted to the targets of fibers. The result is None without positions on the sky, or with few targets.
    """
    p, table = tile.provenance["parameters"], tile.table[np.asarray(tile.table["status"]) == "assigned"]
    if "ra_deg" not in p or len(table) < FEWEST:
        return None
    center = SkyCoord(p["ra_deg"], p["dec_deg"], unit="deg")
    places = SkyCoord(table["ra"], table["dec"]).transform_to(center.skyoffset_frame())
    z = table["tip_x"].to_value(u.mm) + 1j * table["tip_y"].to_value(u.mm)
    size = np.abs(z).max() or 1.0
    z, lon, lat = z / size, places.lon.wrap_at(180 * u.deg).to_value(u.rad), places.lat.to_value(u.rad)
    r2 = np.abs(z) ** 2
    terms = np.column_stack([z, np.ones(len(z)), z * r2, z.conj(), z * r2 * r2])
    fit = np.linalg.lstsq(terms, np.tan(lon) + 1j * np.tan(lat) / np.cos(lon))[0] / size ** np.array([1, 0, 3, 1, 5])
    return {"center": [p["ra_deg"], p["dec_deg"]], "terms": np.column_stack([fit.real, fit.imag]).tolist()}


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
    columns |= {name: pack(table[name], SKY.get(name, MM)) for name in NUMBERS if name in table.colnames}
    columns |= {name: pack(table[name]) for name in CLASSES if name in table.colnames}
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
    idle_rows = zip(rows, (codes[reason] for reason in idle["reason"].tolist()), *counts, strict=True)
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
    return {"idle": [list(row) for row in idle_rows], "free": [list(row) for row in zip(*columns, strict=True)]}


MOST_DRAWN = 20_000
"""Largest number of positioners in the figures of all further plans, because each figure takes time and space."""


def blocks_of_plans(plans: Mapping[str, Tile], draw: Callable, drawn: int = 0) -> list:
    """Return a table of the differences between the first plan and each plan, and a figure of each plan.

    ``draw`` returns the figure of a plan; the page has figures of the first ``drawn`` plans already.
    """
    if len(plans) < 2:
        return []
    names = list(plans)
    end = max(drawn, MOST_DRAWN // len(plans[names[0]]))
    blocks = [Rows(f"Differences of the plans from the plan {names[0]}.", differences(plans))]
    for name in names[drawn:end]:
        axes = draw(plans[name])
        for artist in (*axes.collections, *axes.lines):
            artist.set_rasterized(True)  # a page with several plans would be large
        blocks.append(Picture(f"The whole focal plane in the plan {name}.", axes))
    if names[end:]:
        blocks.append(
            Text(f"There are no figures of the plans {listed(names[end:])}; the interactive view shows them.")
        )
    return blocks


def differences(plans: Mapping[str, Tile]) -> QTable:
    """Return a table with a row for each plan, which is compared with the first plan."""
    first, rows = None, []
    for name, tile in plans.items():
        target_ids = np.ma.filled(np.ma.asarray(tile.table["target_id"]).astype(str), "")
        first = target_ids if first is None else first
        same, before, now = target_ids == first, first != "", target_ids != ""
        counts = (now, same & now, ~same & before & now, ~same & before & ~now, ~same & ~before & now)
        rows.append((name, *(int(np.count_nonzero(mask)) for mask in counts), tile.summary["n_colliding"]))
    names = ("plan", "with a target", "same target", "different target", "target only in the first plan")
    return QTable(rows=rows, names=(*names, "target only in this plan", "in collision"))


DECIMALS = 4
"""Number of decimals of positions in degrees, and of fractions."""
WIDE = 70
"""If a tile is farther than this angle (degrees) from the mean direction of all tiles, the map shows the whole sky."""
COLUMNS = (
    "tile",
    "pass",
    "round",
    "position_angle",
    "n_targets",
    "n_new",
    "n_in_field",
    "n_reachable",
    "n_assigned",
    "n_observed",
    "n_colliding",
    "collision_rate",
    "fiber_use",
    "completeness",
)


def sky_view(table: Table, radius_deg: float, still: list) -> View:
    """Return the interactive map of the tiles in a table, with fields of the given radius."""
    centers = SkyCoord(table["ra"], table["dec"])
    x, y, z = centers.cartesian.xyz.value.mean(axis=1)
    known = np.hypot(np.hypot(x, y), z) > 1e-9
    center = SkyCoord(np.arctan2(y, x) * u.rad, np.arctan2(z, np.hypot(x, y)) * u.rad)
    whole = not known or bool(centers.separation(center).max() > WIDE * u.deg)
    columns = [name for name in COLUMNS if name in table.colnames and table[name].ndim == 1]
    data = {
        "n": len(table),
        "radius": float(radius_deg),
        "whole": whole,
        # right ascension and declination at the center of the map
        "center": [round(float(center.ra.deg), 6), 0.0 if whole else round(float(center.dec.deg), 6)],
        "observed": "n_observed" in table.colnames,
        "ra": pack(table["ra"].to_value(u.deg), DECIMALS),
        "dec": pack(table["dec"].to_value(u.deg), DECIMALS),
        "columns": {name: pack(table[name], DECIMALS) for name in columns},
        "units": {name: str(getattr(table[name], "unit", None) or "") for name in columns},
    }
    return View("sky_map", "Tiles on the sky", data, still)


@dataclass(frozen=True)
class NotebookView:
    """An interactive view that notebooks show in a frame; the frame cannot access the notebook, files or the network.

    Parameters
    ----------
    title : str
        Description of the result that the view shows.
    page : str
        HTML of the page in the frame.
    height : int
        Height of the frame in pixels.
    """

    title: str
    page: str
    height: int

    def _repr_html_(self) -> str:
        return (
            f'<iframe sandbox="allow-scripts" title="{escape(self.title)}" srcdoc="{escape(self.page)}" '
            f'style="width: 100%; height: {int(self.height)}px; border: 0"></iframe>'
        )

    def __repr__(self):
        return f"<NotebookView of {self.title}>"


def notebook_view(result: Tile | Survey | Tiling, *, plans: dict | None = None, height: int = 1000) -> NotebookView:
    """Return the interactive view of a tile, a survey or a tiling.

    Parameters
    ----------
    result : Tile, Survey or Tiling
        Result to show.
    plans : dict of str to Tile, optional
        Other plans of the same tile; the keys are the names of the plans. Only allowed if ``result`` is a Tile.
    height : int, optional
        Height of the frame in pixels.

    Returns
    -------
    NotebookView
        The view.

    Raises
    ------
    InputError
        If ``result`` has another type, if ``plans`` are not tiles with the same positioners, or if ``height`` is not a
        positive integer.

    Examples
    --------
    >>> from astropy.coordinates import SkyCoord
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> center = SkyCoord("6h20m +23d")
    >>> sky = rs.synthetic_catalog("uniform", center, 0.2 * u.deg, n_targets=300, rng=1)
    >>> rs.report.notebook_view(rs.plan_tile(sky, "moons", center))
    <NotebookView of a tile of moons>
    """
    check_whole(height, "height", 1)
    if isinstance(result, Tile):
        title, view = f"a tile of {result.instrument}", focal_plane_view(check_plans(result, plans), [])
    elif isinstance(result, Survey):
        radius = result.provenance["parameters"]["radius_deg"]
        title, view = f"a survey with {result.provenance['instrument']['name']}", sky_view(result.tiles, radius, [])
    elif isinstance(result, Tiling):
        title, view = "a tiling", sky_view(result.table, result.summary.get("radius_deg", 1.0), [])
    else:
        raise InputTypeError(f"result must be a Tile, a Survey or a Tiling, got {type(result).__name__}")
    page = Page("View", title[0].upper() + title[1:], "", {}, [Section(view.caption, [view])], {})
    return NotebookView(title, html_of(page, None, framed=True), int(height))
