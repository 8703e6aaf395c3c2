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
    fiber_type = required_types(instrument, len(vectors), fiber_type)
    return projection.project(vectors, fiber_type), fiber_type


def required_types(instrument: Instrument, n: int, fiber_type: np.ndarray | None) -> np.ndarray | None:
    """Return the fiber type that each of n targets requires; None if all fibers can observe all targets."""
    if instrument.focal_plane.fiber_types == ("",):
        return None  # all fibers have the same unnamed type, and can observe all targets
    if not isinstance(instrument.distortion, dict):
        return fiber_type
    # Each fiber type has its own image of the sky. A target that requires no fiber type uses the first fiber type.
    first = next(iter(instrument.distortion))
    given = np.full(n, "") if fiber_type is None else fiber_type
    return np.where(given == "", first, given)
