"""What other packages add: as pip leaves it behind, written by hand, and once by pip itself."""

import importlib.util
import os
import shutil
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from rfpsurvey import _plugins

EXAMPLE = Path(__file__).parent.parent / "docs" / "examples" / "plugin"
CENTER = SkyCoord("6h20m +23d")
ROBOT = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
PAIR = rs.FocalPlane([[0, 0], [25.6, 0]] * u.mm, ROBOT)
# the first of two positioners reaches targets 0 and 1, the second 1 and 2, nobody 3
FOUR = [[-10, 0], [13, 0], [30, 0], [99, 0]] * u.mm

HERS = """
import numpy as np

def begin(problem):
    return problem.start()

def swapped(problem):
    return np.array([1, 2])

def idle(problem):
    return np.full(len(problem.focal_plane), -1)

def wrong(problem):
    return [3, 3]

def formula(question):
    return np.full(len(question.focal_plane), 0.25)
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Return a function that leaves a distribution behind as pip would."""
    names = []

    def make(name, code, version="1.0", **groups):
        folder = tmp_path / f"{name}-{version}"
        info = folder / f"{name}-{version}.dist-info"
        info.mkdir(parents=True)
        (folder / f"{name}.py").write_text(code)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
        lines = []
        for group, entries in groups.items():
            lines += [f"[rfpsurvey.{group}]", *(f"{key} = {name}:{value}" for key, value in entries.items())]
        (info / "entry_points.txt").write_text("\n".join(lines))
        monkeypatch.syspath_prepend(folder)
        _plugins._load.cache_clear()
        sys.modules.pop(name, None)
        names.append(name)

    yield make
    _plugins._load.cache_clear()
    for name in names:
        sys.modules.pop(name, None)


@pytest.fixture
def hers(install):
    """A package with allocators and a method."""
    allocators = {
        "begin": "begin",
        "swapped": "swapped",
        "idle": "idle",
        "wrong": "wrong",
        "absent": "nowhere",
        "number": "np",
    }
    install("hers", HERS, allocators=allocators, probability_methods={"quarter": "formula"})


def always(answer):
    return lambda problem: answer


def sky_of(instrument, n=300):
    return rs.synthetic_catalog("uniform", CENTER, instrument.field_radius, n_targets=n, rng=5)


def same(one, other):
    np.testing.assert_array_equal(one.target_of_positioner, other.target_of_positioner)
    np.testing.assert_array_equal(one.handedness, other.handedness)


# what an allocator is given


