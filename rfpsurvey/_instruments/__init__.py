"""Positioners, focal planes, instruments, and the collisions and motion of their arms."""
