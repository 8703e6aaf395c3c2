"""Regions of the sky."""

from rfpsurvey._sky.region import Region

__all__ = ["Region"]
