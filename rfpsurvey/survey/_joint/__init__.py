"""Joint plans: all tiles of a survey are planned together."""
