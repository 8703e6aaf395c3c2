"""Methods of `Instrument` that change the arm model, the shape of a positioner that is used to find collisions."""

from dataclasses import replace
from typing import TYPE_CHECKING

import astropy.units as u

from rfpsurvey.errors import InputError, check_choice
from rfpsurvey.positioner import ARM_MODELS, ArmOutline

if TYPE_CHECKING:
    from rfpsurvey.instrument._instrument import Instrument

__all__ = ["FULL_OUTLINE", "ArmModels"]

FULL_OUTLINE = "positioner.full_outline"
"""Name of an entry with the published outline of the arms, for instruments that have another arm model by default."""


class ArmModels:
    """Methods that `Instrument` inherits, which list and change arm models."""

    @property
    def arm_models(self) -> tuple[str, ...]:
        """Arm models that `with_arm_model` accepts; the first one is the present arm model of the instrument."""
        own = self.focal_plane.positioner.arm_model
        simpler = {"capsule": ("elbow_to_tip", "fiber_tip"), "elbow_to_tip": ("fiber_tip",)}.get(own, ())
        return (own, *simpler, *(("outline",) if FULL_OUTLINE in self.values else ()))

    def with_arm_model(self, arm_model: str) -> "Instrument":
        """Return the instrument with another arm model, the shape that is used to find collisions (:doc:`/outlines`).

        Parameters
        ----------
        arm_model : {"elbow_to_tip", "capsule", "fiber_tip", "outline"}
            One of ``arm_models``. ``outline`` is the published outline of both arms. Its polygons include all margins;
            therefore, the clearance is set to 0. ``elbow_to_tip`` and ``fiber_tip`` keep the clearance.

        Returns
        -------
        Instrument
            The instrument with this arm model.

        Raises
        ------
        InputError
            If the arm model is unknown or is not available for this instrument.

        Examples
        --------
        >>> import rfpsurvey as rs
        >>> desi = rs.Instrument.preset("desi")
        >>> desi.arm_models
        ('elbow_to_tip', 'fiber_tip', 'outline')
        >>> desi.with_arm_model("outline").focal_plane.positioner.outline
        <ArmOutline: 4 eccentric parts, 3 central parts, length 3 mm>
        """
        check_choice(arm_model, ARM_MODELS, "arm model")
        if arm_model not in self.arm_models:
            raise InputError(
                f"arm_model must be one of {', '.join(self.arm_models)} for {self.name}, got {arm_model!r}"
            )
        own = self.focal_plane.positioner.arm_model
        if arm_model == own:
            return self
        dropped = {"positioner.arm_length", FULL_OUTLINE if arm_model == "outline" else "positioner.arm_angle"}
        values = {name: entry for name, entry in self.values.items() if name not in dropped}
        source = f"with_arm_model; the arm model of the instrument is {own}"
        values["positioner.arm_model"] = {"value": arm_model, "status": "assumed", "source": source}
        changes = {"arm_model": arm_model, "arm_length": None}
        if arm_model == "outline":
            entry = self.values[FULL_OUTLINE]
            origin = {"status": entry["status"], "source": entry["source"]}
            values["positioner.arm_model"] = {"value": arm_model, **origin}
            values["positioner.outline"] = entry
            values["positioner.clearance"] = {"value": 0.0, "unit": "mm", **origin}
            changes |= {"outline": ArmOutline.from_dict(entry["value"], u.Unit(entry["unit"])), "clearance": 0 * u.mm}
        else:
            changes |= {"arm_angle": None}
        plane = self.focal_plane
        return replace(self, focal_plane=replace(plane, positioner=replace(plane.positioner, **changes)), values=values)
