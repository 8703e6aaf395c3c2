"""Compiled functions of numbers and arrays.

The functions do not check their input, raise no exceptions, and do not use a global random state. They copy arrays in
loops, because numba takes seconds to compile the assignment of an array to a slice.

Lengths are in mm and angles in radians. A point is a row (x, y) of an array. A segment is a column (x0, y0, x1, y1) of
an array with four rows.
"""
