"""Instruments with other arm models, and the outline of DESI."""

import json

import astropy.units as u
import desi_files
import numpy as np
import pytest
import shapely
from numpy.testing import assert_array_equal
from raising import refused

import rfpsurvey as rs

THETA = [[5.095, -0.474], [4.358, -2.5], [2.771, -2.5], [1.759, -2.792], [0.905, -0.356]]
UPPER, LOWER = (
    [[0.0, 0.99], [3.0, 0.99]],
    [[0.056, -1.339], [0.056, -2.015], [1.019, -1.757], [1.156, -0.99], [3, -0.99]],
)
LEGACY = {
    "theta": {"circles": [[[3.0, 0.0], 2.095]], "segments": [THETA]},
    "phi": {"circles": [[[3.0, 0.0], 0.967]], "segments": [UPPER, LOWER]},
}
"""The shapes named legacy in desimodel 0.20.0, inputs/focalplane.py."""
partial = pytest.mark.filterwarnings("ignore:.*DESI has 5000 positioners")


def union(parts):
    """Return the union of parts of an outline as a shape of shapely."""
    shapes = [(shapely.MultiPoint(vertices).convex_hull, radius) for vertices, radius in parts]
    return shapely.union_all([shape.buffer(radius, quad_segs=256) for shape, radius in shapes])


def enclosed(rings, circles, sign=1):
    """Return the area that closed lines and circles enclose."""
    shapes = [shapely.Polygon(np.array(ring) * [1, sign]) for ring in rings]
    shapes += [shapely.Point(x, sign * y).buffer(radius, quad_segs=256) for (x, y), radius in circles]
    return shapely.union_all(shapes)


def assert_legacy(outline, sign=1):
    n, phi = outline.n_eccentric, enclosed([UPPER + LOWER[::-1]], LEGACY["phi"]["circles"], sign)
    theta = enclosed([THETA], LEGACY["theta"]["circles"], sign)
    assert union(outline.parts[:n]).symmetric_difference(phi).area < 1e-9
    assert union(outline.parts[n:]).symmetric_difference(theta).area < 1e-9
    assert phi.area > 8
    assert theta.area > 15


def colliding_polygons(centers, theta, phi, n):
    """Return the pairs of the first n positioners whose published shapes overlap, except those of two central arms."""
    shapes = [enclosed([UPPER + LOWER[::-1]], LEGACY["phi"]["circles"]), enclosed([THETA], LEGACY["theta"]["circles"])]

    def placed(k):
        x, y = centers[k]
        c, s = np.cos(theta[k]), np.sin(theta[k])
        d, t = np.cos(theta[k] + phi[k]), np.sin(theta[k] + phi[k])
        move = shapely.affinity.affine_transform
        return move(shapes[0], [d, -t, t, d, x + 3 * c, y + 3 * s]), move(shapes[1], [c, -s, s, c, x, y])

    near = shapely.STRtree(shapely.points(centers)).query(shapely.points(centers), "dwithin", distance=16)
    found, parts = set(), {}
    for i, j in near.T.tolist():
        if i < j < n and np.isfinite(theta[[i, j]]).all():
            (a, b), (c, d) = (parts.setdefault(k, placed(k)) for k in (i, j))
            gap = max(shapely.intersection(p, q).area for p, q in ((a, c), (a, d), (b, c)))
            if gap > 1e-5:  # circles of shapely are polygons
                found.add((i, j))
    return found


def test_the_outline_of_desi_covers_the_published_shapes(presets):
    desi = presets["desi"]
    unit = desi.focal_plane.positioner
    assert_legacy(unit.outline)
    assert unit.clearance == unit.min_separation == 0 * u.mm
    assert desi.values["positioner.outline"]["status"] == "published"
    assert "positioner.full_outline" not in desi.values
    segment = desi.with_arm_model("elbow_to_tip")
    assert segment.focal_plane.positioner.outline is None
    assert segment.focal_plane.positioner.clearance == 0.99 * u.mm
    assert segment.provenance["digest"] != desi.provenance["digest"]
    assert_legacy(segment.with_arm_model("outline").focal_plane.positioner.outline)


def test_a_plan_of_desi_without_collisions_has_no_collisions_of_the_published_polygons(presets):
    """The arms of the preset were segments; plans without collisions of segments had more than 90 colliding pairs."""
    plane, rng = presets["desi"].focal_plane, np.random.default_rng(0)
    r, angle = 410 * np.sqrt(rng.random(5300)), rng.uniform(0, 2 * np.pi, 5300)
    xy, counts = np.column_stack([r * np.cos(angle), r * np.sin(angle)]) * u.mm, {}
    for allocator in ("repair", "balanced"):
        plan, tips = rs.allocate(plane, xy, allocator=allocator), np.full((len(plane), 2), np.nan)
        assigned = plan.target_of_positioner >= 0
        tips[assigned] = (xy[plan.target_of_positioner[assigned]] - plane.xy[assigned]).to_value(u.mm)
        theta, phi = (angle.to_value(u.rad) for angle in plane.positioner.inverse(tips * u.mm))
        counts[allocator] = len(colliding_polygons(plane.xy.to_value(u.mm), theta, phi, 2000))
        assert (len(rs.find_collisions(plane, plan).pairs) > 0) == (allocator == "balanced")
    assert counts["repair"] == 0
    assert counts["balanced"] > 30


