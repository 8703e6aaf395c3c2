"""Poses that a plan records: the handedness of arms with a target, and the poses of arms without a target."""

from typing import NamedTuple

import astropy.units as u
import numpy as np
from astropy.table import Table

from rfpsurvey._units import to_plain
from rfpsurvey.catalog import Finder
from rfpsurvey.collision import Arms
from rfpsurvey.errors import number_of, warn
from rfpsurvey.instrument import Instrument
from rfpsurvey.plans import is_plan

GOOD = 1  # fiberStatus of PFS
TOLERANCE_MM = 0.1
"""Largest distance between the position of a fiber and the position computed from its recorded joint angles."""


class Recorded(NamedTuple):
    """The poses that a table records."""

    idle_angles: np.ndarray
    """Joint angles (radians) of the positioners, shape (2, n); NaN if the pose is not known."""
    handedness: np.ndarray | None
    """Handedness of each arm; None if the table does not contain joint angles."""
    by_angles: np.ndarray
    """Whether the pose of each positioner is known from joint angles; other poses are known from positions."""


def find_recorded(
    find: Finder,
    owner: np.ndarray,
    has_target: np.ndarray,
    instrument: Instrument,
    places: np.ndarray,
    types: np.ndarray,
    tips: np.ndarray,
) -> Recorded:
    """Return the poses that a table records.

    ``owner`` is the index of the positioner of each row (-1: no positioner of the instrument), and ``has_target`` is
    whether each row assigns a target. For each positioner, ``places`` (mm) is the recorded position of the target on
    the focal plane, with which the angles must agree, ``types`` is the fiber type, and ``tips`` (mm) is the position of
    the target that is scored.
    """
    plane = instrument.focal_plane
    angles = _angles(find, owner, has_target, len(plane))
    if angles is not None:
        angles = _consistent(angles, instrument, places, types)
    handedness = None if angles is None else _handedness(angles, plane, tips, types)
    idle = np.full((2, len(plane)), np.nan) if angles is None else angles
    by_angles = np.isfinite(idle).all(axis=0)
    if is_plan(find.table):
        idle = np.where(by_angles, idle, _angles_of_positions(find, owner, has_target, plane))
    return Recorded(np.where(plane.arrays.is_stuck, np.nan, idle), handedness, by_angles)


def sentence_of(posed: Arms, recorded: Recorded, status: np.ndarray) -> str:
    """Return a sentence on the poses of the positioners without a target; empty if all positioners have one."""
    idle = ~posed.assigned
    known = posed.recorded & idle
    assumed = idle & ~known
    counts = {
        "at the recorded joint angles": known & recorded.by_angles,
        "at the recorded positions": known & ~recorded.by_angles,
        "stuck at the angles that the instrument states": assumed & (status == "stuck"),
        "assumed to be parked": assumed & np.isin(status, ("parked", "disabled")),
        "assumed to avoid all other arms": assumed & (status == "idle"),
    }
    parts = [f"{mask.sum()} {text}" for text, mask in counts.items() if mask.any()]
    return f"{number_of(int(idle.sum()), 'positioner')} without a target: {', '.join(parts)}" if parts else ""


def warn_of_neglected(assigned: Table, *, sky: bool) -> None:
    """Warn of information in the assigned rows of a plan that its score neglects.

    ``sky`` is whether sky positions are scored.
    """
    form, names = assigned.meta.get("format"), assigned.colnames
    if sky and form == "confsummary" and {"delta_ra", "delta_dec"} <= {*names}:
        offsets = np.array([to_plain(assigned[name]) for name in ("delta_ra", "delta_dec")])
        n = int((~np.isin(offsets, (0, -999)) & np.isfinite(offsets)).any(axis=0).sum())
        if n:
            warn(f"the offsets delta_ra and delta_dec of {number_of(n, 'target')} are neglected")
    if form == "pfsdesign" and "fiberStatus" in names and (bad := to_plain(assigned["fiberStatus"]) != GOOD).any():
        warn(f"{bad.sum()} fibers with a target have a fiberStatus other than {GOOD} (good), but count as assigned")


