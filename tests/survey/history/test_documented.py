"""Random histories of a survey have the states that the page on histories describes."""

import hashlib
import os
from contextlib import nullcontext
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
from astropy.io import fits
from history_from_docs import STATES, DocumentedHistory, Plan, Report
from living import content, events, instrument, part, targets, tiling

import rfpsurvey as rs
from rfpsurvey.survey import VisitRule, survey_status
from rfpsurvey.survey._folder import Folder

RULES = ({}, {"retries": 0}, {"after_success": 2}, {"visits": 1, "retries": 1})
PETALS = np.array([0, 0, 0, 0, 1, 1, 1])


class Driver:
    """A survey whose tiles have different passes, and the same history in both implementations."""

    def __init__(self, seed, folder, monkeypatch):
        self.rng, self.patch, self.day = np.random.default_rng(seed), monkeypatch, 1
        self.sky = targets(seed, kinds=seed % 3 == 0, roles=seed % 3 == 1)
        table = tiling(seed).table
        table["pass"] = 1 + np.arange(len(table))
        self.tiles, self.folder, self.rule = table["tile"].tolist(), folder, {}
        plane = replace(instrument().focal_plane, groups={"petal": PETALS})
        given = self.sky, replace(instrument(), focal_plane=plane), rs.Tiling.from_table(table)
        self.patch.setenv("SOURCE_DATE_EPOCH", str(self.seconds()))
        self.survey = rs.plan_survey(*given, folder=folder, rng=1, allocator=["nearest", "repair"][seed % 2])
        ids = self.sky.id.tolist()
        kinds = ["science"] * len(ids) if self.sky.kind is None else self.sky.kind.tolist()
        science = {name for name, kind in zip(ids, kinds, strict=True) if "science" in kind}
        self.history = DocumentedHistory(zip(ids, self.sky.visits.tolist(), strict=True), science)
        self.take_plans(self.tiles, 0)
        self.planned = None

    def date(self, day=None):
        return str(np.datetime64("2026-01-01") + ((self.day if day is None else day) - 1))

    def seconds(self):
        return np.datetime64(self.date(), "s").astype(int)

    def take_plans(self, tiles, n_records):
        plans = {}
        for tile in tiles:
            data = part(self.folder, self.tiles.index(tile))
            names = ("positioner", "target_id", "observed")
            columns = zip(*(self.survey.tile(tile)[name].tolist() for name in names), strict=True)
            digest = fits.getheader(BytesIO(data), 1)["PLANID"]
            plans[tile] = Plan(hashlib.sha256(data).hexdigest(), digest, tuple(columns))
        self.history.plan(plans, self.date(), n_records)

    def send(self, is_new, function, *arguments, **options):
        """Record or undo, which is refused if ``is_new`` is None; a dry run before does the same, without files."""
        for is_dry in (True, False) if self.rng.random() < 0.2 else (False,):
            before = content(self.folder)
            with pytest.raises(rs.InputError) if is_new is None else nullcontext():
                result = function(*arguments, **options, dry_run=is_dry)
                assert is_new is None or "undone" in result or result["n_events"] == is_new, result
            assert (content(self.folder) == before) == (is_dry or not is_new)

    def observe(self, tiles=None, **chosen):
        rng, history = self.rng, self.history
        tile, state = rng.choice(tiles or self.tiles).item(), rng.choice(["done", "done", "partly", "bad"]).item()
        known = sorted(date for name, date in history.observations if name == tile)
        date = self.date(max(0, self.day - int(rng.choice([0, 0, 0, 1, 3, 6]))))
        if known and rng.random() < 0.4:
            date = rng.choice(known).item()
        elif rng.random() < 0.1:
            date = ""
        plans = [one.plans[tile] for one in history.generations if tile in one.plans]
        names, columns, by_target = {}, {}, None
        if plans and rng.random() < 0.15:
            names = {"generation": int(rng.integers(1, len(history.generations) + 2))}
            columns = {"generation": names["generation"]}
        elif plans and rng.random() < 0.15:
            names = {"digest": plans[rng.integers(len(plans))].digest}
            columns = {rng.choice(["plan", "PLANID"]).item(): names["digest"]}
        elif plans and rng.random() < 0.2:
            by_target = plans[rng.integers(len(plans))]
            names = {"targets": by_target.targets}
        plan = history.credit(tile, date, **names)
        visits, rows = self.visits(by_target, plan)
        replaces = bool(rows and rng.random() < 0.3)
        if (tile, date) in history.observations and rows and rng.random() < 0.4:
            state = ""
        if replaces and rng.random() < 0.5:
            columns["replaces"] = True
            options = {}
        else:
            options = {"replaces": True} if replaces else {}
        table = {"tile": tile, "state": [state, *[""] * len(rows)], **({"date": date} if date else {}), **columns}
        for name in dict.fromkeys(name for row in rows for name in row):
            table[name] = [True if name == "good" else "", *(row.get(name, "") for row in rows)]
        table = events(**table)[(0 if state else 1) :]
        is_new = history.observe(Report(tile, date, state, visits, replaces, plan))
        self.send(is_new, self.survey.record, table, **options)

    def visits(self, by_target, plan):
        """Return pairs of positioners and whether they were good, and the rows of a table that state the same."""
        rng = self.rng
        if by_target is not None:
            of_target = {target: name for name, target, _ in (plan or by_target).visits}
            rows = [{"target": str(name), "good": bool(rng.random() < 0.7)} for name in sorted(by_target.targets)]
            return tuple((of_target.get(int(row["target"]), -1), row["good"]) for row in rows), rows
        planned = [visit[0] for visit in plan.visits] if plan else []
        if rng.random() < 0.2:
            petal, is_good = int(rng.integers(2)), bool(rng.random() < 0.3)
            visits = tuple((name, is_good) for name in planned if PETALS[name] == petal)
            return visits, [{rng.choice(["petal", "spectrograph"]).item(): str(petal), "good": is_good}]
        names = [name for name in planned if rng.random() < 0.3]
        names += [6] if rng.random() < 0.1 and 6 not in names else []
        visits = tuple((name, bool(rng.random() < 0.3)) for name in names)
        return visits, [{"positioner": str(name), "good": is_good} for name, is_good in visits]

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
        assert self.survey.status().meta["generation"] == len(self.history.generations)

    def compare(self):
        rule, names = self.rng.choice(RULES), ("target_id", "requested", "observed", "failed", "left")
        until = {"until": self.date(int(self.rng.integers(1, self.day + 1)))} if self.rng.random() < 0.3 else {}
        state = self.survey.state(self.sky, rule=VisitRule(**rule), **until)
        rows = {name: tuple(more) for name, *more in zip(*(state.table[name].tolist() for name in names), strict=True)}
        assert rows == self.history.state(**rule, **until)
        if not until:
            credited = sorted((int(one.tile), one.date or "", one.plan) for one in state.attempts)
            assert credited == sorted((*key, one.plan.file) for key, one in self.history.observations.items())

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
@pytest.mark.parametrize("seed", range(int(os.environ.get("RFPSURVEY_HISTORIES", 30))))
def test_random_histories_have_the_documented_states(seed, tmp_path, monkeypatch):
    Driver(seed, tmp_path / "survey", monkeypatch).run(15)
