"""The history of a survey as the page on histories describes it, with dictionaries of tiles, dates and targets."""

from dataclasses import dataclass, field

STATES = ("observed", "partly observed", "bad", "dropped", "planned")


@dataclass
class Observation:
    """The observation of a tile on a date, with the plan that the tile had when it was first recorded."""

    plan: tuple
    state: str = ""
    failed: set = field(default_factory=set)
    stated: list = field(default_factory=list)
    """What each of the records stated."""


class DocumentedHistory:
    """Everything that was recorded of a survey.

    Parameters
    ----------
    visits : dict
        Requested visits of each target.
    science : set
        Targets that are science targets.
    """

    def __init__(self, visits, science):
        self.visits, self.science = dict(visits), set(science)
        self.observations, self.dropped_tiles, self.dropped_targets = {}, set(), set()
        self.plans, self.planned, self.before = {}, {}, set()

    def plan(self, plans, day):
        """Use plans made on a day: for each tile, its file, and the positioner, target and success of each visit."""
        for tile, plan in plans.items():
            if self.plans.get(tile) != plan:
                self.planned[tile] = day
        self.plans, self.before = plans, {*self.observations}

    def of(self, tile):
        """Return the observations of a tile in the order of their dates."""
        return [self.observations[key] for key in sorted(self.observations) if key[0] == tile]

    def state_of(self, tile):
        states = [one.state for one in self.of(tile)]
        if "done" in states:
            return "observed"
        if tile in self.dropped_tiles:
            return "dropped"
        return {"partly": "partly observed", "bad": "bad"}[states[-1]] if states else "planned"

    def observe(self, tile, date, state, visits=()):
        """Record an observation, with pairs of a positioner and whether its visit was good; return if it is valid."""
        before = self.observations.get((tile, date))
        stated = {("state", state), *visits}
        if before is not None and any(stated <= earlier for earlier in before.stated):
            return True
        if before is None and tile not in self.plans:
            return False
        now = before or Observation(self.plans[tile])
        others = [one for one in self.of(tile) if one is not before]
        if not {positioner for positioner, _ in visits} <= {visit[0] for visit in now.plan[1]}:
            return False
        if any(one.state == "done" for one in others) and (before is None or state == "done"):
            return False
        is_used = any(one.plan == now.plan for one in others)
        last = max((key[1] for key in self.before & {*self.observations}), default="")
        if before is None and ((date <= last and not is_used) or date < self.planned.get(tile, "")):
            return False
        if before is None and date > max((key[1] for key in self.observations if key[0] == tile), default=""):
            self.dropped_tiles.discard(tile)
        now.state = state
        now.failed |= {positioner for positioner, is_good in visits if not is_good}
        now.failed -= {positioner for positioner, is_good in visits if is_good}
        now.stated.append(stated)
        self.observations[tile, date] = now
        return True

    def cancel(self, tile):
        """Record that a tile is planned, whatever was observed."""
        self.dropped_tiles.discard(tile)
        self.observations = {key: one for key, one in self.observations.items() if key[0] != tile}

    def drop(self, tile):
        self.dropped_tiles.add(tile)

    def change(self, targets, *, visits=None, dropped=None):
        """Record other numbers of visits of targets, or whether they are dropped; unknown targets are added."""
        if visits is not None:
            self.science.update(set(targets) - {*self.visits})
            self.visits.update(dict.fromkeys(targets, visits))
        if dropped is not None:
            self.dropped_targets = self.dropped_targets - set(targets) | (set(targets) if dropped else set())

    def state(self, *, until="9999", visits=None, after_success=None, retries=None):
        """Return for each target the numbers of requested, observed, failed and remaining visits."""
        good, bad = dict.fromkeys(self.visits, 0), dict.fromkeys(self.visits, 0)
        for (_, date), one in self.observations.items():
            if one.state == "done" and date <= until:
                for positioner, target, counts in one.plan[1]:
                    if counts and target in self.science:
                        (bad if positioner in one.failed else good)[target] += 1
        return {target: self._row(target, good[target], bad[target], visits, after_success, retries) for target in good}

    def _row(self, target, good, bad, visits, after_success, retries):
        requested = self.visits[target] if visits is None else visits
        if after_success is not None and requested > 0:
            requested = after_success if good else 1
        if target in self.dropped_targets or (retries is not None and bad > retries):
            requested = min(requested, good)
        requested = requested if target in self.science else 0
        return requested, good, bad, max(requested - good, 0)
