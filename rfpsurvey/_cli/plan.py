"""The command ``rfpsurvey plan``."""

import sys
from dataclasses import dataclass
from pathlib import Path

import astropy.units as u
import typer

import rfpsurvey as rs
from rfpsurvey import inputs
from rfpsurvey._cli import _app, _print
from rfpsurvey._cli._command import command
from rfpsurvey.allocation import end_on_interrupt
from rfpsurvey.tile import north_of_date


@dataclass(frozen=True)
class PlanOutputKeys(inputs.TableOutputKeys):
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
        selects the fastest model that is accurate enough. The default is full if observing conditions are given, and
        radial otherwise.
    """

    catalog: inputs.CatalogKeys
    instrument: inputs.InstrumentKeys
    options: inputs.Options
    conditions: inputs.Conditions
    output: PlanOutputKeys
    center: inputs.Center = None
    position_angle: inputs.PositionAngle = 0 * u.deg
    equinox: inputs.Equinox = None
    epoch: inputs.Epoch = None
    projection: str | None = None
    rng: inputs.Seed = 0


@command(
    PlanKeys,
    "instrument.name center position_angle epoch options.allocator options.constraints options.rules rng "
    "catalog.columns output.path output.plot output.report output.overwrite",
    argument="catalog.path",
)
def plan(keys: PlanKeys, given) -> None:
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
    conditions = inputs.conditions_of(keys.conditions)
    paths = (keys.catalog.path, keys.instrument.name, keys.instrument.broken, keys.conditions.get("path"))
    _app.check_outputs(keys.output, paths)
    _app.check_targets(keys.output)
    model = _app.model_of(keys.instrument, lambda: inputs.time_of(conditions, keys.epoch))
    catalog = inputs.with_columns_of_rules(keys.catalog, keys.options, model)
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
