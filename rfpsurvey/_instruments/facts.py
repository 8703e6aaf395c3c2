"""Facts that are derived from the description of an instrument, and files with complete instruments.

A file is the table of a focal plane, whose ``meta`` contains the other values.
"""

import json
import os
from collections import Counter
from dataclasses import fields, is_dataclass
from pathlib import Path

import astropy.units as u
import numpy as np
import scipy  # its subpackages are imported on first use
from astropy.table import QTable

from rfpsurvey._common.files import check_output
from rfpsurvey._common.io import write_table
from rfpsurvey._common.read_documents import parse_json
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._instruments.entries import STATUSES
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._sky.distortion_map import DistortionMap
from rfpsurvey._sky.radial_map import RadialMap
from rfpsurvey.errors import InputError

N_POINTS = 2**18
"""Number of points at which coverage and multiplicity are computed; their standard errors are then below 0.001."""
MOST_CLASSES = 4
N_DIRECTIONS = 1440
N_PIECES = 8
"""Number of pieces into which each edge of the field is divided, because straight edges on the focal plane are curved
on the sky."""
SHAPES = {"circle": 0, "hexagon": 6, "square": 4, "triangle": 3}
SIMILAR = 0.03
"""A field has the name of a shape if the mean difference between the radii of the field and of the shape is less than
this fraction of the mean radius. The mean is taken over all directions."""
FORMATS = {
    "field_radius": "{:.4g}",
    "focal_plane_radius": "{:.1f}",
    "field_of_view": "{:.4g}",
    "footprint": "{:.4g}",
    "positioner_density": "{:.4g}",
    "coverage": "{:.4f}",
    "multiplicity": "{:.3f}",
}


def find_facts(instrument) -> dict:
    """Return the facts of an instrument by name; see `Instrument.facts`."""
    plane = instrument.focal_plane
    arrays = plane.arrays
    outline = _outline(arrays.xy, arrays.outer_radius)
    area = (_solid_angle(instrument, outline) * u.sr).to(u.deg**2)
    try:
        parts, footprint = plane.coverage(n_points=N_POINTS), plane.footprint
    except InputError:  # there are fewer than three centers, or all centers are on a line
        parts, footprint = np.array([np.nan]), np.nan * u.mm**2
    groups = np.unique(plane.spectrograph)
    return {
        "positioners": len(plane),
        "usable_positioners": int(arrays.usable.sum()),
        "fibers": _fibers(plane),
        "spectrographs": len(groups),
        "obstacles": len(arrays.obstacles) + len(arrays.obstacle_polygons),
        "field_shape": _shape(arrays.xy, outline),
        "field_radius": instrument.field_radius,
        "focal_plane_radius": float(np.hypot(*outline.T).max()) * u.mm,
        "field_of_view": area,
        "footprint": footprint,
        "plate_scale": instrument.plate_scale.to(u.um / u.arcsec),
        **arm_facts(instrument),
        "collision_type": plane.collision_type,
        "coverage": float(1 - parts[0]),
        "multiplicity": float(np.arange(len(parts)) @ parts) if np.isfinite(parts[0]) else np.nan,
        "max_multiplicity": int(np.flatnonzero(parts).max(initial=0)) if np.isfinite(parts[0]) else np.nan,
        "positioner_density": len(plane) / area,
        "layout": instrument.layout,
        **{
            status: tuple(name for name, entry in instrument.values.items() if entry["status"] == status)
            for status in STATUSES
        },
    }


def arm_facts(instrument) -> dict[str, u.Quantity]:
    """Return the lengths that describe the lattice and the arms, as medians over the positioners."""
    arrays = instrument.focal_plane.arrays
    columns = {
        "central_arm": arrays.central_arm,
        "eccentric_arm": arrays.eccentric_arm,
        "inner_patrol_radius": arrays.inner_radius,
        "patrol_radius": arrays.outer_radius,
    }
    return {
        "pitch": _pitch(arrays.xy) * u.mm,
        **{name: float(np.median(values)) * u.mm for name, values in columns.items()},
        "min_separation": arrays.separation * u.mm,
    }


def arm_classes(instrument) -> str:
    """Return text with the lengths of both arms, in mm, and the number of positioners of each class of arms."""
    arrays = instrument.focal_plane.arrays
    lengths = np.round(np.column_stack([arrays.central_arm, arrays.eccentric_arm]), 6)
    classes, numbers = np.unique(lengths, axis=0, return_counts=True)
    if len(classes) > MOST_CLASSES:
        low, high = lengths.min(axis=0), lengths.max(axis=0)
        return " + ".join(f"{a:.5g} to {b:.5g}" for a, b in zip(low, high, strict=True)) + " mm"
    return ", ".join(f"{a:.5g} + {b:.5g} mm: {n}" for (a, b), n in zip(classes, numbers, strict=True))


