"""Options of joint plans, and tiles that were already observed; their plans are taken from another survey."""

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

from rfpsurvey._assignment.methods import METHODS
from rfpsurvey._assignment.options import AllocationOptions, as_options
from rfpsurvey._assignment.weighted import TileCandidates, no_rules
from rfpsurvey._common.settings import Settings, not_invertible, option
from rfpsurvey._common.units import to_vectors
from rfpsurvey._field.constraints import project_field
from rfpsurvey._field.plan import FieldTargets
from rfpsurvey._field.targets import FieldBuilder
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._sky.arrays import SkyIndex, has_role
from rfpsurvey._sky.time import to_time
from rfpsurvey._survey.joint.values import to_objective, weights_in
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.columns import places_of_tiles, when_of
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey._survey.work import projection_of
from rfpsurvey.errors import InputError, check_keywords, short, warn_no_effect

ONLY_DIGEST = not_invertible("fixed must be given as an argument of from_record, because records contain only a digest")
JOINT = "joint"
"""Name of the allocator that stands for a joint plan with default options."""


def _check_first(allocator: AllocationOptions | str) -> AllocationOptions | str:
    """Return an allocator; raise an error if its options do not allow a joint plan."""
    options = as_options(allocator)
    if not options.method.plans_jointly:
        names = " or ".join(repr(name) for name, method in METHODS.items() if method.plans_jointly)
        raise InputError(f"a joint plan needs the allocator {names}, got {options.name!r}")
    if options.objective != "priority":
        raise InputError(f"a joint plan needs the objective 'priority', got {options.objective!r}")
    return allocator


