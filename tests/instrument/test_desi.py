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
from raising import refused, warned

import rfpsurvey as rs
from damaged_files import FINE, damage, outcome
from valid_files import Sample

FEW = 20  # positioners of each petal
partial = pytest.mark.filterwarnings("ignore:.*DESI has 5000 positioners")


@pytest.fixture
def folder(tmp_path):
    """Return the folder of a focal plane with few positioners, its state with three events, and its exclusions."""
    table = desi_files.focal_plane(tmp_path / "desi-focalplane_2020-01-01T00:00:00.ecsv", per_petal=FEW)
    events = [
        {"TIME": "2021-01-01T00:00:00+00:00", "LOCATION": 1003, "STATE": 2, "POS_T": 10.0, "POS_P": 100.0},
        {"TIME": "2022-01-01T00:00:00", "LOCATION": 1003, "STATE": 0},
        {"TIME": "2022-01-01T00:00:00", "LOCATION": 1004, "STATE": 4, "POS_T": 1.0, "POS_P": 90.0},
        {"TIME": "2023-01-01T00:00:00", "LOCATION": 1005, "STATE": 8, "MIN_P": 100.0, "EXCLUSION": "retracted"},
    ]
    desi_files.state(tmp_path / "desi-state_2020-01-01T00:00:00.ecsv", table, events)
    desi_files.exclusions(tmp_path / "desi-exclusion_2020-01-01T00:00:00.json.gz", ("default", "retracted"))
    return tmp_path


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


def set_(name, row, value):
    return lambda table: table[name].__setitem__(row, value)


def text(name):
    def edit(table):
        table[name] = np.array(table[name]).astype("U12")
        table[name][3] = "broken"

    return edit


def unit(name, what):
    return lambda table: setattr(table[name], "unit", what)


def at(x, y):
    def edit(table):
        table["X_FP"][5], table["Y_FP"][5] = x(table), y(table)

    return edit


def without(name):
    return lambda table: table.remove_column(name)


CODES = "must hold .* no codes such as 99 or -999, got"
DAMAGED = [
    ("metrology", without("X_FP"), "must have the column"),
    ("metrology", without("LOCATION"), "must have the column 'LOCATION'"),
    ("metrology", text("Y_FP"), r"column 'Y_FP' must hold one number for each row, got 'broken'"),
    ("metrology", set_("X_FP", 5, np.nan), r"column 'X_FP' must hold a finite number for each row, but 1 of 200 rows"),
    ("metrology", set_("Y_FP", 5, -99.0), f"'Y_FP' {CODES} -99 in row 6"),
    ("metrology", set_("X_FP", 5, 9999.0), "'X_FP' must hold numbers from -420 to 420 mm, .*, got 9999 in row 6"),
    (
        "metrology",
        at(lambda table: 0.0, lambda table: 0.0),
        r"X_FP, Y_FP must be at least 10 mm from the center, but are not for 1 positioner \(5\)",
    ),
    (
        "metrology",
        at(lambda table: table["X_FP"][6] + 1, lambda table: table["Y_FP"][6] + 1),
        r"must be at least 5 mm from each other, but are not for 2 positioners \(5, 6\)",
    ),
    ("metrology", set_("LOCATION", 5, 7000), "DEVICE_LOC, got 7000 for PETAL_LOC 0 and DEVICE_LOC 5"),
    ("metrology", lambda table: table.add_row(table[0]), "LOCATION must be unique, but 0 occurs more than once"),
    ("metrology", lambda table: table.remove_rows(slice(None)), "must have at least one row, got none"),
    ("metrology", lambda table: table["DEVICE_TYPE"].fill("FIF"), "must be POS for positioners, got 'FIF'"),
    ("focal_plane", without("OFFSET_P"), "must have the column 'OFFSET_P'"),
    ("focal_plane", text("LENGTH_R1"), r"column 'LENGTH_R1' must hold one number for each row, got 'broken'"),
    ("focal_plane", unit("OFFSET_X", "degrees"), "column 'OFFSET_X' must have a unit convertible to mm, got deg"),
    ("focal_plane", unit("OFFSET_T", "mm"), "column 'OFFSET_T' must have a unit convertible to deg, got mm"),
    ("focal_plane", set_("MIN_P", 2, 195.0), r"MIN_P must be less than MAX_P, but is not for 1 positioner \(2\)"),
    ("focal_plane", set_("LOCATION", 0, 4), "must be 1000 PETAL [+] DEVICE, got 4 for PETAL 0 and DEVICE 0"),
    ("focal_plane", set_("LENGTH_R2", 0, -3.0), "'LENGTH_R2' must hold numbers from 1 to 6 mm, got -3 in row 1"),
    ("focal_plane", set_("LENGTH_R1", 7, 999.0), "'LENGTH_R1' must hold numbers from 1 to 6 mm, got 999 in row 8"),
    ("focal_plane", set_("OFFSET_X", 7, -999.0), f"'OFFSET_X' {CODES} -999 in row 8"),
    ("focal_plane", set_("OFFSET_T", 7, -99.0), f"'OFFSET_T' {CODES} -99 in row 8"),
    ("focal_plane", set_("MIN_T", 7, -999.0), "'MIN_T' must hold numbers from -400 to 400 deg, got -999 in row 8"),
    ("state", without("STATE"), "must have the column 'STATE'"),
    ("state", set_("TIME", 0, "yesterday"), "column 'TIME' must be a Time or text such as .*, got 'yesterday'"),
    ("state", text("STATE"), r"column 'STATE' must hold one whole number for each row, got 'broken'"),
    ("state", set_("POS_T", 1, np.nan), "column 'POS_T' must hold a finite number for each row"),
    ("state", set_("MAX_P", 3, 999.0), "'MAX_P' must hold numbers from -400 to 400 deg, got 999 in row 4"),
]


