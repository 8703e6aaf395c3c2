"""The function `work`, which plans one tile from the data of a `Job`, and the loop over the rounds of tiles.

Surveys, joint plans and selection probabilities share the loop.
"""

import hashlib
import pickle
from collections.abc import Callable, Collection, Iterable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple

import astropy.units as u
import numpy as np

from rfpsurvey._assignment.constraints.motion import PATHS
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._common.descriptions import COPIED, Column, table_of, text_of
from rfpsurvey._common.executors import IN_FLIGHT, in_order
from rfpsurvey._common.io import fits_bytes, table_cards, write_new_file
from rfpsurvey._field.constraints import early_violations
from rfpsurvey._field.plan import BlankIds, FieldPlan, FieldReach, find_reach, plan_field
from rfpsurvey._field.table import TARGET_COLUMNS, TARGET_ID, TILE_COLUMNS
from rfpsurvey._field.targets import FieldRows
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._sky.arrays import KINDS, count_also_science, has_role
from rfpsurvey._sky.conditions import ObservingConditions
from rfpsurvey._survey.columns import (
    ALSO_SCIENCE,
    COUNTS,
    LOST,
    LOST_TO_RULES,
    MOST_TILES,
    MOTION,
    VIOLATED,
    CountOfRule,
    shortfall_cards,
    shortfall_counts,
)
from rfpsurvey.errors import listed, number_of

SEEN, REACHED, LOST_IN_COLLISION, DONE, EXCLUDED = 1, 2, 4, 8, 16
"""Flags that record in which fields and in reach of which positioners a target of a survey was."""
TIME, FASTEST = "TILETIME", "FASTEST"
"""Header cards of the time of a tile, and of the largest proper motion of its planned targets (mas/yr)."""
VISITS_COLUMNS = table_of(
    TARGET_ID,
    Column("target_row", "row in the catalog, -1 for blank sky"),
    Column("positioner", "identifier of the positioner"),
    Column("in_collision", TILE_COLUMNS["in_collision"].text),
    Column("observed", "whether the visit counts as an observation"),
    TILE_COLUMNS["fiber_type"],
    *TARGET_COLUMNS,
)
"""Columns of the visits of a tile of a survey."""
VISITS_UNITS = {name: column.unit for name, column in VISITS_COLUMNS.items() if column.unit}


@dataclass(frozen=True, eq=False)
class Model:
    """The data that all tiles of a survey share; each worker process unpacks these data only once."""

    instrument: Instrument
    options: AllocationOptions
    blank: BlankIds | None
    lost_in_collision: bool
    units: dict

    @cached_property
    def _packed(self) -> bytes:
        return pickle.dumps([getattr(self, field_of_model.name) for field_of_model in fields(self)], protocol=5)

    def __reduce__(self):
        return _unpack, (self._packed,)

    def cards(self, columns: tuple[str, ...]) -> tuple:
        """Return the FITS header cards that are the same in the files of all tiles."""
        about = {name: text_of(VISITS_COLUMNS, name, COPIED) for name in columns}
        cards = table_cards("VISITS", columns, about, VISITS_UNITS | self.units)
        cards["RADESYS"] = ("ICRS", "frame of right ascensions and declinations")
        return tuple(cards.items())


@lru_cache(maxsize=4)  # the jobs of a worker share one object
def _unpack(packed: bytes) -> Model:
    return Model(*pickle.loads(packed))


class Job(NamedTuple):
    """All data that are required to plan one tile."""

    model: Model
    tile: int | str
    ra_deg: float
    dec_deg: float
    position_angle_deg: float
    field: FieldRows
    seed: np.random.SeedSequence
    conditions: ObservingConditions | None = None
    epoch: str | None = None
    """Epoch of the positions of the targets; None if the targets were not moved."""
    time: str | None = None
    """Time of the tile (UTC); None if neither positions nor states of positioners depend on it."""
    speed: np.ndarray | None = None
    """Proper motions of the targets in radians per year; None if they are not moved to the time of the tile."""
    as_file: bool = False
    """Whether the visits are returned as the content of a FITS file instead of an array."""
    path: Path | None = None
    """Path to which `work` writes this file; None if the file is not written."""
    generations: tuple[int, tuple[int, str] | None] = (1, None)
    """The generation of the plan, and the generation and the checksum of the plan of the tile that it replaces."""

    def bare(self) -> "Job":
        """Return the job without the slots of targets, which workers do not require."""
        return self._replace(field=self.field._replace(slot=None))