@check_keywords
@dataclass(frozen=True, eq=False, repr=False)
class JointOptions(Settings):
    """Options of a joint plan, in which all tiles of a survey are planned together; the allocator of `plan_survey`.

    The tiles are first planned one after the other, and then together, such that the number of visits increases. If the
    targets have cadences (`~rfpsurvey.survey.Cadences`), the number of complete cadences increases first. The search
    ends when the gap is small enough, after the given number of iterations, or at the time limit.

    Parameters
    ----------
    gap : float, optional
        The search ends when, for every priority, the relative difference between the number of visits and its upper
        bound is at most this value. The visits of a priority are all visits to targets with at least this priority. If
        the targets have cadences, the numbers of complete cadences are compared instead, and the number of visits must
        be equal to its bound. With the objective ``finished``, the numbers of finished targets are compared.
    iterations : int, optional
        Largest number of iterations. If this number is 0, visits are only moved between tiles along augmenting paths,
        and the first bounds are computed.
    time_limit : Quantity, optional
        Time after which the search ends. The preceding step, in which the tiles are planned one after the other, is
        not included in this time. By default, the time is not limited. A plan whose search ends at the time limit may
        not be reproducible.
    fixed : Survey, str or path-like, optional
        An earlier survey, or its folder, whose tiles were already observed. Each of its tiles must have the same center
        and position angle as a tile of the new survey, which keeps the earlier plan. If several tiles have this center
        and position angle, the tile with the same identifier is used. Both surveys must have the same instrument,
        epoch, observing conditions, ``keep_out`` and ``lost_in_collision``, and the catalog must contain the targets of
        the earlier survey in the same rows. Positioners with the handedness ``both`` are not supported.
    inform : callable, optional
        Function that is called once before the first iteration, with a dict: ``visits_before`` is the number of visits
        of the tiles planned one after the other, ``visits`` is the number of visits after the search for augmenting
        paths, and ``bound`` is the upper bound so far. Each value is a list with one number for each priority; the
        number for a priority includes the visits to targets of all higher priorities.
    patch_size : int, optional
        The search solves an integer program for each patch of the sky. This parameter is the initial number of pairs of
        a positioner and a target in one patch, 10 to 100000. The search increases this number when the plan and the
        bounds hardly improve. Larger patches give better plans and bounds, but take longer.
    allocator : AllocationOptions or str, optional
        The allocator of the first plan, which must be ``optimal``, or options with this allocator. If they contain
        requirements, required targets or other constraints, the joint plan meets all of them that the first plan meets.
    early : bool, optional
        Whether visits are moved to earlier passes. Plans with the same numbers of visits, and with the same sum of the
        subpriorities if there are any, are compared. This option has no effect with cadences.
    objective : str or Table, optional
        What is maximized, one priority after the other: ``visits`` (the number of visits), ``finished`` (the number of
        targets with all requested visits), or the sum of values of the targets: a table with the columns ``visits``,
        ``value`` and optionally ``category``, or text such as ``"1=0.2 3=1"`` or ``"main:3=1 guest:1=0.5"``. A target
        has the value of the largest of these numbers that its visits reach, otherwise 0. Visits that were already made
        count. Cadences are always completed first.
    share : str, optional
        Only with the objective ``finished``: ``category``, or weights such as ``"main=2 guest=1"``. The smallest
        finished fraction of the categories of the catalog, divided by its weight (1 by default), is maximized first,
        then the next one. Priorities count after these fractions.

    Raises
    ------
    InputError
        If a number is out of range, if ``share`` or ``objective`` is not valid, or if ``share`` is given with another
        objective.

    Notes
    -----
    The attribute ``record`` contains a digest of ``fixed``, and neither ``inform`` nor ``allocator``. Therefore,
    ``from_record`` also needs ``allocator`` and ``fixed`` as arguments if they do not have their default values.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> rs.JointOptions(gap=0.001, time_limit=30 * u.min).seconds
    1800.0
    """

    gap: float = option(0.0, low=0, below=1)
    iterations: int = option(10, low=0, high=100_000)
    time_limit: u.Quantity[u.s] | None = option(None, above=0)
    fixed: Survey | str | os.PathLike | None = option(
        None, words="a Survey or the path of its folder", to_record="_fixed_digest", from_record=ONLY_DIGEST
    )
    inform: Callable | None = option(None, words="a function", record=None, compare=False)
    patch_size: int = option(800, low=10, high=100_000)
    allocator: AllocationOptions | str = option("optimal", convert=_check_first, record=None)
    early: bool = option(False, sparse=True)
    objective: str | Table = option("visits", convert=to_objective, sparse=True)
    share: str | None = option(None, words="'category' or weights of categories", sparse=True)

    def _check(self):
        if self.share is not None:
            weights_in(self.share)
            if self.objective != "finished":
                raise InputError(f"share can be given only with the objective 'finished', got {self.objective!r}")

    @property
    def seconds(self) -> float:
        """The time limit in seconds; infinity if the time is not limited."""
        return float("inf") if self.time_limit is None else float(self.time_limit.to_value(u.s))

    @cached_property
    def _fixed_digest(self) -> str | None:
        """A digest of the visits of the fixed tiles; a plan can only be continued with the same fixed tiles."""
        if self.fixed is None:
            return None
        survey = self.fixed if isinstance(self.fixed, Survey) else Survey.read(self.fixed)
        total = hashlib.sha256()
        for name, visits in zip(np.asarray(survey.tiles["tile"]).tolist(), survey, strict=True):
            columns = [np.asarray(visits[column]).tolist() for column in ("target_row", "positioner", "observed")]
            total.update(repr((name, columns)).encode())
        return total.hexdigest()


def check_for_cadences(joint: JointOptions) -> None:
    """Raise an error, or issue a warning, if an option does not apply to targets with cadences."""
    if joint.fixed is not None:
        raise InputError("fixed must not be given for a joint plan with cadences")
    if joint.early:
        warn_no_effect("early", "with cadences")


