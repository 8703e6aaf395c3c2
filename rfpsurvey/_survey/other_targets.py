"""Other targets for the fibers of the tiles of a survey: alternates, and replacements of targets that a fiber loses."""

from dataclasses import replace
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time

from rfpsurvey._assignment.rules import FEWEST_FIRST
from rfpsurvey._common.descriptions import Column, describe, table_of, with_unit
from rfpsurvey._common.units import from_lonlat, to_plain
from rfpsurvey._field.alternates import PlannedField, find_alternates
from rfpsurvey._field.plan import FieldReach, with_subpriorities
from rfpsurvey._field.tile import Tile
from rfpsurvey._instruments.arms import place_arms
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._sky.conditions import ObservingConditions
from rfpsurvey._survey.continue_survey import request_in
from rfpsurvey._survey.folder import read_visits
from rfpsurvey._survey.history.status import count_planned
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.work import Job, projection_of, reach_of
from rfpsurvey.errors import InputError

CHANGES = table_of(
    Column("tile", "identifier of the tile"),
    Column("date", "local date of the evening before the exposure"),
    Column("positioner", "identifier of the positioner"),
    Column("target", "identifier of the target in the file or, if there is none, of the planned target"),
    Column("good", "whether the positioner has a target in the file"),
    Column("swaps", "whether this target is not the planned one"),
    Column("reason", "why the positioner cannot observe its planned target at this time"),
)
"""Columns of the fibers that do not observe their planned targets, in a form that `Survey.record` reads."""
UNUSABLE, OUT_OF_REACH, COLLIDES = "cannot be used", "out of reach", "would collide"
CHOICES = 5
"""Number of alternates among which a replacement is chosen."""


