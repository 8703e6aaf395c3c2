"""Focal planes: the positioners of an instrument, their neighbors, and the targets that they reach."""

from rfpsurvey.focal_plane._arrays import FocalPlaneArrays
from rfpsurvey.focal_plane._coverage import on_footprint
from rfpsurvey.focal_plane._focal_plane import FocalPlane
from rfpsurvey.focal_plane._kinematics import to_sides
from rfpsurvey.focal_plane._lattice import cell_centers, hexagonal_cells
from rfpsurvey.focal_plane._margins import Margins
from rfpsurvey.focal_plane._modules import grouped_modules, onto_surface, triangle
from rfpsurvey.focal_plane._obstacles import with_circles
from rfpsurvey.focal_plane._reach import Reach, accepted_types, elbow_names

__all__ = [
    "FocalPlane",
    "FocalPlaneArrays",
    "Margins",
    "Reach",
    "accepted_types",
    "cell_centers",
    "elbow_names",
    "grouped_modules",
    "hexagonal_cells",
    "on_footprint",
    "onto_surface",
    "to_sides",
    "triangle",
    "with_circles",
]