def _angles(find, owner, has_target, n) -> np.ndarray | None:
    """Return the recorded joint angles (radians) of each positioner, shape (2, n); None if the table has none."""
    table, names = find.table, ("theta", "phi")
    units = [getattr(table[name], "unit", None) if name in table.colnames else None for name in names]
    if not all(unit is not None and unit.is_equivalent(u.rad) for unit in units):
        return None
    given = np.array([to_plain(table[name]) * unit.to(u.rad) for name, unit in zip(names, units, strict=True)])
    known = (owner >= 0) & np.isfinite(given).all(axis=0)
    if "status" in table.colnames and "in_collision" in table.colnames:  # a tile states which poses were assumed
        known &= has_target | np.isin(to_plain(table["status"]), ("recorded", "disabled"))
    rows = np.flatnonzero(known)
    rows = rows[np.argsort(has_target[rows], kind="stable")]  # of several rows, the last one determines the angles
    found = np.full((2, n), np.nan)
    found[:, owner[rows]] = given[:, rows]
    return found


def _consistent(angles, instrument, places, types) -> np.ndarray | None:
    """Return angles without those that disagree with the positions of the targets; None if most of them disagree."""
    plane = instrument.focal_plane
    own = np.flatnonzero(np.isfinite(angles).all(axis=0) & np.isfinite(places).all(axis=1) & plane.arrays.usable)
    if len(own) == 0:
        return angles
    away = np.hypot(*(plane.forward(*(angles * u.rad), types).to_value(u.mm) - places)[own].T)
    differs = away > TOLERANCE_MM
    if not differs.any():
        return angles
    most = 2 * differs.sum() > len(own)
    text = "the recorded angles are not used" if most else "the positions determine the poses of these arms"
    remedy = "check that the instrument is the one for which the plan was made"
    if instrument.layout == "nominal":
        remedy = "the arms are nominal: score the plan with the instrument as built"
    warn(
        f"the recorded joint angles of {differs.sum()} of {len(own)} positioners with a target place the fiber more "
        f"than {TOLERANCE_MM:g} mm from the target (median {np.nanmedian(away):.3g} mm); {text}; {remedy}"
    )
    return None if most else np.where(np.isin(np.arange(len(places)), own[differs]), np.nan, angles)


def _handedness(angles, plane, tips, types) -> np.ndarray:
    """Return the handedness of each arm: that of the recorded angles or, if there are none, the usual one."""
    columns = plane.arrays.using(plane.arrays.index_of(types))
    bend = np.sin(columns.from_joints(*angles)[1])
    side = np.where(np.isnan(bend), columns.sides(tips), np.where(bend < -1e-9, -1, 1))
    return np.where(side < 0, "left", "right")


def _angles_of_positions(find, owner, has_target, plane) -> np.ndarray:
    """Return the joint angles (radians) that place fibers without a target at their recorded positions."""
    table, found = find.table, np.full((2, len(plane)), np.nan)
    points = np.column_stack([to_plain(table[name].to(u.mm)) for name in ("x", "y")])
    labels = np.asarray(table["fiber_type"]).astype(str)
    known = (owner >= 0) & ~has_target & np.isfinite(points).all(axis=1)
    # the fiber of a folded arm is at the center, where its position does not determine the direction of the arm
    known &= np.hypot(*(points - plane.arrays.xy[owner]).T) > TOLERANCE_MM
    names = plane.fiber_types if plane.arrays.fibers is None else plane.arrays.fibers.names
    for name in names:
        rows = np.flatnonzero(known & (labels == name)) if names != ("",) else np.flatnonzero(known)
        xy = np.full((len(plane), 2), np.nan)
        xy[owner[rows]] = points[rows]
        angles = np.array([angle.to_value(u.rad) for angle in plane.inverse(xy * u.mm, name)])
        found = np.where(np.isfinite(found), found, angles)
    return found


def on_focal_plane(find: Finder, names: list, n: int, who: np.ndarray) -> np.ndarray:
    """Return the recorded positions of the targets in mm, one row for each positioner; NaN if there are none."""
    found = np.full((n, 2), np.nan)
    if None not in names:
        found[who] = np.column_stack([find.quantity(role).to_value(u.mm) for role in ("x", "y")])
    return found


def sky_deg_of(find: Finder) -> np.ndarray:
    """Return the right ascensions and declinations of a table in deg, shape (2, n); NaN if the table has none."""
    if find.name_of("ra") is None or find.name_of("dec") is None:
        return np.full((2, len(find.table)), np.nan)
    return np.array([find.quantity("ra").value, find.quantity("dec").value])