class OtherTargets:
    """Targets that fibers of a survey can observe; ``given`` contains parameters that its plan file lacks."""

    def __init__(self, survey: Survey, **given: object):
        self._survey, self._given = survey, given

    @cached_property
    def _request(self):
        return request_in(self._survey.folder, **self._given)

    @cached_property
    def _state(self):
        return self._request.open_state()

    @cached_property
    def _planned(self) -> np.ndarray:
        """Number of visits of each target in the tiles that will be observed, in the order of the catalog."""
        return count_planned(self._survey, self._request.state, is_planned=False)

    def of_tile(self, row: int, n: int) -> QTable:
        """Return a table of at most n alternates of each fiber of the tile in a row, as `find_alternates` does."""
        job, visits = self._job(row), self._survey._visits(row)
        field, left, planned = self._field(job, reach_of(job), visits, ())
        table = find_alternates(field, n, left, planned)
        table.add_column(np.full(len(table), self._survey.tiles["tile"][row]), name="tile", index=0)
        return table

    def replaced(self, row: int, visits: QTable, lost: list[str], about: tuple) -> QTable:
        """Return visits in which fibers that lost their targets have other targets, as far as there are any.

        ``about`` contains the instrument and the observing conditions. The visits of fibers for which no other target
        is found are unchanged.
        """
        job = self._job(row)
        job = job._replace(model=replace(job.model, instrument=about[0]), conditions=about[1])
        reach, names = reach_of(job), visits["positioner"].astype(str).tolist()
        plane, lost, visits = reach.applied.instrument.focal_plane, [*lost], visits.copy()
        row_of = {str(positioner): k for k, positioner in enumerate(plane.id.tolist())}
        near = {frozenset(pair) for pair in plane.arrays.neighbors.tolist()}
        while lost:
            field, left, planned = self._field(job, reach, visits, lost)
            pairs = field.reach.where(np.isin(field.reach.owner, [row_of[name] for name in lost]))
            table = find_alternates(field._replace(reach=pairs), CHOICES, left, planned)
            table, moved = table[np.isin(to_plain(table["positioner"]).astype(str), lost)], []
            for choice in table:
                owner = row_of[name := str(choice["positioner"])]
                is_taken = str(choice["target_id"]) in visits["target_id"].astype(str).tolist()
                # alternates are checked alone, so that neighbors change their targets one after the other
                if name in lost and not is_taken and not any(frozenset((owner, other)) in near for other in moved):
                    _put(visits, names.index(name), choice, job)
                    lost.remove(name)
                    moved.append(owner)
            if not moved:
                break
        return visits

    def _job(self, row: int) -> Job:
        survey, request, name = self._survey, self._request, self._survey.tiles["tile"][row]
        _, cards = read_visits(survey.folder, row, survey._known, name)
        if not np.allclose([cards[axis] for axis in ("RA", "DEC", "POSANG")], request.places[row], rtol=0, atol=1e-9):
            raise InputError(f"tile {name} must have its planned position for alternates, got a tile that was moved")
        return self._state.open_job(request, row)

    def _field(self, job: Job, reach: FieldReach, visits: QTable, resting: tuple | list) -> tuple:
        """Return the field of a tile, and the remaining and the planned visits of its targets.

        The arms of the positioners ``resting`` are parked. No other positioner can observe their planned targets.
        """
        request, options, has_types = self._request, self._request.options, "fiber_type" in visits.colnames
        plane = reach.applied.instrument.focal_plane
        row_of = {str(positioner): k for k, positioner in enumerate(plane.id.tolist())}
        names = visits["positioner"].astype(str).tolist()
        owner = np.array([row_of[name] for name in names])
        vectors = from_lonlat(*(np.deg2rad(to_plain(visits[axis])) for axis in ("ra", "dec")))
        tips, types = np.full((len(plane), 2), np.nan), None
        tips[owner] = projection_of(job).project(vectors, visits["fiber_type"] if has_types else None)
        tips[owner[np.isin(names, resting)]] = np.nan
        tips[~plane.arrays.usable] = np.nan
        if has_types:
            types = plane.arrays.first_type.astype(np.promote_types(visits["fiber_type"].dtype, "U1"))
            types[owner] = visits["fiber_type"]
        parked = options.parked_obstacles
        arms = place_arms(plane, tips * u.mm, fiber_type=types, parked_obstacles=parked, clip=True)
        targets = job.field.targets._replace(columns=job.field.targets.columns._replace(kind=reach.applied.kind))
        if options.subpriority == FEWEST_FIRST:  # here, the most remaining visits come first
            targets = targets._replace(columns=targets.columns._replace(subpriority=None))
        else:
            targets = with_subpriorities(targets, options)
        catalog_row, kind = job.field.row, targets.columns.kind
        pairs = reach.allowed.where(~np.isin(catalog_row, visits["target_row"])[reach.allowed.target])
        planned = self._planned[catalog_row].astype(int)
        left = np.maximum(request.builder.left[job.field.slot] - planned, 0)
        if kind is not None:  # standards and sky positions can be observed any number of times
            left = np.where(has_role(kind, "science"), left, 1)
        roles = visits["kind"] if "kind" in visits.colnames else np.full(len(visits), "science")
        about = targets, reach.xy, reach.fiber_type, pairs, owner, visits["target_id"], roles, vectors
        return PlannedField(plane, arms, options.motion_law, parked, *about), left, planned


def _put(visits: QTable, k: int, choice, job: Job) -> None:
    """Put an alternate into a row of visits."""
    targets = job.field.targets
    index = int(np.flatnonzero(targets.id == choice["target_id"])[0])
    columns = {name: values for name, values in targets.columns._asdict().items() if values is not None}
    columns |= {"target_row": job.field.row, **(targets.extra or {})}
    values = {name: columns[name][index] for name in visits.colnames if name in columns}
    values |= {name: choice[name] for name in choice.colnames if name in visits.colnames and name != "tile"}
    for name, value in values.items():
        column, value = visits[name], getattr(value, "value", value)
        plain = to_plain(column)
        if plain.dtype.kind == "U":  # longer text would be cut
            plain = plain.astype(np.promote_types(plain.dtype, np.asarray(value).dtype))
        plain[k] = value
        visits[name] = with_unit(plain, getattr(column, "unit", None))


