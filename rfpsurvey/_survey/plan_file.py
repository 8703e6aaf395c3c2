"""The plan file of a survey: its keys, the parameters of `plan_survey` for their values, and the values for a call."""

import hashlib
import os
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import astropy.units as u
import numpy as np
from astropy.table import QTable, Table
from astropy.time import Time

from rfpsurvey._assignment.constraints.targets import circle_text
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._common.io import write_bytes, write_table, written
from rfpsurvey._common.plugins import name_of
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._common.settings import Settings, options_of
from rfpsurvey._common.units import to_center
from rfpsurvey._instruments.instrument import Instrument, as_instrument, available_instruments
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.catalog_files import EXACT, write_exactly
from rfpsurvey._sky.partitions import PartitionedCatalog
from rfpsurvey._sky.region import Region
from rfpsurvey._sky.synthetic import synthetic_catalog
from rfpsurvey._survey import key_groups, key_objects, key_types
from rfpsurvey._survey.cadences import Cadences
from rfpsurvey._survey.history.rule import VisitRule
from rfpsurvey._survey.history.state import SurveyState
from rfpsurvey._survey.joint.fixed import JOINT, JointOptions, as_joint
from rfpsurvey._survey.key_objects import no_output
from rfpsurvey._survey.key_types import Part, build, keys_of
from rfpsurvey._survey.request import tiles_digest
from rfpsurvey._survey.source import check_first_catalog
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.columns import conditions_of_tiles, warn_of_targets
from rfpsurvey._survey.tiling.place import place_tiles
from rfpsurvey._survey.tiling.tiling import Tiling, as_tiling, in_passes
from rfpsurvey.errors import InputError, listed, warn, warn_no_effect

DEFAULT_CENTER = "06h20m00s +23d00m00s"
GIVEN = "given in Python"
LACKING = {"rule": "rule.function", "allocator": "options.allocator", "instrument": "instrument.name"}
"""Keys that have the value ``GIVEN`` if the file cannot contain a parameter, so that no default value replaces it."""
TILING_COLUMNS = {"tile", "ra", "dec", "position_angle", "pass", "program", "state", "time", "hour_angle", "date"}
TILING_COLUMNS |= {"mjd", "skybrightness", "sky_brightness", "n_failed"}
"""Columns of tables of tiles that surveys use."""


@dataclass(frozen=True)
class SurveyOutputKeys(key_groups.OutputKeys):
    """The files that the command writes.

    Parameters
    ----------
    folder : Path, optional
        Folder to which the finished tiles are written.
    resume : bool, optional
        Continue the survey in the folder, which is unfinished, or to which tiles are added after its own.
    replan : bool, optional
        Plan the rest of a survey, whose folder is given in place of the catalog, from the events that were recorded
        (rfpsurvey record). Observed tiles keep their plans. All options have the values of the first plan, unless
        they are given.
    plot : Path, optional
        Plot the tiles on the sky and the completeness (.png, .pdf or .svg).
    quality : Path, optional
        Plot the numbers of visits per priority class, of targets per outcome, and of fibers per kind of target (.png,
        .pdf or .svg).
    """

    folder: Path | None = None
    resume: bool = False
    replan: bool = False
    quality: Path | None = None


@dataclass(frozen=True, kw_only=True)
class SurveyKeys(key_groups.WorkerKeys):
    """The keys of a survey.

    Parameters
    ----------
    cadences : Path, optional
        Table of cadences; the catalog must have the column cadence, and the tiles the column time, date or mjd.
    python : list[str], optional
        Parameters of a survey that was planned in Python for which there is no key, such as a function as allocator.
        They must be given when the rest of the survey is planned.
    """

    catalog: key_groups.SurveyCatalogKeys
    instrument: key_groups.InstrumentKeys
    tiles: key_groups.TilesKeys
    options: key_groups.SurveyOptions
    joint: Annotated[dict, Part(JointOptions, omit=("allocator",))]
    rule: Annotated[dict, Part(VisitRule)]
    conditions: key_groups.Conditions
    output: SurveyOutputKeys
    order: key_groups.Order = "color"
    cadences: Path | None = None
    epoch: key_groups.Epoch = None
    lost_in_collision: key_groups.Lost = True
    rng: key_groups.Seed = 0
    python: list[str] | None = None


