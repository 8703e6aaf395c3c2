"""Requirements and limits: which targets they count, which fibers are missing, and maxima that no plan exceeds."""

import astropy.units as u
import numpy as np
import pytest
from raising import refused

import flat
import rfpsurvey as rs
from rfpsurvey._assignment.constraints.counts import sentences
from rfpsurvey.allocation import METHODS
from scenes import two_fibers

MM = u.mm
UNIT = rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM)
ROW = rs.FocalPlane([[0, 0], [40, 0], [80, 0]] * MM, UNIT, spectrograph=[7, 7, 9])
# each of three separate positioners reaches one science target, and the first also reaches three sky positions
XY = np.array([[5, 0], [45, 0], [85, 0], [0, 5], [0, 7], [0, -9.0]])
KIND = ["science"] * 3 + ["sky"] * 3
FILLING = ["lamost_rule", "network_flow", "optimal", "repair"]


def allocate(method, asked, **options):
    return flat.allocate(ROW, XY * MM, allocator=method, **{"kind": KIND, "requirements": asked, **options})


def said(method, asked, **options):
    return sentences(allocate(method, asked, **options).unmet)


@pytest.mark.parametrize("asked", ["sky=1", rs.Requirement("sky", 1), ("sky=1",), iter(["sky=1"]), np.array(["sky=1"])])
def test_one_requirement_or_any_list_of_them_will_do(asked):
    assert allocate("lamost_rule", asked).target_of_positioner.tolist() == [3, 1, 2]


ROWS = "forbidden must contain rows of positioners from 0 to 2 and rows of targets from 0 to 5"
PAIRS = r"forbidden must be pairs \(positioner, target\) of row numbers"
WHOLE = r"required must be row numbers of targets \(whole numbers\), got"
ONE = "^a requirement must be a Requirement or text such as 'sky=20/spectrograph', got"
REFUSED = [
    ({"requirements": 5}, "^requirements must be a list of Requirement or text, got 5$"),
    ({"requirements": [5]}, f"{ONE} 5$"),
    ({"requirements": ["sky=3", None]}, f"{ONE} None$"),
    ({"requirements": ["sky=99999999999999999999"]}, "a requirement must have a form such as"),
    ({"requirements": ["sky@BOSS=2"]}, "requirement 'sky@BOSS=2' 'BOSS': the positioners have no fiber"),
    ({"kind": ["science"] * 5}, r"kind must have one value per target, shape \(6,\), got \(5,\)"),
    (
        {"kind": ["science"] * 5 + ["star"]},
        "kind must be science, standard or sky, or several of them joined by '\\+'.* got 'star'",
    ),
    ({"category": ["a"]}, r"category must have one value per target, shape \(6,\), got \(1,\)"),
    ({"required": [True] * 6}, f"{WHOLE} bool"),
    ({"required": [1.0]}, f"{WHOLE} float64"),
    ({"required": [[1]]}, f"{WHOLE} int64 of the shape"),
    ({"required": [-1, 2]}, "required must be row numbers of targets, 0 to 5, got -1 to 2"),
    ({"required": 6}, "required must be row numbers of targets, 0 to 5, got 6 to 6"),
    *(({"forbidden": pairs}, PAIRS) for pairs in ([0, 1], [[0.0, 1.0]])),
    *(({"forbidden": [pair]}, ROWS) for pair in ([3, 0], [0, 6], [-1, 0])),
    ({"objective": "best"}, "unknown objective 'best'; choose one of: count, priority"),
]


@pytest.mark.parametrize(("options", "message"), REFUSED)
def test_wrong_options_are_refused(options, message):
    refused(message, allocate, "network_flow", **{"asked": ["sky=1"], "kind": KIND, **options})


def test_an_unknown_fiber_type_of_a_requirement_is_refused():
    message = "unknown fiber type of the requirement 'sky@C=2' 'C'; choose one of: A, B"
    refused(message, flat.allocate, two_fibers(), XY * MM, requirements="sky@C=2")


