"""The comparison of planners: the table of results, its tables and figure in the documentation, drivers and readers."""

import csv
import dataclasses
import importlib
import importlib.metadata
import importlib.util
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from astropy.table import Table, vstack

import rfpsurvey as rs

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks" / "planners"))
import compare
import ours
import results
import scene as scenes

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "tests" / "benchmarks" / "planners"


@pytest.fixture
def small(presets, tmp_path):
    """Return the path of a scene with seven LAMOST positioners and ten targets."""
    plane = presets["lamost"].focal_plane
    rows = np.sort(np.argsort(np.hypot(*plane.xy.value.T))[:7])
    part = rs.FocalPlane(plane.xy[rows], plane.positioner, id=plane.id[rows])
    instrument = rs.Instrument("small", part, plate_scale=presets["lamost"].plate_scale)
    targets, path = scenes.in_circle(instrument, 10, 1), tmp_path / "small.fits"
    scenes.scene_of(instrument, targets, name="small").write(path)
    return path


def command(monkeypatch, capsys, *words):
    """Run compare.py and return its output."""
    monkeypatch.setattr(sys, "argv", ["compare.py", *map(str, words)])
    compare.main()
    return capsys.readouterr().out


def row(scene, program, science, **changes):
    """Return a row of results."""
    usual = {name: kind() for name, kind in results.COLUMNS.items()}
    return {**usual, "scene": scene, "program": program, "science": science, **changes}


def test_results_have_all_columns_and_each_scene_and_program_once():
    table = results.read(FOLDER / "results.ecsv")
    assert (table.colnames, set(table["scene"])) == (list(results.COLUMNS), set(scenes.SCENES))
    assert len({(one["scene"], one["program"]) for one in table}) == len(table)
    assert (FOLDER / "results.ecsv").stat().st_size < 30_000
    assert [sum(map(int, one["by_class"].split())) for one in table] == table["science"].tolist()
    assert (table["science_without_idle"] >= table["science"]).all()
    for one in table:
        assert all(one[name] for name in ("machine", "date", "limit")), one["program"]


