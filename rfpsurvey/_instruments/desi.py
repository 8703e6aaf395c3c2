"""DESI as built: positions from the metrology of desimeter, or the focal plane of desimodel with its state.

The files of desimeter and desimodel use the coordinate system CS5, in which +x is west and +y is north at a field
rotation of 0. In rfpsurvey, +x is east. The conversion reverses the sign of x; this reflection also reverses the
handedness and the signs of the joint angles.
"""

from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np
import scipy  # its subpackages are imported on first use

from rfpsurvey._common.files import to_path
from rfpsurvey._common.read_documents import entries_of, head_of
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._common.units import check_unique, to_plain
from rfpsurvey._instruments.as_built import MOST_ANGLE, entry, impossible_entry, number_rows, numbers, some, whole
from rfpsurvey._instruments.desi_state import find_conditions, find_events, find_latest, moment_of, read_polygons
from rfpsurvey._instruments.entries import value_of
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.layouts import FULL_OUTLINE, OUTLINE, SEGMENT_CLEARANCE
from rfpsurvey._instruments.state_tables import ALWAYS, Row
from rfpsurvey._instruments.states import moments_at, with_rows
from rfpsurvey.errors import InputError, listed, warn

N_POSITIONERS = 5000
# Limits of possible values, in mm and deg.
LARGEST, SMALLEST, CLOSEST = 420.0, 10.0, 5.0  # distances from the center, and between two positioners
LONGEST, SHORTEST = 6.0, 1.0  # arm lengths
METROLOGY = ("LOCATION", "PETAL_LOC", "DEVICE_LOC", "DEVICE_TYPE", "X_FP", "Y_FP")
LENGTHS = ("OFFSET_X", "OFFSET_Y", "LENGTH_R1", "LENGTH_R2")
ANGLES = ("OFFSET_T", "OFFSET_P", "MIN_T", "MAX_T", "MIN_P", "MAX_P")
MODEL = ("LOCATION", "PETAL", "DEVICE", "DEVICE_TYPE", *LENGTHS, *ANGLES)
LEFT_OUT = (
    "x is the negative x of CS5, because +x is east in rfpsurvey and west in CS5. Guide cameras, fiducials and petal "
    "edges are not treated as obstacles. The arms move in the plane of the centers, not in planes tangent to the focal "
    "surface. The radial map is the map of the preset desi."
)


def recognizes(path: Path) -> bool:
    """Return whether a path is a file with DESI's metrology or focal plane, or a folder with such a file."""
    if path.is_dir():
        return any(file.name.startswith(("desi-focalplane_", "fp-metrology.csv")) for file in entries_of(path))
    head = head_of(path, 2**14).decode("utf-8", "replace")
    return any(all(name in head for name in names) for names in (METROLOGY, MODEL))


def read(preset, path, *, state=None, exclusions=None, time=None):
    """Return the preset of DESI with the positioners of a file; see `Instrument.from_desi`."""
    moments = [] if time is None else [moment_of(time, "time")] if np.ndim(time) == 0 else moments_at(time)
    path, moment = to_path(path), moments[0] if moments else None
    files = entries_of(path) if path.is_dir() else []
    metrologies = [file for file in files if file.name.startswith("fp-metrology.csv")]
    if metrologies and not any(file.name.startswith("desi-focalplane_") for file in files):
        path = metrologies[0]
    if path.is_dir():
        latest = [find_latest(path, at)[0] for at in moments[1:][-1:]]
        folder, (path, beside) = path, find_latest(path, moment)
        if latest not in ([], [path]):
            raise InputError(
                f"{folder}: the focal plane must be the same at all times, got {path.name} and {latest[0].name}; plan "
                "the tiles before and after the change separately, or choose one time with time= or --set "
                "instrument.state_time=DATE"
            )
        state, exclusions = state or beside.get("state"), exclusions or beside.get("exclusion")
    table = read_table(path)
    metrology = "X_FP" in table.colnames
    for name, value in {"state": state, "exclusions": exclusions}.items():
        if metrology and value is not None:
            raise InputError(f"{name} must be None for a metrology file, got {value}")
    if time is not None and state is None:
        raise InputError(f"time must be None without a state, got {time}")
    if metrology:
        return _from_metrology(preset, table, path)
    return _from_model(preset, table, path, state and to_path(state), exclusions and to_path(exclusions), moments)


