"""Compiled code: scalars and arrays in, arrays out; no checks, no raising, no random state, no globals but constants.

No array is assigned to a slice of another: numba would compile the text of its error message, which takes seconds.
Lengths are in mm and angles in radians. Points are rows (x, y); segments are rows (x0, y0, x1, y1).
"""
