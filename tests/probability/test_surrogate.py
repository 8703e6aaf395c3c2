"""Designs: the surrogate compared with quadrature and simulation."""

import astropy.units as u
import numpy as np
import pytest
from raising import refused

import rfpsurvey as rs
from rfpsurvey._studies.quadrature import environments
from rfpsurvey._studies.surrogate import AXES, interior_probability

MM = u.mm
PITCH = 31.0


def designs_of(rng, n):
    """Return random designs in the range of the paper, none of which is a node of the grid."""
    central_arm, ratio, pitch, distance = rng.uniform((7.25, 1, 24.6, 1), (14.5, 2, 35, 7), (n, 4)).T
    return central_arm, central_arm * ratio, pitch, distance


@pytest.mark.exhaustive
def test_the_surrogate_agrees_with_quadrature_at_designs_it_never_saw(rng):
    central_arm, eccentric_arm, pitch, distance = designs_of(rng, 40)
    got = rs.probability.surrogate_probability(central_arm * MM, eccentric_arm * MM, pitch * MM, distance * MM)
    jobs = zip(central_arm / pitch, eccentric_arm / central_arm, distance / pitch, rng.spawn(40), strict=True)
    want = np.array([interior_probability((a, b, c), 512, own)[0] for a, b, c, own in jobs])
    assert np.abs(got - want).max() < 0.005
    assert 1 - ((got - want) ** 2).sum() / ((want - want.mean()) ** 2).sum() > 0.9999


def test_the_surrogate_agrees_with_plain_simulation_of_a_large_array(rng):
    plane = rs.FocalPlane.hexagonal(rs.Positioner(9 * MM, 14 * MM, 2 * MM), rings=5, pitch=27 * MM)
    middle, n, m = np.hypot(*plane.xy.to_value("mm").T) < 2.1 * 27, 3000, len(plane)
    r = np.maximum(np.sqrt(rng.uniform(5.0**2, 23.0**2, (n, m))) * (1 - 1e-12), 5.0 + 1e-9)
    alpha = rng.uniform(0, 2 * np.pi, (n, m))
    tips = plane.xy.to_value("mm") + np.stack([r * np.cos(alpha), r * np.sin(alpha)], axis=-1)
    rate = rs.collision.count_collisions(plane, tips * MM).per_positioner[middle].mean() / n
    # neighbors share collisions, so that the variance is at most doubled
    error = 2 * np.sqrt(rate * (1 - rate) / (n * middle.sum()))
    assert abs(rs.probability.surrogate_probability(9 * MM, 14 * MM, 27 * MM, 4 * MM) - rate) < 3 * error + 0.003


def test_only_the_shape_matters():
    one = rs.probability.surrogate_probability(8 * MM, 12 * MM, 26 * MM, 4 * MM)
    assert one == pytest.approx(
        rs.probability.surrogate_probability(0.8 * u.cm, 1.2 * u.cm, 2.6 * u.cm, 0.4 * u.cm), abs=1e-12
    )
    assert one == pytest.approx(rs.probability.surrogate_probability(80 * MM, 120 * MM, 260 * MM, 40 * MM), abs=1e-12)


def test_arms_that_cannot_touch_never_collide():
    assert rs.probability.surrogate_probability(7.25 * MM, 7.25 * MM, 35 * MM, 1 * MM) == 0
    assert rs.probability.surrogate_probability([7.25] * 2 * MM, 7.25 * MM, 35 * MM, 1 * MM).tolist() == [0, 0]


OUTSIDE_THE_GRID = [
    ((20, 20, 25, 4), "central arm over pitch must be from 0.2 to 0.6, got 0.8"),
    ((8, 7, 25, 4), "eccentric over central arm must be from 1 to 3"),
    ((8, 25, 25, 4), "eccentric over central arm must be from 1 to 3"),
    ((8, 8, 25, 0.1), "minimum separation over pitch must be from 0.02 to 0.3"),
    ((8, np.nan, 25, 4), "eccentric over central arm"),
    ((8, 8, 0, 4), "positive lengths"),
    ((np.nan, 8, 25, 4), "positive lengths"),
]


@pytest.mark.parametrize(("design", "words"), OUTSIDE_THE_GRID)
def test_the_surrogate_does_not_extrapolate(design, words):
    refused(words, lambda: rs.probability.surrogate_probability(*(v * MM for v in design)))


def test_arguments_of_the_surrogate_need_units_and_fitting_shapes():
    make, others = rs.probability.surrogate_probability, (25 * MM, 4 * MM)
    refused("central_arm must be a Quantity", make, 8, 8 * MM, *others)
    refused("shapes that can be broadcast", make, [8, 9] * MM, [8, 9, 10] * MM, *others)


def test_the_table_of_the_surrogate_can_be_made_again(tmp_path, monkeypatch):
    from reproduction import _surrogate

    few = {name: nodes[::8] for name, nodes in AXES.items()}
    monkeypatch.setattr(_surrogate, "AXES", few)
    monkeypatch.setattr(_surrogate, "N_POINTS", 64)
    _surrogate.make_surrogate(tmp_path / "some.npz")
    with np.load(tmp_path / "some.npz") as data:
        risk = data["risk"]
    assert risk.shape == tuple(len(n) for n in few.values())
    shipped = rs.probability.surrogate_probability(
        few["central arm over pitch"][1] * PITCH * MM,
        few["central arm over pitch"][1] * few["eccentric over central arm"][1] * PITCH * MM,
        PITCH * MM,
        few["minimum separation over pitch"][1] * PITCH * MM,
    )
    assert risk[1, 1, 1] == pytest.approx(shipped, abs=0.02)
    refused("exists", _surrogate.make_surrogate, tmp_path / "some.npz")


def test_environments_of_an_irregular_plane_are_all_different(rng):
    plane = rs.FocalPlane(rng.uniform(-60, 60, (20, 2)) * MM, rs.Positioner(8 * MM, 8 * MM, 2 * MM))
    assert len(environments(plane, 200.0)[0]) == 20
