from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from raising import refused

import rfpsurvey as rs
from oracles import annuli_coverage, in_annulus

MM = u.mm


def plane(l1=8.25, l2=8.25, rings=2):
    return rs.FocalPlane.hexagonal(rs.Positioner(l1 * MM, l2 * MM, 2.25 * MM), rings=rings, pitch=25.6 * MM)


@pytest.mark.few(2)
@pytest.mark.parametrize(("l1", "l2"), [(8.25, 8.25), (8.0, 17.0), (5.0, 14.0), (3.0, 3.0)])
def test_coverage_is_that_of_an_exact_overlay(l1, l2):
    design = plane(l1, l2)
    found, truth = design.coverage(), annuli_coverage(design, design.xy.value)
    assert found.sum() == pytest.approx(1)
    assert np.abs(np.pad(found, (0, 20 - len(found))) - truth).max() < 0.0015


def test_multiplicity_counts_annuli():
    design, xy = plane(5.0, 14.0), np.random.default_rng(3).uniform(-60, 60, (500, 2))
    truth = [sum(in_annulus(point, center, 5.0, 14.0) for center in design.xy.value) for point in xy]
    np.testing.assert_array_equal(design.multiplicity(xy * MM), truth)
    assert design.multiplicity([[np.nan, 0.0]] * MM).tolist() == [0]


def test_units_out_of_use_reach_nothing():
    assert replace(plane(), disabled=np.ones(19, bool)).coverage(n_points=1000).tolist() == [1.0]


def test_footprint_is_the_hexagon_of_centers():
    assert plane().footprint.to_value(MM**2) == pytest.approx(3 * np.sqrt(3) / 2 * (2 * 25.6) ** 2)


@pytest.mark.parametrize("centers", [[[0, 0]], [[0, 0], [9, 9]], [[0, 0], [20, 20], [40, 40]]])
def test_centers_on_a_line_have_no_footprint(centers):
    line = rs.FocalPlane(centers * MM, plane().positioner)
    refused("three centers that are not on a line", line.coverage)


@pytest.mark.parametrize("n_points", [0, 1.5, True, 2**27, "many"])
def test_points_are_a_whole_number(n_points):
    refused("n_points must be a whole number from 1", lambda: plane().coverage(n_points=n_points))
