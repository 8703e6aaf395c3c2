"""confSummary files of SDSS-V: invented ones, and the real ones of 2021 and 2024."""

import gzip
import subprocess
import sys
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from numpy.testing import assert_allclose, assert_array_equal
from raising import refused, warned

import rfpsurvey as rs
import sdssv_files
from rfpsurvey import plans

pytest.importorskip("pydl", reason="pydl is not installed")


@pytest.fixture
def path(tmp_path):
    return sdssv_files.configuration(tmp_path / "confSummary-7.par")


@pytest.fixture
def built(tmp_path):
    return rs.Instrument.read(sdssv_files.calibration(tmp_path / "calibration"))


def assert_same(one, other):
    assert (one.colnames, one.meta) == (other.colnames, other.meta)
    for name in one.colnames:
        a, b = np.asarray(one[name]), np.asarray(other[name])
        assert a.dtype.kind == b.dtype.kind, name
        assert_array_equal(a, b, name)


def files_in(folder):
    return sorted(path.name for path in folder.iterdir())


def test_the_common_columns_are_those_of_the_file(path):
    plan = plans.read_plan(path)
    assert plans.is_plan(plan)
    assert (len(plan), plan.meta["instrument"]) == (21, "sdss_apo")
    assert [plan.meta[name] for name in ("racen", "deccen", "position_angle")] == [120.0, 30.0, 60.0]
    assert (plan.meta["epoch"], plan.meta["header"]["configuration_id"]) == ("J2024.317591", "7")
    first = plan[1]
    assert (first["positioner"], first["fiber_type"], first["kind"]) == ("R-1C13", "BOSS", "sky")
    assert (first["target_id"], first["ra"], first["dec"]) == (27021597909966377, 120 * u.deg, 30 * u.deg)
    assert plan["assigned"].sum() == 6
    assert_array_equal(np.unique(plan["target_id"][~plan["assigned"]]), [-1])
    assert np.isnan(plan["ra"][~plan["assigned"]].value).all()
    assert plan["kind"][plan["assigned"]].tolist() == ["sky", "standard", "sky", "science", "science", "science"]
    assert (plan["theta"].unit, plan["theta"][3].value) == (u.deg, np.float32(43))


def test_files_without_wok_coordinates_are_rotated_by_the_position_angle(tmp_path, path):
    old = plans.read_plan(sdssv_files.configuration(tmp_path / "old.par", wok=False))
    new = plans.read_plan(path)
    assert_allclose(old["x"].value, new["x"].value, atol=1e-12)
    assert_allclose(old["y"].value, new["y"].value, atol=1e-12)
    assert np.abs(old["xFocal"] - old["x"].value).max() > 1


def test_a_plan_scores_without_options(path, built):
    plan = plans.read_plan(path)
    tile = rs.score_tile(plan, built)
    assert tile.summary["n_assigned"] == 6
    assert tile.summary["n_out_of_reach"] == tile.summary["n_wrong_fiber"] == 0
    rows, own = tile.table[tile.table["status"] == "assigned"], plan[plan["assigned"]]
    order = [own["positioner"].tolist().index(hole) for hole in rows["id"].tolist()]
    for name in ("theta", "phi"):
        assert_allclose(rows[name].value, own[name].value[order], atol=1e-4)


@pytest.mark.few(2)
@pytest.mark.parametrize("name", ["new.par", "new.par.gz", "new.ecsv", "new.fits"])
@pytest.mark.parametrize("wok", [True, False])
def test_reading_what_was_written_gives_the_same_plan(tmp_path, name, wok):
    plan = plans.read_plan(sdssv_files.configuration(tmp_path / "a.par.gz", wok=wok))
    plans.write_plan(plan, tmp_path / name)
    assert_same(plans.read_plan(tmp_path / name), plan)


def test_changed_positions_replace_the_focal_ones(tmp_path, path):
    plan = plans.read_plan(path)
    plan["x"] += 1 * u.mm
    plans.write_plan(plan, tmp_path / "b.par")
    again = plans.read_plan(tmp_path / "b.par")
    assert_allclose(again["x"].value, plan["x"].value)
    assert_allclose(again["xFocal"], plan["xFocal"] + np.cos(np.deg2rad(60)))


