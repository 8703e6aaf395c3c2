"""Distortion maps of a dispersion compensator: invented ray traces, and the real one of DESI."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import Table
from raising import refused

import rfpsurvey as rs

CENTER = SkyCoord(150 * u.deg, 32 * u.deg)


def image(x, y, strength):
    """Return an invented ray trace, symmetric about y = 0 if y and the strength change their signs."""
    r2 = x**2 + y**2
    along_x = 14000 * x * (1 + 90 * r2) + 3000 * x * y * np.sin(strength) + 0.01 * np.cos(strength)
    along_y = (
        14000 * y * (1 + 90 * r2)
        - 5 * np.sin(strength)
        + 2000 * y**2 * np.sin(strength)
        + 0.5 * y * np.cos(2 * strength)
    )
    return np.array([along_x, along_y])


@pytest.fixture(scope="module")
def traced(tmp_path_factory):
    rng, rows = np.random.default_rng(5), []
    for angle in range(-180, 1, 20):
        r, turn = 0.028 * np.sqrt(np.append(rng.random(150), 1.0)), 2 * np.pi * rng.random(151)
        x, y = r * np.cos(turn), r * np.sin(turn)
        rows += zip(np.full(151, angle), np.full(151, -angle), x, y, *image(x, y, np.deg2rad(angle)), strict=True)
    path = tmp_path_factory.mktemp("trace") / "trace.csv"
    Table(rows=rows, names=["ADC1", "ADC2", "X_TAN", "Y_TAN", "X_FP", "Y_FP"]).write(path)
    return path


def targets(n=200, radius=0.027):
    rng = np.random.default_rng(6)
    r, turn = radius * np.sqrt(rng.random(n)), 2 * np.pi * rng.random(n)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn)])


@pytest.mark.few(2)
@pytest.mark.parametrize("strength", [-170, -33, 0, 40, 90])
def test_the_map_is_that_of_the_ray_trace(traced, strength):
    """Positive strengths are not in the table; they follow from the symmetry."""
    found = rs.projection.DistortionMap.from_ray_trace(traced).at([strength, -strength] * u.deg)
    assert found.residuals["max"].max() < 1e-9 * u.mm
    assert len(found.residuals) == 10
    tangents = targets()
    x, y = tangents.T
    center = image(0.0, 0.0, np.deg2rad(strength))
    expected = (image(-x, y, np.deg2rad(strength)).T - center) * [-1, 1]
    np.testing.assert_allclose(found.project(tangents), expected, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.shift.value, center * [-1, 1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.project(np.zeros((1, 2))), 0, atol=1e-12)


def test_the_mean_angle_rotates_the_compensator(traced):
    plain = replace(rs.projection.DistortionMap.from_ray_trace(traced), mirrored=False)
    angle = np.deg2rad(25)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    tangents = targets()
    expected = plain.at([-60, 60] * u.deg).project(tangents @ turn) @ turn.T
    np.testing.assert_allclose(plain.at([-35, 85] * u.deg).project(tangents), expected, rtol=0, atol=1e-9)
    assert np.abs(expected - plain.at([-60, 60] * u.deg).project(tangents)).max() > 0.1


@pytest.mark.parametrize("adc", [(0, 0), (-90, 90), (20, 75)])
def test_the_round_trip_is_exact_and_the_outside_is_nan(traced, adc):
    found = rs.projection.DistortionMap.from_ray_trace(traced).at(adc * u.deg)
    xy = found.project(targets())
    np.testing.assert_allclose(found.project(found.unproject(xy)), xy, rtol=0, atol=1e-9)
    assert np.isnan(found.project(np.array([[0.03, 0.0]]))).all()
    assert np.isnan(found.unproject(np.array([[450.0, 0.0], [1e6, 0.0], [np.nan, 0.0]]))).all()
    angles = found.to_angle([100, 1e4] * u.mm)
    assert np.isfinite(angles[0])
    assert np.isnan(angles[1])
    edge = np.tan(angles[0].to_value(u.rad)) * np.array([[np.cos(t), np.sin(t)] for t in np.linspace(0, 7, 300)])
    assert np.hypot(*found.project(edge).T).min() >= 100 - 1e-2
    step = 1e-7
    scales = np.linalg.svd((found.project(step * np.eye(2)) - found.project(-step * np.eye(2))) / (2 * step))[1]
    assert found.plate_scale.to_value(u.mm / u.rad) == pytest.approx(np.sqrt(np.prod(scales)), rel=1e-6)


def test_the_inverse_needs_few_steps(traced, monkeypatch):
    found, solve, calls = rs.projection.DistortionMap.from_ray_trace(traced), np.linalg.solve, []
    monkeypatch.setattr(np.linalg, "solve", lambda *arguments: calls.append(1) or solve(*arguments))
    found.unproject(found.project(targets()))
    assert 1 < len(calls) < 7


def test_fields_are_projected_and_planned(traced, presets):
    found = rs.projection.DistortionMap.from_ray_trace(traced).at([-60, 60] * u.deg)
    desi = replace(presets["desi"], plate_scale=None, distortion=found)
    conditions = rs.ObservingConditions("kitt peak", hour_angle=2 * u.hourangle)
    for given in (None, conditions):
        plane = desi.projection(CENTER, 15 * u.deg, given)
        coord = CENTER.directional_offset_by(np.arange(0, 360, 20) * u.deg, 1.4 * u.deg)
        assert plane.to_sky(plane.to_focal_plane(coord)).separation(coord).max() < 1e-9 * u.deg
    tangents = rs.projection.TangentPlane(CENTER, 1 * u.mm / u.rad, 15 * u.deg).to_focal_plane(coord).value
    static = desi.projection(CENTER, 15 * u.deg).to_focal_plane(coord).value
    np.testing.assert_allclose(static, found.project(tangents), rtol=0, atol=1e-9)
    sky = rs.synthetic_catalog("poisson", CENTER, 1.6 * u.deg, density=700 / u.deg**2, rng=1)
    assert rs.plan_tile(sky, desi, CENTER, conditions=conditions).summary["n_assigned"] > 2000
    assert (
        desi.provenance["digest"]
        != replace(desi, plate_scale=None, distortion=found.at([0, 0] * u.deg)).provenance["digest"]
    )


def test_the_ray_trace_of_desi_is_reproduced(real_data, presets):
    path = real_data("desi") / "raytrace-tan2fp-4957-v18.csv.gz"
    found = rs.projection.DistortionMap.from_ray_trace(path)
    assert len(found.residuals) == 19
    assert found.residuals["max"].max() < 0.0015 * u.mm
    assert np.sqrt((found.residuals["rms"] ** 2).mean()) < 0.0003 * u.mm
    table = Table.read(path, format="ascii.csv")
    still = np.asarray(table["ADC1"]) == 0
    tangents = np.column_stack([table["X_TAN"], table["Y_TAN"]])[still]
    traced = np.column_stack([table["X_FP"], table["Y_FP"]])[still]
    # at ADC 0, also a radial map suffices: an odd polynomial of degree 5 in the tangent, after one shift
    r = np.hypot(*tangents.T)
    radial = np.array([tangents * (r**k)[:, None] for k in (0, 2, 4)])
    columns = [*radial.reshape(3, -1), np.tile([1.0, 0.0], len(r)), np.tile([0.0, 1.0], len(r))]
    columns /= np.abs(columns).max(axis=1)[:, None]
    solution = np.linalg.lstsq(columns.T, traced.ravel(), rcond=None)[0]
    left = (solution @ columns - traced.ravel()).reshape(-1, 2)
    assert np.hypot(*left.T).max() < 0.006
    # the map of the preset, which is a fit to another table
    theta = np.arctan(r) * u.rad
    xy = presets["desi"].distortion.to_radius(theta).value[:, None] * tangents / np.maximum(r, 1e-9)[:, None]
    left = xy - traced
    assert np.hypot(*(left - left.mean(axis=0)).T).max() == pytest.approx(0.057, abs=0.001)


def test_settings_that_are_not_in_the_ray_trace_of_desi_are_interpolated(real_data, tmp_path):
    """The map is fitted to every second setting, and compared with the others."""
    table = Table.read(real_data("desi") / "raytrace-tan2fp-4957-v18.csv.gz", format="ascii.csv")
    strength = np.asarray(table["ADC1"])
    table[strength % 20 == 0].write(tmp_path / "half.csv")
    half = rs.projection.DistortionMap.from_ray_trace(tmp_path / "half.csv")
    assert len(half.residuals) == 10
    left = {}
    for angle in np.unique(strength):
        rows = table[strength == angle]
        tangents = np.column_stack([-rows["X_TAN"], rows["Y_TAN"]])
        traced = np.column_stack([-rows["X_FP"], rows["Y_FP"]])
        found = half.at([angle, -angle] * u.deg)
        left[angle] = np.hypot(*(found.project(tangents) + found.shift.to_value(u.mm) - traced).T)
    assert max(left[angle].max() for angle in left) < 0.0015
    assert np.median(np.concatenate([left[angle] for angle in left if angle % 20])) < 0.0003
    for row in half.residuals:
        distance = left[row["adc1"].to_value(u.deg)]
        found = row["median"], row["rms"], row["max"]
        expected = np.median(distance), np.sqrt(np.mean(distance**2)), distance.max()
        np.testing.assert_allclose(u.Quantity(found).to_value(u.mm), expected, rtol=0, atol=1e-9)


WRONG_VALUES = [
    ({"coefficients": (1.0, 2.0)}, "coefficients must be 63 finite numbers"),
    ({"coefficients": "many"}, "coefficients must be a sequence of numbers"),
    ({"degree": 0}, "degree must be a whole number"),
    ({"harmonics": -1}, "harmonics must be a whole number"),
    ({"adc": 5 * u.deg}, "adc must be two finite angles"),
    ({"adc": [5, np.nan] * u.deg}, "adc must be two finite angles"),
    ({"max_angle": 95 * u.deg}, "max_angle must be"),
    ({"coefficients": (0.0,) * 63}, "invertible at the field center"),
]


@pytest.mark.few(2)
@pytest.mark.parametrize(("change", "text"), WRONG_VALUES)
def test_values_that_are_not_valid_are_errors(traced, change, text):
    found = rs.projection.DistortionMap.from_ray_trace(traced, degree=5, harmonics=1)
    refused(text, lambda: replace(found, **change))


WRONG_RAY_TRACES = [
    (lambda table: table.remove_column("X_FP"), "must have the column 'X_FP'"),
    (lambda table: table.replace_column("X_FP", ["far"] * len(table)), "the columns must contain numbers"),
    (lambda table: table["X_FP"].__setitem__(3, np.nan), "all values must be finite"),
    (lambda table: table["ADC1"].__setitem__(3, 5), "ADC1 must be -ADC2"),
    (lambda table: table.remove_rows(slice(20, None)), "must have enough rows .* coefficients, got 20 rows"),
]


@pytest.mark.parametrize(("change", "text"), WRONG_RAY_TRACES)
def test_ray_traces_that_are_not_valid_are_errors(traced, tmp_path, change, text):
    table = Table.read(traced, format="ascii.csv")
    change(table)
    table.write(tmp_path / "trace.csv")
    refused(text, rs.projection.DistortionMap.from_ray_trace, tmp_path / "trace.csv")


def test_other_types_of_distortion_are_errors():
    with pytest.raises(rs.InputError, match="distortion must be a RadialMap, a DistortionMap, or a dict"):
        rs.projection.TangentPlane(CENTER, distortion="far")
