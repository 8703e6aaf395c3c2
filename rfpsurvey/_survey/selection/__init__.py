"""Probabilities that a survey observes its targets."""
