"""Derived quantities of instruments, compared with formulas, shapely, and random directions on the sky."""

import astropy.units as u
import numpy as np
import pytest
import shapely
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from oracles import annuli_coverage
from rfpsurvey._instruments.facts import fact_texts

MM = u.mm
DEG2 = (np.pi / 180) ** 2


def lattice(rings=4, l1=8.25, l2=8.25, pitch=25.6, scale=200 * u.mm / u.deg, **columns):
    unit = rs.Positioner(l1 * MM, l2 * MM, 2.25 * MM)
    return rs.Instrument(
        "own", rs.FocalPlane.hexagonal(unit, rings=rings, pitch=pitch * MM, **columns), plate_scale=scale
    )


def hull_of(plane):
    centers, radius = shapely.points(plane.arrays.xy), plane.arrays.outer_radius
    # a patrol area inside the hull of all centers does not change the area
    outer = shapely.distance(centers, shapely.convex_hull(shapely.multipoints(centers)).boundary) <= radius
    discs = shapely.buffer(centers[outer], radius[outer], quad_segs=512)
    return shapely.convex_hull(shapely.multipoints(shapely.get_coordinates(discs)))


def test_a_hexagonal_grid_has_the_facts_of_the_closed_forms():
    facts = lattice(rings=4).facts()
    side, reach, focal_length = 4 * 25.6, 16.5, 200 / np.deg2rad(1)
    assert facts["positioners"] == facts["usable_positioners"] == 61
    assert (facts["field_shape"], facts["pitch"].to_value(MM)) == ("hexagon", 25.6)
    assert (facts["patrol_radius"].to_value(MM), facts["inner_patrol_radius"].to_value(MM)) == (reach, 0)
    assert facts["focal_plane_radius"].to_value(MM) == pytest.approx(side + reach, abs=1e-9)
    assert facts["field_radius"].to_value(u.rad) == pytest.approx(np.arctan((side + reach) / focal_length), rel=1e-9)
    hexagon = 1.5 * np.sqrt(3) * side**2
    assert facts["footprint"].to_value(MM**2) == pytest.approx(hexagon)
    # a hexagon with a margin as wide as the reach; on the sky it is smaller by (1 + t2) ** -1.5, with t below 0.0103
    area = (hexagon + 6 * side * reach + np.pi * reach**2) / 200**2
    assert area * (1 - 1.5 * 0.0103**2) < facts["field_of_view"].to_value(u.deg**2) < area
    assert facts["coverage"] == 1  # the reach is larger than the distance to a corner of a cell, pitch / sqrt(3)
    assert facts["plate_scale"].to_value(u.mm / u.deg) == pytest.approx(200)
    assert facts["positioner_density"].to_value(u.deg**-2) == pytest.approx(61 / area, rel=2e-4)


@pytest.mark.parametrize(("l1", "l2"), [(8.25, 8.25), (8.0, 17.0), (5.0, 14.0), (6.0, 6.0)])
def test_coverage_and_multiplicity_are_those_of_an_exact_overlay(l1, l2):
    own = lattice(rings=2, l1=l1, l2=l2)
    truth, facts = annuli_coverage(own.focal_plane, own.focal_plane.xy.value), own.facts()
    assert facts["coverage"] == pytest.approx(1 - truth[0], abs=0.003)
    assert facts["multiplicity"] == pytest.approx(truth @ np.arange(len(truth)), abs=0.006)
    assert facts["max_multiplicity"] == np.flatnonzero(truth > 1e-4).max()


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["desi", "pfs", "sdss_apo"])
def test_the_field_of_view_is_that_of_random_directions(presets, name, rng):
    """Count uniform random directions around the center whose positions are in the hull of the patrol areas."""
    model = presets[name]
    if isinstance(model.distortion, dict):  # the fiber type with the larger field
        widest = max(model.distortion.values(), key=lambda m: m.to_angle(300 * MM))
        model = rs.Instrument(
            "one",
            rs.FocalPlane(model.focal_plane.xy, rs.Positioner(7.4 * MM, 14.96972281 * MM, 2 * MM)),
            distortion=widest,
        )
    center = SkyCoord(0 * u.deg, 0 * u.deg)
    n, cap = 400_000, model.field_radius.to_value(u.rad) * 1.001
    angle, turn = np.arccos(1 - rng.random(n) * (1 - np.cos(cap))), rng.random(n) * 360
    xy = model.projection(center).to_focal_plane(center.directional_offset_by(turn * u.deg, angle * u.rad)).value
    inside = shapely.contains_xy(hull_of(model.focal_plane), *np.nan_to_num(xy, nan=1e9).T)
    area = 2 * np.pi * (1 - np.cos(cap)) / DEG2
    error = area * np.sqrt(inside.mean() * (1 - inside.mean()) / n)
    assert presets[name].facts()["field_of_view"].to_value(u.deg**2) == pytest.approx(
        area * inside.mean(), abs=5 * error + 1e-4 * area
    )


