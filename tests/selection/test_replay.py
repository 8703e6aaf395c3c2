"""Realizations, compared bit for bit with surveys that have the same subpriorities."""

import astropy.units as u
import numpy as np
import pytest

import rfpsurvey as rs
from realizations import check, sky_of, tiles_of
from scenes import SCENES

# the last two realizations are in the second block
N, SOME = 34, (0, 31, 33)
# the scenes of the default tests
FEW, EXHAUSTIVE = ("troubles", "capsules", "both hands"), pytest.mark.exhaustive


@pytest.mark.few(2)
@pytest.mark.parametrize("allocator", ["nearest", "lamost_rule", "balanced"])
@pytest.mark.parametrize("text", [False, True])
def test_rules_with_visits_and_priorities(small, allocator, text):
    sky, tiles = sky_of(1.2, 1500, text=text), tiles_of(0.5)
    found = rs.selection_probabilities(sky, small, tiles, N, allocator=allocator)
    assert found.realizations["n_lost"].min() > 0
    check(found, sky, small, tiles, allocator, SOME if text else SOME[:1])


@pytest.mark.filterwarnings("ignore:required targets never observed", "ignore:constraint keep_out")
@pytest.mark.few(1)
@pytest.mark.parametrize("allocator", ["nearest", "lamost_rule"])
def test_fiber_types_kinds_required_targets_and_circles(allocator):
    sky, tiles = sky_of(1.4, 1600, kinds=True, fiber_types=("BOSS", "APOGEE", "")), tiles_of(0.9, 2)
    circles = [rs.Region.cap(where, 0.02 * u.deg) for where in sky.coord[:40]]
    options = rs.AllocationOptions(allocator, required=sky.id[::30], keep_out=circles)
    found = rs.selection_probabilities(sky, "sdss_apo", tiles, N, allocator=options, order="given")
    assert found.realizations["n_lost"].min() > 0
    check(found, sky, "sdss_apo", tiles, options, SOME[1:], order="given")


@pytest.mark.parametrize("allocator", ["nearest", "repair"])
def test_limits_of_magnitudes(small, allocator):
    """Regression: the columns of the catalog that rules on magnitudes use were lost."""
    sky, tiles = sky_of(0.8, 400), tiles_of(0.5, 2)
    sky = rs.Catalog(sky.coord, extra={"r": np.random.default_rng(1).uniform(12, 20, len(sky))})
    options = rs.AllocationOptions(allocator, constraints=["magnitude r 14 18"])
    found = rs.selection_probabilities(sky, small, tiles, 3, allocator=options)
    check(found, sky, small, tiles, options, (0, 2))
    assert found.n_observed[np.asarray(sky.extra["r"]) > 18].sum() == 0 < found.n_observed.sum()


def test_observing_conditions_and_losses_that_count():
    sky = sky_of(1.0, 3000)
    conditions = rs.ObservingConditions("kitt peak", hour_angle=30 * u.deg)
    tiles = tiles_of(0.6, 2).with_conditions(conditions)
    found = rs.selection_probabilities(sky, "moons", tiles, N, lost_in_collision=False, allocator="nearest")
    assert found.realizations["n_lost"].max() == 0
    check(found, sky, "moons", tiles, "nearest", SOME[:1], lost_in_collision=False)


@pytest.mark.filterwarnings("ignore:.*requirement")
def test_joint_plans(small):
    sky, tiles = sky_of(0.8, 400, kinds=True), tiles_of(0.5, 3)

    options = rs.JointOptions(iterations=2, allocator=rs.AllocationOptions("optimal", requirements=["standard=1"]))
    found = rs.selection_probabilities(sky, small, tiles, 4, allocator=options)
    check(found, sky, small, tiles, options, range(4))
    plain = rs.selection_probabilities(sky, small, tiles, 4, allocator=options.allocator)
    assert found.realizations["n_observed"].sum() > plain.realizations["n_observed"].sum()


def test_an_allocator_of_another_package(small):
    def first(problem):
        target_of = np.full(len(problem.focal_plane), -1)
        for own in range(len(target_of)):
            target_of[own] = next((t for t in problem.reachable[[own]].indices if t not in target_of), -1)
        return target_of

    sky, tiles = sky_of(0.6, 200), tiles_of(0.5, 2)
    found = rs.selection_probabilities(sky, small, tiles, 2, allocator=first)
    check(found, sky, small, tiles, first, (0, 1))


@pytest.mark.parametrize("scene", [one if one in FEW else pytest.param(one, marks=EXHAUSTIVE) for one in SCENES])
def test_arms_of_all_kinds(scene):
    """The segments of arms are computed for all pairs in reach, and not for the arms of one plan."""
    plane, others = SCENES[scene]
    types = [name for name in plane.fiber_types if name]
    instrument = rs.Instrument("scene", plane, plate_scale=150 * u.mm / u.deg)
    sky, tiles = sky_of(1.0, 500, fiber_types=[*types, ""] if types else ()), tiles_of(0.4, 2)
    options = rs.AllocationOptions("nearest", parked_obstacles=others.get("parked_obstacles", True))
    found = rs.selection_probabilities(sky, instrument, tiles, 3, allocator=options)
    assert found.realizations["n_lost"].min() > 0
    check(found, sky, instrument, tiles, options, (0, 2))


def test_outlines_of_arms():
    instrument = rs.Instrument.preset("desi").with_arm_model("outline")
    sky, tiles = sky_of(0.4, 3000), tiles_of(0.2, 2)
    found = rs.selection_probabilities(sky, instrument, tiles, 2, allocator="nearest")
    assert found.realizations["n_lost"].min() > 0
    check(found, sky, instrument, tiles, "nearest", (0, 1))


def test_catalogs_in_partitions(small, tmp_path):
    sky, tiles = sky_of(1.2, 1500), tiles_of(0.5)
    parts = rs.catalog.partition_catalog(sky, tmp_path / "sky", order=6)
    found = rs.selection_probabilities(parts, small, tiles, 3, executor=None)
    expected = rs.selection_probabilities(sky, small, tiles, 3)
    row_of = np.argsort(expected.target_id)[np.searchsorted(np.sort(expected.target_id), found.target_id)]
    for name in ("target_id", "requested", "n_tiles", "bits"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name)[row_of], err_msg=name)
    points = rs.selection.potential_assignments(parts, small, tiles).n_tiles()
    np.testing.assert_array_equal(points, found.n_tiles)