def test_the_provenance_omits_arm_models_that_are_not_used(presets):
    desi = presets["desi"]
    assert "positioner.segment_clearance" not in desi.provenance["values"]
    assert "positioner.full_outline" not in desi.with_arm_model("elbow_to_tip").provenance["values"]


ARM_MODELS = [
    ("desi", ("outline", "elbow_to_tip", "fiber_tip")),
    ("sdss_apo", ("capsule", "elbow_to_tip", "fiber_tip")),
    ("pfs", ("elbow_to_tip", "fiber_tip")),
]


@pytest.mark.parametrize(("name", "models"), ARM_MODELS)
def test_all_arm_models_of_an_instrument_are_accepted(presets, name, models):
    instrument = presets[name]
    assert instrument.arm_models == models
    assert instrument.with_arm_model(models[0]) is instrument
    for model in models:
        other = instrument.with_arm_model(model)
        assert other.focal_plane.positioner.arm_model == model == other.values["positioner.arm_model"]["value"]
        assert_array_equal(other.focal_plane.xy, instrument.focal_plane.xy)


def test_other_arm_models_are_refused(presets):
    refused("must be one of elbow_to_tip, fiber_tip for pfs, got 'outline'", presets["pfs"].with_arm_model, "outline")
    refused("arm model", presets["pfs"].with_arm_model, "triangle")


def test_collisions_with_the_outline_of_desi_are_those_of_the_polygons(presets):
    """Two positioners collide if the published shapes overlap, except those of two central arms."""
    plane, rng = presets["desi"].focal_plane, np.random.default_rng(1)
    n = len(plane)
    theta, phi = rng.uniform(-np.pi, np.pi, n), rng.uniform(0, np.pi, n)
    report = rs.find_collisions(plane, plane.xy + plane.positioner.forward(theta * u.rad, phi * u.rad))
    found = colliding_polygons(plane.xy.to_value(u.mm), theta, phi, 600)
    own = {pair for pair in map(tuple, report.pairs.tolist()) if max(pair) < 600}
    assert found <= own
    assert len(own - found) <= 1
    assert len(found) > 20


@partial
@pytest.mark.parametrize("closed", [False, True])
def test_from_desi_mirrors_the_polygons_of_most_positioners(tmp_path, closed):
    table = desi_files.focal_plane(tmp_path / "desi-focalplane_2020-01-01T00:00:00.ecsv", per_petal=20)
    event = {"TIME": "2021-01-01T00:00:00", "LOCATION": 1003, "EXCLUSION": "other"}
    desi_files.state(tmp_path / "desi-state_2020-01-01T00:00:00.ecsv", table, [event])
    shapes = LEGACY
    if closed:
        rings = {"theta": THETA + THETA[:1], "phi": UPPER + LOWER[::-1] + UPPER[:1]}
        shapes = {name: {**LEGACY[name], "segments": [ring]} for name, ring in rings.items()}
    other = {"phi": {"segments": [[[0, 1], [3, 1], [3, -1]]], "circles": []}}
    path = tmp_path / "desi-exclusion_2020-01-01T00:00:00.json"
    path.write_text(json.dumps({"default": shapes, "other": other}))
    desi = rs.Instrument.from_desi(tmp_path)
    assert "also replace other polygons of 1 positioner" in desi.notes
    assert desi.values["positioner.outline"]["status"] == "derived"
    assert_legacy(desi.focal_plane.positioner.outline, sign=-1)
    segment = desi.with_arm_model("elbow_to_tip")
    assert segment.focal_plane.positioner.clearance == 2.015 * u.mm  # the largest |y| of the eccentric polygon
    assert_legacy(segment.with_arm_model("outline").focal_plane.positioner.outline, sign=-1)


@partial
def test_from_desi_without_exclusions_has_the_mirrored_outline_of_the_preset(tmp_path):
    desi_files.metrology(tmp_path / "fp.csv", per_petal=20)
    assert_legacy(rs.Instrument.from_desi(tmp_path / "fp.csv").focal_plane.positioner.outline, sign=-1)


@partial
def test_polygons_that_cross_give_a_clearance_but_no_outline(tmp_path):
    desi_files.focal_plane(tmp_path / "f.ecsv", per_petal=20)
    cross = {"segments": [[[0, -1], [3, 1], [3, -1], [0, 1], [0, -1]]], "circles": []}
    (tmp_path / "e.json").write_text(json.dumps({"default": {"phi": cross, "theta": cross}}))
    desi = rs.Instrument.from_desi(tmp_path / "f.ecsv", exclusions=tmp_path / "e.json")
    assert (desi.focal_plane.positioner.clearance, desi.arm_models) == (1 * u.mm, ("elbow_to_tip", "fiber_tip"))
    assert "do not form a valid outline" in desi.notes
