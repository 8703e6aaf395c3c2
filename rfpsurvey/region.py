"""Regions of the sky."""

__all__: list[str] = []
