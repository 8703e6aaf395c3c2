import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from raising import refused
from scipy import stats
from scipy.spatial import cKDTree

import rfpsurvey as rs

DEG = u.deg
CENTERS = [(0, 0), (359.9, 40), (120, 90), (77, -90), (200, -30)]
OPTIONS = {
    "uniform": {"n_targets": 4000},
    "poisson": {"density": 60 / u.deg**2},
    "poisson_disc": {"min_separation": 0.05 * DEG, "n_targets": 4000},
    "clustered": {"density": 60 / u.deg**2, "cluster_scale": 0.05 * DEG, "cluster_size": 5},
}


def sky(kind, center, radius=5, **options):
    return rs.synthetic_catalog(kind, SkyCoord(*center, unit="deg"), radius * DEG, **{**OPTIONS[kind], **options})


@pytest.mark.few(5)
@pytest.mark.parametrize("kind", OPTIONS)
@pytest.mark.parametrize("center", CENTERS)
def test_points_are_true_to_area(kind, center):
    """The area within a circle increases as sin^2(r / 2), and azimuths are uniform (Kolmogorov-Smirnov test at 1 in
    10^4).
    """
    seeds = range(6) if kind == "clustered" else range(1)
    catalogs = [sky(kind, center, rng=100 + k) for k in seeds]
    middle = SkyCoord(*center, unit="deg")
    r = np.concatenate([c.coord.separation(middle).rad for c in catalogs])
    azimuth = np.concatenate([middle.position_angle(c.coord).rad for c in catalogs])
    assert r.max() <= np.deg2rad(5) * (1 + 1e-12)
    area = np.sin(r / 2) ** 2 / np.sin(np.deg2rad(2.5)) ** 2
    # members of a cluster are not independent; use only a few members of each cluster
    step = 10 if kind == "clustered" else 1
    assert stats.kstest(area[::step], "uniform").pvalue > 1e-4
    assert stats.kstest(azimuth[::step] / (2 * np.pi), "uniform").pvalue > 1e-4


def test_large_circles_and_the_whole_sphere():
    z = sky("uniform", (10, 20), radius=180, rng=1).coord.cartesian.xyz.value
    for axis in z:
        assert stats.kstest((axis + 1) / 2, "uniform").pvalue > 1e-4


def test_counts():
    assert len(sky("uniform", (0, 0), rng=1)) == 4000
    area = 2 * np.pi * (1 - np.cos(np.deg2rad(5))) * (180 / np.pi) ** 2
    numbers = np.array([len(sky("poisson", (0, 90), rng=k)) for k in range(300)])
    assert numbers.mean() == pytest.approx(60 * area, abs=5 * np.sqrt(60 * area / 300))
    assert numbers.var() / numbers.mean() == pytest.approx(1, abs=5 * np.sqrt(2 / 300))
    clustered = np.array([len(sky("clustered", (0, 90), rng=k)) for k in range(200)])
    # the variance of a Thomas process is (1 + cluster size) times the mean
    assert clustered.mean() == pytest.approx(60 * area, abs=5 * np.sqrt(6 * 60 * area / 200))
    assert clustered.var() / clustered.mean() == pytest.approx(6, rel=0.5)


def test_poisson_disc_keeps_its_distance():
    catalog = sky("poisson_disc", (359.99, 89), rng=2)
    chord = cKDTree(catalog.arrays.vectors).query(catalog.arrays.vectors, k=2)[0][:, 1]
    assert np.rad2deg(2 * np.arcsin(chord.min() / 2)) >= 0.05
    full = sky("poisson_disc", (0, 0), radius=1, n_targets=None, rng=3)
    # random sequential addition ends at 0.547 of the area; discs extend slightly beyond the edge
    assert 0.45 < (len(full) * np.pi * 0.025**2 / (np.pi * (1 + 0.025) ** 2)) < 0.56
    with pytest.raises(rs.InputError, match="targets at least 0.5 deg apart do not fit"):
        sky("poisson_disc", (0, 0), min_separation=0.5 * DEG, n_targets=4000, rng=1)


def test_clusters_have_their_size():
    """In a Thomas process, the mean number of additional neighbors within R is size (1 - exp(-R^2 / 4 sigma^2))."""
    excess = []
    for k in range(10):
        catalog = sky("clustered", (40, 20), rng=k, cluster_size=8.0)
        inner = catalog.coord.separation(SkyCoord(40, 20, unit="deg")) < 4.5 * DEG
        tree = cKDTree(catalog.arrays.vectors)
        near = (
            tree.query_ball_point(catalog.arrays.vectors[inner], 2 * np.sin(np.deg2rad(0.1) / 2), return_length=True)
            - 1
        )
        excess.append(near.mean() - 60 * np.pi * 0.1**2)
    assert np.mean(excess) == pytest.approx(8 * (1 - np.exp(-(0.1**2) / (4 * 0.05**2))), rel=0.08)


@pytest.mark.parametrize("kind", OPTIONS)
def test_rng_decides(kind):
    first, second, third = (
        sky(kind, (0, 0), rng=7),
        sky(kind, (0, 0), rng=np.random.default_rng(7)),
        sky(kind, (0, 0), rng=8),
    )
    np.testing.assert_array_equal(first.arrays.vectors, second.arrays.vectors)
    assert len(first) != len(third) or not np.array_equal(first.arrays.vectors, third.arrays.vectors)


BAD_INPUT = [
    ("poison", {"n_targets": 1}, "unknown kind of synthetic catalog 'poison'.* Did you mean 'poisson'"),
    ("uniform", {}, "n_targets or density must be given for a uniform catalog"),
    ("uniform", {"n_targets": 1, "density": 1 / u.deg**2}, "give either n_targets or density, but not both"),
    ("uniform", {"n_targets": -1}, "the number of targets must be from 0 to 1e.09, got -1"),
    ("poisson", {"density": 5}, "density must be a Quantity"),
    ("poisson", {"density": 5 / u.mm**2}, "density must have a unit convertible to 1 / sr"),
    ("poisson_disc", {"n_targets": 1}, "min_separation must be given"),
    ("clustered", {"n_targets": 1}, "cluster_scale must be given"),
    (
        "clustered",
        {"n_targets": 1, "cluster_scale": 90 * DEG},
        "cluster_scale must be one finite value above 0 deg and below 28 deg",
    ),
]


@pytest.mark.parametrize(("kind", "options", "message"), BAD_INPUT)
def test_bad_input_is_named(kind, options, message):
    refused(message, lambda: rs.synthetic_catalog(kind, SkyCoord(0, 0, unit="deg"), 1 * DEG, **options))


def test_bad_circles_are_named():
    make = rs.synthetic_catalog
    words = "radius must be one finite value above 0 deg and below 180 deg"
    refused(words, make, "uniform", SkyCoord(0, 0, unit="deg"), 0 * DEG, n_targets=1)
    refused("center must be a SkyCoord", make, "uniform", (0, 0), 1 * DEG, n_targets=1)


@pytest.mark.parametrize(
    ("name", "value"), [("min_separation", 1 * u.arcmin), ("cluster_size", -1), ("cluster_scale", 1 * u.arcmin)]
)
def test_options_of_other_kinds_have_no_effect(name, value):
    with pytest.warns(rs.RfpsurveyWarning, match=f"{name} has no effect with the kind 'uniform'"):
        rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 1 * u.deg, n_targets=3, **{name: value})
