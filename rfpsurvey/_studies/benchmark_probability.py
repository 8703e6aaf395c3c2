"""Benchmark that measures the time and the error of each method that estimates collision probabilities."""

import os
import platform
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._assignment.allocate import allocate
from rfpsurvey._common.executors import Progress
from rfpsurvey._common.plugins import name_of
from rfpsurvey._common.units import to_generator
from rfpsurvey._instruments.arms import place_arms
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.instrument import Instrument, as_focal_plane, as_instrument
from rfpsurvey._studies.collision_probability import collision_probability
from rfpsurvey._studies.methods import METHODS, find_method
from rfpsurvey._studies.simulate import QUEUEING
from rfpsurvey._studies.targets import Precision, make_source
from rfpsurvey.errors import InputError, check_whole, used_elsewhere


def random_tips(plane, rng):
    """Return the position (mm) of one random target for each positioner, uniformly distributed in its patrol area.

    If a positioner reaches none of a hundred random points, its target is NaN.
    """
    inner, outer, n = plane.arrays.inner_radius, plane.arrays.outer_radius, len(plane)
    tips, wanting = np.full((n, 2), np.nan), np.ones(n, dtype=bool)
    for _ in range(100):  # targets that joint limits exclude are drawn again
        # the area within a radius grows with its square; targets on an edge could be out of reach by rounding errors
        r = np.clip(np.sqrt(rng.uniform(inner**2, outer**2)), inner * (1 + 1e-12), outer * (1 - 1e-12))
        alpha = rng.uniform(0, 2 * np.pi, n)
        drawn = plane.arrays.xy + r[:, None] * np.column_stack([np.cos(alpha), np.sin(alpha)])
        tips[wanting] = drawn[wanting]
        wanting = place_arms(plane, tips * u.mm, clip=True).clipped
        if not wanting.any():
            break
    tips[wanting] = np.nan
    return tips


def has_gpu():
    """Return whether the machine has a GPU; a GPU that numba simulates on the CPU is not counted."""
    try:
        from numba import config, cuda
    except ImportError:
        return False
    return bool(not config.ENABLE_CUDASIM and cuda.is_available())


def provenance(instrument, plane):
    """Return a description of a benchmark: the instrument, the versions of packages, and the machine."""
    name = instrument if isinstance(instrument, str) else getattr(instrument, "name", "focal plane")
    return {
        "instrument": name,
        "layout": getattr(as_instrument(instrument) if name is instrument else instrument, "layout", "not stated"),
        "n_positioners": len(plane),
        "n_neighbor_pairs": len(plane.arrays.neighbors),
        "min_separation_mm": plane.arrays.separation,
        "versions": {name: version(name) for name in ("rfpsurvey", "numba", "numpy")},
        "machine": f"{processor()}, {os.cpu_count()} cores",
    }


def processor(cpuinfo="/proc/cpuinfo"):
    """Return the name of the processor, or the name of its architecture if the processor's name is unknown."""
    try:
        lines = Path(cpuinfo).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(filter(None, names), platform.machine())


def benchmark_probability(
    instrument: str | Instrument | FocalPlane = "lamost",
    *,
    efforts: Mapping[str, Sequence[int]] | None = None,
    repeats: int = 30,
    precision: float = 2e-4,
    rng: int | np.random.Generator | None = 0,
    progress: bool | Callable = False,
) -> QTable:
    """Measure the time and the error of each method that estimates collision probabilities.

    The reference value for allocated targets is computed by a long conditional Monte Carlo simulation. The reference
    value for independent (uniform) targets is computed by a fine quadrature. The methods run alternately. Errors below
    ``truth_error``, the standard error of the reference value, are not significant.

    Parameters
    ----------
    instrument : str, Instrument or FocalPlane, optional
        An instrument, a focal plane, or the name of a preset. The random targets are the default targets of
        `~rfpsurvey.collision_probability`.
    efforts : mapping of str to sequence of int, optional
        Efforts of each method: the numbers of iterations, realizations or points for which the method is run. Give 0
        for the methods that are formulas. By default, all methods that support the arm model.
    repeats : int, optional
        Number of runs with different random numbers for each method and effort.
    precision : float, optional
        Standard error to which the reference values are computed.
    rng : int, Generator or None, optional
        Seed or random number generator.
    progress : bool or callable, optional
        Show the progress on the standard error, or call a function with the number of finished rounds and the total
        number of rounds. Each round runs every method once with each effort.

    Returns
    -------
    QTable
        Table with a row for each method and effort: ``method``, ``estimand``, ``effort``, median ``time``, mean
        ``value``, ``bias`` (mean minus reference value) and its standard error ``bias_error``, root-mean-square
        ``error`` and its standard error ``error_error`` (NaN for a single run), mean estimated ``standard_error``,
        the reference value ``truth`` and its standard error ``truth_error``.

    Raises
    ------
    InputError
        If a method is unknown or a number is not positive.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(7.4 * u.mm, 15 * u.mm, 2.5 * u.mm)
    >>> plane = rs.FocalPlane.hexagonal(robot, rings=2, pitch=22.4 * u.mm)
    >>> table = rs.benchmark.benchmark_probability(plane, efforts={"quadrature": [64, 128]}, repeats=2, precision=2e-3)
    >>> table["method", "effort"].pformat()[2:]
    ['quadrature     64', 'quadrature    128']
    """
    plane = as_focal_plane(instrument)
    if efforts is None:
        outlined = plane.positioner.outline is not None
        efforts = {name: method.efforts for name, method in METHODS.items() if method.supports_outlines or not outlined}
    if not isinstance(efforts, Mapping) or not efforts:
        raise InputError(f"efforts must map methods to lists of numbers, got {efforts!r}")
    estimands = {method: find_method(method, METHODS).estimand for method in efforts}
    runs = [(method, n) for method, numbers in efforts.items() for n in numbers]
    check_whole(repeats, "repeats")
    rng = to_generator(rng)
    with used_elsewhere():  # methods use different options
        truth = {
            kind: collision_probability(instrument, estimand=kind, precision=precision, rng=rng.spawn(1)[0])
            for kind in sorted(set(estimands.values()))
        }
    results: dict = {run: [] for run in runs}
    turns = range(repeats + 1)  # the first run compiles the kernels
    with Progress(progress, len(turns), "rounds") as bar:
        for turn in turns:
            for method, n in runs:
                effort = Precision(max_iterations=n or None)
                start = perf_counter()
                with used_elsewhere():
                    e = collision_probability(instrument, method=method, precision=effort, rng=rng.spawn(1)[0])
                results[method, n] += [(perf_counter() - start, e.value, e.standard_error)] if turn else []
            bar(turn + 1)
    rows = []
    for (method, n), values in results.items():
        seconds, value, error = np.array(values).T
        true = truth[estimands[method]]
        rows.append(
            {
                "method": name_of(method),
                "estimand": true.estimand,
                "effort": n,
                "time": 1e3 * np.median(seconds) * u.ms,
                "value": value.mean(),
                **_misses(value, true),
                "standard_error": error.mean(),
                "truth": true.value,
                "truth_error": true.standard_error,
            }
        )
    table = QTable(rows)
    table.meta.update(provenance(instrument, plane), repeats=repeats)
    return table


