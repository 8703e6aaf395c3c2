"""SDSS-V as built, from invented calibrations."""

import os
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from numpy.testing import assert_allclose, assert_array_equal
from raising import refused, warned

import rfpsurvey as rs
import sdssv_files
from rfpsurvey._instruments.instrument import as_instrument

PLACES = {"BOSS": "boss", "APOGEE": "ap", "METROLOGY": "met"}


@pytest.fixture
def folder(tmp_path):
    return sdssv_files.calibration(tmp_path / "calibration")


def row_of(plane, hole):
    return plane.id.tolist().index(hole)


def changed(hole, **values):
    """Return a function that changes values in the row of a hole."""
    return lambda rows: [{**row, **values} if row["holeID"] == hole else row for row in rows]


def test_positions_of_all_fibers_follow_the_published_formula(folder):
    inst = rs.Instrument.from_sdssv(folder)
    plane, nominal = inst.focal_plane, rs.Instrument.preset("sdss_apo").focal_plane
    centers = dict(zip(nominal.id.tolist(), nominal.xy.value.tolist(), strict=True))
    rng = np.random.default_rng(3)
    alpha, beta = rng.uniform(0, 360, len(plane)), rng.uniform(1, 179, len(plane))
    for fiber, place in PLACES.items():
        expected = [
            sdssv_files.formula(values, centers[hole], alpha[k], beta[k], place)
            for hole, values in sdssv_files.robot_values().items()
            for k in [row_of(plane, hole)]
        ]
        order = [row_of(plane, hole) for hole in sdssv_files.HOLES]
        got = plane.forward(alpha * u.deg, beta * u.deg, fiber)
        assert_allclose(got[order].value, expected, rtol=0, atol=1e-11)
        theta, phi = plane.inverse(got, fiber)
        assert_allclose(theta.value, alpha, rtol=0, atol=1e-6)
        assert_allclose(phi.value, beta, rtol=0, atol=1e-6)


def test_the_instrument_combines_the_files_with_the_preset(folder):
    inst, preset = rs.Instrument.read(folder), rs.Instrument.preset("sdss_apo")
    plane = inst.focal_plane
    assert (inst.name, inst.layout, len(plane)) == ("sdss_apo", "as built", 7)
    order = [preset.focal_plane.id.tolist().index(hole) for hole in plane.id.tolist()]
    assert order == sorted(order)
    assert plane.fiber_type[row_of(plane, "R-1C13")] == "BOSS"
    assert (plane.fiber_type == "BOSS+APOGEE").sum() == 6
    assert_array_equal(plane.obstacles.value, [[-10.5, -45, 3]])
    assert (inst.distortion["BOSS"].coefficients[0], inst.distortion["APOGEE"].radius) == (1.3, 8939 * u.mm)
    assert inst.distortion["BOSS"].factor == preset.distortion["BOSS"].factor
    assert inst.requirements == preset.requirements
    assert "layout.pitch" not in inst.values
    assert "wokCoords.csv has 1 hole without a robot." in inst.notes
    assert "Fiducials between the robots (1 of 2 in fiducialCoords.csv)" in inst.notes
    assert as_instrument(str(folder)).provenance == inst.provenance
    assert inst.to_table()


@pytest.mark.parametrize("index", ["index", "id", ""])
def test_the_name_of_the_first_column_does_not_matter(tmp_path, index):
    a = rs.Instrument.read(sdssv_files.calibration(tmp_path / "a", index=index))
    b = rs.Instrument.read(sdssv_files.calibration(tmp_path / "b"))
    assert_array_equal(a.focal_plane.xy, b.focal_plane.xy)


def test_only_two_files_are_required(folder):
    for name in ("fiberAssignments", "fiducialCoords", "focalPlaneModel", "wokOrientation"):
        (folder / f"{name}.csv").unlink()
    inst, preset = rs.Instrument.read(folder), rs.Instrument.preset("sdss_apo")
    assert inst.distortion == preset.distortion
    assert len(inst.focal_plane.obstacles) == len(preset.focal_plane.obstacles)
    assert (inst.focal_plane.fiber_type == "BOSS+APOGEE").sum() == 6
    for name in ("fiberAssignments", "fiducialCoords", "focalPlaneModel", "wokOrientation"):
        assert f"There is no {name}.csv" in inst.notes
    (folder / "wokCoords.csv").unlink()
    refused(r"wokCoords.csv: there is no such file", rs.Instrument.read, folder)


