"""Projection of the sky onto the focal plane, and its inverse."""

from rfpsurvey.projection._distortion_map import DistortionMap
from rfpsurvey.projection._field import FieldProjection, field_basis
from rfpsurvey.projection._radial_map import RadialMap
from rfpsurvey.projection._tangent_plane import TangentPlane

__all__ = ["DistortionMap", "FieldProjection", "RadialMap", "TangentPlane", "field_basis"]
