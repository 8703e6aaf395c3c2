"""Benchmarks that measure the speed and the errors of the methods that find collisions."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.util import find_spec
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.table import MaskedColumn, QTable
from scipy.spatial import cKDTree

from rfpsurvey._common.descriptions import table_of
from rfpsurvey._common.executors import Progress, released
from rfpsurvey._common.units import to_generator
from rfpsurvey._instruments.arms import place_arms
from rfpsurvey._instruments.collision_methods import (
    DEFAULT_METHOD,
    METHODS,
    CollisionMethod,
    Configuration,
    Found,
    closer_exactly,
    distance_exactly,
    keep_closer,
    near_pairs,
)
from rfpsurvey._instruments.count_collisions import count_collisions
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.instrument import Instrument, as_focal_plane
from rfpsurvey._kernels import batch as reference
from rfpsurvey._studies.benchmark_probability import has_gpu, provenance, random_tips
from rfpsurvey.errors import InputError, check_choice, check_whole


def every_pair(case: Configuration) -> Found:
    """Compute the exact distances of all pairs of neighbors in a loop, without excluding distant pairs first."""
    first, second = case.plane.arrays.neighbors.T.copy()
    squared = np.empty(len(first))
    reference.all_pairs(case.segments, first, second, squared)
    return keep_closer(case, first, second, np.sqrt(squared))


def endpoints(case: Configuration) -> Found:
    """Compute distances only from the four ends of two arms; crossings are not detected."""
    first, second = near_pairs(case)
    squared = np.empty(len(first))
    reference.endpoints(case.segments, first, second, squared)
    return keep_closer(case, first, second, np.sqrt(squared))


def shapely(case: Configuration) -> Found:
    """Compute distances with vectorized functions of shapely; making the line strings is part of the measured time."""
    from shapely import distance, linestrings

    first, second = near_pairs(case)
    lines = linestrings(case.segments.T.reshape(-1, 2, 2))
    return keep_closer(case, first, second, distance(lines[first], lines[second]))


COMPARED = METHODS | table_of(
    CollisionMethod("every_pair", every_pair),
    CollisionMethod("endpoints", endpoints),
    CollisionMethod("shapely", shapely),
)
"""All methods that `~rfpsurvey.benchmark.benchmark_collisions` can measure.

