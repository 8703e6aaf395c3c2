"""Maps of the sky: right ascension and declination, offsets around a pole, or the whole sky; east is to the left."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke

from rfpsurvey._sky.region import Region
from rfpsurvey._sky.shapes import border_of, circle_around

CORNERS, MOST_CORNERS = 36, 7200
"""Smallest number of points on the edge of a field, and intended total number of points on the edges of all fields. If
there are few fields, each edge has more points, so that large circles look round."""
WIDE = 60.0  # deg; the map shows the whole sky if fields extend farther from the mean direction
POLAR = 75.0  # deg; the axes are offsets if fields extend to a larger absolute declination
MARGIN = 0.03  # width of the margins of a map, as a fraction of its extent
GRID = 400  # points along each axis, for the outlines of HEALPix pixels


@dataclass(frozen=True, eq=False)
class SkyMap:
    """A map of the sky around a direction.

    ``kind`` is ``region`` (right ascension and declination, deg), ``offsets`` (offsets east and north of ``center``,
    deg) or ``whole`` (the whole sky on an Aitoff map, radians).
    """

    kind: str
    center: SkyCoord

    def to_xy(self, coord: SkyCoord) -> np.ndarray:
        """Return positions on the map, shape (..., 2)."""
        if self.kind == "whole":  # right ascension 180 deg is at the center of the map
            return np.stack([-(coord.ra - 180 * u.deg).wrap_at(180 * u.deg).rad, coord.dec.rad], axis=-1)
        if self.kind == "region":
            lon = (coord.ra - self.center.ra).wrap_at(180 * u.deg).deg + self.center.ra.deg
            return np.stack([lon, coord.dec.deg], axis=-1)
        distance, angle = self.center.separation(coord).deg, self.center.position_angle(coord).rad
        return np.stack([distance * np.sin(angle), distance * np.cos(angle)], axis=-1)

    @property
    def aspect(self) -> float:
        """Length of a unit of y on the plot, divided by the length of a unit of x."""
        return 1 / np.cos(self.center.dec.rad) if self.kind == "region" else 1.0

    def label(self, ax) -> None:
        """Label the axes, and set the ratio of their scales."""
        if self.kind == "whole":
            _label_whole_sky(ax)
        elif self.kind == "region":
            ax.xaxis.set_major_formatter(lambda lon, _: f"{lon % 360:g}")
            ax.set(aspect=self.aspect, xlabel="right ascension [deg]", ylabel="declination [deg]")
        else:
            where = f"{self.center.ra.deg:.1f} {self.center.dec.deg:+.1f}"
            ax.set(aspect=self.aspect, xlabel=f"east of {where} [deg]", ylabel=f"north of {where} [deg]")

    def show(self, ax, low: np.ndarray, high: np.ndarray) -> None:
        """Set the limits of the axes, with margins, and with east to the left; maps of the whole sky do not change."""
        margin = MARGIN * np.subtract(high, low)
        if self.kind != "whole":
            ax.set(xlim=(high[0] + margin[0], low[0] - margin[0]), ylim=(low[1] - margin[1], high[1] + margin[1]))


def map_of(centers: SkyCoord, radius: float, *, whole: bool) -> SkyMap:
    """Return a map that shows all fields with the given centers and radius (deg)."""
    center, _ = _mean_direction(centers)
    if whole:
        return SkyMap("whole", center)
    return SkyMap("offsets" if np.abs(centers.dec.deg).max() + radius > POLAR else "region", center)


def is_wide(centers: SkyCoord, radius: float) -> bool:
    """Return whether fields (radius in deg) require a map of the whole sky."""
    center, known = _mean_direction(centers)
    return not known or bool(centers.separation(center).max().deg + radius > WIDE)


def _mean_direction(centers):
    """Return the mean direction of the centers, and whether the mean direction is defined."""
    mean = centers.cartesian.mean()
    if mean.norm() < 1e-6:
        return centers[0], False
    spherical = SkyCoord(mean, frame="icrs").spherical
    return SkyCoord(spherical.lon, spherical.lat), True


def rims_of(centers: SkyCoord, radius: np.ndarray | float) -> SkyCoord:
    """Return points on the edge of each field (radius in deg), shape (n, m).

    The number of points m is ``CORNERS``, or up to 144 if there are few fields.
    """
    corners = int(np.clip(MOST_CORNERS // max(len(centers), 1), CORNERS, 4 * CORNERS)) // 4 * 4
    angles = np.linspace(0, 360, corners, endpoint=False) * u.deg
    return centers[:, None].directional_offset_by(
        angles[None, :], np.broadcast_to(radius, len(centers))[:, None] * u.deg
    )


def outlines_of_whole_sky(centers: SkyCoord, radius: np.ndarray | float) -> tuple[list[np.ndarray], np.ndarray]:
    """Return the outlines of fields on a map of the whole sky, and the row of the field to which each outline belongs.

    A field that extends across the edge of the map is divided into two outlines, unless it contains a pole.
    """
    rims = rims_of(centers, radius)
    # x on the map decreases as right ascension increases; x is continuous around the center of each field
    center = -(centers.ra - 180 * u.deg).wrap_at(180 * u.deg).rad
    away = (centers.ra[:, None] - rims.ra).wrap_at(180 * u.deg).rad
    # remove units before the loop, because astropy converts all fields on each access
    height, side = rims.dec.rad, np.copysign(np.pi / 2, centers.dec.rad)
    polar = np.abs(centers.dec.deg) + radius >= 90
    polygons, row_of = [], []
    for k in range(len(centers)):
        x, y = center[k] + away[k], height[k]
        if polar[k]:  # a field that contains a pole spans all right ascensions
            x = (x + np.pi) % (2 * np.pi) - np.pi
            order, pole = np.argsort(x), side[k]
            x = np.concatenate([[-np.pi, -np.pi], x[order], [np.pi, np.pi]])
            y = np.concatenate([[pole, y[order[0]]], y[order], [y[order[-1]], pole]])
        for shift in (0, -2 * np.pi, 2 * np.pi):
            if (x + shift).min() < np.pi and (x + shift).max() > -np.pi:
                polygons.append(np.column_stack([np.clip(x + shift, -np.pi, np.pi), y]))
                row_of.append(k)
            if polar[k]:
                break
    return polygons, np.array(row_of)


def outline_of_region(region: Region, sky_map: SkyMap) -> list[np.ndarray]:
    """Return lines along the border of a region on a map; the whole sky has no border."""
    if region.kind == "cap" and region.values[3] >= np.pi:
        return []
    if region.kind == "healpix":
        return _contours(region, sky_map)
    if region.kind == "cap":
        angles = np.linspace(0, 360, 401) * u.deg
        lines = [_to_coord(np.array(region.values[:3])).directional_offset_by(angles, region.values[3] * u.rad)]
    elif region.kind == "box":
        sides = np.split(border_of(region), 4)
        lines = [_to_coord(side) for side in (sides[:2] if region.values[1] == 2 * np.pi else sides)]
    else:
        border = border_of(region)
        lines = [_to_coord(np.vstack([border, border[:1]]))]
    return [_unjoined(sky_map.to_xy(line), sky_map) for line in lines]


def _to_coord(vectors):
    spherical = SkyCoord(*vectors.T, representation_type="cartesian").spherical
    return SkyCoord(spherical.lon, spherical.lat)


def _unjoined(points, sky_map):
    """Insert NaN where a line crosses the edge of the map."""
    edge = {"whole": np.pi, "region": 180.0}.get(sky_map.kind, np.inf)
    jumps = np.flatnonzero(np.abs(np.diff(points[:, 0])) > edge) + 1
    return np.insert(points, jumps, np.nan, axis=0)


def _contours(region, sky_map):
    """Return the borders of HEALPix regions as contours on a grid of directions."""
    vector, radius = circle_around(region)
    center = _to_coord(vector[None])[0]
    if sky_map.kind == "whole":
        x, y = np.meshgrid(np.linspace(-np.pi, np.pi, 2 * GRID), np.linspace(-np.pi / 2, np.pi / 2, GRID))
        coord = SkyCoord(np.pi - x, y, unit="rad")
    else:
        reach = np.rad2deg(radius) * 1.05
        away = np.linspace(-reach, reach, GRID)
        x, y = np.meshgrid(away, away)
        coord = center.directional_offset_by(np.arctan2(x, y) * u.rad, np.hypot(x, y) * u.deg)
        x, y = np.moveaxis(sky_map.to_xy(coord), -1, 0)
    inside = region.contains(coord.ravel()).reshape(x.shape).astype(float)
    return [line for lines in Figure().add_subplot().contour(x, y, inside, [0.5]).allsegs for line in lines]


def _label_whole_sky(ax):
    """Label right ascensions on the equator, and draw a grid."""
    degrees = np.arange(30, 360, 60)
    ax.set_xticks(np.deg2rad(180 - degrees), [f"{d}\N{DEGREE SIGN}" for d in degrees], fontsize="small")
    halo = [Stroke(linewidth=2.5, foreground="white"), Normal()]  # labels are on top of tiles
    for label in ax.get_xticklabels():
        label.set_path_effects(halo)
    ax.set_yticks(np.deg2rad(np.arange(-60, 61, 30)))
    ax.grid(color="0.85", lw=0.5)