@pytest.mark.exhaustive
def test_published_fields_of_view(presets):
    """The values are DESI: 8 deg2 within 1.6 deg; PFS: 1.25 deg2; MOONS: 500 arcmin2; LAMOST: diameter of 5 deg."""
    for name, area, tolerance in (
        ("desi", 8, 0.07),
        ("pfs", 1.25, 0.03),
        ("moons", 0.1389, 0.03),
        ("lamost", 19.6, 0.03),
    ):
        assert presets[name].facts()["field_of_view"].to_value(u.deg**2) == pytest.approx(area, rel=tolerance)


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("name", "shape"), [("lamost", "circle"), ("desi", "circle"), ("pfs", "hexagon"), ("sdss_apo", "hexagon")]
)
def test_shapes_of_fields(presets, name, shape):
    assert presets[name].facts()["field_shape"] == shape


@pytest.mark.few(3)
@pytest.mark.parametrize("turn", [0, 20, 77])
@pytest.mark.parametrize(("corners", "shape"), [(3, "triangle"), (4, "square"), (6, "hexagon"), (40, "circle")])
def test_shapes_of_polygons_of_any_orientation_and_place(corners, shape, turn):
    angle = np.deg2rad(turn) + 2 * np.pi * np.arange(corners) / corners
    xy = 300 * np.column_stack([np.cos(angle), np.sin(angle)]) + [50, -20]
    assert (
        rs.Instrument(
            "own", rs.FocalPlane(xy * MM, lattice().focal_plane.positioner), plate_scale=100 * u.mm / u.deg
        ).facts()["field_shape"]
        == shape
    )
    long = rs.FocalPlane(xy * [1, 0.4] * MM, lattice().focal_plane.positioner)
    assert rs.Instrument("own", long, plate_scale=100 * u.mm / u.deg).facts()["field_shape"] == "irregular"


def test_a_field_beside_the_axis_has_the_area_of_its_hull():
    xy = lattice(rings=2).focal_plane.xy + [150, 80] * MM
    aside = rs.Instrument("a", rs.FocalPlane(xy, lattice().focal_plane.positioner), plate_scale=20 * u.m / u.deg)
    area = hull_of(aside.focal_plane).area / 20_000**2
    assert aside.facts()["field_of_view"].to_value(u.deg**2) == pytest.approx(area, rel=1e-4)


def test_one_positioner_has_a_field_but_no_pitch_and_no_coverage():
    facts = lattice(rings=0).facts()
    assert facts["field_of_view"].to_value(u.deg**2) == pytest.approx(np.pi * 16.5**2 / 200**2, rel=1e-3)
    assert facts["field_shape"] == "circle"
    assert np.isnan([facts["pitch"].value, facts["coverage"], facts["multiplicity"], facts["footprint"].value]).all()
    assert fact_texts(facts)["coverage"] == "undefined"


def test_units_out_of_use_and_fiber_types_are_counted(presets):
    own = lattice(rings=1, fiber_type=["A"] * 4 + ["A+B"] * 3, disabled=np.arange(7) == 2).facts()
    assert (own["positioners"], own["usable_positioners"], own["fibers"]) == (7, 6, {"A": 7, "B": 3})
    facts = presets["sdss_apo"].facts()
    assert facts["fibers"] == {"BOSS": 500, "APOGEE": 298}
    assert (facts["obstacles"], facts["spectrographs"]) == (46, 2)
    assert len(facts["published"]) + len(facts["derived"]) + len(facts["assumed"]) == len(presets["sdss_apo"].values)
    assert "positioner.clearance" in presets["lamost"].facts()["derived"]


def test_instruments_and_positioners_are_shown_in_a_line():
    own = lattice()
    assert repr(own) == "<Instrument 'own': 61 positioners, field 1.189 deg across, layout nominal>"
    assert repr(own.focal_plane.positioner) == (
        "<Positioner: arms 8.25 + 8.25 mm, clearance 2.25 mm, minimum separation 4.5 mm>"
    )
    other = rs.Positioner(0.8 * u.cm, 17 * MM, 2 * MM, handedness="both", arm_model="fiber_tip")
    assert repr(other) == ("<Positioner: arms 8 + 17 mm, clearance 2 mm, minimum separation 4 mm, both, fiber_tip>")
    html = own._repr_html_()
    assert html.startswith("<p>Instrument &#x27;own&#x27;: 61 positioners")
    assert "<th>multiplicity</th>" in html
    assert "<th>field shape</th><td>hexagon</td>" in html
