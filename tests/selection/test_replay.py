"""Realizations, compared bit for bit with surveys that have the same subpriorities."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs

CENTER = SkyCoord(180 * u.deg, 20 * u.deg)
# the last two realizations are in the second block
N, SOME = 34, (0, 31, 33)


def tiles_of(step, n=3, passes=2):
    """Return overlapping tiles around the center, in two passes with different position angles."""
    lon, lat = (a.ravel() * step for a in np.meshgrid(np.arange(n) - (n - 1) / 2, [0.0] if n < 4 else np.arange(5)))
    table = {"ra": [], "dec": [], "pass": [], "position_angle": []}
    for k in range(passes):
        centers = SkyCoord((lon + k * step / 3) * u.deg, lat * u.deg, frame=CENTER.skyoffset_frame()).icrs
        table["ra"] += centers.ra.deg.tolist()
        table["dec"] += centers.dec.deg.tolist()
        table["pass"] += [k] * len(lon)
        table["position_angle"] += [10.0 * k] * len(lon)
    angles = {name: values * u.deg for name, values in table.items() if name != "pass"}
    return rs.Tiling.from_table(QTable({**angles, "pass": table["pass"]}))


def sky_of(radius, n, *, text=False, kinds=False, fiber_types=(), seed=3):
    """Return targets with priorities and up to two visits; half of them are clustered."""
    options = {"cluster_size": 8, "cluster_scale": 0.02 * u.deg}
    parts = [
        rs.synthetic_catalog("uniform", CENTER, radius * u.deg, n_targets=n // 2, rng=seed),
        rs.synthetic_catalog("clustered", CENTER, radius * u.deg, n_targets=n // 2, rng=seed, **options),
    ]
    lon, lat = (np.concatenate([getattr(part.coord, name).deg for part in parts]) for name in ("ra", "dec"))
    rng = np.random.default_rng(seed)
    n = len(lon)
    return rs.Catalog(
        SkyCoord(lon * u.deg, lat * u.deg),
        id=[f"galaxy {k}" for k in range(n)] if text else 7 * np.arange(n) - 100,
        priority=rng.integers(1, 3, n),
        visits=rng.integers(0, 3, n),
        kind=rng.choice(["science", "standard"], n, p=[0.9, 0.1]) if kinds else None,
        fiber_type=rng.choice(fiber_types, n) if fiber_types else None,
    )


def check(found, sky, instrument, tiles, allocator, realizations, **options):
    """Compare realizations with surveys, target by target, and their counts."""
    assert found.n_realizations > max(realizations)
    for r in realizations:
        seed = int(found.realizations["seed"][r])
        asked = allocator if isinstance(allocator, rs.AllocationOptions) else rs.AllocationOptions(allocator)
        survey = rs.plan_survey(sky, instrument, tiles, allocator=replace(asked, subpriority=seed), rng=seed, **options)
        observed = np.asarray(survey.outcomes["observed"]) > 0
        np.testing.assert_array_equal(found.observed_in(r), observed, err_msg=f"realization {r}")
        row, s = found.realizations[r], survey.summary
        lost = sum(int((~np.asarray(visits["observed"])).sum()) for visits in survey)
        assert (row["n_assigned"], row["n_observed"], row["n_lost"]) == (s["n_assigned"], s["n_visits_observed"], lost)
    reached = np.asarray(survey.outcomes["outcome"])
    never = {k for k, name in enumerate(rs.Survey.OUTCOMES) if name in ("in no field", "out of reach")}
    np.testing.assert_array_equal(
        found.unreachable[found.requested > 0], np.isin(reached, list(never))[found.requested > 0]
    )


@pytest.mark.parametrize("allocator", ["nearest", "lamost", "balanced"])
@pytest.mark.parametrize("text", [False, True])
def test_rules_with_visits_and_priorities(small, allocator, text):
    sky, tiles = sky_of(1.2, 1500, text=text), tiles_of(0.5)
    found = rs.selection_probabilities(sky, small, tiles, N, allocator=allocator)
    assert found.realizations["n_lost"].min() > 0
    check(found, sky, small, tiles, allocator, SOME if text else SOME[:1])


@pytest.mark.filterwarnings("ignore:required targets never observed")
@pytest.mark.parametrize("allocator", ["nearest", "lamost"])
def test_fiber_types_kinds_required_targets_and_circles(allocator):
    sky, tiles = sky_of(1.4, 1600, kinds=True, fiber_types=("BOSS", "APOGEE", "")), tiles_of(0.9, 2)
    circles = [rs.Region.cap(where, 0.02 * u.deg) for where in sky.coord[:40]]
    options = rs.AllocationOptions(allocator, required=sky.id[::30], keep_out=circles)
    found = rs.selection_probabilities(sky, "sdss_apo", tiles, N, allocator=options, order="given")
    assert found.realizations["n_lost"].min() > 0
    check(found, sky, "sdss_apo", tiles, options, SOME[1:], order="given")


def test_observing_conditions_and_losses_that_count():
    sky = sky_of(1.0, 3000)
    conditions = rs.ObservingConditions("kitt peak", hour_angle=30 * u.deg)
    tiles = tiles_of(0.6, 2).with_conditions(conditions)
    found = rs.selection_probabilities(sky, "moons", tiles, N, lost_in_collision=False)
    assert found.realizations["n_lost"].max() == 0
    check(found, sky, "moons", tiles, "nearest", SOME[:1], lost_in_collision=False)


@pytest.mark.filterwarnings("ignore:.*requirement")
@pytest.mark.parametrize(
    "options",
    [
        rs.AllocationOptions("lamost", requirements=["standard=3"]),
        rs.AllocationOptions("repair"),
        rs.AllocationOptions("sdss"),
        pytest.param(rs.AllocationOptions("optimal"), marks=pytest.mark.exhaustive),
        pytest.param(
            rs.AllocationOptions("nearest", requirements=["sky=2"], sky_separation=20 * u.arcsec),
            marks=pytest.mark.exhaustive,
        ),
    ],
    ids=lambda options: f"{options.name}-{len(options.requirements)}",
)
def test_allocators_that_plan_one_realization_after_the_other(small, options):
    sky, tiles = sky_of(0.8, 400, kinds=True), tiles_of(0.5, 2)
    found = rs.selection_probabilities(sky, small, tiles, 3, allocator=options)
    check(found, sky, small, tiles, options, (0, 2))


def test_an_allocator_of_another_package(small):
    def first(problem):
        target_of = np.full(len(problem.focal_plane), -1)
        for own in range(len(target_of)):
            target_of[own] = next((t for t in problem.reachable[[own]].indices if t not in target_of), -1)
        return target_of

    sky, tiles = sky_of(0.6, 200), tiles_of(0.5, 2)
    found = rs.selection_probabilities(sky, small, tiles, 2, allocator=first)
    check(found, sky, small, tiles, first, (0, 1))


@pytest.mark.exhaustive
@pytest.mark.parametrize("allocator", ["nearest", "lamost", "balanced"])
@pytest.mark.parametrize(("instrument", "step", "n"), [("moons", 0.3, 20_000), ("desi", 1.4, 60_000)])
def test_twenty_realizations_of_fifty_tiles(allocator, instrument, step, n):
    tiles = tiles_of(step, 5)
    assert len(tiles) == 50
    sky = sky_of(4 * step, n)
    found = rs.selection_probabilities(sky, instrument, tiles, 64, allocator=allocator)
    assert found.summary["n_sometimes_observed"] > 1000
    check(found, sky, instrument, tiles, allocator, range(0, 60, 3))
