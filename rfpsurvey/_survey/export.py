"""Tiles of a survey with the poses of their arms, their files in the formats of observatories, and alternates."""

import re
import tempfile
import warnings
from collections import defaultdict
from collections.abc import Iterable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from astropy.time import Time

from rfpsurvey._assignment.constraints.targets import circle_text
from rfpsurvey._assignment.constraints.text import listed_in, recorded_constraints
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._assignment.rules import FEWEST_FIRST
from rfpsurvey._common.descriptions import COPIED, Column, describe, table_of, with_unit
from rfpsurvey._common.executors import Progress
from rfpsurvey._common.files import check_parent, suffix_of, to_path
from rfpsurvey._common.io import write_bytes, write_table, writing_to, written
from rfpsurvey._common.units import from_lonlat, to_plain
from rfpsurvey._field.alternates import PlannedField, find_alternates
from rfpsurvey._field.plan import with_subpriorities
from rfpsurvey._field.plan_files import TABLE, as_plan, file_name, write_plan
from rfpsurvey._field.plan_values import instrument_file
from rfpsurvey._field.score import score_tile
from rfpsurvey._field.table import TILE_COLUMNS, only_with_target
from rfpsurvey._field.tile import Tile
from rfpsurvey._instruments.arms import place_arms
from rfpsurvey._instruments.instrument import Instrument, as_instrument, available_instruments
from rfpsurvey._instruments.states import instruments_at, is_dated
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._sky.conditions import ObservingConditions
from rfpsurvey._sky.region import Region
from rfpsurvey._survey import key_objects
from rfpsurvey._survey.continue_survey import request_in
from rfpsurvey._survey.folder import part_name, read_visits
from rfpsurvey._survey.history.status import count_planned
from rfpsurvey._survey.plan_file import keys_in
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.columns import conditions_of_rows
from rfpsurvey._survey.work import TIME, projection_of, reach_of
from rfpsurvey.errors import InputError, RfpsurveyWarning, check_whole, listed, number_of, warn

EXPORTED = table_of(
    Column("tile", "identifier of the tile"),
    Column("file", "name of the file"),
    Column("n_positioners", "positioners in the file"),
    Column("n_assigned", "positioners with a target"),
    Column("n_colliding", "positioners in collision"),
    Column("unmet", "requirements and constraints that are not met"),
    Column("alternates", "name of the file with the alternates of the fibers"),
)
"""Columns of the table that `Survey.export` returns; the last one only if alternates are requested."""
MOST_NAMES = 10
"""Largest number of tiles that a message lists."""
FIELDS = 1.5
"""Distance, as a multiple of the radius of a field, from which on arms cannot touch a keep-out circle."""
CHECKED = ("n_assigned", "n_colliding", "n_colliding_pairs", "n_obstacle_collisions")
"""Numbers of a tile that must be those of the survey."""
OF_VISITS = {"tile", "target_id", "target_row", "positioner", "ra", "dec", "in_collision", "observed", "fiber_type"}
"""Columns of visits that are not copied to the table of a tile."""