def targets_of(keys, model: Instrument, *, tell: Callable[[str], None] = no_output) -> Catalog | PartitionedCatalog:
    """Read the catalog of a survey from a file or a folder of partitions, with the columns that rules and cadences use.

    By default, make a synthetic catalog wider than a field. All commands that read the catalog of a survey call this
    function, so that they have the same columns.
    """
    catalog = key_objects.with_columns_of_rules(keys.catalog, getattr(keys, "options", {}), model)
    if getattr(keys, "cadences", None) is not None:
        catalog = replace(catalog, keep=[*dict.fromkeys([*(catalog.keep or ()), "cadence"])])
    if catalog.path is None:
        key_objects.warn_without_catalog(catalog)
        options = {"density": model.target_density, "rng": keys.rng}
        return synthetic_catalog("poisson", to_center(DEFAULT_CENTER), 2 * model.field_radius, **options)
    return key_objects.read_catalog(catalog, tell=tell)


def visits_of(keys, targets, **given: object) -> SurveyState | VisitRule | Cadences | int | np.ndarray | None:
    """Return the parameter ``visits`` of `plan_survey`: the state of a survey, a rule, cadences or numbers.

    ``given`` contains the planned ``tiles``, and can contain a ``rule`` and ``visits`` in place of those of the keys.
    """
    if keys.cadences is not None and (keys.rule or keys.catalog.visits is not None):
        raise InputError("cadences must be used without catalog.visits and rule, got several of them")
    visits = given["visits"] if "visits" in given else _requested(keys)
    rule = given["rule"] if "rule" in given else VisitRule(**keys.rule)
    for name in ("visits", "after_success"):
        if keys.catalog.visits and getattr(rule, name) is not None:
            warn(f"rule.{name} replaces the number of visits of all targets ({visits})")
    if keys.output.replan:
        return SurveyState.read(keys.output.folder, targets, rule=rule, visits=visits, tiles=given["tiles"])
    if not keys.rule:
        return visits
    return rule if visits is None or rule.visits is not None else replace(rule, visits=visits)


def _requested(keys) -> int | np.ndarray | Cadences | None:
    """Return the requested visits: cadences, one number, or the numbers in a table that the plan of a survey wrote."""
    if keys.cadences is not None:
        return Cadences(keys.cadences)
    path = keys.catalog.visits_table
    return keys.catalog.visits if path is None else np.asarray(read_table(path)["visits"])


def tiles_of(tiling: Tiling | None, targets, model: Instrument) -> Tiling:
    """Return the given tiles; if no tiles are given, return tiles that cover the catalog twice."""
    if tiling is not None:
        warn_of_targets(tiling, len(targets))
        return tiling
    if isinstance(targets, PartitionedCatalog):
        raise InputError(
            "--tiles must be given for a partitioned catalog: make a table of tiles with rfpsurvey tile --region"
        )
    return place_tiles(targets, model, passes=2)


def allocator_of(options: dict, joint: dict) -> AllocationOptions | JointOptions:
    """Return the parameter ``allocator`` of `plan_survey` for the keys of the allocator and of a joint plan."""
    if options.get("allocator") == JOINT:
        first = AllocationOptions(**{**options, "allocator": JointOptions.allocator})
        return JointOptions(**joint, allocator=first)
    for name in joint:
        warn_no_effect(f"joint.{name}", "without --allocator joint")
    return AllocationOptions(**options)


def keys_in(folder: Path, given: Collection[str] = ()) -> SurveyKeys:
    """Return the keys in the plan file of a survey; parameters for which there is no key must be ``given``."""
    path, values = key_objects.survey_folder(folder), {}
    if path is None:
        raise InputError(f"{folder} does not hold a survey: there is no survey.json")
    key_objects.add_file(keys_of(SurveyKeys), values, path / key_objects.RECORD)
    keys = build(SurveyKeys, values | {"output.folder": str(path)})
    if lacking := [name for name in keys.python or () if name not in given]:
        raise InputError(
            f"{listed(lacking)} must be given as in the first plan, because the plan file of {folder} cannot contain "
            "what was given in Python"
        )
    return keys


def state_in(folder: Path, *, tell: Callable[[str], None] = no_output, **given: object) -> SurveyState:
    """Return the state of the survey in a folder for the catalog, the rule and the visits in its plan file.

    ``given`` contains values in place of them, and ``until`` (see `SurveyState.read`).
    """
    keys = keys_in(folder, {"allocator", "instrument", "tiles", *given})
    catalog = given.pop("catalog", None)
    if catalog is None:
        catalog = targets_of(keys, _model_in(keys), tell=tell)
    rule = given.pop("rule") if "rule" in given else VisitRule(**keys.rule)
    visits = given.pop("visits") if "visits" in given else _requested(keys)
    tiling = partial(key_objects.tiling_of, keys)  # only some states require the tiles
    tiles = tiling() if isinstance(visits, Cadences) else tiling
    return SurveyState.read(folder, catalog, rule=rule, visits=visits, tiles=tiles, **given)


def _model_in(keys: SurveyKeys) -> Instrument | None:
    """Return the instrument that is required to read the catalog of a survey; None if no key describes it."""
    if "instrument" in (keys.python or ()):
        return None
    return key_objects.model_of(keys.instrument, key_objects.any_time)


