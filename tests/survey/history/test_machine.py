"""Random histories of a small survey, compared with a second implementation of the history."""

import os
import shutil
import tempfile
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule, run_state_machine_as_test
from living import N, content, differences, events, instrument, part, sha, targets, tiling
from naive_history import NaiveHistory, digests, results_of, statements, visits_of

import rfpsurvey as rs
from rfpsurvey.survey import SurveyState, VisitRule
from rfpsurvey.survey._folder import Folder

INSTRUMENT = instrument()
TINY = tiling()
ALLOCATOR = st.sampled_from(["nearest", "repair"] * 8 + ["joint"])
KINDS = st.sampled_from(["none", "none", "single", "several"])
LATE = st.sampled_from([None, -1, 1, 0, -1, -2])
"""Days after the last plan at which an observation was made that is recorded now; None for the present day."""
DIGEST = st.none() | st.none() | st.integers(0, 4)
LISTED = st.sampled_from(["positioner", "target", "all targets"])
FRACTIONS = {"done": 1.0, "partly": 0.5, "bad": 0.0}


class InterruptedPlanError(Exception):
    pass


def date_of(day):
    """Return the date of a day, which is counted from the beginning of the year."""
    return f"2026-01-{day:02d}" if day < 32 else f"2026-02-{day - 31:02d}"


