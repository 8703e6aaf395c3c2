"""PFS as built, from files of the observatory: dots, fiducials, interference limits and calibration of the cobras.

Cobra identifiers are those of the observatory, 1 to 2394: three fields of 14 modules of 57 cobras.
"""

from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np
from scipy.spatial import cKDTree

from rfpsurvey._readers import content_of, read_table, sentence, to_path
from rfpsurvey.errors import InputError
from rfpsurvey.focal_plane import FocalPlane

__all__ = ["cobra_ids", "find_pfs_files", "nominal_centers", "pfs_engineering_fibers", "pfs_fibers", "read_pfs"]

N_FIELDS, N_MODULES, N_COBRAS = 3, 14, 57  # fields, modules of a field, cobras of a module
N = N_FIELDS * N_MODULES * N_COBRAS
PITCH = 8.0
N_FIDUCIALS = 96
# Boards of cobras in the order of their fibers along the slit of each spectrograph: module of a field and half of it.
# Each entry stands for three boards, one of each field.
BOARDS = ("4A 12A 4B 14B 12B 8B 8A", "3A 11A 3B 13B 11B 7B 7A", "2A 10A 2B 14A 10B 6B 6A", "1A 9A 1B 13A 9B 5B 5A")
FIRST_HALF = 29  # number of cobras on board A of a module; the other cobras are on board B
HOLES = 651
# Holes of a slit that contain no fiber of a cobra: engineering fibers and empty holes.
ENGINEERING = (1, 45, 92, 137, 184, 229, 273, 316, 336, 382, 426, 471, 515, 560, 607, 651)
EMPTY = (44, 91, 93, 136, 183, 185, 228, 272, *range(317, 336), 383, 427, 470, 472, 516, 559, 561, 608)
EMPTY_IN_FIRST_TWO = (280, 309, 359)

MAP = "https://github.com/Subaru-PFS/pfs_utils data/fiberids"
ANGLES = "https://github.com/Subaru-PFS/ics_cobraCharmer python/ics/cobraCharmer/targetValidation.py"
# Largest distance (mm) of a dot from the nominal center of its cobra; a neighbor is at 8 mm.
FARTHEST_DOT = 4.0
FARTHEST_CENTER = 3.0
# The range of phi is 185.9 deg in the median of the calibration files, and the excess over 180 deg can be folded.
FOLDED = 185.9
GOOD = 1  # status of a cobra without a defect
KINEMATICS = {
    "x": "Global_base_pos_x",
    "y": "Global_base_pos_y",
    "theta_low": "CCW_Global_base_ori_z",
    "theta_high": "CW_Global_base_ori_z",
    "phi_low": "Joint2_CCW_limit_angle",
    "phi_high": "Joint2_CW_limit_angle",
    "central_arm": "Link1_Link_Length",
    "eccentric_arm": "Link2_Link_Length",
}
HEADER = {"module": "Module_Id", "cobra": "Positioner_Id", "status": "Status"}


def nominal_centers() -> np.ndarray:
    """Return the nominal centers of cobras 1 to 2394 on the PFI (mm), shape (2394, 2)."""
    cobra, module = np.arange(N_COBRAS), np.arange(N_MODULES)
    step = PITCH * np.exp(1j * np.deg2rad(150))
    row = -PITCH * np.sin(np.pi / 3) * (1 + cobra % 2) + 1j * PITCH / 2 * (1 - cobra)
    field = (row + 2 * module[:, None] * step).ravel()
    centers = np.concatenate([field * np.exp(-2j * np.pi / 3 * k) for k in range(N_FIELDS)])
    return np.column_stack([centers.real, centers.imag])


def cobra_ids(xy: np.ndarray) -> np.ndarray:
    """Return the cobras whose nominal centers are given (mm)."""
    apart, row = cKDTree(nominal_centers()).query(xy)
    if len(xy) != N or apart.max() > 1e-6 or len(np.unique(row)) < N:
        raise InputError(f"names = 'cobra' needs the {N} nominal centers of PFS, got other positions")
    return row + 1


