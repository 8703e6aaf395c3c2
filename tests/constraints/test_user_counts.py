"""A constraint of a user that asks for sky fibers in each quadrant of the focal plane."""

from dataclasses import dataclass

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from raising import warned

import rfpsurvey as rs
from rfpsurvey.constraints import Group

CENTER = SkyCoord("6h20m +23d")


def quadrant(xy):
    return 2 * (xy[:, 0] > 0).astype(int) + (xy[:, 1] > 0)


@dataclass(frozen=True)
class InQuadrant(rs.Requirement):
    def groups(self, problem):
        targets, place = problem.kind == self.what, quadrant(problem.focal_plane.arrays.xy)
        return [Group(self, None, targets, place == k, f"quadrant {k}") for k in range(4)]


@dataclass(frozen=True)
class SkyInQuadrants(rs.constraints.Constraint):
    minimum: int
    maximum: int

    name = "sky_in_quadrants"
    uses_targets = False

    @property
    def counts(self):
        return (InQuadrant("sky", self.minimum, self.maximum),)


@pytest.fixture(scope="module")
def sky(small):
    """Return targets of which most sky positions are in one half of the field."""
    sky = rs.synthetic_catalog("uniform", CENTER, small.field_radius, n_targets=400, rng=3)
    rng, fraction = np.random.default_rng(4), np.where(sky.coord.ra > CENTER.ra, 0.5, 0.08)
    return rs.Catalog(sky.coord, kind=np.where(rng.random(400) < fraction, "sky", "science"))


@pytest.mark.parametrize("allocator", ["lamost_rule", "network_flow", "optimal", "repair"])
def test_every_quadrant_has_its_sky_fibers(sky, small, allocator):
    asked = rs.AllocationOptions(allocator, constraints=SkyInQuadrants(2, 4))
    tile = rs.plan_tile(sky, small, CENTER, allocator=asked)
    place = quadrant(small.focal_plane.arrays.xy)
    n = np.bincount(place[np.asarray(tile.table["kind"]) == "sky"], minlength=4)
    assert (n >= 2).all()
    assert allocator == "lamost_rule" or (n <= 4).all()  # lamost ignores maxima
    assert bool(tile.summary["unmet"]) == (n > 4).any()
    assert tile.provenance["parameters"]["constraints"] == ["sky_in_quadrants 2 4"]
    plain = rs.plan_tile(sky, small, CENTER, allocator=rs.AllocationOptions(allocator, requirements=["sky=8-16"]))
    unequal = np.bincount(place[np.asarray(plain.table["kind"]) == "sky"], minlength=4)
    assert ((unequal < 2) | (unequal > 4)).any()


def test_quadrants_that_lack_sky_fibers_are_named(sky, small):
    few = sky[np.flatnonzero((sky.kind == "science") | (sky.coord.ra.deg > CENTER.ra.deg + 0.15))]
    asked = rs.AllocationOptions("optimal", constraints=SkyInQuadrants(2, 20))
    survey = warned("4 missing in 1 of 1 tile", rs.plan_survey, few, small, CENTER, allocator=asked)
    tile = rs.plan_tile(few, small, CENTER, allocator=asked)
    has_sky = np.asarray(tile.table["kind"]) == "sky"
    n = np.bincount(quadrant(small.focal_plane.arrays.xy)[has_sky], minlength=4)
    lacking = np.flatnonzero(n < 2)
    assert 0 < len(lacking) < 4
    assert len(tile.summary["unmet"]) == len(lacking) == survey.tiles["n_unmet"][0]
    for k, text in zip(lacking, tile.summary["unmet"], strict=True):
        assert text.startswith(f"sky targets in quadrant {k}: {n[k]} of 2, {2 - n[k]} missing")
    assert survey.tiles["unmet"].tolist() == [f"sky=2-20: {np.maximum(2 - n, 0).sum()} missing"]