def test_an_allocator_is_told_everything():
    seen = []
    names = ["A", "B", "A+B"]
    plane = rs.FocalPlane([[0, 0], [25.6, 0], [51.2, 0]] * u.mm, ROBOT, fiber_type=names)
    xy = [[-10, 0], [13, 0], [30, 0], [39, 0], [99, 0]] * u.mm
    columns = {
        "priority": [5, 1, 7, 5, 9], "kind": ["science", "science", "sky", "science", "standard"],
        "category": ["", "x", "", "", "x"], "fiber_type": ["", "A", "", "B", ""], "required": [0, 0, 0, 1, 0],
        "requirements": ["sky=1", "x=1"], "forbidden": [[1, 2]], "objective": "count", "time_limit": 0.1 * u.min,
    }  # fmt: skip

    def look(problem):
        seen.append(problem)
        return np.full(3, -1)

    nothing = rs.allocate(xy, plane, method=look, parked_obstacles=False, rng=8, **columns)
    assert nothing.n_assigned == 0
    assert str(nothing.unmet[0]) == "sky targets: 0 of 1, 1 missing; none is in reach"
    (problem,) = seen
    assert problem.focal_plane is plane
    np.testing.assert_array_equal(problem.xy, xy.value)
    # 1 needs A, 3 needs B, the pair (1, 2) is forbidden
    assert problem.reachable.toarray().tolist() == [[1, 1, 0, 0, 0], [0, 0, 0, 1, 0], [0, 0, 0, 1, 0]]
    assert problem.rank.tolist() == [0, 1, 2, 0, 2]
    np.testing.assert_array_equal(problem.priority, [5, 1, np.nan, 5, np.nan])
    assert problem.kind.tolist() == columns["kind"]
    assert problem.category.tolist() == columns["category"]
    assert problem.fiber_type.tolist() == columns["fiber_type"]
    assert problem.required.tolist() == [False, False, False, True, False]
    assert problem.requirements == (rs.Requirement("sky", 1), rs.Requirement("x", 1))
    assert (problem.objective, problem.time_limit, problem.parked_obstacles) == ("count", 6.0, False)
    assert problem.rng.random() == np.random.default_rng(8).random()
    for name in ("xy", "rank", "priority", "kind", "category", "fiber_type", "required"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(problem, name)[0] = 1


def test_what_is_not_said_has_a_value():
    seen = []
    rs.allocate(FOUR, PAIR, method=lambda problem: seen.append(problem) or np.array([0, 2]))
    (problem,) = seen
    assert problem.kind.tolist() == ["science"] * 4
    assert problem.category.tolist() == problem.fiber_type.tolist() == [""] * 4
    assert problem.rank.tolist() == problem.priority.tolist() == problem.required.tolist() == [0] * 4
    assert problem.reachable.toarray().tolist() == [[1, 1, 0, 0], [0, 1, 1, 0]]


def test_the_plan_to_begin_with(small, hers, rng):
    xy = rng.uniform(-70, 70, (200, 2)) * u.mm
    plane = small.focal_plane
    for start in ("lamost", "nearest", rs.allocate(xy, plane, method="optimal")):
        usual = start if isinstance(start, rs.Allocation) else rs.allocate(xy, plane, method=start)
        same(rs.allocate(xy, plane, method="begin", start=start), usual)
    with pytest.raises(rs.InputError, match="there is no plan to begin with"):
        rs.allocate(xy, plane, method="begin", start="begin")
    with pytest.raises(rs.InputError, match="'begin' of hers 1.0 .*: unknown allocator to start with 'repair'"):
        rs.allocate(xy, plane, method="begin", start="repair")


def test_a_plan_of_others_can_be_repaired(hers):
    """Both arms stretch toward the same side, the tips are 2 mm apart."""
    xy = [[99, 99], [13, 0], [15, 0]] * u.mm
    assert len(rs.find_collisions(PAIR, rs.allocate(xy, PAIR, method="swapped")).pairs) == 1
    repaired = rs.allocate(xy, PAIR, method="repair", start="swapped")
    assert len(rs.find_collisions(PAIR, repaired).pairs) == 0
    assert repaired.meta["n_before"] == 2


def test_stuck_fibers_look_at_sky_without_being_asked():
    stuck = [[np.nan, np.nan], [0, 90]] * u.deg
    plane = replace(PAIR, stuck=stuck)
    options = {"requirements": "sky=1", "sky_separation": 1 * u.mm}
    usual = rs.allocate(FOUR, plane, method="lamost", **options)
    assert usual.target_of_positioner[1] == usual.n_given  # that of the stuck one
    for method in (always([0, -1]), lambda problem: problem.start()):
        mine = rs.allocate(FOUR, plane, method=method, **options)
        assert mine.target_of_positioner[1] == usual.target_of_positioner[1]
        assert not mine.unmet


# what it may come back with


def test_elbows_are_those_that_were_asked_for():
    plane = replace(PAIR, positioner=replace(ROBOT, handedness="both"))
    mine = rs.allocate(FOUR, plane, method=always(([0, 2], np.array(["left", "right"]))))
    assert mine.handedness.tolist() == ["left", "right"]
    (x, y), (tip_x, tip_y) = ((part - plane.xy.value).T for part in (mine.place_arms(plane).elbow, mine.tips.value))
    assert np.sign(tip_x * y - tip_y * x).tolist() == [1, -1]  # on the left of the way from center to tip, and right
    assert rs.allocate(FOUR, PAIR, method=always(([0, -1], ["right", ""]))).n_assigned == 1


LIMITED = replace(PAIR, positioner=replace(ROBOT, handedness="both", phi_range=[0, 180] * u.deg))


@pytest.mark.parametrize(
    ("plane", "answer", "words"),
    [
        (PAIR, None, r"must return whole numbers of the shape \(2,\).* got NoneType of the shape \(\)"),
        (PAIR, [0, 2, -1], r"got list of the shape \(3,\)"),
        (PAIR, np.array([[0, 2]]), r"got ndarray of the shape \(1, 2\)"),
        (PAIR, np.array([0.0, 2.0]), "must return whole numbers"),
        (PAIR, np.array([True, False]), "must return whole numbers"),
        (PAIR, ["0", "2"], "must return whole numbers"),
        (PAIR, [[0], [1, 2]], "must return whole numbers"),
        (PAIR, np.ma.array([0, 2], mask=[False, True]), "must return whole numbers"),
        (PAIR, ([0, 2], None, 3), "must return whole numbers"),
        (PAIR, [0, 4], "targets must be rows from 0 to 3, or -1 for none, got 4"),
        (PAIR, np.array([0, 2**64 - 1], dtype=np.uint64), "got 18446744073709551615"),
        (PAIR, [-2, 0], "got -2"),
        (PAIR, [1, 1], r"target 1 must have one positioner at most, got 0 and 1 \(by row\)"),
        (PAIR, [0, 3], r"positioner 1 \(by row\) cannot observe target 3: it is out of reach, forbidden"),
        (PAIR, [2, 1], r"positioner 0 \(by row\) cannot observe target 2: it is out of reach"),
        (replace(PAIR, disabled=[True, False]), [0, 1], "positioner 0 .* target 0: it is disabled or stuck"),
        (PAIR, ([0, 2], ["right"]), r"elbows must be 'right' or 'left' .* shape \(2,\), got \['right'\]"),
        (PAIR, ([0, 2], ["right", "up"]), "elbows must be 'right' or 'left'"),
        (PAIR, ([0, 2], [1, -1]), "elbows must be 'right' or 'left'"),
        (PAIR, ([0, 2], [["right"], []]), "elbows must be 'right' or 'left'"),
        (PAIR, ([0, 2], ["right", "left"]), r"positioner 1 \(by row\) cannot have the elbow 'left'"),
        (LIMITED, ([0, 2], ["right", "left"]), r"positioner 1 \(by row\) cannot have the elbow 'left'"),
    ],
)
def test_what_no_plan_can_be_is_refused(plane, answer, words):
    with pytest.raises(rs.InputError, match=words) as caught:
        rs.allocate(FOUR, plane, method=always(answer))
    assert str(caught.value).startswith(f"the allocator '{__name__}.always.<locals>.<lambda>': ")


def test_forbidden_pairs_stay_forbidden():
    assert rs.allocate(FOUR, PAIR, method=always([0, 1])).n_assigned == 2
    with pytest.raises(rs.InputError, match="positioner 1 .* cannot observe target 1: it is out of reach, forbidden"):
        rs.allocate(FOUR, PAIR, method=always([0, 1]), forbidden=[[1, 1]])


def test_errors_say_whose_they_are(hers):
    with pytest.raises(
        rs.InputError, match=r"^the allocator 'wrong' of hers 1.0 \(hers:wrong\): target 3 must have one"
    ):
        rs.allocate(FOUR, PAIR, method="wrong")

    def fails(problem):
        return problem.xy / 0

    with np.errstate(all="raise"), pytest.raises(rs.InputError, match="fails' failed: FloatingPointError: ") as caught:
        rs.allocate(FOUR, PAIR, method=fails)
    assert isinstance(caught.value.__cause__, FloatingPointError)


# by name


def test_a_tile_says_where_its_allocator_comes_from(small, hers):
    sky = sky_of(small)
    usual, tile = (rs.plan_tile(sky, small, CENTER, allocator=name) for name in ("lamost", "begin"))
    np.testing.assert_array_equal(tile.table["target_id"], usual.table["target_id"])
    assert "hers" not in usual.provenance["software"]
    assert tile.provenance["software"] == {**usual.provenance["software"], "hers": "1.0"}
    assert tile.provenance["parameters"]["allocator"] == "begin"
    assert tile.summary["search"] == {"software": {"hers": "1.0"}}
    repaired = rs.plan_tile(sky, small, CENTER, allocator="repair", start="idle")
    assert repaired.provenance["software"]["hers"] == "1.0"


def test_a_function_is_recorded_by_its_name(small, tmp_path):
    class Ünsere:
        def __call__(self, problem):
            return problem.start()

    tile = rs.plan_tile(sky_of(small), small, CENTER, allocator=Ünsere())
    name = tile.provenance["parameters"]["allocator"]
    assert name == f"{__name__}.test_a_function_is_recorded_by_its_name.<locals>.\\xdcnsere"
    tile.write(tmp_path / "tile.fits")
    assert rs.Tile.read(tmp_path / "tile.fits") == tile


def test_nothing_is_looked_up_before_it_is_needed(install, monkeypatch):
    calls, look = [], _plugins.entry_points
    monkeypatch.setattr(_plugins, "entry_points", lambda **given: calls.append(given) or look(**given))
    rs.allocate(FOUR, PAIR, method="lamost")
    rs.allocate(FOUR, PAIR, method=always([0, 2]))
    rs.Instrument.preset("moons")
    rs.collision_probability(PAIR, method="overlap_ratio")
    assert not calls
    with pytest.raises(rs.InputError, match="unknown allocator 'swapped'; choose one of: balanced, lamost"):
        rs.allocate(FOUR, PAIR, method="swapped")
    install("hers", HERS, allocators={"swapped": "swapped"})  # meanwhile
    calls.clear()
    for _ in range(3):
        assert rs.allocate(FOUR, PAIR, method="swapped").target_of_positioner.tolist() == [1, 2]
    assert len(calls) == 1


def test_names_that_are_ours_stay_ours(install, presets):
    install(
        "thief", "def steal(*_):\n    raise SystemExit", allocators={"lamost": "steal"},
        instruments={"lamost": "steal"}, probability_methods={"close_pair": "steal"},
    )  # fmt: skip
    assert rs.allocate(FOUR, PAIR, method="lamost").n_assigned == 2
    assert len(rs.Instrument.preset("lamost").focal_plane) == 4000
    assert rs.collision_probability(PAIR, method="close_pair").value > 0
    assert rs.available_instruments().count("lamost") == 1


def test_a_broken_package_breaks_nothing_else(hers, install, run):
    install("bad", "import not_there", allocators={"bad": "f"}, instruments={"bad": "f", "other": "g"})
    install("odd", "one, two = 1, lambda: 2\n", instruments={"odd": "one", "odder": "two"})
    words = r"the allocator 'bad' of bad 1.0 \(bad:f\) failed: ModuleNotFoundError: No module named 'not_there'"
    with pytest.raises(rs.InputError, match=words) as caught:
        rs.allocate(FOUR, PAIR, method="bad")
    assert isinstance(caught.value.__cause__, ModuleNotFoundError)
    with pytest.raises(rs.InputError, match=r"'absent' of hers 1.0 \(hers:nowhere\) failed: AttributeError"):
        rs.allocate(FOUR, PAIR, method="absent")
    with pytest.raises(rs.InputError, match=r"'number' of hers 1.0 \(hers:np\) must be a function, got module"):
        rs.allocate(FOUR, PAIR, method="number")
    with pytest.raises(rs.InputError, match="choose one of: absent, bad, balanced, begin, .*, swapped, wrong"):
        rs.allocate(FOUR, PAIR, method="unheard of")
    for name in ("odd", "odder"):
        with pytest.raises(
            rs.InputError, match=f"the instrument '{name}' of odd 1.0 .*: a path must be text or a path"
        ):
            rs.Instrument.preset(name)
    assert {"bad", "odd", "other", "lamost"} <= set(rs.available_instruments())
    code, out, err = run("instruments")
    assert (code, err.count("warning: the instrument")) == (0, 4)
    assert "warning: the instrument 'bad' of bad 1.0 (bad:f) failed: ModuleNotFoundError" in err
    assert [line.split()[0] for line in out.splitlines()[1:]] == [
        "desi", "lamost", "moons", "pfs", "sdss_apo", "sdss_lco",
    ]  # fmt: skip


def test_one_name_of_two_packages_is_nobodys(hers, install):
    install("his", HERS, "2.1", allocators={"swapped": "swapped"})
    with pytest.raises(rs.InputError, match="several packages add the allocator 'swapped': hers 1.0, his 2.1; all but"):
        rs.allocate(FOUR, PAIR, method="swapped")


@pytest.mark.parametrize("name", [3, None, ["lamost"]])
def test_what_is_no_name_is_refused(name):
    with pytest.raises(rs.InputError, match="unknown allocator"):
        rs.allocate(FOUR, PAIR, method=name)


# in surveys and comparisons


def test_surveys_know_them_by_name(small, install, tmp_path):
    sky, tiles = sky_of(small), SkyCoord([95, 95.05, 95.2] * u.deg, [23, 23, 23.1] * u.deg)
    install("hers", HERS, allocators={"begin": "begin"})
    usual = rs.plan_survey(sky, tiles, small)
    mine = rs.plan_survey(sky, tiles, small, allocator="begin", folder=tmp_path / "survey")
    assert mine.summary == usual.summary
    assert mine.provenance["software"] == {**usual.provenance["software"], "hers": "1.0"}
    assert mine.provenance["parameters"]["method"] == "begin"
    install("hers", HERS, "1.1", allocators={"begin": "begin"})
    with pytest.warns(rs.RfpsurveyWarning, match="was begun with other versions of the software"):
        rs.plan_survey(sky, tiles, small, allocator="begin", folder=tmp_path / "survey", resume=True)
    with pytest.raises(rs.InputError, match="unknown allocator 'bgin'.* Did you mean 'begin'"):
        rs.plan_survey(sky, tiles, small, allocator="bgin")


def test_surveys_take_functions_on_threads(small):
    sky, tiles = sky_of(small), SkyCoord([95, 95.05] * u.deg, [23, 23] * u.deg)
    usual = rs.plan_survey(sky, tiles, small, allocator="optimal", start="nearest")
    with ThreadPoolExecutor(2) as executor:
        mine = rs.plan_survey(sky, tiles, small, allocator=begin_optimal, executor=executor)
    assert mine.summary == usual.summary
    assert mine.provenance["parameters"]["method"] == f"{__name__}.begin_optimal"
    with ProcessPoolExecutor(1) as executor, pytest.raises(rs.InputError, match="must be a name where processes do"):
        rs.plan_survey(sky, tiles, small, allocator=begin_optimal, executor=executor)


def begin_optimal(problem):
    return rs.allocate(problem.xy * u.mm, problem.focal_plane, method="optimal").target_of_positioner


def test_comparisons_take_both(small, hers):
    table = rs.compare_allocators(sky_of(small), small, CENTER, allocators=["lamost", "begin", begin_optimal])
    assert table["allocator"].tolist() == ["lamost", "begin", f"{__name__}.begin_optimal"]
    assert table["science"][0] == table["science"][1]
    assert table["colliding"][2] == 0
    assert table.meta["software"]["hers"] == "1.0"
    assert (
        rs.compare_allocators(sky_of(small), small, CENTER, allocators=begin_optimal)["science"] == table["science"][2]
    )


def test_instruments_are_compared_without_those_that_fail(hers, install, monkeypatch):
    install("bad", "import not_there", instruments={"bad": "f"})
    monkeypatch.setattr("rfpsurvey.instrument._instrument._shipped", dict)
    toy = EXAMPLE / "rfpsurvey_example" / "toy.toml"
    install("mine", f"toy = {str(toy)!r}", instruments={"toy": "toy"})
    with pytest.warns(rs.RfpsurveyWarning, match="the instrument 'bad' of bad 1.0"):
        table = rs.compare_instruments(allocators=["begin", begin_optimal], n_realizations=1)
    assert table["instrument"].tolist() == ["toy", "toy"]
    assert table["allocator"].tolist() == ["begin", f"{__name__}.begin_optimal"]
    assert table.meta["software"]["hers"] == "1.0"


# methods of collision probability


def test_a_formula_of_a_package(small, hers):
    plane = replace(small.focal_plane, disabled=np.arange(37) < 2)
    found = rs.collision_probability(plane, method="quarter", dynamic=0.5)
    assert (found.value, found.value_assigned, found.method, found.estimand) == (0.625, 0.625, "quarter", "independent")
    assert np.isnan(found.per_positioner[:2]).all()
    assert (found.per_positioner[2:] == 0.625).all()
    assert np.isnan([found.low, found.high, found.standard_error, found.pairs_per_positioner]).all()
    assert found.meta["software"] == {"hers": "1.0"}
    with pytest.raises(rs.InputError, match="'quarter' estimates 'independent' targets, not 'allocated' ones"):
        rs.collision_probability(plane, method="quarter", estimand="allocated")
    with pytest.raises(
        rs.InputError, match="interval='bootstrap' belongs to iterations, which 'quarter' does not make"
    ):
        rs.collision_probability(plane, method="quarter", interval="bootstrap")
    table = rs.benchmark_probability(small, efforts={"quarter": [0]}, repeats=1, precision=0.01)
    assert (table["method"][0], table["value"][0]) == ("quarter", 0.25)


def test_a_question_says_everything(small):
    seen = []

    def answer(question):
        seen.append(question)
        return {"value": 0.5, "n": 7, "meta": {"words": "mine"}}

    plane = small.focal_plane
    options = {"precision": 0.01, "max_iterations": 9, "confidence": 0.9, "parked_obstacles": False, "rng": 3}
    found = rs.collision_probability(plane, method=answer, **options)
    assert (found.value, found.n, found.meta["words"], found.meta["confidence"]) == (0.5, 7, "mine", 0.9)
    assert np.isnan(found.per_positioner).all()
    (question,) = seen
    assert question.focal_plane is plane
    assert (question.precision, question.max_iterations, question.confidence) == (0.01, 9, 0.9)
    assert question.rng.random() == np.random.default_rng(3).random()
    assert (question.parked_obstacles, question.realize) == (False, None)
    rs.collision_probability(plane, method=answer)
    assert (seen[1].precision, seen[1].max_iterations) == (0.001, 1_000_000)


def test_allocated_targets_are_those_asked_for(small, rng):
    xy = rng.uniform(-70, 70, (60, 2)) * u.mm

    def count(question):
        plan = question.realize(question.rng)
        return {"value": rs.find_collisions(question.focal_plane, plan).rate}

    count.estimand = "allocated"
    for parked in (True, False):
        plan = rs.allocate(xy, small.focal_plane, method="nearest", parked_obstacles=parked)
        found = rs.collision_probability(small, method=count, targets=xy, allocator="nearest", parked_obstacles=parked)
        assert found.value == rs.find_collisions(small.focal_plane, plan).rate
    assert (found.estimand, found.meta["targets"], found.meta["allocator"]) == ("allocated", "given", "nearest")


def test_an_error_gives_an_interval(small):
    """Where the binomial distribution is the answer: Wilson's interval of 30 of 100 trials."""
    from astropy.stats import binom_conf_interval

    def answer(question):
        return {"value": 0.3, "standard_error": np.sqrt(0.3 * 0.7 / 100), "n": 100}

    with pytest.warns(
        rs.RfpsurveyWarning, match="after 100 iterations the standard error is 0.046: the interval is wid"
    ):
        found = rs.collision_probability(small, method=answer, confidence=0.9)
    low, high = binom_conf_interval(30, 100, confidence_level=0.9, interval="wilson")
    assert (found.low, found.high, found.n_effective) == pytest.approx((low, high, 100))


def test_simulations_take_allocators_of_others(small, hers):
    options = {"method": "auto", "n_targets": 100, "max_iterations": 20}
    usual = rs.collision_probability(small, allocator="lamost", **options)
    mine = rs.collision_probability(small, allocator="begin", **options)
    assert (mine.value, mine.method) == (usual.value, "monte_carlo")
    assert mine.meta["software"] == {"hers": "1.0"}
    own = rs.collision_probability(small, allocator=lambda problem: problem.start(), **options)
    assert own.value == usual.value
    assert own.meta["allocator"].endswith("<lambda>")


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (
            None,
            r"must return a probability for each positioner, numbers of the shape \(37,\), or a dict; got None",
        ),
        (0.5, r"got float of the shape \(\)"),
        (np.zeros(3), r"got ndarray of the shape \(3,\)"),
        (["a"] * 37, "must return a probability for each"),
        ([[1], [1, 2]], "must return a probability for each"),
        (np.full(37, 1.1), "per_positioner must be from 0 to 1, or NaN, got 1.1"),
        (np.full(37, -0.1), "per_positioner must be from 0 to 1, or NaN, got -0.1"),
        (np.full(37, np.nan), "the answer must have a value, or one per_positioner for a positioner that can take"),
        ({}, "the answer must have a value"),
        ({"n": 3}, "the answer must have a value"),
        (
            {"values": 0.5},
            "unknown field of an answer 'values'; choose one of: high, low, meta, .* Did you mean 'value'",
        ),
        ({"value": 0.5, "method": "x"}, "unknown field of an answer 'method'"),
        ({"value": np.nan}, "value must be a number of at least 0 and at most 1, got nan"),
        ({"value": 1.5}, "value must be a number of at least 0 and at most 1, got 1.5"),
        ({"value": "0.5"}, "value must be a number"),
        ({"value": np.ones(3)}, "value must be a number"),
        ({"value": 0.5, "standard_error": -1}, "standard_error must be a number of at least 0, got -1"),
        ({"value": 0.5, "n": 1.5}, "n must be a whole number of at least 0, got 1.5"),
        ({"value": 0.5, "low": 0.6, "high": 0.7}, "low, value and high must ascend, got 0.6, 0.5 and 0.7"),
        ({"value": 0.5, "low": 0.4}, "low, value and high must ascend, got 0.4, 0.5 and nan"),
        ({"value": 0.5, "meta": 3}, "meta must be a dict, got 3"),
    ],
)
def test_what_no_estimate_can_be_is_refused(small, answer, words):
    with pytest.raises(rs.InputError, match=f"^the method of collision probability .*<lambda>': .*{words}"):
        rs.collision_probability(small, method=always(answer))


