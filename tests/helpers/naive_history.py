"""A second implementation of the state of a survey: every observation in a list, every count in a dict."""

import hashlib
from dataclasses import dataclass, field
from functools import lru_cache
from io import BytesIO

from astropy.io import fits


@dataclass
class Observation:
    """What was recorded for a tile and a date, and the content of the plan of the tile at that time."""

    tile: str
    date: str
    state: str
    plan: bytes
    failed: frozenset = frozenset()
    fraction: float = 1.0
    said: frozenset = frozenset()
    """The statements of the table: the state with the fraction, and each positioner that failed or was good."""

    def visits(self) -> list[tuple]:
        """Return the identifier of the target, the positioner and the success of the plan for each science visit."""
        return [one[:3] for one in visits_of(self.plan) if "science" in one[3]]


@lru_cache(1000)
def visits_of(plan: bytes) -> list[tuple]:
    """Return the identifier of the target, the positioner, the success and the roles of each visit of a plan."""
    if not plan:
        return []
    with fits.open(BytesIO(plan)) as units:
        rows = units[1].data
        kinds = rows["kind"] if "kind" in rows.names else ["science"] * len(rows)
        return [
            (int(row["target_id"]), str(row["positioner"]), bool(row["observed"]), kind.split("+"))
            for row, kind in zip(rows, kinds, strict=True)
        ]


def digests(plan: bytes) -> list[str]:
    """Return the texts that identify a plan in a table: the entry of its header, and the checksum of its file."""
    with fits.open(BytesIO(plan)) as units:
        return [units[1].header["PLANID"], hashlib.sha256(plan).hexdigest()]


def results_of(rows: list[dict], plan: bytes) -> tuple[list, list]:
    """Return the positioners that failed and that were good according to a table; None for those without a visit."""
    names = {str(text): one[1] for one in visits_of(plan) for text in one[:2]}
    results = [
        (names.get(one.get("positioner") or one["target"]), one.get("good"))
        for one in rows
        if {*one} & {"positioner", "target"}
    ]
    return [name for name, good in results if not good], [name for name, good in results if good]


def statements(state: str, failed=(), fraction: float = 1.0, good=()) -> frozenset:
    """Return what a table states of a tile and a date, statement by statement."""
    return frozenset({(state, fraction), *(("failed", one) for one in failed), *(("good", one) for one in good)})


