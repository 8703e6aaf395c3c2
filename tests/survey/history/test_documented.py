"""Random histories of a survey have the states and plans that the page on histories describes."""

import os
from collections import Counter
from contextlib import nullcontext
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from astropy.io import fits
from history_from_docs import STATES, DocumentedHistory, Plan, Report
from living import content, differences, events, instrument, part, sha, targets, tiling

import rfpsurvey as rs
from rfpsurvey._survey.folder import Folder
from rfpsurvey.survey import VisitRule, survey_status

RULES = ({}, {"retries": 0}, {"after_success": 2}, {"visits": 1, "retries": 1})
PETALS = np.array([0, 0, 0, 0, 1, 1, 1])
NEEDS, PARTS = ["standard=1", "sky=1"], ("requested", "observed", "complete", "targets")


class Driver:
    """A survey whose tiles have different passes, and the same history in both implementations."""

    def __init__(self, seed, folder, monkeypatch):
        self.rng, self.patch, self.day = np.random.default_rng(seed), monkeypatch, 1
        self.sky = targets(seed, kinds=seed % 3 == 0, roles=seed % 3 == 1)
        table = tiling(seed).table
        table["pass"] = 1 + np.arange(len(table))
        self.tiles, self.folder, self.rule = table["tile"].tolist(), folder, {}
        plane = replace(instrument().focal_plane, groups={"petal": PETALS})
        self.case = self.sky, replace(instrument(), focal_plane=plane), rs.Tiling.from_table(table)
        self.patch.setenv("SOURCE_DATE_EPOCH", str(self.seconds()))
        asked = rs.AllocationOptions(["nearest", "repair"][seed % 2], requirements=NEEDS if seed % 6 == 1 else ())
        joint = rs.JointOptions(iterations=1, allocator=rs.AllocationOptions("optimal"))
        self.options = {"rng": 1, "allocator": joint if seed % 10 == 2 else asked}
        self.survey = rs.plan_survey(*self.case, folder=folder, **self.options)
        ids = self.sky.id.tolist()
        kinds = ["science"] * len(ids) if self.sky.kind is None else self.sky.kind.tolist()
        science = {name for name, kind in zip(ids, kinds, strict=True) if "science" in kind}
        self.history = DocumentedHistory(zip(ids, self.sky.visits.tolist(), strict=True), science)
        self.take_plans(self.tiles, 0)
        self.planned, self.tables = None, []

    def date(self, day=None):
        return str(np.datetime64("2026-01-01") + ((self.day if day is None else day) - 1))

    def seconds(self):
        return np.datetime64(self.date(), "s").astype(int)

    def take_plans(self, tiles, n_records):
        plans = {}
        for tile in tiles:
            data = part(self.folder, self.tiles.index(tile))
            rows = self.survey.tile(tile)
            kinds = rows["kind"] if "kind" in rows.colnames else ["science"] * len(rows)
            counts = [ok and "science" in kind for ok, kind in zip(rows["observed"].tolist(), kinds, strict=True)]
            columns = rows["positioner"].tolist(), rows["target_id"].tolist(), counts
            digest = fits.getheader(BytesIO(data), 1)["PLANID"]
            plans[tile] = Plan(sha(data), digest, tuple(zip(*columns, strict=True)))
        self.history.plan(plans, self.date(), n_records)

    def send(self, is_new, function, *arguments, **options):
        """Record or undo, which is refused if ``is_new`` is None; a dry run before does the same, without files."""
        for is_dry in (True, False) if self.rng.random() < 0.2 else (False,):
            before = content(self.folder)
            with pytest.raises(rs.InputError) if is_new is None else nullcontext():
                result = function(*arguments, **options, dry_run=is_dry)
                assert is_new is None or "undone" in result or result["n_events"] == is_new, result
            assert (content(self.folder) == before) == (is_dry or not is_new)

    def observe(self):
        """Record an observation whose visits are named by positioners, targets or petals, or an old table again."""
        rng, history = self.rng, self.history
        if self.tables and rng.random() < 0.15:
            return self.send_table(*self.tables[rng.integers(len(self.tables))])
        tile, state = rng.choice(self.tiles).item(), rng.choice(["done", "done", "partly", "bad"]).item()
        known = sorted(date for name, date in history.observations if name == tile)
        date = self.date(max(0, self.day - int(rng.choice([0, 0, 0, 1, 3, 6]))))
        if known and rng.random() < 0.4:
            date = rng.choice(known).item()
        elif rng.random() < 0.1:
            date = ""
        plans = [one.plans[tile] for one in history.generations if tile in one.plans]
        names, columns, by_target = {}, {}, None
        if plans and rng.random() < 0.15:
            names = columns = {"generation": int(rng.integers(1, len(history.generations) + 2))}
        elif plans and rng.random() < 0.15:
            names = {"digest": plans[rng.integers(len(plans))].digest}
            columns = {rng.choice(["plan", "PLANID"]).item(): names["digest"]}
        elif plans and rng.random() < 0.2:
            by_target = plans[rng.integers(len(plans))]
            names = {"targets": by_target.targets}
        plan = history.credit(tile, date, **names)
        if by_target is not None:
            rows = [{"target": str(name), "good": bool(rng.random() < 0.7)} for name in sorted(by_target.targets)]
        elif rng.random() < 0.2:
            petal = {rng.choice(["petal", "spectrograph", "PETAL"]).item(): str(rng.integers(2))}
            rows = [petal | {"good": bool(rng.random() < 0.3)}]
        else:
            used = [visit[0] for visit in plan.visits if rng.random() < 0.3] if plan else []
            used += [6] if rng.random() < 0.1 and 6 not in used else []
            rows = [{"positioner": str(name), "good": bool(rng.random() < 0.3)} for name in used]
        replaces = rng.choice(["", "", "column", "option"]).item() if rows else ""
        if (tile, date) in history.observations and rows and rng.random() < 0.4:
            state = ""
        columns = columns | ({"replaces": True} if replaces == "column" else {})
        self.tables.append((tile, date, state, names, columns, by_target, rows, replaces))
        return self.send_table(*self.tables[-1])

    def send_table(self, tile, date, state, names, columns, by_target, rows, replaces):
        plan = self.history.credit(tile, date, **names)
        of_target = {str(target): name for name, target, _ in (getattr(plan or by_target, "visits", ()))}
        visits = []
        for row in rows:
            (name, value), is_good = next(iter(row.items())), row["good"]
            if name.lower() in ("petal", "spectrograph"):
                visits += [(k, is_good) for k in of_target.values() if plan and PETALS[k] == int(value)]
            else:
                visits.append((int(value) if name == "positioner" else of_target.get(value, -1), is_good))
        table = {"tile": tile, "state": [state, *[""] * len(rows)], **({"date": date} if date else {}), **columns}
        for name in dict.fromkeys(name for row in rows for name in row):
            table[name] = [True if name == "good" else "", *(row.get(name, "") for row in rows)]
        report = Report(tile, date, state, tuple(visits), replaces != "", plan)
        options = {"replaces": True} if replaces == "option" else {}
        self.send(self.history.observe(report), self.survey.record, events(**table)[not state :], **options)

    def undo(self):
        if self.history.records:
            number = int(self.rng.integers(1, len(self.history.records) + 1))
            self.send(self.history.undo(number), self.survey.undo, number)

    def cancel(self):
        tile = self.rng.choice(self.tiles).item()
        self.send(self.history.cancel(tile), self.survey.record, events(tile=tile, state="planned"))

    def drop(self):
        tile = self.rng.choice(self.tiles).item()
        self.send(self.history.drop(tile), self.survey.record, events(tile=tile, state="dropped"))

    def add_tile(self):
        tile, x, y = 30 + len(self.tiles), *self.rng.uniform(-0.2, 0.2, 2).tolist()
        self.tiles.append(tile)
        table = events(tile=tile, state="added", ra=120 + x, dec=30 + y, **{"pass": len(self.tiles)})
        self.send(self.history.record("add_tile", tile), self.survey.record, table)

    def change(self):
        known = [*self.history.visits]
        ids, number = self.rng.choice(known, 4, replace=False).tolist(), int(self.rng.integers(4))
        match self.rng.integers(4):
            case 0:
                ids = [5000 + len(known) + k for k in range(3)]
                columns, state = {"visits": 2, "priority": 1}, "added"
                columns |= {"ra": (120 + self.rng.uniform(-0.2, 0.2, 3)).tolist(), "dec": 30.01}
                columns |= {} if self.sky.kind is None else {"kind": "science"}
            case 1:
                columns, state = {"visits": number, "priority": int(self.rng.integers(1, 4))}, ""
            case what:
                columns, state = {}, "dropped" if what == 2 else "planned"
        values = {name: columns[name] for name in ("visits", "priority") if name in columns}
        table = events(target=ids, **columns, **({"state": state} if state else {}))
        self.send(self.history.change(ids, state, **values), self.survey.record, table)

    def begin(self):
        """Return what is planned: the tiles, the number of records, and the rule."""
        self.compare_tiles()
        tiles = [tile for tile in self.tiles if self.history.state_of(tile) != "dropped"]
        return tiles, len(self.history.records), self.rule

    def replan(self):
        """Plan the rest, also with another rule; an observation is recorded meanwhile or after an interruption."""
        self.patch.setenv("SOURCE_DATE_EPOCH", str(self.seconds()))
        self.rule = self.rng.choice(RULES) if self.rng.random() < 0.3 else self.rule
        tiles, *planned = self.begin()
        when, put, calls = self.rng.choice(["", "meanwhile", "interrupted"]).item(), Folder.put_part, []

        changes = {"rule": VisitRule(**self.rule), "progress": False}

        def observe_and_put(folder, *arguments):
            calls.append(arguments)
            if when == "interrupted" and len(calls) == 2:
                raise KeyboardInterrupt
            if when == "meanwhile" and len(calls) == 2:
                self.observe()
            put(folder, *arguments)

        with self.patch.context() as patch:
            patch.setattr(Folder, "put_part", observe_and_put)
            try:
                self.survey = self.survey.replan(**changes)
            except KeyboardInterrupt:
                self.observe()
                tiles, *planned = self.begin()
                self.survey = self.survey.replan(**changes)
        if planned != self.planned:
            self.take_plans(tiles, planned[0])
            self.planned = planned
        if planned[0] == len(self.history.records):
            self.compare_plan()
        assert self.survey.status().meta["generation"] == len(self.history.generations)

    def compare(self):
        """Compare the state, up to a date, with a rule and without the checkpoint in some cases."""
        rule, names = self.rng.choice(RULES), ("target_id", "requested", "observed", "failed", "left")
        until = {"until": self.date(int(self.rng.integers(1, self.day + 1)))} if self.rng.random() < 0.3 else {}
        if self.rng.random() < 0.3:
            (self.folder / "events/state.npz").unlink(missing_ok=True)
        state = self.survey.state(self.sky, rule=VisitRule(**rule), **until)
        rows = {name: tuple(more) for name, *more in zip(*(state.table[name].tolist() for name in names), strict=True)}
        assert rows == self.history.state(**rule, **until)
        if all(date for _, date in self.history.observations):  # the order of undated observations is not documented
            names = ("target_id", "last", "last_tile", "last_date")
            rows = zip(*(state.table[name].tolist() for name in names), strict=True)
            assert {name: tuple(row) for name, *row in rows if row[0] != "none"} == self.history.last_visits(**until)
        if not until:
            credited = sorted((int(one.tile), one.date or "", one.plan) for one in state.attempts)
            assert credited == sorted((*key, one.plan.file) for key, one in self.history.observations.items())

    def compare_plan(self):
        """The plan has the plans of the observed tiles, the rest is planned, and all sums agree."""
        survey, history, planned, total = self.survey, self.history, Counter(), Counter()
        for k, (tile, row) in enumerate(zip(self.tiles, survey.tiles, strict=True)):
            state, kept = history.state_of(tile), history.of(tile)
            kept = [one for one in kept if one.state == "done"] or (kept[-1:] if state == "partly observed" else [])
            if kept:
                assert sha(part(self.folder, k)) == kept[0].plan.file
            if state == "observed":
                visits = [visit for visit in kept[0].plan.visits if visit[2]]
                n_failed = sum(visit[0] in kept[0].failed for visit in visits)
                date = next(key[1] for key, one in history.observations.items() if one is kept[0])
                assert (row["n_observed"], row["n_failed"]) == (len(visits) - n_failed, n_failed)
                assert row["date"] == date
            elif state != "dropped":
                visits = kept[0].plan.visits if kept else history.generations[-1].plans[tile].visits
                planned.update(target for _, target, counts in visits if counts)
        rows, names = history.state(**self.rule), ("target_id", "requested", "observed")
        for target, requested, observed in zip(*(survey.outcomes[name].tolist() for name in names), strict=True):
            wanted, made, failed, _ = rows[target]
            assert (requested, observed) == (wanted, max(made, min(wanted, made + planned[target])))
            total.update(requested=requested, made=made, failed=failed, all=observed)
            total.update(observed=min(observed, requested), complete=0 < requested <= observed, targets=requested > 0)
        found = {name: survey.summary[f"n_visits_{name}"] for name in ("requested", "made", "failed", "observed")}
        assert (found, survey.tiles["n_observed"].sum()) == ({name: total[name] for name in found}, total["all"])
        last = survey.completeness[survey.completeness["priority"] == "all"][-1]
        assert [last[f"n_{name}"] for name in PARTS] == [total[name] for name in PARTS]
        assert sum(survey.summary["outcomes"].values()) == len(survey.outcomes)
        state = survey.state(self.sky, rule=VisitRule(**self.rule))
        assert differences(survey, rs.plan_survey(*self.case, **self.options, visits=state)) == []
        assert differences(survey, rs.Survey.read(self.folder)) == []

    def compare_tiles(self):
        passes = survey_status(self.survey, self.survey.state(self.sky)).meta["tiles"]
        states = [next(name for name in STATES if numbers[name]) for numbers in passes]
        assert states == [self.history.state_of(tile) for tile in self.tiles]

    def run(self, n_steps):
        steps = [self.observe] * 8 + [self.replan] * 4 + [self.change] * 2 + [self.undo] * 3
        steps += [self.cancel, self.drop, self.add_tile]
        for k in self.rng.integers(len(steps), size=n_steps):
            self.day += int(self.rng.integers(0, 3))
            steps[k]()
            self.compare()
        self.compare_tiles()


@pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")
@pytest.mark.few(3)
@pytest.mark.parametrize("seed", range(int(os.environ.get("RFPSURVEY_HISTORIES", 18))))
def test_random_histories_have_the_documented_states(seed, tmp_path, monkeypatch):
    Driver(seed, tmp_path / "survey", monkeypatch).run(15)
