"""The history of a survey as the page on histories describes it: all records that were not undone, in their order."""

from dataclasses import dataclass, field
from typing import NamedTuple

STATES = ("observed", "partly observed", "bad", "dropped", "planned")


class Plan(NamedTuple):
    """The plan of a tile: its file, the digest of its targets, and positioner, target and success of each visit."""

    file: str
    digest: str
    visits: tuple

    @property
    def targets(self):
        return {target for _, target, _ in self.visits}


class Generation(NamedTuple):
    """The last plans of all tiles, the tiles that were not dropped, the day, and the number of records before."""

    plans: dict
    tiles: set
    day: str
    n_records: int


class Report(NamedTuple):
    """What a record states of a tile on a date; ``visits`` contains pairs of a positioner and whether it was good."""

    tile: int
    date: str
    state: str = ""
    visits: tuple = ()
    replaces: bool = False
    plan: Plan | None = None

    @property
    def failed(self):
        return {positioner for positioner, is_good in self.visits if not is_good}


@dataclass
class Observation:
    """The observation of a tile on a date."""

    plan: Plan
    order: tuple
    first: int
    state: str = ""
    failed: set = field(default_factory=set)
    reports: list = field(default_factory=list)

    def states(self, report):
        """Return whether a report states nothing that an earlier report did not state, or replaces nothing."""
        if report.replaces:
            return report.failed == self.failed and report.state in ("", self.state)
        return any({*report.visits} <= {*one.visits} and report.state in ("", one.state) for one in self.reports)


