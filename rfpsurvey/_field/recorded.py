"""The data in the table of a plan: the field, the positions of the targets, and the poses of the arms."""

import warnings

import astropy.units as u
import numpy as np
from astropy.coordinates import FK5, SkyCoord
from astropy.table import Table

from rfpsurvey._common.units import to_center, to_direction, to_plain
from rfpsurvey._field.plan_files import format_of, is_plan
from rfpsurvey._instruments.arms import Arms
from rfpsurvey._instruments.compare_projections import choose_projection
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.columns import Finder
from rfpsurvey._sky.conditions import ObservingConditions
from rfpsurvey._sky.survey_formats import survey_of_north
from rfpsurvey._sky.tables import read_columns
from rfpsurvey._sky.time import choose_epoch, epoch_text, moving, to_time
from rfpsurvey.errors import InputError, RfpsurveyWarning, number_of, warn, warn_no_effect

TOLERANCE_MM = 0.1
"""Largest distance between the position of a fiber and the position computed from its recorded joint angles."""


def find_recorded(
    find: Finder,
    owner: np.ndarray,
    has_target: np.ndarray,
    instrument: Instrument,
    places: np.ndarray,
    types: np.ndarray,
    tips: np.ndarray,
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
    """Return the poses that a table records.

    These are the joint angles (radians) of the positioners, shape (2, n), which are NaN if the pose is not known, the
    handedness of each arm, which is None if the table does not contain joint angles, and whether the pose of each
    positioner is known from joint angles; other poses are known from positions.

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
    return np.where(plane.arrays.is_stuck, np.nan, idle), handedness, by_angles


def sentence_of(posed: Arms, by_angles: np.ndarray, status: np.ndarray) -> str:
    """Return a sentence on the poses of the positioners without a target; empty if all positioners have one."""
    idle = ~posed.assigned
    known = posed.recorded & idle
    assumed = idle & ~known
    counts = {
        "at the recorded joint angles": known & by_angles,
        "at the recorded positions": known & ~by_angles,
        "stuck at the angles that the instrument states": assumed & (status == "stuck"),
        "assumed to be parked": assumed & np.isin(status, ("parked", "disabled")),
        "assumed to avoid all other arms": assumed & (status == "idle"),
    }
    parts = [f"{mask.sum()} {text}" for text, mask in counts.items() if mask.any()]
    return f"{number_of(int(idle.sum()), 'positioner')} without a target: {', '.join(parts)}" if parts else ""


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
    angles = np.full((2, n), np.nan)
    angles[:, owner[rows]] = given[:, rows]
    return angles


def _consistent(angles, instrument, places, types) -> np.ndarray | None:
    """Return angles without those that disagree with the positions of the targets; None if most of them disagree."""
    plane = instrument.focal_plane
    placed = np.flatnonzero(np.isfinite(angles).all(axis=0) & np.isfinite(places).all(axis=1) & plane.arrays.usable)
    if len(placed) == 0:
        return angles
    away = np.hypot(*(plane.forward(*(angles * u.rad), types).to_value(u.mm) - places)[placed].T)
    differs = away > TOLERANCE_MM
    if not differs.any():
        return angles
    most = 2 * differs.sum() > len(placed)
    text = "the recorded angles are not used" if most else "the positions determine the poses of these arms"
    remedy = "check that the instrument is the one for which the plan was made"
    if instrument.layout == "nominal":
        remedy = "the arms are nominal: score the plan with the instrument as built"
    warn(
        f"the recorded joint angles of {differs.sum()} of {len(placed)} positioners with a target place the fiber more "
        f"than {TOLERANCE_MM:g} mm from the target (median {np.nanmedian(away):.3g} mm); {text}; {remedy}"
    )
    return None if most else np.where(np.isin(np.arange(len(places)), placed[differs]), np.nan, angles)


def _handedness(angles, plane, tips, types) -> np.ndarray:
    """Return the handedness of each arm: that of the recorded angles or, if there are none, the usual one."""
    columns = plane.arrays.using(plane.arrays.index_of(types))
    bend = np.sin(columns.from_joints(*angles)[1])
    side = np.where(np.isnan(bend), columns.sides(tips), np.where(bend < -1e-9, -1, 1))
    return np.where(side < 0, "left", "right")


def _angles_of_positions(find, owner, has_target, plane) -> np.ndarray:
    """Return the joint angles (radians) that place fibers without a target at their recorded positions."""
    table, idle_angles = find.table, np.full((2, len(plane)), np.nan)
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
        idle_angles = np.where(np.isfinite(idle_angles), idle_angles, angles)
    return idle_angles


def on_focal_plane(find: Finder, names: list, n: int, who: np.ndarray) -> np.ndarray:
    """Return the recorded positions of the targets in mm, one row for each positioner; NaN if there are none."""
    positions = np.full((n, 2), np.nan)
    if None not in names:
        positions[who] = np.column_stack([find.quantity(role).to_value(u.mm) for role in ("x", "y")])
    return positions


def sky_deg_of(find: Finder) -> np.ndarray:
    """Return the right ascensions and declinations of a table in deg, shape (2, n); NaN if the table has none."""
    if find.name_of("ra") is None or find.name_of("dec") is None:
        return np.full((2, len(find.table)), np.nan)
    return np.array([find.quantity("ra").value, find.quantity("dec").value])


# names under which planners store the center and the orientation of a field, in columns or in the meta of a table
FIELD = {
    "ra": ("racen", "field_racen", "field_ra", "tile_ra", "tilera"),
    "dec": ("deccen", "field_deccen", "field_dec", "tile_dec", "tiledec"),
    "position angle": ("position_angle", "field_pa", "pa", "posang"),
}
# the names of the same values in the provenance of tiles that this package made
OWN = {"ra": "ra_deg", "dec": "dec_deg", "position angle": "position_angle_deg"}


def project_rows(find, instrument, fibers, columns, units, *, center, position_angle, equinox, epoch, conditions):
    """Project the sky positions of assigned rows; the parameters are those of `score_tile`.

    The returned tuple contains the positions on the focal plane and on the sky (NaN for rows without coordinates), the
    projection, a sentence on the epoch, and the parameters to record.
    """
    part = find.table
    form = format_of(part)
    survey = survey_of_north(find.format.name) if find.format else form.NORTH_OF_DATE
    north = center is not None or position_angle is not None or equinox is not None or "north_of" in part.meta
    warn_of_north(survey, is_given=north)
    recorded, model = recorded_projection(part), None
    if conditions is None:
        model = recorded.get("projection")
        if recorded.get("conditions") is not None:
            conditions = ObservingConditions.from_record(recorded["conditions"])
    catalog, there = _catalog(part, columns, units)
    of_catalog = form.EPOCH_OF_OBSERVATION and find.name_of("ra") == "ra"
    if epoch is None and of_catalog and catalog.epoch is not None and moving(catalog.coord).any():
        epoch = part.meta.get("epoch")
    used, moved = choose_epoch(catalog, epoch, None)
    catalog = catalog if used is None else catalog.at_epoch(used)
    if center is None:
        is_recorded = equinox is None and position_angle is None
        center = north_of_date(field_center(part), recorded_equinox(part) if is_recorded else equinox)
    center = to_center(center)
    if position_angle is None:
        position_angle = field_value(part, "position angle") * u.deg
    plain, chosen = choose_projection(instrument, instrument.projection(center, position_angle), conditions, model)
    icrs, xy, sky_deg = catalog.coord.icrs, np.full((len(part), 2), np.nan), np.full((2, len(part)), np.nan)
    xy[there] = plain.project(catalog.arrays.vectors, fibers[there])
    sky_deg[:, there] = icrs.ra.deg, icrs.dec.deg
    parameters = {**where(center, position_angle), "epoch": epoch_text(catalog.epoch)}
    if conditions is not None:
        parameters["conditions"] = conditions.record
    if conditions is not None or chosen["model"] != "radial":
        parameters["projection"] = chosen["model"]
    return xy, sky_deg, plain, moved, parameters


def read_positions(find: Finder, xy_names: list, who: np.ndarray, n: int, given: dict) -> tuple:
    """Return the same as `project_rows`, with the positions on the focal plane that the table contains.

    ``given`` contains parameters of `project_rows`, which must be None, because they have no effect.
    """
    if None in xy_names:
        raise find.missing("x and y")
    for unused in (name for name, value in given.items() if value is not None):
        remedy = "to use positions on the sky, give positions='sky' (or --positions sky)"
        warn_no_effect(unused, f"because the table has positions on the focal plane; {remedy}")
    return on_focal_plane(find, xy_names, n, who)[who], sky_deg_of(find), None, None, {}


def _catalog(part: Table, columns: dict, units: dict | None) -> tuple[Catalog, np.ndarray]:
    """Return the assigned rows with finite coordinates as a catalog, and the numbers of these rows."""
    # added sky positions have no priority, which a score does not use
    values = read_columns(part, columns, units, "icrs", {"priority": 0.0}, None, assume_units=False)
    place = to_direction(values["coord"]).data
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*have no finite coordinates", RfpsurveyWarning)  # `_placed` names the rows
        catalog = Catalog(**values)
    return catalog, np.flatnonzero(np.isfinite(place.lon.value) & np.isfinite(place.lat.value))


def north_of_date(center: SkyCoord, equinox: str | None) -> SkyCoord:
    """Return a field center in the frame of an equinox; the north of this frame defines position angles.

    If ``equinox`` is None, the center is returned unchanged.
    """
    return center if equinox is None else center.transform_to(FK5(equinox=to_time(equinox, "equinox", scalar=True)))


def warn_of_north(survey: str, *, is_given: bool) -> None:
    """Warn that a survey measures position angles from the north of date, if its files do not state the north."""
    if survey and not is_given:
        warn(
            "the position angle is measured from the north of ICRS, because the file does not state the north; "
            f"{survey} uses the north of date: give equinox= (or --set equinox=J2026), or a center in FK5 of this "
            "equinox"
        )


def field_center(table) -> SkyCoord:
    """Return the field center that the columns or the meta of a table contain."""
    return SkyCoord(field_value(table, "ra") * u.deg, field_value(table, "dec") * u.deg)


def _degrees(value, name: str) -> np.ndarray:
    """Return angles in degrees; numbers without a unit are in degrees."""
    try:
        angles = u.Quantity(to_plain(value).astype(float), getattr(value, "unit", None) or u.deg).to_value(u.deg)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} of the field must be an angle, got {value!r}: {error}") from None
    if not np.isfinite(angles).all() or (np.abs(angles) > 90 if "dec" in name else np.abs(angles) > 360).any():
        raise InputError(
            f"{name} of the field must be an angle from -360 to 360 deg (declinations: from -90 to 90 deg), got {value}"
        )
    return angles


def field_value(table, what: str) -> float:
    """Return a value that describes the field, such as a position angle, from a column or the meta of a table."""
    lower = {c.lower(): c for c in table.colnames}
    meta = {str(k).lower(): v for k, v in table.meta.items()}
    for name in FIELD[what]:
        if name in lower:
            values = np.unique(_degrees(table[lower[name]], lower[name]))
            if len(values) > 1:
                raise InputError(
                    f"column {lower[name]!r} has {len(values)} values, so the table holds several fields: score one "
                    f"field at a time, for example with --select COLUMN=VALUE"
                )
            return float(values[0])
        if name in meta:
            return float(_degrees(meta[name], name))
    recorded = recorded_projection(table)
    if OWN[what] in recorded:
        return float(recorded[OWN[what]])
    option = "--position-angle" if what == "position angle" else "--center"
    raise InputError(
        f"the {what} of the field must be given ({option}), or be in a column or meta entry "
        f"{' or '.join(FIELD[what][:2])}"
    )


def recorded_projection(table) -> dict:
    """Return the meta of a table or, for a tile of this package, its parameters.

    The entries ``north_of``, ``projection`` and ``conditions`` describe how sky positions were projected.
    """
    provenance = table.meta.get("provenance")
    return provenance.get("parameters", {}) if isinstance(provenance, dict) else table.meta


def recorded_equinox(table) -> str | None:
    """Return the equinox whose north defines the position angle in a table; None stands for the north of ICRS."""
    north = recorded_projection(table).get("north_of", "icrs")
    if north == "icrs":
        return None
    frame, _, equinox = str(north).partition(" ")
    if frame != "fk5" or not equinox:
        raise InputError(
            f"the position angle in the table must be measured from the north of icrs or fk5, got {north}; give center "
            "(in the frame whose north you use) and position_angle"
        )
    return equinox


def where(center: SkyCoord, position_angle: u.Quantity) -> dict:
    """Return the center and the orientation of a field in the form in which the provenance stores them."""
    icrs = center.icrs
    return {
        "ra_deg": float(icrs.ra.deg),
        "dec_deg": float(icrs.dec.deg),
        "position_angle_deg": float(u.Quantity(position_angle).to_value(u.deg)),
        "north_of": center.frame.name + (f" J{center.equinox.jyear:.3f}" if center.frame.name == "fk5" else ""),
    }