LACKING = [
    (["sky=1"], []),
    (["sky=2", "sky=2"], ["sky targets: 1 of 2, 1 missing"]),
    (["sky=3"], ["sky targets: 1 of 3, 2 missing"]),
    (["sky=4"], ["sky targets: 1 of 4, 3 missing; only 3 are in reach"]),
    (["sky=999999999"], ["sky targets: 1 of 999999999, 999999998 missing; only 3 are in reach"]),
    (["science=4"], ["science targets: 3 of 4, 1 missing; only 3 are in reach"]),
    (["standard=2"], ["standard targets: 0 of 2, 2 missing; none is in reach"]),
    (["sky_boss=2"], ["sky_boss targets: 0 of 2, 2 missing; none is in reach"]),
    (["sky=1/spectrograph"], ["sky targets in spectrograph 9: 0 of 1, 1 missing; none is in reach"]),
    (
        ["sky=2/spectrograph"],
        ["sky targets, 2 in each spectrograph: 3 missing in 2 spectrographs (7, 9); only 3 are in reach there"],
    ),
    (["sky=2", "sky=-1"], ["sky targets: 1 of 2, 1 missing"]),
    (
        ["sky=-1", "sky=2/spectrograph", "sky_boss=1"],
        [
            "sky targets, 2 in each spectrograph: 3 missing in 2 spectrographs (7, 9); only 3 are in reach there",
            "sky_boss targets: 0 of 1, 1 missing; none is in reach",
        ],
    ),
    (["sky=0", "sky=-0", "science=0-3/spectrograph"], []),
]


@pytest.mark.parametrize("method", FILLING)
@pytest.mark.parametrize(("asked", "expected"), LACKING)
def test_what_is_lacking_is_said_in_numbers(method, asked, expected):
    found = allocate(method, asked)
    assert sentences(found.unmet) == expected
    n_sky = sum(t >= 3 for t in found.target_of_positioner)
    assert n_sky == (not {"sky_boss=2", "standard=2", "science=4", "sky=0"} & set(asked))
    assert (found.target_of_positioner[1:] == [1, 2]).all()


@pytest.mark.parametrize("method", FILLING)
def test_what_exceeds_the_number_of_fibers_is_met_as_far_as_possible(method):
    xy = np.concatenate([c + [[1, 0], [0, 2], [-3, 0], [0, 4]] for c in ROW.xy.value])
    found = flat.allocate(ROW, xy * MM, method, requirements=["sky=5", "sky=3/spectrograph"], kind=["sky"] * 12)
    assert found.n_assigned == 3
    why = "all requirements together need 11 fibers, but only 3 fibers are usable"
    assert sentences(found.unmet) == [
        f"sky targets: 3 of 5, 2 missing; {why}",
        f"sky targets, 3 in each spectrograph: 3 missing in 2 spectrographs (7, 9); {why}",
    ]
    assert [(s.spectrograph, s.requested, s.found, s.possible) for s in found.unmet] == [
        (None, 5, 3, 12),
        (7, 3, 2, 8),
        (9, 3, 1, 4),
    ]


@pytest.mark.parametrize("method", ["network_flow", "optimal"])
def test_of_two_requirements_that_contradict_each_other_the_maximum_holds(method):
    assert said(method, ["science=3", "science=-1"]) == ["science targets: 1 of 3, 2 missing"]
    assert said("repair", ["science=-1"]) == []
    # both requirements need the first positioner, so that one requirement lacks a target
    found = allocate(method, ["sky=1", "near=1"], category=["near", "", "", "", "", ""])
    assert [(s.requested, s.found, s.possible) for s in found.unmet] in ([(1, 0, 1)], [(1, 0, 3)])
    assert found.n_assigned == 3


@pytest.mark.parametrize("method", ["balanced", "nearest"])
def test_rules_without_requirements_only_report(method):
    assert said(method, ["sky=2", "science=-2"]) == [
        "sky targets: 0 of 2, 2 missing",
        "science targets: 3, 1 more than the maximum of 2",
    ]
    assert allocate(method, ["sky=2", "science=-2"]).target_of_positioner.tolist() == [0, 1, 2]


NO_TARGETS = [
    {"xy": np.empty((0, 2)) * MM, "kind": []},
    {"xy": [[np.nan, 0], [900, 0]] * MM, "kind": ["sky", "science"]},
    {"xy": [[900, 0]] * MM, "kind": ["sky"], "sky_separation": 5 * MM},
]