def test_las_campanas_takes_the_other_preset(tmp_path):
    inst = rs.Instrument.read(sdssv_files.calibration(tmp_path / "lco", site="LCO"))
    assert (inst.name, inst.distortion["BOSS"].max_angle) == ("sdss_lco", 1.1 * u.deg)


def test_robots_with_missing_values_are_disabled_and_named(tmp_path):
    def gaps(rows):
        rows = changed("R-1C13", bossX="", bossY="")(changed("R0C15", apX="nan")(rows))
        return changed("R0C13", alphaOffset="")(rows)

    inst = rs.Instrument.read(sdssv_files.calibration(tmp_path / "gaps", positionerTable=gaps))
    plane = inst.focal_plane
    assert plane.id[plane.disabled].tolist() == ["R-1C13", "R0C13"]
    for sentence in (
        "These robots are disabled, because values in positionerTable.csv are missing: R0C13.",
        "The fiber BOSS of these robots is not used, because its position in positionerTable.csv is missing: R-1C13.",
        "These robots are disabled, because they have no fiber: R-1C13.",
    ):
        assert sentence in inst.notes
    assert plane.fiber_type[row_of(plane, "R0C15")] == "BOSS"


IMPOSSIBLE_VALUES = [
    ("alphaArmLen", -999.0, True),
    ("alphaArmLen", 74.0, True),
    ("alphaOffset", 99.0, True),
    ("betaOffset", -9999.0, True),
    ("dx", 5000.0, True),
    ("bossX", -999.0, False),
    ("bossY", 99.9, False),
    ("bossX", 0.0, False),
]


@pytest.mark.few(2)
@pytest.mark.parametrize(("column", "value", "is_disabled"), IMPOSSIBLE_VALUES)
def test_impossible_values_of_robots_count_as_missing(tmp_path, column, value, is_disabled):
    """With the code -999 for the position of a fiber, a robot had a reach of 1420 mm."""
    folder = sdssv_files.calibration(tmp_path / "codes", positionerTable=changed("R0C13", **{column: value}))
    inst = rs.Instrument.read(folder)
    plane, k = inst.focal_plane, row_of(inst.focal_plane, "R0C13")
    assert (plane.disabled[k], plane.disabled.sum()) == (is_disabled, is_disabled)
    assert is_disabled or plane.fiber_type[k] == "APOGEE"
    assert plane.arrays.outer_radius.max() < 25
    assert f"{column} = {value} in row 5" in inst.notes
    assert "R0C13" in inst.notes


@pytest.mark.few(2)
@pytest.mark.parametrize("value", [-999, 0, -1, 9999, "nan"])
def test_impossible_numbers_of_fibers_are_no_fibers(tmp_path, value):
    folder = sdssv_files.calibration(tmp_path / "codes", fiberAssignments=changed("R0C13", BOSSFiber=value))
    inst = rs.Instrument.read(folder)
    assert inst.focal_plane.fiber_type[row_of(inst.focal_plane, "R0C13")] == "APOGEE"
    assert value == "nan" or f"impossible and count as missing: BOSSFiber = {value}" in inst.notes


def test_numbers_of_fibers_may_have_gaps(tmp_path):
    """At Las Campanas, 500 robots have fibers from 1 to 527; numbers above 500 counted as missing."""

    def numbered(rows):
        return [{**row, "BOSSFiber": row["BOSSFiber"] and 501 + 3 * k} for k, row in enumerate(rows)]

    planes = [
        rs.Instrument.read(sdssv_files.calibration(tmp_path / name, **changes)).focal_plane
        for name, changes in (("old", {}), ("new", {"fiberAssignments": numbered}))
    ]
    assert_array_equal(planes[0].fiber_type, planes[1].fiber_type)
    assert not planes[1].disabled.any()


def test_impossible_values_are_counted_where_a_plan_is_printed(tmp_path, run):
    """Robots were disabled because of impossible values, and only the notes of the instrument stated this."""

    def repeated(rows):  # a code for missing values, and a robot without a second fiber
        return [{**row, "BOSSFiber": 600 if row["holeID"] in ("R-1C13", "R0C13") else row["BOSSFiber"]} for row in rows]

    folder = sdssv_files.calibration(tmp_path / "codes", fiberAssignments=repeated)
    inst = rs.Instrument.read(folder)
    assert inst.values["layout.impossible_values"]["value"] == 2
    assert inst.focal_plane.id[inst.focal_plane.disabled].tolist() == ["R-1C13"]
    sentence = "impossible values, which count as missing, for 2 positioners (see its notes); 1 of all positioners"
    targets = rs.synthetic_catalog("uniform", "10h +2d", 0.05 * u.deg, n_targets=9, rng=1)
    tile = rs.plan_tile(targets, inst, "10h +2d", allocator="nearest")
    survey = rs.plan_survey(targets, inst, SkyCoord(["10h +2d"]), allocator="nearest")
    assert all(sentence in summary["model"] for summary in (tile.summary, survey.summary))
    targets.write(tmp_path / "targets.ecsv")
    code, out, err = run("plan", tmp_path / "targets.ecsv", "--instrument", folder, "--center", "10h +2d")
    assert (code, sentence in " ".join(out.split())) == (0, True), err


