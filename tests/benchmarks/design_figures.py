"""Numbers on the page on designs: the time of large scans by each method, and the errors of the fast methods.

Run ``python tests/benchmarks/design_figures.py``, which takes half an hour on two cores. ``--designs 400`` takes a
tenth of this time.
"""

import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from unittest import mock

import astropy.units as u
import numpy as np
from measure import arguments

import rfpsurvey as rs
from rfpsurvey._studies import losses as _losses
from rfpsurvey._studies.losses import make_lattice
from rfpsurvey._studies.surrogate import AXES, interior_probability

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))
import flat

MM = u.mm
BOX = {"central_arm": [7.25, 14.5] * MM, "ratio": [1, 2], "pitch": [24.6, 35] * MM, "clearance": 2.25 * MM}
"""The ranges of the designs of the paper."""
SCANS = (
    ("auto", 4.0, 1),
    ("quadrature", 4.0, 1),
    ("conditional", 4.0, 1),
    ("repair", 1.0, 5),
    ("optimal", 4.0, 10),
    ("optimal", 1.0, 20),
    ("optimal, 0.2 s", 1.0, 20),
)
"""Method, targets per positioner, and the factor by which fewer designs are computed."""
NAMED = {
    "LAMOST": (8.25, 8.25, 25.6, 2.25),
    "SDSS-V": (7.4, 15.0, 22.4, 2.5391),
    "MOONS": (8.0, 17.0, 25.058, 2.0),
    "DESI": (3.0, 3.0, 10.4, 0.99),
    "PFS": (2.375, 2.375, 8.0, 1.0),
}


def scan(n, executor, **options):
    """Return a scan of the paper's range of designs, and its time in seconds."""
    start = perf_counter()
    table = flat.explore_designs(**BOX, n_designs=n, executor=executor, **options)
    return table, perf_counter() - start


def timings(n, executor, workers):
    """Print the time of scans."""
    for method, each, part in SCANS:
        name, _, limit = method.partition(", ")
        options = {"method": name, "targets_per_positioner": each}
        options |= {"time_limit": u.Quantity(limit)} if limit else {}
        scan(16, executor, **options)  # compile the kernels
        some = max(n // part, 16)
        table, seconds = scan(some, executor, **options)
        used = {str(name): int((table["method"] == name).sum()) for name in np.unique(table["method"])}
        print(
            f"{method}, {each:g} targets: {some} designs in {seconds:.1f} s with {workers} processes, "
            f"{1e3 * seconds / some:.2f} ms each; {n} would take {seconds * n / some:.0f} s; median error "
            f"{np.median(table['loss_error']):.4f}; {used}; {(table['n_unproven'] > 0).sum()} unproven, "
            f"largest gap {np.max(table['loss_gap']):.2g}",
            flush=True,
        )


def surrogate_errors(n):
    """Print the errors of the surrogate in its whole range, for values of at least 0.01 and for smaller values."""
    rng = np.random.default_rng(11)
    low, high = ([nodes[k] for nodes in AXES.values()] for k in (0, -1))
    shapes = rng.uniform(low, high, (n, 3))
    found = rs.probability.surrogate_probability(
        shapes[:, 0] * MM, shapes[:, 0] * shapes[:, 1] * MM, 1 * MM, shapes[:, 2] * MM
    )
    truth = np.array([interior_probability(tuple(s), 512, own)[0] for s, own in zip(shapes, rng.spawn(n), strict=True)])
    for name, rows in (("at least 0.01", found >= 0.01), ("less than 0.01", (found < 0.01) & (found > 0))):
        away = np.abs(found - truth)[rows]
        print(f"surrogate, {name}: {rows.sum()} designs, rms {np.sqrt(np.mean(away**2)):.1e}, largest {away.max():.1e}")


def coverage_errors():
    """Print the largest error of coverages that are computed with the default number of lines."""
    rng = np.random.default_rng(3)
    away = []
    for central_arm, ratio, pitch in rng.uniform((5, 0.7, 22), (15, 3, 36), (300, 3)):
        lattice, _ = make_lattice(central_arm, ratio, pitch, 2.0, 0.0)
        if lattice is not None:
            away.append(np.abs(lattice.coverage() - lattice.coverage(8192)).max())
    print(f"coverage: {len(away)} designs, error rms {np.sqrt(np.mean(np.square(away))):.1e}, largest {max(away):.1e}")


def losses():
    """Print the losses of existing arms, for each definition of the loss."""
    for name, (central_arm, eccentric_arm, pitch, clearance) in NAMED.items():
        design = {
            "central_arm": central_arm * MM,
            "ratio": eccentric_arm / central_arm,
            "pitch": pitch * MM,
            "clearance": clearance * MM,
        }
        row = flat.explore_designs(**design)[0]
        print(
            f"{name}: coverage {row['coverage']:.4f}, multiplicity {row['multiplicity']:.3f}, alone {row['loss']:.3f}"
        )
        for each in (1.0, 2.0, 4.0):
            line = f"  {each:g} targets a positioner:"
            for method in ("conditional", "repair", "optimal"):
                row = flat.explore_designs(**design, method=method, targets_per_positioner=each, n_skies=32)[0]
                line += f" {method} {row['loss']:.4f} +- {row['loss_error']:.4f} of {row['assigned']:.3f};"
            print(line, flush=True)


def edges():
    """Print losses in the center of patches of two sizes. The edge of a patch influences which positioners are idle."""
    design = {
        "central_arm": 8.25 * MM,
        "ratio": 1.5,
        "pitch": 25.6 * MM,
        "clearance": 2.25 * MM,
        "targets_per_positioner": 1.0,
    }
    for method in ("conditional", "optimal"):
        for core, n_skies in ((_losses.CORE, 800), (2.4 * _losses.CORE, 150)):
            with mock.patch.object(_losses, "CORE", core):
                row = flat.explore_designs(**design, method=method, n_skies=n_skies)[0]
            print(f"{method}, {core:g} pitches about the middle: {row['loss']:.4f} +- {row['loss_error']:.4f}")


def main():
    asked = arguments(__doc__, designs=4000, workers=2)
    warnings.simplefilter("ignore", rs.RfpsurveyWarning)
    coverage_errors()
    surrogate_errors(max(asked.designs // 10, 40))
    edges()
    losses()
    with ProcessPoolExecutor(asked.workers, get_context("spawn")) as executor:
        timings(asked.designs, executor, asked.workers)


if __name__ == "__main__":
    main()
