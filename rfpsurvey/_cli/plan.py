"""The command ``rfpsurvey plan``."""

import sys
from dataclasses import dataclass
from pathlib import Path

import astropy.units as u
import typer

import rfpsurvey as rs
from rfpsurvey._cli import _app, _conditions, _examples, _groups, _print
from rfpsurvey._cli._command import command
from rfpsurvey.allocation import end_on_interrupt
from rfpsurvey.tile import north_of_date


@dataclass(frozen=True)
class PlanOutputKeys(_groups.TableOutputKeys):
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

    path: Path | None = None
    quality: Path | None = None
    targets: str | None = None


@dataclass(frozen=True, kw_only=True)
class PlanKeys:
    """The keys of the command."""

    catalog: _groups.CatalogKeys
    instrument: _groups.InstrumentKeys
    options: _groups.Options
    conditions: _groups.Conditions
    output: PlanOutputKeys
    center: _groups.Center = None
    position_angle: _groups.PositionAngle = 0 * u.deg
    equinox: _groups.Equinox = None
    epoch: _groups.Epoch = None
    projection: _groups.Projection = None
    rng: _groups.Seed = 0


@command(
    PlanKeys,
    "instrument.name center position_angle epoch options.allocator options.constraints options.rules rng "
    "catalog.columns output.path output.plot output.report output.overwrite",
    argument="catalog.path",
    epilog=_examples.PLAN_EXAMPLES,
)
def plan(keys: PlanKeys, given) -> None:
    """Assign the targets of a field to fibers, and find the arms that collide."""
    conditions = _conditions.conditions_of(keys.conditions)
    inputs = (keys.catalog.path, keys.instrument.name, keys.instrument.broken, keys.conditions.get("path"))
    _app.check_outputs(keys.output, inputs)
    _app.check_targets(keys.output)
    model = _app.model_of(keys.instrument, lambda: _conditions.time_of(conditions, keys.epoch))
    catalog = _app.with_columns_of_rules(keys.catalog, keys.options, model)
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
    _print.finish(tile, keys.output)
    if ended_early:
        raise typer.Exit(130)
