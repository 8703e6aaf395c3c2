"""Recorded events of surveys, and what follows from them."""
