"""Catalogs of targets, regions of the sky, projections, and observing conditions."""