def test_a_tile_survives_with_its_assignment_and_collisions(tmp_path, path, built):
    plan = plans.read_plan(path)
    x, y = plan["x"][1].value, plan["y"][1].value
    close = replace(built, focal_plane=replace(built.focal_plane, obstacles=[[x, y, 3]] * u.mm))
    tile = rs.score_tile(plan, close)
    warned("without the column spectrograph", tile.write, tmp_path / "tile.par.gz", format="confsummary")
    plan = plans.read_plan(tmp_path / "tile.par.gz")
    again = rs.score_tile(plan, close)
    assert tile.summary["n_obstacle_collisions"] > 0
    for name in ("id", "status", "fiber_type", "in_collision", "colliding_with"):
        assert_array_equal(tile.table[name], again.table[name])
    taken = tile.table["status"] == "assigned"
    assert_array_equal(tile.table["target_id"][taken], again.table["target_id"][taken])
    assert_allclose(plan["theta"].value[taken], tile.table["theta"].value[taken], atol=1e-4)


def test_joint_angles_of_nominal_arms_are_left_out(tmp_path, path):
    tile = warned("the arms are nominal", lambda: rs.score_tile(plans.read_plan(path), "sdss_apo"))
    with pytest.warns(rs.RfpsurveyWarning, match="the joint angles computed from nominal arm lengths"):
        tile.write(tmp_path / "tile.par", format="confsummary")
    assert np.isnan(plans.read_plan(tmp_path / "tile.par")["theta"]).all()


def test_plans_of_other_instruments_are_refused(tmp_path, small):
    x, y = rs.Instrument.preset("lamost").focal_plane.xy[:2].T
    tile = rs.score_tile(QTable({"positioner": [0, 1], "x": x, "y": y}), "lamost")
    refused("must be sdss_apo or sdss_lco, got lamost", tile.write, tmp_path / "tile.par", format="confsummary")
    assert files_in(tmp_path) == []


def test_a_header_that_cannot_be_read_again_is_not_written(tmp_path, path):
    """Regression: a plan table with a damaged epoch was converted to a file that could not be read."""
    plan = plans.read_plan(path)
    plan.meta["header"]["epoch"] = "618"
    refused("epoch in the header must be a Julian date from .*, got 618", plans.write_plan, plan, tmp_path / "bad.par")
    assert not (tmp_path / "bad.par").exists()


def test_text_that_yanny_files_cannot_hold_is_refused(tmp_path, path):
    plan = plans.read_plan(path)
    for text in ('a "word"', "{a", "a\\", "größe"):
        bad = plan.copy()
        bad["category"] = text
        refused("yanny files cannot hold the text", plans.write_plan, bad, tmp_path / "bad.par")
    ids = plan.copy()
    ids.replace_column("target_id", np.full(21, "star 1"))
    refused("catalogid must be whole numbers, got text", plans.write_plan, ids, tmp_path / "bad.par")
    plan.meta["header"]["note"] = "a # b"
    refused("cannot hold the keyword 'note'", plans.write_plan, plan, tmp_path / "bad.par")
    assert files_in(tmp_path) == ["confSummary-7.par"]


def test_existing_files_are_kept_unless_asked(tmp_path, path):
    plan = plans.read_plan(path)
    refused("exists; to replace it, use overwrite=True", plans.write_plan, plan, path)
    plans.write_plan(plan, path, overwrite=True)
    assert_same(plans.read_plan(path), plan)
    refused("the name of a plan must end in one of", plans.write_plan, plan, tmp_path / "plan.txt")


def rename(name, other):
    return lambda text: text.replace(f" {name};", f" {other};", 1)


