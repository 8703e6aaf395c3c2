"""Local moves remove the collisions of any plan, and lose at most the stated number of targets."""

from dataclasses import replace
from itertools import product

import astropy.units as u
import numpy as np
import pytest
from raising import refused

import flat
import rfpsurvey as rs
from rfpsurvey._assignment import local_search as _local_search
from rfpsurvey._assignment import methods as _methods
from rfpsurvey.allocation import METHODS
from scenes import SCENES, lamost_like, sdss_like

MM = u.mm
STARTS = sorted(name for name, one in METHODS.items() if not one.improves)
NAMES = sorted(set(SCENES) - {"left"})  # the handedness of a whole plan is not an option of allocations


def scene(name, n=110, seed=3):
    """Return a plane of the scenes, crowded targets in two classes, and options."""
    rng = np.random.default_rng(seed)
    plane, given = SCENES[name]
    options = {"priority": rng.integers(0, 2, n), "parked_obstacles": given.get("parked_obstacles", True)}
    if plane.fiber_types != ("",):
        options["fiber_type"] = rng.choice(["", *plane.fiber_types], n)
    return plane, rng.uniform(-85, 85, (n, 2)) * MM, options


def at_fault(plane, found):
    """Return the colliding pairs in which at least one arm has a target, and collisions of such arms with obstacles."""
    report, busy = rs.find_collisions(plane, found), found.target_of_positioner >= 0
    return [tuple(p) for p in report.pairs if busy[p].any()] + [tuple(p) for p in report.obstacle_pairs if busy[p[0]]]


def ladder(found, priority):
    """Return the numbers of targets in the first class, in the first two classes, and so on."""
    used = found.target_of_positioner[found.target_of_positioner >= 0]
    return [int((priority[used] >= p).sum()) for p in sorted(set(priority.tolist()), reverse=True)]


@pytest.mark.few(20)
@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("name", NAMES)
def test_no_arm_collides_whatever_the_start(name, start):
    """The plan of each start is also given as an allocation; without collisions, it does not become worse."""
    plane, xy, options = scene(name)

    def repaired(start, **moves):
        return flat.allocate(plane, xy, allocator="repair", start=start, **moves, **options)

    def counts(plan):
        return ladder(plan, options["priority"])

    found, before = repaired(start), flat.allocate(plane, xy, allocator=start, **options)
    assert at_fault(plane, found) == []
    assert found.meta["n_before"] == before.n_assigned
    if plane.obstacles is None:
        assert found.n_assigned >= before.n_assigned - found.meta["n_dropped"]
        assert counts(found)[0] >= counts(before)[0] - found.meta["n_dropped"]
    best = flat.allocate(plane, xy, allocator="optimal", **options)
    assert counts(found) <= counts(best)
    assert counts(found)[0] >= 0.8 * counts(best)[0]
    assert at_fault(plane, repaired(before)) == []
    if start == "optimal":  # its plan also depends on the moves
        for method in ("optimal", "repair"):
            given = flat.allocate(plane, xy, allocator=method, **options)
            again = repaired(given)
            assert at_fault(plane, again) == []
            assert counts(again) == counts(given) if method == "optimal" else counts(again) >= counts(given)
            assert method == "repair" or again.meta["n_dropped"] == again.meta["n_moved"] == 0
        return
    named, given = (repaired(one, moves="exchange") for one in (start, before))
    np.testing.assert_array_equal(given.target_of_positioner, named.target_of_positioner)
    np.testing.assert_array_equal(given.handedness, named.handedness)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("equal", [True, False])
def test_there_is_something_to_repair(equal, seed):
    plane = sdss_like(rings=5)
    if equal:
        plane = rs.FocalPlane.hexagonal(lamost_like().positioner, rings=5, pitch=18 * MM)
    xy = np.random.default_rng(seed).uniform(-130, 130, (500, 2)) * MM
    start = rs.allocate(plane, xy, allocator="balanced")
    assert len(at_fault(plane, start)) > 3
    found = rs.allocate(plane, xy, allocator=rs.AllocationOptions("repair", start=start))
    assert at_fault(plane, found) == []
    assert found.meta["n_moved"] + found.meta["n_dropped"] >= 2
    best = rs.allocate(plane, xy, allocator="optimal").n_assigned
    assert start.n_assigned - found.meta["n_dropped"] <= found.n_assigned <= best
    assert found.n_assigned >= 0.95 * best


