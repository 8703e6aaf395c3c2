"""Allocated targets: expected values and simulations, compared with each other and with all configurations."""

import io
import sys

import astropy.units as u
import numpy as np
import pytest
from raising import refused
from scipy import stats

import flat
import rfpsurvey as rs
from oracles import balanced_queues, collisions_of, expectation, standing_arms
from scenes import CAPSULE, MM, SEPARATE_HOME, both_hands, lamost_like, sdss_like, two_fibers, with_troubles

PAIR = [[0, 0], [19, 4]] * MM
RHOMB = [[0, 0], [22.4, 0], [11.2, 19.4], [33.6, 19.4]] * MM
LAMOST = rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM)
SDSS = rs.Positioner(7.4 * MM, 15 * MM, 2.5 * MM, step=0.1 * u.deg)
NOT = [np.nan, np.nan]
EXHAUSTIVE = pytest.mark.exhaustive
NUMBERS = ("value", "value_assigned", "pairs_per_positioner")

TINY = {
    "two equal arms": rs.FocalPlane(PAIR, LAMOST),
    "equal arms": rs.FocalPlane(RHOMB * 0.8, LAMOST),
    "home elsewhere": rs.FocalPlane(RHOMB * 0.8, rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM, **SEPARATE_HOME)),
    "unequal arms": rs.FocalPlane(RHOMB, SDSS),
    "fiber tips": rs.FocalPlane(
        RHOMB * 0.7, rs.Positioner(7.4 * MM, 15 * MM, 4 * MM, arm_model="fiber_tip", handedness="left")
    ),
    "capsules": rs.FocalPlane(RHOMB, rs.Positioner(7.4 * MM, 15 * MM, 2 * MM, **CAPSULE), fiber_type=["A", "B"] * 2),
    "left": rs.FocalPlane(RHOMB, rs.Positioner(7.4 * MM, 15 * MM, 2.5 * MM, handedness="left")),
    "arms of their own": rs.FocalPlane(
        RHOMB, LAMOST, central_arm=[8.25, 7, 8.25, 9] * MM, eccentric_arm=[8.25, 11, 9, 9] * MM
    ),
    "troubles": rs.FocalPlane(
        RHOMB,
        LAMOST,
        disabled=[False, True, False, False],
        stuck=[NOT, NOT, [-70, 30], NOT] * u.deg,
        obstacles=[[12, 4, 1.5], [33, 12, 1]] * MM,
    ),
    "both hands": rs.FocalPlane(
        RHOMB * 0.8, rs.Positioner(8 * MM, 8 * MM, 2 * MM, handedness="both", theta_range=[-120, 150] * u.deg)
    ),
}

# scene, number of conditional realizations, number of plain iterations per batch
SETTINGS = {
    "four a positioner": (lamost_like(), {}, 300, 3000),
    "dense": (lamost_like(), {"n_targets": 1500}, 120, 1200),
    "sparse": (lamost_like(), {"n_targets": 30}, 1200, 3000),
    "sparse, parked arms ignored": (lamost_like(), {"n_targets": 30, "parked_obstacles": False}, 1200, 3000),
    "sparse, home elsewhere": (lamost_like(**SEPARATE_HOME), {"n_targets": 45}, 1200, 3000),
    "unequal arms": (sdss_like(), {}, 300, 3000),
    "few for unequal arms": (sdss_like(), {"n_targets": 25}, 1200, 3000),
    "long central arms": (sdss_like(l2=6.0), {}, 300, 3000),
    "small circle": (lamost_like(), {"n_targets": 60, "target_radius": 45 * MM}, 600, 3000),
    "small circle of unequal arms": (sdss_like(), {"n_targets": 60, "target_radius": 35 * MM}, 600, 3000),
    "capsules": (two_fibers(), {}, 300, 3000),
    "fiber tips": (sdss_like(arm_model="fiber_tip"), {}, 300, 3000),
    "left": (sdss_like(handedness="left"), {"n_targets": 80}, 300, 3000),
    "troubles": (with_troubles(sdss_like()), {}, 300, 3000),
    "troubles of equal arms": (with_troubles(lamost_like()), {"n_targets": 60}, 600, 3000),
    "both hands": (both_hands(), {"n_targets": 60}, 160, 400),
    "rule of lamost": (sdss_like(2), {"n_targets": 40, "allocator": "lamost_rule"}, 120, 120),
    "poisson": (lamost_like(2), {"n_targets": 20, "targets": "poisson"}, 1200, 3000),
    "few entries of long queues": (lamost_like(2), {"n_targets": 400, "most_entries": 3}, 600, 3000),
    "discs": (lamost_like(), {"n_targets": 150, "targets": "poisson_disc", "min_separation": 7 * MM}, 300, 3000),
}


