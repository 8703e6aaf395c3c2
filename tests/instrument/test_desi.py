"""DESI as built, from test files that follow the data models, and from the real metrology."""

import gzip

import astropy.units as u
import desi_files
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import Table
from astropy.time import Time
from numpy.testing import assert_allclose, assert_array_equal
from raising import refused

import rfpsurvey as rs

FEW = 20  # positioners of each petal
partial = pytest.mark.filterwarnings("ignore:.*DESI has 5000 positioners")


@pytest.fixture
def folder(tmp_path):
    return desi_files.folder_with_state(tmp_path, per_petal=FEW)


def row_of(instrument, location):
    return np.flatnonzero(instrument.focal_plane.id == location)[0]


def test_the_metrology_gives_centers_ids_and_petals(tmp_path, presets):
    table = desi_files.metrology(tmp_path / "fp.csv")[:5000]
    instrument = rs.Instrument.from_desi(tmp_path / "fp.csv")
    plane = instrument.focal_plane
    assert_array_equal(plane.xy.to_value(u.mm), np.column_stack([-table["X_FP"], table["Y_FP"]]))
    assert_array_equal(plane.id, table["LOCATION"])
    assert_array_equal(plane.spectrograph, table["PETAL_LOC"])
    assert instrument.layout == "as built"
    assert "1 FIF, 1 GIF" in instrument.notes
    assert instrument.requirements == presets["desi"].requirements
    assert instrument.values["layout.centers"]["value"] == 5000
    assert not {"layout.pitch", "layout.count", "layout.inner_radius"} & set(instrument.values)


def test_the_mirror_image_has_the_same_poses_as_the_preset(tmp_path, presets):
    """If the preset reaches (x, y) with a pose, the instrument as built reaches (-x, y) with the mirror image of this
    pose.
    """
    desi_files.metrology(tmp_path / "fp.csv", others=False)
    built, nominal = rs.Instrument.from_desi(tmp_path / "fp.csv").focal_plane, presets["desi"].focal_plane
    order = np.argsort(nominal.spectrograph, kind="stable")
    points = np.random.default_rng(3).uniform(-4, 4, (5000, 2)) * u.mm
    theta, phi = nominal.positioner.inverse(points)
    other, folded = built.positioner.inverse(points * [-1, 1])
    assert_allclose(np.cos((theta + other).to_value(u.rad)), -1, atol=1e-9)
    assert_allclose(phi.value, -folded.value, atol=1e-9)
    assert_array_equal(built.xy, nominal.xy[order] * [-1, 1])


@partial
def test_joint_angles_are_those_of_desimodel_with_the_opposite_sign(folder):
    """The forward kinematics of desimeter in CS5 is x = R1 cos(t) + R2 cos(t + p), with t = POS_T + OFFSET_T."""
    table = Table.read(next(folder.glob("desi-focalplane*")), format="ascii.ecsv")[:-1]
    plane, rng = rs.Instrument.from_desi(folder).focal_plane, np.random.default_rng(4)
    t, p = rng.uniform(-180, 180, len(table)), rng.uniform(5, 175, len(table))
    a = np.deg2rad(t + table["OFFSET_T"].value)
    b = a + np.deg2rad(p + table["OFFSET_P"].value)
    r1, r2 = table["LENGTH_R1"].value, table["LENGTH_R2"].value
    x = table["OFFSET_X"].value + r1 * np.cos(a) + r2 * np.cos(b)
    y = table["OFFSET_Y"].value + r1 * np.sin(a) + r2 * np.sin(b)
    there = plane.forward(-t * u.deg, -p * u.deg)
    assert_allclose(there.to_value(u.mm), np.column_stack([-x, y]), atol=1e-10)
    theta, phi = plane.inverse(there)
    assert_allclose(plane.theta_range.to_value(u.deg), np.tile([-190, 185], (len(plane), 1)))
    free = plane.id != 1005  # the reach of this positioner is restricted
    assert_allclose(np.cos(theta.to_value(u.rad) + np.deg2rad(t))[free], 1, atol=1e-9)
    assert_allclose(phi.to_value(u.deg)[free], -p[free], atol=1e-6)