@pytest.mark.parametrize("column", ["R", "c0", "c1", "c4"])
def test_impossible_radial_maps_are_refused(folder, column):
    rows = [line.split(",") for line in sdssv_files.MODEL.format("APO").splitlines()]
    rows[2][rows[1].index(column)] = "-999"
    (folder / "focalPlaneModel.csv").write_text("\n".join(",".join(row) for row in rows) + "\n")
    refused(r"focalPlaneModel.csv: .*row 1", rs.Instrument.read, folder)


OPTIONAL = ("fiberAssignments", "fiducialCoords", "focalPlaneModel", "wokOrientation")


PLACES_FOR = (
    lambda path: path.symlink_to(path.with_name("nowhere.csv")),
    lambda path: path.symlink_to(path.name),
    Path.mkdir,
)


@pytest.mark.few(3)
@pytest.mark.parametrize("place", PLACES_FOR)
@pytest.mark.parametrize("name", OPTIONAL)
def test_optional_files_that_cannot_be_read_are_refused(folder, name, place):
    """The instrument silently had the values of the preset, such as 46 obstacles instead of 42."""
    path = folder / f"{name}.csv"
    path.unlink()
    place(path)
    assert refused("", rs.Instrument.read, folder).startswith(str(path))


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="every file is readable for this user")
def test_optional_files_without_permission_are_refused(folder):
    (folder / "fiducialCoords.csv").chmod(0)
    refused(r"fiducialCoords.csv cannot be read", rs.Instrument.read, folder)


def test_robots_can_be_disabled(folder):
    plane = rs.Instrument.from_sdssv(folder, disabled=["R0C13"]).focal_plane
    assert plane.id[plane.disabled].tolist() == ["R0C13"]
    refused("unknown robot to disable 'R9C9'", rs.Instrument.from_sdssv, folder, disabled=["R9C9"])


def test_a_shifted_wok_gives_a_warning(tmp_path):
    folder = sdssv_files.calibration(tmp_path / "tilt", wokOrientation=lambda rows: [{**rows[0], "xTilt": 0.01}])
    inst = warned(r"the wok is shifted or tilted \(xTilt = 0.01\)", rs.Instrument.read, folder)
    assert "xTilt = 0.01" in inst.notes


def test_a_rotated_robot_turns_its_zero_point_and_its_offset(tmp_path):
    """With i along +x, the robot frame is that of the wok."""
    folder = sdssv_files.calibration(
        tmp_path / "rotated", wokCoords=changed("R0C13", ix=1, iy=0, jx=0, jy=1), positionerTable=lambda rows: rows
    )
    plane = rs.Instrument.read(folder).focal_plane
    k, own = row_of(plane, "R0C13"), sdssv_files.robot_values()["R0C13"]
    assert_allclose(plane.zero_points[k, 0].to_value(u.deg), own["alphaOffset"], atol=1e-12)
    center = dict(zip(*[(p := rs.Instrument.preset("sdss_apo").focal_plane).id.tolist(), p.xy.value], strict=True))
    assert_allclose(plane.xy[k].value, center["R0C13"] + [own["dx"], own["dy"]])


def test_two_sites_need_a_choice(tmp_path):
    def both(rows):
        return [*rows, *({**row, "site": "LCO"} for row in rows)]

    names = ("positionerTable", "wokCoords", "fiberAssignments", "fiducialCoords", "wokOrientation")
    folder = sdssv_files.calibration(tmp_path / "both", **dict.fromkeys(names, both))
    model = folder / "focalPlaneModel.csv"
    model.write_text(model.read_text() + "".join(sdssv_files.MODEL_LCO.splitlines(keepends=True)[1:]))
    refused(r"positionerTable.csv: site must be one of APO, LCO", rs.Instrument.read, folder)
    assert rs.Instrument.from_sdssv(folder, site="LCO").name == "sdss_lco"
    refused("site must be APO or LCO, got 'KPNO'", rs.Instrument.from_sdssv, folder, site="KPNO")


