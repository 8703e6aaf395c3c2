"""Projection of the sky onto the focal plane, and its inverse."""

from rfpsurvey.projection._distortion_map import DistortionMap
from rfpsurvey.projection._field import FieldProjection, TangentPlane, field_basis, groups_of_types
from rfpsurvey.projection._radial_map import RadialMap

__all__ = ["DistortionMap", "FieldProjection", "RadialMap", "TangentPlane", "field_basis", "groups_of_types"]
