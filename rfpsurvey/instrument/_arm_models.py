"""Methods of `Instrument` that change the arm model, the shape of a positioner that is used to find collisions."""

from dataclasses import replace
from typing import TYPE_CHECKING

import astropy.units as u

from rfpsurvey.errors import InputError, check_choice
from rfpsurvey.positioner import ARM_MODELS, ArmOutline

if TYPE_CHECKING:
    from rfpsurvey.instrument._instrument import Instrument

__all__ = ["FULL_OUTLINE", "OUTLINE", "SEGMENT_CLEARANCE", "UNUSED", "ArmModels"]

OUTLINE = "positioner.outline"
FULL_OUTLINE = "positioner.full_outline"
"""Name of an entry with the published outline of the arms, for instruments that have another arm model."""
SEGMENT_CLEARANCE = "positioner.segment_clearance"
"""Name of an entry with the clearance of segments that replace the outline, for instruments with an outline."""
UNUSED = (FULL_OUTLINE, SEGMENT_CLEARANCE)
"""Names of entries that only `ArmModels.with_arm_model` reads; no result depends on these entries."""


class ArmModels:
    """Methods that `Instrument` inherits, which list and change arm models."""

    @property
    def arm_models(self) -> tuple[str, ...]:
        """Arm models that `with_arm_model` accepts; the first one is the present arm model of the instrument."""
        own = self.focal_plane.positioner.arm_model
        simpler = {"capsule": ("elbow_to_tip", "fiber_tip"), "elbow_to_tip": ("fiber_tip",)}.get(own, ())
        if own == "outline" and SEGMENT_CLEARANCE in self.values:
            simpler = ("elbow_to_tip", "fiber_tip")
        return (own, *simpler, *(("outline",) if FULL_OUTLINE in self.values else ()))

    def with_arm_model(self, arm_model: str) -> "Instrument":
        """Return the instrument with another arm model, the shape that is used to find collisions (:doc:`/outlines`).

        Parameters
        ----------
        arm_model : {"elbow_to_tip", "capsule", "fiber_tip", "outline"}
            One of ``arm_models``. ``outline`` is the published outline of both arms. Its polygons include all margins;
            therefore, the clearance is set to 0. ``elbow_to_tip`` and ``fiber_tip`` have the clearance
            ``positioner.segment_clearance`` if the arm model of the instrument is ``outline``, and keep the clearance
            otherwise.

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
        ('outline', 'elbow_to_tip', 'fiber_tip')
        >>> desi.focal_plane.positioner.outline
        <ArmOutline: 4 eccentric parts, 3 central parts, length 3 mm>
        >>> desi.with_arm_model("elbow_to_tip").focal_plane.positioner.clearance
        <Quantity 0.99 mm>
        """
        check_choice(arm_model, ARM_MODELS, "arm model")
        if arm_model not in self.arm_models:
            raise InputError(
                f"arm_model must be one of {', '.join(self.arm_models)} for {self.name}, got {arm_model!r}"
            )
        own = self.focal_plane.positioner.arm_model
        if arm_model == own:
            return self
        values = dict(self.values)
        changes = {"arm_model": arm_model, "arm_length": None, "outline": None}
        source = f"with_arm_model; the arm model of the instrument is {own}"
        origin = {"status": "assumed", "source": source}
        if arm_model == "outline":
            entry = values[OUTLINE] = values.pop(FULL_OUTLINE)
            origin = {"status": entry["status"], "source": entry["source"]}
            values[SEGMENT_CLEARANCE] = values["positioner.clearance"]
            values["positioner.clearance"] = {"value": 0.0, "unit": "mm", **origin}
            changes |= {"outline": ArmOutline.from_dict(entry["value"], u.Unit(entry["unit"])), "clearance": 0 * u.mm}
        else:
            changes |= {"arm_angle": None}
            values.pop("positioner.arm_angle", None)
        if own == "outline":
            values[FULL_OUTLINE] = values.pop(OUTLINE)
            entry = values["positioner.clearance"] = values.pop(SEGMENT_CLEARANCE)
            changes |= {"clearance": entry["value"] * u.Unit(entry["unit"])}
        values.pop("positioner.arm_length", None)
        values["positioner.arm_model"] = {"value": arm_model, **origin}
        plane = self.focal_plane
        return replace(self, focal_plane=replace(plane, positioner=replace(plane.positioner, **changes)), values=values)