class History(RuleBasedStateMachine):
    """A survey in a folder, and everything that was recorded in a second implementation."""

    @initialize(seed=st.integers(0, 9), kinds=KINDS, allocator=ALLOCATOR)
    def begin(self, seed, kinds, allocator):
        self.home = Path(tempfile.mkdtemp())
        self.folder = self.home / "survey"
        self.sky = targets(seed, kinds=kinds == "single", roles=kinds == "several")
        requirements = [] if kinds == "none" else ["standard=1", "sky=1"]
        self.allocator = rs.AllocationOptions(allocator, requirements=requirements) if allocator != "joint" else "joint"
        self.survey = self.plan()
        self.naive = NaiveHistory()
        self.day, self.planned_day = 1, 0
        self.names = np.asarray(TINY.table["tile"]).astype(str).tolist()
        self.tables, self.unplanned = [], set()
        plans = {name: part(self.folder, row) for row, name in enumerate(self.names)}
        self.all_plans, self.n_files = {name: [plan] for name, plan in plans.items()}, 0
        self.naive.replan("", plans)
        self.visits = dict(zip(self.sky.id.tolist(), self.sky.visits.tolist(), strict=True))
        kind = [["science"]] * N if self.sky.kind is None else [one.split("+") for one in self.sky.kind.tolist()]
        self.roles = dict(zip(self.sky.id.tolist(), kind, strict=True))
        self.dropped, self.n_added = set(), 0

    def teardown(self):
        if hasattr(self, "home"):
            shutil.rmtree(self.home)

    def plan(self, state=None, **options):
        options = {"folder": self.folder, "resume": state is not None, **options}
        clock = np.datetime64(date_of(self.day if state is not None else 1), "s").astype(int)
        with warnings.catch_warnings(), pytest.MonkeyPatch.context() as patch:
            patch.setenv("SOURCE_DATE_EPOCH", str(clock))
            warnings.simplefilter("ignore", rs.RfpsurveyWarning)
            return rs.plan_survey(self.sky, INSTRUMENT, TINY, allocator=self.allocator, visits=state, rng=1, **options)

    def record(self, table, accepted):
        """Record a table, and check that it is accepted or refused without a change of the folder."""
        before = content(self.folder)
        if not accepted:
            with pytest.raises(rs.InputError) as caught:
                self.survey.record(table)
            assert "\n" not in str(caught.value)
            assert content(self.folder) == before
            return False
        self.survey.record(table)
        before.pop("events/records.txt", None)  # the copy of all records
        assert before.items() <= content(self.folder).items()
        return True

    @rule(
        tile=st.integers(0, 9),
        state=st.sampled_from(["done", "done", "partly", "bad"]),
        late=LATE,
        fails=st.lists(st.integers(0, 6), max_size=3),
        listed=LISTED,
        by_fraction=st.booleans(),
        digest=DIGEST,
        order=st.randoms(use_true_random=False),
    )
    def observe(self, tile, state, late, fails, listed, by_fraction, digest, order):
        name, self.day = self.names[tile % len(self.names)], self.day + 1
        self.observe_on(name, self.date(late), state, fails, listed, by_fraction, order, digest)

    @rule(
        number=st.integers(0, 20),
        state=st.sampled_from(["done", "done", "partly", "bad"]),
        fails=st.lists(st.integers(0, 6), max_size=3),
        digest=DIGEST,
        order=st.randoms(use_true_random=False),
    )
    def correct(self, number, state, fails, digest, order):
        """Record another result of an earlier observation."""
        known = self.naive.observations()
        if known:
            one = known[number % len(known)]
            self.observe_on(one.tile, one.date, state, fails, "positioner", False, order, digest, good=fails[1:])

    @rule(number=st.integers(0, 40), order=st.randoms(use_true_random=False))
    def record_again(self, number, order):
        """Record an old table once more, also after it was corrected, canceled, or planned again."""
        if self.tables:
            name, date, state, rows, by_fraction = self.tables[number % len(self.tables)]
            self.send(name, date, state, order.sample(rows, len(rows)), by_fraction)

    def date(self, late):
        """Return the present date, or a date some days after the day on which the survey was planned."""
        return date_of(self.day if late is None else min(self.day, max(1, self.planned_day + late)))

    def observe_on(self, name, date, state, fails, listed, by_fraction, order, digest=None, good=()):
        """Record an observation; of the visits that failed, some are recorded as good instead."""
        rows = [{"tile": name, "date": date}]
        rows[0].update({"fraction": FRACTIONS[state]} if by_fraction else {"state": state})
        if digest is not None:  # the digest of a plan that this tile has or had, or another text
            texts = [text for plan in self.all_plans.get(name, [])[::-1] for text in digests(plan)] + [
                "0123456789abcdef"
            ]
            rows[0]["plan"] = texts[digest % len(texts)]
        visits = visits_of(self.naive.plan(name, date, rows[0].get("plan", "")) or self.naive.plan(name, date))
        failed, good_rows = ({k % len(visits) for k in numbers if visits} for numbers in (fails, good))
        for k in range(len(visits)) if listed == "all targets" else failed:
            key = {"tile": name, "date": date}
            key |= {"positioner": visits[k][1]} if listed == "positioner" else {"target": str(visits[k][0])}
            result = {"good": k not in failed - good_rows} if good or listed == "all targets" else {}
            rows.append(key | result)
        self.send(name, date, state, order.sample(rows, len(rows)), by_fraction)

    def is_accepted(self, name, date, state, failed=(), fraction=1.0, good=(), digest="", stated=()):
        """Return whether an observation states its plan or is later than it, or corrects or repeats another one.

        ``stated`` contains the identifiers of the targets that the table names.
        """
        before, plan = self.naive.of(name), self.naive.plan(name, date, digest, stated)
        done = [one for one in before if one.state == "done" and one.date != date]
        if not plan or None in {*failed, *good}:
            return False  # the tile has another plan than when the table was written
        if any(one.date == date for one in before):
            known = self.naive.is_known(name, date, statements(state, failed, fraction, good))
            return known or not (state == "done" and done)
        return not done

    @rule(tiles=st.lists(st.integers(0, 9), min_size=2, max_size=3), late=LATE)
    def observe_a_night(self, tiles, late):
        """Observe several tiles in the order of the table, which determines the last visits."""
        self.day += 1
        date = self.date(late)
        names = [*dict.fromkeys(self.names[tile % len(self.names)] for tile in tiles)]
        plans = [self.naive.plan(name, date) for name in names]
        accepted = all(self.is_accepted(name, date, "done") for name in names)
        if self.record(events(tile=names, date=date, state="done"), accepted):
            for name, plan in zip(names, plans, strict=True):
                self.naive.observe(name, date, "done", plan)

    def send(self, name, date, state, rows, by_fraction):
        """Record rows, which may be refused."""
        fraction = FRACTIONS[state] if by_fraction else 1.0
        digest = max(row.get("plan", "") for row in rows)
        stated = {row["target"] for row in rows if "target" in row}
        plan = self.naive.plan(name, date, digest, stated)
        failed, good = results_of(rows, plan)
        accepted = self.is_accepted(name, date, state, failed, fraction, good, digest, stated)
        defaults = {"fraction": 1.0, "good": True}
        columns = {key: [one.get(key, defaults.get(key, "")) for one in rows] for one in rows for key in one}
        if self.record(events(**columns), accepted):
            self.naive.observe(name, date, state, plan, failed, fraction, good)
            self.tables.append((name, date, state, rows, by_fraction))

    @rule(tile=st.integers(0, 9))
    def cancel(self, tile):
        name = self.names[tile % len(self.names)]
        self.day += 1
        self.record(events(tile=name, state="planned"), True)
        self.naive.cancel(name)

    @rule(tile=st.integers(0, 9))
    def drop(self, tile):
        name = self.names[tile % len(self.names)]
        if self.record(events(tile=name, state="dropped"), self.naive.state_of(name) != "done"):
            self.naive.drop(name)

    @rule(tile=st.integers(0, 12), x=st.integers(-20, 20), y=st.integers(-20, 20), number=st.integers(1, 3))
    def move(self, tile, x, y, number):
        """Add a tile, or move an existing tile."""
        is_new = tile >= len(self.names) and len(self.names) < 9
        name = str(50 + len(self.names)) if is_new else self.names[tile % len(self.names)]
        table = events(tile=name, state="added", ra=120 + x / 100, dec=30 + y / 100 + self.day / 1e5)
        self.day += 1  # no two tiles are at the same place
        table["pass"] = number
        if self.record(table, not self.naive.of(name)):
            self.unplanned.add(name)
            self.naive.add(name)
            if is_new:
                self.names.append(name)

    @rule(chosen=st.lists(st.integers(0, N - 1), min_size=1, max_size=6, unique=True), what=st.integers(0, 3))
    def change(self, chosen, what):
        """Add, drop or take back targets, or change numbers of visits."""
        ids = [1000 + k for k in chosen]
        if what == 0:
            ids = [2000 + self.n_added + k for k in range(len(chosen))]
            self.n_added += len(chosen)
            table = events(target=ids, ra=[119.8 + k / 150 for k in chosen], dec=30.05, priority=2, visits=2)
            self.visits |= dict.fromkeys(ids, 2)
            roles = ("science",) if self.sky.kind is None else ("science", "standard")
            self.roles |= dict.fromkeys(ids, roles)
            if len(roles) > 1:
                table["kind"] = "+".join(roles)
        elif what == 1:
            table = events(target=ids, visits=chosen[0] % 4)
            self.visits |= dict.fromkeys(ids, chosen[0] % 4)
        else:
            table = events(target=ids, state="dropped" if what == 2 else "planned")
            self.dropped = self.dropped | {*ids} if what == 2 else self.dropped - {*ids}
        self.record(table, True)

    @rule(after=st.none() | st.integers(0, 6), beside=st.booleans(), days=st.integers(0, 3))
    def replan(self, after, beside, days):
        """Plan the rest after some days; after some files, the plan is interrupted and continued."""
        self.day += days
        state = SurveyState.read(self.folder, self.sky)
        if after is not None:
            put, calls = Folder.put_part, []

            def fail(folder, tile, data):
                if len(calls) >= after:
                    raise InterruptedPlanError
                calls.append(tile)
                put(folder, tile, data)

            Folder.put_part = fail
            try:
                self.plan(state)
            except InterruptedPlanError:
                if beside:
                    state = SurveyState.read(self.folder, self.sky)
            finally:
                Folder.put_part = put
        self.survey = self.plan(state)
        self.unplanned = {name for name in self.names if self.naive.state_of(name) == "dropped"}
        self.planned_day = self.day
        n_files = len([*(self.folder / "events").glob("0*.json")])
        if n_files > self.n_files:  # otherwise, the plan is the present plan
            rows = [(row, name) for row, name in enumerate(self.names) if name not in self.unplanned]
            plans = {name: part(self.folder, row) for row, name in rows}
            self.naive.replan(date_of(self.day), plans)
            for name, plan in plans.items():
                if plan not in self.all_plans.setdefault(name, []):
                    self.all_plans[name].append(plan)
        self.n_files = n_files
        self.check_plan()

    @rule()
    def replan_undisturbed(self):
        self.replan(None, False, 0)

    @rule(tile=st.integers(0, 9), late=LATE, listed=LISTED, digest=DIGEST, order=st.randoms(use_true_random=False))
    def change_and_observe(self, tile, late, listed, digest, order):
        """Drop targets of a tile, plan again, and record an observation before this day, without and with its plan."""
        names = [name for name in self.names if name not in self.unplanned and self.naive.state_of(name) == "planned"]
        if names:
            name = names[tile % len(names)]
            ids = [one[0] for one in visits_of(part(self.folder, self.names.index(name)))]
            self.change([one - 1000 for one in ids[:2]] or [0], 2)
            self.replan(None, False, 2)
            self.observe_on(name, self.date(late), "done", [0, 1], "positioner", False, order)
            self.observe_on(name, self.date(late), "done", [0, 1], listed, False, order, digest)

    def check_plan(self):
        survey, counts = self.survey, self.naive.counts()
        for row, name in enumerate(self.names):
            done = [one for one in self.naive.of(name) if one.state == "done"]
            kept = done[-1:] or (self.naive.of(name)[-1:] if self.naive.state_of(name) == "partly" else [])
            if kept:
                assert sha(part(self.folder, row)) == sha(kept[0].plan)
        assert survey.tiles["state"].tolist() == [self.naive.state_of(name) for name in self.names]
        made = {key: one["made"] for key, one in counts.items()}
        planned = {}
        n_observed = np.zeros(len(self.names), dtype=int)
        for row, name in enumerate(self.names):
            if self.naive.state_of(name) == "done":
                continue
            for target, _, is_free, roles in visits_of(part(self.folder, row)) if name not in self.unplanned else []:
                if is_free and "science" in roles:
                    planned[target] = planned.get(target, 0) + 1
        for row, name in enumerate(self.names):
            for one in self.naive.of(name):
                if one.state == "done":
                    good = [v for v in one.visits() if v[2] and v[1] not in one.failed]
                    n_observed[row] = len(good)
                    assert survey.tiles["n_observed"][row] == len(good)
                    assert survey.tiles["date"][row] == one.date
                    assert survey.tiles["n_failed"][row] == sum(v[2] for v in one.visits()) - len(good)
        total = {"requested": 0, "made": 0, "observed": 0, "complete": 0, "targets": 0}
        for target, requested, observed in zip(
            *(survey.outcomes[name].tolist() for name in ("target_id", "requested", "observed")), strict=True
        ):
            own = made.get(target, 0)
            if "science" not in self.roles[target]:
                assert observed == 0
                continue
            assert requested == (min(own, self.visits[target]) if target in self.dropped else self.visits[target])
            assert observed == max(own, min(requested, own + planned.get(target, 0)))
            assert target not in self.dropped or planned.get(target, 0) == 0 or self.naive_begun(target)
            total["requested"] += requested
            total["made"] += observed
            total["observed"] += min(observed, requested)
            total["complete"] += 0 < requested <= observed
            total["targets"] += requested > 0
        summary = survey.summary
        assert summary["n_visits_made"] == sum(made.values())
        assert summary["n_visits_failed"] == sum(one["failed"] for one in counts.values())
        assert summary["n_visits_observed"] == total["observed"]
        assert survey.tiles["n_observed"].sum() == total["made"]
        assert summary["n_visits_requested"] == total["requested"]
        last = survey.completeness[survey.completeness["priority"] == "all"][-1]
        names = ("n_requested", "n_observed", "n_complete", "n_targets")
        assert [last[name] for name in names] == [total[name[2:]] for name in names]
        assert sum(summary["outcomes"].values()) == len(survey.outcomes)
        again = self.plan(self.survey.state(self.sky), folder=None, resume=False)
        assert differences(survey, again) == []
        read = rs.Survey.read(self.folder)
        assert differences(again, read) == []  # the visits of a survey in a folder are read each time

    def naive_begun(self, target):
        """Return whether a partly observed tile has the target."""
        tiles = [name for name in self.names if self.naive.state_of(name) == "partly"]
        return any(target == v[0] for name in tiles for v in self.naive.of(name)[-1].visits())

    @rule(day=st.none() | st.integers(0, 20), without=st.booleans(), retries=st.none() | st.integers(0, 1))
    def read(self, day, without, retries):
        """Read the state, with or without the checkpoint, up to a date, and with or without a rule."""
        until = None if day is None else f"2026-01-{day + 1:02d}"
        path = self.folder / "events/state.npz"
        if without and path.exists():
            path.unlink()
        rule = VisitRule(retries=retries)
        state = SurveyState.read(self.folder, self.sky, rule=rule, until=until)
        assert not path.exists() or not without
        counts = self.naive.counts(until)
        nobody = {"made": 0, "failed": 0, "last": "none", "last_tile": "", "last_date": ""}
        names = ("observed", "failed", "last", "last_tile", "last_date", "requested", "left")
        table = state.table
        for target, *found in zip(*(table[name].tolist() for name in ("target_id", *names)), strict=True):
            own = counts.get(target, nobody)
            wanted = self.visits[target]
            if target in self.dropped or (retries is not None and own["failed"] > retries):
                wanted = min(wanted, own["made"])
            if "science" not in self.roles[target]:
                own, wanted = nobody, 0
            assert found == [*(own[name] for name in nobody), wanted, max(wanted - own["made"], 0)], target

    @invariant()
    def check_state(self):
        if hasattr(self, "dropped"):
            self.read(None, False, None)


def run(number, steps):
    few = settings(
        max_examples=number,
        stateful_step_count=steps,
        deadline=None,
        suppress_health_check=[*HealthCheck],
        print_blob=False,
    )
    run_state_machine_as_test(History, settings=few)


@pytest.mark.filterwarnings("ignore:.* was corrected after this record")
@pytest.mark.parametrize(
    "number", [15, pytest.param(int(os.environ.get("RFPSURVEY_HISTORIES", 30)), marks=pytest.mark.exhaustive)]
)
def test_random_histories(number):
    run(number, 12)
