"""The state of all targets of a survey (requested and remaining visits, and outcomes) in a few bytes per target."""

import numpy as np

from rfpsurvey._assignment.rules import FEWEST_FIRST
from rfpsurvey._field.verdicts import Outcome, category_classes, priority_classes
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._survey.cadences import Windows
from rfpsurvey._survey.work import DONE, EXCLUDED, LOST_IN_COLLISION, REACHED, SEEN, Done, Job, flags_of, reach_of


class Tally:
    """Numbers of targets and visits in each pass and each class; a class is, for example, all targets of one priority.

    ``class_of`` and the requested visits (``wanted``) are in the order of slots (see `Bookkeeping`).
    """

    def __init__(self, class_of: np.ndarray, names: list[str], wanted: np.ndarray, n_passes: int):
        self.class_of, self.names = class_of, names
        self.n_requested = np.bincount(class_of, weights=wanted, minlength=len(names)).astype(np.int64)
        self.n_targets = np.bincount(class_of[wanted > 0], minlength=len(names))
        self.n_observed = np.zeros((n_passes, len(names)), dtype=np.int64)
        self.n_complete = np.zeros_like(self.n_observed)

    def add(self, number: int, slot: np.ndarray, complete: np.ndarray, last: int | np.ndarray) -> None:
        """Add visits to the counts.

        ``number`` is the index of the pass of the visits, and ``slot`` contains the slot of the target of each visit.
        ``complete`` lists the targets that have now received all requested visits, and ``last`` is the index of the
        pass of the last visit to each of these targets.
        """
        self.n_observed[number] += np.bincount(self.class_of[slot], minlength=len(self.names))
        np.add.at(self.n_complete, (last, self.class_of[complete]), 1)

    def until(self, number: int) -> tuple[list[str], np.ndarray]:
        """Return the names of the classes, and their numbers after a pass.

        The numbers are those of targets, requested visits, successful visits, and complete targets.
        """
        observed, complete = (numbers[: number + 1].sum(axis=0) for numbers in (self.n_observed, self.n_complete))
        return self.names, np.column_stack([self.n_targets, self.n_requested, observed, complete])


def classes_by_column(
    priority: np.ndarray | None, category: np.ndarray | None, wanted: np.ndarray
) -> dict[str, tuple[np.ndarray, list[str]]]:
    """Return the class of each target, and the names of the classes, for each column of labels.

    These are the priorities and, if there are several, the categories. Only targets with requested visits (``wanted``)
    define the classes.
    """
    classes = {"priority": priority_classes(priority, wanted), "category": category_classes(category, wanted)}
    return {column: labels for column, labels in classes.items() if column == "priority" or len(labels[1]) > 1}


def rows_by_class(counts: dict[str, tuple[list[str], np.ndarray]]) -> list[tuple]:
    """Return rows of labels and numbers for all targets and, if there are several classes, for each class.

    ``counts`` contains, for each column of labels, the names of the classes, and an array with a row for each class.
    """
    rows = [(*["all"] * len(counts), *counts["priority"][1].sum(axis=0).tolist())]
    for column, (names, values) in counts.items():
        for name, numbers in zip(names, values.tolist(), strict=True) if len(names) > 1 else ():
            rows.append((*(name if column == labeled_column else "all" for labeled_column in counts), *numbers))
    return rows


def windows_of(request, n: int = 1) -> Windows | None:
    """Return the windows before the first visit, with ``n`` elements for each slot; None without cadences."""
    if request.cadences is None:
        return None
    cadences, row = request.cadences
    return Windows(cadences, np.repeat(request.source.to_slots(row), n), request.visit_days, request.brightness)


def job_without(request, tile: int, left: np.ndarray, closed: np.ndarray) -> Job:
    """Return the job of a tile for remaining visits ``left``, of which those of the slots ``closed`` are not used."""
    kept, left[closed] = left[closed], 0
    job = request.job(tile, left)
    left[closed] = kept
    return job


class Remaining:
    """The remaining visits ``left``, and the windows of cadences or None; both have the same number of elements."""

    left: np.ndarray
    windows: Windows | None

    def allows(self, index: np.ndarray, tile: int) -> np.ndarray:
        """Return whether a visit on a tile counts for each element: visits remain, and the window is open."""
        is_left = self.left.reshape(-1)[index] > 0
        if self.windows is not None:
            is_left[is_left] = self.windows.state(index[is_left], tile)[0]
        return is_left

    def spend(self, index: np.ndarray, tile: int) -> np.ndarray:
        """Reduce the remaining visits of the elements that a tile observes; return that of each visit that counts."""
        index = index if self.windows is None else self.windows.enter(index, tile)
        np.subtract.at(self.left.reshape(-1), index, 1)
        return index


