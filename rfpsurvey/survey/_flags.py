"""Flags that record, for each target of a survey, in which fields and in reach of which positioners it was."""

import numpy as np

SEEN, REACHED, LOST, DONE, EXCLUDED = 1, 2, 4, 8, 16


def flags_of(in_reach: np.ndarray, excluded: np.ndarray | None) -> np.ndarray:
    """Return the flags of the targets of a field.

    ``in_reach`` states whether a positioner reaches each target, and ``excluded`` whether constraints exclude it (None
    if they exclude no target).
    """
    flags = np.where(in_reach, SEEN | REACHED, SEEN).astype(np.uint8)
    if excluded is not None:
        flags[in_reach & excluded] = SEEN | EXCLUDED
    return flags
