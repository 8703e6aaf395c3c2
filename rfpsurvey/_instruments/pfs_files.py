"""Readers of the files of PFS: fiber map, dots, fiducials, interference limits and calibration models of the cobras."""

from pathlib import Path

import astropy.units as u
import numpy as np
import scipy  # its subpackages are imported on first use

from rfpsurvey._common.files import to_path
from rfpsurvey._common.read_documents import check_is_file, content_of, sentence
from rfpsurvey._common.read_tables import is_number, read_table
from rfpsurvey._common.units import check_unique
from rfpsurvey._instruments.as_built import is_missing, number_rows
from rfpsurvey.errors import InputError

N_FIELDS, N_MODULES, N_COBRAS = 3, 14, 57  # numbers of fields, of modules per field and of cobras per module
N = N_FIELDS * N_MODULES * N_COBRAS
PITCH = 8.0
# Position angle (deg) of the +y axis of the focal plane of PFS (PFI) at POSANG = 0. The +x axis points north, and the
# +y axis points west. The difference of 0.1 deg from -90 deg is the rotation between pfiNominal and the sky coordinates
# in the design 0x2a3e0e7f53f47587.
PFI_ANGLE = -89.898
# Boards of cobras in the order of their fibers along the slit of each spectrograph. A name consists of the number of a
# module in its field and of the half of this module, A or B. Each name stands for three boards, one of each field.
BOARDS = ("4A 12A 4B 14B 12B 8B 8A", "3A 11A 3B 13B 11B 7B 7A", "2A 10A 2B 14A 10B 6B 6A", "1A 9A 1B 13A 9B 5B 5A")
FIRST_HALF = 29  # number of cobras on board A of a module; the other cobras are on board B
HOLES = 651
# Numbers of the holes of a slit without a fiber of a cobra: holes with engineering fibers, and empty holes. The slits
# of the first two spectrographs have three more empty holes.
ENGINEERING = (1, 45, 92, 137, 184, 229, 273, 316, 336, 382, 426, 471, 515, 560, 607, 651)
EMPTY = (44, 91, 93, 136, 183, 185, 228, 272, *range(317, 336), 383, 427, 470, 472, 516, 559, 561, 608)
EMPTY_IN_FIRST_TWO = (280, 309, 359)


def nominal_centers() -> np.ndarray:
    """Return the nominal centers of cobras 1 to 2394 on the Prime Focus Instrument (mm), shape (2394, 2)."""
    cobra, module = np.arange(N_COBRAS), np.arange(N_MODULES)
    step = PITCH * np.exp(1j * np.deg2rad(150))
    row = -PITCH * np.sin(np.pi / 3) * (1 + cobra % 2) + 1j * PITCH / 2 * (1 - cobra)
    field = (row + 2 * module[:, None] * step).ravel()
    centers = np.concatenate([field * np.exp(-2j * np.pi / 3 * k) for k in range(N_FIELDS)])
    return np.column_stack([centers.real, centers.imag])


def cobra_ids(xy: np.ndarray) -> np.ndarray:
    """Return the numbers of the cobras (1 to 2394) that have the nominal centers ``xy`` (mm)."""
    apart, row = scipy.spatial.cKDTree(nominal_centers()).query(xy)
    if len(xy) != N or apart.max() > 1e-6 or len(np.unique(row)) < N:
        raise InputError(f"names = 'cobra' requires the {N} nominal centers of PFS, got other positions")
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


N_FIDUCIALS = 96
# Largest distance (mm) of a dot from the nominal center of its cobra; adjacent centers are 8 mm apart.
FARTHEST_DOT = 4.0
FARTHEST_CENTER = 3.0
MOST_XML = 2**25  # bytes
GOOD = 1  # status of a cobra without a defect
FARTHEST_FIDUCIAL = 300.0
# Limits of the values of cobras (angles in deg, lengths in mm); cobras with other values are parked.
LIMITS = {
    "theta_low": (-360, 360),
    "theta_high": (-360, 720),
    "phi_low": (-90, 270),
    "phi_high": (-90, 270),
    "central_arm": (1, 5),
    "eccentric_arm": (1, 5),
}
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


