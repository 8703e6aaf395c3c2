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
from rfpsurvey._common.descriptions import COPIED, Column, describe, table_of, with_unit
from rfpsurvey._common.executors import Progress
from rfpsurvey._common.files import check_parent, suffix_of, to_path
from rfpsurvey._common.io import write_bytes, write_table, writing_to, written
from rfpsurvey._common.units import from_lonlat, to_plain
from rfpsurvey._field.plan_files import TABLE, as_plan, file_name, write_plan
from rfpsurvey._field.plan_values import instrument_file
from rfpsurvey._field.score import score_tile
from rfpsurvey._field.table import TILE_COLUMNS, only_with_target
from rfpsurvey._field.tile import Tile
from rfpsurvey._instruments.instrument import Instrument, as_instrument, available_instruments
from rfpsurvey._instruments.states import instruments_at, is_dated
from rfpsurvey._sky.conditions import ObservingConditions
from rfpsurvey._sky.region import Region
from rfpsurvey._sky.time import to_time
from rfpsurvey._survey import key_objects
from rfpsurvey._survey.folder import part_name, read_visits
from rfpsurvey._survey.other_targets import OtherTargets, table_of_changes, tile_at_time
from rfpsurvey._survey.plan_file import keys_in
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.columns import conditions_of_rows
from rfpsurvey._survey.work import TIME
from rfpsurvey.errors import InputError, RfpsurveyWarning, check_whole, listed, number_of, warn

EXPORTED = table_of(
    Column("tile", "identifier of the tile"),
    Column("file", "name of the file"),
    Column("n_positioners", "positioners in the file"),
    Column("n_assigned", "positioners with a target"),
    Column("n_colliding", "positioners in collision"),
    Column("unmet", "requirements and constraints that are not met"),
    Column("n_changed", "positioners that do not observe their planned target at the time of the file"),
    Column("alternates", "name of the file with the alternates of the fibers"),
)
"""Columns of the table that `Survey.export` returns; the last two only if times or alternates are given."""
CHANGED = "changes.ecsv"
"""Name of the file with the changes of targets."""
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

    def plan_of(self, row: int) -> tuple[QTable, dict, dict]:
        """Return the visits, the header cards and the entry ``survey`` of a tile; raise an error if it has no plan."""
        survey, name = self.survey, self.survey.tiles["tile"][row]
        if survey._states[row] == "dropped":
            raise InputError(f"tile {name} was dropped, and has no plan")
        visits, (_, cards) = survey._visits(row), read_visits(survey.folder, row, survey._known, name)
        if len(visits) == 0:
            raise InputError(f"tile {name} has no positioner with a target")
        return visits, cards, self._entry(row, cards)

    def tile(self, row: int) -> Tile:
        """Return a tile, or raise an error if it has no plan, or if its poses are not those of the plan."""
        (visits, cards, entry) = self.plan_of(row)
        instrument = self.instrument_at(cards.get(TIME))
        conditions = None if self.conditions is None else self.conditions[row]
        scored = self.scored(visits, cards, entry, instrument, conditions)
        self._check(scored, visits, row)
        return self.completed(scored, visits, entry, cards)

    def scored(self, visits: QTable, cards: dict, entry: dict, instrument: Instrument, conditions: object) -> Tile:
        """Return the tile with the poses of arms at the targets of visits."""
        columns = ("positioner", "target_id", "ra", "dec", *({"fiber_type"} & {*visits.colnames}))
        scored = score_tile(
            visits[list(columns)],
            instrument,
            center=SkyCoord(*(float(cards[axis]) for axis in ("RA", "DEC")), unit="deg"),
            position_angle=float(cards["POSANG"]) * u.deg,
            positions="sky",
            conditions=conditions,
            parked_obstacles=bool(self.parameters.get("parked_obstacles", True)),
            constraints=["keep_out " + " ".join(entry["keep_out"].values())] if "keep_out" in entry else None,
        )
        scored.table.meta["provenance"]["instrument"] = instrument.provenance  # without the keep-out circles
        return scored

    def _entry(self, row: int, cards: dict) -> dict:
        """Return the entry ``survey`` of a plan, whose values are text, because some formats contain only text."""
        tiles, parameters = self.survey.tiles, self.parameters
        vector = from_lonlat(*np.deg2rad([float(cards[axis]) for axis in ("RA", "DEC")]))
        limit = FIELDS * self.instrument.field_radius.to_value(u.rad)
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

    def _check(self, scored: Tile, visits: QTable, row: int) -> None:
        """Raise an error if the targets or collisions of a tile are not those of the survey."""
        table, name = scored.table, self.survey.tiles["tile"][row]
        owner = owners_of(table, visits)
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

    def completed(self, scored: Tile, visits: QTable, entry: dict, cards: dict) -> Tile:
        """Return a scored tile with the kinds, priorities and further columns of its targets."""
        table = scored.table
        row_of = np.full(len(table), -1)
        row_of[owners_of(table, visits)] = np.arange(len(visits))
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