@partial
def test_the_last_event_before_a_time_applies(folder):
    start, stuck, broken, last = (
        rs.Instrument.from_desi(folder, time=time)
        for time in ("2020-06-01", "2021-01-01T00:00:00", Time("2022-06-01"), None)
    )
    assert start.focal_plane.arrays.usable.all()
    assert "all positioners work" in start.notes
    assert_allclose(stuck.focal_plane.stuck[row_of(stuck, 1003)].to_value(u.deg), [-10, -100])
    assert stuck.focal_plane.arrays.usable.sum() == 10 * FEW - 1
    k = row_of(stuck, 1003)
    place = stuck.focal_plane.forward(np.full(10 * FEW, -10) * u.deg, np.full(10 * FEW, -100) * u.deg)[k]
    assert_allclose(stuck.focal_plane.arrays.idle(True).segments[2:, k], place.to_value(u.mm))
    assert broken.focal_plane.disabled.sum() == 1
    assert broken.focal_plane.arrays.usable[row_of(broken, 1003)]
    assert_allclose(broken.focal_plane.stuck[row_of(broken, 1004)].to_value(u.deg), [-1, -90])
    k = row_of(last, 1005)
    assert_allclose(last.focal_plane.phi_range[k].to_value(u.deg), [-190, -100])
    assert "1 with a broken fiber, 1 with restricted reach" in last.notes


@partial
def test_a_restricted_positioner_reaches_less(folder):
    before, after = (rs.Instrument.from_desi(folder, time=t).focal_plane for t in ("2022-06-01", None))
    k, away = np.flatnonzero(after.id == 1005)[0], np.linspace(0.5, 5.9, 100)
    points = after.xy[k] + np.column_stack([away, 0 * away]) * u.mm
    reach = [np.diff(plane.reachable(points).T.tocsr()[:, [k]].indptr).astype(bool) for plane in (before, after)]
    r1, r2 = after.arrays.central_arm[k], after.arrays.eccentric_arm[k]
    folded = np.deg2rad(100) - after.zero_points[k, 1].to_value(u.rad)
    limit = np.sqrt(r1**2 + r2**2 + 2 * r1 * r2 * np.cos(folded))
    assert reach[0].all()
    assert_array_equal(reach[1], away <= limit)
    assert 0 < reach[1].sum() < 100


@partial
def test_a_focal_plane_without_a_state_works(folder):
    instrument = rs.Instrument.from_desi(next(folder.glob("desi-focalplane*")))
    assert instrument.focal_plane.arrays.usable.all()
    assert "No state was given" in instrument.notes
    assert instrument.focal_plane.positioner.clearance == 0 * u.mm
    assert instrument.with_arm_model("elbow_to_tip").focal_plane.positioner.clearance == 0.99 * u.mm


@partial
@pytest.mark.few(2)
@pytest.mark.parametrize("name", ["e.json", "e.json.gz", "e.yaml", "e.yaml.gz", "circle.json"])
def test_the_clearance_of_segments_is_that_of_the_polygons(folder, name):
    """Circles of polygons count."""
    if name == "circle.json":
        text = '{"default": {"phi": {"segments": [[[0, 0.3]]], "circles": [[[3, -0.2], 0.5]]}}}'
        (folder / name).write_text(text)
    else:
        desi_files.exclusions(folder / name, ("default", "retracted"), scale=0.8)
    plane, log = (next(folder.glob(f"desi-{kind}*")) for kind in ("focalplane", "state"))
    log = None if name == "circle.json" else log  # its polygons have one name only
    built = rs.Instrument.from_desi(plane, state=log, exclusions=folder / name).with_arm_model("elbow_to_tip")
    clearance = built.focal_plane.positioner.clearance.to_value(u.mm)
    assert_allclose(clearance, 0.7 if name == "circle.json" else 0.72)
    assert built.values["positioner.clearance"]["status"] == "derived"


@partial
def test_the_latest_focal_plane_of_a_folder_is_used(folder):
    def moved(table):
        table["OFFSET_X"] += 1

    later = desi_files.focal_plane(folder / "desi-focalplane_2024-01-01T00:00:00+00:00.ecsv", per_petal=FEW, edit=moved)
    desi_files.state(folder / "desi-state_2024-01-01T00:00:00+00:00.ecsv", later)
    new, old = (rs.Instrument.from_desi(folder, time=time) for time in ("2024-01-01", "2023-12-31"))
    assert_allclose((old.focal_plane.xy - new.focal_plane.xy).to_value(u.mm)[:, 0], 1)
    assert "2024-01-01" in new.notes
    assert "2020-01-01" in old.notes


