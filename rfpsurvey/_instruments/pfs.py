"""PFS as built, from files of the observatory: dots, fiducials, interference limits and calibration of the cobras.

Cobras, the positioners of PFS, have the identifiers of the observatory, 1 to 2394.
"""

from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

import astropy.units as u
import numpy as np

from rfpsurvey._common.files import suffix_of, to_path
from rfpsurvey._common.read_documents import entries_of, head_of, is_present
from rfpsurvey._instruments import pfs_files as _files
from rfpsurvey._instruments.as_built import entry, impossible_entry
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey.errors import InputError

PATTERNS = {
    "dots": "black_dots_mm*.csv*",
    "fiducials": "fiducial_positions*.csv*",
    "interference": "cobraInterference_*.csv*",
}
MAP = "https://github.com/Subaru-PFS/pfs_utils data/fiberids"
ANGLES = "https://github.com/Subaru-PFS/ics_cobraCharmer python/ics/cobraCharmer/targetValidation.py"
# Median width (deg) of the range of phi in the calibration files. A range of this width that ends with the extended arm
# (phi = 0) starts at the folded stop, phi = -185.9 deg.
FOLDED = 185.9


def find_pfs_files(path: Path) -> dict | None:
    """Return the files of PFS in a folder, or a file of dots, as arguments of `read_pfs`; None for any other path.

    The files can also be in the subfolders ``dot`` and ``fiducials`` of the folder, as in the observatory's repository.
    If there are several files of one kind, the last file in alphabetical order is used, because its name contains the
    latest date.
    """
    if path.is_file():
        head = head_of(path, 64) if suffix_of(path) == ".csv" else b""
        return {"dots": path} if head.lstrip(b"\xef\xbb\xbf").startswith(b"spotId,x,y,r") else None
    top_level = entries_of(path) if path.is_dir() else []
    folders = [folder for folder in (path / "dot", path / "fiducials") if is_present(folder)]
    if not any(fnmatchcase(file.name, PATTERNS["dots"]) for file in top_level) and not any(map(Path.is_dir, folders)):
        return None
    entries = top_level + [file for folder in folders for file in entries_of(folder)]
    by_kind = {name: [file for file in entries if fnmatchcase(file.name, PATTERNS[name])] for name in PATTERNS}
    if not by_kind["dots"]:
        return None
    files = {name: paths[-1] for name, paths in by_kind.items() if paths}
    models = [file for file in top_level if file.suffix == ".xml"]
    return {**files, "cobras": models} if models else files


def read_pfs(nominal, dots, fiducials=None, interference=None, cobras=None):
    """Return PFS as built, from the nominal instrument and the paths of the files."""
    dots = to_path(dots)
    if dots.is_dir():
        files = find_pfs_files(dots)
        if files is None:
            raise InputError(f"{dots}: the folder must have a file black_dots_mm*.csv, got none")
        given = {"fiducials": fiducials, "interference": interference, "cobras": cobras}
        return read_pfs(nominal, **files | {name: path for name, path in given.items() if path is not None})
    circles = _files.read_dots(dots)
    offset = (circles[:, :2] - _files.nominal_centers()).mean(axis=0)
    arms = None if cobras is None else _files.read_cobras(cobras)
    xy = circles[:, :2] - offset if arms is None else np.column_stack([arms["x"], arms["y"]])
    positioner = replace(nominal.focal_plane.positioner, handedness="left")
    values = {name: v for name, v in nominal.values.items() if not name.startswith("layout.")}
    values["positioner.handedness"] = entry("left", ANGLES)
    values["layout.ids"] = entry("cobraId", MAP)
    values["layout.spectrographs"] = entry("spectrograph of the fiber of each cobra", MAP)
    values["layout.dots"] = entry(_files.N, dots.name)
    note = (
        f"{dots.name}: {len(circles)} dots of radius {circles[:, 2].min():.3f} to {circles[:, 2].max():.3f} mm hide "
        f"fibers; targets behind a dot are out of reach of all cobras. The mean offset of a dot from the nominal "
        f"center of its cobra is ({offset[0]:.3f}, {offset[1]:.3f}) mm."
    )
    notes, columns = [note], {}
    if arms is None:
        values["layout.centers"] = entry("positions of the dots minus their mean offset", dots.name, "derived")
        values["layout.dot_offset"] = entry([round(float(v), 6) for v in offset], dots.name, "derived", "mm")
    else:
        names = ", ".join(path.name for path in _files.to_paths(cobras))
        columns, defects = _arm_columns(arms, positioner)
        values |= impossible_entry(int(arms["unknown"].sum()), names)
        values.pop("positioner.theta_range", None)
        for name in ("centers", "arms", "zero_points", "joint_limits"):
            values[f"layout.{name}"] = entry("values for each cobra", names)
        notes.append(f"Centers, arms and joint limits are taken from {names}. {defects}")
    if fiducials is not None:
        path = to_path(fiducials)
        columns["obstacles"], text = _files.read_fiducials(path)
        values["layout.fiducials"] = entry(len(columns["obstacles"]), path.name)
        notes.append(text)
    if interference is not None:
        path = to_path(interference)
        limits = _files.read_interference(path)
        text = _restrict(columns, limits, arms)
        values["layout.interference"] = entry(int(np.isfinite(limits[:, 0]).sum()), path.name)
        notes.append(f"{path.name}: {text}")
    plane = FocalPlane(
        xy * u.mm,
        positioner,
        id=np.arange(1, _files.N + 1),
        spectrograph=_files.pfs_fibers()[1],
        hidden=circles * u.mm,
        **columns,
    )
    return replace(
        nominal, focal_plane=plane, plate_scale=None, layout="as built", values=values, notes="\n".join(notes)
    )


