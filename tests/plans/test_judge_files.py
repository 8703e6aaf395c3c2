"""Files of other programs that the judge of plans reads, and its counts for recorded plans and for several tiles."""

import json
import sys
from pathlib import Path

import astropy.units as u
import desi_files
import numpy as np
import pfs_files
import pytest
from astropy.table import Table

import rfpsurvey as rs
import sdssv_files
from rfpsurvey._instruments.pfs_files import pfs_fibers

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks" / "planners"))
import judge
import plan_files
import scene as scenes


def scene_with_targets(instrument, plan):
    """Return a scene whose targets are those of a plan."""
    columns = {
        "id": plan["target"],
        **{name: plan[name] for name in ("x", "y", "kind", "fiber_type") if name in plan.colnames},
    }
    return scenes.scene_of(instrument, Table(columns), name="recorded")


def judged(scene, plan, **options):
    """Return the counts of the judge."""
    return judge.judge((scene.positioners, scene.targets, scene.settings), plan, **options)


@pytest.mark.parametrize(("wok", "suffix"), [(True, ".par"), (False, ".par.gz")])
def test_fibers_of_a_configuration_of_sdssv_are_read(wok, suffix, tmp_path, presets):
    """Older files contain positions along east and north only, which the position angle rotates."""
    path = sdssv_files.configuration(tmp_path / f"confSummary-7{suffix}", wok=wok)
    plan = plan_files.read_plan(path, None)
    holes = [hole for k, hole in enumerate(sdssv_files.HOLES) if k != 4]
    assert plan["positioner"].tolist() == holes
    assert plan["target"].tolist() == [str(27021597909966377 + k) for k in (0, 1, 2, 3, 5, 6)]
    assert plan["kind"].tolist() == ["sky", "standard", "sky", *["science"] * 3]
    assert plan["fiber_type"].tolist() == ["BOSS", "BOSS", "APOGEE", *["BOSS"] * 3]
    plane = presets["sdss_apo"].focal_plane
    center = dict(zip(plane.id.tolist(), plane.xy.value.tolist(), strict=True))
    values = sdssv_files.robot_values()[holes[-1]]
    expected = sdssv_files.formula(values, center[holes[-1]], 40.0 * 6 + 3, 60.0 + 60, "boss")
    np.testing.assert_allclose([plan["x"][-1], plan["y"][-1]], expected, atol=1e-6)


def test_fibers_of_a_pfs_design_are_read(tmp_path, presets):
    """Cobras are found by cobraId, or by the fiber of the scene in designs without cobraId."""
    columns, flux, stars = pfs_files.design()
    path = pfs_files.write_design(tmp_path / "pfsDesign-0x1.fits", (columns, flux, stars))
    positioners = Table({"id": np.arange(1, 2395), "fiber": pfs_fibers()[0]})
    plan = plan_files.read_plan(path, positioners)
    rows = np.flatnonzero(np.isin(columns["targetType"], [1, 2, 3]))
    assert plan["positioner"].tolist() == (rows + 1).tolist()
    assert plan["target"].tolist() == columns["objId"][rows].tolist()
    assert set(plan["kind"]) == {"science", "sky", "standard"}
    np.testing.assert_array_equal(np.column_stack([plan["x"], plan["y"]]), columns["pfiNominal"][rows])
    with pytest.raises(ValueError, match="must have the column fiber"):
        plan_files.read_plan(path, positioners["id",])
    columns["cobraId"] = np.append(np.arange(100, 160), 65535).astype("i4")
    path = pfs_files.write_design(tmp_path / "pfsDesign-0x2.fits", (columns, flux, stars))
    assert plan_files.read_plan(path, positioners["id",])["positioner"].tolist() == (rows + 100).tolist()


def test_fibers_of_a_file_of_fiberassign_are_read(tmp_path):
    """Locations without a target have negative identifiers."""
    table = desi_files.tile(tmp_path / "fiberassign-004403.fits.gz", per_petal=20)
    plan = plan_files.read_plan(tmp_path / "fiberassign-004403.fits.gz", None)
    used = table[table["TARGETID"] >= 0]
    assert len(used) < len(table)
    assert plan["positioner"].tolist() == used["LOCATION"].tolist()
    assert plan["target"].tolist() == used["TARGETID"].tolist()


@pytest.mark.parametrize("name", ["plan.ecsv", "plan.fits"])
def test_plain_tables_and_tables_of_rfpsurvey_are_read(name, tmp_path):
    path = tmp_path / name
    Table({"id": [1, 2, 3], "target_id": [7, -1, 9], "handedness": ["left", "", "right"]}).write(path)
    assert [tuple(one) for one in plan_files.read_plan(path, None)] == [(1, 7, "left"), (3, 9, "right")]
    Table({"a": [1]}).write(path, overwrite=True)
    with pytest.raises(ValueError, match="must have the columns positioner and target, got a"):
        plan_files.read_plan(path, None)