def read_dots(path: Path) -> np.ndarray:
    """Return x, y and radius (mm) of the dots, with one row for each cobra."""
    table = _read(path, ("spotId", "x", "y", "r"))
    _check_ids(path, table["spotId"], "spotId", N)
    circles = np.column_stack([table[name] for name in ("x", "y", "r")])[np.argsort(table["spotId"])]
    for row in np.flatnonzero(~np.isfinite(circles).all(axis=1)):
        raise InputError(f"{path}: x, y and r must be finite, got {circles[row].tolist()} in row {row + 1}")
    apart = np.hypot(*(circles[:, :2] - nominal_centers()).T)
    if apart.max() > FARTHEST_DOT:
        raise InputError(
            f"{path}: each dot must be within {FARTHEST_DOT:g} mm of the nominal center of its cobra, got "
            f"{apart.max():.3g} mm for dot {int(apart.argmax()) + 1}; give x, y and r in mm on the PFI"
        )
    if not ((circles[:, 2] > 0) & (circles[:, 2] < FARTHEST_DOT)).all():
        raise InputError(f"{path}: r must be radii above 0 and below {FARTHEST_DOT:g} mm, got {circles[:, 2].max():g}")
    return circles


def read_fiducials(path: Path) -> tuple[u.Quantity, str]:
    """Return the positions of the fiducials as circles of radius 0, and a note."""
    table = _read(path, ("fiducialId", "x_mm", "y_mm", "flag"))
    _check_ids(path, table["fiducialId"], "fiducialId", N_FIDUCIALS)
    xy = np.column_stack([table["x_mm"], table["y_mm"]])
    missing = is_missing(xy, -FARTHEST_FIDUCIAL, FARTHEST_FIDUCIAL) | (xy == 0).all(axis=1)[:, None]
    seen = ~missing.all(axis=1)
    for k in np.flatnonzero(missing.any(axis=1) & seen):
        raise InputError(
            f"{path}: x_mm and y_mm must both be positions within {FARTHEST_FIDUCIAL:g} mm, or both be missing, got "
            f"{xy[k].tolist()} in row {k + 1}"
        )
    extent = np.hypot(*xy[seen].T).max(initial=0.0)
    if not 150 < extent < FARTHEST_FIDUCIAL:
        raise InputError(f"{path}: the outermost fiducial must be 150 to 300 mm from the center, got {extent:.4g}")
    circles = np.column_stack([xy[seen], np.zeros(seen.sum())]) * u.mm
    none = [str(int(k)) for k in np.sort(table["fiducialId"][~seen])]
    text = (
        f"{path.name}: {seen.sum()} fiducials are obstacles of radius 0, because the file has no radii; the flags in "
        "the file describe the light of the fiducials and are not used."
    )
    return circles, text + (f" Fiducials without a position: {', '.join(none)}." if none else "")


def read_interference(path: Path) -> np.ndarray:
    """Return the interference limits of each cobra (deg): start and end of a window of directions, and limit of phi."""
    names = ("theta_limit_1", "theta_limit_2", "max_phi_angle")
    table = _read(path, ("cobra_id", *names))
    _check_ids(path, table["cobra_id"], "cobra_id", N)
    limits = np.column_stack([table[name] for name in names])[np.argsort(table["cobra_id"])]
    limits[is_missing(limits, -np.inf, np.inf) & is_missing(limits, 0, 360, codes=False)] = np.nan
    given = np.isfinite(limits)
    for row in np.flatnonzero(given.any(axis=1) != given.all(axis=1)):
        raise InputError(f"{path}: a cobra must have all three limits or none, got only some for cobra {row + 1}")
    some = limits[given.all(axis=1)]
    if len(some) and (some.min() < 0 or some.max() > 360 or some[:, 2].max() < 2 * np.pi):
        raise InputError(
            f"{path}: the limits must be angles from 0 to 360 in degrees, got {some.min():g} to {some.max():g} "
            f"with max_phi_angle up to {some[:, 2].max():g}"
        )
    return limits