@dataclass
class NaiveHistory:
    """All records of a survey in the order in which they were made."""

    log: list = field(default_factory=list)
    """Pairs of a word (``observe``, ``cancel``, ``drop``, ``add``) and an observation."""
    generations: list = field(default_factory=list)
    """The date, the observations and the plan of each tile of each plan of the survey."""

    def records(self, tile: str, date: str) -> list[Observation]:
        """Return the records of a tile and a date that were made since the tile was canceled."""
        found = []
        for word, one in self.log:
            if word == "cancel" and one.tile == tile:
                found = []
            elif word == "observe" and (one.tile, one.date) == (tile, date):
                found.append(one)
        return found

    def plan(self, tile: str, date: str, digest: str = "", stated=()) -> bytes:
        """Return the plan with which a tile was observed on a date; empty if it is not known.

        ``digest`` is the digest of the plan in a table, and ``stated`` are the targets in the table.
        """
        recorded = [one.plan for one in self.of(tile) if one.date == date]
        if recorded:
            return recorded[0] if not digest or digest in digests(recorded[0]) else b""
        plans, used = [plans.get(tile) for *_, plans in self.generations], []
        for word, one in self.log:
            if one.tile == tile:
                used = [] if word == "add" else used + [one.plan] * (word == "observe")
        known = [*used, *filter(None, plans)]
        if digest:
            return next((plan for plan in known[::-1] if digest in digests(plan)), b"")
        counted = {(one.tile, one.date, one.plan) for one in self.observations()}
        valid = [
            number
            for number, (made, applied, _) in enumerate(self.generations)
            if made <= date and all(of < date for _, of, _ in applied & counted)
        ]
        if not known or (not plans[-1] and (not valid or valid[-1] == len(plans) - 1)):
            return b""
        own = [plan for plan in plans[: valid[-1] + 1] if plan] if valid else []
        fits = [plan for plan in known if stated and {str(one[0]) for one in visits_of(plan)} <= {*stated}]
        return fits[-1] if fits and not {*own[-1:]} & {*fits} else own[-1] if own else b""

    def replan(self, day: str, plans: dict[str, bytes]) -> None:
        """Add a generation; plans that are replaced on their day, before an observation with them, are not kept."""
        if self.generations:
            made, _, before = self.generations[-1]
            observed = {(one.tile, one.date, one.plan) for word, one in self.log if word == "observe"}
            used = {plan for _, _, plan in observed}
            earlier = {plan for *_, own in self.generations[:-1] for plan in own.values()}
            if made == day and observed == self.planned_with:
                for tile in [*before]:
                    if plans.get(tile) != before[tile] and before[tile] not in used | earlier:
                        del before[tile]
        self.planned_with = {(one.tile, one.date, one.plan) for word, one in self.log if word == "observe"}
        self.generations.append((day, self.planned_with, dict(plans)))

    def is_known(self, tile: str, date: str, said: frozenset) -> bool:
        """Return whether one earlier record of a tile and a date makes all statements."""
        return any(said <= one.said for one in self.records(tile, date))

    def observe(self, tile: str, date: str, state: str, plan: bytes, failed=(), fraction: float = 1.0, good=()) -> None:
        """Add an observation with all failures recorded before, unless it repeats an earlier record."""
        said = statements(state, failed, fraction, good)
        if not self.is_known(tile, date, said):
            before = [one.failed for one in self.records(tile, date)]
            failed = frozenset(failed) | ((before[-1] if before else frozenset()) - frozenset(good))
            self.log.append(("observe", Observation(tile, date, state, plan, failed, fraction, said)))

    def cancel(self, tile: str, date: str = "") -> None:
        self.log.append(("cancel", Observation(tile, date, "planned", b"")))

    def drop(self, tile: str, date: str = "") -> None:
        self.log.append(("drop", Observation(tile, date, "dropped", b"")))

    def add(self, tile: str) -> None:
        self.log.append(("add", Observation(tile, "", "added", b"")))
        for *_, plans in self.generations:  # plans for another position
            plans.pop(tile, None)

    def observations(self, until: str | None = None) -> list[Observation]:
        """Return the observations that count, in the order of dates."""
        found: list[Observation] = []
        for word, one in self.log:
            if until is not None and one.date > until:
                continue
            if word == "cancel":
                found = [other for other in found if other.tile != one.tile]
            elif word == "observe":
                same = [k for k, old in enumerate(found) if (old.tile, old.date) == (one.tile, one.date)]
                if same:
                    found[same[0]] = one
                else:
                    found.append(one)
        return sorted(found, key=lambda one: one.date)

    def of(self, tile: str, until: str | None = None) -> list[Observation]:
        return [one for one in self.observations(until) if one.tile == tile]

    def state_of(self, tile: str, until: str | None = None) -> str:
        """Return done, partly, dropped or planned."""
        found = self.of(tile, until)
        if any(one.state == "done" for one in found):
            return "done"
        dropped, known, latest = None, set(), ""
        for word, one in self.log:
            if until is not None and one.date > until:
                continue
            latest = max(latest, one.date if word == "observe" else "")
            if one.tile != tile:
                continue
            if word == "drop":
                dropped = one.date or latest
            elif word != "observe":
                dropped = None
            elif one.date not in known and not (dropped is not None and one.date <= dropped):
                dropped = None  # a new observation; a report on the past does not change the plan
            known = {*known, one.date} if word == "observe" else set() if word == "cancel" else known
        if dropped is not None:
            return "dropped"
        return "partly" if found and found[-1].state == "partly" else "planned"

    def counts(self, until: str | None = None) -> dict[int, dict]:
        """Return the visits of each target that was visited: made, failed, last, last_tile, last_date."""
        found: dict[int, dict] = {}
        for one in self.observations(until):
            if one.state != "done":
                continue
            for target, positioner, is_free in one.visits():
                if not is_free:  # lost to a collision
                    continue
                own = found.setdefault(target, {"made": 0, "failed": 0})
                good = positioner not in one.failed
                own["made" if good else "failed"] += 1
                own.update(last="good" if good else "bad", last_tile=one.tile, last_date=one.date)
        return found
