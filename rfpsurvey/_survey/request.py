"""The validated request of a survey, that is, its input and its options, and the order of the tiles.

The tiles that can be planned at the same time form a *round*.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.time import Time

from rfpsurvey._assignment.constraints.rule import Rule
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._assignment.plugin import packages
from rfpsurvey._common.io import check_fits_text
from rfpsurvey._common.units import to_dimensionless
from rfpsurvey._field.facts import versions
from rfpsurvey._field.targets import FieldBuilder
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._instruments.states import instruments_at, is_dated
from rfpsurvey._kernels import sky as zones
from rfpsurvey._sky.arrays import SkyIndex, half_chord_squared
from rfpsurvey._sky.time import any_year, epoch_text
from rfpsurvey._survey.bookkeeping import Bookkeeping
from rfpsurvey._survey.cadences import brightness_of, days_of
from rfpsurvey._survey.folder import number_in
from rfpsurvey._survey.history.dated import dates_record, times_of
from rfpsurvey._survey.history.limits import slots_closed_to
from rfpsurvey._survey.history.state import SurveyState
from rfpsurvey._survey.source import column_digests, digest, digest_of, extra_digest
from rfpsurvey._survey.tiling.columns import FieldsOfTiles, conditions_of_tiles, times_of_tiles
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey._survey.work import Job, Model
from rfpsurvey.errors import InputError, number_of, warn

ORDERS = ("color", "given")


def make_rounds(vectors: np.ndarray, reach_rad: float, passes: np.ndarray, order: str) -> list[np.ndarray]:
    """Return, for each round, the rows of its tiles.

    The centers of two tiles of the same round are at least ``reach_rad`` apart. If the order is ``color``, the tiles of
    each pass are numbered such that tiles with the same number do not overlap, and each number is as small as possible.
    All tiles of a pass with the same number are planned in the same round. If the order is ``given``, the number of a
    tile, which is its round, is larger than the numbers of all overlapping tiles that are earlier in the list.
    """
    if len(vectors) == 0:
        return []
    index, by_color, round_of = SkyIndex(vectors), order == "color", np.empty(len(vectors), dtype=np.int64)
    circles = index.vectors, index.key, index.n_zones, index.order.astype(np.int64)
    limits, group = (reach_rad, half_chord_squared(reach_rad)), np.asarray(passes, dtype=np.int64)
    zones.number_circles(*circles, *limits, group, by_color, round_of)
    if by_color:
        round_of = np.unique(np.column_stack([passes, round_of]), axis=0, return_inverse=True)[1].reshape(-1)
    # tiles that are close on the sky are planned in succession, because they use the same partitions of the catalog
    along = index.order[np.argsort(round_of[index.order], kind="stable")]
    return np.split(along, np.cumsum(np.bincount(round_of))[:-1])


FIELDS_DIFFER = 0.01


@dataclass(frozen=True, eq=False)
class Request(FieldsOfTiles):
    """Targets, tiles, instrument and options of a survey.

    The *slot* of a target is its index in the arrays that describe the state of a survey (`Bookkeeping`).
    """

    builder: FieldBuilder
    """The targets, with their requested numbers of visits."""
    tiling: Tiling
    """The tiles of the passes that are planned."""
    number: np.ndarray
    """For each tile, the index of its pass in ``passes``."""
    passes: list[int]
    instrument: Instrument
    options: AllocationOptions
    order: str
    epoch: str | None
    seed: int
    lost_in_collision: bool
    moved: str | None = None
    """Sentence that states the epoch of the targets; None if they have no proper motions."""
    reference: Time | None = None
    """Epoch of the positions in ``source``; None if the targets are not moved to the times of the tiles."""
    joint: object = None
    """Options of the joint plan; None if the tiles are planned one after the other."""
    state: SurveyState | None = None
    """The state of the survey, if events were recorded."""
    given: object = None
    """The catalog of the first plan as it was given, at its own epoch and without priorities of a rule."""
    cadences: tuple | None = None
    """The cadences, and the row of the cadence of each target in the order of the catalog."""
    first: tuple = ()
    """The tiling and the passes that were given, without the recorded events."""

    is_planned = False
    """Whether the plan of each tile is already known."""

    @property
    def source(self):
        """The catalog of the survey."""
        return self.builder.source

    @cached_property
    def rounds(self) -> list[np.ndarray]:
        """Rows of the tiles of each round; the tiles of a round share no targets and can be planned simultaneously."""
        reach = 2 * (self.radius_rad + self.margin_rad) * (1 + 1e-9)
        if self.cadences is None:
            return make_rounds(self.tiling.vectors, reach, self.number, self.order)
        in_time = np.argsort(self.visit_days, kind="stable")
        return [in_time[rows] for rows in make_rounds(self.tiling.vectors[in_time], reach, self.number, "given")]

    @property
    def dropped(self) -> list[int]:
        """Rows of the tiles that are never observed, because they were dropped or lie in the past."""
        return [] if self.state is None else [row for row, event in self.state.closed.items() if event is None]

    @cached_property
    def days(self) -> np.ndarray:
        """Planned time of each tile (MJD), for cadences."""
        return days_of(self.tiling)

    @cached_property
    def visit_days(self) -> np.ndarray:
        """Time of each tile (MJD), for cadences; observed tiles have the times of their observations."""
        return self.days if self.state is None else times_of(self.tiling, self.state.states)[0]

    @cached_property
    def brightness(self) -> np.ndarray:
        """Sky brightness of each tile, for cadences."""
        return brightness_of(self.cadences[0], self.tiling)

    @cached_property
    @any_year()
    def moments(self) -> Time | None:
        """Time of each tile (UTC); None if neither positions nor states of positioners depend on it."""
        if self.years is None and not is_dated(self.instrument):
            return None
        if (times := times_of_tiles(self.tiling)) is None:
            raise InputError(
                "tiles must have times (a column time, mjd or date), because the states of positioners change with "
                "time, got tiles without times; add times, or choose one time of the states with time= or --set "
                "instrument.state_time=DATE"
            )
        return times.utc

    @cached_property
    @any_year()
    def times(self) -> list[str]:
        """Time of each tile (UTC) as text; an empty list if the plan does not depend on it."""
        return [] if self.moments is None else self.moments.isot.tolist()

    @property
    def uses_dates(self) -> bool:
        """Whether the plan depends on times of tiles that are not those of the observing conditions."""
        return self.moments is not None and times_of_tiles(self.tiling, dates=False) is None

    @cached_property
    def models(self) -> list[Model]:
        """For each tile, the data that its job shares with those of all tiles with the same states of positioners."""
        is_same = not is_dated(self.instrument)
        instruments = [self.instrument] * len(self.tiling) if is_same else instruments_at(self.instrument, self.moments)
        others = self.options, self.builder.blank, self.lost_in_collision, self.source.units
        known = {id(instrument): Model(instrument, *others) for instrument in instruments}
        return [known[id(instrument)] for instrument in instruments]

    @cached_property
    def n_usable(self) -> np.ndarray:
        """Number of usable positioners of each tile."""
        known = {id(model): int(model.instrument.focal_plane.arrays.usable.sum()) for model in self.models}
        return np.array([known[id(model)] for model in self.models], dtype=np.int64)

    def open_state(self) -> Bookkeeping:
        """Return the state of all targets before the first visit."""
        return Bookkeeping(self)

    def job(self, tile: int, left: np.ndarray) -> Job:
        """Return the job for the tile in row ``tile``; ``left`` is the number of remaining visits of each target."""
        if len(closed := self.closed_to(tile)):
            left = left.copy()
            left[closed] = 0
        years, center = 0.0 if self.years is None else float(self.years[tile]), self.tiling.vectors[tile]
        field = self.builder.field(center, self.radius_rad, left, years=years, margin_rad=self.margin_rad)
        name, *where = self._names[tile], *self.places[tile].tolist()
        seed = np.random.SeedSequence(self.seed, spawn_key=(tile,))
        conditions = None if self.conditions is None else self.conditions[tile]
        epoch = self.epoch if self.years is None else f"J{self.reference.jyear + years:.6f}"
        time, speed = (self.times[tile] if self.times else None), None
        if self.years is not None:
            speed = self.source.speeds(field.row)
        return Job(self.models[tile], name, *where, field, seed, conditions, epoch, time, speed)

    @cached_property
    def closed_to(self) -> Callable[[int], np.ndarray]:
        """Function of the row of a tile that returns the slots of the targets that this tile may not observe."""
        return slots_closed_to(self.state, self.source, len(self.tiling))

    @cached_property
    def _names(self) -> list:
        return np.asarray(self.tiling.table["tile"]).tolist()

    @cached_property
    def software(self) -> dict:
        """Versions of the software that makes the plan."""
        return {**versions(), **packages(self.options)}

    @cached_property
    def parameters(self) -> dict:
        """The parameters of the survey that are recorded in its provenance and in its folder."""
        epoch = self.epoch if self.years is None else epoch_text(times_of_tiles(self.first[0]))
        return {
            **self.options.record,
            "passes": self.passes,
            "order": self.order,
            "epoch": epoch,
            "rng": self.seed,
            "lost_in_collision": self.lost_in_collision,
            "radius_deg": float(np.rad2deg(self.radius_rad)),
            **({} if self.cadences is None else {"cadences": self.cadences[0].record}),
            **({} if self.joint is None else {"joint": self.joint.record}),
            **self.observed,
        }

    @cached_property
    def provenance(self) -> dict:
        """Software versions, instrument, catalog, tiling and parameters of the survey."""
        about, rules = self.tiling.table.meta, [rule for rule in self.options.all_constraints if isinstance(rule, Rule)]
        entries = {
            "software": self.software,
            "instrument": self.instrument.provenance,
            "catalog": dict(self.source.meta),
            "tiling": {k: v for k, v in about.items() if k in ("columns", "omitted")} | self.tiling.summary,
            "parameters": self.parameters,
            "units": self.source.units,
            "target_columns": self.source.kinds,
            "rule_columns": [name for rule in rules for name in rule.columns] + self._columns_of_cadences,
            **self._events,
        }
        return json.loads(json.dumps(entries, default=str))  # converts to types that all file formats support

    def check_text(self) -> None:
        """Raise an error if FITS files cannot contain an identifier or another text of the survey."""
        columns = {"tile ids": self.tiling.table["tile"], "positioner ids": self.instrument.focal_plane.id}
        if next(iter(self.source.ids_by_part())).dtype.kind == "U":
            columns["target ids"] = self.source.ids()
        columns.update(self.source.text_columns())
        check_fits_text(columns, "plan without a folder")

    def identity(self) -> dict:
        """Return a dict that identifies the survey, so that only the same survey can be continued in a folder."""
        about = {
            "catalog": (number_of(len(self.source), "target"), self.source.digest()),
            "visits": (number_of(int(self.builder.visits.sum()), "visit"), digest(self.builder.visits)),
            "instrument": (self.instrument.name, self.instrument.provenance["digest"]),
        }
        about = {name: f"{words}, digest {key}" for name, (words, key) in about.items()}
        if self.state is not None:
            tiling, passes = self.first
            tiles = tiles_digest(tiling, conditions_of_tiles(tiling), dates=self.uses_dates)
            about["first"] = {"passes": passes, "tiles": tiles, "catalog": self.state.digest}
            if self.cadences is not None:
                n = len(tiling)
                about["first"]["dates"] = dates_record(self.days[:n], self.brightness[:n])
        return {**about, **self._events, **self._of_tiles, "software": self.software}

    def recorded(self) -> dict:
        """Return the dict that the folder of the survey contains: `identity`, and digests of the catalog as given."""
        columns = ("visits", *self.provenance["rule_columns"])
        return {
            **self.identity(),
            "given": digest_of(self.given),
            "extra": extra_digest(self.given),
            "columns": column_digests(self.given, columns),
            "required_ids": [str(target_id) for target_id in self.options.required_ids],
        }

    @property
    def _of_tiles(self) -> dict:
        """The entries of `identity` that can depend on the tiles."""
        entries = {"tiles": tiles_digest(self.tiling, self.conditions, dates=self.uses_dates), **self.parameters}
        if self.cadences is not None:
            entries["dates"] = dates_record(self.days, self.brightness)
        return entries

    def of_first_tiles(self, tiles: str) -> dict:
        """Return the entries of `identity` for the first of the given tiles, which were planned before the others.

        Parameters
        ----------
        tiles : str
            The entry ``tiles`` of these tiles.

        Returns
        -------
        dict
            The entries that can depend on the tiles; an empty dict if the first tiles are not those of ``tiles``.

        Raises
        ------
        InputError
            If the plans of the first tiles could depend on the others.
        """
        (tiling, passes), n = self.first, number_in(tiles)
        if not 0 < n < len(tiling):
            return {}
        number = _number_of(tiling, passes)
        head, used = Tiling(tiling.table[:n]), [p for k, p in enumerate(passes) if k in number[:n]]
        first = replace(self, tiling=head, number=_number_of(head, used), passes=used, state=None, first=(head, used))
        if tiles_digest(head, first.conditions, dates=self.uses_dates) != tiles:
            return {}
        those = f"the {number_of(n, 'tile')} of the folder"
        if self.joint is not None and self.state is None:
            raise InputError(f"tiles of a joint plan, which are planned together, must be {those}, got {len(tiling)}")
        is_dated = self.cadences is not None
        when, what = (self.days, "MJD") if is_dated else (number, "pass")
        early = when[n:] < when[:n].max() if is_dated else when[n:] <= when[:n].max()
        if early.any() and (is_dated or self.order == "color"):
            row = n + int(np.argmax(early))
            got = when[row] if is_dated else passes[number[row]]
            raise InputError(
                f"further tiles must be planned after {those}, and therefore have a later {what}, got the {what} {got} "
                f"for tile {self._names[row]}"
            )
        # the targets in the field of a tile, and the order of the tiles, depend on these two numbers
        if first.margin_rad != self.margin_rad:
            return {}
        return first._of_tiles | {"radius_deg": self.parameters["radius_deg"]}

    @property
    def _columns_of_cadences(self) -> list[str]:
        return [] if self.cadences is None else [self.cadences[0].column]

    @property
    def _events(self) -> dict:
        """The record of the events; an empty dict if there are none."""
        return {} if self.state is None else {"events": self.state.record}


def _number_of(tiling: Tiling, passes: list) -> np.ndarray:
    """Return the index of the pass of each tile in ``passes``."""
    return np.array([passes.index(p) for p in np.asarray(tiling.table["pass"]).tolist()])


def tiles_digest(tiling: Tiling, conditions: list | None, *, dates: bool = False) -> str:
    """Return the number of tiles, and a digest of their positions, passes, names and observing conditions.

    With ``dates``, the digest includes the times of the tiles, if they have times.
    """
    columns = ("ra", "dec", "position_angle", "pass")
    tiles = [np.asarray(tiling.table[name].value, dtype=float) for name in columns]
    names = np.asarray(tiling.table["tile"]).astype(str)
    if conditions is not None:
        tiles.append(np.array([str(tile_conditions.record) for tile_conditions in conditions]))
    if dates and (times := times_of_tiles(tiling)) is not None:
        tiles.append(times.mjd)
    return f"{number_of(len(tiling), 'tile')}, digest {digest(*tiles, names)}"


def make_request(
    source, tiling: Tiling, instrument: Instrument, options: AllocationOptions, *, visits, passes, state, **others
) -> Request:
    """Return the request of a survey, or raise an error if it is not valid."""
    if len(source) == 0:
        raise InputError("the catalog must have at least one target with finite coordinates, got none")
    number = np.asarray(tiling.table["pass"])
    asked = np.unique(number) if passes is None else np.atleast_1d(to_dimensionless(passes, "passes"))
    known = np.unique(number).tolist()
    strange = [p for p in asked.tolist() if p not in known]
    passes = asked.tolist() if strange else asked.astype(int).tolist()
    if strange or len(set(passes)) < len(passes):
        listed = ", ".join(str(p) for p in known[:12])
        raise InputError(f"passes must be distinct passes of the tiling ({listed}), got {passes}")
    rows = np.flatnonzero(np.isin(number, passes))
    if len(rows) == 0:
        raise InputError("the tiling must have at least one tile, got none")
    tiling = tiling if len(rows) == len(tiling) else Tiling(tiling.table[rows])
    first = tiling, passes
    if state is not None:
        tiling = state.tiling(tiling)
        if state.cadences is not None:  # further tiles can lie in the past
            state = replace(state, given=(*state.given[:3], tiling))
        passes = [*passes, *sorted({*np.asarray(tiling.table["pass"]).tolist()} - {*passes})]
    place = _number_of(tiling, passes)
    made_for, radius = tiling.summary.get("radius_deg"), instrument.field_radius.to_value(u.deg)
    if made_for is not None and abs(made_for / radius - 1) > FIELDS_DIFFER:
        name = tiling.summary.get("instrument")
        fields = f"fields of {name}, which have" if name else "fields with"
        warn(
            f"the tiles were placed for {fields} a radius of {made_for:.4g} deg, but the fields of {instrument.name} "
            f"have a radius of {radius:.4g} deg"
        )
    made, dropped = (None, None) if state is None else (state.observed, state.dropped)
    has_cadences = others["cadences"] is not None
    builder = FieldBuilder(source, options, instrument, visits, made=made, dropped=dropped, has_cadences=has_cadences)
    return Request(builder, tiling, place, passes, instrument, options, state=state, first=first, **others)
