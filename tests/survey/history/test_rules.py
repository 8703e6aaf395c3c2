"""Rules for visits, compared with closed forms and with a second implementation after some nights."""

import shutil

import numpy as np
import pytest
from astropy.table import MaskedColumn, QTable
from living import events, instrument, targets, tiling

import rfpsurvey as rs
from rfpsurvey.survey import SurveyState, VisitRule

LAST = ("none", "good", "bad")
NAMES = ("target_id", "positioner", "observed")


def columns(n=200, seed=0, **others):
    """Return the state of random targets, as rules receive it."""
    rng = np.random.default_rng(seed)
    found = {
        "id": np.arange(n),
        "requested": rng.integers(0, 5, n).astype(np.uint8),
        "observed": rng.integers(0, 6, n).astype(np.uint8),
        "failed": rng.integers(0, 4, n).astype(np.uint8),
        "last": rng.integers(0, 3, n),
        "priority": rng.integers(1, 4, n).astype(float),
        "category": rng.choice(["a", "b", "2"], n),
    }
    return found | others


def test_without_a_rule_nothing_changes():
    own = columns()
    visits, priority = VisitRule().apply(own)
    assert visits.tolist() == own["requested"].tolist()
    assert priority is own["priority"]
    assert VisitRule().record == {}


def test_visits():
    for number in (0, 1, 255):
        assert set(VisitRule(visits=number).apply(columns())[0].tolist()) == {number}


def test_after_success_and_retries():
    own = columns()
    visits = VisitRule(after_success=4, retries=1).apply(own)[0]
    for k, found in enumerate(visits.tolist()):
        requested, observed, failed = (int(own[name][k]) for name in ("requested", "observed", "failed"))
        expected = 0 if requested == 0 else 4 if observed else 1
        assert found == (min(expected, observed) if failed > 1 else expected)
    both = VisitRule(visits=0, after_success=4).apply(own)[0]
    assert not both.any()


ROWS = [
    # class, observed, last, priority, visits
    ("a", -1, "bad", 9.0, np.nan),
    ("2", 0, "any", np.nan, 7),
    ("any", 3, "good", 5.0, 8),
    ("a", -1, "any", np.nan, 0),
    ("b", 1, "none", 1.5, 2),
]


def naive_table(own, k, rows=ROWS):
    """Return the visits and the priority of a target by the first row that selects it."""
    for name, observed, last, priority, visits in rows:
        in_class = name == "any" or own["category"][k] == name or own["priority"][k] == {"2": 2.0}.get(name)
        if in_class and observed in (-1, own["observed"][k]) and last in ("any", LAST[own["last"][k]]):
            return (
                own["requested"][k] if visits != visits else visits,
                own["priority"][k] if priority != priority else priority,
            )
    return own["requested"][k], own["priority"][k]


def test_the_first_row_of_a_table_that_selects_a_target(tmp_path):
    own = columns()
    table = QTable(rows=ROWS, names=("class", "observed", "last", "priority", "visits"))
    expected = [naive_table(own, k) for k in range(200)]
    table.write(tmp_path / "rule.ecsv")
    for given in (table, tmp_path / "rule.ecsv"):
        visits, priority = VisitRule(table=given).apply(own)
        assert (visits.tolist(), priority.tolist()) == ([one[0] for one in expected], [one[1] for one in expected])
    reverse = VisitRule(table=table[::-1])
    expected = [naive_table(own, k, ROWS[::-1]) for k in range(200)]
    assert reverse.apply(own)[0].tolist() == [one[0] for one in expected]
    assert VisitRule(table=table).record != reverse.record


def test_tables_with_numbers_as_classes_and_missing_values():
    """Regression: priorities in columns of floating-point numbers, such as 2.0, selected no target."""
    own = columns(category=None)
    for values in ([2], [2.0], ["2"]):
        visits = VisitRule(table=QTable({"class": values, "visits": [9]})).apply(own)[0]
        assert (visits == 9).tolist() == (own["priority"] == 2).tolist()
    masked = QTable({"class": MaskedColumn(["a"], mask=[True]), "visits": [9]})
    masked["observed"] = MaskedColumn([3], mask=[True])
    assert (VisitRule(table=masked).apply(own)[0] == 9).all()
    some = QTable({"observed": [0], "priority": [4], "visits": MaskedColumn([4], mask=[True])})
    visits, priority = VisitRule(table=some).apply(columns(priority=None, category=None))
    assert visits.tolist() == own["requested"].tolist()
    assert priority.tolist() == np.where(own["observed"] == 0, 4.0, 0.0).tolist()