def _from_metrology(preset, table, path):
    table, unused = _positioners(table, METROLOGY, path)
    plane = _plane(
        path,
        xy=_centers(table, "X_FP", "Y_FP", path),
        positioner=_mirrored(preset.focal_plane.positioner),
        id=whole(table, "LOCATION", path),
        spectrograph=whole(table, "PETAL_LOC", path),
    )
    entries = {
        "layout.centers": _entry(len(plane), path, "X_FP and Y_FP of rows of the type POS"),
        "layout.spectrographs": _entry(len(np.unique(plane.spectrograph)), path, "PETAL_LOC"),
        "positioner.phi_range": {**preset.values["positioner.phi_range"], "value": _limits(plane.positioner.phi_range)},
    }
    notes = f"The centers of the {len(plane)} positioners are taken from {path.name}; the arms are nominal.{unused}"
    return _built(preset, plane, entries, notes)


def _from_model(preset, table, path, state, exclusions, moments):
    table, unused = _positioners(table, MODEL, path)
    ids = whole(table, "LOCATION", path)
    r1, r2 = (numbers(table, name, u.mm, path, LONGEST, low=SHORTEST) for name in ("LENGTH_R1", "LENGTH_R2"))
    angles = {name: numbers(table, name, u.deg, path, MOST_ANGLE, codes=name[:3] == "OFF") for name in ANGLES}
    notes, columns, polygons = [f"The {len(ids)} positioners are taken from {path.name}.{unused}"], {}, None
    impossible, of_file, moment = {}, dict(angles), moments[0] if moments else None
    if state is None:
        notes.append("No state was given; therefore, all positioners count as working.")
    else:
        columns, limits, polygons, text, n = find_conditions(state, ids, moment)
        impossible = impossible_entry(n, state.name)
        angles |= {name: np.where(np.isfinite(value), value, angles[name]) for name, value in limits.items()}
        notes.append(text)
    for axis in "TP":
        wrong = ~(angles[f"MIN_{axis}"] < angles[f"MAX_{axis}"])
        if wrong.any():
            raise InputError(
                f"{state or path}: MIN_{axis} must be less than MAX_{axis}, but is not for {some(ids, wrong)}"
            )
    positioner, entries, dropped = replace(_mirrored(preset.focal_plane.positioner), home=None), {}, ["positioner.home"]
    if exclusions is not None:
        width, outline, text = read_polygons(exclusions, polygons, len(ids))
        notes.append(text)
        entry = _entry(width, exclusions, "median half width of the phi polygons of all positioners", "mm", "derived")
        if outline is None:
            preset = preset.with_arm_model("elbow_to_tip")
            positioner = replace(positioner, arm_model="elbow_to_tip", outline=None, clearance=width * u.mm)
            entries["positioner.clearance"] = entry
            dropped.append(FULL_OUTLINE)
        else:
            positioner = replace(positioner, outline=outline.mirrored())
            source = "the most common polygons, divided into convex parts"
            entries |= {SEGMENT_CLEARANCE: entry, OUTLINE: _entry(outline.to_dict(), exclusions, source, "mm")}
    plane = _plane(
        path,
        xy=_centers(table, "OFFSET_X", "OFFSET_Y", path),
        positioner=positioner,
        id=ids,
        spectrograph=whole(table, "PETAL", path),
        central_arm=r1 * u.mm,
        eccentric_arm=r2 * u.mm,
        zero_points=np.column_stack([180 - angles["OFFSET_T"], -angles["OFFSET_P"]]) * u.deg,
        theta_range=-np.column_stack([angles["MAX_T"], angles["MIN_T"]]) * u.deg,
        phi_range=-np.column_stack([angles["MAX_P"], angles["MIN_P"]]) * u.deg,
        **columns,
    )
    entries |= impossible | {
        "layout.centers": _entry(len(ids), path, "OFFSET_X and OFFSET_Y of rows of the type POS"),
        "layout.spectrographs": _entry(len(np.unique(plane.spectrograph)), path, "PETAL"),
        "positioner.central_arm": _entry(float(np.median(r1)), path, "median of LENGTH_R1", "mm"),
        "positioner.eccentric_arm": _entry(float(np.median(r2)), path, "median of LENGTH_R2", "mm"),
        "positioner.theta_range": _entry(_limits(plane.theta_range), state or path, "medians of MIN_T, MAX_T", "deg"),
        "positioner.phi_range": _entry(_limits(plane.phi_range), state or path, "medians of MIN_P, MAX_P", "deg"),
    }
    built = _built(preset, plane, entries, " ".join(notes), dropped=dropped)
    return built if len(moments) < 2 or state is None else _with_log(built, state, of_file, moments)


