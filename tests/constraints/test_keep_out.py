"""Circles that no arm may cover, and their text."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs


def numbers_of(text):
    return [float(word) for word in text.split()[1:]]


@pytest.mark.parametrize("seed", range(3))
def test_the_numbers_of_circles_are_those_that_were_given(seed):
    """Regression: they were computed from the unit vector, so that 23.15 became 23.149999999999995."""
    rng = np.random.default_rng(seed)
    for ra, dec, radius in zip(
        rng.uniform(0, 360, 300), rng.uniform(-90, 90, 300), rng.uniform(0, 1, 300), strict=True
    ):
        given = f"{ra:.2f} {dec:.2f} {radius + 0.001:.3f}"
        circle = rs.KeepOut.parse(given)
        assert numbers_of(str(circle)) == [float(word) for word in given.split()]
        assert str(rs.constraints.as_constraints(str(circle))[0]) == str(circle)
    assert str(rs.KeepOut.parse("-5.1 2 0.1")) == "keep_out -5.1 2.0 0.1"
    sky = SkyCoord(95.14, 23.15, unit="deg")
    assert str(rs.KeepOut(rs.Region.cap(sky, 0.058 * u.deg))) == "keep_out 95.14 23.15 0.058"
    galactic = str(rs.KeepOut(rs.Region.cap(sky.galactic, 0.058 * u.deg)))
    np.testing.assert_allclose(numbers_of(galactic), [95.14, 23.15, 0.058], rtol=1e-12)


def test_a_survey_is_resumed_with_the_circles_that_it_records(tmp_path):
    tiles = SkyCoord([95] * u.deg, [23] * u.deg)
    stars = rs.synthetic_catalog("poisson", tiles[0], 1.5 * u.deg, density=30 / u.deg**2, rng=1)

    def plan(*texts, **more):
        options = rs.AllocationOptions("repair", constraints=texts)
        return rs.plan_survey(stars, "sdss_apo", tiles, allocator=options, folder=tmp_path / "plan", **more)

    recorded = plan("keep_out 95.14 23.15 0.058").provenance["parameters"]["keep_out"]
    plan(*(text.replace("cap", "keep_out") for text in recorded), resume=True)


def test_the_radii_around_bright_stars_keep_all_digits():
    text = str(rs.constraints.BrightStars("g", radius=[(10.1, 0.1 + 0.2), (12.3, 1 / 3)]))
    assert repr(0.1 + 0.2) in text
    assert repr(1 / 3) in text
