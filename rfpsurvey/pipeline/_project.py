"""Positions of targets on the focal plane."""

import numpy as np

from rfpsurvey.instrument import Instrument
from rfpsurvey.projection import FieldProjection


def project_field(
    instrument: Instrument, projection: FieldProjection, vectors: np.ndarray, fiber_type: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the positions (mm) of targets on the focal plane, and the fiber type that each target requires.

    Instead of the fiber types, None is returned if all fibers can observe all targets.
    """
    if instrument.focal_plane.fiber_types == ("",):
        fiber_type = None  # all fibers have the same unnamed type, and can observe all targets
    elif isinstance(instrument.distortion, dict):
        # Each fiber type has its own image of the sky. A target that requires no fiber type uses the first fiber type.
        first = next(iter(instrument.distortion))
        given = np.full(len(vectors), "") if fiber_type is None else fiber_type
        fiber_type = np.where(given == "", first, given)
    return projection.project(vectors, fiber_type), fiber_type
