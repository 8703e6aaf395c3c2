"""The report page of a tile, with the motion of its arms along paths as facts and as data of the interactive view."""

import base64
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from matplotlib.axes import Axes

from rfpsurvey._assignment.constraints.field import FAIL, NOT_CHECKABLE, PASS
from rfpsurvey._assignment.constraints.text import recorded_constraints
from rfpsurvey._assignment.methods import METHODS
from rfpsurvey._common.units import to_radian
from rfpsurvey._field.facts import rules_of_tile, tile_facts, tile_objectives, tile_problems
from rfpsurvey._field.table import collision_shape
from rfpsurvey._field.tile import Tile
from rfpsurvey.errors import InputError, number_of, refusal, short
from rfpsurvey.plot import plot_focal_plane, plot_quality
from rfpsurvey.report._blocks import Facts, Page, Picture, Rows, Section, Text, View, model_facts, pack
from rfpsurvey.report._views import MM, blocks_of_plans, focal_plane_view

if TYPE_CHECKING:
    from rfpsurvey._instruments.paths import Paths

COLUMNS = (
    "id",
    "colliding_with",
    "clearance",
    "status",
    "target_id",
    "kind",
    "fiber_type",
    "spectrograph",
    "ra",
    "dec",
    "x",
    "y",
    "theta",
    "phi",
)
NARROW = 25
MARGIN = 4  # half width of the enlarged square, divided by the outer radius of the largest patrol area
MOST_OBJECTIVES = 12
TITLE = 0.35  # height (inches) of the title of a figure; the page shows a caption instead of the title
LITTLE = 60  # if there are more positioners than this, a second figure enlarges a part of the focal plane


def page_of_tile(
    tile: Tile, where: str, plans: Mapping[str, Tile], max_rows: int | None, paths: "Paths | None" = None
) -> Page:
    """Return the report page of a tile.

    ``where`` is the name of the file that contains the complete tile; ``plans`` contains the plans that the interactive
    view of the focal plane shows. If there are ``paths``, the arms move in this view.
    """
    summary, parameters = tile.summary, tile.provenance["parameters"]
    name = tile.provenance["instrument"]["name"]
    counts = f"{summary['n_assigned']} of {summary['n_positioners']} positioners have a target"
    arms = f"{summary['n_colliding'] or 'none'} of the arms {'is' if summary['n_colliding'] == 1 else 'are'}"
    highlights = {"targets in the field": summary["n_in_field"]} if "n_in_field" in summary else {}
    highlights["collision rate of assigned arms"] = summary.get("collision_rate_assigned", np.nan)
    result = [Facts("Request", _asked(tile)), Facts("Result", tile_facts(tile)), *_objectives(tile)]
    result += [] if paths is None else [motion_facts(paths)]
    sections = [Section("Focal plane", [_view(tile, where, plans, max_rows, paths)])]  # on the first screen
    sections.append(Section("Request and result", [*result, Facts("Computing times in seconds", summary["seconds"])]))
    if summary.get("unmet") or recorded_constraints(parameters):
        verdicts = [] if tile.rules is None else tile.rules["verdict"].tolist()
        unknown = number_of(verdicts.count(NOT_CHECKABLE), "constraint")
        met = f"No constraint is violated; not checkable: {unknown}."
        unmet = summary.get("unmet") or [met if NOT_CHECKABLE in verdicts else "All constraints are met."]
        blocks = (
            [Text(list(unmet))] if len(unmet) > 2 or not summary.get("unmet") else []
        )  # others are in the first lines
        if tile.rules is not None:
            caption = "Verdict on each constraint, with the positioners whose fibers violate it."
            rows = QTable(rows=rules_of_tile(tile.rules), names=tile.rules.colnames)
            blocks.append(Rows(caption, rows, marks={PASS: "good", FAIL: "bad", NOT_CHECKABLE: "open"}))
        sections += [Section("Constraints", blocks)] if blocks else []
    if tile.completeness is not None:
        sections.append(Section("Completeness", _completeness(tile)))
    sections.append(Section("Collisions", _collisions(tile, where or "the table of the tile")))
    lead = "; ".join([counts, f"{arms} in collision{collision_shape(summary)}", *tile_problems(tile)]) + "."
    if parameters["allocator"] == "scored":
        lead = f"Score of a plan with the {tile.provenance['instrument'].get('layout') or 'given'} instrument: {lead}"
    return Page("Tile", _title(name, parameters), lead, highlights, sections, tile.provenance)


