"""Joint plans of all tiles of a survey."""