def tile_at_time(planned, others: OtherTargets, row: int, time: Time) -> tuple[Tile, list[tuple]]:
    """Return a tile at a time other than the planned one, and a row of `CHANGES` for each fiber with another target.

    Fibers whose targets are out of reach at this time, and of each two arms that collide only at this time the one with
    the less important target, receive other targets, or none if there are none.
    """
    before, (visits, cards, entry) = planned.tile(row), planned.plan_of(row)
    conditions = replace(planned.conditions[row], time=time, hour_angle=None, date=None)
    about, lost, current, kept = (planned.instrument_at(time.utc.isot), conditions), {}, visits, None
    while True:
        scored = planned.scored(current, cards, entry, *about)
        if more := _lost(scored, before, current):
            lost |= more
            current = current[~np.isin(current["positioner"].astype(str), [*more])]
            if len(current) == 0:
                raise InputError(f"tile {entry['tile']} has no target that a fiber can observe at {time.utc.isot[:19]}")
        elif lost and kept is None:  # after the replacement, no further targets are tried
            kept = others.replaced(row, visits, [*lost], about)
            names, is_other = kept["positioner"].astype(str), kept["target_id"] != visits["target_id"]
            current = kept[np.isin(names, current["positioner"].astype(str)) | is_other]
        else:
            break
    tile, day = planned.completed(scored, current, entry, cards), np.floor(time.utc.mjd + _turn(conditions) - 0.5)
    date, used = Time(day, format="mjd").isot[:10], dict(zip(current["positioner"], current["target_id"], strict=True))
    changes = []
    for name, target in zip(visits["positioner"].tolist(), visits["target_id"].tolist(), strict=True):
        if str(name) in lost:
            other = used.get(name)
            has_other = other is not None
            values = other if has_other else target, has_other, has_other, lost[str(name)]
            changes.append((planned.survey.tiles["tile"][row], date, str(name), *map(str, values[:1]), *values[1:]))
    return tile, changes


def table_of_changes(rows: list[tuple]) -> QTable:
    """Return the table of the fibers that do not observe their planned targets."""
    return describe(QTable(rows=rows, names=[*CHANGES]), CHANGES)


def _turn(conditions: ObservingConditions) -> float:
    """Return the east longitude of the site as a fraction of a turn, from -0.5 to 0.5."""
    return (conditions.site.lon.deg + 180) % 360 / 360 - 0.5


def _lost(scored: Tile, before: Tile, visits: QTable) -> dict[str, str]:
    """Return the positioners that must not have their targets, with the reasons."""
    table, row_of = scored.table, {str(name): k for k, name in enumerate(scored.table["id"].tolist())}
    names, was = visits["positioner"].astype(str).tolist(), before.table
    owner = np.array([row_of[name] for name in names])
    gone = (table["status"] != "assigned") & (was["status"] == "assigned")
    if gone[owner].any():
        is_out = table["status"] == "out_of_reach"
        return {
            name: OUT_OF_REACH if is_out[k] else UNUSABLE
            for name, k in zip(names, owner.tolist(), strict=True)
            if gone[k]
        }
    collides = to_plain(table["in_collision"]) & ~to_plain(was["in_collision"])
    rank = np.zeros(len(visits)) if "priority" not in visits.colnames else to_plain(visits["priority"])
    is_role = np.zeros(len(visits)) if "kind" not in visits.colnames else to_plain(visits["kind"]) != "science"
    lost = {}
    for k in np.lexsort((rank, is_role)).tolist():
        others = str(table["colliding_with"][owner[k]]).split()
        if collides[owner[k]] and not {*others} <= {*lost}:
            lost[names[k]] = COLLIDES
    return lost