def read_cobras(paths) -> dict:
    """Return the columns of the calibration model, with one row for each cobra (lengths in mm, angles in deg).

    The column ``unknown`` states which cobras have values that are impossible. A cobra with a defect whose center is
    impossible has the nominal center.
    """
    rows = [row for path in to_paths(paths) for row in _containers(path)]
    names = ", ".join(str(path) for path in to_paths(paths))
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
                f"{names}: {KINEMATICS[name]} must be about 2.4 mm, got the median {middle:.4g}; models in pixels of "
                "a camera cannot be used"
            )
    good = columns["status"] == GOOD
    nominal = nominal_centers()
    apart = np.hypot(*(np.column_stack([columns["x"], columns["y"]]) - nominal).T)
    if good.any() and apart[good].max() > FARTHEST_CENTER:
        row = int(np.flatnonzero(good)[apart[good].argmax()])
        raise InputError(
            f"{names}: each cobra must be within {FARTHEST_CENTER:g} mm of its nominal center on the PFI, got "
            f"{apart[row]:.3g} mm for cobra {row + 1}"
        )
    far = apart > FARTHEST_CENTER
    columns["x"], columns["y"] = np.where(far, nominal.T, (columns["x"], columns["y"]))
    wrong = [is_missing(columns[name], *limits, codes=False) for name, limits in LIMITS.items()]
    columns["unknown"] = far | np.any(wrong, axis=0) | (columns["theta_low"] == -99) | (columns["theta_high"] == -99)
    return columns


def _containers(path: Path):
    """Yield the values of each cobra in a calibration file."""
    from xml.etree import ElementTree

    check_is_file(path)
    content = content_of(path, most=MOST_XML)
    if b"<!DOCTYPE" in content[:4096] or b"<!ENTITY" in content:
        raise InputError(f"{path}: the XML must have no document type and no entities, got one")
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path} cannot be read as XML: {sentence(error)}") from None
    containers = root.findall("ARM_DATA_CONTAINER")
    if not containers:
        raise InputError(f"{path}: the XML must have elements ARM_DATA_CONTAINER, one per cobra, got none")
    for number, container in enumerate(containers, 1):
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


def to_paths(paths) -> list[Path]:
    """Return a list of paths from one path or several."""
    return [to_path(path) for path in (paths if isinstance(paths, list | tuple) else [paths])]


def _read(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Return columns of a table as numbers, with NaN for missing values."""
    table, columns = read_table(path), {}
    number_rows(table, names, path)
    for name in names:
        column = table[name]
        if np.asarray(column).dtype.kind not in "if":
            text = [str(v) for v in np.ma.asarray(column).compressed().tolist()]
            strange = next((v for v in text if not is_number(v)), text[0] if text else "no number")
            raise InputError(f"{path}: the column {name!r} must hold numbers, got {strange!r}")
        columns[name] = np.ma.filled(np.ma.asarray(np.ma.asanyarray(column), dtype=float), np.nan)
    return columns


def _check_ids(path, ids: np.ndarray, name: str, n: int) -> None:
    """Raise an error unless identifiers are the numbers 1 to n, without repetition."""
    if len(ids) != n:
        raise InputError(f"{path}: the file must have {n} rows, one for each {name} from 1 to {n}, got {len(ids)}")
    check_unique(ids, f"{path}: {name}")
    for strange in ids[~np.isin(ids, np.arange(1, n + 1))]:
        raise InputError(f"{path}: {name} must be 1 to {n}, got {strange:g}")