def field_angles(instrument, radius: np.ndarray) -> np.ndarray:
    """Return the field angles (radians) at distances (mm) from the center of the focal plane.

    If fiber types have different radial maps, the largest field angle is returned. Outside the range of a radial map,
    the largest angle of this map is used.
    """
    if instrument.distortion is None:
        return np.arctan(radius / instrument.plate_scale.to_value(u.mm / u.rad))
    maps = instrument.distortion
    maps = list(maps.values()) if isinstance(maps, dict) else [maps]
    angles = [(m.to_angle(radius * u.mm).to_value(u.rad), m.max_angle.to_value(u.rad)) for m in maps]
    return np.max([np.where(np.isnan(angle), most, angle) for angle, most in angles], axis=0)


def fact_texts(facts: dict) -> dict[str, str]:
    """Return the labels and values of facts as short texts."""
    texts = {}
    for name, value in facts.items():
        label, number, unit = name.replace("_", " "), getattr(value, "value", value), getattr(value, "unit", None)
        if name in STATUSES:
            label, text = f"{name} values", str(len(value))
        elif isinstance(value, dict):
            text = ", ".join(f"{kind or 'one type:'} {count}" for kind, count in value.items())
        elif isinstance(number, int | str):
            text = str(number)
        elif np.isnan(number):
            text = "undefined"
        else:
            text = FORMATS.get(name, "{:.5g}").format(number) + (f" {unit}".replace(" 1 / ", " per ") if unit else "")
        texts[label] = text
    return texts


def _fibers(plane) -> dict[str, int]:
    """Return the number of positioners that have each fiber type."""
    counts = Counter()
    for row, number in zip(*np.unique(plane.fiber_type, return_counts=True), strict=True):
        counts.update(dict.fromkeys(str(row).split("+"), int(number)))
    return {str(name): counts[name] for name in plane.fiber_types}


def _pitch(xy: np.ndarray) -> float:
    """Return the median distance (mm) between nearest centers, rounded to 1e-9, or NaN for a single positioner."""
    if len(xy) == 1:
        return np.nan
    return round(float(np.median(scipy.spatial.cKDTree(xy).query(xy, k=2)[0][:, 1])), 9)


