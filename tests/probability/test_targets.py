"""Sources of the targets of a simulation: random skies, functions, catalogs."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from raising import refused
from scipy import stats
from scipy.spatial import cKDTree

import flat
import rfpsurvey as rs
from oracles import balanced_queues, expectation, lamost_target, tangent_plane_mm
from rfpsurvey._studies.targets import make_source
from rfpsurvey.probability import Precision, RandomTargets
from scenes import CAPSULE, MM, lamost_like, sdss_like

CENTER = SkyCoord(95, 23, unit="deg")
DISCS = {"targets": "poisson_disc", "min_separation": 5 * MM}


def source_of(plane, kind, n=None, radius=None, separation=None):
    return make_source(plane, None, RandomTargets(kind, n, radius, separation))


def apart(gap=33.5, at=(0, 0)):
    """Return three positioners whose patrol areas do not overlap, but whose arms can collide."""
    unit = rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM)
    return rs.FocalPlane(([[0, 0], [gap, 0], [gap / 2, gap * 0.8660254]] + np.array(at)) * MM, unit)


@pytest.mark.parametrize(("at", "center"), [((-20, -20), (0, 0)), ((10, -20), (30, 0)), ((-60, -20), (-40, 0))])
def test_the_circle_of_targets_is_around_the_origin_or_around_a_plane_without_the_origin(at, center):
    places = np.array([[0, 0], [40, 0], [0, 40], [40, 40]]) + np.array(at)
    plane = rs.FocalPlane(places * MM, lamost_like(1).positioner)
    assert source_of(plane, "uniform", 10, 80 * MM).center == center
    if center == (0, 0):  # also if the origin is not the midpoint
        plane = rs.FocalPlane(np.append(places, [[60, 0]], axis=0) * MM, plane.positioner)
        assert source_of(plane, "uniform", 10, 80 * MM).center == center


@pytest.mark.parametrize(
    ("kind", "separation"),
    [("uniform", None), ("poisson", None), ("poisson_disc", 7.9), ("poisson_disc", 3), ("poisson_disc", 0.3)],
)
def test_targets_are_uniform_in_the_circle(kind, separation, rng):
    """Discs are also uniform if they fill nearly half of the circle; a wall at the edge would increase their density
    there.
    """
    source = source_of(lamost_like(), kind, 110, 60 * MM, None if separation is None else separation * MM)
    points = np.concatenate([source.draw(rng) for _ in range(200)])
    assert len(points) == 22_000 or kind == "poisson"
    r2 = (points**2).sum(axis=1)
    assert r2.max() <= 3600
    assert stats.kstest(r2 / 3600, "uniform").pvalue > 1e-3
    angle = np.arctan2(points[:, 1], points[:, 0])
    assert stats.kstest(angle / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-3
    assert abs(np.corrcoef(r2, angle)[0, 1]) < 4 / np.sqrt(len(points))


@pytest.mark.parametrize("n", [50, 500])
def test_the_number_of_poisson_targets_has_its_own_variance(n, rng):
    source = source_of(lamost_like(), "poisson", n)
    for sizes in (source.numbers(2000, rng), [len(source.draw(rng)) for _ in range(2000)]):
        assert abs(np.mean(sizes) - n) < 4 * np.sqrt(n / 2000)
        assert stats.chi2.ppf(1e-4, 1999) < np.var(sizes, ddof=1) / n * 1999 < stats.chi2.ppf(1 - 1e-4, 1999)
    assert set(source_of(lamost_like(), "uniform", n).numbers(100, rng)) == {n}


@pytest.mark.parametrize(("n", "radius", "separation"), [(300, 93, 5.0), (560, 93, 5.5), (12, 20, 7.0), (2, 10, 9.0)])
def test_discs_keep_their_distance(n, radius, separation, rng):
    source, nearest = source_of(lamost_like(), "poisson_disc", n, radius * MM, separation * MM), []
    for _ in range(20):
        points = source.draw(rng)
        assert points.shape == (n, 2)
        assert np.hypot(*points.T).max() <= radius
        nearest.append(cKDTree(points).query(points, k=2)[0][:, 1].min())
    assert min(nearest) >= separation
    assert min(nearest) < 1.1 * separation  # the separation of some discs is not much larger than the minimum


@pytest.mark.few(3)
@pytest.mark.parametrize(("at", "method"), [((0, 0), "conditional"), ((500, -800), "monte_carlo")])
@pytest.mark.parametrize("kind", ["uniform", "poisson", "poisson_disc"])
def test_chance_of_a_positioner_to_be_without_a_target(kind, method, at):
    """Patrol areas that do not overlap contain no target with a probability given by a formula."""
    plane, n, radius = apart(at=at), 6, 70.0
    middle = plane.xy.value.mean(axis=0) if any(at) else np.zeros(2)
    assert np.hypot(*(plane.xy.value - middle).T).max() + 16.5 < radius
    options = {"targets": kind, "n_targets": n, "target_radius": radius * MM, "max_iterations": 10_000}
    if kind == "poisson_disc":
        options["min_separation"] = 0.5 * MM  # so small that it has no effect
    got = flat.collision_probability(plane, method=method, parked_obstacles=False, **options)
    part = (16.5 / radius) ** 2
    empty = np.exp(-n * part) if kind == "poisson" else (1 - part) ** n
    # three positioners compete for the same targets; the scatter is at most that of one positioner
    assert abs(1 - got.meta["trials"] / 30_000 - empty) < 4 * np.sqrt(empty * (1 - empty) / 10_000)


def test_targets_beyond_the_circle_do_not_exist():
    plane = sdss_like()
    distance = np.hypot(*plane.xy.value.T)
    for kind in ({"targets": "uniform"}, {"targets": "poisson"}, DISCS):
        got = flat.collision_probability(plane, n_targets=60, target_radius=35 * MM, max_iterations=40, **kind)
        np.testing.assert_array_equal(np.isnan(got.per_positioner), distance > 35 + 22.4)


def test_targets_cover_the_plane_by_default(presets):
    plane = sdss_like()
    got = flat.collision_probability(plane, max_iterations=2)
    assert (got.meta["n_targets"], got.meta["target_radius_mm"]) == (4 * 37, pytest.approx(3 * 22.4 + 22.4))
    got = flat.collision_probability(plane, n_targets=99, target_radius=5 * u.cm, max_iterations=2, **DISCS)
    assert [got.meta[k] for k in ("targets", "n_targets", "target_radius_mm", "min_separation_mm")] == [
        "poisson_disc",
        99,
        50,
        5,
    ]
    sdss = presets["sdss_apo"]
    got = flat.collision_probability(sdss, max_iterations=2)
    assert got.meta["n_targets"] == sdss.targets_per_fiber * len(sdss.focal_plane)


def test_a_sampler_is_asked_for_each_realization_with_a_generator_of_its_own():
    plane, seen = lamost_like(1), []

    def sampler(rng):
        assert isinstance(rng, np.random.Generator)
        seen.append(rng.uniform(-40, 40, (20, 2)) * MM)
        return seen[-1].to(u.cm)

    for method in ("conditional", "monte_carlo"):
        seen.clear()
        got = flat.collision_probability(plane, method=method, targets=sampler, max_iterations=70)
        assert len(seen) == got.n == 70
        assert len({xy[0, 0].value for xy in seen}) == 70
        assert got.meta["targets"] == "sampler"


LIMITED = rs.Positioner(7.4 * MM, 15 * MM, 2.5 * MM, phi_range=[70, 180] * u.deg)


@pytest.mark.few(1)
@pytest.mark.parametrize("n", [400])
@pytest.mark.parametrize(
    "plane", [sdss_like(2), rs.FocalPlane.hexagonal(LIMITED, rings=2, pitch=22.4 * MM)], ids=["free", "joint limits"]
)
def test_a_sampler_of_uniform_targets_is_like_uniform_targets(plane, n):
    """The first calculation uses only kernels, and the second uses public functions for one sky at a time."""
    radius = 67.2

    def sampler(rng):
        r, angle = radius * np.sqrt(rng.random(60)), rng.uniform(0, 2 * np.pi, 60)
        return np.column_stack([r * np.cos(angle), r * np.sin(angle)]) * MM

    for method in ("conditional", "monte_carlo"):
        one = flat.collision_probability(plane, method=method, targets=sampler, max_iterations=n)
        other = flat.collision_probability(plane, method=method, n_targets=60, max_iterations=2 * n)
        assert abs(one.value - other.value) < 4 * np.hypot(one.standard_error, other.standard_error)
        trials = one.meta["trials"] / (n * 19), other.meta["trials"] / (2 * n * 19)
        assert abs(trials[0] - trials[1]) < 4 * np.sqrt(0.25 / n / 19 + 0.25 / 2 / n / 19)


def tiny(fiber_type=("A", "B", "A", "B")):
    unit = rs.Positioner(7.4 * MM, 15 * MM, 2 * MM, **CAPSULE)
    xy = [[0, 0], [22.4, 0], [11.2, 19.4], [33.6, 19.4]] * MM
    return rs.Instrument("tiny", rs.FocalPlane(xy, unit, fiber_type=fiber_type), plate_scale=200 * MM / u.deg)


def test_a_catalog_is_projected_and_its_fiber_types_count(rng):
    """Compare with all configurations of the queues of the catalog, projected by astropy's WCS, with the requested
    fiber types.
    """
    instrument = tiny(fiber_type=["A+B", "B+A", "A", "B"])
    plane = instrument.focal_plane
    coord = CENTER.spherical_offsets_by(rng.uniform(-0.06, 0.2, 30) * u.deg, rng.uniform(-0.08, 0.16, 30) * u.deg)
    types, kind = rng.choice(["A", "B", ""], 30), rng.choice(["science", "sky", "standard"], 30, p=[0.4, 0.3, 0.3])
    catalog = rs.Catalog(coord, fiber_type=types, kind=kind)
    got = rs.collision_probability(instrument, targets=catalog, center=CENTER)
    science = kind == "science"
    xy, types = tangent_plane_mm(coord[science], CENTER, 200, 0), types[science]
    queues = balanced_queues(xy, plane.xy.value, plane.reachable(xy * MM, types).toarray())
    row = {tuple(p): t for p, t in zip(xy, types, strict=True)}
    used = [[row[p] for p in q] for q in queues]
    assert {t for q in used for t in q} == {"A", "B", ""}
    value, value_assigned, pairs, per_positioner = expectation(plane, queues, used)
    assert 0 < value < 1
    assert (got.value, got.value_assigned, got.pairs_per_positioner) == pytest.approx((value, value_assigned, pairs))
    np.testing.assert_allclose(got.per_positioner, per_positioner, atol=1e-9)
    assert (got.meta["targets"], got.meta["n_targets"]) == ("given", science.sum())


def test_targets_with_no_requested_visits_are_ignored(rng):
    """Targets with 0 visits were assigned."""
    coord = CENTER.spherical_offsets_by(rng.uniform(-0.06, 0.2, 30) * u.deg, rng.uniform(-0.08, 0.16, 30) * u.deg)
    visits = np.arange(30) % 3
    got, expected = (
        rs.collision_probability(tiny(), targets=catalog, center=CENTER)
        for catalog in (rs.Catalog(coord, visits=visits), rs.Catalog(coord[visits > 0]))
    )
    assert (got.value, got.meta["n_targets"]) == (expected.value, 20)


def test_priorities_of_a_catalog_reach_the_allocator(rng):
    instrument = tiny()
    plane = instrument.focal_plane
    coord = CENTER.spherical_offsets_by(rng.uniform(-0.06, 0.2, 25) * u.deg, rng.uniform(-0.08, 0.16, 25) * u.deg)
    priority, xy = rng.integers(1, 4, 25), tangent_plane_mm(coord, CENTER, 200, 0)
    reach, values = plane.reachable(xy * MM).toarray(), []
    for wanted in (priority, np.zeros(25)):
        chosen = lamost_target(xy, plane.xy.value, reach, wanted)
        values.append(expectation(plane, [[tuple(xy[t])] if t >= 0 else [] for t in chosen])[2:])
        catalog = rs.Catalog(coord, priority=wanted)
        for method in ("conditional", "monte_carlo"):
            got = flat.collision_probability(
                instrument, method=method, targets=catalog, center=CENTER, allocator="lamost_rule", max_iterations=2
            )
            assert got.pairs_per_positioner == pytest.approx(values[-1][0])
            np.testing.assert_allclose(got.per_positioner, values[-1][1], atol=1e-12)
    assert any(np.any(a != b) for a, b in zip(*values, strict=True))


def test_a_catalog_is_centered_on_its_mean_direction(rng):
    instrument = tiny()
    # the targets are symmetric around the center, also across 0 h, so that the center is their mean direction
    angle, center = np.arange(0, 360, 15) * u.deg, SkyCoord(0, 40, unit="deg")
    coord = center.directional_offset_by(angle, 0.1 * u.deg)
    assert np.ptp(coord.ra.deg) > 300
    catalog = rs.Catalog(coord)
    here = rs.collision_probability(instrument, targets=catalog)
    there = rs.collision_probability(instrument, targets=catalog, center=center)
    assert here.value == pytest.approx(there.value, abs=1e-12)
    assert here.value > 0
    elsewhere = rs.collision_probability(instrument, targets=catalog, center=SkyCoord(0.05, 40.02, unit="deg"))
    assert elsewhere.value != pytest.approx(there.value, abs=1e-6)


NUMBER, RADIUS = "number must be a number from 0 to", "radius must be one finite value above 0"
LENGTH = "min_separation must be one finite value above 0 mm"
KIND = "min_separation must be given for the kind 'poisson_disc' and for no other"
BAD_TARGETS = [
    ({"targets": "random"}, "unknown kind of targets 'random'; choose one of: poisson, poisson_disc, uniform"),
    ({"targets": 3}, "targets must be RandomTargets or one of uniform, poisson, poisson_disc, a Catalog"),
    ({"targets": [[0, 1]]}, r"targets must be RandomTargets or .* got \[\[0, 1\]\]"),
    ({"targets": np.zeros((3, 2))}, r"got array\(\[\[0"),
    ({"targets": np.zeros((3, 2)) * u.deg}, "targets must have a unit convertible to mm, got deg"),
    ({"targets": np.zeros((3, 3)) * MM}, r"targets must have the shape \(n, 2\), got \(3, 3\)"),
    ({"targets": np.zeros((0, 2)) * MM}, "at least one row .*, got none"),
    ({"targets": rs.Catalog(CENTER)}, "targets in a Catalog require an Instrument"),
    ({"targets": lambda rng: rng.random((3, 2))}, "the result of the function given as targets must be a Quantity"),
    ({"targets": lambda rng: rng.random((3, 3)) * MM}, "the function given as targets must have the shape"),
    *(({"n_targets": n}, NUMBER) for n in (-1, np.nan, np.inf, "many")),
    ({"target_radius": 30}, "radius must be a Quantity"),
    *(({"target_radius": radius * MM}, RADIUS) for radius in (0, np.nan)),
    ({"target_radius": 1 * u.deg}, "radius must have a unit convertible to mm"),
    *((options, KIND) for options in ({"min_separation": 2 * MM}, {"targets": "poisson_disc"})),
    *(({**DISCS, "min_separation": one * MM}, LENGTH) for one in (0, np.nan)),
    ({**DISCS, "n_targets": 400}, "400 targets at least 5 mm apart do not fit into a circle with the radius 42.1"),
    ({**DISCS, "min_separation": 1 * u.nm}, "min_separation must be at least"),
]


@pytest.mark.parametrize(("options", "words"), BAD_TARGETS)
def test_bad_targets_are_named(options, words):
    refused(words, lambda: flat.collision_probability(lamost_like(1), max_iterations=4, **options))


def test_an_empty_catalog_has_no_mean_direction():
    empty, words = rs.Catalog(CENTER.reshape(1)[:0]), "targets must have at least one row"
    for options in ({}, {"center": CENTER}):
        refused(words, flat.collision_probability, tiny(), targets=empty, **options)
    words = "min_separation must have a unit convertible to mm, got arcsec"
    refused(words, RandomTargets, "poisson_disc", min_separation=1 * u.arcsec)


CHOICES = [
    ({"targets": "uniform", "n_targets": 100}, "conditional, the cheapest method with an error estimate"),
    ({"targets": "uniform", "n_targets": 14}, "conditional, the cheapest method with an error estimate"),
    ({"targets": "uniform", "n_targets": 13}, "monte_carlo, since there are fewer than 2 targets per"),
    (
        {"targets": "uniform", "n_targets": 200},
        "conditional, the cheapest method with an error estimate if positioners have queues of targets, with at "
        "most 24 targets of each queue",
    ),
    (
        {"targets": "uniform", "n_targets": 100, "allocator": "lamost_rule"},
        "monte_carlo, since this allocator makes no",
    ),
    ({"estimand": "independent"}, "quadrature, the cheapest method with an error estimate for independent"),
    ({"method": "monte_carlo", "targets": "uniform", "n_targets": 100}, "monte_carlo, as requested"),
]


@pytest.mark.parametrize(("options", "expected"), CHOICES)
def test_an_estimate_says_why_its_method_was_used(options, expected):
    plane = rs.FocalPlane.hexagonal(rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm), rings=1, pitch=25.6 * u.mm)
    estimate = flat.collision_probability(plane, precision=0.2, rng=1, **options)
    assert estimate.meta["choice"].startswith(expected)
    far = rs.FocalPlane.hexagonal(rs.Positioner(4 * u.mm, 4 * u.mm, 1 * u.mm), rings=1, pitch=30 * u.mm)
    assert flat.collision_probability(far, **options).meta["choice"] == "no two arms can touch"


def test_options_have_short_representations():
    assert repr(RandomTargets()) == "RandomTargets('uniform')"
    assert repr(RandomTargets("poisson", radius=6 * u.cm)) == "RandomTargets('poisson', radius=<Quantity 6. cm>)"
    assert repr(Precision()) == "Precision()"
    assert repr(Precision(0.01, interval="bootstrap")) == "Precision(0.01, interval='bootstrap')"


def test_a_kind_and_a_standard_error_are_short_for_options():
    plane = lamost_like(1)
    short = rs.collision_probability(plane, targets="poisson", precision=0.02)
    full = rs.collision_probability(plane, targets=RandomTargets("poisson"), precision=Precision(0.02))
    assert (short.value, short.n, short.meta) == (full.value, full.n, full.meta)
    default = rs.collision_probability(plane)
    assert (default.meta["targets"], default.n) == ("uniform", rs.collision_probability(plane, precision=0.001).n)


def test_auto_is_the_default_and_limits_the_targets_of_a_queue():
    plane = rs.FocalPlane.hexagonal(rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm), rings=1, pitch=25.6 * u.mm)
    options = {"n_targets": 400, "max_iterations": 20, "rng": 1}
    default = flat.collision_probability(plane, **options)
    assert default.value == flat.collision_probability(plane, method="auto", **options).value
    assert default.value == flat.collision_probability(plane, method="conditional", most_entries=24, **options).value
    assert default.value != flat.collision_probability(plane, method="conditional", **options).value
    more = flat.collision_probability(plane, most_entries=1000, **options)
    assert more.value == flat.collision_probability(plane, method="conditional", **options).value
    one_each = flat.collision_probability(plane, n_targets=10, max_iterations=20, most_entries=5)
    assert one_each.method == "conditional"
    sky = np.random.default_rng(1).uniform(-40, 40, (400, 2)) * u.mm
    exact = flat.collision_probability(plane, method="conditional", targets=sky)
    assert flat.collision_probability(plane, targets=sky).value == exact.value  # given targets need one realization