@pytest.mark.parametrize("parked", [True, False])
def test_parked_arms_are_in_the_way_if_they_count(parked):
    """An idle arm along +x covers the target of its neighbor, which can be observed only without parked arms."""
    plane = rs.FocalPlane([[0, 0], [20, 0]] * MM, rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM))
    alone = flat.allocate(plane, [[16, 1]] * MM, "repair", parked_obstacles=parked, forbidden=[[1, 0]])
    stands = rs.find_collisions(plane, [[16, 1], [np.nan, np.nan]] * MM, parked_obstacles=parked)
    assert alone.n_assigned == (len(stands.pairs) == 0) == (not parked)


@pytest.mark.parametrize("method", ["repair", "optimal"])
def test_the_other_elbow_saves_both_targets(method):
    """Only one of the four combinations of elbows has no collision."""
    unit = {"central_arm": 8 * MM, "eccentric_arm": 8 * MM, "clearance": 2.25 * MM}
    centers, xy, apart = [[0, 0], [18, 0]] * MM, [[10, 6], [7, -3]] * MM, [[0, 1], [1, 0]]
    plane = rs.FocalPlane(centers, rs.Positioner(**unit, handedness="both"))
    elbows = [
        hands
        for hands in product(["right", "left"], repeat=2)
        if len(rs.find_collisions(plane, xy, handedness=np.array(hands)).pairs) == 0
    ]
    assert elbows == [("left", "left")]
    found = rs.allocate(plane, xy, allocator=method, forbidden=apart)
    assert (found.target_of_positioner.tolist(), found.handedness.tolist()) == ([0, 1], ["left", "left"])
    assert at_fault(plane, found) == []
    right = rs.FocalPlane(centers, rs.Positioner(**unit))
    assert rs.allocate(right, xy, allocator=method, forbidden=apart).n_assigned <= 1
    again = rs.allocate(plane, xy, allocator=rs.AllocationOptions("repair", start=found), forbidden=apart)
    assert (again.handedness.tolist(), again.meta["n_moved"]) == (["left", "left"], 0)


@pytest.mark.parametrize("start", ["network_flow", "optimal"])
@pytest.mark.parametrize("seed", range(2))
def test_maxima_that_the_start_keeps_are_kept(seed, start):
    plane, xy, options = scene("unequal arms", seed=seed)
    kind = np.random.default_rng(seed).choice(["science", "standard", "sky"], 110)
    options |= {"kind": kind, "requirements": ["sky=-6", "standard=-9", "science=-12"]}
    found = flat.allocate(plane, xy, allocator="repair", start=start, **options)
    used = found.target_of_positioner[found.target_of_positioner >= 0]
    counts = [(kind[used] == one).sum() for one in ("sky", "standard", "science")]
    assert (np.array(counts) <= [6, 9, 12]).all()
    assert sum(counts) > 20
    assert at_fault(plane, found) == []


def test_the_least_important_target_gives_way():
    unit = rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM)
    plane = rs.FocalPlane([[0, 0], [25.6, 0]] * MM, unit)
    for priority in ([2, 1], [1, 2]):
        found = rs.allocate(plane, [[12, 0], [14, 0]] * MM, allocator="repair", priority=priority)
        assert (found.n_assigned, priority[found.target_of_positioner.max()]) == (1, 2)
        assert (found.meta["n_before"], found.meta["n_dropped"]) == (2, 1)
        assert [level.value for level in found.levels] == [1, 0]
    found = rs.allocate(plane, [[12, 0], [14, 0], [37.6, 5]] * MM, allocator="repair")
    assert (sorted(found.target_of_positioner)[1], found.meta["n_dropped"]) == (2, 0)
    plane = rs.FocalPlane([[0, 0]] * MM, unit, obstacles=[[12, 0, 1]] * MM)  # the only target touches an obstacle
    found = rs.allocate(plane, [[12, 0]] * MM, allocator="repair")
    assert (found.n_assigned, found.meta["n_before"], found.meta["n_dropped"]) == (0, 1, 1)


