"""Independent targets: quadrature compared with plain simulation, rejection sampling and all configurations."""

import itertools
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from raising import refused

import flat
import rfpsurvey as rs
from oracles import balanced_queues, expectation
from rfpsurvey._studies.benchmark_probability import random_tips
from rfpsurvey._studies.quadrature import environments
from scenes import MM, SCENES, both_hands, lamost_like, sdss_like, with_troubles

NUMBERS = ("value", "value_assigned", "pairs_per_positioner")
N = 4000


def annuli(plane):
    """Return the center, inner radius and outer radius of each patrol area, from public columns."""
    unit, n = plane.positioner, len(plane)
    l1 = np.full(n, unit.central_arm.value) if plane.central_arm is None else plane.central_arm.value
    l2 = np.full(n, unit.eccentric_arm.value) if plane.eccentric_arm is None else plane.eccentric_arm.value
    return plane.xy.to_value("mm"), np.abs(l1 - l2), l1 + l2


def movable(plane):
    stuck = np.zeros(len(plane), bool) if plane.stuck is None else np.isfinite(plane.stuck.value).all(axis=1)
    return ~plane.disabled & ~stuck


def simulate(plane, rng, keep=lambda i, points: np.ones(len(points), bool), n=N):
    """Draw the tips of each positioner from a square by rejection, and count collisions."""
    centers, inner, outer = annuli(plane)
    tips = np.full((n, len(plane), 2), np.nan)
    for i in np.flatnonzero(movable(plane)):
        found = 0
        while found < n:
            points = rng.uniform(-outer[i], outer[i], (2 * n, 2))
            r = np.hypot(*points.T)
            points = centers[i] + points[(r >= inner[i]) & (r <= outer[i])]
            points = points[keep(i, points)][: n - found]
            tips[found : found + len(points), i] = points
            found += len(points)
    return rs.collision.count_collisions(plane, tips * MM, parked_obstacles=False)


def assert_same(estimate, counts, plane):
    """Check that values agree within 4 combined standard errors (probability 1 in 16,000), and positioners within 5."""
    n, used = len(counts), movable(plane)
    error = np.hypot(counts.rate.std() / np.sqrt(n), estimate.standard_error)
    assert abs(estimate.value - counts.rate.mean()) < 4 * error
    assert estimate.value_assigned == estimate.value
    pairs = counts.n_pairs / used.sum()
    # the relative scatter of pairs is that of the value
    error = np.hypot(pairs.std() / np.sqrt(n), estimate.standard_error)
    assert abs(estimate.pairs_per_positioner - pairs.mean()) < 4 * error
    part = counts.per_positioner / n
    np.testing.assert_array_equal(np.isnan(estimate.per_positioner), ~used)
    error = np.sqrt(part * (1 - part) / n + estimate.standard_error**2 * used.sum() + 1 / n**2)
    assert (np.abs(estimate.per_positioner - part) < 5 * error)[used].all()


PLAIN = {k: SCENES[k][0] for k in SCENES if k not in ("left", "parked arms ignored", "capsules")}


@pytest.mark.few(3)
@pytest.mark.parametrize("name", PLAIN)
def test_uniform_targets_are_those_of_plain_simulation(name, rng):
    plane, n, precision = PLAIN[name], N, 6e-4
    got = rs.collision_probability(plane, method="quadrature", precision=precision)
    unit, centers = plane.positioner, plane.xy
    limited = unit.theta_range is not None

    def in_reach(i, points):
        return np.isfinite(unit.inverse(points * MM - centers[i])[0]) if limited else np.ones(len(points), bool)

    assert_same(got, simulate(plane, rng, in_reach, n), plane)
    assert got.value > 0.05


def in_annuli(plane, points):
    centers, inner, outer = annuli(plane)
    r = np.hypot(*(points[:, None] - centers).transpose(2, 0, 1))
    return (r >= inner) & (r <= outer) & movable(plane)


def shared(plane, rng):
    return lambda i, points: rng.random(len(points)) * in_annuli(plane, points).sum(axis=1) < 1


def voronoi(plane, rng):
    centers = plane.xy.to_value("mm")
    return lambda i, points: ((points[:, None] - centers) ** 2).sum(axis=2).argmin(axis=1) == i


