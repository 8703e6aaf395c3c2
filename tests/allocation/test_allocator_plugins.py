"""Allocators of other packages: their input, and their valid results."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from raising import refused

import flat
import rfpsurvey as rs
from packages import CENTER, FOUR, PAIR, ROBOT, always, same, sky_of


def test_an_allocator_is_told_everything():
    seen = []
    plane = rs.FocalPlane([[0, 0], [25.6, 0], [51.2, 0]] * u.mm, ROBOT, fiber_type=["A", "B", "A+B"])
    xy = [[-10, 0], [13, 0], [30, 0], [39, 0], [99, 0]] * u.mm
    columns = {
        "priority": [5, 1, 7, 5, 9],
        "kind": ["science", "science", "sky", "science", "standard"],
        "category": ["", "x", "", "", "x"],
        "fiber_type": ["", "A", "", "B", ""],
    }
    others = {"required": [3], "requirements": ["sky=1", "x=1"], "forbidden": [[1, 2]], "objective": "count"}
    others |= {"time_limit": 0.1 * u.min, "parked_obstacles": False, "rng": 8}

    def look(problem):
        seen.append(problem)
        return np.full(3, -1)

    nothing = flat.allocate(plane, xy, allocator=look, **columns, **others)
    assert nothing.n_assigned == 0
    assert str(nothing.unmet[0]) == "sky targets: 0 of 1, 1 missing; none is in reach"
    (problem,) = seen
    assert problem.focal_plane is plane
    np.testing.assert_array_equal(problem.xy, xy.value)
    # target 1 requires fiber type A, target 3 requires B, and the pair (1, 2) is forbidden
    assert problem.reachable.toarray().tolist() == [[1, 1, 0, 0, 0], [0, 0, 0, 1, 0], [0, 0, 0, 1, 0]]
    assert problem.rank.tolist() == [0, 1, 2, 0, 2]
    np.testing.assert_array_equal(problem.priority, [5, 1, np.nan, 5, np.nan])
    for name in ("kind", "category", "fiber_type"):
        assert getattr(problem, name).tolist() == columns[name]
    assert problem.is_required.tolist() == [False, False, False, True, False]
    assert problem.requirements == (rs.Requirement("sky", 1), rs.Requirement("x", 1))
    assert (problem.objective, problem.time_limit, problem.parked_obstacles) == ("count", 6.0, False)
    assert problem.rng.random() == np.random.default_rng(8).random()
    pairs, matrix = problem.pairs, problem.reachable
    names = ("xy", "rank", "priority", "kind", "category", "fiber_type", "is_required")
    arrays = [pairs.indptr, pairs.owner, pairs.r2, pairs.target, *pairs.by_positioner]
    arrays += [matrix.data, matrix.indices, matrix.indptr, *(getattr(problem, name) for name in names)]
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    assert matrix.tocsc().nnz == matrix[[0, 1]].nnz + matrix[[2]].nnz == len(pairs.owner)


def test_what_is_not_said_has_a_value():
    seen = []
    rs.allocate(PAIR, FOUR, allocator=lambda problem: seen.append(problem) or np.array([0, 2]))
    (problem,) = seen
    assert problem.kind.tolist() == ["science"] * 4
    assert problem.category.tolist() == problem.fiber_type.tolist() == [""] * 4
    assert problem.rank.tolist() == problem.priority.tolist() == problem.is_required.tolist() == [0] * 4
    assert problem.reachable.toarray().tolist() == [[1, 1, 0, 0], [0, 1, 1, 0]]


def test_the_plan_to_begin_with(small, hers, rng):
    xy, plane = rng.uniform(-70, 70, (200, 2)) * u.mm, small.focal_plane
    for start in ("lamost_rule", "nearest", rs.allocate(plane, xy, allocator="optimal")):
        usual = start if isinstance(start, rs.allocation.Allocation) else rs.allocate(plane, xy, allocator=start)
        same(rs.allocate(plane, xy, allocator=rs.AllocationOptions("begin", start=start)), usual)
    with pytest.raises(rs.InputError, match="the option start must be given for an allocator"):
        rs.allocate(plane, xy, allocator=rs.AllocationOptions("begin", start="begin"))
    with pytest.raises(rs.InputError, match="unknown allocator to start with 'repair'"):
        rs.allocate(plane, xy, allocator=rs.AllocationOptions("begin", start="repair"))


def test_a_plan_of_others_can_be_repaired(hers):
    """Both arms point in the same direction, and the distance of their tips is 2 mm."""
    xy = [[99, 99], [13, 0], [15, 0]] * u.mm
    assert len(rs.find_collisions(PAIR, rs.allocate(PAIR, xy, allocator="swapped")).pairs) == 1
    repaired = rs.allocate(PAIR, xy, allocator=rs.AllocationOptions("repair", start="swapped", moves="exchange"))
    assert len(rs.find_collisions(PAIR, repaired).pairs) == 0
    assert repaired.meta["n_before"] == 2


def test_stuck_fibers_look_at_sky_without_being_asked():
    plane = replace(PAIR, stuck=[[np.nan, np.nan], [0, 90]] * u.deg)
    options = {"requirements": "sky=1", "sky_separation": 1 * u.mm}
    usual = flat.allocate(plane, FOUR, allocator="lamost_rule", **options)
    assert usual.target_of_positioner[1] == usual.n_given  # the target of the stuck positioner
    for method in (always([0, -1]), lambda problem: problem.start()):
        mine = flat.allocate(plane, FOUR, allocator=method, **options)
        assert mine.target_of_positioner[1] == usual.target_of_positioner[1]
        assert not mine.unmet


# valid and invalid results


def test_elbows_are_those_that_were_asked_for():
    plane = replace(PAIR, positioner=replace(ROBOT, handedness="both"))
    mine = rs.allocate(plane, FOUR, allocator=always(([0, 2], np.array(["left", "right"]))))
    assert mine.handedness.tolist() == ["left", "right"]
    (x, y), (tip_x, tip_y) = ((part - plane.xy.value).T for part in (mine.place_arms(plane).elbow, mine.tips.value))
    # the left elbow is to the left of the line from the center to the tip
    assert np.sign(tip_x * y - tip_y * x).tolist() == [1, -1]
    assert rs.allocate(PAIR, FOUR, allocator=always(([0, -1], ["right", ""]))).n_assigned == 1


LIMITED = replace(PAIR, positioner=replace(ROBOT, handedness="both", phi_range=[0, 180] * u.deg))


ROW = "must return the row of the target"
OUT = r"\(row\) cannot observe target"
ELBOWS = "elbows must be 'right' or 'left'"
REFUSED = [
    (PAIR, None, r"whole numbers of the shape \(2,\).* got NoneType of the shape \(\)"),
    (PAIR, [0, 2, -1], r"got list of the shape \(3,\)"),
    (PAIR, np.array([[0, 2]]), r"got ndarray of the shape \(1, 2\)"),
    *((PAIR, np.array(answer), ROW) for answer in ([0.0, 2.0], [True, False])),
    *((PAIR, answer, ROW) for answer in (["0", "2"], [[0], [1, 2]], ([0, 2], None, 3))),
    (PAIR, np.ma.array([0, 2], mask=[False, True]), ROW),
    (PAIR, [0, 4], "targets must be rows from 0 to 3, or -1 for no target, got 4"),
    (PAIR, np.array([0, 2**64 - 1], dtype=np.uint64), "got 18446744073709551615"),
    (PAIR, [-2, 0], "got -2"),
    (PAIR, [1, 1], r"target 1 must have at most one positioner, got the positioners 0 and 1 \(rows\)"),
    (PAIR, [0, 3], f"positioner 1 {OUT} 3: the target is out of reach, is forbidden"),
    (PAIR, [2, 1], f"positioner 0 {OUT} 2: the target is out of reach"),
    (replace(PAIR, disabled=[True, False]), [0, 1], f"positioner 0 {OUT} 0: the positioner is disabled or stuck"),
    (PAIR, ([0, 2], ["right"]), rf"{ELBOWS} .* shape \(2,\), got \['right'\]"),
    *((PAIR, ([0, 2], elbows), ELBOWS) for elbows in (["right", "up"], [1, -1], [["right"], []])),
    *(
        (plane, ([0, 2], ["right", "left"]), r"positioner 1 \(row\) cannot have the elbow 'left'")
        for plane in (PAIR, LIMITED)
    ),
]


@pytest.mark.parametrize(("plane", "answer", "words"), REFUSED)
def test_what_no_plan_can_be_is_refused(plane, answer, words):
    text = refused(words, rs.allocate, plane, FOUR, allocator=always(answer))
    assert text.startswith("the allocator 'packages.always.<locals>.<lambda>': ")


def test_forbidden_pairs_stay_forbidden():
    assert rs.allocate(PAIR, FOUR, allocator=always([0, 1])).n_assigned == 2
    words = "positioner 1 .* cannot observe target 1: the target is out of reach, is forbidden"
    refused(words, rs.allocate, PAIR, FOUR, allocator=always([0, 1]), forbidden=[[1, 1]])


def test_errors_say_whose_they_are(hers):
    words = r"^the allocator 'wrong' of hers 1.0 \(hers:wrong\): target 3 must have at most one"
    refused(words, rs.allocate, PAIR, FOUR, allocator="wrong")
    with np.errstate(all="raise"), pytest.raises(rs.InputError, match=">' failed: FloatingPointError: ") as caught:
        rs.allocate(PAIR, FOUR, allocator=lambda problem: problem.xy / 0)
    assert isinstance(caught.value.__cause__, FloatingPointError)


# allocators given by name


def test_a_tile_says_where_its_allocator_comes_from(small, hers):
    sky = sky_of(small)
    usual, tile = (rs.plan_tile(sky, small, CENTER, allocator=name) for name in ("lamost_rule", "begin"))
    np.testing.assert_array_equal(tile.table["target_id"], usual.table["target_id"])
    assert "hers" not in usual.provenance["software"]
    assert tile.provenance["software"] == {**usual.provenance["software"], "hers": "1.0"}
    assert tile.provenance["parameters"]["allocator"] == "begin"
    assert tile.summary["search"] == {"software": {"hers": "1.0"}}
    repaired = rs.plan_tile(sky, small, CENTER, allocator=rs.AllocationOptions("repair", start="idle"))
    assert repaired.provenance["software"]["hers"] == "1.0"


def test_a_function_is_recorded_by_its_name(small, tmp_path):
    class Ünsere:
        def __call__(self, problem):
            return problem.start()

    tile = rs.plan_tile(sky_of(small), small, CENTER, allocator=Ünsere())
    name = tile.provenance["parameters"]["allocator"]
    assert name == f"{__name__}.test_a_function_is_recorded_by_its_name.<locals>.\\xdcnsere"
    tile.write(tmp_path / "tile.fits")
    assert rs.Tile.read(tmp_path / "tile.fits") == tile
