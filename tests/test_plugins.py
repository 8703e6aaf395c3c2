"""Plugins of other packages: installed files written by the test, and one installation by pip."""

import importlib.util
import shutil
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from importlib import metadata
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs
from packages import CENTER, FOUR, HERS, PAIR, always, sky_of
from rfpsurvey._common import plugins as _plugins

EXAMPLE = Path(__file__).parent.parent / "docs" / "examples" / "plugin"


def test_nothing_is_looked_up_before_it_is_needed(install, monkeypatch):
    calls, look = [], _plugins.entry_points
    monkeypatch.setattr(_plugins, "entry_points", lambda **given: calls.append(given) or look(**given))
    rs.allocate(PAIR, FOUR, allocator="lamost_rule")
    rs.allocate(PAIR, FOUR, allocator=always([0, 2]))
    rs.Instrument.preset("moons")
    rs.collision_probability(PAIR, method="overlap_ratio")
    assert not calls
    with pytest.raises(rs.InputError, match="unknown allocator 'swapped'; choose one of: balanced, lamost"):
        rs.allocate(PAIR, FOUR, allocator="swapped")
    install("hers", HERS, allocators={"swapped": "swapped"})  # while the plugin is loaded
    calls.clear()
    for _ in range(3):
        assert rs.allocate(PAIR, FOUR, allocator="swapped").target_of_positioner.tolist() == [1, 2]
    assert len(calls) == 1


def test_names_that_are_ours_stay_ours(install, presets):
    install(
        "thief",
        "def steal(*_):\n    raise SystemExit",
        allocators={"lamost_rule": "steal"},
        instruments={"lamost": "steal"},
        probability_methods={"close_pair": "steal"},
    )
    assert rs.allocate(PAIR, FOUR, allocator="lamost_rule").n_assigned == 2
    assert len(rs.Instrument.preset("lamost").focal_plane) == 4000
    assert rs.collision_probability(PAIR, method="close_pair").value > 0
    assert rs.available_instruments().count("lamost") == 1


def test_a_broken_package_breaks_nothing_else(hers, install, run):
    install("bad", "import not_there", allocators={"bad": "f"}, instruments={"bad": "f", "other": "g"})
    install("odd", "one, two = 1, lambda: 2\n", instruments={"odd": "one", "odder": "two"})
    words = r"the allocator 'bad' of bad 1.0 \(bad:f\) failed: ModuleNotFoundError: No module named 'not_there'"
    with pytest.raises(rs.InputError, match=words) as caught:
        rs.allocate(PAIR, FOUR, allocator="bad")
    assert isinstance(caught.value.__cause__, ModuleNotFoundError)
    with pytest.raises(rs.InputError, match=r"'absent' of hers 1.0 \(hers:nowhere\) failed: AttributeError"):
        rs.allocate(PAIR, FOUR, allocator="absent")
    with pytest.raises(rs.InputError, match=r"'number' of hers 1.0 \(hers:np\) must be a function, got module"):
        rs.allocate(PAIR, FOUR, allocator="number")
    with pytest.raises(rs.InputError, match="choose one of: absent, bad, balanced, begin, .*, swapped, wrong"):
        rs.allocate(PAIR, FOUR, allocator="unheard of")
    for name in ("odd", "odder"):
        with pytest.raises(
            rs.InputError, match=f"the instrument '{name}' of odd 1.0 .*: a path must be text or a Path object"
        ):
            rs.Instrument.preset(name)
    assert {"bad", "odd", "other", "lamost"} <= set(rs.available_instruments())
    code, out, err = run("instruments")
    assert (code, err.count("warning: the instrument")) == (0, 4)
    assert "warning: the instrument 'bad' of bad 1.0 (bad:f) failed: ModuleNotFoundError" in err
    failed = {"bad", "odd", "odder", "other"}
    listed = [line.split()[0] for line in out.splitlines()[1:] if line[0] != " "]
    assert listed == sorted({*rs.available_instruments()} - failed)


@pytest.mark.few(1)
@pytest.mark.parametrize("code", ["raise SystemExit(0)", "import sys\nsys.exit()", "raise SystemExit('enough')"])
def test_a_plugin_that_exits_ends_nothing(install, run, code):
    """Regression: the program ended with exit code 0 and without a message."""
    body = code.replace("\n", "\n    ")
    install("gone", f"{code}\n", allocators={"import": "f"}, instruments={"import": "f"})
    install("going", f"def f(problem):\n    {body}\n", allocators={"call": "f"}, probability_methods={"call": "f"})
    with pytest.raises(rs.InputError, match=r"'import' of gone 1.0 \(gone:f\) failed: SystemExit"):
        rs.allocate(PAIR, FOUR, allocator="import")
    with pytest.raises(rs.InputError, match=r"'call' of going 1.0 \(going:f\) failed: SystemExit"):
        rs.allocate(PAIR, FOUR, allocator="call")
    with pytest.raises(rs.InputError, match="failed: SystemExit"):
        rs.collision_probability(PAIR, method="call")
    code, _, err = run("plan", "--instrument", "import")
    assert code == 2
    assert err.startswith("rfpsurvey: the instrument 'import' of gone 1.0 (gone:f) failed: SystemExit")


