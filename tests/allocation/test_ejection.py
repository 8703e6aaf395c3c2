"""Ejection moves: plans stay valid, never get worse, are close to the optimum, and ignore the order of targets."""

import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import flat
import rfpsurvey as rs
from rfpsurvey._assignment import local_search as _local_search
from scenes import SCENES, lamost_like, sdss_like

MM = u.mm
NAMES = sorted(set(SCENES) - {"left"})
CENTER = SkyCoord(95, 23, unit="deg")
LONG = rs.Positioner(12.5 * MM, 12.5 * MM, 1.2 * MM)


def crowded(name, seed):
    """Return a plane of the scenes, targets of all kinds, and requirements with minima and maxima."""
    rng = np.random.default_rng([seed, len(name)])
    plane, given = SCENES[name]
    n = int(rng.integers(40, 300))
    options = {"priority": rng.integers(0, 3, n), "parked_obstacles": given.get("parked_obstacles", True)}
    options["kind"] = rng.choice(["science", "science+standard", "standard", "sky"], n, p=[0.7, 0.1, 0.1, 0.1])
    options["requirements"] = ["sky=4-6", f"standard={rng.integers(2, 9)}", "science=-25"][: rng.integers(0, 4)]
    if rng.random() < 0.5:
        options["subpriority"] = rng.random(n)
    if rng.random() < 0.3:
        options["required"] = rng.permutation(n)[:3]
    if plane.fiber_types != ("",):
        options["fiber_type"] = rng.choice(["", *plane.fiber_types], n)
    return plane, rng.uniform(-85, 85, (n, 2)) * MM, options


@pytest.mark.few(13)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seeds", [range(4), pytest.param(range(4, 12), marks=pytest.mark.exhaustive)])
def test_plans_stay_valid_and_never_get_worse(name, seeds, monkeypatch):
    """The state that the moves update is that of a new plan with the same candidates."""
    improve, n_better = _local_search.improve, 0

    def checked(candidates, chosen, *arguments, **options):
        nonlocal n_better
        plans, make = [], _local_search._plan
        with monkeypatch.context() as patch:
            patch.setattr(_local_search, "_plan", lambda *given: plans.append(make(*given)) or plans[-1])
            after = improve(candidates, chosen, *arguments, **options)
        expected = make(candidates, after, _local_search._goals(candidates))
        for found, wanted in zip(plans[0], expected, strict=True):
            np.testing.assert_array_equal(found, wanted)
        assert not expected.blocked[after].any() or expected.blocked[chosen].any()
        assert (expected.count <= np.maximum(candidates.limits[1], candidates.held[:, chosen].sum(axis=1))).all()
        values = [tuple(candidates.problem.level_values(candidates.options.target[plan])) for plan in (chosen, after)]
        assert values[1] >= values[0]
        n_better += values[1] > values[0]
        return after

    monkeypatch.setattr(_local_search, "improve", checked)
    for seed in seeds:
        plane, xy, options = crowded(name, seed)
        columns = {key: options.pop(key) for key in ("required", "subpriority") if key in options}
        allocator, others = flat.split("repair", options)
        rs.allocate(plane, xy, allocator=allocator, **columns, **others)
    assert n_better >= len(seeds) / 4


@pytest.mark.parametrize("n_scenes", [60, pytest.param(150, marks=pytest.mark.exhaustive)])
def test_plans_are_close_to_the_optimum(n_scenes):
    n_close = n_equal = 0
    for seed in range(n_scenes):
        rng = np.random.default_rng(seed)
        unit = rs.Positioner(rng.uniform(3, 8) * MM, rng.uniform(4, 9) * MM, rng.uniform(0.3, 1.5) * MM)
        plane = rs.FocalPlane.hexagonal(unit, rings=int(rng.integers(1, 4)), pitch=10 * MM)
        n = int(rng.uniform(0.3, 5) * len(plane)) + 1
        xy, columns = rng.uniform(-12 * 3, 12 * 3, (n, 2)) * MM, {"priority": rng.integers(0, 3, n)}
        found, best = (rs.allocate(plane, xy, allocator=one, **columns) for one in ("repair", "optimal"))
        values, bounds = ([level.value for level in one.levels] for one in (found, best))
        assert best.gap == 0
        assert tuple(values) <= tuple(bounds)
        n_close += values[0] >= bounds[0] - 1 and sum(values) >= sum(bounds) - max(1, 0.01 * sum(bounds))
        n_equal += values == bounds
    assert n_close >= 0.99 * n_scenes
    assert n_equal >= 0.9 * n_scenes