def call_of(keys: SurveyKeys, *, tell: Callable[[str], None] = no_output, **given: object) -> dict:
    """Return the parameters of `plan_survey` for keys; ``given`` contains parameters in place of those of the keys."""
    tiling = as_tiling(given["tiles"]) if "tiles" in given else key_objects.read_tiles(keys.tiles, tell=tell)
    if "instrument" in given:
        model = as_instrument(given["instrument"], may_be_dated=True)
    else:
        time = partial(key_objects.time_of_tiles, tiling, keys.epoch, keys.conditions)
        model = key_objects.model_of(keys.instrument, time, tell=tell)
    catalog = given["catalog"] if "catalog" in given else targets_of(keys, model, tell=tell)
    call = {name: getattr(keys, name) for name in ("epoch", "lost_in_collision", "order", "rng")} | given
    call |= {"catalog": catalog, "instrument": model, "passes": given.get("passes", keys.tiles.passes)}
    if "allocator" not in given:
        call["allocator"] = allocator_of(keys.options, keys.joint)
    of_visits = {name: call.pop(name) for name in ("rule", "visits") if name in given}
    call["visits"] = visits_of(keys, catalog, tiles=in_passes(tiling, call["passes"]), **of_visits)
    call["tiles"] = key_objects.tiles_under(tiles_of(tiling, catalog, model), keys.conditions)
    return call


def check_inputs(folder: Path, request: dict) -> None:
    """Raise an error if the catalog, the tiles or the instrument of the plan file differ from a recorded request."""
    keys = keys_in(folder, ("allocator", "instrument", "visits", "rule"))
    tiling, model = key_objects.read_tiles(keys.tiles), None
    if "instrument" not in (keys.python or ()):
        model = key_objects.model_of(
            keys.instrument, partial(key_objects.time_of_tiles, tiling, keys.epoch, keys.conditions)
        )
        present = f"{model.name}, digest {model.provenance['digest']}"
        if present != request.get("instrument"):
            raise InputError(f"{folder / key_objects.RECORD} must name the instrument of survey.json, got {present}")
    catalog = targets_of(keys, model)
    rule = VisitRule() if "rule" in (keys.python or ()) else VisitRule(**keys.rule)
    check_first_catalog(request, catalog, None if keys.cadences else _requested(keys), rule)
    if tiling is None:
        return
    tiling = in_passes(key_objects.tiles_under(tiling, keys.conditions), keys.tiles.passes)
    recorded, digest_of = request.get("first", request).get("tiles"), partial(tiles_digest, tiling)
    conditions = conditions_of_tiles(tiling)
    if recorded != digest_of(conditions) and recorded != digest_of(conditions, dates=True):
        text = f"must name the tiles of the first plan, {recorded}, got {digest_of(conditions)}"
        raise InputError(f"{folder / key_objects.RECORD} {text}")


def write_call(request, call: dict, folder: Path, place: Path) -> None:
    """Write the plan file of a survey to the folder ``place``, for the parameters of `plan_survey` in ``call``.

    This is another folder than that of the survey until a new plan replaces the present plan. Inputs that no other file
    describes are written to the folder of the survey.
    """
    text_of = key_objects.PLAN_FILE.get()
    if text_of is None:
        values, lacking = _values_of(request, call, folder.resolve() / key_objects.INPUTS)
        values |= {"python": lacking} if lacking else {}
        tables = ("options",) if request.joint is None else ("options", "joint")
        text_of = partial(key_objects.Given("survey", keys_of(SurveyKeys), values).record, tables=tables)
    text = text_of(folder)
    write_bytes(place / key_objects.RECORD, text.encode(), sync=True)
    for path in (folder / key_objects.INPUTS).glob("*") if place == folder else ():
        if path.name not in text:
            path.unlink()