@pytest.mark.filterwarnings("ignore:sky_separation has no effect")
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("options", NO_TARGETS)
def test_a_plan_without_targets_lacks_everything(method, options):
    options = dict(options)
    xy = options.pop("xy")
    found = flat.allocate(ROW, xy, allocator=method, requirements=["science=2", "sky=0", "standard=1-2"], **options)
    assert found.n_assigned == 0
    assert sentences(found.unmet) == [
        "science targets: 0 of 2, 2 missing; none is in reach",
        "standard targets: 0 of 1, 1 missing; none is in reach",
    ]


@pytest.mark.parametrize("method", FILLING)
def test_a_category_comes_before_the_kind_of_the_same_name(method):
    found = allocate(method, ["sky=2"], category=["", "", "sky", "", "", ""])
    assert [str(s) for s in found.unmet] == ["sky targets: 1 of 2, 1 missing; only 1 is in reach"]
    assert found.target_of_positioner.tolist() == [0, 1, 2]
    assert said(method, ["sky=2"], category=["x"] * 6) == ["sky targets: 1 of 2, 1 missing"]
    without = allocate(method, ["science=3", "sky=1"], kind=None)  # all targets are science targets
    assert (without.n_assigned, len(without.unmet)) == (3, 1)
    assert str(without.unmet[0]) == "sky targets: 0 of 1, 1 missing; none is in reach"


@pytest.mark.parametrize("method", FILLING)
def test_spectrographs_count_on_their_own(method):
    xy, kind = np.concatenate([XY, [[40, 9], [80, 9.5]]]), [*KIND, "sky", "standard"]
    found = flat.allocate(ROW, xy * MM, method, requirements=["sky=1/spectrograph", "standard=1"], kind=kind)
    assert [str(s) for s in found.unmet] == ["sky targets in spectrograph 9: 0 of 1, 1 missing; none is in reach"]
    target_of = found.target_of_positioner
    assert "sky" in [kind[t] for t in target_of[:2]]
    assert target_of[2] == 7


@pytest.mark.parametrize("method", FILLING)
def test_each_fiber_type_can_have_a_spectrograph_of_its_own(method):
    plane = rs.FocalPlane(ROW.xy, UNIT, fiber_type=["B+A", "B+A", "B"], spectrograph=[[1, 2], [1, 2], [2, 9]])
    xy = np.array([[5, 0], [45, 0], [85, 0], [0, 5], [0, 6], [80, 6], [40, 6]])
    kind, fiber = ["science"] * 3 + ["sky"] * 4, ["B", "", "", "A", "B", "", "B"]
    found = flat.allocate(
        plane, xy * MM, method, requirements=["sky=1/spectrograph"], kind=kind, fiber_type=fiber, forbidden=[(0, 4)]
    )
    # type B of the second positioner is in spectrograph 1; type A of the first or the third positioner is in
    # spectrograph 2; no positioner is in spectrograph 9
    assert found.target_of_positioner[1] == 6
    assert found.target_of_positioner[0] == 3 or found.target_of_positioner[2] == 5
    assert [str(s) for s in found.unmet] == ["sky targets in spectrograph 9: 0 of 1, 1 missing; none is in reach"]


@pytest.mark.parametrize("method", FILLING)
def test_a_fiber_type_narrows_what_counts(method):
    plane = rs.FocalPlane(ROW.xy, UNIT, fiber_type=["B+A", "A", "B"])
    fiber = ["B", "A", "B", "A", "", "B"]
    found = flat.allocate(plane, XY * MM, method, requirements=["sky@A=1"], kind=KIND, fiber_type=fiber)
    assert (found.target_of_positioner.tolist(), found.fiber_type.tolist()) == ([3, 1, 2], ["A", "A", "B"])
    found = flat.allocate(plane, XY * MM, method, requirements=["science@B=3"], kind=KIND, fiber_type=fiber)
    assert [str(s) for s in found.unmet] == ["science targets for B: 2 of 3, 1 missing; only 2 are in reach"]


