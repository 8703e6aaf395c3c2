"""The commands ``rfpsurvey compare``, ``compare-allocators`` and ``benchmark``."""

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import astropy.units as u
import typer

import rfpsurvey as rs
from rfpsurvey._cli import application as _main
from rfpsurvey._cli import command as _app
from rfpsurvey._cli import results as _results
from rfpsurvey._cli.command import command
from rfpsurvey._common.io import write_table
from rfpsurvey._field.recorded import north_of_date
from rfpsurvey._studies.compare_instruments import COMPARED, parts_of
from rfpsurvey._survey import key_groups, key_objects
from rfpsurvey._survey.key_objects import Given
from rfpsurvey._survey.key_types import Located
from rfpsurvey.errors import listed

RESULT = ("instrument", "allocator", "positioners", "targets", "assigned", "usable", "probability", "loss")
"""Columns of a comparison of instruments that are printed without --verbose."""


@dataclass(frozen=True, kw_only=True)
class CompareKeys:
    """The keys of the command.

    Parameters
    ----------
    instruments : list[str], optional
        Names of presets, or paths of TOML files. By default, all presets.
    targets_per_positioner : float, optional
        Number of synthetic targets per positioner. By default, 1.
    density : float, optional
        Number of synthetic targets per deg2, in place of the number per positioner.
    n_realizations : int, optional
        Number of synthetic fields per instrument. By default, 4.
    """

    instruments: Annotated[list[str] | None, Located] = None
    instrument: key_groups.StateKeys
    catalog: key_groups.CatalogKeys
    options: key_groups.OptionsOnly
    output: key_groups.TableOutputKeys
    center: key_groups.Center = None
    position_angle: key_groups.PositionAngle = 0 * u.deg
    epoch: key_groups.Epoch = None
    targets_per_positioner: float | None = None
    density: float | None = None
    n_realizations: int | None = None
    allocators: Annotated[
        list[str] | None, f"Allocators to compare. By default, the allocators {listed(COMPARED)} are used."
    ] = None
    rng: key_groups.Seed = 0
    workers: key_groups.Workers = 1


@command(
    CompareKeys,
    "catalog.path center position_angle epoch targets_per_positioner density n_realizations allocators "
    "options.constraints rng workers catalog.columns output.path output.plot output.report output.overwrite",
    argument="instruments",
)
def compare(keys: CompareKeys) -> None:
    r"""Compare the patrol areas, fibers and collisions of instruments, and the targets lost to collisions.

    Examples
    --------
    rfpsurvey compare
    rfpsurvey compare lamost design.toml --targets-per-positioner 2 \
        --plot comparison.png --output comparison.ecsv
    rfpsurvey compare sdss_apo moons --catalog stars.fits \
        --center "06h20m00s +23d00m00s" --allocator optimal
    rfpsurvey compare lamost desi pfs --density 1000 --n-realizations 2 \
        --report comparison.html
    """
    names, state = keys.instruments or [], keys.instrument
    _app.check_outputs(keys.output, (*names, keys.catalog.path, state.broken))
    if state.broken is not None and len(names) != 1:
        raise rs.InputError(
            "instrument.broken must be used with one instrument, because instruments have different identifiers; to "
            "compare several instruments, write TOML files with the entry layout.states"
        )
    if state.arm_model or state.margins:
        names = names or rs.available_instruments()
    named = [key_groups.InstrumentKeys(**vars(state), name=name) for name in names]
    models = [
        _app.model_of(instrument_keys, lambda: key_objects.time_of(None, keys.epoch)) for instrument_keys in named
    ]
    if keys.catalog.path is None:
        key_objects.warn_without_catalog(keys.catalog)
    with _results.workers(keys) as executor:
        table = rs.compare_instruments(
            "poisson" if keys.catalog.path is None else _app.read_catalog(keys.catalog),
            models or None,
            center=_app.parse_center(keys.center),
            allocators=keys.allocators or COMPARED,
            targets_per_positioner=keys.targets_per_positioner,
            density=None if keys.density is None else keys.density / u.deg**2,
            n_realizations=keys.n_realizations,
            rng=keys.rng,
            executor=executor,
            progress=sys.stderr.isatty(),
            options=rs.AllocationOptions(**keys.options),
            position_angle=keys.position_angle,
            epoch=keys.epoch,
        )
    with _results.files(
        keys.output,
        write=partial(write_table, table),
        draw=lambda: rs.plot.draw_instruments(table),
        report=(table, {"data": keys.output.path}),
    ):
        _print_comparison(table, with_margins=bool(state.margins))


def _print_comparison(table, *, with_margins: bool) -> None:
    """Print a comparison of instruments."""
    if not _results.is_verbose():
        _results.print_table(table[list(RESULT)])
        _results.print_text(f"{table.meta['way']}; numbers are per field; loss: fraction of fibers lost to collisions")
        return
    _results.print_text(table.meta["way"])
    for name, model in table.meta["instruments"].items() if with_margins else ():
        values = ", ".join(f"{key} {value:g}" for key, value in model.get("margins", {}).items())
        print(f"margins of {name}: {values or 'none'}")
    for title, part in parts_of(table).items():
        print(f"\n{title}")
        _results.print_table(part)
    print()
    _results.print_text(table.meta["comparable"], "")


@dataclass(frozen=True, kw_only=True)
class CompareAllocatorsKeys:
    """The keys of the command.

    Parameters
    ----------
    allocators : list[str], optional
        Allocators to compare. By default, all allocators are compared.
    """

    catalog: key_groups.CatalogKeys
    instrument: key_groups.InstrumentKeys
    options: key_groups.OptionsOnly
    output: key_groups.TableOutputKeys
    allocators: list[str] | None = None
    center: key_groups.Center = None
    position_angle: key_groups.PositionAngle = 0 * u.deg
    equinox: key_groups.Equinox = None
    epoch: key_groups.Epoch = None
    rng: key_groups.Seed = 0