class Done(NamedTuple):
    """The result of planning a tile."""

    part: bytes | tuple[int, str] | None
    """The content of a FITS file with the visits of the tile; if `work` wrote this file, its size and checksum.

    The value is None if no file is requested.
    """
    visits: np.ndarray | None
    """The visits of the tile as an array; None if a file is requested."""
    target: np.ndarray
    """For each visit, the index of its target among the targets of the field; -1 for blank sky."""
    observed: np.ndarray
    flags: np.ndarray
    """The flags of the targets of the field (see `flags_of`)."""
    counts: dict


def work(job: Job) -> Done:
    """Plan the tile of a job, and return the result."""
    model, field = job.model, job.field
    instrument, plan = model.instrument, plan_of(job)
    colliding = plan.report.in_collision[plan.positioner]
    columns = {
        "target_id": plan.id,
        "target_row": np.append(field.row, -1)[plan.target],
        "positioner": instrument.focal_plane.id[plan.positioner],
        "ra": np.rad2deg(plan.lon_rad),
        "dec": np.rad2deg(plan.lat_rad),
        "in_collision": colliding,
        "observed": ~colliding if model.lost_in_collision else np.ones(len(colliding), dtype=bool),
    }
    if model.blank is not None:  # the identifiers must have the same data type in every tile
        columns["target_id"] = plan.id.astype(model.blank.dtype)
    if instrument.focal_plane.fiber_types != ("",):
        columns["fiber_type"] = plan.allocation.fiber_type[plan.positioner]
    of_kind = {"science": len(plan.target)}
    if field.targets.columns.kind is not None or model.blank is not None:
        columns["kind"] = plan.kind
        of_kind = {kind: int(has_role(plan.kind, kind).sum()) for kind in KINDS}
    columns.update(plan.carried)
    report = plan.report
    n_both = count_also_science(plan.kind, [requirement.what for requirement in model.options.counts])
    counts = {
        "n_in_field": len(field.row),
        "n_reachable": plan.allocation.n_reachable,
        "n_assigned": int(plan.arms.assigned.sum()),
        **{f"n_{kind}": of_kind.get(kind, 0) for kind in KINDS},
        "n_colliding_assigned": int((report.in_collision & plan.arms.assigned).sum()),
        "n_colliding": int((report.in_collision & report.counted).sum()),
        "n_counted": int(report.counted.sum()),
        "n_colliding_pairs": len(report.pairs),
        "n_obstacle_collisions": len(report.obstacle_pairs),
        **({} if report.motion is None else report.motion.counts),
        **({LOST: max(plan.allocation.meta[LOST], 0)} if LOST in plan.allocation.meta else {}),
        **({ALSO_SCIENCE.name: n_both} if n_both else {}),
        "n_unmet": len(plan.allocation.unmet),
        **shortfall_counts(plan, model.options),
    }
    counts["n_unmet"] += sum(
        n > 0 for name, n in counts.items() if isinstance(name, CountOfRule) and name.word == VIOLATED
    )
    plan_id = plan_digest(job.tile, columns["positioner"], columns["target_id"])
    cards = {"TILE": job.tile, "PLANID": (plan_id, "digest of the targets of all positioners")}
    cards |= {"RA": job.ra_deg, "DEC": job.dec_deg, "POSANG": job.position_angle_deg}
    if job.epoch is not None:
        cards["REFEPOCH"] = (job.epoch, "epoch of the target positions")
    if job.time is not None:
        cards[TIME] = (job.time, "time of the tile (UTC)")
    if job.speed is not None:
        fastest = float(job.speed[plan.target[plan.target >= 0]].max(initial=0.0)) * (u.rad / u.yr).to(u.mas / u.yr)
        cards[FASTEST] = (fastest, "largest proper motion of a target (mas/yr)")
    cards.update(
        (card, (counts[name], words)) for card, (name, words) in cards_of(model.options).items() if name in counts
    )
    part = visits = None
    if job.as_file:
        now, former = job.generations
        # a plan that does not change keeps the generation that introduced it
        for number, checksum in ([] if former is None else [former]) + [(now, None)]:
            cards["GENER"] = number, "generation that introduced this plan"
            part = fits_bytes(columns, cards, model.cards(tuple(columns)))
            if checksum == hashlib.sha256(part).hexdigest():
                break
        part = part if job.path is None else write_new_file(job.path, part)
    else:
        visits = np.rec.fromarrays(list(columns.values()), names=list(columns))
    flags = flags_of(plan.allocation.in_reach, plan.allocation.excluded)
    return Done(part, visits, plan.target, columns["observed"], flags, counts)