def _with_log(built, path, angles, moments):
    """Return the instrument with the events of a log between several moments, before which its state is known."""
    rows, *columns, limits = find_events(path, built.focal_plane.id, moments[0], moments[-1])
    of_event = {name: values[list(rows)] for name, values in angles.items()}
    of_event |= {k: np.where(np.isfinite(limits[k]), limits[k], of_event[k]) for k in of_event if k in limits}
    ranges = np.column_stack([-of_event[name] for name in ("MAX_T", "MIN_T", "MAX_P", "MIN_P")])
    names, states = built.focal_plane.id[list(rows)].astype(str).tolist(), []
    for name, begin, end, is_broken, pose, joints in zip(names, *columns, ranges.tolist(), strict=True):
        if joints[0] >= joints[1] or joints[2] >= joints[3]:
            raise InputError(f"{path}: MIN_T and MIN_P must be less than MAX_T and MAX_P, but are not for {name}")
        angles_of_arm = tuple(pose.tolist()) if np.isfinite(pose).all() else None
        word = "broken" if is_broken else "restored" if angles_of_arm is None else "stuck"
        states.append(Row(name, word, begin, end or ALWAYS[1], angles_of_arm, tuple(joints)))
    return with_rows(built, states, path.name) if states else built


def _plane(path, **columns) -> FocalPlane:
    try:
        return FocalPlane(**columns)
    except InputError as error:
        raise type(error)(f"{path}: {error}") from None


def _built(preset, plane, entries, notes, dropped=()):
    """Return the preset with a new focal plane; ``entries`` replace the values that describe the layout."""
    gone = {*dropped, *(name for name in preset.values if name.startswith("layout."))}
    values = {name: entry for name, entry in preset.values.items() if name not in gone} | entries
    values["positioner.handedness"] = {**values["positioner.handedness"], "value": "left"}
    for name in ("positioner.handedness", "positioner.theta_range", "positioner.phi_range"):
        values[name] = {**values[name], "status": "derived", "source": f"{values[name]['source']}; mirror image of CS5"}
    if OUTLINE in values:
        mirror, source = value_of(values[OUTLINE]).mirrored().to_dict(), values[OUTLINE]["source"]
        values[OUTLINE] = entry(mirror, f"{source}; mirror image of CS5", "derived", "mm")
    return replace(preset, focal_plane=plane, layout="as built", values=values, notes=f"{notes} {LEFT_OUT}")


def _entry(value, path, source, unit=None, status="published"):
    return entry(value, f"{path.name}: {source}", status, unit)


def _mirrored(positioner):
    """Return the mirror image of a positioner that is described in CS5."""
    ranges = {name: -getattr(positioner, name)[::-1] for name in ("theta_range", "phi_range")}
    return replace(positioner, handedness="left", outline=positioner.outline.mirrored(), **ranges)


def _limits(limits) -> list[float]:
    """Return joint limits in degrees; if each positioner has its own limits, return the median limits."""
    return np.median(np.atleast_2d(limits.to_value(u.deg)), axis=0).tolist()


def _centers(table, x, y, path):
    """Return the positions of the positioners, or raise an error if they are impossible."""
    xy = np.column_stack(
        [sign * numbers(table, name, u.mm, path, LARGEST, codes=True) for sign, name in ((-1, x), (1, y))]
    )
    ids = whole(table, "LOCATION", path)
    apart = scipy.spatial.cKDTree(xy).query(xy, k=2)[0][:, 1]
    for wrong, rule in (
        (np.hypot(*xy.T) < SMALLEST, f"at least {SMALLEST:g} mm from the center"),
        (apart < CLOSEST, f"at least {CLOSEST:g} mm from each other"),
    ):
        if wrong.any():
            raise InputError(f"{path}: the positions {x}, {y} must be {rule}, but are not for {some(ids, wrong)}")
    return xy * u.mm


def _positioners(table, names, path):
    """Return the rows of a table that are positioners, and a sentence about the other rows."""
    number_rows(table, names, path)
    kinds = np.char.strip(to_plain(table["DEVICE_TYPE"], f"{path}: column 'DEVICE_TYPE'").astype(str))
    rows = kinds == "POS"
    if not rows.any():
        raise InputError(
            f"{path}: DEVICE_TYPE must be POS for positioners, got {listed(map(repr, np.unique(kinds).tolist()))}"
        )
    if rows.sum() != N_POSITIONERS:
        warn(f"{path}: DESI has {N_POSITIONERS} positioners, but the file has {rows.sum()} and may be incomplete")
    types, counts = np.unique(kinds[~rows], return_counts=True)
    counts = ", ".join(f"{n} {kind or 'without type'}" for kind, n in zip(types, counts, strict=True))
    unused = f" Rows of other devices are not used: {counts}." if counts else ""
    table = table[rows]
    ids, petal, device = (whole(table, name, path) for name in names[:3])
    for k in np.flatnonzero(ids != 1000 * petal + device):
        raise InputError(
            f"{path}: LOCATION must be 1000 {names[1]} + {names[2]}, got {ids[k]} for {names[1]} {petal[k]} and "
            f"{names[2]} {device[k]}"
        )
    check_unique(ids, f"{path}: LOCATION")
    return table, unused