def pfs_fibers() -> tuple[np.ndarray, np.ndarray]:
    """Return the fiberId and the spectrograph (0 to 3) of cobras 1 to 2394."""
    fiber, spectrograph = np.empty(N, dtype=np.int64), np.empty(N, dtype=np.int64)
    for k, boards in enumerate(BOARDS):
        taken = {*ENGINEERING, *EMPTY, *(EMPTY_IN_FIRST_TWO if k < 2 else ())}
        holes = [hole for hole in range(1, HOLES + 1) if hole not in taken]
        rows = [
            field * N_MODULES * N_COBRAS + (int(board[:-1]) - 1) * N_COBRAS + cobra
            for board in boards.split()
            for field in range(N_FIELDS)
            for cobra in (range(FIRST_HALF) if board[-1] == "A" else range(FIRST_HALF, N_COBRAS))
        ]
        fiber[rows], spectrograph[rows] = HOLES * k + np.array(holes), k
    return fiber, spectrograph


def pfs_engineering_fibers() -> np.ndarray:
    """Return the fiberId of the engineering fibers, which belong to no cobra."""
    return np.concatenate([HOLES * k + np.array(ENGINEERING) for k in range(len(BOARDS))])


def find_pfs_files(folder: Path) -> dict | None:
    """Return the files of PFS in a folder, as arguments of `read_pfs`; None if no file contains dots.

    If there are several files of one kind, the last file in the order of names is used, because names contain dates.
    """
    patterns = {
        "dots": "black_dots*.csv*",
        "fiducials": "fiducial_positions*.csv*",
        "interference": "cobraInterference_*.csv*",
    }
    found = {name: sorted(folder.glob(pattern)) for name, pattern in patterns.items()}
    if not found["dots"]:
        return None
    files = {name: paths[-1] for name, paths in found.items() if paths}
    models = sorted(folder.glob("*.xml"))
    return {**files, "cobras": models} if models else files


def read_pfs(nominal, dots, fiducials=None, interference=None, cobras=None):
    """Return PFS as built, from the nominal instrument and the paths of the files."""
    dots = to_path(dots)
    if dots.is_dir():
        files = find_pfs_files(dots)
        if files is None:
            raise InputError(f"{dots}: the folder must have a file black_dots*.csv, got none")
        return read_pfs(nominal, **{**files, **_given(fiducials=fiducials, interference=interference, cobras=cobras)})
    circles = read_dots(dots)
    offset = (circles[:, :2] - nominal_centers()).mean(axis=0)
    arms = None if cobras is None else read_cobras(cobras)
    xy = circles[:, :2] - offset if arms is None else np.column_stack([arms["x"], arms["y"]])
    positioner = replace(nominal.focal_plane.positioner, handedness="left")
    values = {name: v for name, v in nominal.values.items() if not name.startswith("layout.")}
    values["positioner.handedness"] = _entry("left", "published", ANGLES)
    values["layout.ids"] = _entry("cobraId", "published", MAP)
    values["layout.spectrographs"] = _entry("by fiber", "published", MAP)
    values["layout.dots"] = _entry(N, "published", dots.name)
    notes, columns = [_note_on_dots(dots, circles, offset)], {}
    if arms is None:
        values["layout.centers"] = _entry("dots minus their mean offset", "derived", dots.name)
        values["layout.dot_offset"] = _entry([round(float(v), 6) for v in offset], "derived", dots.name, "mm")
    else:
        names = ", ".join(path.name for path in _paths(cobras))
        columns, defects = _arm_columns(arms, positioner)
        values.pop("positioner.theta_range", None)
        for name in ("centers", "arms", "zero_points", "joint_limits"):
            values[f"layout.{name}"] = _entry("by cobra", "published", names)
        notes.append(f"Centers, arms and joint limits are those of {names}. {defects}")
    if fiducials is not None:
        path = to_path(fiducials)
        columns["obstacles"], text = read_fiducials(path)
        values["layout.fiducials"] = _entry(len(columns["obstacles"]), "published", path.name)
        notes.append(text)
    if interference is not None:
        path = to_path(interference)
        limits = read_interference(path)
        text = _restrict(columns, limits, arms)
        values["layout.interference"] = _entry(int(np.isfinite(limits[:, 0]).sum()), "published", path.name)
        notes.append(f"{path.name}: {text}")
    plane = FocalPlane(
        xy * u.mm, positioner, id=np.arange(1, N + 1), spectrograph=pfs_fibers()[1], hidden=circles * u.mm, **columns
    )
    return replace(
        nominal, focal_plane=plane, plate_scale=None, layout="as built", values=values, notes="\n".join(notes)
    )


