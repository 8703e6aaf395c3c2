"""Compiled functions of scalars and arrays, without checks, exceptions or random state; the only globals are constants.

No array is assigned to a slice of another array, because numba would then spend seconds to compile the text of an
error message. Lengths are in mm and angles in radians. Points are rows (x, y); segments are rows (x0, y0, x1, y1).
"""