def _values_of(request, call: dict, place: Path) -> tuple[dict, list[str]]:
    """Return the values of the keys for the parameters of `plan_survey`, and the parameters for which there is none."""
    lacking, visits, rule = [], call["visits"], None
    values = {"rng": request.seed, "order": request.order, "lost_in_collision": request.lost_in_collision}
    if (epoch := call["epoch"]) is not None:
        values["epoch"] = key_types.time_text(epoch) if isinstance(epoch, Time) else request.epoch
    values |= {} if call["passes"] is None else {"tiles.passes": request.first[1]}
    origin = request.given.origin
    if origin is None:
        origin = {"path": _stored(place, "catalog.fits", partial(write_exactly, request.given)), "hdu": EXACT}
    values |= {f"catalog.{name}": value for name, value in origin.items() if value}
    if isinstance(visits, SurveyState):
        rule, visits = visits.rule, visits.given[1]
    elif isinstance(visits, VisitRule):
        rule, visits = visits, None
    if isinstance(visits, Cadences):
        values["cadences"] = _stored(place, "cadences.ecsv", partial(write_table, visits.table))
        lacking += [] if visits.column == "cadence" else ["visits"]
    elif np.ndim(visits):
        table = QTable({"visits": np.asarray(visits)})
        values["catalog.visits_table"] = _stored(place, "visits.fits", partial(write_table, table))
    elif visits is not None:
        values["catalog.visits"] = int(visits)
    for values_of_parameter, name in (
        (_rule_values(rule, place), "rule"),
        (_allocator_values(call["allocator"]), "allocator"),
        (_instrument_values(call["instrument"], place), "instrument"),
    ):
        values |= {LACKING[name]: GIVEN} if values_of_parameter is None else values_of_parameter
        lacking += [name] if values_of_parameter is None else []
    values["tiles.path"] = _stored(place, "tiles.ecsv", partial(_write_tiles, as_tiling(call["tiles"])))
    return values, lacking


def _stored(place: Path, name: str, write: Callable[[Path], None]) -> str:
    """Write an input that no other file describes, and return its path, which contains a checksum of its content."""
    path = place / name
    with written(place):
        place.mkdir(exist_ok=True)
        write(path, overwrite=True)
        with path.open("rb") as file:
            checksum = hashlib.file_digest(file, "sha256").hexdigest()[:16]
        return str(path.rename(path.with_stem(f"{path.stem}-{checksum}")))


def _write_tiles(tiling: Tiling, path: Path, *, overwrite: bool) -> None:
    """Write the columns of a tiling that surveys use."""
    names = [name for name in tiling.table.colnames if name.lower() in TILING_COLUMNS]
    meta = {name: tiling.table.meta[name] for name in ("conditions", "summary") if name in tiling.table.meta}
    write_table(QTable(tiling.table[names], meta=meta), path, overwrite=overwrite)


def _rule_values(rule: VisitRule | None, place: Path) -> dict | None:
    """Return the values of the keys of a rule; None if its function has no name."""
    values = {} if rule is None else {f"rule.{k}": v for k in _named(rule) if (v := getattr(rule, k)) is not None}
    if callable(values.get("rule.function")):
        return None
    if isinstance(table := values.get("rule.table"), Table):
        values["rule.table"] = _stored(place, "rule.ecsv", partial(write_table, table))
    elif table is not None:
        values["rule.table"] = str(Path(table).resolve())
    return values


def _allocator_values(given: object) -> dict | None:
    """Return the values of the keys of an allocator; None if they do not determine it."""
    options, joint = as_joint(given, "color")
    values = {f"options.{name}": _text_of(getattr(options, name)) for name in _named(options)}
    if joint is not None:
        names = [name for name in _named(joint) if name not in ("allocator", "inform")]
        values |= {"options.allocator": JOINT, **{f"joint.{name}": _text_of(getattr(joint, name)) for name in names}}
    try:  # the values determine the allocator if the same options follow from them
        keys = build(SurveyKeys, values)
        again = as_joint(allocator_of(keys.options, keys.joint), "color")
    except InputError:
        return None
    return values if again == (options, joint and replace(joint, inform=None, allocator=options)) else None


def _named(settings: Settings) -> list[str]:
    """Return the names of the first option and of all options without their default values."""
    return [options_of(type(settings))[0].name, *settings.changed()]


def _text_of(value: object) -> object:
    """Return a value of an option as a key has it."""
    if isinstance(value, u.Quantity):
        return f"{float(value.value)!r} {value.unit}"
    if isinstance(value, Survey):
        return str(value.folder)
    if isinstance(value, tuple):
        return [circle_text(item) if isinstance(item, Region) else str(item) for item in value]
    return value if isinstance(value, bool | int | float | str) else str(name_of(value) if callable(value) else value)


def _instrument_values(given: Instrument | str | os.PathLike, place: Path) -> dict | None:
    """Return the values of the keys of an instrument; None if no file can describe it."""
    if isinstance(given, str) and given in available_instruments():
        return {"instrument.name": given}
    if not isinstance(given, Instrument):
        return {"instrument.name": str(Path(given).resolve())}
    preset, arm_model = {"instrument.name": given.name}, given.focal_plane.positioner.arm_model
    candidates = [preset, preset | {"instrument.arm_model": arm_model}] if given.name in available_instruments() else []
    for values in candidates:
        if key_objects.model_of(build(SurveyKeys, values).instrument).provenance == given.provenance:
            return values
    try:
        path = _stored(place, "instrument.ecsv", given.write)
        return {"instrument.name": path} if Instrument.read(path).provenance == given.provenance else None
    except InputError:
        return None