@dataclass(frozen=True)
class PlannedTiles:
    """The tiles of a survey in a folder, and the instrument with which they were planned."""

    survey: Survey
    instrument: Instrument
    """The instrument of the survey, whose states of positioners can differ between tiles."""
    stored: dict[int, tuple[Instrument, bytes]] = field(default_factory=dict)
    """The instruments of the tiles that were returned, as their files describe them, and contents of these files."""

    @cached_property
    def parameters(self) -> dict:
        """The parameters of the survey."""
        return self.survey.provenance["parameters"]

    @cached_property
    def conditions(self) -> list[ObservingConditions] | None:
        """The observing conditions of each tile; None if refraction is neglected."""
        record = self.parameters.get("conditions")
        return None if not record else conditions_of_rows(ObservingConditions.from_record(record), self.survey.tiles)

    @cached_property
    def circles(self) -> tuple[Region, ...]:
        """The circles that no arm may cover."""
        try:
            return tuple(Region.parse(text) for text in listed_in(self.parameters.get("keep_out", [])))
        except InputError:  # the folder contains only a digest of many circles
            options = keys_in(self.survey.folder, ("allocator", "instrument", "visits", "rule")).options
            return AllocationOptions(**{name: options.get(name) for name in ("constraints", "keep_out")}).keep_out

    def put_instruments(self, folder: Path) -> None:
        """Write the files of the instruments of tiles to a folder of plans, unless the folder already contains them."""
        for instrument, content in self.stored.values():
            path = folder / instrument_file(instrument.provenance["digest"])
            if content and not path.is_file():
                write_bytes(path, content)

    def instrument_at(self, time: str | None) -> Instrument:
        """Return the instrument with the states of positioners at the time of a tile, as its file describes it."""
        is_same = not is_dated(self.instrument)
        model = self.instrument if is_same else instruments_at(self.instrument, Time([time], scale="utc"))[0]
        if id(model) not in self.stored:  # instruments_at returns the same object for times with the same states
            self.stored[id(model)] = _stored(model)
        return self.stored[id(model)][0]

    def tile(self, row: int) -> Tile:
        """Return a tile, or raise an error if it has no plan, or if its poses are not those of the plan."""
        survey, name = self.survey, self.survey.tiles["tile"][row]
        if survey._states[row] == "dropped":
            raise InputError(f"tile {name} was dropped, and has no plan")
        visits, (_, cards) = survey._visits(row), read_visits(survey.folder, row, survey._known, name)
        if len(visits) == 0:
            raise InputError(f"tile {name} has no positioner with a target")
        center = SkyCoord(*(float(cards[axis]) for axis in ("RA", "DEC")), unit="deg")
        entry, instrument = self._entry(row, cards, center), self.instrument_at(cards.get(TIME))
        columns = ("positioner", "target_id", "ra", "dec", *({"fiber_type"} & {*visits.colnames}))
        scored = score_tile(
            visits[list(columns)],
            instrument,
            center=center,
            position_angle=float(cards["POSANG"]) * u.deg,
            positions="sky",
            conditions=None if self.conditions is None else self.conditions[row],
            parked_obstacles=bool(self.parameters.get("parked_obstacles", True)),
            constraints=["keep_out " + " ".join(entry["keep_out"].values())] if "keep_out" in entry else None,
        )
        scored.table.meta["provenance"]["instrument"] = instrument.provenance  # without the keep-out circles
        return self._completed(scored, visits, entry, cards, row)

    def _entry(self, row: int, cards: dict, center: SkyCoord) -> dict:
        """Return the entry ``survey`` of a plan, whose values are text, because some formats contain only text."""
        tiles, parameters = self.survey.tiles, self.parameters
        vector, limit = center.cartesian.xyz.value, FIELDS * self.instrument.field_radius.to_value(u.rad)
        near = [c for c in self.circles if np.arccos(np.clip(c.values[:3] @ vector, -1, 1)) < c.values[3] + limit]
        others = {name: values for name, values in parameters.items() if name not in ("required", "keep_out")}
        circles = [circle_text(circle).removeprefix("cap ") for circle in near]
        lists = {"constraints": recorded_constraints(others), "keep_out": circles}
        entry = {
            "tile": tiles["tile"][row],
            "generation": cards.get("GENER", 1),
            "plan": cards.get("PLANID", ""),
            "allocator": parameters["allocator"],
            "parked_obstacles": parameters.get("parked_obstacles", True),
            **{name: tiles[name][row] for name in ("unmet", "not_checkable") if name in tiles.colnames},
        }
        texts = {name: str(value) for name, value in entry.items() if str(value)}
        return texts | {name: {str(k): text for k, text in enumerate(rows)} for name, rows in lists.items() if rows}

    def _completed(self, scored: Tile, visits: QTable, entry: dict, cards: dict, row: int) -> Tile:
        """Return a scored tile with the kinds, priorities and further columns of its targets."""
        table, name = scored.table, entry["tile"]
        row_of_id = {str(i): k for k, i in enumerate(table["id"].tolist())}
        owner = np.array([row_of_id[str(i)] for i in visits["positioner"].tolist()])
        numbers = {key: (scored.summary[key], int(self.survey.tiles[key][row])) for key in CHECKED}
        differ = to_plain(table["in_collision"])[owner] != to_plain(visits["in_collision"])
        if differ.any() or scored.summary["n_out_of_reach"] or any(a != b for a, b in numbers.values()):
            n_lost = abs(np.subtract(*numbers["n_assigned"]))
            n = max(int(differ.sum()), scored.summary["n_out_of_reach"], n_lost, 1)
            raise InputError(
                f"the poses of tile {name} must be those of its plan, got other targets or collisions of "
                f"{number_of(n, 'positioner')}; the plan was made with another state of the instrument, or with arms "
                "that are bent to the other side (handedness both), which the folder does not contain"
            )
        row_of = np.full(len(table), -1)
        row_of[owner] = np.arange(len(visits))
        for column in visits.colnames:
            if column not in OF_VISITS:
                values, unit = to_plain(visits[column]), getattr(visits[column], "unit", None)
                table[column] = with_unit(only_with_target(values[row_of], row_of >= 0), unit)
        provenance, parameters = table.meta["provenance"], table.meta["provenance"]["parameters"]
        parameters |= {"allocator": self.parameters["allocator"], "survey": entry}
        parameters["epoch"] = cards.get("REFEPOCH", self.parameters.get("epoch"))
        provenance["catalog"] = self.survey.provenance["catalog"]
        table.meta["summary"]["unmet"] = [entry["unmet"]] if "unmet" in entry else []
        return Tile(describe(table, TILE_COLUMNS, COPIED))


