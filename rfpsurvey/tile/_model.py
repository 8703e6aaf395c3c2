"""One sentence on the model behind a tile: what was computed, and why no more was needed."""

import numpy as np

from rfpsurvey.collision import Arms, Configuration, near_pairs
from rfpsurvey.instrument import Instrument

__all__ = ["model_sentence"]

TYPES = {
    2: "only arms of adjacent positioners can touch (collision type 2)",
    3: "arms can also touch those of positioners that are not adjacent (collision type 3)",
}
ARMS = {
    "elbow_to_tip": "segments from elbow to fiber",
    "capsule": "segments of a given length from the elbow (capsules)",
    "fiber_tip": "points at the fiber",
}


def model_sentence(instrument: Instrument, posed: Arms) -> str:
    """Return which model a tile was computed with, and why it suffices.

    Parameters
    ----------
    instrument : Instrument
        The instrument.
    posed : Arms
        The arms of the tile.

    Returns
    -------
    str
        One sentence on collisions and one on positions.
    """
    plane = instrument.focal_plane
    kind = plane.collision_type
    if kind == 1:
        collisions = "No two arms can touch (collision type 1), so that no pair was tested"
    else:
        case = Configuration(plane, np.ascontiguousarray(posed.segments.T), 2, lambda: posed)
        near, tested = len(near_pairs(case)[0]), len(plane._neighbors)
        collisions = (
            f"Collisions: {TYPES[kind]}; of {tested} pairs within reach of each other, {near} needed a distance, which "
            f"is exact for arms as {ARMS[plane.positioner.arm_model]}"
        )
    if instrument.distortion is None:
        positions = "a tangent plane with one plate scale"
    else:
        each = ", one for each fiber type" if isinstance(instrument.distortion, dict) else ""
        positions = f"a tangent plane with the instrument's radial map{each}"
    return f"{collisions}. Positions: {positions}, without refraction."
