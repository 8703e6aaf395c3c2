"""Focal planes: the positioners of an instrument, their neighbors, and the targets that they reach."""

from rfpsurvey.focal_plane._arrays import FocalPlaneArrays
from rfpsurvey.focal_plane._coverage import on_footprint
from rfpsurvey.focal_plane._focal_plane import FocalPlane
from rfpsurvey.focal_plane._lattice import hexagonal_cells
from rfpsurvey.focal_plane._margins import LENGTHS, Margins
from rfpsurvey.focal_plane._obstacles import with_circles
from rfpsurvey.focal_plane._reach import Reach, accepted_types, elbow_names

__all__ = [
    "LENGTHS",
    "FocalPlane",
    "FocalPlaneArrays",
    "Margins",
    "Reach",
    "accepted_types",
    "elbow_names",
    "hexagonal_cells",
    "on_footprint",
    "with_circles",
]
