"""Random histories of a survey have the states that the page on histories describes."""

from contextlib import nullcontext

import numpy as np
import pytest
from history_from_docs import STATES, DocumentedHistory
from living import events, instrument, part, targets, tiling

import rfpsurvey as rs
from rfpsurvey.survey import VisitRule, survey_status

RULES = ({}, {"retries": 0}, {"after_success": 2}, {"visits": 1, "retries": 1})


class Driver:
    """A survey whose tiles have different passes, and the same history in both implementations."""

    def __init__(self, seed, folder, monkeypatch):
        self.rng, self.patch, self.day = np.random.default_rng(seed), monkeypatch, 1
        self.sky = targets(seed, kinds=seed % 3 == 0, roles=seed % 3 == 1)
        table = tiling(seed).table
        table["pass"] = 1 + np.arange(len(table))
        self.tiles = table["tile"].tolist()
        self.given = (self.sky, instrument(), rs.Tiling.from_table(table))
        self.options = {"folder": folder, "rng": 1, "allocator": ["nearest", "repair"][seed % 2]}
        self.patch.setenv("SOURCE_DATE_EPOCH", str(self.seconds()))
        self.survey = rs.plan_survey(*self.given, **self.options)
        ids = self.sky.id.tolist()
        kinds = ["science"] * len(ids) if self.sky.kind is None else self.sky.kind.tolist()
        science = {name for name, kind in zip(ids, kinds, strict=True) if "science" in kind}
        self.history = DocumentedHistory(zip(ids, self.sky.visits.tolist(), strict=True), science)
        self.take_plans()

    def date(self, day=None):
        return str(np.datetime64("2026-01-01") + ((self.day if day is None else day) - 1))

    def seconds(self):
        return np.datetime64(self.date(), "s").astype(int)

    def take_plans(self):
        plans = {}
        for row, tile in enumerate(self.tiles):
            if self.history.state_of(tile) != "dropped":
                content = part(self.options["folder"], row)
                plans[tile] = self.history.plans.get(tile, ("", []))
                if content != plans[tile][0]:
                    columns = (
                        self.survey.tile(tile)[name].tolist() for name in ("positioner", "target_id", "observed")
                    )
                    plans[tile] = content, list(zip(*columns, strict=True))
        self.history.plan(plans, self.date())

    def send(self, is_valid, **columns):
        with nullcontext() if is_valid else pytest.raises(rs.InputError):
            self.survey.record(events(**columns))

    def observe(self):
        tile, state = self.rng.choice(self.tiles).item(), self.rng.choice(["done", "done", "partly", "bad"]).item()
        known = sorted(date for name, date in self.history.observations if name == tile)
        date = self.date(max(1, self.day - int(self.rng.choice([0, 0, 0, 1, 3]))))
        if known and self.rng.random() < 0.4:
            date = self.rng.choice(known).item()
        one = self.history.observations.get((tile, date))
        _, plan = one.plan if one else self.history.plans.get(tile, ("", []))
        names = [visit[0] for visit in plan if self.rng.random() < 0.3]
        names += [6] if self.rng.random() < 0.1 and 6 not in names else []
        good = [bool(self.rng.random() < 0.3) for _ in names]
        is_valid = self.history.observe(tile, date, state, [*zip(names, good, strict=True)])
        columns = {"tile": tile, "date": date, "state": [state, *[""] * len(names)]}
        more = {"positioner": ["", *map(str, names)], "good": [True, *good]} if names else {}
        self.send(is_valid, **columns, **more)

    def cancel(self):
        tile = self.rng.choice(self.tiles).item()
        self.history.cancel(tile)
        self.send(True, tile=tile, state="planned")

    def drop(self):
        tile = self.rng.choice(self.tiles).item()
        is_valid = self.history.state_of(tile) != "observed"
        if is_valid:
            self.history.drop(tile)
        self.send(is_valid, tile=tile, state="dropped")

    def add_tile(self):
        tile, x, y = 30 + len(self.tiles), *self.rng.uniform(-0.2, 0.2, 2).tolist()
        self.tiles.append(tile)
        self.survey.record(events(tile=tile, state="added", ra=120 + x, dec=30 + y, **{"pass": len(self.tiles)}))

    def change(self):
        known = [*self.history.visits]
        ids = self.rng.choice(known, 4, replace=False).tolist()
        match self.rng.integers(4):
            case 0:
                ids = [5000 + len(known) + k for k in range(3)]
                self.history.change(ids, visits=2)
                ra = (120 + self.rng.uniform(-0.2, 0.2, 3)).tolist()
                kind = {} if self.sky.kind is None else {"kind": "science"}
                self.send(True, target=ids, ra=ra, dec=30.01, visits=2, priority=1, **kind)
            case 1:
                number = int(self.rng.integers(4))
                self.history.change(ids, visits=number)
                self.send(True, target=ids, visits=number)
            case what:
                self.history.change(ids, dropped=what == 2)
                self.send(True, target=ids, state="dropped" if what == 2 else "planned")

    def replan(self):
        self.patch.setenv("SOURCE_DATE_EPOCH", str(self.seconds()))
        self.compare_tiles()
        state = self.survey.state(self.sky)
        self.survey = rs.plan_survey(*self.given, **self.options, visits=state, resume=True)
        self.take_plans()

    def compare(self):
        rule, names = self.rng.choice(RULES), ("target_id", "requested", "observed", "failed", "left")
        until = {"until": self.date(int(self.rng.integers(1, self.day + 1)))} if self.rng.random() < 0.3 else {}
        table = self.survey.state(self.sky, rule=VisitRule(**rule), **until).table
        rows = {name: tuple(more) for name, *more in zip(*(table[name].tolist() for name in names), strict=True)}
        assert rows == self.history.state(**rule, **until)

    def compare_tiles(self):
        passes = survey_status(self.survey, self.survey.state(self.sky)).meta["tiles"]
        states = [next(name for name in STATES if numbers[name]) for numbers in passes]
        assert states == [self.history.state_of(tile) for tile in self.tiles]

    def run(self, n_steps):
        steps = [self.observe] * 8 + [self.replan] * 4 + [self.change] * 2 + [self.cancel, self.drop, self.add_tile]
        for k in self.rng.integers(len(steps), size=n_steps):
            self.day += int(self.rng.integers(0, 3))
            steps[k]()
            self.compare()
        self.compare_tiles()


@pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")
@pytest.mark.few(3)
@pytest.mark.parametrize("seed", range(300))
def test_random_histories_have_the_documented_states(seed, tmp_path, monkeypatch):
    Driver(seed, tmp_path / "survey", monkeypatch).run(15)
