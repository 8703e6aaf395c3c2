"""The assignment of targets to positioners: allocators, and the constraints that plans follow."""
