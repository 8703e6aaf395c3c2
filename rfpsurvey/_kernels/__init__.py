"""Compiled functions of scalars and arrays, without checks, exceptions, random state, and globals except constants.

No array is assigned to a slice of another one: numba would then compile the text of an error message, which takes
seconds. Lengths are in mm and angles in radians. Points are rows (x, y); segments are rows (x0, y0, x1, y1).
"""
