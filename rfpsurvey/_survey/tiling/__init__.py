"""Positions of the tiles of a survey."""