WHOLE = "must be whole numbers from 0 to 255"
WRONG = (
    ({"observed": [1]}, "must have the column visits or priority"),
    ({"visits": [1], "color": [1]}, "must have the column visits or priority, and may have the columns class"),
    ({"visits": [1.5]}, f"visits {WHOLE}, got 1.5"),
    ({"visits": ["x"]}, "visits"),
    *(
        ({"visits": [1], "observed": [n]}, "observed of a visit rule must be whole numbers from 0 to 255")
        for n in (1.5, -2)
    ),
    ({"visits": [1], "observed": ["x"]}, "observed"),
    ({"priority": [np.inf]}, "priority of a visit rule must be finite, got inf"),
    ({"priority": ["x"]}, "priority"),
    ({"visits": [1], "last": ["best"]}, "unknown last result of a visit rule 'best'"),
)


def test_wrong_tables():
    for table, sentence in WRONG:
        with pytest.raises(rs.InputError, match=sentence):
            VisitRule(table=QTable(table))


def by_hand(table):
    """Request another visit after each failed visit, up to three, and raise the priority of bad targets."""
    extra = np.minimum(table["failed"], 3)
    return {"visits": np.minimum(table["requested"] + extra, 255), "priority": 1.0 + 10 * (table["last"] == "bad")}


def test_functions_and_entry_points(install):
    own = columns()
    visits, priority = VisitRule(function=by_hand).apply(own)
    assert visits.tolist() == (own["requested"] + np.minimum(own["failed"], 3)).tolist()
    assert priority.tolist() == np.where(own["last"] == 2, 11.0, 1.0).tolist()
    code = "import numpy as np\ndef twice(table):\n    return {'visits': 2 * np.ones(len(table))}\n"
    install("nights", code, visit_rules={"twice": "twice"})
    rule = VisitRule(function="twice")
    assert (set(rule.apply(own)[0].tolist()), rule.record) == ({2}, {"function": "twice"})


RULES = {
    "visits": ({"visits": 2}, lambda one: 2),
    "after_success": ({"after_success": 3}, lambda one: 3 if one["made"] else 1),
    "retries": ({"retries": 0}, lambda one: min(one["visits"], one["made"]) if one["failed"] else one["visits"]),
    "table": (
        {"table": QTable({"observed": [0, -1], "last": ["bad", "any"], "visits": [3, 1]})},
        lambda one: 3 if one["made"] == 0 and one["last"] == "bad" else 1,
    ),
    "function": ({"function": by_hand}, lambda one: one["visits"] + min(one["failed"], 3)),
}


@pytest.mark.parametrize("name", RULES)
def test_states_after_some_nights(name, tmp_path):
    """After each night, the remaining visits are those of the second implementation, and they are planned."""
    sky, tiny, tiles = targets(2), instrument(), tiling(2)
    options, expected = RULES[name]
    rule, folder = VisitRule(**options), tmp_path / "survey"
    counts = {name: {"made": 0, "failed": 0, "last": "none"} for name in sky.id.tolist()}
    survey = rs.plan_survey(sky, tiny, tiles, folder=folder, allocator="nearest")
    rng = np.random.default_rng(1)
    for night in range(3):
        for tile in (11 + 2 * night, 12 + 2 * night):
            visits, failed = survey.tile(tile), [""]
            for target, positioner, counted in zip(*(visits[name].tolist() for name in NAMES), strict=True):
                is_good = rng.random() >= 0.4
                failed += [] if is_good else [str(positioner)]
                if counted:
                    counts[target]["made" if is_good else "failed"] += 1
                    counts[target]["last"] = "good" if is_good else "bad"
            survey.record(events(tile=tile, date=f"2026-01-0{night + 1}", positioner=failed))
        state = SurveyState.read(folder, sky, rule=rule)
        wanted = dict(zip(sky.id.tolist(), sky.visits.tolist(), strict=True))
        for row in state.table:
            one = counts[row["target_id"]] | {"visits": wanted[row["target_id"]]}
            assert (row["observed"], row["failed"], row["last"]) == (one["made"], one["failed"], one["last"])
            assert row["left"] == max(expected(one) - one["made"], 0)
        survey = rs.plan_survey(sky, tiny, tiles, folder=folder, allocator="nearest", visits=state, resume=True)
        planned = np.zeros(len(sky), dtype=int)
        for name_of, how in zip(survey.tiles["tile"], survey.tiles["state"], strict=True):
            if how == "planned":
                rows = survey.tile(name_of)
                np.add.at(planned, rows["target_row"][rows["observed"]], 1)
        assert (planned <= state.left).all()
        assert (survey.outcomes["observed"] == state.observed + planned).all()
        assert survey.provenance["events"].get("rule") == rule.record
    shutil.rmtree(folder)