def _title(name, parameters) -> str:
    if "ra_deg" not in parameters:
        return f"A tile of {name}"
    place = SkyCoord(parameters["ra_deg"], parameters["dec_deg"], unit="deg")
    return f"{name} at {place.to_string('hmsdms', sep=':', precision=0)}"


def _asked(tile) -> dict:
    """Return the parameters of a tile as labels and values with units."""
    p, catalog = tile.provenance["parameters"], tile.provenance["catalog"]
    asked = {"instrument": tile.provenance["instrument"]["name"], "allocator": p["allocator"]}
    if "ra_deg" in p:
        asked["center (ICRS)"] = f"{p['ra_deg']:.6f} {p['dec_deg']:+.6f} deg"
        asked["position angle"] = f"{p['position_angle_deg']:g} deg from the north of {p['north_of']}"
    asked["catalog"] = catalog.get("file") or catalog.get("synthetic") or "given in memory"
    if catalog.get("columns"):
        asked["columns of the catalog"] = catalog["columns"]
    asked["epoch"] = p.get("epoch") or "not stated"
    asked["constraints"] = recorded_constraints(p) or "none"
    if p.get("sky_separation_mm"):
        asked["minimum distance of sky positions from targets"] = f"{p['sky_separation_mm']:.4g} mm"
    if p["allocator"] in METHODS and METHODS[p["allocator"]].searches:
        asked["objective"], asked["time limit"] = p["objective"], f"{p['time_limit_s']:g} s"
    parked = "those that are parked, with two arms of equal length"
    asked["idle arms that are obstacles"] = parked if p.get("parked_obstacles", True) else "none"
    return asked | model_facts(tile)


def _objectives(tile) -> list:
    """Return the number of fibers on each class of targets, and the gap to the best plan."""
    objectives, gap = tile_objectives(tile, MOST_OBJECTIVES), tile.summary.get("gap")
    values = {name: f"{value} (bound: {proof})" if proof else value for name, value, proof in objectives}
    if gap is not None:
        values["gap to the best plan"] = gap
    return [Facts("Fibers on each class of targets, in order of priority", values)] if values else []


def _completeness(tile) -> list:
    """Return a figure and a table with the numbers of assigned and observed targets of each class."""
    words = "A target of the field is observed if it is assigned to a positioner that is not in collision."
    axes = plot_quality(tile)
    axes[0].set_title("", loc="left")
    about = (
        "The first panel shows the outcomes of the targets in the field by class, with the numbers of observed targets "
        "and of all targets on the right. The second panel shows the numbers of fibers by the kind of target or by "
        "requirement. The third panel is a histogram of a column of the catalog. The fourth panel shows the fractions "
        "of science targets that are in reach and that are assigned, in rings of equal area around the center of the "
        "field, with 68\N{NO-BREAK SPACE}% intervals."
    )
    figure = Picture("Targets that are available, in reach and assigned.", axes[0], about)
    table = [Rows("Targets of the field by class.", tile.completeness)] if len(tile.completeness) > 1 else []
    return [Text(words), figure, *table]


