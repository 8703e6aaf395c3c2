"""Files of DESI that are damaged or incomplete."""

import gzip

import desi_files
import numpy as np
import pytest
from astropy.table import Table
from raising import refused, warned

import rfpsurvey as rs
from damaged_files import FINE, damage, outcome
from valid_files import Sample

FEW = 20  # positioners of each petal
partial = pytest.mark.filterwarnings("ignore:.*DESI has 5000 positioners")


@pytest.fixture
def folder(tmp_path):
    return desi_files.folder_with_state(tmp_path, per_petal=FEW)


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