@partial
def test_files_and_folders_are_recognized(folder):
    desi_files.metrology(folder / "fp.csv", per_petal=FEW)
    (folder / "fp.csv.gz").write_bytes(gzip.compress((folder / "fp.csv").read_bytes()))
    for path in (folder, folder / "fp.csv", folder / "fp.csv.gz", next(folder.glob("desi-focalplane*"))):
        assert rs.Instrument.read(path).name == "desi"


@partial
def test_a_tile_can_be_planned_with_measured_arms(folder):
    desi, center = rs.Instrument.from_desi(folder), SkyCoord(10 * u.deg, 20 * u.deg)
    sky = rs.synthetic_catalog("uniform", center, 1.6 * u.deg, density=600 / u.deg**2, rng=5)
    tile = rs.plan_tile(sky, desi, center)
    n, has = tile.summary["n_assigned"], tile.table["status"] == "assigned"
    assert n > 100
    assert (tile.summary["n_parked"], tile.summary["n_idle"]) == (desi.focal_plane.arrays.usable.sum() - n, 0)
    tips = np.column_stack([tile.table["tip_x"], tile.table["tip_y"]])[has]
    found = desi.focal_plane.forward(tile.table["theta"], tile.table["phi"])[has]
    assert_allclose(found, tips, atol=1e-9 * u.mm)


@partial
def test_lengths_in_another_unit_are_converted(tmp_path):
    def centimeters(table):
        table["LENGTH_R1"] /= 10
        table["LENGTH_R1"].unit = "cm"

    for name, edit in (("a", None), ("b", centimeters)):
        desi_files.focal_plane(tmp_path / f"{name}.ecsv", per_petal=FEW, edit=edit)
    one, other = (rs.Instrument.from_desi(tmp_path / f"{name}.ecsv").focal_plane for name in "ab")
    assert_allclose(one.arrays.central_arm, other.arrays.central_arm)


def test_the_real_metrology(real_data):
    instrument = rs.Instrument.read(real_data("desi/fp-metrology.csv.gz"))
    plane = instrument.focal_plane
    assert len(plane) == 5000
    assert set(np.unique(plane.spectrograph, return_counts=True)[1]) == {500}
    assert "20 ETC, 393 FIF, 40 GFA, 80 GIF, 62 GIF-T" in instrument.notes
    # petals are numbered counter-clockwise in CS5, and petal 3 is in the direction of +x
    x, y = np.array([plane.xy[plane.spectrograph == p].mean(axis=0).value for p in range(10)]).T
    turned = np.rad2deg(np.arctan2(y, -x)) - (36 * (7 + np.arange(10)) + 18)
    assert_allclose(np.mod(turned + 180, 360) - 180, 0, atol=3)


def test_the_optics_agree_with_the_ray_trace(real_data, presets):
    """CS5 has the signs of the tangent plane.

    Without the dispersion compensator, errors of the radial map are below 0.07 mm.
    """
    rays = Table.read(real_data("desi/raytrace-tan2fp-4957-v18.csv.gz"), format="ascii.csv")
    rays = rays[rays["ADC1"] == 0]
    angle, radius = np.arctan(np.hypot(rays["X_TAN"], rays["Y_TAN"])), np.hypot(rays["X_FP"], rays["Y_FP"])
    inside = angle < np.deg2rad(1.6)
    along = rays["X_TAN"] * rays["X_FP"] + rays["Y_TAN"] * rays["Y_FP"]
    assert (along[inside & (angle > 0.005)] > 0).all()
    expected = presets["desi"].distortion.to_radius(angle[inside] * u.rad).to_value(u.mm)
    assert 0.05 < np.abs(radius[inside] - expected).max() < 0.07


def test_a_folder_with_a_metrology_or_without_an_instrument(tmp_path):
    refused(r"must contain positionerTable.csv .* got none of them", rs.Instrument.read, tmp_path)
    (tmp_path / "fp-metrology.csv").write_text("PETAL_LOC,DEVICE_LOC,DEVICE_TYPE,X_FP,Y_FP,LOCATION\n")
    refused("fp-metrology.csv", rs.Instrument.read, tmp_path)