def read_dots(path: Path) -> np.ndarray:
    """Return x, y and radius (mm) of the dots, by cobra."""
    table = _read(path, ("spotId", "x", "y", "r"))
    _check_ids(path, table["spotId"], "spotId", N)
    circles = np.column_stack([table[name] for name in ("x", "y", "r")])[np.argsort(table["spotId"])]
    _check_finite(path, circles, "x, y and r")
    apart = np.hypot(*(circles[:, :2] - nominal_centers()).T)
    if apart.max() > FARTHEST_DOT:
        raise InputError(
            f"{path}: each dot must be within {FARTHEST_DOT:g} mm of the nominal center of its cobra, got "
            f"{apart.max():.3g} mm for dot {int(apart.argmax()) + 1}; x, y and r are in mm on the PFI"
        )
    if not ((circles[:, 2] > 0) & (circles[:, 2] < FARTHEST_DOT)).all():
        raise InputError(f"{path}: r must be radii above 0 and below {FARTHEST_DOT:g} mm, got {circles[:, 2].max():g}")
    return circles


def read_fiducials(path: Path) -> tuple[u.Quantity, str]:
    """Return the positions of the fiducials as circles of radius 0, and a note."""
    table = _read(path, ("fiducialId", "x_mm", "y_mm", "flag"))
    _check_ids(path, table["fiducialId"], "fiducialId", N_FIDUCIALS)
    xy = np.column_stack([table["x_mm"], table["y_mm"]])
    seen = np.isfinite(xy).all(axis=1)
    if (seen != np.isfinite(xy).any(axis=1)).any():
        raise InputError(f"{path}: x_mm and y_mm must be given together, got only one for a fiducial")
    extent = np.hypot(*xy[seen].T).max(initial=0.0)
    if not 150 < extent < 300:
        raise InputError(f"{path}: the outermost fiducial must be 150 to 300 mm from the center, got {extent:.4g}")
    circles = np.column_stack([xy[seen], np.zeros(seen.sum())]) * u.mm
    none = [str(int(k)) for k in np.sort(table["fiducialId"][~seen])]
    text = (
        f"{path.name}: {seen.sum()} fiducials are obstacles of radius 0, because the file has no radii; their flags "
        "concern their light and are not used."
    )
    return circles, text + (f" Fiducials without a position: {', '.join(none)}." if none else "")


def read_interference(path: Path) -> np.ndarray:
    """Return the limits of each cobra (deg): begin and end of the window of directions, and largest local phi."""
    names = ("theta_limit_1", "theta_limit_2", "max_phi_angle")
    table = _read(path, ("cobra_id", *names))
    _check_ids(path, table["cobra_id"], "cobra_id", N)
    limits = np.column_stack([table[name] for name in names])[np.argsort(table["cobra_id"])]
    given = np.isfinite(limits)
    if (given.any(axis=1) != given.all(axis=1)).any():
        row = int(np.flatnonzero(given.any(axis=1) != given.all(axis=1))[0]) + 1
        raise InputError(f"{path}: a cobra must have all three limits or none, got some for cobra {row}")
    some = limits[given.all(axis=1)]
    if len(some) and (some.min() < 0 or some.max() > 360 or some[:, 2].max() < 2 * np.pi):
        raise InputError(
            f"{path}: the limits must be angles from 0 to 360 in degrees, got {some.min():g} to {some.max():g} "
            f"with max_phi_angle up to {some[:, 2].max():g}"
        )
    return limits


def read_cobras(paths) -> dict:
    """Return the columns of the calibration model of all cobras, by cobra (lengths in mm, angles in deg)."""
    rows = [row for path in _paths(paths) for row in _containers(path)]
    names = ", ".join(str(path) for path in _paths(paths))
    columns = {name: np.array([row[name] for row in rows]) for name in (*HEADER, *KINEMATICS)}
    ids = N_COBRAS * (columns["module"] - 1) + columns["cobra"]
    if ((columns["cobra"] < 1) | (columns["cobra"] > N_COBRAS)).any():
        raise InputError(f"{names}: Positioner_Id must be 1 to {N_COBRAS}, got {columns['cobra'].max():g}")
    _check_ids(names, ids, "57 (Module_Id - 1) + Positioner_Id", N)
    columns = {name: values[np.argsort(ids)] for name, values in columns.items()}
    for name in ("central_arm", "eccentric_arm"):
        middle = np.median(columns[name])
        if not 1 < middle < 5:
            raise InputError(
                f"{names}: {KINEMATICS[name]} must be in mm, about 2.4, got {middle:.4g} in the median; models in "
                "pixels of a camera cannot be used"
            )
    good = columns["status"] == GOOD
    apart = np.hypot(*(np.column_stack([columns["x"], columns["y"]]) - nominal_centers()).T)
    if good.any() and apart[good].max() > FARTHEST_CENTER:
        row = int(np.flatnonzero(good)[apart[good].argmax()])
        raise InputError(
            f"{names}: each cobra must be within {FARTHEST_CENTER:g} mm of its nominal center on the PFI, got "
            f"{apart[row]:.3g} mm for cobra {row + 1}"
        )
    return columns