BAD = {
    "cut in a row": (lambda text: text[:-30], "the last line must end with a line break"),
    "cut after a row": (lambda text: text.rpartition("FIBERMAP 6 R+2C13 M")[0], "the same number of rows, got 2 to 3"),
    "cut in the definition": (lambda text: text[: text.index("double racat")] + "\n", "complete definition"),
    "short row": (lambda text: text.replace(" 1.5 {", " {", 1), "cannot be read as yanny"),
    "text": (lambda text: text.replace("43.0 ", "far ", 1), "cannot be read as yanny.*'far'"),
    "no hole": (rename("holeId[28]", "hole[28]"), "FIBERMAP must have the column 'holeId'"),
    "no assigned": (rename("assigned", "used"), "FIBERMAP must have the column 'assigned'"),
    "no rows": (lambda text: text[: text.index("FIBERMAP 0")], "at least one row"),
    "site": (lambda text: text.replace("observatory APO", "observatory KPNO"), "observatory must be APO or LCO"),
    "no site": (lambda text: text.replace("observatory APO\n", ""), "observatory must be APO or LCO, got ''"),
    "angle": (lambda text: text.replace("pa 60.0", "pa north"), "pa in the header must be a number, got 'north'"),
    "twice": (lambda text: text.replace(" R-1C14 ", " R-1C13 "), "each fiber must have one row, got several"),
    "wide": (lambda text: text.replace("category[40]", "category[99999999]"), "rows of text must fit into memory"),
    "epoch": (lambda text: text.replace("epoch 2460427", "epoch soon"), "epoch in the header must be .* 'soon'"),
    "no epoch": (lambda text: text.replace("epoch 2460427", "epoch nan"), "epoch in the header must be a finite"),
    "MJD": (lambda text: text.replace("epoch 2460427", "epoch 60427.5"), "must be a Julian date from .* got 60427.5"),
    "other text": (lambda text: "stars\n", "complete definition"),
    "empty": (lambda text: "", "the last line must end with a line break"),
}


@pytest.mark.few(9)
@pytest.mark.parametrize("case", BAD)
@pytest.mark.parametrize("name", ["bad.par", "bad.par.gz"])
def test_damaged_files_are_refused_in_one_sentence(tmp_path, case, name):
    change, message = BAD[case]
    path = sdssv_files.configuration(tmp_path / name, change=change)
    text = refused(message, plans.read_plan, path)
    assert str(path) in text
    assert "\n" not in text


def test_positions_are_required(tmp_path):
    path = sdssv_files.configuration(tmp_path / "bad.par", change=lambda t: t.replace("ocal;", "ocaL;"), wok=False)
    refused("must have xwok and ywok, or xFocal and yFocal", plans.read_plan, path)
    path = sdssv_files.configuration(tmp_path / "old.par", change=lambda t: t.replace("pa 60.0\n", ""), wok=False)
    refused("must have the position angle pa", plans.read_plan, path)


def test_a_truncated_archive_is_refused(tmp_path):
    path = sdssv_files.configuration(tmp_path / "a.par.gz")
    path.write_bytes(path.read_bytes()[:-40])
    refused(r"a.par.gz cannot be read", plans.read_plan, path)