def owners_of(table: QTable, visits: QTable) -> np.ndarray:
    """Return the row in the table of a tile of the positioner of each visit."""
    row_of = {str(identifier): row for row, identifier in enumerate(table["id"].tolist())}
    return np.array([row_of[str(positioner)] for positioner in visits["positioner"].tolist()])


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


def export(survey, tiles, *, format, folder, instrument, overwrite, alternates, times, progress) -> QTable:  # noqa: A002
    """Write tiles of a survey to files of plans; see `Survey.export`."""
    folder, planned = to_path(folder), planned_tiles(survey, instrument)
    if alternates is not None:
        check_whole(alternates, "alternates")
    others = OtherTargets(survey, **({} if instrument is None else {"instrument": instrument}))
    rows = range(len(survey)) if tiles is None else rows_of_tiles(survey, tiles)
    moments = None if times is None else _times_of(times, rows, planned, alternates)
    records, left_out, said, n_stuck, changes = [], {}, defaultdict(list), 0, []
    if is_new := not folder.is_dir():
        check_parent(folder)
        with written(folder):
            folder.mkdir()
    try:
        with ExitStack() as stack, Progress(progress, len(rows), "tiles") as tell:
            for number, row in enumerate(rows, 1):
                name = survey.tiles["tile"][row]
                try:
                    if moments is None:
                        tile, changed = planned.tile(row), []
                    else:
                        tile, changed = tile_at_time(planned, others, row, moments[number - 1])
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
                changes += changed
                if moments is not None:
                    records[-1] += (len(changed),)
                if alternates is not None:
                    usual = file_name(plan, name, TABLE)
                    path = folder / Path(usual.replace("tile-", "alternates-", 1)).with_suffix(".ecsv")
                    temporary = stack.enter_context(writing_to(path, (".ecsv",), overwrite=overwrite))
                    write_table(others.of_tile(row, alternates), temporary)
                    records[-1] += (path.name,)
                tell(number)
            if changes:
                temporary = stack.enter_context(writing_to(folder / CHANGED, (".ecsv",), overwrite=overwrite))
                write_table(table_of_changes(changes), temporary)
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
    names = [*EXPORTED][:-2] + ["n_changed"] * (times is not None) + ["alternates"] * (alternates is not None)
    table = QTable(rows=records, names=names, meta={"folder": str(folder), "left_out": left_out})
    return describe(table, EXPORTED)


def _times_of(times: object, rows: list[int] | range, planned: PlannedTiles, alternates: int | None) -> Time:
    """Return the times of tiles, or raise an error if the tiles cannot have them."""
    times = to_time(times, "times")
    if times.shape != (len(rows),):
        raise InputError(f"times must have one time for each of the {len(rows)} tiles, got the shape {times.shape}")
    if planned.conditions is None:
        raise InputError(
            "times must be left out for a survey without observing conditions, whose positions do not change"
        )
    if alternates is not None:
        raise InputError("times must be left out if alternates are given, because alternates are those of the plan")
    return Time(times.utc, format="isot", precision=3)


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
