"""The designs of a scan: all combinations of given parameter values, or Sobol points between limits."""

import itertools

import astropy.units as u
import numpy as np

from rfpsurvey._units import to_mm, to_plain
from rfpsurvey.errors import INCONVERTIBLE, InputError, check_whole, refusal

AXES = ("central_arm", "ratio", "pitch", "clearance")
MOST = 10_000_000


def to_axes(central_arm: u.Quantity, ratio: object, pitch: u.Quantity, clearance: u.Quantity) -> dict[str, np.ndarray]:
    """Return the values of each parameter of a scan, with lengths in mm; raise an error if a value is not valid."""
    lengths = {"central_arm": central_arm, "pitch": pitch, "clearance": clearance}
    axes = {name: to_mm(value, name) for name, value in lengths.items()}
    try:
        axes["ratio"] = to_plain(u.Quantity(ratio, u.dimensionless_unscaled).value).astype(float)
    except INCONVERTIBLE:
        text = "ratio (eccentric arm length divided by central arm length) must be one or several numbers"
        raise refusal(text, ratio, str, int, list, np.ndarray) from None
    for name, values in axes.items():
        wrong = values[~((values >= 0 if name == "clearance" else values > 0) & (values < 1e6))]
        if wrong.size:
            what = "at least 0" if name == "clearance" else "above 0"
            raise InputError(f"{name} must be finite and {what}, got {wrong.flat[0]:g}")
        if values.ndim > 1 or values.size == 0:
            raise InputError(f"{name} must be one value or a one-dimensional array, got the shape {values.shape}")
    return {name: np.atleast_1d(axes[name]) for name in AXES}


def to_designs(axes: dict[str, np.ndarray], n_designs: int | None, seed: int) -> np.ndarray:
    """Return the designs of a scan as rows (central_arm, ratio, pitch, clearance)."""
    if n_designs is None:
        for name, values in axes.items():
            if len(np.unique(values)) < len(values):
                raise InputError(f"the values of {name} must differ from each other, got {values}")
        n = np.prod([float(len(values)) for values in axes.values()])
        if n > MOST:
            raise InputError(f"a grid must have at most {MOST:.0e} designs, got {n:.3g}")
        return np.array(list(itertools.product(*axes.values())))
    check_whole(n_designs, "n_designs", high=MOST)
    for name, values in axes.items():
        if len(values) > 2 or (len(values) == 2 and not values[0] < values[1]):
            raise InputError(f"if n_designs is given, {name} must be one value or two limits (low, high), got {values}")
    low, high = (np.array([values[k] for values in axes.values()]) for k in (0, -1))
    points = np.zeros((n_designs, len(axes)))
    free = low < high
    if free.any():
        points[:, free] = _sobol(int(n_designs), int(free.sum()), seed)
    return low + points * (high - low)


def _sobol(n, n_axes, seed):
    """Return scrambled Sobol points of the unit cube; for the same seed, larger sets begin with the same points."""
    from scipy.stats import qmc  # importing this takes longer than importing all of this package

    return qmc.Sobol(n_axes, scramble=True, seed=seed).random_base2(int(np.ceil(np.log2(n))))[:n]