def test_an_interrupt_is_that_of_the_user():
    def interrupted(problem):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rs.allocate(PAIR, FOUR, allocator=interrupted)


def test_one_name_of_two_packages_is_nobodys(hers, install):
    install("his", HERS, "2.1", allocators={"swapped": "swapped"})
    with pytest.raises(
        rs.InputError,
        match="several packages add the allocator 'swapped': hers 1.0, his 2.1; uninstall all but one of these",
    ):
        rs.allocate(PAIR, FOUR, allocator="swapped")


@pytest.mark.parametrize("name", [3, None, ["lamost"]])
def test_what_is_no_name_is_refused(name):
    with pytest.raises(rs.InputError, match="unknown allocator"):
        rs.allocate(PAIR, FOUR, allocator=name)


# plugins in surveys and comparisons


def test_surveys_know_them_by_name(small, install, tmp_path):
    sky, tiles = sky_of(small), SkyCoord([95, 95.05, 95.2] * u.deg, [23, 23, 23.1] * u.deg)
    install("hers", HERS, allocators={"begin": "begin"})
    usual = rs.plan_survey(sky, small, tiles, allocator="lamost_rule")
    mine = rs.plan_survey(sky, small, tiles, allocator="begin", folder=tmp_path / "survey")
    assert mine.summary == usual.summary
    assert mine.provenance["software"] == {**usual.provenance["software"], "hers": "1.0"}
    assert mine.provenance["parameters"]["allocator"] == "begin"
    install("hers", HERS, "1.1", allocators={"begin": "begin"})
    with pytest.warns(rs.RfpsurveyWarning, match="was begun with other versions of the software"):
        rs.plan_survey(sky, small, tiles, allocator="begin", folder=tmp_path / "survey", resume=True)
    with pytest.raises(rs.InputError, match="unknown allocator 'bgin'.* Did you mean 'begin'"):
        rs.plan_survey(sky, small, tiles, allocator="bgin")


def test_surveys_take_functions_on_threads(small):
    sky, tiles = sky_of(small), SkyCoord([95, 95.05] * u.deg, [23, 23] * u.deg)
    usual = rs.plan_survey(sky, small, tiles, allocator=rs.AllocationOptions("optimal", start="nearest"))
    with ThreadPoolExecutor(2) as executor:
        mine = rs.plan_survey(sky, small, tiles, allocator=begin_optimal, executor=executor)
    assert mine.summary == usual.summary
    assert mine.provenance["parameters"]["allocator"] == f"{__name__}.begin_optimal"
    with (
        ProcessPoolExecutor(1) as executor,
        pytest.raises(rs.InputError, match="must be a name, such as the name of an entry point"),
    ):
        rs.plan_survey(sky, small, tiles, allocator=begin_optimal, executor=executor)


def begin_optimal(problem):
    return rs.allocate(problem.focal_plane, problem.xy * u.mm, allocator="optimal").target_of_positioner


def test_comparisons_take_both(small, hers):
    table = rs.compare_allocators(sky_of(small), small, CENTER, allocators=["lamost_rule", "begin", begin_optimal])
    assert table["allocator"].tolist() == ["lamost_rule", "begin", f"{__name__}.begin_optimal"]
    assert (table["science"][0], table["colliding"][2]) == (table["science"][1], 0)
    assert table.meta["software"]["hers"] == "1.0"
    assert (
        rs.compare_allocators(sky_of(small), small, CENTER, allocators=begin_optimal)["science"] == table["science"][2]
    )


def test_instruments_are_compared_without_those_that_fail(hers, install, monkeypatch):
    install("bad", "import not_there", instruments={"bad": "f"})
    monkeypatch.setattr("rfpsurvey._instruments.instrument._shipped", dict)
    toy = EXAMPLE / "rfpsurvey_example" / "toy.toml"
    install("mine", f"toy = {str(toy)!r}", instruments={"toy": "toy"})
    with pytest.warns(rs.RfpsurveyWarning, match="the instrument 'bad' of bad 1.0"):
        table = rs.compare_instruments(allocators=["begin", begin_optimal], n_realizations=1)
    assert table["instrument"].tolist() == ["toy", "toy"]
    assert table["allocator"].tolist() == ["begin", f"{__name__}.begin_optimal"]
    assert table.meta["software"]["hers"] == "1.0"


# the example of the documentation


def test_the_example_serves_the_rarest_first():
    """Only target 1 is in reach of two positioners.

    If it were assigned first, it would take the positioner of another target.
    """
    spec = importlib.util.spec_from_file_location("rfpsurvey_example", EXAMPLE / "rfpsurvey_example" / "__init__.py")
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    xy = [[12, 0], [13, 1], [-10, 0], [99, 0]] * u.mm  # both positioners reach 0 and 1, and only the first reaches 2
    assert rs.allocate(PAIR, xy, allocator=example.rarest).target_of_positioner.tolist() == [2, 0]
    ranked = rs.allocate(PAIR, xy, allocator=example.rarest, priority=[1, 2, 0, 0])
    assert ranked.target_of_positioner.tolist() == [0, 1]
    skies = rs.allocate(PAIR, xy, allocator=example.rarest, kind=["science", "sky", "sky", "sky"])
    assert (skies.target_of_positioner.tolist(), rs.Instrument.read(example.TOY).name) == ([0, -1], "toy")


