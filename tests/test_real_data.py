"""Results for real catalogs, and for designs that surveys observed."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import FK5, SkyCoord
from astropy.table import QTable

import flat
import rfpsurvey as rs


@pytest.fixture(scope="module")
def field_a(real_data):
    return QTable.read(real_data("sdssv_robostrategy_field_a.ecsv"))


def similarity_residuals(model, truth):
    """Return residuals after fitting an offset, a rotation and a scale (points are complex numbers)."""
    design = np.column_stack([model, np.ones(len(model))])
    solution, *_ = np.linalg.lstsq(design, truth, rcond=None)
    return np.abs(truth - design @ solution)


def test_sdss_focal_plane_is_reproduced(presets, field_a):
    """The differences from positions of robostrategy are at most 0.012 mm rms for each fiber type, and 0.02 mm for all
    fibers.
    """
    t = field_a[field_a["within"] == 1]
    plane = presets["sdss_apo"].projection(SkyCoord(269.59, 66.55, unit="deg"), 40 * u.deg)
    types = np.asarray(t["fiber_type"])
    xy = plane.to_focal_plane(SkyCoord(t["ra"], t["dec"]), types).value
    model, truth = xy @ [1, 1j], t["x_wok"].value + 1j * t["y_wok"].value
    for name in ("BOSS", "APOGEE"):
        rows = types == name
        assert np.sqrt(np.mean(similarity_residuals(model[rows], truth[rows]) ** 2)) < 0.012
    assert np.sqrt(np.mean(similarity_residuals(model, truth) ** 2)) < 0.02


def test_the_plan_of_the_survey_has_no_robot_robot_collision(presets, field_a):
    tile = rs.score_tile(field_a, presets["sdss_apo"])
    assert (tile.summary["n_assigned"], tile.summary["n_colliding_pairs"]) == (494, 0)
    # one target is 0.01 mm beyond the nominal reach; the survey uses the measured length of each arm
    assert tile.summary["n_out_of_reach"] <= 1
    # the result depends on the arm model: a segment to the fiber has 7 colliding pairs, and an arm of 15 mm has 9
    plane = presets["sdss_apo"].focal_plane
    fields = ("central_arm", "clearance", "step", "displacement")
    for length, pairs in ((np.hypot(14.965, 0.376), 7), (15.0, 9)):
        unit = rs.Positioner(eccentric_arm=length * u.mm, **{f: getattr(plane.positioner, f) for f in fields})
        simple = rs.FocalPlane(plane.xy, unit, id=plane.id, fiber_type=plane.fiber_type)
        instrument = rs.Instrument("simple", simple, distortion=presets["sdss_apo"].distortion)
        assert rs.score_tile(field_a, instrument).summary["n_colliding_pairs"] == pairs


APO, LCO = [21636, 21637, 50323], [502706, 503246, 503247, 505253, 505254]


@pytest.mark.few(2)
@pytest.mark.parametrize(("design", "name"), [*((n, "sdss_apo") for n in APO), *((n, "sdss_lco") for n in LCO)])
def test_designs_of_both_sites_score_from_the_sky(presets, real_data, design, name):
    """With only ra and dec, and without refraction, nearly all targets are in reach, and few pairs collide."""
    t = QTable.read(real_data("sdssv_eight_designs.ecsv"))
    t = t[t["design_id"] == design]
    tile = rs.score_tile(t, presets[name], equinox="J2022.0")
    assert tile.summary["n_assigned"] == len(t)
    assert tile.summary["n_out_of_reach"] <= 8
    assert tile.summary["n_colliding_pairs"] <= 6
    # ICRS north differs from north of date by 0.1 deg, and fewer targets are in reach
    with pytest.warns(rs.RfpsurveyWarning, match="SDSS-V uses the north of date"):
        icrs = rs.score_tile(t, presets[name])
    assert icrs.summary["n_colliding_pairs"] >= tile.summary["n_colliding_pairs"]


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("file", "instrument", "center", "epoch"),
    [
        ("zcosmos_bright.ecsv", "moons", (150.1, 2.2), None),
        ("zcosmos_bright.ecsv", "pfs", (150.1, 2.2), None),
        ("gaia_ngc103_field.ecsv", "pfs", (6.9, 61.1), 2026.5),
        ("tycho2_pleiades_r4.ecsv", "lamost", (56.75, 24.1), 2026.5),
        ("tycho2_spring_60x20.ecsv.gz", "desi", (210, 35), 2026.5),
    ],
)
def test_real_catalogs_are_planned(presets, real_data, file, instrument, center, epoch):
    catalog = rs.Catalog.read(real_data(file))
    tile = rs.plan_tile(catalog, presets[instrument], SkyCoord(*center, unit="deg"), epoch=epoch)
    s = tile.summary
    assert (
        s["n_targets"]
        == len(catalog)
        >= s["n_in_field"]
        >= s["n_reachable"]
        >= s["n_assigned"]
        > 0.05 * s["n_reachable"]
    )
    ids = tile.table["target_id"].compressed()
    assert len(np.unique(ids)) == len(ids) == s["n_assigned"]


REQUIRED = {"sky_boss": 300, "standard_boss": 20, "sky_apogee": 50, "standard_apogee": 20}


@pytest.mark.few(1)
@pytest.mark.parametrize("where", ["focal plane", "sky"])
def test_all_requirements_of_a_survey_field_are_met_with_all_robots_and_no_collision(
    presets, real_data, field_a, where
):
    """The planner of the survey assigned 494 of 500 robots."""
    plane, requirements = presets["sdss_apo"].focal_plane, [f"{name}={n}" for name, n in REQUIRED.items()]
    catalog = rs.Catalog.read(real_data("sdssv_robostrategy_field_a.ecsv"))
    if where == "sky":
        center = SkyCoord(269.59, 66.55, unit="deg").transform_to(FK5(equinox="J2021"))
        options = {"position_angle": 40 * u.deg, "allocator": "optimal", "requirements": requirements}
        tile = flat.plan_tile(catalog, presets["sdss_apo"], center, **options)
        assert (tile.summary["n_assigned"], tile.summary["gap"], tile.summary["unmet"]) == (500, 0, [])
        category = dict(zip(catalog.id.tolist(), catalog.category, strict=True))
        used = [category[i] for i in tile.table["target_id"].tolist()]
        report = tile.summary["n_colliding_pairs"], tile.summary["n_obstacle_collisions"]
    else:
        t = field_a[field_a["within"] == 1]
        category = np.asarray(t["category"]).astype(str)
        kind = np.array(["science" if "_" not in c else c.split("_")[0] for c in category])
        xy = np.column_stack([t["x_wok"], t["y_wok"]])
        columns = {"fiber_type": np.asarray(t["fiber_type"]).astype(str), "kind": kind, "category": category}
        plan = flat.allocate(plane, xy, allocator="optimal", requirements=requirements, **columns)
        assert (plan.n_assigned, plan.gap, plan.unmet) == (500, 0, ())
        used, found = category[plan.target_of_positioner].tolist(), rs.find_collisions(plane, plan)
        report = len(found.pairs), len(found.obstacle_pairs)
        boss_only = plane.fiber_type == "BOSS"
        assert boss_only.sum() == 202
        assert all(columns["fiber_type"][plan.target_of_positioner[boss_only]] == "BOSS")
    assert report == (0, 0)
    assert all(used.count(name) >= n for name, n in REQUIRED.items())
    assert used.count("science") == 4


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("file", "name", "center", "least"),
    [
        ("zcosmos_bright.ecsv", "moons", None, 0.2),
        ("tycho2_pleiades_r4.ecsv", "lamost", None, 0.02),
        ("tycho2_anticentre_r8.ecsv.gz", "lamost", (92.25, 24.35), 0.02),
    ],
)
def test_what_rules_lose_to_collisions_in_crowded_fields_is_won_back(real_data, file, name, center, least):
    catalog = rs.Catalog.read(real_data(file))
    center = catalog.mean_direction if center is None else SkyCoord(*center, unit="deg")
    table = rs.compare_allocators(catalog, name, center, allocators=["lamost_rule", "repair", "optimal"])
    rule, repaired, best = table
    assert best["gap"] == 0
    assert best["colliding"] == repaired["colliding"] == 0
    assert rule["usable"] < repaired["usable"] <= best["usable"]
    assert rule["loss"] > least > best["loss"]
