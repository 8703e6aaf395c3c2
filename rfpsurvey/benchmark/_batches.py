"""Benchmark that measures the time of counting the collisions of many configurations in one call."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._executors import released
from rfpsurvey._units import to_generator
from rfpsurvey.benchmark._common import has_gpu, provenance, random_tips
from rfpsurvey.collision import count_collisions
from rfpsurvey.errors import InputError, check_whole
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.instrument import Instrument, as_focal_plane


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