def _pictures(tile) -> list:
    whole = draw_plane(tile)
    dots = whole.get_legend() is not None and "fiber on a target" in {
        t.get_text() for t in whole.get_legend().get_texts()
    }
    if dots:
        words = (
            "Blue dots are fibers on their targets, gray dots are positioners without a target, and diamonds are "
            "positioners in collision."
        )
    else:
        shading = "The shading around each arm is half the minimum separation wide on each side"
        if tile.summary.get("arm_model") == "outline":
            shading = "The shading is the outline of both arms of a positioner"
        words = (
            "Circles are the outer edges of patrol areas, and dotted circles are the inner edges. "
            f"{shading}: two arms collide if their shadings overlap."
        )
    if "position_angle_deg" in tile.provenance["parameters"]:
        words += " East is to the left of north, as on the sky; arrows point to north and east."
    pictures = [Picture("The whole focal plane.", whole, words)]
    if len(tile.table) > LITTLE:
        corner = _crowded(tile)
        words = "This part of the focal plane has the smallest clearance between two arms."
        if tile.summary["n_colliding"]:
            words = (
                "This part of the focal plane has the most collisions. Arms collide if their shadings overlap; the "
                "shadings of colliding arms are hatched."
            )
        pictures.append(Picture("Part of the focal plane, enlarged.", draw_plane(tile, corner), words))
    return pictures


def draw_plane(tile: Tile, region: u.Quantity | None = None) -> Axes:
    """Return a plot of the focal plane, or of a part of it, without a title."""
    ax = plot_focal_plane(tile, region=region)
    ax.set_title("")
    width, height = ax.figure.get_size_inches()
    ax.figure.set_size_inches(width, height - TITLE)
    return ax


def _crowded(tile) -> u.Quantity:
    """Return the corners of a square with the most collisions or, if there are none, with the smallest clearance."""
    xy = np.column_stack([tile.table["x"].to_value(u.mm), tile.table["y"].to_value(u.mm)])
    colliding = np.asarray(tile.table["in_collision"])
    outer = np.max(tile.table.meta["geometry"]["outer_radius_mm"])
    half = MARGIN * outer
    if colliding.any():
        near = (np.abs(xy[colliding][:, None] - xy[colliding][None]) < half).all(axis=2).sum(axis=1)
        center = xy[colliding][near == near.max()]
        center = center[np.hypot(*center.T).argmin()]
    else:
        clearance = np.nan_to_num(tile.table["clearance"].to_value(u.mm), nan=np.inf)
        center = xy[clearance.argmin()]
    # the square must not extend beyond the outermost patrol areas
    center = np.clip(center, xy.min(axis=0) - outer + half, np.maximum(xy.max(axis=0) + outer - half, xy.min(axis=0)))
    return np.stack([center - half, center + half]) * u.mm


def _collisions(tile, where) -> list:
    """Return a table of the positioners in collision, and a table of other positioners with the smallest clearances."""
    table = tile.table[[c for c in COLUMNS if c in tile.table.colnames and not _empty(tile.table[c])]]
    colliding = np.asarray(tile.table["in_collision"])
    clearance = np.nan_to_num(tile.table["clearance"].to_value(u.mm), nan=np.inf)
    free = np.flatnonzero(~colliding & np.isfinite(clearance))
    narrow = free[np.argsort(clearance[free], kind="stable")]
    words = "The clearance is the distance to the nearest other arm, minus the minimum separation."
    blocks = [Text(f"{words}{_not_counted(tile)}{'' if colliding.any() else ' No arm is in collision.'}")]
    if colliding.any():
        blocks.append(Rows("Positioners in collision.", table[colliding], where))
    narrow_rows = table[narrow[:NARROW]][[c for c in table.colnames if c != "colliding_with"]]
    left_out = len(narrow) - len(narrow_rows)
    return [
        *blocks,
        Rows("Positioners without a collision that have the smallest clearances.", narrow_rows, where, left_out),
    ]


