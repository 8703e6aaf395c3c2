"""Nominal centers, spectrographs and fibers of the cobras of PFS, which are numbered from 1 to 2394.

The cobras are in three fields; each field has 14 modules, and each module has 57 cobras.
"""

import numpy as np
import scipy  # its subpackages are imported on first use

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