def test_without_pydl_the_message_names_the_remedy(path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pydl.pydlutils.yanny", None)
    refused(r"another package: .* \(pip install 'rfpsurvey\[sdss\]'\)", plans.read_plan, path)


def test_reading_issues_no_warning_of_pydl(path):
    """In a new process, because pydl warns when it is first imported."""
    code = f"import rfpsurvey as rs; print(len(rs.plans.read_plan({str(path)!r})))"
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == ("21", "")


def test_formats_are_recognized_by_content(tmp_path, path):
    other = tmp_path / "configuration.txt"
    other.write_bytes(gzip.compress(path.read_bytes()))
    assert (plans.recognize_plan(other), len(plans.read_plan(other))) == ("confsummary", 21)
    other.write_text("#%yanny\n")
    assert plans.recognize_plan(other) is None
    refused("must be a plan in one of the formats", plans.read_plan, other)
    refused("unknown format of plans 'par'", plans.read_plan, path, format="par")


def test_commands_read_and_write_plans(run, tmp_path, path, built, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = run("score", str(path))
    assert code == 0, err
    assert "sdss_apo, nominal, allocator scored" in out
    code, out, _ = run("score", str(path), "--instrument", str(tmp_path / "calibration"), "--output", "tile.fits")
    assert code == 0
    code, out, err = run("convert", "tile.fits", "tile.par.gz")
    assert code == 0
    assert out == "tile.par.gz: 6 of 7 fibers of sdss_apo have a target\n"
    assert "the column spectrograph" in err
    code, _, err = run("convert", "tile.fits", "tile.par.gz")
    assert code == 2
    assert "tile.par.gz exists" in err
    assert run("convert", str(path), "plan.ecsv", "--format", "table", "--overwrite")[0] == 0
    assert plans.recognize_plan("plan.ecsv") == "table"
    assert run("convert", "plan.ecsv", "back.par")[0] == 0
    assert_same(plans.read_plan("back.par"), plans.read_plan(path))
    code, _, err = run("convert", "nothing.par", "a.par")
    assert code == 2
    assert "nothing.par: there is no such file" in err


def test_an_epoch_can_be_a_date(tmp_path):
    path = sdssv_files.configuration(
        tmp_path / "a.par", change=lambda text: text.replace("epoch 2460427", "epoch 2024-04-26")
    )
    assert plans.read_plan(path).meta["epoch"] == "J2024.316222"


def test_columns_of_several_texts_and_with_common_names_are_kept(tmp_path):
    """Writing the first one ended with a traceback, and the second one replaced the kinds of the targets."""

    def change(text):
        return text.replace("float mag[2];", "char mag[2][9];").replace("float pmra;", "float kind;")

    plan = plans.read_plan(sdssv_files.configuration(tmp_path / "a.par", change=change))
    assert plan["mag"].shape == (21, 2)
    assert "science" in plan["kind"].tolist()
    assert plan["kind_in_file"].max() == 1.5
    plans.write_plan(plan, tmp_path / "b.par")
    assert_same(plan, plans.read_plan(tmp_path / "b.par"))
    plans.write_plan(plan, tmp_path / "b.ecsv")
    plans.write_plan(plans.read_plan(tmp_path / "b.ecsv"), tmp_path / "c.par")
    assert_same(plan, plans.read_plan(tmp_path / "c.par"))


REAL = ["sdssv_apo_2024/confSummary-test", "sdssv_apo_2021/confSummary-998", "sdssv_apo_2021/confSummaryF-998"]


@pytest.mark.few(1)
@pytest.mark.parametrize("name", REAL)
def test_real_configurations_survive_writing(real_data, tmp_path, name):
    source = real_data(f"{name}.par.gz")
    plan = plans.read_plan(source)
    assert len(plan) == 1500
    plans.write_plan(plan, tmp_path / "new.par.gz")
    assert_same(plans.read_plan(tmp_path / "new.par.gz"), plan)

    def rows_of(path):
        text = gzip.decompress(path.read_bytes()).decode()
        return [line for line in text.splitlines() if line.startswith("FIBERMAP ")]

    # missing proper motions are nan or -999 in the files, and -999 in those written here
    old, new = rows_of(source), rows_of(tmp_path / "new.par.gz")
    changed = [k for k, (a, b) in enumerate(zip(old, new, strict=True)) if a != b]
    assert all(" nan nan nan " in old[k] for k in changed)
    assert len(changed) <= 91


def test_a_real_configuration_has_no_position_for_one_fiber_in_2021(real_data):
    plan = plans.read_plan(real_data("sdssv_apo_2021/confSummary-998.par.gz"))
    lost = plan[~np.isfinite(plan["x"].value)]
    assert [*zip(lost["positioner"], lost["fiber_type"], strict=True)] == [("R+8C7", "BOSS")]
    assert plan["assigned"].sum() == 298


def test_files_that_cannot_be_read_again_are_not_written(tmp_path, path):
    """A plan without a required column was written."""
    plan = plans.read_plan(path)
    plan.meta["struct"] = [entry.replace("holeId", "hole") for entry in plan.meta["struct"]]
    with pytest.raises(rs.InputError, match=r"b\.par: the table FIBERMAP must have the column 'holeId', got "):
        plans.write_plan(plan, tmp_path / "b.par")
    assert not (tmp_path / "b.par").exists()