@pytest.mark.parametrize("n_classes", [1, 3])
def test_long_arms_lose_few_targets(n_classes):
    """Exchanges lose 10 % of the targets of arms that reach 2.5 pitches."""
    plane, rng = rs.FocalPlane.hexagonal(LONG, rings=8, pitch=10 * MM), np.random.default_rng(3)
    xy, priority = rng.uniform(-100, 100, (2 * len(plane), 2)) * MM, rng.integers(0, n_classes, 2 * len(plane))
    found, earlier = (
        rs.allocate(plane, xy, allocator=rs.AllocationOptions("repair", moves=moves), priority=priority)
        for moves in ("ejection", "exchange")
    )
    assert found.levels[0].value > 1.08 * earlier.levels[0].value
    busy = found.target_of_positioner >= 0
    assert not any(busy[pair].any() for pair in rs.find_collisions(plane, found).pairs)


def test_the_order_of_the_catalog_has_no_influence():
    instrument = rs.Instrument("small", lamost_like(), plate_scale=100 * MM / u.deg)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(60, 200))
        sky = CENTER.spherical_offsets_by(*rng.uniform(-0.9, 0.9, (2, n)) * u.deg)
        table = QTable({"id": rng.permutation(n) + 10, "priority": rng.integers(0, 2, n)})
        plans = []
        for rows in (np.arange(n), rng.permutation(n)):
            catalog = rs.Catalog(sky[rows], id=table["id"][rows], priority=table["priority"][rows])
            tile = rs.plan_tile(catalog, instrument, CENTER).table
            plans.append(np.where(tile["status"] == "assigned", tile["target_id"], "").tolist())
        assert plans[0] == plans[1]


@pytest.mark.parametrize("seed", [86, 93])
def test_the_most_important_target_is_observed_where_rules_allow_it(seed):
    """With exchanges, fibers that no rule requires observe the sky, and the target of priority 1000 has no fiber."""
    rng, n_standard = np.random.default_rng(seed), {86: 120, 93: 200}[seed]
    n = 150 + n_standard + 250 + 1
    distance, angle = 1.45 * np.sqrt(rng.random(n)), rng.uniform(0, 360, n)
    distance[-1] *= 0.9
    kind = np.repeat(["science", "standard", "sky", "science"], [150, n_standard, 250, 1])
    priority = np.where(kind == "science", rng.choice([1, 2, 3], n), 0)
    priority[-1] = 1000
    fiber_type = rng.choice(["BOSS", "APOGEE"], n, p=[0.65, 0.35])
    fiber_type[-1] = "APOGEE"
    bands = QTable({band: np.full(n, 15.0) for band in ("bp", "rp", "g", "i", "gaia_g")} | {"h": np.full(n, 11.0)})
    sky = CENTER.directional_offset_by(angle * u.deg, distance * u.deg)
    catalog = rs.Catalog(sky, id=np.arange(n), priority=priority, kind=kind, fiber_type=fiber_type, extra=bands)
    tile = rs.plan_tile(catalog, "sdss_apo", CENTER, allocator=rs.AllocationOptions(rules="bright_time"))
    assert n - 1 in tile.table["target_id"][tile.table["status"] == "assigned"]
    assert len(tile.summary["unmet"]) == 0