class DocumentedHistory:
    """Everything that was recorded of a survey; each method that records returns None if the record is refused.

    Parameters
    ----------
    visits : dict
        Requested visits of each target.
    science : set
        Targets that are science targets.
    """

    def __init__(self, visits, science):
        self.first, self.science = dict(visits), set(science)
        self.records, self.generations, self.removed, self.unclear = [], [], set(), set()
        self._replay()

    def plan(self, plans, day, n_records):
        """Add a generation; plans that are replaced on their day, before an observation was recorded, are removed."""
        former = self.generations[-1].plans if self.generations else {}
        changed = [tile for tile in plans if plans[tile] != former.get(tile, plans[tile])]
        if changed and self.generations[-1].day == day:
            is_used = any(kind == "observe" for kind, _ in self.records[self.generations[-1].n_records :])
            for tile in [] if is_used else changed:
                self.unclear.add((tile, len(self.generations)))
                is_new = all(one.plans.get(tile) != former[tile] for one in self.generations[:-1])
                self.removed |= {former[tile]} if is_new else set()
        self.removed -= {*plans.values()}
        self.generations.append(Generation(former | plans, {*plans}, day if former else "", n_records))

    def credit(self, tile, date, *, generation=None, digest=None, targets=None):
        """Return the plan to which an observation is credited, or None if it is not clear."""
        plans = [one.plans.get(tile) for one in self.generations]
        possible = [plan for plan in plans if plan and plan not in self.removed]
        if generation is not None:
            is_known = generation <= len(plans) and (tile, generation) not in self.unclear
            possible = [plan for plan in plans[generation - 1 : generation] if plan in possible and is_known]
        elif digest is not None:
            possible = [plan for plan in possible if plan.digest == digest]
        is_named = generation is not None or digest is not None
        if (recorded := self.observations.get((tile, date))) is not None:
            is_valid = not is_named or recorded.plan.digest in {plan.digest for plan in possible}
            return recorded.plan if is_valid else None
        if is_named:
            return [None, *possible][-1]
        valid = [one for one in self.generations if not date or (one.day <= date and self._last_before(one) < date)]
        is_clear = valid[-1] is not self.generations[-1] or tile in valid[-1].tiles
        if not date and self._last_before(valid[-1]) and len({*possible}) > 1:
            is_clear = False
        plan = valid[-1].plans.get(tile) if is_clear else None
        if targets is not None and (plan is None or not plan.targets <= targets):
            plan = [plan, *(other for other in possible if other.targets <= targets)][-1]
        return plan if plan in possible else None

    def _last_before(self, generation):
        """Return the last date of the observations with which a plan was made, except those that were canceled."""
        return max((key[1] for key, one in self.observations.items() if one.first <= generation.n_records), default="")

    def of(self, tile):
        """Return the observations of a tile in the order of their dates."""
        return sorted(
            (self.observations[key] for key in self.observations if key[0] == tile), key=lambda one: one.order
        )

    def state_of(self, tile):
        states = [observation.state for observation in self.of(tile)]
        if "done" in states:
            return "observed"
        if tile in self.dropped_tiles:
            return "dropped"
        return {"partly": "partly observed", "bad": "bad"}[states[-1]] if states else "planned"

    def observe(self, report):
        """Record an observation; return whether it was not known."""
        before = self.observations.get((report.tile, report.date))
        if report.plan is None or any(name < 0 for name, _ in report.visits):
            return None
        if before is None and (not report.state or self.state_of(report.tile) == "observed"):
            return None
        return False if before is not None and before.states(report) else self.record("observe", report)

    def cancel(self, tile):
        return self.record("cancel", tile) if self.of(tile) or tile in self.dropped_tiles else False

    def drop(self, tile):
        if tile in self.dropped_tiles:
            return False
        return self.record("drop", tile) if self.state_of(tile) != "observed" else None

    def change(self, targets, state="", **values):
        """Record numbers of visits, priorities or the states of targets; return how many rows are not known."""
        self.science.update(targets if state == "added" else ())
        dropped = self.dropped_targets
        same = {"": {*targets}, "dropped": dropped, "planned": {*self.visits} - dropped, "added": set()}[state]
        same = {target for target in same if values.items() <= self.stated.get(target, {}).items()}
        new = [target for target in targets if target not in same]
        return len(new) if not new or self.record("change", new, state, values) else None

    def undo(self, number):
        return None if number in self.undone else self.record("undo", number)

    def record(self, kind, *values):
        """Add a record if it is possible after all earlier records that were not undone."""
        self.records.append((kind, values))
        if self._replay():
            return True
        self.records.pop()
        self._replay()
        return None

    def _replay(self):
        """Repeat all records that were not undone, and return whether they are possible."""
        self.observations, self.dropped_tiles, self.dropped_targets = {}, {}, set()
        self.visits, self.stated, self.undone = dict(self.first), {}, set()
        numbered = [*enumerate(self.records, start=1)]
        for number, (kind, values) in reversed(numbered):
            self.undone |= {*values} if kind == "undo" and number not in self.undone else set()
        return all(self._repeat(number, kind, values) for number, (kind, values) in numbered)

    def _repeat(self, number, kind, values):
        is_undone = number in self.undone
        match kind, *values:
            case "observe", report if not is_undone:
                return self._observe(number, report)
            case "cancel", tile if not is_undone:
                self.dropped_tiles.pop(tile, None)
                self.observations = {key: value for key, value in self.observations.items() if key[0] != tile}
            case (("drop" | "add_tile"), tile) if is_undone == (kind == "add_tile"):
                self.dropped_tiles[tile] = max((date for _, date in self.observations), default="")
            case "change", targets, state, stated if not is_undone or state == "added":
                for target in targets:
                    self.stated[target] = self.stated.get(target, {}) | stated
                    self.visits[target] = self.stated[target].get("visits", self.first.get(target))
                self.dropped_targets -= {*targets} if state else set()
                self.dropped_targets |= {*targets} if state == "dropped" or is_undone else set()
        return True

    def _observe(self, number, report):
        key = report.tile, report.date
        before = self.observations.get(key)
        others = [self.observations[other] for other in self.observations if other[0] == report.tile and other != key]
        if (before is None and not report.state) or (before and before.plan != report.plan):
            return False
        if report.state == "done" and any(other.state == "done" for other in others):
            return False
        if not {positioner for positioner, _ in report.visits} <= {visit[0] for visit in report.plan.visits}:
            return False
        order = report.date or max((date for _, date in self.observations), default=""), not report.date
        if order[0] > self.dropped_tiles.get(report.tile, order[0]):
            del self.dropped_tiles[report.tile]
        now = self.observations.setdefault(key, Observation(report.plan, order, number))
        now.state = report.state or now.state
        good = {positioner for positioner, is_good in report.visits if is_good}
        now.failed = (set() if report.replaces else now.failed - good) | report.failed
        now.reports.append(report)
        return True

    def state(self, *, until="9999", visits=None, after_success=None, retries=None):
        """Return for each target the numbers of requested, observed, failed and remaining visits."""
        good, bad = dict.fromkeys(self.visits, 0), dict.fromkeys(self.visits, 0)
        for (_, date), one in self.observations.items():
            if one.state == "done" and date <= until:
                for positioner, target, counts in one.plan.visits:
                    if counts and target in self.science:
                        (bad if positioner in one.failed else good)[target] += 1
        return {target: self._row(target, good[target], bad[target], visits, after_success, retries) for target in good}

    def last_visits(self, until="9999"):
        """Return for each target its last visit: whether it was good or bad, the tile, and the date."""
        found = {}
        for (tile, date), one in sorted(self.observations.items(), key=lambda item: item[1].order):
            if one.state == "done" and date <= until:
                for positioner, target, counts in one.plan.visits:
                    if counts and target in self.science:
                        found[target] = "bad" if positioner in one.failed else "good", str(tile), date
        return found

    def _row(self, target, good, bad, visits, after_success, retries):
        requested = self.visits[target] if visits is None else visits
        if after_success is not None and requested > 0:
            requested = after_success if good else 1
        if target in self.dropped_targets or (retries is not None and bad > retries):
            requested = min(requested, good)
        requested = requested if target in self.science else 0
        return requested, good, bad, max(requested - good, 0)
