"""``optimal`` chooses between equally good plans by a hash, not by the order of rows or by requirements."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from rfpsurvey._assignment.rules import tie_order

MM = u.mm
PLANE = rs.FocalPlane.hexagonal(rs.Positioner(7.4 * MM, 15 * MM, 2.5 * MM), rings=4, pitch=22.4 * MM)
CENTER = SkyCoord(150, 33, unit="deg")
OPTIONS = {
    "alone": {},
    "requirements": {"requirements": ["good=20", "poor=15"]},
    "a requirement that is not met": {"requirements": ["good=36"]},
}


def field(rng, n=150):
    xy = rng.uniform(-85, 85, (n, 2)) * MM
    return xy, {"priority": rng.integers(0, 2, n).astype(float), "category": rng.choice(["good", "poor"], n)}


def test_local_moves_that_suffice_do_not_depend_on_the_order_of_rows(rng):
    """Where arms are long, local moves are tried before a search."""
    unit = rs.Positioner(9 * MM, 9 * MM, 1.5 * MM, home=[0, 60] * u.deg)
    plane = rs.FocalPlane.hexagonal(unit, rings=4, pitch=8 * MM)
    xy = rng.uniform(-35, 35, (6 * len(plane), 2)) * MM
    plans = [rs.allocate(plane, xy[k], allocator="optimal") for k in (np.arange(len(xy)), rng.permutation(len(xy)))]
    assert [plan.meta["model"] for plan in plans] == ["local moves"] * 2
    np.testing.assert_array_equal(*[plan.tips.value for plan in plans])


@pytest.mark.few(2)
@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
@pytest.mark.parametrize("allocator", ["optimal", "repair"])
def test_positions_decide_ties_if_there_are_no_identifiers(allocator, options):
    """Plans once depended on the order of rows: 171 of 224 plans were the same after a shuffle."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        xy, columns = field(rng)
        order = rng.permutation(len(xy))
        asked = rs.AllocationOptions(allocator, start="optimal", **options)
        first = rs.allocate(PLANE, xy, allocator=asked, **columns)
        second = rs.allocate(
            PLANE, xy[order], allocator=asked, **{name: values[order] for name, values in columns.items()}
        )
        assert first.n_assigned > 30
        np.testing.assert_array_equal(first.tips.value, second.tips.value)
        np.testing.assert_array_equal(first.handedness, second.handedness)


@pytest.mark.parametrize("ids", [True, False])
def test_tiles_and_surveys_do_not_depend_on_the_order_of_rows(ids, rng):
    n = 900
    stars = rs.synthetic_catalog("uniform", CENTER, 1.4 * u.deg, n_targets=n, rng=1)
    names, order = rng.choice(10**6, n, replace=False), rng.permutation(n)
    catalogs = [rs.Catalog(stars.coord[k], id=names[k] if ids else None) for k in (np.arange(n), order)]
    tiles = [rs.plan_tile(catalog, "sdss_apo", CENTER, allocator="optimal") for catalog in catalogs]
    np.testing.assert_array_equal(*[tile.table["ra"].value for tile in tiles])
    surveys = [rs.plan_survey(catalog, "sdss_apo", CENTER.reshape(1), allocator="optimal") for catalog in catalogs]
    np.testing.assert_array_equal(*[np.sort(survey.targets["ra"].value) for survey in surveys])
    for plan in (tiles[0], surveys[0]):
        assert plan.provenance["parameters"]["tie_seed"] == 0


def test_identifiers_decide_ties_where_there_are_any():
    xy = np.array([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]])
    first = tie_order(xy, np.array([5, 7, 9]))
    assert tie_order(xy[::-1], np.array([5, 7, 9])).tolist() == first.tolist()
    assert (2 - tie_order(xy[::-1])).tolist() == tie_order(xy).tolist()


@pytest.mark.parametrize("name", ["good", "poor"])
def test_a_requirement_that_is_met_anyway_changes_nothing(name):
    """A category with a requirement that was met many times over once received up to 32 more of 770 fibers."""
    for seed in range(5):
        xy, columns = field(np.random.default_rng(seed))
        plans = [
            rs.allocate(PLANE, xy, allocator=rs.AllocationOptions("optimal", requirements=one), **columns)
            for one in ([], [f"{name}=5"], [f"{name}=0-60"])
        ]
        for plan in plans[1:]:
            np.testing.assert_array_equal(plan.target_of_positioner, plans[0].target_of_positioner)
            assert [level for level in plan.levels if level.name != "requirements"] == list(plans[0].levels)
            assert plan.levels[0] == ("requirements", 0.0, 0.0)


def test_a_requirement_that_matters_changes_no_more_than_necessary():
    """A requirement for five more targets of a category once gave up to 30 more targets of this category."""
    for seed in range(5):
        xy, columns = field(np.random.default_rng(seed), 300)
        columns["priority"] = None
        free = rs.allocate(PLANE, xy, allocator="optimal")
        n = int((columns["category"][free.target_of_positioner[free.target_of_positioner >= 0]] == "good").sum())
        asked = rs.AllocationOptions("optimal", requirements=[f"good={n + 2}"])
        plan, random = rs.allocate(PLANE, xy, allocator=asked, **columns), np.empty(len(xy))
        random[tie_order(xy.value)] = np.sort(np.random.default_rng(0).random(len(xy)))[::-1]
        exact = rs.allocate(PLANE, xy, allocator=asked, subpriority=random, **columns)
        assert plan.n_assigned == free.n_assigned
        sums, counts = [], []
        for one in (plan, exact):
            used = one.target_of_positioner[one.target_of_positioner >= 0]
            sums.append(random[used].sum())
            counts.append((columns["category"][used] == "good").sum())
        np.testing.assert_allclose(*sums, atol=1e-4, rtol=0)
        assert counts[0] == counts[1] >= n + 2
