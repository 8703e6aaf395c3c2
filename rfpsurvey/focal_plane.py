"""Focal planes: the positioners of an instrument, their neighbors, and the targets that they reach."""

from rfpsurvey._instruments.arrays import FocalPlaneArrays
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.margins import Margins
from rfpsurvey._instruments.modules import triangle
from rfpsurvey._instruments.reach import Reach

__all__ = ["FocalPlane", "FocalPlaneArrays", "Margins", "Reach", "triangle"]