@partial
@pytest.mark.few(8)
@pytest.mark.parametrize(("kind", "edit", "sentence"), DAMAGED)
def test_a_damaged_table_is_refused(tmp_path, kind, edit, sentence):
    path, plane = tmp_path / f"bad.{'csv' if kind == 'metrology' else 'ecsv'}", tmp_path / "desi-focalplane.ecsv"
    options = {}
    if kind == "metrology":
        desi_files.metrology(path, per_petal=FEW, others=False, edit=edit)
    elif kind == "focal_plane":
        desi_files.focal_plane(path, per_petal=FEW, edit=edit)
    else:
        desi_files.state(path, desi_files.focal_plane(plane, per_petal=FEW), edit=edit)
        options = {"state": path}
    assert str(path) in refused(sentence, rs.Instrument.from_desi, plane if options else path, **options)


@partial
def test_lengths_in_another_unit_are_converted(tmp_path):
    def centimeters(table):
        table["LENGTH_R1"] /= 10
        table["LENGTH_R1"].unit = "cm"

    for name, edit in (("a", None), ("b", centimeters)):
        desi_files.focal_plane(tmp_path / f"{name}.ecsv", per_petal=FEW, edit=edit)
    one, other = (rs.Instrument.from_desi(tmp_path / f"{name}.ecsv").focal_plane for name in "ab")
    assert_allclose(one.arrays.central_arm, other.arrays.central_arm)


@partial
@pytest.mark.few(1)
@pytest.mark.parametrize("code", [-999.0, 99.0, 9999.0])
def test_stuck_positioners_with_codes_as_pose_are_parked(folder, code):
    """The code -999 was a pose, and the arm of the positioner was an obstacle in this direction."""
    plane = next(folder.glob("desi-focalplane*"))
    event = {"TIME": "2030-01-01T00:00:00", "LOCATION": 4, "STATE": 2, "POS_T": code, "POS_P": 100.0}
    desi_files.state(folder / "stuck.ecsv", Table.read(plane, format="ascii.ecsv"), [event])
    found = rs.Instrument.from_desi(plane, state=folder / "stuck.ecsv")
    assert found.focal_plane.disabled[4]
    assert np.isnan(found.focal_plane.stuck.value[4]).all()
    assert "1 stuck or broken without a known pose, and thus parked" in found.notes


@partial
def test_other_files_that_cannot_be_read_are_refused(folder):
    for kind in ("state", "exclusion"):
        path = next(folder.glob(f"desi-{kind}*"))
        content = path.read_bytes()
        path.unlink()
        path.symlink_to(folder / "nowhere")
        assert refused("the target of this link does not exist", rs.Instrument.read, folder).startswith(str(path))
        path.unlink()
        path.write_bytes(content)


@partial
def test_unknown_states_are_reported(folder):
    plane = next(folder.glob("desi-focalplane*"))
    table = Table.read(plane, format="ascii.ecsv")
    desi_files.state(folder / "odd.ecsv", table, edit=set_("STATE", 4, 64))
    desi_files.state(folder / "short.ecsv", table[3:])
    odd, short = (
        warned(message, rs.Instrument.from_desi, plane, state=folder / name).focal_plane
        for name, message in (
            ("odd.ecsv", r"1 positioner \(4\) have unknown bits"),
            ("short.ecsv", r"3 positioners \(0, 1, 2\) of the focal plane have no state"),
        )
    )
    assert odd.disabled.sum() == 1
    assert short.arrays.usable.all()
    assert np.isfinite(short.phi_range).all()


@partial
def test_exclusions_that_expand_in_memory_are_refused(folder, monkeypatch):
    """A list of YAML that refers to another list many times took minutes and all of the memory."""
    path = folder / "bad.yaml"
    path.write_text(f"segment: &a [[1, 1], [2, 2]]\nmany: &b [{'*a,' * 500}]\ndefault: [{'*b,' * 500}]\n")
    plane = folder / "desi-focalplane_2020-01-01T00:00:00.ecsv"
    monkeypatch.setattr("rfpsurvey._instruments.desi_state.MOST_VALUES", 50_000)
    refused(r"bad\.yaml: there must be at most 50000 values, got more", rs.Instrument.from_desi, plane, exclusions=path)


