"""What the package says of real catalogs and of plans that surveys really observed."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs


@pytest.fixture(scope="module")
def field_a(real_data):
    return QTable.read(real_data("sdssv_robostrategy_field_a.ecsv"))


def similarity_residuals(model, truth):
    """Residuals after the best offset, rotation and scale (points as complex numbers)."""
    design = np.column_stack([model, np.ones(len(model))])
    solution, *_ = np.linalg.lstsq(design, truth, rcond=None)
    return np.abs(truth - design @ solution)


def test_sdss_focal_plane_is_reproduced(presets, field_a):
    """Robostrategy's own positions: at most 0.012 mm rms within a fiber type, 0.02 mm over all."""
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
    assert tile.summary["n_assigned"] == 494
    assert tile.summary["n_colliding_pairs"] == 0
    # one target lies 0.01 mm beyond the nominal arms: the survey knows the true length of each
    assert tile.summary["n_out_of_reach"] <= 1
    # the arm model matters: a segment to the fiber finds 7 pairs, with an arm of 15 mm 9
    plane = presets["sdss_apo"].focal_plane
    fields = ("central_arm", "clearance", "step", "displacement")
    for length, pairs in ((np.hypot(14.965, 0.376), 7), (15.0, 9)):
        unit = rs.Positioner(eccentric_arm=length * u.mm, **{f: getattr(plane.positioner, f) for f in fields})
        simple = rs.FocalPlane(plane.xy, unit, id=plane.id, fiber_type=plane.fiber_type)
        instrument = rs.Instrument("simple", simple, distortion=presets["sdss_apo"].distortion)
        assert rs.score_tile(field_a, instrument).summary["n_colliding_pairs"] == pairs


@pytest.mark.parametrize(
    ("design", "name"),
    [
        (21636, "sdss_apo"), (21637, "sdss_apo"), (50323, "sdss_apo"), (502706, "sdss_lco"), (503246, "sdss_lco"),
        (503247, "sdss_lco"), (505253, "sdss_lco"), (505254, "sdss_lco"),
    ],
)  # fmt: skip
def test_designs_of_both_sites_score_from_the_sky(presets, real_data, design, name):
    """From ra and dec alone, without refraction: nearly all in reach, and few pairs near the limit."""
    t = QTable.read(real_data("sdssv_eight_designs.ecsv"))
    t = t[t["design_id"] == design]
    tile = rs.score_tile(t, presets[name], equinox="J2022.0")
    assert tile.summary["n_assigned"] == len(t)
    assert tile.summary["n_out_of_reach"] <= 8
    assert tile.summary["n_colliding_pairs"] <= 6
    # the north of ICRS instead of that of date is 0.1 deg off, and loses more targets
    icrs = rs.score_tile(t, presets[name])
    assert icrs.summary["n_colliding_pairs"] >= tile.summary["n_colliding_pairs"]


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