def planned_tiles(survey: Survey, instrument: Instrument | str | None = None) -> PlannedTiles:
    """Return the tiles of a survey with its instrument, which is that of its plan file unless it is given."""
    if survey.folder is None:
        raise InputError("the survey must have a folder to export its tiles, got a survey in memory; plan with folder=")
    if instrument is None:
        keys = keys_in(survey.folder, ("allocator", "visits", "rule"))

        def time_of_tiles():
            return key_objects.time_of_tiles(key_objects.read_tiles(keys.tiles), keys.epoch, keys.conditions)

        model = key_objects.model_of(keys.instrument, time_of_tiles)
    else:
        model = as_instrument(instrument, may_be_dated=True)
    now, then = model.provenance, survey.provenance["instrument"]
    if now["digest"] != then.get("digest"):
        name, digest = then["name"], then.get("digest")
        raise InputError(
            f"instrument must be that of the survey, {name} with the digest {digest}, got {model.name} with the digest "
            f"{now['digest']}; give the instrument as it was planned with instrument= (or --set instrument=PATH)"
        )
    return PlannedTiles(survey, model)


def _stored(model: Instrument) -> tuple[Instrument, bytes]:
    """Return an instrument as its file describes it, and the content of this file; presets need no file.

    Exported tiles have the values in the file, which can differ by rounding errors, so that plans have the same scores.
    """
    digest = model.provenance["digest"]
    if model.name in available_instruments() and as_instrument(model.name).provenance["digest"] == digest:
        return model, b""
    with tempfile.TemporaryDirectory() as place:
        try:
            model.write(path := Path(place) / "instrument.ecsv")
        except InputError as error:
            warn(f"{error}; give the instrument when the plans are scored")
            return model, b""
        return Instrument.read(path), path.read_bytes()