@command(
    CompareAllocatorsKeys,
    "instrument.name center position_angle epoch allocators options.constraints rng catalog.columns output.path "
    "output.plot output.report output.overwrite",
    argument="catalog.path",
)
def compare_allocators(keys: CompareAllocatorsKeys, _: Given) -> None:
    r"""Compare allocators on the same field.

    Examples
    --------
    rfpsurvey compare-allocators
    rfpsurvey compare-allocators stars.fits --instrument moons \
        --plot allocators.png --report allocators.html
    rfpsurvey compare-allocators stars.fits --constraint sky=20 \
        --allocator network_flow --allocator optimal
    """
    _app.check_outputs(keys.output, (keys.catalog.path, keys.instrument.name, keys.instrument.broken))
    model = _app.model_of(keys.instrument, lambda: key_objects.time_of(None, keys.epoch))
    targets, field = _app.targets_and_center(keys.catalog, keys.center, model, keys.rng)
    with _app.seed_of(keys.catalog.path):
        table, plans = rs.compare_allocators(
            targets,
            model,
            north_of_date(field, keys.equinox),
            allocators=keys.allocators,
            options=rs.AllocationOptions(**keys.options),
            return_tiles=True,
            position_angle=keys.position_angle,
            epoch=keys.epoch,
            rng=keys.rng,
        )
    _results.finish_comparison(table, plans, keys.output)


benchmark = typer.Typer(
    no_args_is_help=True,
    help="Measure the speed and the errors of the methods that find collisions or estimate collision probabilities, "
    "for the arms of an instrument.",
)
_main.app.add_typer(benchmark, name="benchmark")
PLOT = "Plot (.png, .pdf or .svg); the table is written to the same folder."
OPTIONS = "instrument.name instrument.arm_model instrument.state_time repeats"
EXAMPLES = """\b
Examples:
  rfpsurvey benchmark collisions
  rfpsurvey benchmark collisions --instrument sdss_apo --method exact \\
      --method sampled --plot sdss.pdf
  rfpsurvey benchmark batches --instrument moons
  rfpsurvey benchmark probability --instrument moons --plot moons.png
"""
OUTPUT = " rng output.plot output.report output.overwrite"


@dataclass(frozen=True)
class CollisionsOutputKeys(key_groups.OutputKeys):
    """The files that the benchmark of collisions writes."""

    plot: Annotated[Path, PLOT] = Path("benchmark_collisions.png")


@dataclass(frozen=True)
class ProbabilityOutputKeys(key_groups.OutputKeys):
    """The files that the benchmark of probabilities writes."""

    plot: Annotated[Path, PLOT] = Path("benchmark_probability.png")


@dataclass(frozen=True, kw_only=True)
class CollisionsKeys:
    """The keys of the benchmark of collisions.

    Parameters
    ----------
    methods : list[str], optional
        Methods to compare. By default, all methods are compared.
    repeats : int, optional
        Maximum number of runs of each method.
    """

    instrument: key_groups.InstrumentKeys
    methods: list[str] | None = None
    repeats: int = 15
    rng: key_groups.Seed = 0
    output: CollisionsOutputKeys


@dataclass(frozen=True, kw_only=True)
class BatchesKeys:
    """The keys of the benchmark of batches.

    Parameters
    ----------
    repeats : int, optional
        Number of calls with the same settings; the median time is shown.
    """

    instrument: key_groups.InstrumentKeys
    repeats: int = 5


@dataclass(frozen=True, kw_only=True)
class ProbabilityKeys:
    """The keys of the benchmark of probabilities.

    Parameters
    ----------
    repeats : int, optional
        Number of runs with different random numbers, for each method and each number of iterations.
    """

    instrument: key_groups.InstrumentKeys
    repeats: int = 30
    rng: key_groups.Seed = 0
    output: ProbabilityOutputKeys


@command(CollisionsKeys, f"{OPTIONS} methods{OUTPUT}", app=benchmark, epilog=EXAMPLES)
def collisions(keys: CollisionsKeys) -> None:
    """Compare the speed and the errors of the methods of finding collisions."""
    output = _app.check_chart(keys.output)
    options = {"methods": keys.methods, "repeats": keys.repeats, "rng": keys.rng, "progress": sys.stderr.isatty()}
    table = rs.benchmark.benchmark_collisions(_app.model_of(keys.instrument), **options)
    _results.finish_table(table, rs.plot.plot_speed_accuracy, output)


@command(BatchesKeys, OPTIONS, app=benchmark, epilog=EXAMPLES)
def batches(keys: BatchesKeys) -> None:
    """Measure how long the CPU and, if available, a GPU take to count the collisions of many configurations."""
    _results.print_table(rs.benchmark.benchmark_batches(_app.model_of(keys.instrument), repeats=keys.repeats))


@command(ProbabilityKeys, OPTIONS + OUTPUT, app=benchmark, epilog=EXAMPLES)
def probability(keys: ProbabilityKeys) -> None:
    """Compare the time and the error of the methods that estimate collision probabilities.

    The command also prints the collision probability of independent targets for several probability densities of the
    targets in the patrol area. For each density, it prints the difference from the collision probability of allocated
    targets.
    """
    output = _app.check_chart(keys.output)
    model, options = _app.model_of(keys.instrument), {"rng": keys.rng}
    _results.print_table(rs.benchmark.benchmark_densities(model, **options))
    options |= {"repeats": keys.repeats, "progress": sys.stderr.isatty()}
    table = rs.benchmark.benchmark_probability(model, **options)
    _results.finish_table(table, rs.plot.plot_probability_accuracy, output)