def sloping(points):
    """Return a density that increases toward the east, and is 0 in a band."""
    x, y = points.to_value("mm").T
    return np.where(np.abs(y + 25) > 5, np.exp(x / 25), 0) * 1e200


def weighted(plane, rng):
    def keep(i, points):
        largest = np.exp((plane.xy[i, 0].value + 22.4) / 25) * 1e200
        return rng.random(len(points)) * largest < sloping(points * MM)

    return keep


DENSITY = {"shared": ("shared", shared), "voronoi": ("voronoi", voronoi), "given": (sloping, weighted)}


@pytest.mark.few(3)
@pytest.mark.parametrize("name", DENSITY)
@pytest.mark.parametrize(
    "plane", [lamost_like(2), sdss_like(2), with_troubles(lamost_like())], ids=["equal", "unequal", "troubles"]
)
def test_densities_are_those_of_rejection_sampling(name, plane, rng):
    (density, keep), n, precision = DENSITY[name], 3000, 1.1e-3
    got = rs.collision_probability(plane, method="quadrature", density=density, precision=precision)
    assert_same(got, simulate(plane, rng, keep(plane, rng), n=n), plane)
    assert got.meta["density"] == name


def test_a_factor_of_the_density_does_not_matter():
    plane, options = lamost_like(1), {"method": "quadrature", "max_iterations": 256}
    one = flat.collision_probability(plane, density=lambda p: np.full(len(p), 1.0), **options)
    for factor in (1e-200, 7.0, 1e300):
        other = flat.collision_probability(plane, density=lambda p, f=factor: np.full(len(p), f), **options)
        assert other.value == pytest.approx(one.value, abs=1e-12)
    with_unit = flat.collision_probability(plane, density=lambda p: np.full(len(p), 3) / u.mm**2, **options)
    assert with_unit.value == pytest.approx(one.value, abs=1e-12)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    "plane", [lamost_like(), sdss_like(2), pytest.param(sdss_like(arm_model="fiber_tip"), marks=pytest.mark.exhaustive)]
)
def test_environments_change_nothing(plane):
    """With a function as density, environments are not used, and each positioner is computed separately."""
    few = flat.collision_probability(plane, method="quadrature", max_iterations=512)
    each = flat.collision_probability(plane, method="quadrature", density=lambda p: np.ones(len(p)), max_iterations=512)
    assert few.meta["environments"] < 8 < each.meta["environments"] == len(plane)
    assert abs(few.value - each.value) < 3 * np.hypot(few.standard_error, each.standard_error)
    # the error of a positioner is larger than that of the mean by at most the square root of their number
    error = np.hypot(few.standard_error, each.standard_error) * np.sqrt(len(plane))
    assert (np.abs(few.per_positioner - each.per_positioner) < 5 * error).all()


def test_lamost_has_three_environments(presets):
    plane = lamost_like(12)
    assert len(plane) == 469
    got = flat.collision_probability(plane, method="quadrature", max_iterations=64)
    assert got.meta["environments"] == 3
    # positioners at corners, at edges and inside have 3, 4 and 6 neighbors
    n_neighbors = np.bincount(plane.neighbor_pairs().ravel())
    groups = [set(got.per_positioner[n_neighbors == k]) for k in (3, 4, 6)]
    assert [len(g) for g in groups] == [1, 1, 1]
    assert len(set.union(*groups)) == 3


MIXED = {
    "lattice": lamost_like(4),
    "long arms": sdss_like(5),
    "fiber types": replace(lamost_like(4), fiber_type=np.where(np.arange(61) % 3, "A", "B")),
    "arms of their own": replace(lamost_like(4), eccentric_arm=np.where(np.arange(61) % 7, 8.25, 9) * MM),
    "rows along y": rs.FocalPlane.hexagonal(lamost_like().positioner, rings=4, pitch=25.6 * MM, rows_along="y"),
    "vacant": rs.FocalPlane.hexagonal(lamost_like().positioner, rings=4, pitch=25.6 * MM, vacant=[(0, 0), (3, 0)]),
    "moved": replace(lamost_like(4), xy=lamost_like(4).xy + [312.7, -45.3] * MM),
    "obstacles": replace(lamost_like(4), obstacles=[[12.8, 7, 1], [-80, 3, 2]] * MM),
    "disabled": replace(lamost_like(4), disabled=np.arange(61) == 17),
    "joint limits": rs.FocalPlane.hexagonal(both_hands().positioner, rings=4, pitch=25 * MM),
}