def as_joint(allocator: object, order: object) -> tuple[AllocationOptions, JointOptions | None]:
    """Return the options of the tiles, and the options of the joint plan, if one is requested."""
    if isinstance(allocator, str) and allocator == JOINT:
        allocator = JointOptions()
    if not isinstance(allocator, JointOptions):
        return as_options(allocator), None
    if not (isinstance(order, str) and order == "color"):
        raise InputError(f"the order must be 'color' for a joint plan, got {short(order)}")
    return as_options(allocator.allocator), allocator


# Options that determine where the arms of a tile are, and whether a visit counts.
SAME = ("epoch", "lost_in_collision", "keep_out", "constraints", "conditions")
# Largest difference (degrees) between the centers, position angles and targets of two equal tiles: about 1 mas.
TOLERANCE = 3e-7


class TilePlan(NamedTuple):
    """The plan of a tile."""

    slot: np.ndarray
    """Slot of the target of each positioner (see `Bookkeeping`); -1 if the positioner has no target.

    The number of all slots is added for a science target that the tile observes only in its other roles (see
    `FieldBuilder`), without using one of its visits. The slot of the blank sky position with the index k is -2 - k.
    These positions do not depend on which targets have remaining visits.
    """
    side: np.ndarray
    """Handedness of each positioner: +1 is right, -1 is left."""
    counted: np.ndarray | None = None
    """Whether the visit of each positioner of an observed tile counts as an observation; None for other tiles."""
    blank_mm: np.ndarray | None = None
    """Position of the blank sky that each positioner of an observed tile observes, in mm; NaN if it observes none."""

    def spent(self, builder: FieldBuilder) -> np.ndarray:
        """Return the slots of the targets of which an observed tile uses a visit."""
        return builder.spending(self.slot[self.counted & (self.slot < len(builder.left))])


def fixed_tiles(request) -> dict[int, TilePlan]:
    """Return the plans that do not change, as a dict from the row of a tile to its plan.

    These are the plans of the tiles that the option ``fixed`` contains. In a survey with recorded events, tiles that
    were partly observed keep their plans, and observed and dropped tiles observe no further targets.

    Raises
    ------
    InputError
        If the fixed survey has another instrument, other targets, another epoch, or other observing conditions, if it
        contains a tile that is not in the tiling, if it contains more visits of a target than requested, or if its
        positioners have the handedness ``both``.
    """
    given = request.joint.fixed
    if request.state is not None:
        if given is not None:
            raise InputError(
                "fixed must not be given for a survey with recorded events, which keeps its observed tiles"
            )
        return _recorded_tiles(request)
    if given is None:
        return {}
    survey = given if isinstance(given, Survey) else Survey.read(given)
    plane = request.instrument.focal_plane
    _check_request(request, survey)
    left = request.builder.left.astype(np.int64)
    requested, every = left > 0, np.ones(len(left), dtype=np.uint8)
    plans = {}
    names = np.asarray(survey.tiles["tile"]).tolist()
    for name, tile, visits in zip(names, _counterparts(request.tiling, survey.tiles), survey, strict=True):
        visits, blank = (visits[(np.asarray(visits["target_row"]) >= 0) == is_target] for is_target in (True, False))
        job = request.job(tile, every)
        field = job.field
        index = _targets_of(visits, field)
        if index is None:
            raise InputError(
                f"fixed must be a survey of the targets of this catalog, got other targets or positions in tile {name}"
            )
        slot = with_roles(request.builder, field.slot[index], visits)
        plan = _plan_of(plane, visits["positioner"], slot, visits["observed"])
        left[plan.spent(request.builder)] -= 1
        bad = np.flatnonzero((left[field.slot[index]] < 0) | ~requested[field.slot[index]])
        if len(bad):
            raise InputError(
                "fixed must not have more visits of a target than requested, got too many visits of target "
                f"{field.targets.id[index[bad[0]]]}"
            )
        blank_mm = np.full((len(plane), 2), np.nan)
        if len(blank):
            types = np.asarray(blank["fiber_type"]).astype(str) if "fiber_type" in blank.colnames else None
            vectors = to_vectors(SkyCoord(blank["ra"], blank["dec"]))
            places = project_field(job.model.instrument, projection_of(job), vectors, types)[0]
            blank_mm[_rows_of(plane, blank["positioner"])] = places
        plans[tile] = plan._replace(blank_mm=blank_mm)
    return plans