def _misses(values, true):
    """Return the columns ``bias`` and ``error`` (root mean square) of repeated runs, and their standard errors."""
    n, away = len(values), values - true.value
    squares = away**2
    error = float(np.sqrt(squares.mean()))
    scatter, spread = (x.std(ddof=1) / np.sqrt(n) if n > 1 else np.nan for x in (values, squares))
    # the error of the square root of the mean, to first order
    return {
        "bias": away.mean(),
        "bias_error": np.hypot(scatter, true.standard_error),
        "error": error,
        "error_error": spread / (2 * error) if error > 0 else spread,
    }


def benchmark_densities(
    instrument: str | Instrument | FocalPlane = "lamost",
    *,
    precision: float = 1e-3,
    n_allocations: int = 8,
    rng: int | np.random.Generator | None = 0,
) -> QTable:
    """Compare the collision probability for allocated targets with that for independent targets of several densities.

    Parameters
    ----------
    instrument : str, Instrument or FocalPlane, optional
        An instrument, a focal plane, or the name of a preset.
    precision : float, optional
        Standard error of each collision probability, except for the empirical density.
    n_allocations : int, optional
        Number of allocations of random targets. The queues (lists of targets) of all positioners in these allocations
        form the empirical density.
    rng : int, Generator or None, optional
        Seed or random number generator.

    Returns
    -------
    QTable
        Table with a row for each density: ``density`` (``allocated`` for allocated targets, otherwise a density of
        `~rfpsurvey.collision_probability`), ``value`` (collision probability), ``standard_error``, ``bias`` (the
        difference from the value for allocated targets), and ``factor`` (the ratio to the value for allocated
        targets). The first row contains the value for allocated targets.

    Raises
    ------
    InputError
        If a number is not positive.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> robot = rs.Positioner(7.4 * u.mm, 15 * u.mm, 2.5 * u.mm)
    >>> plane = rs.FocalPlane.hexagonal(robot, rings=2, pitch=22.4 * u.mm)
    >>> rs.benchmark.benchmark_densities(plane, precision=0.01, n_allocations=2)["density"].tolist()
    ['allocated', 'uniform', 'shared', 'voronoi', 'empirical']
    """
    plane = as_focal_plane(instrument)
    check_whole(n_allocations, "n_allocations")
    rng = to_generator(rng)
    model = None if isinstance(instrument, FocalPlane) else as_instrument(instrument)
    estimates = {"allocated": collision_probability(instrument, precision=precision, rng=rng)}
    for density in ("uniform", "shared", "voronoi"):
        options = {"method": "quadrature", "density": density, "precision": precision}
        estimates[density] = collision_probability(plane, rng=rng, **options)
    source = make_source(plane, model)
    queues = [allocate(plane, source.draw(rng) * u.mm, allocator=QUEUEING, rng=rng) for _ in range(n_allocations)]
    estimates["empirical"] = collision_probability(plane, method="quadrature", density=queues, precision=precision)
    true = estimates["allocated"].value
    rows = [
        (name, e.value, e.standard_error, e.value - true, e.value / true if true else np.nan)
        for name, e in estimates.items()
    ]
    table = QTable(rows=rows, names=("density", "value", "standard_error", "bias", "factor"))
    table.meta.update(provenance(instrument, plane), n_allocations=n_allocations)
    return table