def plan_digest(tile: int | str, positioner: np.ndarray, target_id: np.ndarray) -> str:
    """Return 16 hexadecimal digits that identify the targets of all positioners of a tile."""
    text = "\0".join(map(str, [tile, *positioner.tolist(), *target_id.tolist()]))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def cards_of(options: AllocationOptions) -> dict[str, tuple[str | CountOfRule, str]]:
    """Return the header cards of the counts of a tile, with the name of the count and the comment of each card."""
    counts = [*COUNTS, *(MOTION[-1:] if options.motion_law == PATHS else MOTION[:-1] if options.motion_law else ())]
    counts += [LOST_TO_RULES] if options.distributions else []
    counts += [ALSO_SCIENCE] if options.counts else []
    cards = {count.card: (count.name, count.comment or count.text.removeprefix("number of ")) for count in counts}
    return cards | shortfall_cards(options)


def flags_of(in_reach: np.ndarray, excluded: np.ndarray | None) -> np.ndarray:
    """Return the flags of the targets of a field.

    ``in_reach`` states whether a positioner reaches each target, and ``excluded`` whether constraints exclude it (None
    if they exclude no target).
    """
    flags = np.where(in_reach, SEEN | REACHED, SEEN).astype(np.uint8)
    if excluded is not None:
        flags[in_reach & excluded] = SEEN | EXCLUDED
    return flags


def plan_of(job: Job) -> FieldPlan:
    """Return the plan of the field of a job."""
    model, rng = job.model, np.random.default_rng(job.seed)
    return plan_field(model.instrument, projection_of(job), job.field.targets, model.options, rng, model.blank)


def reach_of(job: Job) -> FieldReach:
    """Return the pairs of a positioner and a target of the field in its reach."""
    return find_reach(job.model.instrument, projection_of(job), job.field.targets, job.model.options)


def projection_of(job: Job):
    """Return the projection from the sky to the focal plane for the tile of a job."""
    place = np.deg2rad([job.ra_deg, job.dec_deg, job.position_angle_deg])
    return job.model.instrument.field_projection(*place, job.conditions)


def early_sentences(request) -> list[str]:
    """Return a sentence for each constraint that tiles to be planned violate whichever targets they observe."""
    texts_of_constraints, n, state = {}, len(request.tiling), request.state
    early = any(constraint.before_fibers for constraint in request.options.constraints)
    known = () if state is None else {*state.closed, *state.begun}
    for tile in range(n) if early else ():
        if tile not in known:
            job = request.job(tile, request.builder.left)
            model = job.model
            texts = early_violations(model.instrument, projection_of(job), model.options, job.field.targets)
            for name, sentences in texts.items():
                texts_of_constraints.setdefault(name, []).extend((job.tile, text) for text in sentences)
    return [
        f"{len(rows)} of {number_of(n, 'tile')} ({listed([tile for tile, _ in rows], MOST_TILES)}) cannot meet a "
        f"constraint, whichever targets they observe; tile {rows[0][0]}: {rows[0][1]}"
        for rows in texts_of_constraints.values()
        if rows
    ]


# A task of an executor plans up to 8 tiles of a large round, because starting a task takes as long as planning a tile
# by a simple rule. In rounds with fewer than 16 times as many tiles, or if fewer than 32 times as many tiles may wait,
# tasks are smaller, so that all workers have tasks.
SHARE = 16


def run_rounds(
    rounds: Iterable[np.ndarray],
    executor: Executor | None,
    function: Callable,
    open_job: Callable,
    enter: Callable = lambda *_: None,
    *,
    argument: Callable = lambda _, job: (job.bare(), None),
    known: Collection[int] = (),
    most: int = IN_FLIGHT,
) -> Iterator[tuple]:
    """Plan the tiles of all rounds; yield the row, the job and the result of each tile, and whether it is new.

    The tiles of a round share no targets. For the row of a tile, ``open_job`` makes the job from the state of the
    survey. For the row and the job, ``argument`` returns the argument of ``function``, which workers call, and the
    result if it is already known. ``enter`` records the row, the job and the result in the state. The tiles in
    ``known`` are omitted, and at most about ``most`` tiles wait for workers (see `in_order`).
    """
    for tiles in rounds:
        tiles = tiles[~np.isin(tiles, [*known])].tolist()
        together = max(min(len(tiles), most // 2) // SHARE, 1)
        jobs = map(open_job, tiles)
        given = ((job, *argument(tile, job)) for tile, job in zip(tiles, jobs, strict=True))
        for tile, (job, done, is_new) in zip(tiles, in_order(executor, function, given, most, together), strict=True):
            enter(tile, job, done)
            yield tile, job, done, is_new