def _not_counted(tile) -> str:
    """Return a sentence on arms in collision that the summary does not count; the text is empty if there are none."""
    colliding, n = np.asarray(tile.table["in_collision"]), tile.summary["n_colliding"]
    n_more = int(colliding.sum()) - n
    if n_more <= 0:
        return ""
    status = np.asarray(tile.table["status"])[colliding]
    what = " or ".join(sorted({word for word in status.tolist() if word not in ("assigned", "out_of_reach")}))
    return (
        f" The table has {n + n_more} rows: the {number_of(n, 'positioner')} in collision, and {n_more} more with the "
        f"status {what}, which cannot move to a target. The number of positioners in collision and the collision rate "
        "do not count the latter."
    )


def _view(tile, where, plans, max_rows, paths) -> View:
    """Return the interactive view of all assignments; in browsers that run no scripts, figures replace the view."""
    words = "The interactive view lists all assignments, but it requires a browser that runs scripts."
    words += f" The file {where} also contains all assignments." if where else ""
    still = [*_pictures(tile), *blocks_of_plans(plans, draw_plane, 1), Text(words)]
    return focal_plane_view(plans, still, max_rows) if paths is None else motion_view(plans, paths, still, max_rows)


def _empty(column) -> bool:
    return column.dtype.kind == "U" and not (np.ma.filled(column, "") != "").any()


PER_DEG = 100
"""The data contain angles as integers in units of 1/100 deg, and times in units of 1 ms (0.1 ms for fast motions)."""
SLOW = 10.0
"""Motions of at least this duration (s) are slow."""
SAME = 1e-6
"""Largest difference (rad) of angles of the tile from those at the ends of the paths."""


def check_paths(tile: object, paths: "Paths | bool | None") -> "Paths | None":
    """Return the paths that a page shows, which are planned if ``paths`` is True; they must lead to the tile."""
    if paths is None or paths is False:
        return None
    from rfpsurvey._instruments.paths import Paths  # most pages show no paths

    if not (paths is True or isinstance(paths, Paths)):
        raise refusal("paths must be True or an object of the class Paths", paths, Paths)
    if not isinstance(tile, Tile):
        raise InputError(f"paths must be given only for a Tile, got paths for {short(tile)}")
    if paths is True:
        return tile.paths()
    table, plane = tile.table, paths.focal_plane
    places = np.column_stack([table[c].to_value(u.mm) for c in ("x", "y")])
    if not np.array_equal(np.asarray(table["id"]).astype(str), plane.id.astype(str)) or not np.allclose(
        places, plane.xy.to_value(u.mm), rtol=0, atol=SAME
    ):
        raise InputError(
            f"paths must belong to the {number_of(len(table), 'positioner')} of the tile, got paths of "
            f"{number_of(len(plane), 'positioner')} of another focal plane"
        )
    posed, first = np.isin(np.asarray(table["status"]), ("assigned", "out_of_reach")), paths.start[:-1]
    away = np.zeros(len(table), dtype=bool)
    for name in ("theta", "phi"):
        difference = to_radian(table[name], name) - getattr(paths, name)[first].to_value(u.rad)
        away |= ~(np.abs(np.sin(0.5 * difference)) < SAME)
    if (posed & away).any():
        raise InputError(
            f"paths must lead to the poses of the tile, but {number_of(int((posed & away).sum()), 'arm')} with a "
            f"target have other poses; the first is that of the positioner {plane.id[int(np.argmax(posed & away))]}"
        )
    return paths


def motion_facts(paths: "Paths") -> Facts:
    """Return the facts of the motion that a page shows."""
    speed = paths.meta.get("speed_deg_s")
    values = {
        "arms with a target that arrive": f"{paths.n_arriving} of {int(paths.assigned.sum())}",
        "duration": f"{paths.duration.to_value(u.s):.1f} s",
        "smallest distance of two arms (proven)": f"{paths.smallest_distance.to_value(u.mm):.3f} mm",
    }
    if speed is not None:
        assumed = " (assumed)" if paths.meta.get("speed_is_assumed") else ""
        values["speed of the joints"] = f"{speed:.4g} deg / s{assumed}"
    if paths.groups:
        values["arms that do not arrive"] = [f"{', '.join(ids)} ({reason})" for ids, reason in paths.groups]
    return Facts("Motion from the folded poses to the plan", values)


