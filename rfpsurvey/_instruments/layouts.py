"""Read the entries of a description that arrange positioners in modules, and change the arm model of an instrument."""

from collections.abc import Callable, Container, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Self

import astropy.units as u
import numpy as np

from rfpsurvey._common.read_tables import read_table
from rfpsurvey._instruments.entries import select_entries, value_of
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.modules import grouped_modules, onto_surface, triangle
from rfpsurvey._instruments.positioner import ARM_MODELS, Positioner
from rfpsurvey.errors import InputError, check_choice, listed

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
        """Return the instrument with another arm model, the shape that is used to find collisions (:ref:`outlines`).

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


GENERATED = ("module_side", "module_gap", "group_gap")
RADII = ("group_radius", "module_radius")
ONLY_MODULES = ("modules", *GENERATED, *RADII, "focal_surface")
ONLY_MODULES += tuple(f"module_{name}" for name in ("rows", "corners", "places", "outline", "wall", "classes"))
ONLY_LATTICE = ("rings", "count", "inner_radius", "rows_along", "vacant_cells", "fiducial_cells", "names")
ONLY_LATTICE += ("fiber_types", "first_type_only_cells")
"""Entries of layouts without modules."""


def without_replaced(base: dict, entries: dict) -> dict:
    """Return the entries of an inherited layout that remain if the own entries state other modules or places."""
    replaced = {*ONLY_MODULES} if "table" in entries else {*RADII} if {*RADII} & {*entries} else set()
    replaced |= {*GENERATED, *RADII, "fiducial_radius"} if "modules" in entries else set()
    replaced |= {"module_rows", "module_corners", "pitch"} if "module_places" in entries else set()
    return {name: entry for name, entry in base.items() if name not in replaced - {*entries}}


def has_modules(get: Callable) -> bool:
    """Return whether a description arranges positioners in modules."""
    return any(get(f"layout.{name}") is not None for name in ("modules", *GENERATED))


def layout_of_modules(positioner: Positioner, get: Callable, folder: Path) -> FocalPlane:
    """Return the focal plane of a description with modules."""
    is_list = get("layout.modules") is not None
    unused = [*ONLY_LATTICE, *([*GENERATED, *RADII, "fiducial_radius"] if is_list else [])]
    unused += ["pitch", "module_rows", "module_corners"] if get("layout.module_places") is not None else []
    refuse_unused(get, unused, "with modules" if not is_list else "with a list of modules")
    places, corners = _places(get), np.empty((0, 2))
    columns = _classes(get, places)
    if is_list:
        xy, turn = _listed_modules(get("layout.modules"), folder)
    else:
        lacking = [name for name in GENERATED if get(f"layout.{name}") is None]
        radii = {name: get(f"layout.{name}") for name in RADII}
        radii = {name: radius for name, radius in radii.items() if radius is not None}
        if lacking or len(radii) != 1:
            got = listed(lacking) if lacking else f"{len(radii)} radii"
            raise InputError(
                f"[layout] must have modules, or {listed(GENERATED)} and either group_radius or module_radius; "
                f"{'it lacks' if lacking else 'got'} {got}"
            )
        sizes = [get(f"layout.{name}").to_value(u.mm) for name in GENERATED]
        ((name, radius),) = radii.items()
        xy, turn, corners = grouped_modules(*sizes, radius.to_value(u.mm), whole=name == "group_radius")
    if get("layout.focal_surface") is not None:
        xy = onto_surface(xy, get("layout.focal_surface").to_value(u.mm))
    if get("layout.fiducial_radius") is not None:
        radius = np.full((len(corners), 1), get("layout.fiducial_radius").to_value(u.mm))
        columns["obstacles"] = np.hstack([corners, radius]) * u.mm
    if get("layout.spectrographs") == "one a module":
        columns["spectrograph"] = np.repeat(np.arange(len(xy)), len(places))
    if get("layout.spectrographs") == "one a fiber type":
        n_types = len(dict.fromkeys(columns.get("fiber_type", [""])))
        columns["spectrograph"] = np.tile(np.arange(n_types), (len(xy) * len(places), 1))
    return FocalPlane.from_modules(
        positioner,
        centers=xy * u.mm,
        rotation=turn * u.rad,
        places=places,
        outline=get("layout.module_outline"),
        wall=get("layout.module_wall"),
        **columns,
    )


def refuse_unused(get: Callable, names: Iterable[str], what: str) -> None:
    """Raise an error if a layout has entries that it does not use."""
    for name in names:
        if get(f"layout.{name}") is not None:
            raise InputError(f"[layout] {what} must not have the entry {name!r}, which would have no effect")


def _places(get: Callable) -> u.Quantity:
    """Return the places of the positioners in a module."""
    given = get("layout.module_places")
    if given is not None:
        return given
    if get("layout.pitch") is None or get("layout.module_rows") is None:
        raise InputError("[layout] with modules must have module_places, or pitch and module_rows")
    corners = get("layout.module_corners", "used") == "used"
    return triangle(get("layout.pitch"), get("layout.module_rows"), corners=corners)


def _listed_modules(given: str | list, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the centers (mm) and rotations (rad) of modules in a list or in a file."""
    if not isinstance(given, str):
        rows = np.array(given, dtype=float)
        return rows[:, :2], np.radians(rows[:, 2])
    table = read_table(folder / given)
    lacking = [name for name in ("x", "y") if name not in table.colnames]
    if lacking or not {"rotation", "points_up"} & {*table.colnames}:
        raise InputError(
            f"{given} must have the columns x and y (mm), and rotation (deg) or points_up, got {listed(table.colnames)}"
        )

    def numbers(name, unit):
        column = table[name]
        column_unit = getattr(column, "unit", None) or unit
        values = np.ma.asarray(getattr(column, "value", column)).astype(float)
        return u.Quantity(np.ma.filled(values, np.nan), column_unit).to_value(unit)

    if {"rotation", "points_up"} <= {*table.colnames}:
        raise InputError(f"{given} must have either the column rotation or the column points_up, got both")
    if "rotation" in table.colnames:
        turn = numbers("rotation", u.deg)
    else:
        turn = 180 - 180 * numbers("points_up", u.one)
        if not np.isin(turn, (0, 180)).all():
            raise InputError(f"points_up in {given} must be 0 or 1, got other values")
    return np.column_stack([numbers("x", u.mm), numbers("y", u.mm)]), np.radians(turn)