def _containers(path: Path):
    """Yield the values of each cobra in a calibration file."""
    from xml.etree import ElementTree

    if not path.is_file():
        raise InputError(f"{path}: {'this is a folder' if path.is_dir() else 'there is no such file'}")
    content = content_of(path)
    if b"<!DOCTYPE" in content[:4096] or b"<!ENTITY" in content:
        raise InputError(f"{path}: the XML must have no document type and no entities, got one")
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path} cannot be read as XML: {sentence(error)}") from None
    found = root.findall("ARM_DATA_CONTAINER")
    if not found:
        raise InputError(f"{path}: the XML must have elements ARM_DATA_CONTAINER, one per cobra, got none")
    for number, container in enumerate(found, 1):
        row = {}
        for section, names in (("DATA_HEADER", HEADER), ("KINEMATICS", KINEMATICS)):
            for name, tag in names.items():
                text = container.findtext(f"{section}/{tag}")
                try:
                    row[name] = float("missing" if text is None else text)
                except ValueError:
                    got = "no such element" if text is None else repr(text)
                    raise InputError(f"{path}: {tag} of element {number} must be a number, got {got}") from None
                if not np.isfinite(row[name]):
                    raise InputError(f"{path}: {tag} of element {number} must be finite, got {text}")
        for name in HEADER:
            if row[name] != int(row[name]):
                raise InputError(f"{path}: {HEADER[name]} of element {number} must be a whole number, got {row[name]}")
            row[name] = int(row[name])
        yield row


def _arm_columns(arms: dict, positioner) -> tuple[dict, str]:
    """Return the columns of the focal plane from a calibration model, and a note on the cobras with defects.

    theta is counted from the counter-clockwise hard stop, and phi from the extended arm.
    """
    bad = arms["status"] != GOOD
    lengths = {}
    unknown = np.zeros(N, dtype=bool)
    for name in ("central_arm", "eccentric_arm"):
        strange = ~((arms[name] > 1) & (arms[name] < 5))
        unknown |= strange
        lengths[name] = np.where(strange, getattr(positioner, name).to_value(u.mm), arms[name]) * u.mm
    span = (arms["theta_high"] - arms["theta_low"] + 180) % 360 + 180
    columns = {
        **lengths,
        "zero_points": np.column_stack([arms["theta_low"], np.zeros(N)]) * u.deg,
        "theta_range": np.column_stack([np.zeros(N), span]) * u.deg,
        "phi_range": np.column_stack([arms["phi_low"], arms["phi_high"]]) * u.deg - 180 * u.deg,
        "disabled": bad | unknown,
    }
    low, high = columns["phi_range"].T
    if not (low < high).all():
        row = int(np.flatnonzero(~(low < high))[0]) + 1
        raise InputError(
            f"Joint2_CCW_limit_angle must be below Joint2_CW_limit_angle, got the opposite for cobra {row}"
        )
    text = (
        f"{bad.sum()} cobras whose Status is not {GOOD} take no target and are parked, because the file does not "
        "contain the positions of those that cannot move"
    )
    others = int((unknown & ~bad).sum())
    return columns, text + (f"; so are {others} whose arm lengths are not within 1 to 5 mm." if others else ".")


