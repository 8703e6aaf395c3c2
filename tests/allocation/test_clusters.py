"""Plans and bounds of large problems, on small scenes whose optimum is known."""

import os
import signal
from contextlib import contextmanager
from threading import Timer
from time import perf_counter, sleep

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs

MM = u.mm


def scene(seed):
    """Return a focal plane, targets and priorities; some scenes have several classes and both elbows."""
    rng = np.random.default_rng(seed)
    arms, elbow = rng.uniform(4, 14, 2) * MM, "both" if seed % 3 == 0 else "right"
    unit = rs.Positioner(*arms, rng.uniform(1, 4) * MM, handedness=elbow)
    plane = rs.FocalPlane.hexagonal(unit, rings=3, pitch=rng.uniform(12, 20) * MM)
    n = int(len(plane) * rng.choice([0.5, 1, 2]))
    xy, priority = rng.uniform(-60, 60, (n, 2)) * MM, None if seed % 2 else rng.integers(0, 3, n)
    return plane, xy, priority


def allocate(plane, xy, priority, **options):
    return rs.allocate(plane, xy, priority=priority, allocator=rs.AllocationOptions("optimal", **options), rng=1)


@pytest.fixture
def clusters(monkeypatch):
    """Divide all problems into clusters of a few positioners, and return a function that sets further constants."""
    monkeypatch.setattr("rfpsurvey._assignment.search.LARGEST", 0)
    monkeypatch.setattr("rfpsurvey._assignment.clusters.LARGEST", 40)
    monkeypatch.setattr("rfpsurvey._assignment.clusters.SIZE", 40)
    return monkeypatch.setattr


@pytest.mark.parametrize("seeds", [range(30), pytest.param(range(30, 60), marks=pytest.mark.exhaustive)])
def test_bounds_of_clusters_are_never_below_the_optimum(clusters, monkeypatch, seeds):
    n_proven = 0
    for seed in seeds:
        found = allocate(*scene(seed), objective="count" if seed % 4 == 0 else "priority")
        with monkeypatch.context() as usual:
            usual.setattr("rfpsurvey._assignment.search.LARGEST", 10**9)
            best = allocate(*scene(seed), objective="count" if seed % 4 == 0 else "priority")
        assert best.gap == 0
        assert len(rs.find_collisions(scene(seed)[0], found).pairs) <= len(
            rs.find_collisions(scene(seed)[0], best).pairs
        )
        for ours, level in zip(found.levels, best.levels, strict=True):
            assert ours.value <= level.value <= ours.bound, seed
            if ours.value < level.value:
                break  # later levels depend on the values of this level
            n_proven += ours.bound == ours.value
    assert n_proven > 1.2 * len(seeds)


def test_bounds_from_prices_alone_are_valid(clusters, monkeypatch):
    """The solver finds nothing in time; the bounds then follow from prices that stop at any time."""
    for seed in range(12):
        best = allocate(*scene(seed))
        with monkeypatch.context() as late:
            for module in ("milp", "solver"):
                late.setattr(f"rfpsurvey._assignment.{module}.maximize", lambda *_, **__: (None, np.inf))
            found = allocate(*scene(seed))
        assert found.levels[0].value <= best.levels[0].bound
        assert found.levels[0].bound >= best.levels[0].value
        assert found.bound <= len(scene(seed)[0])


def large():
    """Return a focal plane and targets for which the search takes many seconds."""
    unit = rs.Positioner(7.4 * MM, 15 * MM, 2.5391 * MM)
    plane = rs.FocalPlane.hexagonal(unit, rings=57, pitch=22.4 * MM)
    rng, n = np.random.default_rng(0), len(plane)
    r, angle = 57.5 * 22.4 * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    xy = np.column_stack([r * np.cos(angle), r * np.sin(angle)]) * MM
    allocate(plane, xy[:500], None, time_limit=1 * u.s)  # compiles
    return plane, xy


@contextmanager
def interrupt_after(seconds):
    """Send the signal of Ctrl-C to this process after some seconds."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # other tests may have set another one
    timer = Timer(seconds, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        signal.signal(signal.SIGINT, before)


def test_an_interrupt_stops_python():
    scene, begin = large(), perf_counter()
    with pytest.raises(KeyboardInterrupt), interrupt_after(2):
        allocate(*scene, None, time_limit=100 * u.s)
    assert perf_counter() - begin < 2 + 5  # 1 s on an idle machine


def test_the_command_line_continues_with_the_best_plan_after_an_interrupt():
    plane, xy = large()
    begin = perf_counter()
    with interrupt_after(3), rs.allocation.end_on_interrupt() as interrupted:
        found = allocate(plane, xy, None, time_limit=100 * u.s)
        assert interrupted.is_set()
    assert perf_counter() - begin < 3 + 8
    assert found.gap > 0
    assert len(rs.find_collisions(plane, found).pairs) == 0
    with pytest.raises(KeyboardInterrupt), rs.allocation.end_on_interrupt(), interrupt_after(0.1):
        sleep(5)  # no search


@pytest.mark.exhaustive
def test_a_large_problem_ends_at_the_time_limit():
    plane, xy = large()
    begin = perf_counter()
    rs.allocate(plane, xy, allocator="repair")
    moves = perf_counter() - begin  # 3 s, and longer on a busy machine
    begin, found = perf_counter(), allocate(plane, xy, None, time_limit=4 * moves * u.s)
    assert perf_counter() - begin < 4 * moves + 6  # the limit, the time to find the pairs in reach, and a busy machine
    assert 0 <= found.gap < 0.1  # without prices, the gap is 0.13
    assert len(rs.find_collisions(plane, found).pairs) == 0