def _outline(xy: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Return the corners of the convex hull of discs around centers (mm), in counter-clockwise order."""
    angle = 2 * np.pi * np.arange(N_DIRECTIONS) / N_DIRECTIONS
    outward = np.column_stack([np.cos(angle), np.sin(angle)])
    # in each direction, the hull is as far as the farthest disc
    far = np.argmax(xy @ outward.T + radius[:, None], axis=0)
    return xy[far] + radius[far, None] * outward


def _solid_angle(instrument, outline: np.ndarray) -> float:
    """Return the solid angle (sr) on the sky inside an outline on the focal plane (mm)."""
    along = (np.arange(N_PIECES) / N_PIECES)[:, None]
    points = (outline[:, None] + along * (np.roll(outline, -1, axis=0) - outline)[:, None]).reshape(-1, 2)
    radius = np.maximum(np.hypot(*points.T), 1e-6)
    # for each point, the solid angle divided by the area of the disc around the center that extends to the point
    dilation = 4 * np.sin(field_angles(instrument, radius) / 2) ** 2 / radius**2
    after = np.roll(points, -1, axis=0)
    triangles = (points[:, 0] * after[:, 1] - points[:, 1] * after[:, 0]) / 2
    return float(triangles @ (dilation + np.roll(dilation, -1)) / 2)


def _shape(xy: np.ndarray, outline: np.ndarray) -> str:
    """Return the name of the shape that is most similar to the convex hull of the centers, or ``irregular``.

    If there are too few centers for a convex hull, the outline of the patrol areas is used.
    """
    try:
        hull = scipy.spatial.ConvexHull(xy)
    except (scipy.spatial.QhullError, ValueError):
        hull = scipy.spatial.ConvexHull(outline)
    corners = hull.points[hull.vertices]
    after = np.roll(corners, -1, axis=0)
    weight = corners[:, 0] * after[:, 1] - corners[:, 1] * after[:, 0]
    # the centroid of the hull
    center = ((corners + after) * weight[:, None]).sum(axis=0) / (3 * weight.sum())
    angle = 2 * np.pi * np.arange(N_DIRECTIONS) / N_DIRECTIONS
    slope = hull.equations[:, :2] @ np.array([np.cos(angle), np.sin(angle)])
    depth = -(hull.equations[:, 2] + hull.equations[:, :2] @ center)[:, None]
    radius = np.min(np.where(slope > 1e-12, depth / np.where(slope > 1e-12, slope, 1.0), np.inf), axis=0)
    differences = {name: _difference(radius / radius.mean(), angle, n) for name, n in SHAPES.items()}
    best = min(differences, key=differences.get)
    return best if differences[best] < SIMILAR else "irregular"


def _difference(radius: np.ndarray, angle: np.ndarray, n_corners: int) -> float:
    """Return the mean difference between the radii of a field and of a regular shape in the best orientation.

    The radii of the field are divided by their mean, and so are the radii of the shape. A circle has 0 corners.
    """
    if n_corners == 0:
        return float(np.abs(radius - 1).mean())
    period = N_DIRECTIONS // n_corners
    ideal = 1 / np.cos(np.mod(angle, 2 * np.pi / n_corners) - np.pi / n_corners)
    ideal /= ideal.mean()
    return min(float(np.abs(radius - np.roll(ideal, k)).mean()) for k in range(0, period, 6))


META = "instrument"
"""Name of the entry of the ``meta`` of the table with the values that the columns do not contain."""
PLAIN = ("name", "title", "layout", "targets_per_fiber", "values", "notes")


class Written:
    """The method that `Instrument` inherits, which writes an instrument."""

    def write(self, path: str | os.PathLike, *, overwrite: bool = False) -> None:
        """Write the instrument, with all its positioners and their states, as an ECSV file that `read` reads.

        Parameters
        ----------
        path : str or path-like
            Path that ends in ``.ecsv``.
        overwrite : bool, optional
            Whether to replace an existing file.

        Raises
        ------
        InputError
            If the path does not end in ``.ecsv``, if the file exists and ``overwrite`` is False, or if the instrument
            has a distortion map with residuals.
        """
        path = check_output(path, (".ecsv",), overwrite=overwrite)
        table, optics = self.focal_plane.to_table(), self.distortion
        about = {name: getattr(self, name) for name in PLAIN} | {"plate_scale": _text(self.plate_scale)}
        if isinstance(optics, dict):
            about["distortions"] = {name: _map_to_meta(field_map) for name, field_map in optics.items()}
        elif optics is not None:
            about["distortion"] = _map_to_meta(optics)
        table.meta[META] = json.dumps(about)  # YAML would sort the names and change some numbers
        write_table(table, path, overwrite=overwrite)


def read_instrument(path: Path) -> dict:
    """Return the arguments of `Instrument` in a file that its method ``write`` wrote."""
    table = read_table(path)
    about = parse_json(table.meta.pop(META, None), f"the entry {META} of meta")
    values = {name: about[name] for name in PLAIN if name in about}
    values["focal_plane"] = FocalPlane.from_table(QTable(table))
    if "distortion" in about:
        return values | {"distortion": _map_from_meta(about["distortion"])}
    if "distortions" in about:
        return values | {"distortion": {name: _map_from_meta(meta) for name, meta in about["distortions"].items()}}
    return values | {"plate_scale": u.Quantity(about["plate_scale"])}


def _text(value: object) -> object:
    """Return a quantity as text that represents its numbers exactly, and other values as ECSV stores them."""
    if isinstance(value, u.Quantity):
        numbers = np.asarray(value.value).tolist()
        return f"{numbers!r} {value.unit}" if value.isscalar else [f"{number!r} {value.unit}" for number in numbers]
    return list(value) if isinstance(value, tuple) else value


def _map_to_meta(optics: RadialMap | DistortionMap) -> dict:
    if not is_dataclass(optics) or getattr(optics, "residuals", None) is not None:
        raise InputError("an instrument with a distortion map that contains residuals cannot be written")
    values = {field.name: getattr(optics, field.name) for field in fields(optics)}
    return {name: _text(value) for name, value in values.items() if value is not None}


def _map_from_meta(meta: dict) -> RadialMap | DistortionMap:
    quantities = {"max_angle", "unit_angle", "radius", "adc"}
    given = {name: u.Quantity(value) if name in quantities else value for name, value in meta.items()}
    return (RadialMap if "form" in given else DistortionMap)(**given)