The last three methods are not methods of `find_collisions`.
"""


def benchmark_collisions(
    instrument: str | Instrument | FocalPlane = "lamost",
    *,
    methods: Sequence[str] | None = None,
    n_configurations: int = 5,
    repeats: int = 15,
    seconds: float = 2.0,
    rng: int | np.random.Generator | None = 0,
    progress: bool | Callable = False,
) -> QTable:
    """Measure the time and the errors of each method that finds collisions, for the same configurations of arms.

    Each positioner has one target, uniformly distributed in its patrol area. The result of each method is compared with
    the exact result of rational arithmetic. The measured time begins with known poses of the arms and ends with the
    list of colliding pairs; it excludes compilation. Each round runs every method once, in a random order, so that
    other work on the machine affects all methods in the same way. If ``repeats`` is small, the measured times are
    inaccurate.

    Parameters
    ----------
    instrument : str, Instrument or FocalPlane, optional
        An instrument, a focal plane, or the name of a preset.
    methods : sequence of str, optional
        Methods of `~rfpsurvey.find_collisions` and, for comparison, ``every_pair`` (distant pairs are not
        excluded first), ``endpoints`` (no test for crossings) and ``shapely`` (if it is installed). By default, all
        methods that can run on this machine.
    n_configurations : int, optional
        Number of configurations on which each method runs.
    repeats : int, optional
        Largest number of runs of each method on each configuration.
    seconds : float, optional
        Time limit (s) of each method. A method is not run again when its total time exceeds this limit.
    rng : int, Generator or None, optional
        Seed or random number generator of the targets.
    progress : bool or callable, optional
        Show the progress on the standard error, or call a function with the number of finished rounds and the total
        number of rounds. Each round runs every method once on each configuration.

    Returns
    -------
    QTable
        Table with a row for each method and each value of ``n_points`` (see `~rfpsurvey.find_collisions`): ``method``,
        ``n_points``, ``device``, ``time`` (median time per configuration), ``ratio`` of this time to the time of
        ``exact``, ``n_colliding_true`` (true number of colliding pairs, the same for every method), ``n_missed`` (false
        negatives) and ``n_spurious`` (false positives), ``misclassified`` (``n_missed`` plus ``n_spurious``, divided by
        ``n_colliding_true``), ``max_error`` and ``mean_error`` of the distances of the colliding pairs that were found.
        The counts are sums over all configurations.

    Raises
    ------
    InputError
        If the arms have outlines, if a method is unknown or cannot run on this machine, or if a number is not positive.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> table = rs.benchmark.benchmark_collisions("sdss_apo", methods=["exact", "endpoints"], repeats=1)
    >>> table["method", "n_spurious"].pformat()[2:]
    ['    exact          0', 'endpoints          0']
    """
    plane = as_focal_plane(instrument)
    if plane.positioner.outline is not None:
        raise InputError(
            "the arms must be segments for this benchmark, because only the method 'exact' supports outlines, got the "
            "arm model 'outline'; use another arm model of the instrument (with_arm_model)"
        )
    names = _check_methods(methods)
    check_whole(n_configurations, "n_configurations")
    check_whole(repeats, "repeats")
    if not (isinstance(seconds, int | float) and seconds >= 0):
        raise InputError(f"seconds must be a number of at least 0, got {seconds!r}")
    rng = to_generator(rng)
    runs = [
        (DEFAULT_METHOD, 2),
        *((m, n) for m in names if m != DEFAULT_METHOD for n in COMPARED[m].numbers_of_points or (2,)),
    ]
    cases = [_case(plane, random_tips(plane, rng)) for _ in range(n_configurations)]
    results, times = _take_turns(runs, cases, repeats, seconds, rng, progress)
    truth = [_true_pairs(case) for case in cases]
    typical = {run: float(np.median(times[run])) for run in runs}
    rows = [
        {
            "method": m,
            "n_points": n if COMPARED[m].numbers_of_points else -1,
            "device": COMPARED[m].device,
            "time": 1e3 * typical[m, n] * u.ms,
            "ratio": typical[m, n] / typical[runs[0]],
            **_errors(truth, results[m, n]),
        }
        for m, n in runs
    ]
    table = QTable(rows)
    table["n_points"] = MaskedColumn(table["n_points"], mask=table["n_points"] < 0)
    table.meta.update(
        provenance(instrument, plane), n_configurations=n_configurations, repeats=repeats, seconds=seconds
    )
    return table[np.isin(table["method"], names)] if DEFAULT_METHOD not in names else table


def _take_turns(runs, cases, repeats, seconds, rng, progress):
    """Return the pairs that each method finds in each configuration, and the measured times of each method.

    Times of the first round, in which functions are compiled, are omitted unless the method is slow.
    """
    times: dict[tuple[str, int], list[float]] = {run: [] for run in runs}
    results_of_runs = {}
    turns = range(repeats + 1)
    with Progress(progress, len(turns), "rounds") as bar:
        for turn in turns:
            for run in (runs[k] for k in rng.permutation(len(runs))):
                if sum(times[run]) > seconds:
                    continue
                results = []
                for case in (replace(case, n_points=run[1]) for case in cases):
                    start = perf_counter()
                    results.append(COMPARED[run[0]].function(case))
                    times[run].append(perf_counter() - start)
                if turn == 0:
                    results_of_runs[run] = results
                    # keep the time of the last call of a slow method, because the time limit may not allow another call
                    times[run] = times[run][-1:] if times[run][-1] > seconds / 4 else []
            bar(turn + 1)
    return results_of_runs, times


def _true_pairs(case):
    """Return all colliding pairs of arms and their distances, computed in rational arithmetic."""
    separation = case.plane.arrays.separation
    there = np.flatnonzero(np.isfinite(case.segments[0]))
    ends = case.segments[:, there]
    # the midpoints of two colliding arms are at most the length of an arm plus the minimum separation apart
    longest = np.hypot(*(ends[2:] - ends[:2])).max(initial=0.0)
    tree = cKDTree(0.5 * (ends[:2] + ends[2:]).T)
    pairs = np.sort(there[tree.query_pairs(longest + 1.001 * separation, output_type="ndarray")], axis=1).tolist()
    rows = case.segments.T.tolist()
    return {
        (i, j): distance_exactly(rows[i], rows[j]) for i, j in pairs if closer_exactly(rows[i], rows[j], separation)
    }


def _errors(truth, results):
    """Return the numbers of missed and spurious pairs, and the errors of the distances of the pairs that were found."""
    n = missed = spurious = 0
    errors = []
    for true, got in zip(truth, results, strict=True):
        keys = zip(got.first.tolist(), got.second.tolist(), strict=True)
        distances = dict(zip(keys, got.distances.tolist(), strict=True))
        correct = true.keys() & distances.keys()
        n, missed, spurious = n + len(true), missed + len(true) - len(correct), spurious + len(distances) - len(correct)
        errors += [abs(distances[k] - true[k]) for k in correct]
    return {
        "n_colliding_true": n,
        "n_missed": missed,
        "n_spurious": spurious,
        "misclassified": (missed + spurious) / n if n else np.nan,
        "max_error": max(errors, default=np.nan) * u.mm,
        "mean_error": (float(np.mean(errors)) if errors else np.nan) * u.mm,
    }


def _case(plane, tips) -> Configuration:
    """Return the configuration in which the arms have the given tips."""
    posed = place_arms(plane, tips * u.mm)
    return Configuration(plane, np.ascontiguousarray(posed.segments.T), 2, lambda: posed)


def _check_methods(methods):
    """Return the given names, or by default the names of all methods that can run on this machine."""
    if isinstance(methods, str):
        raise InputError(f"methods must be a list of names, got {methods!r}")
    gone = {"shapely"} if find_spec("shapely") is None else set()
    if methods is None:
        return [m for m, method in COMPARED.items() if m not in gone and (method.device == "CPU" or has_gpu())]
    names = list(dict.fromkeys(check_choice(m, COMPARED, "method") for m in methods))
    if gone & set(names):
        raise InputError("the method 'shapely' needs the package shapely, which is not installed")
    return names


def benchmark_batches(
    instrument: str | Instrument | FocalPlane = "lamost",
    *,
    sizes: Sequence[int] = (1, 100, 10_000),
    workers: Sequence[int] = (1, 2),
    repeats: int = 5,
    rng: int | np.random.Generator | None = 0,
) -> QTable:
    """Measure the time of counting the collisions of many configurations in one call, on CPU threads and on a GPU.

    Parameters
    ----------
    instrument : str, Instrument or FocalPlane, optional
        An instrument, a focal plane, or the name of a preset.
    sizes : sequence of int, optional
        Numbers of configurations whose collisions are counted in one call. At most 256 different configurations are
        made; larger batches repeat these configurations. The positions of all tips are kept in memory, for example
        640 MB for 10,000 configurations of 4000 positioners.
    workers : sequence of int, optional
        Numbers of threads.
    repeats : int, optional
        Number of calls with the same settings. The table contains the median time of these calls.
    rng : int, Generator or None, optional
        Seed or random number generator for the targets, which are uniformly distributed in the patrol areas.

    Returns
    -------
    QTable
        Table with a row for each combination of device, number of workers and size. ``time`` is the median time of a
        call, and ``rate`` is the number of configurations per second.

    Raises
    ------
    InputError
        If ``sizes`` or ``workers`` is not a list of positive integers, or if ``repeats`` is not positive.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> table = rs.benchmark.benchmark_batches("sdss_apo", sizes=[1, 10], workers=[1], repeats=1)
    >>> table["device", "size"].pformat()[2:]
    ['   CPU    1', '   CPU   10']
    """
    plane = as_focal_plane(instrument)
    for name, values in (("sizes", sizes), ("workers", workers)):
        if not isinstance(values, Sequence) or len(values) == 0:
            raise InputError(f"{name} must be a list of whole numbers, got {values!r}")
        for k, n in enumerate(values):
            check_whole(n, f"{name}[{k}]")
    check_whole(repeats, "repeats")
    rng = to_generator(rng)
    some = np.array([random_tips(plane, rng) for _ in range(min(256, max(sizes)))])
    ways = [("CPU", n) for n in workers] + [("GPU", 1)] * has_gpu()
    rows = []
    for size in sizes:
        tips = np.resize(some, (size, *some.shape[1:])) << u.mm
        times: dict[tuple[str, int], list[float]] = {way: [] for way in ways}
        for turn in range(repeats + 1):  # the first call compiles the kernels
            for way in ways:
                spent = _batch_seconds(plane, tips, *way)
                times[way] += [spent] if turn else []
        rows += [(*way, size, np.median(t), size / np.median(t)) for way, t in times.items()]
    table = QTable(rows=rows, names=("device", "workers", "size", "time", "rate"))
    table["time"], table["rate"] = 1e3 * table["time"] * u.ms, table["rate"] / u.s
    table.meta.update(provenance(instrument, plane), repeats=repeats)
    return table


def _batch_seconds(plane, tips, device, workers):
    method = "cuda" if device == "GPU" else "exact"
    start = perf_counter()
    if workers == 1:
        count_collisions(plane, tips, method=method)
    else:
        with released(ThreadPoolExecutor(workers)) as executor:
            count_collisions(plane, tips, method=method, executor=executor)
    return perf_counter() - start