@pytest.fixture(scope="module")
def target(tmp_path_factory):
    """Return a folder in which pip has installed the example."""
    setuptools = [int(found.version.split(".")[0]) for found in metadata.distributions(name="setuptools")]
    if not setuptools or setuptools[0] < 77:
        pytest.skip("there is no setuptools that can build the example; the extra 'test' brings one")
    source, target = (tmp_path_factory.mktemp("plugin") / name for name in ("source", "target"))
    shutil.copytree(EXAMPLE, source)
    pip = [sys.executable, "-m", "pip", "install", "--no-index", "--no-deps", "--no-build-isolation", "--target"]
    subprocess.run([*pip, target, source], check=True, capture_output=True)
    return target


@pytest.fixture
def installed(target, monkeypatch):
    """Make the installed example available to this process."""
    monkeypatch.syspath_prepend(target)
    yield target
    _plugins._load.cache_clear()
    sys.modules.pop("rfpsurvey_example", None)


def test_the_example_as_pip_installs_it(installed, run, tmp_path):
    code, out, err = run("plan", "--instrument", "toy", "--allocator", "rarest", "--output", tmp_path / "tile.ecsv")
    assert (code, err) == (0, "")
    assert out.startswith("toy, allocator rarest\n")
    assert rs.Tile.read(tmp_path / "tile.ecsv").provenance["software"]["rfpsurvey-example"] == "0.1"
    assert run("instruments", "toy")[1].startswith("toy: Toy of the plugin example\n37 positioners")
    assert "toy" in rs.available_instruments()
    code, _, err = run("plan", "--allocator", "rarets")
    assert (code, err.endswith("Did you mean 'rarest'?\n")) == (2, True)


def test_its_constraint_is_found_by_its_name(installed):
    asked = rs.AllocationOptions("nearest", constraints=["away_from_bright 14 0.05", "sky=0-3"])
    (one,) = asked.constraints
    assert (type(one).__name__, str(one)) == ("AwayFromBright", "away_from_bright 14.0 0.05")
    sky = rs.synthetic_catalog("uniform", CENTER, 1 * u.deg, n_targets=300, rng=1)
    magnitude = QTable({"mag": np.arange(300) % 10 + 10.0})
    tile = rs.plan_tile(rs.Catalog(sky.coord, extra=magnitude), "toy", CENTER, allocator=asked)
    assert tile.provenance["software"]["rfpsurvey-example"] == "0.1"
    assert tile.provenance["parameters"]["constraints"] == ["away_from_bright 14.0 0.05"]
    with pytest.raises(rs.InputError, match=r"the constraint 'away_from_bright' of rfpsurvey-example 0.1 .*must have"):
        rs.AllocationOptions(constraints="away_from_bright 14")
    with pytest.raises(rs.InputError, match="unknown constraint 'away_from_brigt'.*Did you mean 'away_from_bright'"):
        rs.AllocationOptions(constraints="away_from_brigt 14 1")


def test_an_entry_point_of_constraints_must_name_a_class_with_its_name(install):
    code = "import rfpsurvey as rs\nf = len\nclass One(rs.constraints.Constraint):\n    name = 'two'\n"
    install("odd", code, constraints={"one": "One", "f": "f", "required": "f"})
    with pytest.raises(rs.InputError, match="its attribute name must be 'one', as in the entry point, got 'two'"):
        rs.AllocationOptions(constraints="one")
    with pytest.raises(rs.InputError, match=r"the constraint 'f' of odd 1.0 \(odd:f\): it must be a subclass of"):
        rs.AllocationOptions(constraints="f 1 2")
    assert rs.AllocationOptions(constraints="required 1").required == ("1",)  # names that are ours stay ours


def test_its_dice_agree_with_the_quadrature(installed, run):
    true = rs.collision_probability("toy", method="quadrature", precision=0.001).value
    code, out, _ = run("probability", "toy", "--method", "dice", "--max-iterations", 400)
    assert code == 0
    assert "nan" not in out
    value, error = (float(line.split()[-1]) for line in out.splitlines() if "probability " in line or "error" in line)
    assert 0 < error < 0.005
    assert abs(value - true) < 4 * error


@pytest.mark.exhaustive
def test_processes_find_it_by_its_name(installed, run, tmp_path):
    """New processes search for packages in the same folders as this process."""
    command = ["survey", "--instrument", "toy", "--allocator", "rarest", "--folder", tmp_path / "survey"]
    assert run(*command, "--set", "processes=true", "--workers", 1)[0] == 0
    survey = rs.Survey.read(tmp_path / "survey")
    assert survey.provenance["software"]["rfpsurvey-example"] == "0.1"
    assert survey.summary["n_assigned"] > 30