def tile_at(path: Path) -> tuple[Tile, PlannedTiles] | None:
    """Return the tile, and the tiles, of a survey for the path of a file in its folder, or None for other paths."""
    folder = Path(path).absolute().parent.parent.parent
    if (Path(path) / "survey.json").is_file():
        raise InputError(f"{path} is a survey; give the file of a tile, or use rfpsurvey export {path}")
    if not (path.stem.isdecimal() and (folder / "survey.json").is_file()):
        return None
    row = int(path.stem)
    if folder / part_name(row) != Path(path).absolute():
        return None
    survey = Survey.read(folder)
    if row >= len(survey):
        raise InputError(f"{path} must be the file of one of the {len(survey)} tiles of the survey, got row {row}")
    planned = planned_tiles(survey)
    return planned.tile(row), planned


class SurveyAlternates:
    """The alternates of the tiles of a survey; ``given`` contains parameters that its plan file does not determine."""

    def __init__(self, survey: Survey, **given: object):
        self._survey, self._request = survey, request_in(survey.folder, **given)
        self._state = self._request.open_state()

    @cached_property
    def _planned(self) -> np.ndarray:
        """Number of visits of each target in the tiles that will be observed, in the order of the catalog."""
        return count_planned(self._survey, self._request.state, is_planned=False)

    def of_tile(self, row: int, n: int) -> QTable:
        """Return a table of at most n alternates of each fiber of the tile in a row, as `find_alternates` does."""
        survey, request = self._survey, self._request
        name = survey.tiles["tile"][row]
        visits, cards = read_visits(survey.folder, row, survey._known, name)
        job = self._state.open_job(request, row)
        if not np.allclose([cards[axis] for axis in ("RA", "DEC", "POSANG")], request.places[row], rtol=0, atol=1e-9):
            raise InputError(f"tile {name} must have its planned position for alternates, got a tile that was moved")
        reach, options, columns = reach_of(job), request.options, visits.dtype.names
        plane, has_types = reach.applied.instrument.focal_plane, "fiber_type" in columns
        row_of = {str(positioner): k for k, positioner in enumerate(plane.id.tolist())}
        owner = np.array([row_of[str(positioner)] for positioner in visits["positioner"].tolist()])
        vectors = from_lonlat(np.deg2rad(visits["ra"]), np.deg2rad(visits["dec"]))
        tips, types = np.full((len(plane), 2), np.nan), None
        tips[owner] = projection_of(job).project(vectors, visits["fiber_type"] if has_types else None)
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
        roles = visits["kind"] if "kind" in columns else np.full(len(visits), "science")
        about = targets, reach.xy, reach.fiber_type, pairs, owner, visits["target_id"], roles, vectors
        table = find_alternates(PlannedField(plane, arms, options.motion_law, parked, *about), n, left, planned)
        table.add_column(np.full(len(table), name), name="tile", index=0)
        return table


def rows_of_tiles(survey: Survey, tiles: object) -> list[int]:
    """Return the rows of tiles that are given as one identifier, a list of them, or text such as ``12-20,31``.

    The ends of a range must be tiles of the survey; a range contains all tiles with numbers between its ends.
    """
    names = np.asarray(survey.tiles["tile"]).astype(str)
    row_of, numbers = {name: row for row, name in enumerate(names.tolist())}, survey.tiles["tile"]
    parts = [tiles] if isinstance(tiles, int | np.integer) else tiles
    if isinstance(tiles, str):
        parts = [tiles] if tiles in row_of else [part.strip() for part in tiles.split(",")]
    if not isinstance(parts, Iterable):
        raise InputError(f"tiles must be identifiers of tiles, or text such as 12-20,31, got {tiles!r}")
    rows, unknown = [], []
    for part in map(str, parts):
        ends = re.fullmatch(r"(\d+)\s*-\s*(\d+)", part)
        wanted = [part] if part in row_of or not ends else list(ends.groups())
        if lacking := [name for name in wanted if name not in row_of]:
            unknown += lacking
        elif len(wanted) == 1:
            rows.append(row_of[part])
        elif np.asarray(numbers).dtype.kind != "i" or int(wanted[0]) > int(wanted[1]):
            raise InputError(f"tiles must be ranges of numbers from the smallest to the largest, got {part!r}")
        else:
            low, high = map(int, wanted)
            rows += np.flatnonzero((numbers >= low) & (numbers <= high)).tolist()
    if unknown or not rows:
        known, got = (listed(values, MOST_NAMES) for values in (names.tolist(), [name or "''" for name in unknown]))
        raise InputError(f"tiles must be tiles of the survey, which has {known}, got {got}")
    return list(dict.fromkeys(rows))