def _arm_columns(arms: dict, positioner) -> tuple[dict, str]:
    """Return the columns of the focal plane from a calibration model, and a note on the cobras with defects.

    theta is measured from the counter-clockwise hard stop, and phi from the extended arm.
    """
    bad, unknown = arms["status"] != _files.GOOD, arms["unknown"]
    nominal = {"theta_low": 0.0, "theta_high": 0.0, "phi_low": 0.0, "phi_high": 180.0}
    lengths = {name: getattr(positioner, name) for name in ("central_arm", "eccentric_arm")}
    nominal |= {name: length.to_value(u.mm) for name, length in lengths.items()}
    arms |= {name: np.where(unknown, value, arms[name]) for name, value in nominal.items()}
    lengths = {name: arms[name] * u.mm for name in lengths}
    span = (arms["theta_high"] - arms["theta_low"] + 180) % 360 + 180
    columns = {
        **lengths,
        "zero_points": np.column_stack([arms["theta_low"], np.zeros(_files.N)]) * u.deg,
        "theta_range": np.column_stack([np.zeros(_files.N), span]) * u.deg,
        "phi_range": np.column_stack([arms["phi_low"], arms["phi_high"]]) * u.deg - 180 * u.deg,
        "disabled": bad | unknown,
    }
    low, high = columns["phi_range"].T
    for row in np.flatnonzero(~(low < high)):
        raise InputError(
            f"Joint2_CCW_limit_angle must be below Joint2_CW_limit_angle, got the opposite for cobra {row + 1}"
        )
    text = (
        f"{bad.sum()} cobras whose Status is not {_files.GOOD} take no target and are parked, because the file does "
        "not contain the poses of cobras that cannot move"
    )
    impossible = (np.flatnonzero(unknown) + 1).tolist()
    return columns, text + (
        f"; cobras with impossible arm lengths (outside 1 to 5 mm), joint limits or centers have nominal values and "
        f"are also parked: {', '.join(map(str, impossible))}."
        if impossible
        else "."
    )


def _restrict(columns: dict, limits: np.ndarray, arms: dict | None) -> str:
    """Restrict a joint of each cobra with an interference limit, so that the cobra avoids fiducials; return a note.

    A cobra interferes with a fiducial if its phi, measured from the folded stop, exceeds a limit while the
    direction of the central arm or of the fiber is in a window. To avoid interference, either phi is restricted to
    values below the limit, or theta is restricted to values for which neither direction can be in the window. The
    restriction that leaves the larger patrol area is used.
    """
    rows = np.flatnonzero(np.isfinite(limits[:, 0]))
    begin, end, most = limits[rows].T
    folded = np.full(len(rows), -FOLDED) if arms is None else arms["phi_low"][rows] - 180
    zero = np.zeros(len(rows)) if arms is None else arms["theta_low"][rows]
    span = np.full(len(rows), 360.0) if arms is None else columns["theta_range"][rows, 1].to_value(u.deg)
    extended = folded + most  # the limit of phi, measured from the extended arm
    lengths = (1.0, 1.0) if arms is None else (columns[f"{name}_arm"][rows].value for name in ("central", "eccentric"))
    width = (end - begin) % 360 + _largest_lag(extended, *lengths)
    # with arms of equal length, the limit of phi leaves the fraction cos^2(phi / 2) of the patrol area
    by_theta = (1 - width / 360 >= np.cos(np.deg2rad(extended) / 2) ** 2) & (span >= 360) & (width < 360)
    theta, phi = (
        columns.get(name, np.full((_files.N, 2), np.nan) * u.deg).to_value(u.deg).copy()
        for name in ("theta_range", "phi_range")
    )
    first = (begin + width - zero) % 360
    theta[rows[by_theta]] = np.column_stack([first, first + 360 - width])[by_theta]
    low = np.maximum(folded, -180) if arms is None else folded
    phi[rows[~by_theta]] = np.column_stack([low, extended])[~by_theta]
    columns["theta_range"], columns["phi_range"] = theta * u.deg, phi * u.deg
    return (
        f"{len(rows)} cobras have limits because of a fiducial. Each limit is a condition on both joint angles. "
        f"As an approximation, the range of theta is restricted for {by_theta.sum()} cobras and the range of phi for "
        f"{(~by_theta).sum()} cobras. These ranges exclude more poses than the original limits."
    )


def _largest_lag(extended: np.ndarray, l1, l2) -> np.ndarray:
    """Return, for each cobra, the largest angle (deg, counter-clockwise) from its fiber to its central arm.

    Angles are measured at the center of the cobra, for all phi from ``extended`` to 0.
    """
    phi = np.deg2rad(np.linspace(np.minimum(extended, 0), 0, 200))
    return np.rad2deg(np.arctan2(-l2 * np.sin(phi), l1 + l2 * np.cos(phi))).max(axis=0)