class Bookkeeping(Remaining):
    """Record of the visits of each target; tiles that share no target can be recorded in any order.

    The *slot* of a target is its index in the arrays of ``request.builder`` and of this class.
    """

    def __init__(self, request):
        builder, n_passes, self._number = request.builder, len(request.passes), request.number
        self.windows = windows_of(request)
        if self.windows is not None and request.state is not None:
            self.windows.begin_as(request.state.windows, request.source.to_slots)
        self._builder, self.wanted, self.left = builder, builder.wanted, builder.left.copy()
        self.spends = np.broadcast_to(np.True_, len(self.left)) if builder.spends is None else builder.spends
        self.n_observed = np.zeros(len(self._number), dtype=np.int64)
        """Number of successful visits of each tile to science targets."""
        classes = classes_by_column(*(builder.source.by_slot(name) for name in ("priority", "category")), self.wanted)
        self.flags = np.zeros(len(self.wanted), dtype=np.uint8)
        self.tallies = {column: Tally(*labels, self.wanted, n_passes) for column, labels in classes.items()}
        # the index of the last pass in which each target was visited; if passes are planned one after the other, this
        # is the pass of the tile that `enter` records, and no array is required
        in_turn = request.order == "color" and self.windows is None
        self._last = None if in_turn else np.zeros(len(self.wanted), dtype=np.min_scalar_type(n_passes))
        made = np.flatnonzero(self.done())
        if len(made):  # visits that were made before belong to the first pass
            self.flags[made] |= DONE
            for tally in self.tallies.values():
                complete = made[(self.left[made] == 0) & (self.wanted[made] > 0)]
                tally.add(0, np.repeat(made, self.counted()[made]), complete, 0)

    def open_job(self, request, tile: int):
        """Return the job of a tile with the targets whose windows are open; the first to close have precedence."""
        job = request.job(tile, self.left)
        slot = job.field.slot
        if request.options.subpriority == FEWEST_FIRST and not request.is_planned:
            job = _with_subpriority(job, -self.left[slot].astype(float))
        if self.windows is None:
            return job
        is_closed = ~self.windows.state(slot, tile)[0] & self.spends[slot]
        closed = slot[is_closed]
        if ((self.flags[closed] & REACHED) == 0).any():  # these targets are in the field, although no visit is possible
            reach = reach_of(job)
            self.flags[closed] |= flags_of(reach.pairs.covered, reach.applied.excluded)[is_closed]
        job = job_without(request, tile, self.left, closed)
        if request.is_planned:
            return job
        closing = self.windows.state(job.field.slot, tile)[1]
        order = np.unique(closing, return_inverse=True)[1].reshape(-1)
        return _with_subpriority(job, -order.astype(float))

    def enter(self, tile: int, job: Job, done: Done) -> None:
        """Record the visits of the tile in row ``tile``."""
        field, number, is_target = job.field, self._number[tile], done.target >= 0
        self.flags[field.slot] |= done.flags
        slot, observed = field.slot[done.target[is_target]], done.observed[is_target]
        self.flags[slot[~observed]] |= LOST_IN_COLLISION
        slot = slot[observed]
        self.flags[slot] |= DONE
        slot = self._builder.spending(slot)
        if self._builder.lasting is not None:
            # without remaining visits, these targets are only standards or sky positions
            science = has_role(field.targets.columns.kind, "science")
            slot = slot[np.isin(slot, field.slot[science])]
        slot = self.spend(slot, tile)
        complete = np.unique(slot[self.left[slot] == 0])
        last = number
        if self._last is not None:
            self._last[slot] = np.maximum(self._last[slot], number)
            last = self._last[complete]
        for tally in self.tallies.values():
            tally.add(number, slot, complete, last)
        self.n_observed[tile] = len(slot)

    def done(self) -> np.ndarray:
        """Return the number of successful visits to each target; 0 for standards and sky positions."""
        surplus = self._builder.surplus
        return self.counted() if surplus is None else self.counted() + surplus

    def counted(self) -> np.ndarray:
        """Return the number of successful visits to each target, at most the number of requested visits."""
        return np.where(self.spends, self.wanted - self.left, np.uint8(0))

    def outcomes(self) -> np.ndarray:
        """Return the outcome of each target as an index of ``OUTCOMES``."""
        done = self.done()
        code = _outcomes_by_flags(self.flags)
        code[done > 0] = Outcome.PARTLY_OBSERVED
        code[done >= self.wanted] = Outcome.OBSERVED
        code[(self.wanted == 0) & (done == 0)] = Outcome.NOT_REQUESTED
        return code

    def never_observed(self, slot: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the targets in ``slot`` that were never observed, and the outcomes of these targets."""
        slot = slot[(self.flags[slot] & DONE) == 0]
        return slot, _outcomes_by_flags(self.flags[slot])


def _outcomes_by_flags(flags: np.ndarray) -> np.ndarray:
    """Return the outcome that each target has if it was never observed."""
    code = np.full(len(flags), Outcome.IN_NO_FIELD, dtype=np.uint8)
    code[(flags & SEEN) > 0] = Outcome.OUT_OF_REACH
    code[(flags & EXCLUDED) > 0] = Outcome.EXCLUDED_BY_A_CONSTRAINT
    code[(flags & REACHED) > 0] = Outcome.IN_REACH_NOT_ASSIGNED
    code[(flags & LOST_IN_COLLISION) > 0] = Outcome.LOST_TO_A_COLLISION
    return code


def _with_subpriority(job: Job, subpriority: np.ndarray) -> Job:
    """Return a job whose targets have other subpriorities."""
    targets = job.field.targets
    columns = targets.columns._replace(subpriority=subpriority)
    return job._replace(field=job.field._replace(targets=targets._replace(columns=columns)))