def test_tables_of_the_page_contain_the_results(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs")
    import planner_tables

    planner_tables.write_tables(tmp_path)
    page = (ROOT / "docs" / "related.rst").read_text()
    every, found = results.read(FOLDER / "results.ecsv"), set()
    for name, titles in planner_tables.TABLES.items():
        assert f":file: api/planners_{name}.csv" in page
        with (tmp_path / f"planners_{name}.csv").open(newline="") as file:
            given = list(csv.DictReader(file))
        scene = None
        for one in given:
            scene = {title: key for key, title in titles.items()}.get(one["scene"], scene)
            (k,) = np.flatnonzero((every["scene"] == scene) & (every["program"] == one["planner"]))
            science, _, classes = one["science, by class"].partition(": ")
            assert int(science.replace(",", "")) == every["science"][k]
            assert classes.partition(" (")[0].split(", ") == every["by_class"][k].split()
            shown = one["time (s)"].partition(",")[0]
            assert not shown or float(shown) == pytest.approx(every["seconds"][k], rel=0.06)
            found.add(scene)
    assert found == set(scenes.SCENES)


def test_the_figure_shows_the_results(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs")
    with plt.rc_context():
        drawn = runpy.run_path(str(ROOT / "docs" / "figures" / "planners.py"))
        every = results.read(FOLDER / "results.ecsv")
        for ax, scene in zip(drawn["figure"].axes, drawn["SCENES"], strict=True):
            points = {(x, y) for line in ax.lines for x, y in line.get_xydata()}
            some = every[(every["scene"] == scene) & np.isin(every["program"], ["repair", "optimal", "CP-SAT"])]
            assert {(one["seconds"], one["science"]) for one in some} <= points
        plt.close(drawn["figure"])


def test_the_text_of_the_page_agrees_with_the_results():
    """If results change, the section on scenes in which rfpsurvey is not the best must be written again."""
    page = " ".join((ROOT / "docs" / "related.rst").read_text().split())
    every = {(one["scene"], one["program"]): one for one in results.read(FOLDER / "results.ecsv")}
    words = "no one two three four five six seven eight nine ten".split()

    def top(scene, program):
        return int(every[scene, program]["by_class"].split()[0])

    assert f"CP-SAT finds {words[top('hub', 'CP-SAT')]} targets in the top class" in page
    assert top("hub", "optimal") == top("hub", "CP-SAT")
    assert f"``repair`` finds {words[top('hub', 'repair')]} targets in the top class" in page
    less = {one: 100 - 100 * top(one, "repair") / top(one, "optimal") for one in scenes.SCENES}
    assert not any(one["missing"] for (_, program), one in every.items() if program == "repair")
    assert f"``sdss_dark``, it observes {less.pop('sdss_dark'):.1f} % fewer targets of the top class" in page
    del less["hub"]
    assert f"the difference is at most {np.ceil(10 * max(less.values())) / 10:.1f} %" in page
    lower = {}
    for scene in set(less) - {"field_a"}:  # the latter has one class
        second = [int(every[scene, program]["by_class"].split()[1]) for program in ("repair", "optimal")]
        lower[scene] = 100 - 100 * second[0] / second[1]
    worst = max(lower, key=lower.get)
    assert f"In the second class, it is up to {lower[worst]:.1f} % (``{worst}``)" in page
    for scene in ("desi_1_rules", "desi_2_rules"):
        assert every[scene, "optimal"]["seconds"] > every[scene, "fiberassign"]["seconds"]
    recorded = every["field_a", "recorded"]
    assert f"The judge counts {recorded['standard'] + recorded['sky']} of them as observed" in page
    assert {scene for (scene, program), one in every.items() if program == "optimal" and one["gap"] != "0"} == {
        "desi_tiles"  # no bound of all tiles together
    }


RANGES = {
    "fiberassign": ("desi_1", "desi_2", "desi_5", "desi_1_rules", "desi_2_rules"),
    "netflow": ("pfs_3600", "pfs_9600", "pfs_rules"),
    "robostrategy": ("field_a", "sdss_dark"),
}


@pytest.mark.parametrize("name", ["README.rst", "docs/related.rst"])
def test_the_table_of_packages_states_the_range_of_the_results(name):
    """If results change, the rows of both tables must be written again."""
    lines = (ROOT / name).read_text().splitlines()
    every = {(one["scene"], one["program"]): one for one in results.read(FOLDER / "results.ecsv")}
    for column, head, tolerance in (
        ("seconds", "Relative planning time", 0.06),
        ("science", "Relative number of", 5e-4),
    ):
        (line,) = [one for one in lines if one.startswith(head)]
        shown, found = [float(one) for one in re.findall(r"[\d.]+", line)[1:]], []
        for program, some in RANGES.items():  # with the same kind of subpriorities, equal or random
            same = [("fiberassign", "optimal random"), ("fiberassign equal", "optimal")]
            pairs = same if program == "fiberassign" else [(program, "optimal")]
            ratios = [every[scene, a][column] / every[scene, b][column] for scene in some for a, b in pairs]
            found += [min(ratios), max(ratios)]
        assert shown == pytest.approx(found, rel=tolerance)


def test_new_results_replace_rows_of_the_same_scene_and_program_only(tmp_path):
    path = tmp_path / "results.ecsv"
    first = [row("hub", "repair", 6, gap="0"), row("hub", "optimal", 9, seconds=1.23456), row("stuck", "repair", 259)]
    results.write(results.merge(results.read(path), first, ["stuck", "hub"]), path)
    again = [row("hub", "optimal", 10), row("hub", "CP-SAT", 11)]
    results.write(results.merge(results.read(path), again, ["stuck", "hub"]), path)
    table = results.read(path)
    assert list(zip(table["scene"], table["program"], table["science"], strict=True)) == [
        ("stuck", "repair", 259),
        ("hub", "repair", 6),
        ("hub", "optimal", 10),
        ("hub", "CP-SAT", 11),
    ]
    assert table["gap"].tolist() == ["", "0", "", ""]


def test_a_scene_is_compared_from_the_file_to_the_table(small, tmp_path, monkeypatch, capsys):
    path = tmp_path / "out.ecsv"
    words = small, "--program", "repair", "--repeats", 1, "--output", path
    out = command(monkeypatch, capsys, *words)
    (found,) = results.read(path)
    assert (found["scene"], found["program"], found["colliding"], found["wrong"]) == ("small", "repair", 0, 0)
    assert 0 < found["science"] <= 7
    assert f"science {found['science']:6}" in out
    results.write(results.merge(results.read(path), [row("small", "other", 1)], []), path)
    command(monkeypatch, capsys, *words)
    assert len(results.read(path)) == 2


def test_several_programs_run_in_processes_of_their_own(small, tmp_path, monkeypatch, capfd):
    """OR-tools could not be imported after the solver HiGHS, and was reported as not installed."""
    output, plot = tmp_path / "out.ecsv", tmp_path / "plot.png"
    words = "compare.py", small, "--program", "nearest", "--program", "recorded", "--output", output, "--plot", plot
    monkeypatch.setattr(sys, "argv", list(map(str, words)))
    monkeypatch.setenv("PYTHONPATH", path())
    compare.main()
    assert results.read(output)["program"].tolist() == ["nearest"]
    assert "recorded          left out: the scene contains no recorded plan" in capfd.readouterr().out
    assert plot.stat().st_size > 5000


def test_programs_that_are_not_known_are_refused(small, monkeypatch, capsys):
    with pytest.raises(SystemExit):
        command(monkeypatch, capsys, small, "--program", "magic")
    assert "--program must be one of" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        command(monkeypatch, capsys, "magic")
    assert "the scene must be a file (.fits) or one of desi_1, " in capsys.readouterr().err


MISSING = {
    "cpsat": (["ortools.sat.python"], "OR-tools cannot be imported"),
    "desi_fiberassign": (["fiberassign"], "fiberassign cannot be imported"),
    "pfs_netflow": (["ets_fiber_assigner"], "netflow, cobraOps or PuLP cannot be imported"),
    "sdss_kaiju": (["kaiju", "kaiju.cKaiju"], "cannot be imported"),
    "sdss_robostrategy": (["robostrategy"], "robostrategy cannot be imported"),
}


@pytest.mark.parametrize("name", MISSING)
def test_a_program_that_is_not_installed_is_skipped_with_the_reason(name, small, monkeypatch, capsys):
    modules, reason = MISSING[name]
    for module in modules:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.delitem(sys.modules, name, raising=False)
    out = command(monkeypatch, capsys, small, "--program", name)
    assert f"{name}: skipped, " in out
    assert reason in out


@pytest.fixture
def netflow(monkeypatch):
    """Return the driver of netflow, with empty modules instead of netflow, cobraOps and PuLP, which need not exist."""
    names = ["ets_fiber_assigner", "ics", "ics.cobraOps", "ics.cobraOps.Bench", "pandas", "pulp"]
    names += ["ics.cobraCharmer", "ics.cobraCharmer.cobraCoach"]
    for name in names:
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    kinds = dict.fromkeys(("ScienceTarget", "CalibTarget"), lambda *values: values)
    sys.modules["ets_fiber_assigner"].netflow = SimpleNamespace(**kinds)
    sys.modules["ics.cobraOps.Bench"].Bench = None
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "0")
    monkeypatch.delitem(sys.modules, "pfs_netflow", raising=False)
    yield importlib.import_module("pfs_netflow")
    sys.modules.pop("pfs_netflow")


@pytest.mark.parametrize(("classes", "requirements"), [(5, False), (6, False), (3, True), (4, True)])
def test_netflow_refuses_more_classes_than_its_costs_can_order(classes, requirements, netflow, presets, monkeypatch):
    """The limits are 5 classes, or 3 with calibration targets: each class costs 100 times as much as the next one."""
    plane = presets["lamost"].focal_plane
    part = rs.FocalPlane(plane.xy[:7], plane.positioner, id=plane.id[:7])
    instrument = rs.Instrument("small", part, plate_scale=presets["lamost"].plate_scale)
    scene = scenes.scene_of(instrument, scenes.in_circle(instrument, 12, 1), name="small")
    scene.targets["priority"] = np.arange(12.0) % classes
    scene.settings["requirements"] = [{"what": "sky", "minimum": 1, "per": "tile"}] if requirements else []

    class BuildError(Exception):
        """The scene was accepted, and the integer program is to be built."""

    def build(*arguments, **options):
        raise BuildError

    monkeypatch.setattr(netflow, "bench_of", lambda scene: None)
    netflow.netflow.buildProblem = build
    most = 3 if requirements else 5
    if classes <= most:
        with pytest.raises(BuildError):
            netflow.plan(scene, 1.0)
    else:
        with pytest.raises(NotImplementedError, match=f"^the number of .* must be at most {most}, got {classes}$"):
            netflow.plan(scene, 1.0)


def test_netflow_plans_several_visits_in_several_exposures(netflow, presets, monkeypatch):
    """The times are those of the visits; the bound follows from the bound 25 of the cost, at 10 for each target."""
    plane = presets["pfs"].focal_plane
    part = rs.FocalPlane(plane.xy[:4], plane.positioner, id=plane.id[:4] + 100)
    instrument = rs.Instrument("small", part, plate_scale=presets["lamost"].plate_scale)
    targets = Table({"id": [10, 11, 12, 13, 14], "x": np.arange(5.0), "y": np.zeros(5)})
    targets["kind"] = ["sky", *["science"] * 4]
    scene = scenes.scene_of(instrument, targets, name="small")
    values = {f"STC_T_0_P0_{k}": 1.0 for k in range(1, 5)}
    values |= {"Tv_Cv_0_3_0": 1.0, "Tv_Cv_0_3_2": 1.0, "Tv_Cv_2_0_1": 1.0, "Tv_Cv_2_1_1": 0.0}
    given, solver = {}, SimpleNamespace(getInfo=lambda: SimpleNamespace(mip_dual_bound=25.0))

    class Program(SimpleNamespace):
        """A solved program, which ignores what is added."""

        def __iadd__(self, other):
            return self

    def build(bench, targets, tpos, costs, duration, **options):
        given.update(times=[target[3] for target in targets], tpos=tpos, duration=duration)
        program = Program(sol_status=1, solve=lambda solver: None, solverModel=solver)
        variables = {name: SimpleNamespace(value=lambda x=x: x) for name, x in values.items()}
        return SimpleNamespace(_prob=program, cost=0, _constr=[], _vardict=variables)

    monkeypatch.setattr(netflow, "bench_of", lambda scene: None)
    netflow.netflow.buildProblem = build
    netflow.pulp.HiGHS, netflow.pulp.LpSolutionOptimal = lambda **options: None, 1
    plan, _, facts = netflow.plan(scene, 1.0, np.array([9, 2, 3, 1, 1]), 3)
    assert given["times"] == [1800, 2700, 900, 900]
    assert given["duration"] == 900
    assert [xy.tolist() for xy in given["tpos"]] == [[1, 2, 3, 4]] * 3
    rows = [list(row) for row in plan.iterrows("positioner", "target", "exposure")]
    assert rows == [[plane.id[3] + 100, 11, 0], [plane.id[3] + 100, 11, 2], [plane.id[0] + 100, 13, 1]]
    assert (facts["gap"], facts["bound"]) == ("0", 1)


def test_tiles_are_planned_one_after_the_other_without_targets_that_have_a_fiber(presets):
    """A planner that takes the first target of each tile observes three targets in three tiles."""
    plane = presets["lamost"].focal_plane
    part = rs.FocalPlane(plane.xy[:2], plane.positioner, id=plane.id[:2])
    targets = scenes.in_circle(rs.Instrument("two", part, plate_scale=presets["lamost"].plate_scale), 4, 1)
    scene = scenes.scene_of(rs.Instrument("two", part, plate_scale=presets["lamost"].plate_scale), targets, name="two")
    tiles = vstack([scene.targets] * 3)
    tiles["tile"] = np.repeat([0, 1, 2], 4)
    scene = scenes.Scene(scene.positioners, tiles, {**scene.settings, "tiles": [{}] * 3})

    def first(part, seconds, *, label):
        assert (part.n_tiles, seconds, label) == (0, 2.0, "x")
        return Table({"positioner": [part.positioners["id"][0]], "target": [part.targets["id"][0]]}), 1.5, {"gap": "0"}

    plan, seconds, facts = compare.tile_by_tile(first)(scene, 6.0, label="x")
    assert (plan["target"].tolist(), plan["tile"].tolist()) == ([0, 1, 2], [0, 1, 2])
    assert (seconds, facts) == (4.5, {})


def test_a_joint_plan_of_tiles_is_judged(presets):
    """The positions of the scene are those of the projection that the joint plan uses, so no target is out of reach."""
    lamost = presets["lamost"]
    plane = lamost.focal_plane
    rows = np.sort(np.argsort(np.hypot(*plane.xy.value.T))[:61])
    part = rs.FocalPlane(plane.xy[rows], plane.positioner, id=plane.id[rows])
    small = dataclasses.replace(lamost, focal_plane=part)
    one = scenes.scene_of(small, scenes.in_circle(small, 10, 1), name="small")
    scene = scenes.tiles_of(one, small, 0.3 * small.field_radius)
    assert (scene.n_tiles, scene.settings["preset"]) == (4, "lamost")
    found = {}
    for name, plan in (("joint", ours.plan_together), ("optimal", compare.tile_by_tile(ours.plan))):
        found[name] = compare.measure(scene, lambda one, name=name, plan=plan: plan(one, 30.0, allocator=name), 1)
        assert (found[name]["wrong"], found[name]["doubles"], found[name]["colliding"]) == (0, 0, 0)
    assert found["joint"]["science"] >= found["optimal"]["science"] > 61
    with pytest.raises(NotImplementedError, match="needs several tiles"):
        ours.plan_together(one, 5.0, allocator="joint")


CASES = {"cpsat": ("lamost", "ortools"), "desi_fiberassign": ("desi", "fiberassign")}
CASES |= {"pfs_netflow": ("pfs", "ets_fiber_assigner"), "sdss_kaiju": ("sdss_apo", "kaiju")}
CASES["sdss_robostrategy"] = "sdss_apo", "robostrategy"


@pytest.mark.parametrize("name", CASES)
def test_programs_that_are_installed_plan_a_small_scene(name, presets, tmp_path):
    """Each program has a process of its own, because the libraries of OR-tools and HiGHS exclude each other."""
    preset, module = CASES[name]
    if importlib.util.find_spec(module) is None:
        pytest.skip(f"{module} is not installed")
    whole = presets[preset]
    plane = whole.focal_plane
    rows = np.sort(np.argsort(np.hypot(*plane.xy.value.T))[:7])
    part = rs.FocalPlane(plane.xy[rows], plane.positioner, id=plane.id[rows], fiber_type=plane.fiber_type[rows])
    instrument = rs.Instrument("small", part, plate_scale=whole.plate_scale)
    targets = scenes.in_circle(instrument, 20, 1)
    if preset == "sdss_apo":
        targets["fiber_type"] = "BOSS"
    scene = scenes.scene_of(instrument, targets, name="small")
    scene.write(tmp_path / "small.fits")
    words = str(tmp_path / "small.fits"), "--program", name, "--repeats", "1", "--output", str(tmp_path / "out.ecsv")
    subprocess.run(
        [sys.executable, FOLDER / "compare.py", *words], check=True, env={**os.environ, "PYTHONPATH": path()}
    )
    table = results.read(tmp_path / "out.ecsv")
    assert len(table) >= 1
    good = compare.measure(scene, lambda one: ours.plan(one, 5.0, allocator="repair"), 1)
    for found in table:
        assert found["wrong"] == 0
        assert found["science_without_idle"] >= found["science"] > 0
        if name not in ("desi_fiberassign", "sdss_robostrategy"):
            assert found["gap"] == "0"
            assert found["science_without_idle"] >= good["science"]


def path():
    """Return the PYTHONPATH of processes: this package, and what is set."""
    return os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
