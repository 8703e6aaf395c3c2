"""The commands ``rfpsurvey plan``, ``probability`` and ``instruments``."""

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import astropy.units as u
import typer

import rfpsurvey as rs
from rfpsurvey._assignment.clock import end_on_interrupt
from rfpsurvey._cli import command as _app
from rfpsurvey._cli import results as _results
from rfpsurvey._cli.command import command
from rfpsurvey._cli.results import is_verbose, print_text
from rfpsurvey._common.executors import released
from rfpsurvey._field.recorded import north_of_date
from rfpsurvey._instruments.facts import arm_classes, fact_texts
from rfpsurvey._instruments.instrument import Instrument, every_instrument
from rfpsurvey._sky.catalog_files import is_example
from rfpsurvey._studies.methods import METHODS
from rfpsurvey._studies.simulate import QUEUEING
from rfpsurvey._studies.targets import Precision, RandomTargets
from rfpsurvey._survey import key_groups, key_objects
from rfpsurvey._survey.key_types import Located, Part
from rfpsurvey.errors import InputError, listed


@dataclass(frozen=True)
class PlanOutputKeys(key_groups.TableOutputKeys):
    """The files that the command writes.

    Parameters
    ----------
    path : Path, optional
        Write the tile (.fits or .ecsv); only FITS files contain the outcomes of all targets.
    quality : Path, optional
        Plot the numbers of targets that are in reach, assigned and observed (.png, .pdf or .svg).
    targets : str, optional
        Include all targets of the field in the plot, colored by outcome, kind, category or priority.
    """

    quality: Path | None = None
    targets: str | None = None


@dataclass(frozen=True, kw_only=True)
class PlanKeys:
    """The keys of the command.

    Parameters
    ----------
    projection : str, optional
        Model of the projection onto the focal plane: tangent, radial, refraction, dispersion, full, or auto, which
        selects the fastest model that is accurate enough. The default is conditions.projection if observing conditions
        are given, and radial otherwise.
    """

    catalog: key_groups.CatalogKeys
    instrument: key_groups.InstrumentKeys
    options: key_groups.Options
    conditions: key_groups.Conditions
    output: PlanOutputKeys
    center: key_groups.Center = None
    position_angle: key_groups.PositionAngle = 0 * u.deg
    equinox: key_groups.Equinox = None
    epoch: key_groups.Epoch = None
    projection: str | None = None
    rng: key_groups.Seed = 0


@command(
    PlanKeys,
    "instrument.name center position_angle epoch options.allocator options.constraints options.rules rng "
    "catalog.columns output.path output.plot output.report output.overwrite",
    argument="catalog.path",
    strict=True,
)
def plan(keys: PlanKeys, given) -> list[str]:
    r"""Assign the targets of a field to fibers, and find the arms that collide.

    Examples
    --------
    rfpsurvey plan
    rfpsurvey plan example:anticenter --center "95 23" --epoch 2026.5
    rfpsurvey plan stars.fits --center "06h20m00s +23d00m00s" \
        --output tile.fits --plot tile.png
    rfpsurvey plan stars.fits --output tile.fits --report tile.html
    rfpsurvey plan stars.fits --plot tile.png --set output.targets=outcome \
        --set output.quality=quality.png
    rfpsurvey plan stars.csv --instrument sdss_apo --center "95.0 23.0" \
        --position-angle 40 --set equinox=J2026.0
    rfpsurvey plan stars.fits --allocator optimal --constraint sky=20 \
        --set options.sky_separation=10
    rfpsurvey plan stars.fits --constraint "required 4711" \
        --constraint "keep_out 95.0 23.1 0.01"
    rfpsurvey plan stars.fits --center "95 23" --write-plan plan.toml
    rfpsurvey plan plan.toml --output tile.fits
    """
    conditions = key_objects.conditions_of(keys.conditions)
    paths = (keys.catalog.path, keys.instrument.name, keys.instrument.broken, keys.conditions.get("path"))
    _app.check_outputs(keys.output, paths)
    _app.check_targets(keys.output)
    model = _app.model_of(keys.instrument, lambda: key_objects.time_of(conditions, keys.epoch))
    catalog = key_objects.with_columns_of_rules(keys.catalog, keys.options, model)
    sky, field = _app.targets_and_center(catalog, keys.center, model, keys.rng)
    if field is None and keys.equinox is not None:
        field = sky.mean_direction
    _app.check_targets(keys.output, sky)
    options = rs.AllocationOptions(**keys.options)
    _app.check_text(sky, model, field, keys.output.path)
    with _app.seed_of(keys.catalog.path), end_on_interrupt() as interrupted:
        tile = rs.plan_tile(
            sky,
            model,
            north_of_date(field, keys.equinox),
            position_angle=keys.position_angle,
            epoch=keys.epoch,
            allocator=options,
            conditions=conditions,
            projection=keys.projection,
            progress=options.method.searches and sys.stderr.isatty(),
            rng=keys.rng,
        )
        ended_early = interrupted.is_set()
    if ended_early:
        print(
            "rfpsurvey: interrupted; the output is the best plan that was found before the interruption",
            file=sys.stderr,
        )
    folder = Path() if keys.output.path is None else keys.output.path.parent
    tile.provenance["plan_file"] = given.record(folder, outputs=("output.path",))
    _results.finish(tile, keys.output)
    if ended_early:
        raise typer.Exit(130)
    return tile.summary["unmet"]