def _classes(get: Callable, places: u.Quantity) -> dict:
    """Return the columns of the fiber types of a module, with the lengths of their arms."""
    classes, n = get("layout.module_classes"), len(places)
    if classes is None:
        return {}
    kinds, of = list(classes), np.full(n, -1)
    arms = {name: np.empty(n) for name in ("central_arm", "eccentric_arm")}
    for k, content in enumerate(classes.values()):
        rows = np.array(content.get("places", []), dtype=int)
        if len(rows) and (rows.min() < 1 or rows.max() > n):
            wrong = rows[(rows < 1) | (rows > n)][0]
            raise InputError(f"places of {kinds[k]!r} must be numbers from 1 to {n}, got {wrong}")
        if (of[rows - 1] >= 0).any() or len(np.unique(rows)) < len(rows):
            twice = next(row for row in rows.tolist() if of[row - 1] >= 0 or rows.tolist().count(row) > 1)
            raise InputError(f"each place of a module must be in one class, got two for the place {twice}")
        of[rows - 1] = k
    unlisted = [k for k, content in enumerate(classes.values()) if "places" not in content]
    if len(unlisted) > 1 or ((of < 0).any() and not unlisted):
        raise InputError(
            "exactly one class of module_classes must have no places, and contains all other places, got "
            f"{len(unlisted)} of them"
        )
    of[of < 0] = unlisted[0] if unlisted else 0
    for name, values in arms.items():
        values[:] = [classes[kinds[k]].get(name, get(f"positioner.{name}").to_value(u.mm)) for k in of]
    return {"fiber_type": np.array(kinds)[of], **{name: values * u.mm for name, values in arms.items()}}
