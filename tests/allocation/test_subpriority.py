"""Subpriorities: the order of targets within each class."""

from itertools import product

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from raising import refused
from scipy.stats import kstest

import rfpsurvey as rs
from brute import bodies_of, conflicts_of, options_of
from oracles import balanced_owner, lamost_target, targets_in_order
from rfpsurvey._assignment.rules import id_numbers, service_order
from rfpsurvey.allocation import METHODS, subpriorities

MM = u.mm
PLANES = {
    "equal": rs.FocalPlane.hexagonal(rs.Positioner(8.25 * MM, 8.25 * MM, 2 * MM), rings=1, pitch=25.6 * MM),
    "unequal": rs.FocalPlane.hexagonal(rs.Positioner(7.4 * MM, 15 * MM, 2 * MM), rings=1, pitch=22.4 * MM),
}
M64 = 2**64 - 1


def slow_number(name):
    """Return the number of an identifier by the definition, with Python's integers."""
    text = str(name)
    digits = text.removeprefix("-")
    if digits.isascii() and digits.isdigit() and text == str(int(text)) and -(2**63) <= int(text) < 2**64:
        return int(text) & M64
    total = 0xCBF29CE484222325
    for letter in text:
        total = (total ^ ord(letter)) * 0x100000001B3 & M64
    return total


def slow_mix(number):
    z = (number + 0x9E3779B97F4A7C15) & M64
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 & M64
    z = (z ^ z >> 27) * 0x94D049BB133111EB & M64
    return z ^ z >> 31


def slow_subpriority(name, seed):
    return (slow_mix(slow_number(name) ^ slow_mix(seed)) >> 11) / 2**53


def test_the_hash_is_the_one_that_is_documented():
    ids = ["7", "-3", "0", "-0", "007", "a", "Gaia DR3 12", "+1", "", "Ü9", "1" * 18, "1" * 19, "1" * 20, "2" * 20, "٣"]
    ids += [str(n) for n in (2**63 - 1, 2**63, 2**64 - 1, 2**64, -(2**63), -(2**63) - 1, 6 * 10**18 + 7)]
    for seed in (0, 1, 2**63 - 1):
        assert subpriorities(ids, seed).tolist() == [slow_subpriority(name, seed) for name in ids]
    numbers = [0, 7, -3, 2**62, -(2**63)]
    assert subpriorities(numbers, 5).tolist() == [slow_subpriority(name, 5) for name in numbers[:3]] + [
        (slow_mix(n & M64 ^ slow_mix(5)) >> 11) / 2**53 for n in numbers[3:]
    ]
    assert slow_mix(0) == 0xE220A8397B1DCDAF  # the first output of SplitMix64 with the seed 0


def test_subpriorities_are_given_only_once():
    words = "subpriority must be given either as an array or in the options, got both"
    for given, options in ((None, 1), (np.array([0.5, 0.1]), None)):  # one of them is accepted
        rs.allocate(
            PLANES["equal"],
            [[0, 5], [5, 0]] * MM,
            allocator=rs.AllocationOptions(subpriority=options),
            subpriority=given,
        )
    refused(
        words,
        rs.allocate,
        PLANES["equal"],
        [[0, 5], [5, 0]] * MM,
        allocator=rs.AllocationOptions(subpriority=1),
        subpriority=np.array([0.5, 0.1]),
    )


def test_integers_and_their_text_agree():
    numbers = np.array([0, 5, -17, 10**17, 123456, 2**63 - 1, -(2**63), 5_853_498_713_190_525_696])
    assert (id_numbers(numbers) == id_numbers(numbers.astype(str))).all()
    assert (id_numbers(numbers.astype(np.int32)[[0, 1, 2, 4]]) == id_numbers(numbers[[0, 1, 2, 4]])).all()
    large = np.array([3, 2**64 - 1], dtype=np.uint64)
    assert (id_numbers(large) == [3, M64]).all()
    assert (id_numbers(large.astype(str)) == [3, M64]).all()
    assert (id_numbers(np.array(["7", "star"], dtype=">U4")) == id_numbers(np.array(["7", "star"]))).all()


@pytest.mark.parametrize("text", [False, True])
def test_subpriorities_are_uniform_and_independent(text):
    ids = np.arange(100_000)
    ids = np.char.add("star ", ids.astype(str)) if text else ids
    first, second = subpriorities(ids, 0), subpriorities(ids, 1)
    assert kstest(first, "uniform").pvalue > 1e-3
    assert kstest(second, "uniform").pvalue > 1e-3
    for a, b in ((first, second), (first[1:], first[:-1]), (first, np.arange(len(ids)))):
        assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(len(ids))
    assert len(np.unique(first)) == len(ids)


