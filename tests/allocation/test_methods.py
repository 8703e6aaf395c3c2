"""Rules that make allocations, compared with literal implementations of the same rules and with SciPy's matchings."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import linear_sum_assignment
from scipy.sparse.csgraph import maximum_bipartite_matching

import flat
import rfpsurvey as rs
from oracles import closest_pairs_first, lamost_target, squared_apart
from scenes import lamost_like, sdss_like, two_fibers

MM = u.mm
PLANES = {
    "equal": rs.FocalPlane.hexagonal(
        rs.Positioner(8.25 * MM, 8.25 * MM, 2 * MM), rings=1, pitch=25.6 * MM, spectrograph=[0, 0, 0, 4, 4, 4, 2]
    ),
    "unequal": rs.FocalPlane.hexagonal(
        rs.Positioner(7.4 * MM, 15 * MM, 2 * MM), rings=1, pitch=22.4 * MM, spectrograph=[1, 0, 1, 0, 1, 0, 1]
    ),
}
KINDS = ("science", "standard", "sky")


@st.composite
def scenes(draw, kinds=KINDS):
    """Targets with classes and kinds, at random positions or on a lattice, which has many ties in distance."""
    n = draw(st.integers(1, 24))
    lattice = arrays(float, (n, 2), elements=st.integers(-7, 7).map(lambda k: 6.4 * k))
    xy = draw(lattice | arrays(float, (n, 2), elements=st.floats(-45, 45, allow_subnormal=False)))
    priority = draw(st.lists(st.integers(0, 2), min_size=n, max_size=n))
    return xy, priority, draw(st.lists(st.sampled_from(kinds), min_size=n, max_size=n))


@given(st.sampled_from(sorted(PLANES)), scenes())
def test_nearest_is_the_closest_pair_first(name, scene):
    plane, (xy, priority, kind) = PLANES[name], scene
    can = plane.reachable(xy * MM).toarray()
    for kinds, mask in ((None, True), (kind, np.array(kind) == "science")):
        found = rs.allocate(plane, xy * MM, allocator="nearest", priority=priority, kind=kinds)
        expected = closest_pairs_first(xy, plane.arrays.xy, can & mask, priority)
        assert found.target_of_positioner.tolist() == expected


def lamost_with_requirements(xy, plane, can, priority, kind, category, requirements, column):
    """Assign science targets by nominations. Then meet each requirement in each spectrograph, first with idle
    positioners.

    ``column(i, t)`` is the spectrograph in which positioner i observes target t.
    """
    target_of = lamost_target(xy, plane.arrays.xy, can & [k == "science" for k in kind], priority)
    locked = set()
    for one in requirements:
        if one.minimum == 0:
            continue
        wanted = [c == one.what for c in category] if one.what in category else [k == one.what for k in kind]
        for place in [None] if one.per == "tile" else np.unique(plane.spectrograph).tolist():
            counts = [i for i, t in enumerate(target_of) if t >= 0 and wanted[t] and place in (None, column(i, t))]
            locked.update(counts)
            lacking = one.minimum - len(counts)
            # idle positioners first, then positioners with the least important targets
            importance = [(t >= 0, priority[t] if t >= 0 else 0, i) for i, t in enumerate(target_of)]
            for _, _, i in sorted(importance):
                free = [
                    (squared_apart(xy[t], plane.arrays.xy[i]), t)
                    for t in range(len(xy))
                    if can[i, t] and wanted[t] and t not in target_of and place in (None, column(i, t))
                ]
                if lacking <= 0 or i in locked or not free:
                    continue
                target_of[i] = min(free)[1]
                locked.add(i)
                lacking -= 1
    return target_of


requirements = st.lists(
    st.builds(
        rs.Requirement,
        st.sampled_from([*KINDS, "faint", "missing"]),
        st.integers(0, 3),
        per=st.sampled_from(["tile", "spectrograph"]),
    ),
    min_size=1,
    max_size=3,
)


@given(st.sampled_from(sorted(PLANES)), scenes(), requirements, st.randoms(use_true_random=False))
def test_lamost_with_requirements_is_the_rule_as_written(name, scene, requirements, random):
    plane, (xy, priority, kind) = PLANES[name], scene
    category, can = [random.choice(["faint", ""]) for _ in xy], plane.reachable(xy * MM).toarray()
    found = flat.allocate(
        plane, xy * MM, "lamost_rule", requirements=requirements, priority=priority, kind=kind, category=category
    )
    expected = lamost_with_requirements(
        xy, plane, can, priority, kind, category, requirements, lambda i, t: plane.spectrograph[i]
    )
    assert found.target_of_positioner.tolist() == expected


@pytest.mark.parametrize("seed", range(3))
def test_rules_with_requirements_are_the_rules_as_written_in_a_crowd(seed):
    """There is one spectrograph per fiber type, some positioners are unusable, and requirements exceed the number of
    targets.
    """
    rng, n = np.random.default_rng(seed), 200
    plane = replace(two_fibers(), spectrograph=rng.integers(0, 3, (37, 2)), disabled=rng.random(37) < 0.1)
    xy, priority = rng.uniform(-80, 80, (n, 2)), rng.integers(0, 3, n)
    kind, fiber = rng.choice(["science", "science", *KINDS], n), rng.choice(["A", "B", ""], n)
    requirements = [rs.Requirement.parse(one) for one in ("standard=2/spectrograph", "sky=9", "science=6/spectrograph")]
    can = plane.reachable(xy * MM, fiber).toarray()

    def column(i, t):
        return plane.spectrograph[i, plane.fiber_types.index(fiber[t] or plane.fiber_type[i].split("+")[0])]

    columns = {"priority": priority, "kind": kind, "fiber_type": fiber}
    found = flat.allocate(plane, xy * MM, "lamost_rule", requirements=requirements, **columns)
    given = priority.tolist(), kind.tolist(), [""] * n, requirements, column
    expected = lamost_with_requirements(xy, plane, can, *given)
    assert found.target_of_positioner.tolist() == expected
    assert (kind[expected] == "sky").sum() == 9
    nearest = rs.allocate(plane, xy * MM, allocator="nearest", **columns)
    expected = closest_pairs_first(xy, plane.arrays.xy, can & (kind == "science"), priority.tolist())
    assert nearest.target_of_positioner.tolist() == expected


def test_the_least_important_targets_give_way_first_and_are_free_again():
    """One positioner is idle, and three observe targets of priorities 3, 1 and 2. One of them releases a target, which
    another positioner then observes.
    """
    unit = rs.Positioner(8.25 * MM, 8.25 * MM, 2 * MM)
    plane = rs.FocalPlane([[0, 0], [40, 0], [80, 0], [120, 0]] * MM, unit)
    xy = [[1, 0], [41, 0], [81, 0], [0, 9], [40, 9], [80, 9], [120, 9]] * MM
    columns = {"priority": [3, 1, 2, 0, 0, 0, 0], "kind": ["science"] * 3 + ["sky"] * 4}
    for n, expected in enumerate([[0, 1, 2, -1], [0, 1, 2, 6], [0, 4, 2, 6], [0, 4, 5, 6], [3, 4, 5, 6]]):
        found = flat.allocate(plane, xy, allocator="lamost_rule", requirements=f"sky={n}", **columns)
        assert found.target_of_positioner.tolist() == expected
    pair, xy = rs.FocalPlane([[0, 0], [20, 0]] * MM, unit), [[10, 0], [15, 0], [0, 5]] * MM
    columns = {"kind": ["science", "science", "sky"], "priority": [1, 2, 0], "category": ["bright", "", ""]}
    found = flat.allocate(pair, xy, "lamost_rule", requirements=["sky=1", "bright=1"], **columns)
    assert found.target_of_positioner.tolist() == [2, 0]


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["balanced", "nearest", "lamost_rule"])
@given(st.sampled_from(sorted(PLANES)), scenes())
def test_rules_take_nothing_but_science(method, name, scene):
    """The result is the same as without standards and sky positions."""
    plane, (xy, priority, kind) = PLANES[name], scene
    science = np.flatnonzero(np.array(kind) == "science")
    given, alone = (None, None) if method == "balanced" else (priority, np.array(priority)[science])
    found = rs.allocate(plane, xy * MM, allocator=method, kind=kind, priority=given).target_of_positioner
    expected = rs.allocate(plane, xy[science] * MM, allocator=method, priority=alone).target_of_positioner
    assert found.tolist() == np.append(science, -1)[expected].tolist()


@pytest.mark.parametrize("method", ["network_flow", "optimal", "repair"])
def test_what_is_not_science_fills_idle_positioners_only(method):
    plane = lamost_like(rings=1)
    xy = np.concatenate([plane.arrays.xy + [9, 0], plane.arrays.xy[:5] + [-9, 0]])
    kind = ["sky", "standard", "sky", "sky", "sky", "sky", "standard"] + ["science"] * 5
    found = rs.allocate(plane, xy * MM, allocator=method, kind=kind, priority=[9] * 7 + [0] * 5)
    assert sorted(found.target_of_positioner) == [5, 6, 7, 8, 9, 10, 11]
    assert [(level.name, level.value) for level in found.levels] == [("science", 5), ("any target", 7)]


def crowd(name, n, seed):
    """Return a focal plane and many targets, some of which are far from all positioners."""
    rng = np.random.default_rng(seed)
    plane = {"lamost_rule": lambda: lamost_like(rings=12), "network_flow": lambda: sdss_like(rings=11)}[name]()
    half = np.abs(plane.arrays.xy).max() * 1.1
    return plane, rng.uniform(-half, half, (n, 2)), rng


def matched(can):
    """Return the number of pairs in a maximum matching, computed by SciPy."""
    return int((maximum_bipartite_matching(can.tocsr(), perm_type="column") >= 0).sum())


@pytest.mark.parametrize("n", [300, 2000])
@pytest.mark.parametrize("name", ["lamost_rule", "network_flow"])
def test_sdss_assigns_a_maximum_matching(name, n):
    plane, xy, _ = crowd(name, n, n)
    found = rs.allocate(plane, xy * MM, allocator="network_flow")
    assert found.n_assigned == found.bound == matched(plane.reachable(xy * MM))
    assert found.gap == 0
    assert found.n_assigned >= rs.allocate(plane, xy * MM, allocator="lamost_rule").n_assigned


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", ["lamost_rule", "network_flow"])
def test_sdss_has_as_many_of_each_class_as_matchings_allow(name, seed):
    """The first k classes together have as many assigned targets as a matching of these classes alone."""
    plane, xy, rng = crowd(name, 700, seed)
    columns = {"priority": rng.choice([2.5, -1, 7, 0], 700), "kind": np.where(rng.random(700) < 0.2, "sky", "science")}
    priority, science = columns["priority"], columns["kind"] == "science"
    found = rs.allocate(plane, xy * MM, allocator="network_flow", **columns)
    can = plane.reachable(xy * MM)
    ranks, expected = [0], {}
    used = found.target_of_positioner[found.target_of_positioner >= 0]
    for value in (7, 2.5, 0, -1):
        ranks.append(matched(can[:, np.flatnonzero(science & (priority >= value))]))
        expected[f"priority {value:g}"] = ranks[-1] - ranks[-2]
        assert ((priority[used] == value) & science[used]).sum() == ranks[-1] - ranks[-2]
    expected["any target"] = matched(can)
    assert {level.name: level.value for level in found.levels} == expected
    assert len(used) == expected["any target"]
    by_count = flat.allocate(plane, xy * MM, "network_flow", objective="count", **columns).levels
    assert by_count[0][:2] == ("science", ranks[-1])
    assert found.levels[0].value >= by_count[1].value


@pytest.mark.parametrize(("make", "n"), [(lamost_like, 400), (sdss_like, 150)])
def test_sdss_has_the_least_sum_of_squared_distances_of_all_maximum_matchings(make, n, rng):
    plane, xy = make(rings=4), rng.uniform(-120, 120, (n, 2))
    r2 = ((xy[None] - plane.arrays.xy[:, None]) ** 2).sum(axis=2)
    can = plane.reachable(xy * MM).toarray()
    rows, columns = linear_sum_assignment(np.where(can, r2 - 1e7, 0.0))
    good = can[rows, columns]
    found = rs.allocate(plane, xy * MM, allocator="network_flow").target_of_positioner
    used = np.flatnonzero(found >= 0)
    assert len(used) == good.sum()
    assert r2[used, found[used]].sum() == pytest.approx(r2[rows, columns][good].sum(), rel=1e-9)


@pytest.mark.parametrize("n", [300, 2000])
@pytest.mark.parametrize("make", [lamost_like, sdss_like])
def test_repair_and_optimal_stay_below_a_matching_class_by_class(make, n, rng):
    plane = make(rings=6)
    half = np.abs(plane.arrays.xy).max()
    xy, priority = rng.uniform(-half, half, (n, 2)), rng.integers(0, 2, n)
    can = plane.reachable(xy * MM)
    top, both = matched(can[:, np.flatnonzero(priority == 1)]), matched(can)
    for method in ("optimal", "repair"):
        found = flat.allocate(plane, xy * MM, method, start="network_flow", priority=priority)
        assert found.levels[0].value <= top
        assert found.n_assigned <= both
        if method == "repair":
            assert found.levels[0].bound == top
            assert found.levels[1].bound == both - top or found.levels[0].value < top
