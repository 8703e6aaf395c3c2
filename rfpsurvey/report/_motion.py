"""The motion of the arms of a tile along their paths, as facts and as data of the interactive view."""

import base64
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from rfpsurvey._common.units import to_radian
from rfpsurvey._field.tile import Tile
from rfpsurvey.errors import InputError, number_of, refusal, short
from rfpsurvey.report._blocks import Facts, View, pack
from rfpsurvey.report._views import MM, focal_plane_view

if TYPE_CHECKING:
    from rfpsurvey._instruments.paths import Paths

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