@dataclass(frozen=True)
class TargetsKeys:
    """Further keys of targets.

    Parameters
    ----------
    kind : str, optional
        Targets: uniform, poisson or poisson_disc for random targets, or a catalog, such as example:anticenter.
    """

    kind: Annotated[str, Located] = "uniform"


@dataclass(frozen=True, kw_only=True)
class ProbabilityKeys:
    """The keys of the command.

    Parameters
    ----------
    estimand : str, optional
        Definition of the collision probability, for the method auto: allocated (an allocator assigns the targets; the
        default) or independent (each positioner draws its own target).
    allocator : str, optional
        Allocator that assigns the targets.
    density : str, optional
        Probability density of independent targets in the patrol area: uniform; shared (proportional to 1/k at points
        that k positioners reach); or voronoi (uniform over the points that are nearer to the center of the positioner
        than to any other center).
    dynamic : float, optional
        Probability that a positioner does not reach its target, for example because of a dynamic collision. Such
        failures are assumed to be independent.
    """

    instrument: key_groups.InstrumentKeys
    targets: Annotated[dict, Part(RandomTargets, TargetsKeys)]
    catalog: key_groups.CatalogKeys
    precision: Annotated[dict, Part(Precision)]
    output: key_groups.TableOutputKeys
    method: Annotated[
        str,
        f"Method: {listed(METHODS)}, a method of an installed package, or auto, which selects the fastest method with "
        "an error estimate.",
    ] = "auto"
    estimand: str | None = None
    allocator: str = QUEUEING
    density: str | None = None
    dynamic: float = 0.0
    rng: key_groups.Seed = 0
    workers: key_groups.Workers = 1


@command(
    ProbabilityKeys,
    "method estimand precision.standard_error precision.max_iterations targets.kind allocator density rng workers "
    "output.path output.plot output.report output.overwrite",
    argument="instrument.name",
)
def probability(keys: ProbabilityKeys) -> None:
    r"""Estimate the probability that arms collide, with a confidence interval.

    Examples
    --------
    rfpsurvey probability lamost
    rfpsurvey probability sdss_apo --method monte_carlo --precision 0.002 \
        --workers 2
    rfpsurvey probability moons --estimand independent --density shared
    rfpsurvey probability lamost --targets stars.fits --output map.fits \
        --plot map.png
    """
    kind = keys.targets.get("kind")
    _app.check_outputs(keys.output, (kind, keys.instrument.name, keys.instrument.broken))
    model = _app.model_of(keys.instrument)
    options = {name: getattr(keys, name) for name in ("method", "estimand", "allocator", "density", "dynamic", "rng")}
    options |= {"precision": Precision(**keys.precision), "targets": _targets(keys.catalog, **keys.targets)}
    with released(ThreadPoolExecutor(keys.workers)) as executor:
        options |= {"executor": executor, "progress": sys.stderr.isatty()}
        estimate = rs.collision_probability(model, **options)
    _results.finish_estimate(estimate, model, keys.output)