def export(survey, tiles, *, format, folder, instrument, overwrite, alternates, progress) -> QTable:  # noqa: A002
    """Write tiles of a survey to files of plans; see `Survey.export`."""
    folder, planned, others = to_path(folder), planned_tiles(survey, instrument), None
    if alternates is not None:
        check_whole(alternates, "alternates")
        others = SurveyAlternates(survey, **({} if instrument is None else {"instrument": instrument}))
    rows = range(len(survey)) if tiles is None else rows_of_tiles(survey, tiles)
    records, left_out, said, n_stuck = [], {}, defaultdict(list), 0
    if is_new := not folder.is_dir():
        check_parent(folder)
        with written(folder):
            folder.mkdir()
    try:
        with ExitStack() as stack, Progress(progress, len(rows), "tiles") as tell:
            for number, row in enumerate(rows, 1):
                name = survey.tiles["tile"][row]
                try:
                    tile = planned.tile(row)
                except InputError as error:
                    if tiles is not None:
                        raise
                    left_out[str(name)] = str(error)
                    continue
                plan = as_plan(tile)
                path = folder / file_name(plan, name, format)
                if any(path.name == record[1] for record in records):
                    raise InputError(f"{path} must be the file of one tile, got {name} and another tile of this name")
                n_stuck += int(((plan["kind"] == "sky") & ~plan["assigned"]).sum())
                # all files are renamed when all of them are complete
                temporary = stack.enter_context(writing_to(path, (suffix_of(path),), overwrite=overwrite))
                for text in _write(tile, plan, temporary, format, path):
                    said[text].append(path.name)
                numbers = (tile.summary["n_assigned"], tile.summary["n_colliding"], " ".join(tile.summary["unmet"]))
                records.append((name, path.name, len(plan), *numbers))
                if others is not None:
                    usual = file_name(plan, name, TABLE)
                    path = folder / Path(usual.replace("tile-", "alternates-", 1)).with_suffix(".ecsv")
                    temporary = stack.enter_context(writing_to(path, (".ecsv",), overwrite=overwrite))
                    write_table(others.of_tile(row, alternates), temporary)
                    records[-1] += (path.name,)
                tell(number)
        names, reasons = [*left_out], listed(dict.fromkeys(left_out.values()), 2)
        without = f"{number_of(len(names), 'tile')} left out: {listed(names, MOST_NAMES)} ({reasons})"
        if not records:
            raise InputError(f"at least one tile must have a plan to export, got {without}")
        planned.put_instruments(folder)
    except BaseException:
        if is_new:
            with suppress(OSError):
                folder.rmdir()
        raise
    for text, names in said.items():
        warn(f"{text} ({number_of(len(names), 'file')}, such as {names[0]})")
    if n_stuck:
        warn(f"{number_of(n_stuck, 'stuck fiber')} on sky are written without a position and an identifier of a target")
    if left_out:
        warn(without)
    names = [*EXPORTED][: len(EXPORTED) - (others is None)]
    table = QTable(rows=records, names=names, meta={"folder": str(folder), "left_out": left_out})
    return describe(table, EXPORTED)


def _write(tile: Tile, plan: QTable, temporary: Path, format: str, path: Path) -> list[str]:  # noqa: A002
    """Write a tile to a temporary file that will be renamed to ``path``, and return the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RfpsurveyWarning)
        try:
            if format == TABLE:
                tile.write(temporary)
            else:
                write_plan(plan, temporary, format=format)
        except InputError as error:
            raise type(error)(str(error).replace(str(temporary), str(path))) from error
    return [str(warning.message).replace(str(temporary), "each file") for warning in caught]