@pytest.mark.parametrize("name", sorted(PLANES))
@pytest.mark.parametrize("seed", range(25))
def test_rules_serve_targets_in_this_order(name, seed):
    """Only the order of the priorities and of the subpriorities matters."""
    plane, rng = PLANES[name], np.random.default_rng(seed)
    n = int(rng.integers(1, 40))
    xy, priority = rng.uniform(-45, 45, (n, 2)), rng.integers(0, 3, n)
    value = rng.permutation(n) / n
    order = np.argsort(-value)
    place, can = np.argsort(order), plane.reachable(xy * MM).toarray()

    def plan(allocator, priority=priority):
        return rs.allocate(plane, xy * MM, allocator=allocator, priority=priority, subpriority=value)

    by_class = sorted(range(n), key=lambda t: (-priority[t], place[t]))
    assert plan("nearest").target_of_positioner.tolist() == targets_in_order(xy, plane.arrays.xy, can, by_class)
    expected = lamost_target(xy, plane.arrays.xy, can, priority, place)
    for given in (priority, 10 * priority - 7.5):
        assert plan("lamost_rule", given).target_of_positioner.tolist() == expected
    indptr, queue = plan("balanced").queues
    owner = np.array(balanced_owner(xy[order], plane.arrays.xy, can[:, order]))
    for i in range(len(plane)):
        assert queue[indptr[i] : indptr[i + 1]].tolist() == order[owner == i].tolist()


def plans_of(plane, xy, collide):
    """Yield the targets of each plan, without collisions if ``collide`` is true."""
    choices, pairs = options_of(plane, xy, None, both=False), set()
    if collide:
        pairs, _ = conflicts_of(plane, bodies_of(plane, xy, choices, None, True))
    for picked in product(*(range(len(mine)) for mine in choices)):
        targets = [choices[i][k][0] for i, k in enumerate(picked) if k]
        if len(set(targets)) == len(targets):
            used = list(enumerate(picked))
            if not any((a, b) in pairs or (b, a) in pairs for a in used for b in used):
                yield targets


@pytest.mark.parametrize("allocator", ["network_flow", "optimal"])
@pytest.mark.parametrize("seed", range(10))
def test_the_sum_of_subpriorities_is_the_largest_of_all_best_plans(allocator, seed):
    rng = np.random.default_rng(seed)
    plane = rs.FocalPlane([[0, 0], [20, 0], [10, 17]] * MM, rs.Positioner(7.4 * MM, 9 * MM, 2 * MM))
    n = 9
    xy, priority, value = rng.uniform(-10, 30, (n, 2)), rng.integers(0, 2, n), rng.random(n)
    found = rs.allocate(plane, xy * MM, allocator=allocator, priority=priority, subpriority=value)
    plain = rs.allocate(plane, xy * MM, allocator=allocator, priority=priority)
    assert found.levels[:-1] == plain.levels

    def worth(targets):
        targets = np.array(targets, dtype=int)
        return (priority[targets] == 1).sum(), (priority[targets] == 0).sum(), value[targets].sum()

    used = found.target_of_positioner[found.target_of_positioner >= 0]
    best = max(map(worth, plans_of(plane, xy, allocator == "optimal")))
    assert worth(used) == pytest.approx(best, abs=2e-5)


@pytest.mark.parametrize("allocator", METHODS)
@pytest.mark.parametrize("requirements", [[], ["sky=3", "standard=2"]])
def test_shuffled_rows_give_the_same_plan(allocator, requirements, rng):
    plane = rs.FocalPlane.hexagonal(rs.Positioner(7.4 * MM, 15 * MM, 2.5 * MM), rings=4, pitch=22.4 * MM)
    n = 150
    xy, priority = rng.uniform(-100, 100, (n, 2)), rng.integers(0, 2, n)
    kind, value = rng.choice(["science", "science", "standard", "sky"], n), rng.random(n)
    options = rs.AllocationOptions(
        allocator, requirements=requirements, sky_separation=1 * MM if requirements else None
    )
    forbidden = np.column_stack([rng.integers(0, len(plane), 50), rng.integers(0, n, 50)])

    def plan(rows):
        new = np.argsort(rows)
        pairs = np.column_stack([forbidden[:, 0], new[forbidden[:, 1]]])
        columns = {"priority": priority[rows], "kind": kind[rows], "subpriority": value[rows], "forbidden": pairs}
        return rs.allocate(plane, xy[rows] * MM, allocator=options, required=new[:5], **columns)

    rows = rng.permutation(n)
    first, second = plan(np.arange(n)), plan(rows)
    assert (first.tips[np.isfinite(first.tips)] == second.tips[np.isfinite(first.tips)]).all()
    name_of = np.append(np.append(rows, np.arange(n, len(second.xy))), -1)
    assert (name_of[second.target_of_positioner] == first.target_of_positioner).all()
    assert (second.in_reach == first.in_reach[rows]).all()
    for one in (first, second):
        used = np.flatnonzero(one.target_of_positioner >= 0)
        assert (one.positioner_of_target[one.target_of_positioner[used]] == used).all()
        assert (one.xy[one.target_of_positioner[used]] == one.tips[used]).all()