def _recorded_tiles(request) -> dict[int, TilePlan]:
    """Return the plans of the tiles that were observed, partly observed or dropped."""
    plane, state = request.instrument.focal_plane, request.state
    if state.begun and plane.positioner.handedness == "both":
        raise InputError(
            "a joint plan of a survey with partly observed tiles needs positioners of one handedness, because a survey "
            "does not record to which side an arm bends"
        )
    every, before = np.ones(len(request.builder.left), dtype=np.uint8), request.open_state()
    plans = {row: _plan_of(plane, [], [], []) for row in state.closed}
    for tile, event in state.begun.items():
        visits = state.events.visits(event)[0]
        visits = visits[visits["target_row"] >= 0]
        field = request.job(tile, every).field
        base = field.slot[np.searchsorted(field.row, visits["target_row"])]
        slot = with_roles(request.builder, base, visits)
        counted = visits["observed"].astype(bool) & (before.allows(base, tile) | (slot != base))
        plans[tile] = _plan_of(plane, visits["positioner"], slot, counted)
        before.spend(plans[tile].spent(request.builder), tile)
    return plans


def _plan_of(plane: FocalPlane, positioner, slot, counted) -> TilePlan:
    """Return the plan of an observed tile; the parameters have an element for each visit."""
    rows, side = _rows_of(plane, positioner), -1 if plane.positioner.handedness == "left" else 1
    plan = TilePlan(np.full(len(plane), -1), np.full(len(plane), side, np.int8), np.zeros(len(plane), dtype=bool))
    plan.slot[rows], plan.counted[rows] = slot, counted
    return plan


def _rows_of(plane: FocalPlane, positioner) -> np.ndarray:
    """Return the rows of the positioners with the given identifiers."""
    row_of = {name: k for k, name in enumerate(plane.id.tolist())}
    return np.array([row_of[name] for name in np.asarray(positioner).tolist()], dtype=np.int64)


def with_roles(builder: FieldBuilder, slot: np.ndarray, visits) -> np.ndarray:
    """Return slots, with the number of all slots added for targets that are visited only in other roles.

    ``visits`` is a table of visits, or the columns of targets (`FieldTargets`), with an element for each slot.
    """
    if builder.lasting is None:
        return slot
    kind = visits.columns.kind if isinstance(visits, FieldTargets) else np.asarray(visits["kind"]).astype(str)
    return np.where(builder.lasting[slot] & ~has_role(kind, "science"), slot + len(builder.left), slot)


def _check_request(request, survey: Survey) -> None:
    """Raise an error if the instrument or an option of the fixed survey does not allow the plans of its tiles."""
    if survey.provenance["instrument"].get("digest") != request.instrument.provenance["digest"]:
        name = request.instrument.name
        raise InputError(f"fixed must be a survey with the instrument {name!r}, got a survey with another instrument")
    if request.instrument.focal_plane.positioner.handedness == "both":
        raise InputError(
            "fixed needs positioners of one handedness, because a survey does not record to which side an arm bends"
        )
    now, before = request.provenance["parameters"], survey.provenance["parameters"]
    for name in SAME:
        values = [parameters.get(name) for parameters in (now, before)]
        if name == "epoch":
            # positions at the times of the tiles are compared with the positions of the visits
            if request.years is not None or " to " in str(values[1]):
                continue
            values = [value if value is None else to_time(value, "epoch").jyear for value in values]
        if values[0] != values[1]:
            raise InputError(
                f"fixed must be a survey with the {name} {short(now.get(name))}, got one with the {name} "
                f"{short(before.get(name))}; use the same {name} for both surveys"
            )