def _restrict(columns: dict, limits: np.ndarray, arms: dict | None) -> str:
    """Restrict one joint of each limited cobra so that it never interferes with its fiducial; return a note.

    A cobra interferes if its phi, counted from the folded stop, exceeds a limit while the direction of the central arm
    or of the fiber is in a window. This is avoided by restricting phi to values below the limit, or by restricting
    theta to values for which neither direction can be in the window. The restriction that leaves the larger patrol area
    is used.
    """
    rows = np.flatnonzero(np.isfinite(limits[:, 0]))
    begin, end, most = limits[rows].T
    folded = np.full(len(rows), -FOLDED) if arms is None else arms["phi_low"][rows] - 180
    zero = np.zeros(len(rows)) if arms is None else arms["theta_low"][rows]
    span = np.full(len(rows), 360.0) if arms is None else columns["theta_range"][rows, 1].to_value(u.deg)
    extended = folded + most  # the limit, measured from the extended arm
    lengths = (1.0, 1.0) if arms is None else (columns[f"{name}_arm"][rows].value for name in ("central", "eccentric"))
    width = (end - begin) % 360 + _largest_lag(extended, *lengths)
    by_theta = (1 - width / 360 >= np.cos(np.deg2rad(extended) / 2) ** 2) & (span >= 360) & (width < 360)
    theta, phi = (
        columns.get(name, np.full((N, 2), np.nan) * u.deg).to_value(u.deg).copy()
        for name in ("theta_range", "phi_range")
    )
    first = (begin + width - zero) % 360
    theta[rows[by_theta]] = np.column_stack([first, first + 360 - width])[by_theta]
    low = np.maximum(folded, -180) if arms is None else folded
    phi[rows[~by_theta]] = np.column_stack([low, extended])[~by_theta]
    columns["theta_range"], columns["phi_range"] = theta * u.deg, phi * u.deg
    return (
        f"{len(rows)} cobras have limits because of a fiducial. A limit concerns both joints together; it is honored "
        f"by a range of theta for {by_theta.sum()} and by a range of phi for {(~by_theta).sum()} cobras, each of "
        "which forbids more than the limit does."
    )


def _largest_lag(extended: np.ndarray, l1, l2) -> np.ndarray:
    """Return the largest angle (deg) by which the fiber is clockwise of the central arm, for phi above a limit."""
    phi = np.deg2rad(np.linspace(np.minimum(extended, 0), 0, 200))
    return np.rad2deg(np.arctan2(-l2 * np.sin(phi), l1 + l2 * np.cos(phi))).max(axis=0)


def _note_on_dots(path: Path, circles: np.ndarray, offset: np.ndarray) -> str:
    return (
        f"{path.name}: {len(circles)} dots of radius {circles[:, 2].min():.3f} to {circles[:, 2].max():.3f} mm hide "
        f"fibers; targets behind a dot are out of reach of all cobras. The mean offset of a dot from the nominal "
        f"center of its cobra is ({offset[0]:.3f}, {offset[1]:.3f}) mm."
    )


def _entry(value, status: str, source: str, unit: str | None = None) -> dict:
    return {"value": value, **({} if unit is None else {"unit": unit}), "status": status, "source": source}


def _given(**values) -> dict:
    return {name: value for name, value in values.items() if value is not None}


def _paths(paths) -> list[Path]:
    return [to_path(path) for path in (paths if isinstance(paths, list | tuple) else [paths])]


def _read(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Return columns of numbers, with NaN for missing values."""
    table, columns = read_table(path), {}
    if len(table) == 0:
        raise InputError(f"{path}: the table must have at least one row, got none")
    for name in names:
        if name not in table.colnames:
            raise InputError(f"{path}: the table must have the column {name!r}, got {', '.join(table.colnames)}")
        column = table[name]
        if np.asarray(column).dtype.kind not in "if":
            text = [str(v) for v in np.ma.asarray(column).compressed().tolist()]
            strange = next((v for v in text if not _is_float(v)), text[0] if text else "no number")
            raise InputError(f"{path}: the column {name!r} must hold numbers, got {strange!r}")
        columns[name] = np.ma.filled(np.ma.asarray(np.ma.asanyarray(column), dtype=float), np.nan)
    return columns


def _is_float(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _check_ids(path, ids: np.ndarray, name: str, n: int) -> None:
    """Raise an error unless identifiers are the numbers 1 to n, without repetition."""
    if len(ids) != n:
        raise InputError(f"{path}: the file must have {n} rows, one for each {name} from 1 to {n}, got {len(ids)}")
    values, counts = np.unique(ids, return_counts=True)
    if (counts > 1).any():
        raise InputError(f"{path}: {name} must be unique, but {values[counts > 1][0]:g} occurs more than once")
    if not np.array_equal(values, np.arange(1, n + 1)):
        strange = values[~np.isin(values, np.arange(1, n + 1))][0]
        raise InputError(f"{path}: {name} must be 1 to {n}, got {strange:g}")


def _check_finite(path, values: np.ndarray, names: str) -> None:
    bad = ~np.isfinite(values).all(axis=1)
    if bad.any():
        raise InputError(
            f"{path}: {names} must be finite, got {values[bad][0].tolist()} in row {np.flatnonzero(bad)[0] + 1}"
        )