def test_a_start_with_found_sky_may_be_repaired():
    plane, xy, options = scene("equal arms")
    options |= {"requirements": "sky=6", "sky_separation": 2 * MM}
    start = flat.allocate(plane, xy, allocator="lamost_rule", **options)
    found = flat.allocate(plane, xy, allocator="repair", start=start, **options)
    assert found.unmet == start.unmet == ()
    assert at_fault(plane, found) == []
    assert (found.target_of_positioner >= found.n_given).sum() >= 6


def test_a_start_that_does_not_fit_is_an_error():
    plane, xy, _ = scene("equal arms")
    start = rs.allocate(plane, xy, allocator="lamost_rule")
    fewer, moved = rs.FocalPlane(plane.xy[:-1], plane.positioner), rs.FocalPlane(plane.xy + 300 * MM, plane.positioner)
    fits = "start must be an allocation of the same targets to the same focal plane"
    for onto, targets in (
        *((other, xy) for other in (fewer, moved)),
        *((plane, other) for other in (xy + 1 * MM, xy[::-1], xy[:-1], np.concatenate([xy, xy]))),
    ):
        refused(fits, flat.allocate, onto, targets, "repair", start=start)
    for name in ("best", "repair", ""):
        text = f"unknown allocator to start with {name!r}; choose one of: balanced,"
        refused(text, flat.allocate, plane, xy, "repair", start=name)
    for value in (5, None, start.target_of_positioner.tolist()):
        text = "start must be an Allocation, a Tile or the name of an allocator, got "
        refused(text, flat.allocate, plane, xy, "repair", start=value)


def test_a_start_within_the_margins_of_broken_arms_is_an_error():
    """The patrol areas of both planes are the same, but one of them forbids poses close to broken positioners."""
    plane, xy, _ = scene("equal arms")
    plane = replace(plane, disabled=np.arange(len(plane)) % 3 == 0)
    start = rs.allocate(plane, xy, allocator="lamost_rule")
    margined = replace(plane, margins=rs.Margins(broken=9 * MM))
    same = replace(start, in_reach=rs.allocate(margined, xy, allocator="lamost_rule").in_reach)
    with pytest.raises(rs.InputError, match="the same focal plane"):
        rs.allocate(margined, xy, allocator=rs.AllocationOptions("repair", start=same))
    own = rs.allocate(margined, xy, allocator="lamost_rule")
    found = rs.allocate(margined, xy, allocator=rs.AllocationOptions("repair", start=own))
    assert (found.target_of_positioner >= 0).any()


@pytest.mark.few(12)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("n", [30, 110, 600])
def test_the_plan_is_the_same_as_if_all_collisions_of_candidates_were_known(name, n, monkeypatch):
    """Collisions are found only for arms that can move, and for arms that these arms can move."""

    def with_all_collisions(everything, chosen, **_):
        everything = everything.with_collisions()
        return everything, _local_search.repair_collisions(everything, chosen)

    for seed in range(2):
        plane, xy, options = scene(name, n, seed)
        found = flat.allocate(plane, xy, allocator="repair", moves="exchange", **options)
        with monkeypatch.context() as patch:
            patch.setattr(_methods, "repair_nearby", with_all_collisions)
            expected = flat.allocate(plane, xy, allocator="repair", moves="exchange", **options)
        np.testing.assert_array_equal(found.target_of_positioner, expected.target_of_positioner)
        np.testing.assert_array_equal(found.handedness, expected.handedness)
        assert (found.meta, found.levels) == (expected.meta, expected.levels)
