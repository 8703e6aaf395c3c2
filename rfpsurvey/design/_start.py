"""The design of an instrument, around which a scan varies the parameters."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np

from rfpsurvey.design._axes import AXES
from rfpsurvey.errors import InputError, warn
from rfpsurvey.instrument import Instrument, arm_facts

N_POINTS = 2**16
SAME = 1e-9
"""Two designs are equal if the relative differences of their parameters are below this value."""


@dataclass(frozen=True, eq=False)
class Start:
    """The design of an instrument."""

    name: str
    design: np.ndarray
    """central_arm, ratio, pitch and clearance, with lengths in mm."""
    step: float
    """Motor step, in radians."""

    def among(self, designs: np.ndarray) -> tuple[np.ndarray, int, dict]:
        """Return the designs including the design of the instrument, its row number, and a description for ``meta``."""
        same = np.isclose(designs, self.design, rtol=SAME, atol=0).all(axis=1)
        added = not same.any()
        record = {"name": self.name, "added": added, **dict(zip(AXES, self.design.tolist(), strict=True))}
        return (np.vstack([designs, self.design]), len(designs), record) if added else (designs, same.argmax(), record)


def start_of(model: Instrument) -> Start:
    """Return the design of an instrument: its arms, the pitch of its lattice, and its clearance and motor step."""
    if len(model.focal_plane) < 2:
        raise InputError(
            f"{model.name} must have at least two positioners, because a design needs a pitch, got one positioner"
        )
    if model.focal_plane.margins:
        raise InputError(
            f"{model.name} must have no margins, because the designs of a scan have none, got "
            f"{model.focal_plane.margins}; use the instrument without with_margins"
        )
    if "module" in (model.focal_plane.groups or {}):
        reach = 1 - model.focal_plane.coverage(n_points=N_POINTS, rng=0)[0]
        warn(
            f"the designs are infinite lattices without the gaps between the modules of {model.name}: all values refer "
            f"to the lattice inside a module; positioners of {model.name} reach {reach:.3f} of its focal plane"
        )
    own = model.focal_plane.positioner.arm_model
    if "elbow_to_tip" in model.arm_models:
        model = model.with_arm_model("elbow_to_tip")
    elif own == "outline":
        raise InputError(
            f"{model.name} must have the entry positioner.segment_clearance, because a scan of designs replaces the "
            "outline of the arms by a segment with this clearance, got no such entry"
        )
    facts = {name: float(value.to_value(u.mm)) for name, value in arm_facts(model).items()}
    unit = model.focal_plane.positioner
    if own != "elbow_to_tip":
        warn(
            f"the scan uses the arm model 'elbow_to_tip' with a clearance of {unit.numbers.clearance:g} mm instead of "
            f"the arm model {own!r} of {model.name}"
        )
    central_arm, eccentric_arm, clearance = facts["central_arm"], facts["eccentric_arm"], unit.numbers.clearance
    moved = (facts["min_separation"] - 2 * clearance) / (central_arm + eccentric_arm)
    if not moved < 1:
        raise InputError(
            f"the displacement of an arm of {model.name} within a motor step must be less than the total length of "
            "both arms"
        )
    design = np.array([central_arm, eccentric_arm / central_arm, facts["pitch"], clearance])
    return Start(model.name, design, float(np.arcsin(max(moved, 0.0)) / 2))