def _targets(catalog, kind: str = "uniform", **options):
    """Return random targets if ``kind`` is a kind of random targets; otherwise, read a catalog."""
    if not (Path(kind).suffix or is_example(kind)):
        key_objects.warn_without_catalog(catalog)
        return RandomTargets(kind, **options)
    for name in options:
        raise rs.InputError(f"targets.{name} can be used only with random targets, but a catalog was given")
    return _app.read_catalog(replace(catalog, path=Path(kind)))


@dataclass(frozen=True, kw_only=True)
class InstrumentsKeys:
    """The keys of the command.

    Parameters
    ----------
    instruments : list[str], optional
        Names of presets, or paths of TOML files; if several are given, the instruments are compared. By default, all
        presets are listed.
    """

    instruments: Annotated[list[str] | None, Located] = None
    instrument: key_groups.StateKeys


@command(
    InstrumentsKeys,
    "instrument.arm_model instrument.broken instrument.state_time",
    argument="instruments",
)
def instruments(keys: InstrumentsKeys) -> None:
    """List all instruments, describe one instrument with the source of every value, or compare several instruments.

    Examples
    --------
    rfpsurvey instruments
    rfpsurvey instruments lamost --verbose
    rfpsurvey instruments lamost sdss_apo mine.toml
    """
    names = keys.instruments or []
    if keys.instrument.broken is not None and len(names) != 1:
        raise InputError("--broken must be used with the name or path of one instrument")
    models = [_app.model_of(key_groups.InstrumentKeys(**vars(keys.instrument), name=name)) for name in names]
    if not models:
        _print_list()
    elif len(models) == 1:
        _print_instrument(models[0])
    else:
        _print_columns(models)


RESULT = ("fibers", "field radius", "pitch", "central arm", "eccentric arm", "min separation", "collision type")
RESULT += ("coverage", "multiplicity")
"""Facts of an instrument that are printed without --verbose."""


def _print_list() -> None:
    print(f"{'name':<10}{'positioners':>12}{'type':>6}{'field':>11}  title")
    for known, model in every_instrument().items():
        kind, field = model.focal_plane.collision_type, f"{2 * model.field_radius.to_value('deg'):.3f} deg"
        print_text(f"{known:<10}{len(model.focal_plane):>12}{kind:>6}{field:>11}  {model.title}", " " * 41)


def _print_instrument(model: Instrument) -> None:
    """Print the description of an instrument, quantities derived from its design, and the source of every value."""
    print_text(f"{model.name}: {model.title}" if model.title else model.name)
    print(f"{len(model.focal_plane)} positioners, layout {model.layout}")
    for paragraph in model.notes.strip().split("\n\n") if is_verbose() else ():
        print_text(paragraph, "")
        if paragraph:
            print()
    texts = _texts_of(model)
    for label in texts if is_verbose() else [label for label in RESULT if label in texts]:
        print_text(f"{label:<22}{texts[label]}", " " * 22)
    if not is_verbose():
        print("the sources of all values: --verbose")
        return
    print()
    for row in model.to_table():
        unit = f" in {row['unit']}" if row["unit"] and row["value"].endswith(" values") else f" {row['unit']}"
        print_text(f"{row['name']} = {row['value']}{unit}".rstrip(), "    ")
        print_text(f"    {row['status']}: {row['source']}", "        ")


def _texts_of(model: Instrument) -> dict[str, str]:
    """Return the labels and values of facts; the lengths of the arms in the facts are medians of all positioners."""
    return fact_texts(model.facts() | {"arms": arm_classes(model)})


def _print_columns(models: list[Instrument]) -> None:
    """Print a table that compares several instruments, with one column for each instrument."""
    columns = [_texts_of(model) for model in models]
    widths = [max(len(model.name), *map(len, texts.values())) for model, texts in zip(models, columns, strict=True)]
    rows = {"": [model.name for model in models]}
    rows |= {label: [texts[label] for texts in columns] for label in columns[0]}
    for label, texts in rows.items():
        cells = (f"{text:<{width}}" for text, width in zip(texts, widths, strict=True))
        print(f"{label:<22}{'  '.join(cells)}".rstrip())
