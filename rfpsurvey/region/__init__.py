"""Parts of the sky."""

from rfpsurvey.region._region import Region

__all__ = ["Region"]