def _counterparts(tiling: Tiling, earlier: QTable) -> list[int]:
    """Return, for each tile of an earlier survey, the row of the tile with the same center and position angle.

    If several tiles have this center and position angle, a tile with the same identifier is preferred.
    """
    before = Tiling(QTable(earlier[("tile", "ra", "dec", "position_angle", "pass")], meta={}))
    names, earlier_names = (np.asarray(some_tiling.table["tile"]).astype(str) for some_tiling in (tiling, before))
    places, earlier_places, index = places_of_tiles(tiling), places_of_tiles(before), SkyIndex(tiling.vectors)
    fits, row_of_earlier, used = [], np.full(len(before), -1), set()
    for vector, place in zip(before.vectors, earlier_places, strict=True):
        near = index.order[index.near(vector, np.deg2rad(TOLERANCE))]
        turn = (places[near, 2] - place[2] + 180) % 360 - 180
        fits.append(near[np.abs(turn) <= TOLERANCE].tolist())
    for by_name in (True, False):  # first the tiles with the same identifier
        for k in np.flatnonzero(row_of_earlier < 0).tolist():
            rows = [row for row in fits[k] if row not in used and (not by_name or names[row] == earlier_names[k])]
            if rows:
                row_of_earlier[k] = rows[0]
                used.add(rows[0])
    missing = np.flatnonzero(row_of_earlier < 0)
    if len(missing):
        k = missing[0]
        same = np.flatnonzero(names == earlier_names[k])
        text = f"fixed must contain only tiles of the tiling, got tile {earlier_names[k]} at {_text(earlier_places[k])}"
        if len(same) and same[0] not in used:
            text += f", but the tile {earlier_names[k]} of the tiling is at {_text(places[same[0]])}"
        else:
            text += "; add this tile to the tiling"
        raise InputError(text + (f"; number of other tiles that are missing: {len(missing) - 1}" * (len(missing) > 1)))
    when = when_of(earlier)
    if when is not None and when in tiling.table.colnames:
        values, earlier_values = np.asarray(tiling.table[when])[row_of_earlier], np.asarray(earlier[when])
        for k in np.flatnonzero(values != earlier_values)[:1].tolist():
            raise InputError(f"fixed must have the {when} of the tiling, got another value for tile {earlier_names[k]}")
    return row_of_earlier.tolist()


def _text(place: np.ndarray) -> str:
    return "{:.6f} {:+.6f} deg, position angle {:.7g} deg".format(*place)


def _targets_of(visits: QTable, field) -> np.ndarray | None:
    """Return, for each visit, the index of its target in the field; None if a target is not there."""
    if not np.isin(visits["target_row"], field.row).all():
        return None
    index = np.searchsorted(field.row, visits["target_row"])
    if (field.targets.id[index].astype(str) != np.asarray(visits["target_id"]).astype(str)).any():
        return None
    vectors = to_vectors(SkyCoord(visits["ra"], visits["dec"]))
    apart = np.linalg.norm(vectors - field.targets.vectors[index], axis=1)
    return index if (apart <= np.deg2rad(TOLERANCE)).all() else None


def candidates_of(fixed: TilePlan, slots: np.ndarray) -> TileCandidates:
    """Return the candidates of a fixed tile, one for each positioner.

    ``slots`` lists the slots of all targets in the field of the tile. Visits that do not count as observations
    are omitted.
    """
    n, order = len(fixed.slot), np.argsort(slots, kind="stable")
    target, counted = np.full(n, -1, dtype=np.int32), np.flatnonzero(fixed.counted)
    target[counted] = order[np.searchsorted(slots[order], fixed.slot[counted])]
    cliques = np.zeros(1, dtype=np.int64), np.empty(0, dtype=np.int32)
    pairs, shortened = (counted.astype(np.int32), target[counted]), np.zeros(n, dtype=bool)
    return TileCandidates(np.arange(n + 1), target, fixed.side, *cliques, shortened, pairs, no_rules(n))