def test_repair_starts_from_a_plan_with_subpriorities(rng):
    plane = rs.FocalPlane.hexagonal(rs.Positioner(7.4 * MM, 15 * MM, 2.5 * MM), rings=4, pitch=22.4 * MM)
    xy, value = rng.uniform(-100, 100, (150, 2)) * MM, rng.random(150)
    start = rs.allocate(plane, xy, allocator="nearest", subpriority=value)
    given, named = (
        rs.allocate(plane, xy, allocator=rs.AllocationOptions("repair", start=one, moves="exchange"), subpriority=value)
        for one in (start, "nearest")
    )
    assert (given.target_of_positioner == named.target_of_positioner).all()
    assert given.meta["n_before"] == start.n_assigned


@pytest.fixture(scope="module")
def field():
    center = SkyCoord(95 * u.deg, 23 * u.deg)
    return rs.synthetic_catalog("poisson", center, 1.4 * u.deg, density=900 / u.deg**2, rng=3), center


@pytest.mark.parametrize("ids", ["integers", "text"])
def test_a_tile_depends_on_identifiers_and_not_on_rows(field, ids, rng):
    catalog, center = field
    names = np.arange(len(catalog)) if ids == "integers" else np.char.add("s", np.arange(len(catalog)).astype(str))
    rows = rng.permutation(len(catalog))

    def plan(order, seed):
        shuffled = rs.Catalog(catalog.coord[order], id=names[order], priority=(np.arange(len(names)) % 3)[order])
        options = rs.AllocationOptions("lamost_rule", subpriority=seed)
        return rs.plan_tile(shuffled, "sdss_apo", center, allocator=options)

    first, second, other = plan(np.arange(len(names)), 1), plan(rows, 1), plan(rows, 2)
    assert (first["target_id"] == second["target_id"]).all()
    assert (first["target_id"] != other["target_id"]).any()
    assert first.provenance["parameters"]["subpriority"] == 1


def test_a_column_of_the_catalog_gives_the_order(field, tmp_path):
    catalog, center = field
    value, table = subpriorities(catalog.id, 4), catalog.to_table()
    table["SUBPRIORITY"] = value
    kept = rs.Catalog.from_table(table, keep=["SUBPRIORITY"])
    options = rs.AllocationOptions("nearest", subpriority="SUBPRIORITY")
    by_column = rs.plan_tile(kept, "sdss_apo", center, allocator=options)
    by_seed = rs.plan_tile(catalog, "sdss_apo", center, allocator=rs.AllocationOptions("nearest", subpriority=4))
    assert (by_column["target_id"] == by_seed["target_id"]).all()
    surveys = [
        rs.plan_survey(kept, "sdss_apo", center[None], allocator=options, folder=folder)
        for folder in (None, tmp_path / "survey")
    ]
    for survey in surveys:
        visits, used = survey.tile(0), np.isfinite(by_seed["ra"])
        assert np.asarray(visits["target_id"]).tolist() == np.asarray(by_seed["target_id"])[used].tolist()


def test_equal_subpriorities_are_ordered_by_identifier(rng):
    ids, value = rng.permutation(50), np.zeros(50)
    assert ids[service_order(value, ids)].tolist() == list(range(50))


def test_wrong_subpriorities_are_refused(field):
    def allocate(subpriority, allocator="balanced"):
        return rs.allocate(PLANES["equal"], [[0, 0]] * MM, subpriority=subpriority, allocator=allocator)

    for value, message in (
        (-1, "0 to 2\\^63 - 1, got -1"),
        (1.5, "must be an integer, got 1.5"),
        (True, "must be an integer, got True"),
    ):
        refused(message, rs.AllocationOptions, subpriority=value)
    refused("integers or text", subpriorities, [1.5], 0)
    refused("a finite number for every target, but 1 of 1 rows", allocate, [np.nan])
    refused("must be numbers", allocate, ["a"])
    refused("shape \\(1,\\), got \\(2,\\)", allocate, [1, 2])
    refused("got both", allocate, [1], rs.AllocationOptions(subpriority=1))
    refused("can be used only with a catalog, got 'S'", allocate, None, rs.AllocationOptions(subpriority="S"))
    own = rs.AllocationOptions(subpriority="SUB")
    refused("got 'SUB'; additional columns: none", rs.plan_tile, field[0], "sdss_apo", field[1], allocator=own)