@partial
def test_exclusions_that_are_not_polygons_are_refused(folder):
    plane, lists = next(folder.glob("desi-focalplane*")), "must be lists of segments"
    for content, sentence in (
        ("{", "bad.json cannot be read"),
        ("[]", "must contain a dict of polygons, got list"),
        ("{}", "there must be polygons with the name 'default'"),
        ('{"segments": [[[0, "x"]]], "circles": []}', lists),
        ('{"segments": [], "circles": []}', lists),
        ('{"segments": [[[0, 0]]], "circles": []}', "must have a half width above 0 and below 10 mm, got 0"),
        ('{"segments": [], "circles": [[[0, 0], 1e9]]}', "below 10 mm, got 1e[+]09"),
    ):
        whole = f'{{"default": {{"phi": {content}}}}}' if "segments" in content else content
        (folder / "bad.json").write_text(whole)
        refused(sentence, rs.Instrument.from_desi, plane, exclusions=folder / "bad.json")
    refused("there is no such file", rs.Instrument.from_desi, plane, exclusions=folder / "none.json")


@partial
def test_arguments_that_do_not_fit_are_refused(folder):
    desi_files.metrology(folder / "fp.csv", per_petal=FEW)
    (folder / "empty").mkdir()
    plane, log = (next(folder.glob(f"desi-{kind}*")) for kind in ("focalplane", "state"))
    for path, options, sentence in (
        (folder, {"time": "2019-01-01"}, "time must not be before the first focal plane, 2020-01-01"),
        (folder, {"time": "soon"}, "time must be a Time or text such as .*, got 'soon'"),
        (folder, {"time": 3}, "time must be a Time or text such as .*, got 3"),
        (plane, {"time": "2021-01-01"}, "time must be None without a state, got 2021-01-01"),
        (plane, {"state": log, "time": "2019-01-01"}, "time must not be before the first event, 2020-01-01T00:00:00"),
        (folder / "fp.csv", {"state": log}, "state must be None for a metrology file"),
        (folder / "none.csv", {}, "there is no such file"),
        (folder / "empty", {}, "must have a file desi-focalplane_DATE.ecsv, got none"),
    ):
        refused(sentence, rs.Instrument.from_desi, path, **options)


def test_an_incomplete_focal_plane_is_reported(tmp_path):
    desi_files.metrology(tmp_path / "fp.csv")
    lines = (tmp_path / "fp.csv").read_text().splitlines(keepends=True)
    (tmp_path / "cut.csv").write_text("".join(lines[:4000]))
    warned("DESI has 5000 positioners, but the file has 3999", rs.Instrument.from_desi, tmp_path / "cut.csv")
    content = gzip.compress((tmp_path / "fp.csv").read_bytes())
    (tmp_path / "cut.csv.gz").write_bytes(content[: len(content) // 2])
    with pytest.raises(rs.errors.InputError, match=r"cut.csv.gz cannot be read: EOFError: Compressed file ended"):
        rs.Instrument.from_desi(tmp_path / "cut.csv.gz")


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


@pytest.mark.few(2)
@pytest.mark.parametrize("seed", range(5))
def test_damaged_files_are_refused_with_a_sentence(folder, tmp_path, seed):
    desi_files.metrology(folder / "fp.csv", per_petal=FEW)
    plane, log = (next(folder.glob(f"desi-{kind}*")) for kind in ("focalplane", "state"))
    desi_files.exclusions(folder / "polygons.yaml")
    readers = {
        folder / "fp.csv": rs.Instrument.from_desi,
        plane: rs.Instrument.from_desi,
        log: lambda path: rs.Instrument.from_desi(plane, state=path),
        folder / "polygons.yaml": lambda path: rs.Instrument.from_desi(plane, exclusions=path),
    }
    for number, (path, read) in enumerate(readers.items()):
        sample = Sample("DESI", path, lambda path, read=read: len(read(path).focal_plane), lambda path: None)
        away = tmp_path / f"damaged {number}"
        away.mkdir()
        damaged, done = damage(np.random.default_rng([7, seed, number]), sample, away)
        what, words = outcome(sample, damaged)
        assert what in FINE, f"{path.name} ({done}): {what}: {words}"


def test_a_folder_with_a_metrology_or_without_an_instrument(tmp_path):
    refused(r"must contain positionerTable.csv .* got none of them", rs.Instrument.read, tmp_path)
    (tmp_path / "fp-metrology.csv").write_text("PETAL_LOC,DEVICE_LOC,DEVICE_TYPE,X_FP,Y_FP,LOCATION\n")
    refused("fp-metrology.csv", rs.Instrument.read, tmp_path)