ALIKE = set(SETTINGS) - {
    *("four a positioner", "sparse", "unequal arms", "capsules", "fiber tips", "troubles", "both hands"),
    *("rule of lamost", "poisson", "few entries of long queues", "discs"),
}
"""Settings that are similar to others."""


def fields(estimate):
    return np.array([getattr(estimate, name) for name in NUMBERS])


def batches(plane, seed, n=20, **options):
    """Return independent estimates, whose scatter is an error that does not depend on the stated errors."""
    return [flat.collision_probability(plane, rng=own, **options) for own in np.random.default_rng(seed).spawn(n)]


def mean_and_error(rows):
    rows = np.array(rows)
    return rows.mean(axis=0), rows.std(axis=0, ddof=1) / np.sqrt(len(rows))


def queues_of(plane, xy):
    return balanced_queues(xy, plane.xy.to_value("mm"), plane.reachable(xy * MM).toarray())


def assert_agree(one, other):
    """Check that values agree within 4 combined standard errors (probability 1 in 3000), and positioners within 5."""
    (a, error_a), (b, error_b) = (mean_and_error([fields(e) for e in some]) for some in (one, other))
    assert (np.abs(a - b) < 4 * np.hypot(error_a, error_b)).all()
    (a, error_a), (b, error_b) = (mean_and_error([e.per_positioner for e in some]) for some in (one, other))
    np.testing.assert_array_equal(np.isnan(a), np.isnan(b))
    there = ~np.isnan(a)
    assert (np.abs(a - b)[there] <= 5 * np.hypot(error_a, error_b)[there]).all()