def surroundings(plane, i, radius):
    """Return all objects within a radius as (x + iy, kind). Immovable positioners and obstacles have names as kinds."""
    z = plane.xy.value @ [1, 1j]
    l2 = np.full(len(plane), 0) if plane.eccentric_arm is None else plane.eccentric_arm.value
    seen = [
        (z[j] - z[i], f"{plane.fiber_type[j]} {l2[j]}" if not plane.disabled[j] else f"disabled {j}")
        for j in np.flatnonzero(np.abs(z - z[i]) < radius)
    ]
    circles = [] if plane.obstacles is None else plane.obstacles.value.tolist()
    return seen + [
        (complex(x, y) - z[i], f"obstacle {k}")
        for k, (x, y, r) in enumerate(circles)
        if abs(complex(x, y) - z[i]) < radius + max(c[2] for c in circles)
    ]


def alike(one, other, turns):
    """Return whether a rotation by a multiple of 60 degrees maps one environment to the other; immovable arms do not
    rotate.
    """
    for k in turns:
        turned = [(z * np.exp(1j * np.pi / 3 * k), what) for z, what in one]
        still = any(what.startswith("disabled") for _, what in one)
        if (
            len(one) == len(other)
            and not (still and k)
            and all(any(abs(z - w) < 1e-7 and what == that for w, that in other) for z, what in turned)
        ):
            return True
    return False


@pytest.mark.parametrize("name", MIXED)
def test_positioners_of_one_environment_see_the_same(name):
    plane, radius = MIXED[name], 39.0
    turns = [0] if name == "joint limits" else range(6)
    first, number = environments(plane, radius)
    seen = [surroundings(plane, i, radius) for i in range(len(plane))]
    for i, k in enumerate(number):
        assert alike(seen[i], seen[first[k]], turns)
    for a in first:
        assert not any(alike(seen[a], seen[b], turns) for b in first if a != b)


def queues_of(plane, xy):
    return balanced_queues(xy, plane.xy.to_value("mm"), plane.reachable(xy * MM).toarray())


@pytest.mark.parametrize("parked", [True, False])
@pytest.mark.parametrize("plane", [lamost_like(), sdss_like(), with_troubles(lamost_like())])
def test_queues_of_an_allocation_are_conditional_of_its_targets(plane, parked, rng):
    xy = rng.uniform(-70, 70, (60, 2)) * MM
    given = flat.collision_probability(plane, targets=xy, parked_obstacles=parked)
    density = rs.allocate(plane, xy, allocator="balanced")
    for some in (density, [density], (density, density)):
        got = flat.collision_probability(plane, method="quadrature", density=some, parked_obstacles=parked)
        for field in (*NUMBERS, "low", "high", "standard_error", "n_effective"):
            assert getattr(got, field) == pytest.approx(getattr(given, field), rel=1e-12)
        np.testing.assert_allclose(got.per_positioner, given.per_positioner, rtol=1e-12, atol=1e-15)
        assert (got.estimand, got.meta["density"]) == ("independent", "empirical")
    assert got.meta["n_allocations"] == 2
    assert given.value > 0


def test_queues_of_several_allocations_are_put_together(rng):
    plane = rs.FocalPlane([[0, 0], [22.4, 0], [11.2, 19.4], [33.6, 19.4]] * MM, sdss_like(1).positioner)
    skies = [rng.uniform(-10, 40, (n, 2)) for n in (4, 6, 1)]
    queues = [list(itertools.chain(*q)) for q in zip(*(queues_of(plane, xy) for xy in skies), strict=True)]
    allocations = [rs.allocate(plane, xy * MM, allocator="balanced") for xy in skies]
    got = rs.collision_probability(plane, method="quadrature", density=allocations)
    *numbers, per_positioner = expectation(plane, queues)
    np.testing.assert_allclose([getattr(got, k) for k in NUMBERS], numbers, atol=1e-12)
    np.testing.assert_allclose(got.per_positioner, per_positioner, atol=1e-12)
    assert 0 < got.value < 1


