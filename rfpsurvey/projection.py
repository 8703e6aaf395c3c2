"""Projection of the sky onto the focal plane, and its inverse."""

from rfpsurvey._sky.distortion_map import DistortionMap
from rfpsurvey._sky.projection import FieldProjection, TangentPlane
from rfpsurvey._sky.radial_map import RadialMap

__all__ = ["DistortionMap", "FieldProjection", "RadialMap", "TangentPlane"]