def test_an_estimand_must_be_one():
    def method(question):
        raise AssertionError

    method.estimand = "both"
    with pytest.raises(rs.InputError, match="method': unknown estimand 'both'; choose one of: allocated, independent"):
        rs.collision_probability(PAIR, method=method)
    with pytest.raises(rs.InputError, match="every positioner is disabled or stuck"):
        rs.collision_probability(replace(PAIR, disabled=[True, True]), method=lambda question: [0, 0])


# the example of the documentation


def test_the_example_serves_the_rarest_first():
    """Target 1 has a choice, 0 and 2 do not; whoever comes first would take its place otherwise."""
    spec = importlib.util.spec_from_file_location("rfpsurvey_example", EXAMPLE / "rfpsurvey_example" / "__init__.py")
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    xy = [[12, 0], [13, 1], [-10, 0], [99, 0]] * u.mm  # both reach 0 and 1, the first alone 2
    assert rs.allocate(xy, PAIR, method=example.rarest).target_of_positioner.tolist() == [2, 0]
    ranked = rs.allocate(xy, PAIR, method=example.rarest, priority=[1, 2, 0, 0])
    assert ranked.target_of_positioner.tolist() == [0, 1]
    skies = rs.allocate(xy, PAIR, method=example.rarest, kind=["science", "sky", "sky", "sky"])
    assert skies.target_of_positioner.tolist() == [0, -1]
    assert rs.Instrument.read(example.TOY).name == "toy"


@pytest.fixture(scope="module")
def target(tmp_path_factory):
    """Return a folder where pip has installed the example."""
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
    """Let this process find it."""
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


def test_its_dice_agree_with_the_quadrature(installed, run):
    true = rs.collision_probability("toy", method="quadrature", precision=0.001).value
    code, out, _ = run("probability", "toy", "--method", "dice", "--max-iterations", 400)
    assert code == 0
    assert "nan" not in out
    value, error = (float(line.split()[-1]) for line in out.splitlines() if "probability " in line or "error" in line)
    assert 0 < error < 0.005
    assert abs(value - true) < 4 * error


def test_processes_find_it_by_its_name(target, tmp_path):
    command = [sys.executable, "-m", "rfpsurvey", "survey", "--instrument", "toy", "--allocator", "rarest"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(target), *filter(None, sys.path)])}
    subprocess.run([*command, "--processes", "--folder", "survey"], env=environment, check=True, cwd=tmp_path)
    survey = rs.Survey.read(tmp_path / "survey")
    assert survey.provenance["software"]["rfpsurvey-example"] == "0.1"
    assert survey.summary["n_assigned"] > 30