def test_points_come_in_powers_of_two_and_no_more_than_allowed():
    plane = lamost_like(1)
    for most, n in ((1, 1), (100, 64), (128, 128), (1000, 512)):
        assert flat.collision_probability(plane, method="quadrature", max_iterations=most).n == n
    loose, tight = (rs.collision_probability(plane, method="quadrature", precision=p) for p in (1e-3, 5e-5))
    assert loose.n < tight.n
    for got, precision in ((loose, 1e-3), (tight, 5e-5)):
        assert (got.high - got.low) / 2 <= 1.96 * precision
    with pytest.warns(rs.RfpsurveyWarning, match="interval is too wide for the requested standard error 1e-06"):
        flat.collision_probability(plane, method="quadrature", precision=1e-6, max_iterations=256)


def test_the_error_is_that_of_repeated_quadrature():
    """Results with different seeds scatter around the same value as much as the standard error states."""
    plane = sdss_like(1)
    got = [
        flat.collision_probability(plane, method="quadrature", max_iterations=128, rng=rng)
        for rng in np.random.default_rng(4).spawn(25)
    ]
    values, errors = np.array([[e.value, e.standard_error] for e in got]).T
    # 24 and 25 times 7 degrees of freedom: the ratio of variances is within a factor of 2.5 at 0.1 %
    assert 1 / 2.5 < values.var(ddof=1) / np.mean(errors**2) < 2.5
    best = flat.collision_probability(plane, method="quadrature", max_iterations=1024)
    assert abs(values.mean() - best.value) < 4 * np.hypot(values.std(ddof=1) / 5, best.standard_error)


BAD_DENSITIES = [
    (lambda p: -np.ones(len(p)), "density must return a finite number of at least 0 for each"),
    (lambda p: np.full(len(p), np.nan), "density must return a finite number"),
    (lambda p: np.full(len(p), np.inf), "density must return a finite number"),
    (lambda p: 1.0, "density must return a finite number"),
    (lambda p: np.ones((len(p), 2)), "density must return a finite number"),
    (lambda p: np.zeros(len(p)), "density must be positive somewhere in every patrol area"),
    (lambda p: (p[:, 0] > 0).astype(float), "density must be positive somewhere in every patrol area.*around"),
]


@pytest.mark.parametrize(("density", "words"), BAD_DENSITIES)
def test_bad_densities_are_named(density, words):
    refused(words, lambda: rs.collision_probability(lamost_like(2), method="quadrature", density=density))


def test_allocations_have_to_fit(rng):
    xy, plane = rng.uniform(-30, 30, (20, 2)) * MM, lamost_like(1)
    with pytest.raises(rs.InputError, match="density must be Allocations with queues"):
        rs.collision_probability(plane, method="quadrature", density=rs.allocate(plane, xy, allocator="lamost_rule"))
    with pytest.raises(rs.InputError, match="for the 19 positioners of the focal plane, got .* for 7"):
        rs.collision_probability(
            lamost_like(2), method="quadrature", density=rs.allocate(plane, xy, allocator="balanced")
        )
    moved = replace(plane, xy=plane.xy + 900 * MM)
    with pytest.raises(rs.InputError, match="the allocation is for another focal plane"):
        rs.collision_probability(moved, method="quadrature", density=rs.allocate(plane, xy, allocator="balanced"))


def test_the_probability_of_outlines_is_the_rate_of_random_configurations(presets):
    """Independent of the quadrature: collisions of random configurations are found one configuration at a time."""
    desi = presets["desi"]
    found = rs.collision_probability(desi, method="quadrature", precision=1e-3, rng=0)
    rng = np.random.default_rng(1)
    rates = [rs.find_collisions(desi.focal_plane, random_tips(desi.focal_plane, rng) * u.mm).rate for _ in range(20)]
    error = np.hypot(np.std(rates, ddof=1) / np.sqrt(len(rates)), found.standard_error)
    assert abs(np.mean(rates) - found.value) < 4 * error
    segment = rs.collision_probability(desi.with_arm_model("elbow_to_tip"), method="quadrature", precision=1e-3, rng=0)
    assert found.value > 2 * segment.value