def test_rows_of_a_configuration_that_do_not_fit_its_structure_are_refused(tmp_path):
    path = sdssv_files.configuration(tmp_path / "a.par", change=lambda text: text.replace(" {-999.0 nan}", "", 1))
    with pytest.raises(ValueError, match="a row of FIBERMAP must have 17 values, got 16"):
        plan_files.read_plan(path, None)
    (tmp_path / "b.par").write_text("pa 1\n")
    with pytest.raises(ValueError, match="must define the structure FIBERMAP"):
        plan_files.read_plan(tmp_path / "b.par", None)


def test_the_recorded_plan_of_a_field_of_sdssv_observes_492_of_its_494_targets(real_data, monkeypatch):
    """One target is out of reach of the nominal arms, and one arm is too close to the nominal place of a fiducial."""
    real_data("sdssv_robostrategy_field_a.ecsv")
    scene = scenes.SCENES["field_a"]()
    found = judged(scene, Table(rows=scene.settings["recorded"], names=("positioner", "target")))
    assert found["assigned"] == 494
    assert found["standard"] + found["sky"] == 492
    assert (found["colliding"], found["pairs"], found["wrong"]) == (1, 0, {"out of reach": 1})


CONFIGURATIONS_SDSSV = [
    ("sdssv_apo_2021/confSummary-998.par.gz", 298, 297),
    ("sdssv_apo_2021/confSummaryF-998.par.gz", 298, 298),
    ("sdssv_apo_2024/confSummary-test.par.gz", 500, 494),
]


@pytest.mark.parametrize(("name", "assigned", "observed"), CONFIGURATIONS_SDSSV)
def test_configurations_of_sdssv_are_judged(name, assigned, observed, real_data, presets):
    plan = plan_files.read_plan(real_data(name), None)
    found = judged(scene_with_targets(presets["sdss_apo"], plan), plan)
    assert found["assigned"] == assigned
    assert found["science"] + found["standard"] + found["sky"] == observed


def two_tiles(presets):
    """Return a scene with two LAMOST positioners and two tiles, which share the target 5."""
    plane = presets["lamost"].focal_plane
    part = rs.FocalPlane(plane.xy[:2], plane.positioner, id=plane.id[:2])
    x, y = part.xy.to_value(u.mm).T
    targets = {"id": [5, 6, 5, 7], "x": x[[0, 1, 1, 0]] + 6.0, "y": y[[0, 1, 1, 0]], "priority": [2.0, 1.0, 2.0, 1.0]}
    scene = scenes.scene_of(rs.Instrument("two", part, plate_scale=1 * u.mm / u.arcsec), Table(targets), name="two")
    scene.targets["tile"] = [0, 0, 1, 1]
    scene.settings["tiles"] = [{"ra": 0.0, "dec": 0.0}, {"ra": 0.1, "dec": 0.0}]
    return scene, part.id.tolist()


def test_a_target_of_two_tiles_counts_once(presets):
    scene, (a, b) = two_tiles(presets)
    plan = Table({"positioner": [a, b, b, a], "target": [5, 6, 5, 7], "tile": [0, 0, 1, 1]})
    found = judged(scene, plan)
    assert (found["assigned"], found["science"], found["doubles"]) == (4, 3, 1)
    assert found["by_priority"] == [1, 2]
    assert not found["wrong"]


def test_targets_and_positioners_that_the_scene_lacks_are_errors(presets):
    scene, (a, b) = two_tiles(presets)
    plan = Table({"positioner": [a, b], "target": [6, 7], "tile": [1, 0]})
    assert judged(scene, plan)["wrong"] == {"positioner or target that the scene lacks": 2}


def test_the_judge_refuses_files_in_one_sentence(presets, tmp_path, monkeypatch, capsys):
    scene, (a, _) = two_tiles(presets)
    scene.write(tmp_path / "two.fits")
    Table({"positioner": [a], "target": [5]}).write(tmp_path / "plan.ecsv")
    for name, reason in (
        ("plan.ecsv", "must have the column tile, got positioner, target"),
        ("none.ecsv", "none.ecsv"),
    ):
        monkeypatch.setattr(sys, "argv", ["judge.py", str(tmp_path / "two.fits"), str(tmp_path / name)])
        with pytest.raises(SystemExit) as caught:
            judge.main()
        assert caught.value.code == 2
        assert reason in capsys.readouterr().err


def test_idle_arms_can_be_ignored_on_the_command_line(presets, tmp_path, monkeypatch, capsys):
    """A parked arm stands in the way of the arm at a target between them."""
    unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm, home=[180, 0] * u.deg)
    plane, targets = rs.FocalPlane([[0, 0], [20, 0]] * u.mm, unit), Table({"x": [9.0], "y": [0.0]})
    instrument = rs.Instrument("pair", plane, plate_scale=1 * u.mm / u.arcsec)
    scenes.scene_of(instrument, targets, name="pair").write(tmp_path / "pair.fits")
    Table({"positioner": plane.id[:1], "target": [0]}).write(tmp_path / "plan.ecsv")
    counts = []
    for option in ([], ["--ignore-idle"]):
        words = ["judge.py", str(tmp_path / "pair.fits"), str(tmp_path / "plan.ecsv"), *option]
        monkeypatch.setattr(sys, "argv", words)
        judge.main()
        counts.append(json.loads(capsys.readouterr().out.partition(" ")[2]))
    assert [(one["science"], one["colliding"]) for one in counts] == [(0, 1), (1, 0)]