@pytest.mark.parametrize("name", [pytest.param(name, marks=EXHAUSTIVE if name in ALIKE else ()) for name in SETTINGS])
def test_conditional_and_monte_carlo_agree(name):
    plane, options, n_conditional, n_plain = SETTINGS[name]
    part = 3 if name in ALIKE else 12
    conditional = batches(plane, 1, method="conditional", max_iterations=n_conditional // part, **options)
    options = {key: value for key, value in options.items() if key != "most_entries"}
    plain = batches(plane, 2, method="monte_carlo", max_iterations=n_plain // part, **options)
    assert 0.005 < plain[0].value < 0.7
    assert_agree(conditional, plain)
    for some in (conditional, plain):  # the error that each estimate states equals their scatter
        ratio = np.var([e.value for e in some], ddof=1) / np.mean([e.standard_error**2 for e in some])
        assert stats.chi2.ppf(0.001, 19) < 19 * ratio < stats.chi2.ppf(0.999, 19)


@pytest.mark.parametrize("name", TINY)
def test_conditional_is_the_mean_over_all_configurations(name, rng):
    plane = TINY[name]
    longest, values, idle = 0, [], 0
    skies = [rng.uniform(-edge, edge, (n, 2)) for n, edge in ((4, 20), (7, 20), (11, 25), (13, 30))]
    # the first sky has a single target
    skies = [np.array([[-9, 2]]), *(xy + plane.xy.to_value("mm").mean(axis=0) for xy in skies)]
    for xy in skies:
        queues = queues_of(plane, xy)
        longest, idle = max(longest, *(len(q) for q in queues)), idle + sum(not q for q in queues)
        types = None if plane.fiber_types == ("",) else [[t] * len(q) for t, q in zip("ABAB", queues, strict=True)]
        for parked in (True, False):
            got = flat.collision_probability(plane, targets=xy * MM, parked_obstacles=parked)
            *numbers, per_positioner = expectation(plane, queues, types, parked)
            np.testing.assert_allclose(fields(got), numbers, atol=1e-12)
            np.testing.assert_allclose(got.per_positioner, per_positioner, atol=1e-12)
            values.append(got.value)
            assert got.n == 1
    assert longest >= 3
    assert idle > 0
    assert any(0 < v < 1 for v in values)


def test_monte_carlo_draws_every_configuration_alike(rng):
    plane, xy = TINY["unequal arms"], rng.uniform(-10, 40, (11, 2))
    queues = queues_of(plane, xy)
    *exact, per_positioner = expectation(plane, queues)
    assert len({len(q) for q in queues}) > 1
    got = batches(plane, 3, method="monte_carlo", targets=xy * MM, max_iterations=500)
    mean, error = mean_and_error([fields(e) for e in got])
    assert (np.abs(mean - exact) < 4 * error).all()
    mean, error = mean_and_error([e.per_positioner for e in got])
    assert (np.abs(mean - per_positioner) <= 4 * error).all()


def test_few_entries_are_drawn_alike(rng):
    plane, xy = TINY["equal arms"], rng.uniform(-10, 40, (14, 2))
    exact = rs.collision_probability(plane, targets=xy * MM)
    got = batches(plane, 3, targets=xy * MM, max_iterations=400, most_entries=1)
    assert max(len(q) for q in queues_of(plane, xy)) > 3
    mean, error = mean_and_error([np.append(fields(e), e.per_positioner) for e in got])
    assert (error > 0).any()
    assert (np.abs(mean - np.append(fields(exact), exact.per_positioner)) <= 4 * error + 1e-12).all()
    all_of_them = flat.collision_probability(plane, targets=xy * MM, max_iterations=3, most_entries=14)
    np.testing.assert_allclose(fields(all_of_them), fields(exact), atol=1e-14)


@pytest.mark.parametrize("method", ["monte_carlo", "conditional"])
@pytest.mark.parametrize("name", ["equal arms", "unequal arms", "troubles", "both hands"])
def test_iterations_are_the_public_way_through_allocation_and_collisions(name, method, rng):
    """The rule of LAMOST leaves one configuration for each sky, so that all methods must give the same result."""
    plane, skies = TINY[name], []

    def sampler(rng):
        skies.append(rng.uniform(-20, 45, (rng.integers(1, 8), 2)) * MM)
        return skies[-1]

    got = flat.collision_probability(plane, method=method, targets=sampler, allocator="lamost_rule", max_iterations=70)
    reports = [rs.find_collisions(plane, rs.allocate(plane, xy, allocator="lamost_rule")) for xy in skies]
    assert len(reports) == got.n == 70
    reports = [r for r in reports if r.counted.any()]
    rates = np.array([r.rate for r in reports])
    assert 0 < rates.mean() < 1
    assert got.value == pytest.approx(rates.mean(), abs=1e-12)
    assert got.value_assigned == pytest.approx(np.mean([r.rate_assigned for r in reports if r.assigned.any()]))
    assert got.standard_error == pytest.approx(rates.std(ddof=1) / np.sqrt(len(rates)))
    assert got.pairs_per_positioner == pytest.approx(np.mean([len(r.pairs) / r.counted.sum() for r in reports]))
    counted = np.array([r.counted for r in reports])
    times = (np.array([r.in_collision for r in reports]) & counted).sum(axis=0).astype(float)
    part = np.divide(times, counted.sum(axis=0), out=np.full(4, np.nan), where=counted.any(axis=0))
    np.testing.assert_allclose(got.per_positioner, part, atol=1e-12)
    assert got.meta["trials"] == counted.sum()


def test_a_configuration_without_a_choice_is_scored_exactly(rng):
    """With queues of one target there is a single configuration.

    One iteration gives the number of `find_collisions`.
    """
    plane, rates = sdss_like(2), []
    for _ in range(30):
        xy = rng.uniform(-50, 50, (7, 2))
        allocation = rs.allocate(plane, xy * MM, allocator="balanced")
        report = rs.find_collisions(plane, allocation)
        if (np.diff(allocation.queues[0]) > 1).any():
            continue
        rates.append(report.rate)
        for method in ("monte_carlo", "conditional"):
            got = flat.collision_probability(plane, method=method, targets=xy * MM, max_iterations=1)
            assert got.value == got.value_assigned == pytest.approx(report.rate, abs=1e-15)
            assert got.pairs_per_positioner == pytest.approx(len(report.pairs) / report.counted.sum(), abs=1e-15)
            expected = np.where(report.counted, report.in_collision, np.nan)
            np.testing.assert_allclose(got.per_positioner, expected, atol=1e-15)
    assert len(rates) > 10
    assert len(set(rates)) > 1


def test_conditional_over_skies_is_the_mean_over_given_skies(rng):
    plane, skies = lamost_like(1), []

    def sampler(rng):
        skies.append(rng.uniform(-35, 35, (12, 2)) * MM)
        return skies[-1]

    got = flat.collision_probability(plane, targets=sampler, max_iterations=30)
    each = [rs.collision_probability(plane, targets=xy) for xy in skies]
    np.testing.assert_allclose(fields(got), np.mean([fields(e) for e in each], axis=0), atol=1e-12)
    assert got.standard_error == pytest.approx(np.std([e.value for e in each], ddof=1) / np.sqrt(30))


@pytest.mark.parametrize("method", ["conditional", "monte_carlo", "quadrature"])
def test_arms_that_cannot_touch_are_never_looked_at(method):
    plane = rs.FocalPlane.hexagonal(LAMOST, rings=2, pitch=37.6 * MM)
    assert plane.collision_type == 1
    nobody = {"density" if method == "quadrature" else "targets": lambda what: pytest.fail("there is nothing to do")}
    got = flat.collision_probability(plane, method=method, **nobody)
    assert fields(got).tolist() == [0, 0, 0]
    assert (got.low, got.high, got.standard_error, got.n) == (0, 0, 0, 0)
    assert got.per_positioner.tolist() == [0] * 19
    near = rs.FocalPlane.hexagonal(LAMOST, rings=2, pitch=37.4 * MM)
    assert near.collision_type == 2
    assert flat.collision_probability(near, method=method, max_iterations=16).n == 16


def test_without_targets_parked_arms_remain():
    plane, stuck = lamost_like(2), np.full((19, 2), np.nan)
    stuck[9], stuck[4] = [170, 0], [-20, 10]
    plane = rs.FocalPlane(plane.xy, plane.positioner, stuck=stuck * u.deg)
    arms, _, counted = standing_arms(plane, np.full((19, 2), np.nan))
    pairs, _ = collisions_of(plane, arms)
    assert 0 < len(pairs) < 19
    hit = np.isin(np.arange(19), pairs) & counted
    for method in ("conditional", "monte_carlo"):
        got = flat.collision_probability(plane, method=method, n_targets=0, max_iterations=5)
        assert got.value == pytest.approx(hit.sum() / 17)
        assert got.pairs_per_positioner == pytest.approx(len(pairs) / 17)
        assert np.isnan(got.value_assigned)
        np.testing.assert_array_equal(got.per_positioner, np.where(counted, hit, np.nan))
        for nobody, options in ((sdss_like(1), {}), (lamost_like(1), {"parked_obstacles": False})):
            with pytest.raises(rs.InputError, match="at least one positioner must be counted"):
                flat.collision_probability(nobody, method=method, n_targets=0, max_iterations=5, **options)


def test_figures_of_lamost():
    """The values at the center of LAMOST's lattice under four rules; they differ by a factor of five."""
    known, plane = {"uniform": 0.110, "shared": 0.076, "voronoi": 0.019}, lamost_like(4)
    middle = np.hypot(*plane.xy.value.T).argmin()
    for density, value in known.items():
        got = flat.collision_probability(plane, method="quadrature", density=density, max_iterations=1024)
        assert got.per_positioner[middle] == pytest.approx(value, abs=0.002)
    plane = lamost_like(12)
    got = flat.collision_probability(plane, n_targets=20_000, max_iterations=20)
    inner = np.hypot(*plane.xy.value.T) < 8 * 25.6
    assert len(plane) == 469
    assert got.per_positioner[inner].mean() == pytest.approx(0.063, abs=0.002)


@pytest.mark.filterwarnings("ignore:precision has no effect")
@pytest.mark.parametrize("method", ["conditional", "monte_carlo", "quadrature", "closed_form"])
def test_dynamic_collisions_are_independent_of_static_ones(method):
    plane = lamost_like(1)
    static = flat.collision_probability(plane, method=method, max_iterations=64)
    both = flat.collision_probability(plane, method=method, max_iterations=64, dynamic=0.025)
    for name in ("value", "value_assigned", "low", "high", "per_positioner"):
        expected = 1 - (1 - getattr(static, name)) * (1 - 0.025)
        np.testing.assert_allclose(getattr(both, name), expected, rtol=1e-12)
    np.testing.assert_allclose(both.standard_error, static.standard_error * 0.975, rtol=1e-12)
    assert both.pairs_per_positioner == pytest.approx(static.pairs_per_positioner, nan_ok=True)
    assert both.meta["dynamic"] == 0.025


def test_auto_takes_the_method_of_the_estimand():
    plane, few = lamost_like(1), {"max_iterations": 16}
    for options, name in (
        ({}, "conditional"),
        ({"estimand": "allocated"}, "conditional"),
        ({"allocator": "lamost_rule"}, "monte_carlo"),
        ({"estimand": "independent"}, "quadrature"),
        ({"estimand": "independent", "density": "voronoi"}, "quadrature"),
    ):
        got = flat.collision_probability(plane, method="auto", **options, **few)
        same = flat.collision_probability(plane, method=name, **options, **few)
        assert (got.method, got.estimand, got.value) == (name, options.get("estimand", "allocated"), same.value)


def test_a_preset_goes_by_its_name(presets):
    here = rs.collision_probability(presets["moons"].focal_plane, method="closed_form")
    assert rs.collision_probability("moons", method="closed_form").value == here.value
    by_name = flat.collision_probability("sdss_apo", max_iterations=2)
    assert by_name.meta["n_targets"] == presets["sdss_apo"].targets_per_fiber * len(presets["sdss_apo"].focal_plane)
    assert by_name.value == flat.collision_probability(presets["sdss_apo"], max_iterations=2).value


def test_an_estimate_says_what_it_is():
    got = flat.collision_probability(lamost_like(1), max_iterations=20, confidence=0.9)
    assert f"{got.value:.4g} [{got.low:.4g}, {got.high:.4g}], n = 20" in repr(got)
    assert "'conditional' of 'allocated'" in repr(got)
    assert "[" not in repr(rs.collision_probability(lamost_like(1), method="overlap_ratio"))
    assert got.seconds > 0
    assert (got.meta["confidence"], got.meta["n_positioners"]) == (0.9, 7)


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_the_bar_goes_to_the_standard_error(monkeypatch, capsys):
    for options in ({}, {"method": "monte_carlo"}, {"method": "quadrature"}):
        silent = flat.collision_probability(lamost_like(1), max_iterations=300, **options)
        assert capsys.readouterr() == ("", "")
        terminal = Terminal()
        with monkeypatch.context() as patch:
            patch.setattr(sys, "stderr", terminal)
            shown = flat.collision_probability(lamost_like(1), max_iterations=300, progress=True, **options)
        assert "100%, 0:00:00 left" in terminal.getvalue()
        assert capsys.readouterr().out == ""
        assert shown.value == silent.value


FRACTION = "must be a number above 0 and below 1"
WHOLE = "must be a whole number"
DENSITY = "density must be one of uniform, shared, voronoi"
BAD_OPTIONS = [
    ({"method": "magic"}, "unknown method of collision probability 'magic'; choose one of: auto, "),
    ({"estimand": "both"}, "unknown estimand 'both'"),
    ({"method": "quadrature", "estimand": "allocated"}, "'quadrature' estimates .* for 'independent' targets, not"),
    ({"method": "conditional", "estimand": "independent"}, "'conditional' estimates .* for 'allocated' targets, not"),
    ({"method": "auto", "estimand": "both"}, "unknown estimand"),
    ({"allocator": "greedy"}, "unknown allocator 'greedy'"),
    ({"interval": "normal"}, "unknown interval 'normal'"),
    ({"stop": "soon"}, "unknown stopping rule 'soon'"),
    ({"method": "closed_form", "variant": "ours"}, "unknown variant of the closed form 'ours'"),
    *(({"method": "quadrature", "density": density}, DENSITY) for density in ("clustered", np.ones(3), [])),
    ({"method": "quadrature", "density": [1, 2]}, "density must be Allocations with queues"),
    ({"method": "quadrature", "density": lambda xy: "much"}, "density must return numbers, got str"),
    ({"precision": np.nan}, f"standard_error {FRACTION}, got nan"),
    *(({"precision": value}, f"standard_error {FRACTION}") for value in (0, 1.0, -0.1, "0.1", 0.1 * u.deg)),
    ({"max_iterations": 0}, f"max_iterations {WHOLE} of at least 1, got 0"),
    *(({"max_iterations": value}, f"max_iterations {WHOLE}") for value in (10.0, np.nan)),
    ({"most_entries": 0}, f"most_entries {WHOLE} of at least 1"),
    *(({"most_entries": value}, f"most_entries {WHOLE}") for value in (2.5, True)),
    *(({"confidence": value}, f"confidence {FRACTION}") for value in (0, 1, np.nan, "95%")),
    *(({"dynamic": value}, "dynamic must be a number of at least 0 and below 1") for value in (-0.1, np.nan, 1)),
    *(({"dynamic": value}, "dynamic must be a number of at least 0") for value in ("path", np.array([0.1, 0.2]))),
    *(({"rng": value}, "rng must be") for value in ("seed", -1)),
    ({"rng": np.random.Generator(np.random.RandomState(1)._bit_generator)}, "rng must be able to spawn"),
    ({"executor": 4}, "executor must be a concurrent.futures.Executor, got 4"),
    ({"allocator": rs.AllocationOptions("lamost_rule", requirements="sky=3")}, "must have no requirements and no sky"),
    ({"allocator": rs.AllocationOptions("lamost_rule", requirements="instrument")}, "must have no requirements and no"),
    (
        {"allocator": rs.AllocationOptions("lamost_rule", sky_separation=1 * MM)},
        "no requirements and no sky_separation",
    ),
]


@pytest.mark.parametrize(("options", "words"), BAD_OPTIONS)
def test_bad_options_are_named(options, words):
    refused(words, lambda: flat.collision_probability(lamost_like(1), **options))


@pytest.mark.filterwarnings("ignore:precision has no effect")
def test_bad_planes_are_named():
    refused("unknown instrument 'lamos'.*Did you mean 'lamost'", rs.collision_probability, "lamos")
    refused("must be a name, an Instrument or a FocalPlane, got int", rs.collision_probability, 12)
    idle = rs.FocalPlane(PAIR, LAMOST, disabled=[True, True])
    apart = rs.FocalPlane(PAIR * 9, LAMOST, disabled=[True, True])
    for method in ("conditional", "monte_carlo", "quadrature", "closed_form", "overlap_ratio", "close_pair"):
        refused("at least one positioner must be", flat.collision_probability, idle, method=method, max_iterations=4)
        if method in ("closed_form", "close_pair", "overlap_ratio", "quadrature"):
            refused("every positioner is disabled or stuck", rs.collision_probability, idle, method=method)
    refused("every positioner is disabled or stuck", rs.collision_probability, apart, method="conditional")