def rows(change):
    """Return a function that changes all rows."""
    return lambda given: [change(row) for row in given]


def twice(given):
    return [*given, given[0]]


BAD = {
    "unknown site": ("positionerTable", rows(lambda r: {**r, "site": "KPNO"}), "site must be APO or LCO"),
    "missing column": (
        "positionerTable",
        rows(lambda r: {k: v for k, v in r.items() if k != "alphaArmLen"}),
        "the table must have the column 'alphaArmLen'",
    ),
    "text": ("positionerTable", changed("R0C13", dx="far"), "column 'dx' must hold numbers, .*'far'"),
    "infinite": ("positionerTable", changed("R0C13", dx="inf"), "'dx' must hold finite .*, got 'inf' in row 5"),
    "twice": ("positionerTable", twice, "'holeID' must be unique, but 'R\\+2C13' occurs more than once"),
    "no hole": ("wokCoords", changed("R0C13", holeID="R9C9"), "must have all holes of .*, but R0C13 is missing"),
    "empty hole": ("wokCoords", changed("R0C13", holeID=""), "must have a value in each row"),
    "no position": ("wokCoords", changed("R0C13", xWok=""), "'xWok' must hold finite numbers .*, got '' in row 3"),
    "code of a position": ("wokCoords", changed("R0C13", yWok=-999.0), "'yWok' must hold .*, got '-999.0' in row 3"),
    "small code": ("wokCoords", changed("R0C13", yWok=99), "'yWok' must hold .*, got '99.0' in row 3"),
    "another hole": ("wokCoords", changed("R0C13", xWok=0, yWok=0), r"5 mm .* \[0.0, 0.0\] for R0C13 in row 3"),
    "code of a fiducial": ("fiducialCoords", changed("R-2C12", yWok=-99), "'yWok' must hold .*, got '-99.0' in row 1"),
    "code of a shift": ("wokOrientation", rows(lambda r: {**r, "x": -999}), "'x' must hold .* '-999' in row 1"),
    "tilted robot": ("wokCoords", changed("R0C13", iz=0.1), "must stand perpendicular to the focal plane"),
    "mirrored robot": ("wokCoords", changed("R0C13", jx=-1), "must stand perpendicular to the focal plane"),
    "fibers twice": ("fiberAssignments", twice, "must be unique"),
    "fiducial": ("fiducialCoords", changed("R-2C12", xWok="x"), "column 'xWok' must hold numbers"),
    "orientation": ("wokOrientation", rows(lambda r: {**r, "x": "?"}), "column 'x' must hold numbers"),
    "other site": ("wokOrientation", rows(lambda r: {**r, "site": "LCO"}), "must have rows of the site APO"),
}


@pytest.mark.few(4)
@pytest.mark.parametrize("case", BAD)
def test_bad_tables_are_refused_with_the_name_of_the_file(tmp_path, case):
    name, change, message = BAD[case]
    folder = sdssv_files.calibration(tmp_path / "bad", **{name: change})
    text = refused(message, rs.Instrument.read, folder)
    assert str(folder / f"{name}.csv") in text
    assert "\n" not in text


NAMES = ("positionerTable", "wokCoords", "fiberAssignments", "fiducialCoords", "focalPlaneModel", "wokOrientation")


@pytest.mark.few(5)
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("content", ["", "site,holeID\n", "\x00\x01\x02", "# only a comment\n"])
def test_damaged_files_are_refused(folder, name, content):
    path = folder / f"{name}.csv"
    path.write_text(content)
    assert str(path) in refused("", rs.Instrument.read, folder)


@pytest.mark.parametrize("name", ["positionerTable", "wokCoords", "focalPlaneModel"])
def test_truncated_files_are_refused(folder, name):
    path = folder / f"{name}.csv"
    text = path.read_text()
    path.write_text(text[: len(text) // 2].rpartition(",")[0])
    assert refused("", rs.Instrument.read, folder).startswith((str(path), str(folder / "wokCoords.csv")))
    refused("positionerTable", rs.Instrument.from_sdssv, folder.parent)
    refused("there is no such folder", rs.Instrument.from_sdssv, folder / "nothing")


def test_a_table_that_ends_early_gives_a_warning(tmp_path):
    folder = sdssv_files.calibration(tmp_path / "short", positionerTable=lambda rows: rows[:-2])
    with pytest.warns(rs.RfpsurveyWarning, match="fiberAssignments.csv has 2 positioners without a row"):
        assert len(rs.Instrument.read(folder).focal_plane) == 5
