"""Bad input that once ended in an exception of another package, or in nonsense."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from test_regressions import CENTER, MM, few

import rfpsurvey as rs
from rfpsurvey.collision import place_arms


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda s: rs.plan_tile(few(), 5, CENTER),
            "instrument must be an Instrument, the name of a preset or the path of a TOML file, got 5",
        ),
        (lambda s: rs.plan_tile(few(), s, CENTER, rng="x"), "rng must be a seed of at least 0, a numpy Generator"),
        (lambda s: rs.plan_tile(few(), s, CENTER, rng=-1), "rng must be a seed of at least 0"),
        (lambda s: rs.plan_tile(few(), s, CENTER, position_angle=[1, 2] * u.deg), "rotation must be one value"),
        (lambda s: rs.plan_tile(few(), s, CENTER, position_angle=np.nan * u.deg), "rotation must be one finite value"),
        (lambda s: few().within(CENTER, -1 * u.deg), "radius must be one finite value of at least 0 rad"),
        (lambda s: few().at_epoch(57388), "a Julian year from 1700 to 2300"),
        (lambda s: few(2, priority=["a", "b"]), "priority must be numbers"),
        (
            lambda s: s.projection(CENTER).to_focal_plane(SkyCoord([[1, 2]], [[1, 2]], unit="deg")),
            r"coord must have the shape",
        ),
        (
            lambda s: rs.find_collisions(s.focal_plane, s.focal_plane.xy, theta=np.zeros(37) * u.deg),
            "give either tips, or both",
        ),
        (
            lambda s: rs.find_collisions(
                s.focal_plane, place_arms(rs.FocalPlane([[0, 0]] * MM, s.focal_plane.positioner), [[1, 0]] * MM)
            ),
            "the arms are those of 1 positioners, not of 37",
        ),
        (lambda s: rs.allocate(s.focal_plane, [[1, 2]] * MM).place_arms(s), "got Instrument; an Instrument has one"),
        (lambda s: replace(s.focal_plane, stuck=np.full((37, 2), [30, np.nan]) * u.deg), "stuck must give both theta"),
        (lambda s: replace(s.focal_plane, obstacles=[[np.nan, 0, 1]] * MM), "obstacles must be finite rows"),
        (lambda s: replace(s.focal_plane, id=3), "id must have one value a positioner"),
        (
            lambda s: rs.synthetic_catalog("uniform", CENTER, 1 * u.deg, n_targets="ten"),
            "the number of targets must be one",
        ),
        (lambda s: rs.synthetic_catalog("uniform", CENTER, [1, 2] * u.deg, n_targets=1), "radius must be one value"),
        (lambda s: rs.synthetic_catalog("uniform", CENTER, 1 * u.deg, n_targets=1e30), "from 0 to 1e.09"),
        (lambda s: rs.FocalPlane.hexagonal(s.focal_plane.positioner, radius=np.nan * MM, pitch=8 * MM), "radius must"),
    ],
)
def test_bad_input_is_a_sentence(small, call, message):
    """These ended in exceptions of other packages, or in nonsense."""
    with pytest.raises(rs.InputError, match=message):
        call(small)