def motion_view(plans: Mapping[str, Tile], paths: "Paths", still: list, max_rows: int | None = None) -> View:
    """Return the interactive view of a tile whose arms move along paths; the paths belong to the first plan."""
    view = focal_plane_view(plans, still, max_rows)
    return replace(view, kind="motion", data={**view.data, "motion": motion_data(paths)})


def motion_data(paths: "Paths") -> dict:
    """Return the break points and the sizes of all arms.

    The text ``knots`` contains integers (see `pack_integers`): the number of break points of each positioner (0 for an
    absent arm), the times of the inner break points, and the angles of the central arms and from the central to the
    eccentric arms at all break points. The order is that of the motion from the folded poses to the plan. Each integer
    is the difference from the break point before; at the first break point, it is the difference from the positioner
    before.
    """
    from rfpsurvey._instruments.path_arms import bodies_of

    n, plane, duration = len(paths.start) - 1, paths.focal_plane, paths.duration.to_value(u.s)
    per_second = 1000 if duration >= SLOW else 10_000
    rows, columns = np.arange(n), plane.arrays.using(paths.fiber)
    bodies, offset = bodies_of(columns, rows, paths.fiber)
    owner = np.repeat(rows, np.diff(paths.start))
    unfold = np.argsort(owner[::-1], kind="stable")
    theta, phi = columns.from_joints(
        paths.theta.to_value(u.rad), paths.phi.to_value(u.rad), owner, np.asarray(paths.fiber)[owner]
    )
    time = duration - paths.time.to_value(u.s)
    time, theta, phi = (v[::-1][unfold] for v in (time, theta, phi + offset[owner]))
    present = np.isfinite(theta)
    owner, time = owner[present], np.rint(time[present] * per_second).astype(int)
    angles = [np.rint(np.rad2deg(v[present]) * PER_DEG).astype(int) for v in (theta, phi)]
    first, last = (np.diff(owner, **{end: -1}) != 0 for end in ("prepend", "append"))
    steps = [_steps(time, first)[~first & ~last], *(_steps(v, first) for v in angles)]
    signed = [np.where(v < 0, -2 * v - 1, 2 * v) for v in steps[1:]]
    counts = np.bincount(owner, minlength=n)
    g, outline = columns.geometry_of(rows, paths.fiber), plane.positioner.outline
    sizes = {"l1": bodies.l1, "l2": g.l2, "inner": bodies.inner, "length": bodies.length, "reach": bodies.reach}
    sizes |= {"offset": np.rad2deg(offset)}
    return {
        "duration": round(float(duration * per_second)) / per_second,
        "per_second": per_second,
        "per_deg": PER_DEG,
        "knots": pack_integers(np.concatenate([counts, steps[0], *signed]).tolist()),
        "sizes": {name: pack(np.broadcast_to(np.asarray(v, dtype=float), n), MM) for name, v in sizes.items()},
        "fixed": np.flatnonzero(~columns.usable).tolist(),
        "central": bodies.central,
        "parts": [] if outline is None else [[np.round(v, 4).tolist(), float(r)] for v, r in outline.parts],
        "n_eccentric": 0 if outline is None else outline.n_eccentric,
    }


def _steps(values, first):
    """Return the differences between break points; those of the first break points are between positioners."""
    steps = np.diff(values, prepend=0)
    steps[first] = np.diff(values[first], prepend=0)
    return steps


def pack_integers(values: Iterable[int]) -> str:
    """Return nonnegative integers as base64 text; each byte contains 7 bits, the lowest of an integer first.

    The highest bit of a byte is 1 if more bytes of the same integer follow.
    """
    packed = bytearray()
    for value in values:
        while value > 127:
            packed.append(value & 127 | 128)
            value >>= 7
        packed.append(value)
    return base64.b64encode(packed).decode()
