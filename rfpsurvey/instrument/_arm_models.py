"""Methods of `Instrument` that change the arm model, the shape of a positioner that is used to find collisions."""

from collections.abc import Container
from dataclasses import replace
from typing import Self

from rfpsurvey.errors import InputError, check_choice
from rfpsurvey.instrument._entries import select_entries, value_of
from rfpsurvey.positioner import ARM_MODELS

SECTION = "positioner."
OUTLINE = "positioner.outline"
FULL_OUTLINE = "positioner.full_outline"
"""Name of an entry with the published outline of the arms, for instruments that have another arm model."""
SEGMENT_CLEARANCE = "positioner.segment_clearance"
"""Name of an entry with the clearance of segments that replace the outline, for instruments with an outline."""
UNUSED = (FULL_OUTLINE, SEGMENT_CLEARANCE)
"""Names of entries that only `ArmModels.with_arm_model` reads; no result depends on these entries."""


def _others(arm_model: str, entries: Container[str]) -> tuple[str, ...]:
    """Return the other arm models of a positioner with an arm model and the names of its entries."""
    simpler = {"capsule": ("elbow_to_tip", "fiber_tip"), "elbow_to_tip": ("fiber_tip",)}.get(arm_model, ())
    if arm_model == "outline" and "segment_clearance" in entries:
        simpler = ("elbow_to_tip", "fiber_tip")
    return (*simpler, *(("outline",) if "full_outline" in entries else ()))


def _switch(entries: dict, present: str, arm_model: str, origin: dict) -> dict:
    """Return the entries of a positioner with another arm model, one of `_others`, in place of ``present``.

    ``origin`` contains the status and the source of the new entry ``arm_model``.
    """
    entries = dict(entries)
    if arm_model == "outline":
        entry = entries["outline"] = entries.pop("full_outline")
        origin = {"status": entry["status"], "source": entry["source"]}
        entries["segment_clearance"] = entries["clearance"]
        entries["clearance"] = {"value": 0.0, "unit": "mm", **origin}
    else:
        entries.pop("arm_angle", None)
    if present == "outline":
        entries["full_outline"] = entries.pop("outline")
        entries["clearance"] = entries.pop("segment_clearance")
    entries.pop("arm_length", None)
    entries["arm_model"] = {"value": arm_model, **origin}
    return entries


def switch_inherited(inherited: dict, given: dict) -> dict:
    """Return the entries of a positioner that a description inherits, with the arm model that the description gives.

    The entries that are ``given`` in the description itself replace the inherited entries afterwards.
    """
    present, new = (
        entry.get("value") if isinstance(entry, dict) else None
        for entry in (inherited.get("arm_model", {"value": "elbow_to_tip"}), given.get("arm_model"))
    )
    if new not in ARM_MODELS or new == present:
        return inherited
    origin = {part: given["arm_model"].get(part) for part in ("status", "source")}
    segment = given.get("segment_clearance", given.get("clearance"))
    if present == "outline" and segment is not None:
        inherited = {**inherited, "segment_clearance": segment}
    simpler = "elbow_to_tip" if new == "capsule" else new  # an inherited outline has no capsule
    if simpler != present and simpler in _others(present, inherited):
        return _switch(inherited, present, simpler, origin)
    return {name: entry for name, entry in inherited.items() if name != "arm_length"}


class ArmModels:
    """Methods that `Instrument` inherits, which list and change arm models."""

    @property
    def arm_models(self) -> tuple[str, ...]:
        """Arm models that `with_arm_model` accepts; the first one is the present arm model of the instrument."""
        present = self.focal_plane.positioner.arm_model
        return (present, *_others(present, select_entries(self.values, SECTION)))

    def with_arm_model(self, arm_model: str) -> Self:
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
        present = self.focal_plane.positioner.arm_model
        if arm_model == present:
            return self
        origin = {"status": "assumed", "source": f"with_arm_model; the arm model of the instrument is {present}"}
        entries = _switch(select_entries(self.values, SECTION), present, arm_model, origin)
        values = {SECTION + name: entry for name, entry in entries.items()}
        values |= {name: entry for name, entry in self.values.items() if not name.startswith(SECTION)}
        changes = {"arm_model": arm_model, "arm_length": None, "outline": None}
        if arm_model == "outline":
            changes["outline"] = value_of(entries["outline"])
        else:
            changes["arm_angle"] = None
        if "outline" in (present, arm_model):
            changes["clearance"] = value_of(entries["clearance"])
        plane = self.focal_plane
        return replace(self, focal_plane=replace(plane, positioner=replace(plane.positioner, **changes)), values=values)
