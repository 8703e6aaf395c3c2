"""The content of a plot of a focal plane: positioners and their states, arms, and obstacles, in mm."""

from dataclasses import dataclass, replace

import astropy.units as u
import numpy as np

from rfpsurvey.collision import place_arms
from rfpsurvey.errors import InputTypeError, number_of
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.instrument import Instrument
from rfpsurvey.plot._axes import limits_of, named_plane
from rfpsurvey.tile import Tile

GROUPS = ("spectrograph", "fiber_type")


@dataclass(frozen=True, eq=False)
class Scene:
    """Positioners and obstacles of a focal plane, in mm; the coordinates of arms that are not drawn are NaN."""

    title: str
    centers: np.ndarray
    inner: np.ndarray
    outer: np.ndarray
    elbows: np.ndarray
    tips: np.ndarray
    bodies: np.ndarray
    """Segment of each arm that can collide, as a row (x0, y0, x1, y1)."""
    half: float
    """Half the minimum separation of two arms."""
    outline: dict | None
    """Parts of the outline of the ``eccentric`` and of the ``central`` arm, with vertices and radius in mm."""
    status: np.ndarray
    colliding: np.ndarray
    obstacles: np.ndarray
    polygons: list
    """Vertices of the polygons that no arm may touch."""
    groups: dict[str, np.ndarray]

    @property
    def with_target(self) -> np.ndarray:
        """Whether each positioner has a target."""
        return np.isin(self.status, ("assigned", "out_of_reach"))

    @property
    def points(self) -> np.ndarray:
        """Points that the compass should not cover; points on colliding arms occur four times, for a larger weight."""
        arms = np.vstack([self.elbows, self.tips, (self.elbows + self.tips) / 2])
        points = np.vstack([self.centers, arms, *[arms[np.tile(self.colliding, 3)]] * 3])
        return points[np.isfinite(points).all(axis=1)]


def scene_of(thing: Tile | FocalPlane | Instrument | str) -> Scene:
    """Return the scene of a tile, or of positioners without targets."""
    return _of_tile(thing) if isinstance(thing, Tile) else _of_plane(thing)


def _of_tile(tile):
    table, geometry, summary = tile.table, tile.table.meta["geometry"], tile.summary
    centers, elbows, tips, ends = (
        np.column_stack([table[f"{name}x"].to_value(u.mm), table[f"{name}y"].to_value(u.mm)])
        for name in ("", "elbow_", "tip_", "arm_")
    )
    starts = tips if geometry.get("arm_model") == "fiber_tip" else elbows
    counts = f"{summary['n_assigned']} of {summary['n_positioners']} assigned, {summary['n_colliding']} in collision"
    title = f"{tile.provenance['instrument']['name']}: {counts}"
    return Scene(
        title,
        centers,
        *(np.broadcast_to(geometry[f"{e}_radius_mm"], len(table)) for e in ("inner", "outer")),
        elbows,
        tips,
        np.hstack([starts, ends]),
        geometry["min_separation_mm"] / 2,
        geometry.get("outline_mm"),
        np.asarray(table["status"]),
        np.asarray(table["in_collision"]),
        np.array(geometry["obstacles_mm"]).reshape(-1, 3),
        [np.array(one) for one in geometry.get("obstacle_polygons_mm", [])],
        {name: np.asarray(table[name] if name in table.colnames else np.zeros(len(table), int)) for name in GROUPS},
    )


def _of_plane(thing):
    if not isinstance(thing, Tile | FocalPlane | Instrument | str):
        kind = type(thing).__name__
        raise InputTypeError(
            f"thing must be a Tile, a FocalPlane, an Instrument or the name of an instrument, got {kind}"
        )
    name, plane = named_plane(thing)
    name = f"{name}: " if name else ""
    n, obstacles = len(plane), len(plane.arrays.obstacles) + len(plane.arrays.obstacle_polygons)
    posed = place_arms(plane, np.full((n, 2), np.nan) * u.mm, parked_obstacles=False)
    status = np.where(plane.disabled, "disabled", "usable")
    status[plane.arrays.is_stuck] = "stuck"
    spectrograph = plane.spectrograph if plane.spectrograph.ndim == 1 else plane.spectrograph[:, 0]
    return Scene(
        name + number_of(n, "positioner") + (f", {number_of(obstacles, 'obstacle')}" if obstacles else ""),
        plane.arrays.xy,
        plane.arrays.inner_radius,
        plane.arrays.outer_radius,
        posed.elbow,
        posed.tip,
        posed.segments,
        plane.arrays.separation / 2,
        None if plane.positioner.outline is None else plane.positioner.outline.to_dict(),
        status,
        np.zeros(n, bool),
        plane.arrays.obstacles,
        list(plane.arrays.obstacle_polygons),
        {"spectrograph": spectrograph, "fiber_type": plane.fiber_type},
    )


def visible_part(scene: Scene, ax) -> Scene:
    """Return the part of a scene inside the axes, so that other parts are not drawn and have no legend entries."""
    low, high = limits_of(ax)

    def near(points, margin):
        return ((points > low - margin) & (points < high + margin)).all(axis=1)

    rows = near(scene.centers, 2 * scene.outer.max())  # arms do not extend beyond patrol areas
    columns = ("centers", "inner", "outer", "elbows", "tips", "bodies", "status", "colliding")
    own = {name: getattr(scene, name)[rows] for name in columns}
    own["groups"] = {name: values[rows] for name, values in scene.groups.items()}
    seen = near(scene.obstacles[:, :2], scene.obstacles[:, 2:])
    return replace(scene, obstacles=scene.obstacles[seen], **own)