@pytest.mark.parametrize("method", ["nearest", "lamost_rule", "network_flow", "optimal"])
def test_required_targets_come_before_everything_else(method):
    """Required targets of low priority and of any kind are the first class, and requirements do not release them."""
    xy = [[5, 0], [0, 6], [45, 0], [40, -6], [85, 0], [80, 6]] * MM
    kind = ["science", "sky", "science", "standard", "sky", "science"]
    more = {"kind": kind, "priority": [9, 0, 9, 0, 0, 1]}
    options = rs.AllocationOptions(method, requirements=["science=3"])
    found = rs.allocate(ROW, xy, allocator=options, required=[1, 3, 5], **more)
    assert found.target_of_positioner.tolist() == [1, 3, 5]
    if method in ("network_flow", "optimal"):
        assert found.levels[0] == ("required targets", 3, 3)
        assert said(method, ["sky=1"], required=[0]) == ["sky targets: 0 of 1, 1 missing"]
        return
    assert rs.allocate(ROW, xy, allocator=options, **more).target_of_positioner.tolist() == [0, 2, 5]
    assert rs.allocate(ROW, xy, allocator=method, required=[5], **more).target_of_positioner.tolist() == [0, 2, 5]


@pytest.mark.parametrize("seed", range(4))
def test_required_targets_are_to_lamost_what_the_highest_priority_is(seed):
    rng = np.random.default_rng(seed)
    xy, priority = rng.uniform(-75, 75, (160, 2)) * MM, rng.integers(0, 3, 160)
    rows = np.flatnonzero(rng.random(160) < 0.1)
    first = np.where(np.isin(np.arange(160), rows), 9, priority)
    for method in ("lamost_rule", "nearest"):
        found, expected = (
            rs.allocate(two_fibers(), xy, allocator=method, **columns).target_of_positioner.tolist()
            for columns in ({"priority": priority, "required": rows}, {"priority": first})
        )
        assert found == expected


@pytest.mark.parametrize("method", ["network_flow", "optimal"])
def test_required_targets_that_do_not_fit_are_reported(method):
    found = rs.allocate(ROW, [[5, 0], [0, 6], [0, 900]] * MM, allocator=method, required=[0, 1, 2])
    assert [str(s) for s in found.unmet] == ["required targets: 1 of 3, 2 missing; only 2 are in reach"]
    found = rs.allocate(ROW, [[0, 900]] * MM, allocator=method, required=[0])
    assert [str(s) for s in found.unmet] == ["required targets: 0 of 1, 1 missing; none is in reach"]
    assert rs.allocate(ROW, [[5, 0]] * MM, allocator=method, required=[]).unmet == ()


@pytest.mark.parametrize("method", METHODS)
def test_forbidden_pairs_are_never_used(method):
    free = allocate(method, None)
    assert allocate(method, None, forbidden=np.empty((0, 2), int)).target_of_positioner.tolist() == [0, 1, 2]
    assert free.target_of_positioner.tolist() == [0, 1, 2]
    bound = allocate(method, None, forbidden=[[0, 0], [2, 2], [1, 0]])
    fills = method in ("network_flow", "optimal", "repair")
    assert bound.target_of_positioner[1:].tolist() == [1, -1]
    assert (bound.target_of_positioner[0] >= 3) == fills
    assert (bound.n_reachable, bound.positioner_of_target[[0, 2]].tolist()) == (6, [-1, -1])


def test_a_type_of_fiber_with_its_own_spectrograph_is_not_omitted():
    """Among many better targets, the only one for the second spectrograph is kept, if any requirement counts it."""
    robot = rs.Positioner(8.25 * MM, 8.25 * MM, 2.25 * MM)
    plane = rs.FocalPlane([[0, 0], [100, 0]] * MM, robot, fiber_type=["A+B"] * 2, spectrograph=[[0, 1]] * 2)
    xy = np.random.default_rng(0).uniform(-8, 8, (1001, 2)) + np.where(np.arange(1001) < 501, 0, 100)[:, None] * [1, 0]
    types = np.where(np.arange(1001) == 0, "B", "A")
    plan = rs.allocate(
        plane,
        xy * MM,
        fiber_type=types,
        priority=np.where(types == "B", 1, 5),
        allocator=rs.AllocationOptions("optimal", requirements=["science=0-90", "science=1/spectrograph"]),
    )
    assert (plan.unmet, plan.fiber_type.tolist()) == ((), ["B", "A"])
