"""Regions of the sky."""

from rfpsurvey.region._region import Region
from rfpsurvey.region._shapes import border_of, circle_around, distance_to, is_inside

__all__ = ["Region", "border_of", "circle_around", "distance_to", "is_inside"]