@pytest.mark.parametrize("allocator", ["repair", "optimal", "balanced"])
def test_a_warning_states_that_the_highest_priority_has_no_fiber(allocator):
    """An obstacle covers the only target of the highest priority."""
    obstacles = [[12, 0, 1], [-12, 0, 1]] * MM  # the target in the east is at one of them
    plane = rs.FocalPlane([[0, 0]] * MM, rs.Positioner(8 * MM, 8 * MM, 2 * MM), obstacles=obstacles)
    instrument = rs.Instrument("small", plane, plate_scale=100 * MM / u.deg)
    catalog = rs.Catalog(CENTER.directional_offset_by([90, 0] * u.deg, 0.12 * u.deg), priority=[3, 1])
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        tile = rs.plan_tile(catalog, instrument, CENTER, allocator=allocator)
    texts = [str(one.message) for one in found if "highest priority" in str(one.message)]
    text = "no target of the highest priority (3) has a fiber; 1 target in reach"
    assert texts == ([text] if allocator != "balanced" else [])
    assert allocator == "balanced" or tile.table["target_id"].tolist() == [1]


def test_a_given_plan_changes_only_where_it_gets_better():
    plane, (n, seed) = sdss_like(rings=5), (200, 1)
    xy = np.random.default_rng(seed).uniform(-120, 120, (n, 2)) * MM
    best = rs.allocate(plane, xy, allocator="optimal")
    kept = rs.allocate(plane, xy, allocator=rs.AllocationOptions("repair", start=best))
    np.testing.assert_array_equal(kept.target_of_positioner, best.target_of_positioner)
    assert kept.meta["n_moved"] == 0


EARLIER_PLANS = [
    (sdss_like, 150, [69, 110, 124, 118, 117, 66, 94, 21], 52196),
    (lamost_like, 90, [25, 32, 31, 51, 74, 29, 41, 36], 27725),
    (sdss_like, 700, [565, 441, 421, 319, 612, 323, 153, 8], 217175),
]


@pytest.mark.parametrize(("make", "n", "first", "digest"), EARLIER_PLANS)
def test_exchanges_make_the_plans_of_version_0_3(make, n, first, digest):
    rng = np.random.default_rng(n)
    xy, kind = rng.uniform(-85, 85, (n, 2)) * MM, np.where(rng.random(n) < 0.2, "sky", "science")
    options = rs.AllocationOptions("repair", requirements=["sky=3"], moves="exchange")
    found = rs.allocate(make(), xy, allocator=options, priority=rng.integers(0, 3, n), kind=kind).target_of_positioner
    assert found[: len(first)].tolist() == first
    assert found @ np.arange(1, len(found) + 1) == digest


def test_moves_end_with_nearer_targets(presets):
    """Arms whose targets are near the center of their positioner are less extended, and collide less often."""
    plane, rng = presets["sdss_apo"].focal_plane, np.random.default_rng(1)
    radius = np.hypot(*plane.xy.to_value(MM).T).max()
    xy = rng.uniform(-radius, radius, (round(5 * len(plane) * 4 / np.pi), 2)) * MM

    def size(found):
        target = found.target_of_positioner
        own = np.flatnonzero(target >= 0)
        return len(own), ((xy[target[own]] - plane.xy[own]).to_value(MM) ** 2).sum() / len(own)

    (n, mean), (before, mean_before) = (
        size(rs.allocate(plane, xy, allocator=rs.AllocationOptions("repair", moves=moves)))
        for moves in ("ejection", "exchange")
    )
    assert n >= before
    assert mean < 1.02 * mean_before  # 1.06 without these moves


def test_requirements_are_restored_far_from_a_move(presets):
    """A fiber takes a target of the best class from the sky if another one, anywhere, takes a sky position."""
    plane, rng, n = presets["sdss_apo"].focal_plane, np.random.default_rng(1), 3000
    radius = np.hypot(*plane.xy.to_value(MM).T).max()
    columns = {"kind": rng.choice(["science", "standard", "sky"], n, p=[0.6, 0.15, 0.25])}
    columns["priority"] = np.where(columns["kind"] == "science", rng.integers(1, 4, n), 0)
    rules = {"requirements": ["science=-350", "standard=70-70", "sky=80-80"]}
    xy = rng.uniform(-radius, radius, (n, 2)) * MM
    found, best = (
        rs.allocate(plane, xy, allocator=rs.AllocationOptions(**options, **rules), **columns)
        for options in ({"allocator": "repair"}, {"allocator": "optimal", "time_limit": 10 * u.s})
    )
    assert found.levels[0].value == 0
    assert found.levels[1].value >= 0.985 * best.levels[1].value
