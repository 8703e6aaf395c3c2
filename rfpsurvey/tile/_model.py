"""Description of the model with which the collisions and positions of a tile or a survey were computed."""

import numpy as np

from rfpsurvey.collision import Arms, Configuration, near_pairs
from rfpsurvey.instrument import Instrument, impossible_sentence
from rfpsurvey.observing import MODELS

TYPES = {
    2: "only arms of adjacent positioners can touch (collision type 2)",
    3: "arms of positioners that are not adjacent can also touch (collision type 3)",
}
ARMS = {
    "elbow_to_tip": "segments from elbow to fiber",
    "capsule": "segments of a given length from the elbow (capsules)",
    "fiber_tip": "points at the fiber",
    "outline": "outlines (polygons, capsules and discs)",
}


def collision_shape(summary: dict) -> str:
    """Return the arm model of a summary as text for a count of collisions; empty for tiles of earlier versions."""
    return f" (arm model: {summary['arm_model']})" if "arm_model" in summary else ""


def model_sentence(instrument: Instrument, posed: Arms | None = None, projection: str = "radial") -> str:
    """Return a description of the model with which collisions and positions were computed.

    Parameters
    ----------
    instrument : Instrument
        The instrument.
    posed : Arms, optional
        The arms of the tile. If None, the text describes all tiles of a survey.
    projection : str, optional
        Model of the projection, a key of ``rfpsurvey.observing.MODELS``.

    Returns
    -------
    str
        Sentences on collisions and on positions.
    """
    plane = instrument.focal_plane
    kind = plane.collision_type
    if kind == 1:
        collisions = "No two arms can touch (collision type 1), and no pair was tested"
    else:
        n_pairs, arms = len(plane.arrays.neighbors), f"exact for arms that are {ARMS[plane.positioner.arm_model]}"
        if posed is None:
            looked = (
                f"{n_pairs} pairs of arms can touch. In each tile, distances are computed only for pairs of arms that "
                "are close to each other; the distances are"
            )
        else:
            case = Configuration(plane, np.ascontiguousarray(posed.segments.T), 2, lambda: posed)
            n_near = len(near_pairs(case)[0])
            close = f"the arms of {n_near} of these pairs" if n_near else "the arms of none of these pairs"
            looked = f"{n_pairs} pairs of arms can touch. In this plan, {close} are close to each other; distances are"
        collisions = f"Collisions: {TYPES[kind]}. {looked} {arms}"
    if instrument.distortion is None or projection == "tangent":
        positions = "a tangent plane with one plate scale"
    else:
        each = ", one for each fiber type" if isinstance(instrument.distortion, dict) else ""
        positions = f"a tangent plane with the instrument's radial map{each}"
    refraction = "without refraction" if projection in ("tangent", "radial") else f"with {MODELS[projection]}"
    margins = f" Margins: {plane.margins.description}." if plane.margins else ""
    return f"{collisions}. Positions: {positions}, {refraction}.{margins}{impossible_sentence(instrument)}"
