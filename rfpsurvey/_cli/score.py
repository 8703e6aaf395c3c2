"""The command ``rfpsurvey score``."""

from functools import partial
from pathlib import Path
from typing import Annotated

import astropy.units as u
import typer

import rfpsurvey as rs
from rfpsurvey._cli import _app, _examples, _main, _margins, _options, _states
from rfpsurvey.tile import north_of_date


@_main.app.command(epilog=_examples.SCORE_EXAMPLES)
def score(
    assignment: Annotated[
        Path,
        typer.Argument(
            help="Plan of another program, or a table with the positioner (or hole) and position of each target."
        ),
    ],
    instrument: Annotated[
        str | None,
        typer.Option(
            help="Instrument: the name of a preset, the path of a TOML file, or the path of the calibration "
            "files of a real instrument. By default, the instrument named in the plan or tile is used."
        ),
    ] = None,
    arm_model: _options.ArmModelOption = None,
    broken: _states.BrokenOption = None,
    state_time: _states.StateTimeOption = None,
    margins: _margins.MarginsOption = None,
    center: Annotated[
        str | None,
        typer.Option(
            help="Field center (ICRS). By default, the values racen and deccen in the columns or the header of the "
            "table are used."
        ),
    ] = None,
    pa: Annotated[
        float | None,
        typer.Option(
            help="Position angle (deg). By default, the value position_angle in the columns or the header of the "
            "table is used.",
            callback=_options.check_angle,
        ),
    ] = None,
    equinox: _options.EquinoxOption = None,
    epoch: _options.EpochOption = None,
    positions: Annotated[str | None, typer.Option(help="Target positions to use: focal_plane or sky.")] = None,
    select: Annotated[
        list[str] | None, typer.Option(help="Use only rows that have the given value in a column, COLUMN=VALUE.")
    ] = None,
    skip_missing: Annotated[
        bool, typer.Option("--skip-missing", help="Skip assigned rows that have no position, and score the other rows.")
    ] = False,
    parked: _options.ParkedOption = True,
    hdu: _options.HduOption = None,
    column: _options.ColumnOption = None,
    unit: _options.UnitOption = None,
    output: _options.OutputOption = None,
    plot: _options.PlotOption = None,
    report: _options.ReportOption = None,
    overwrite: _options.OverwriteOption = False,
) -> None:
    """Find the collisions in an assignment that was made by another program."""
    _app.check_outputs(output, plot, report, overwrite=overwrite, inputs=(assignment, instrument, broken))
    table = _app.read_assignment(assignment, select, hdu)
    options = {"positions": positions, "epoch": epoch, "parked_obstacles": parked}
    options["missing"] = "skip" if skip_missing else "refuse"
    if center is None:
        options["equinox"] = equinox
    else:
        options["center"] = north_of_date(_app.parse_center(center), equinox)
    options["position_angle"] = None if pa is None else pa * u.deg
    options.update(columns=_app.parse_pairs(column, "--column"), units=_app.units_of(assignment, unit))
    read = partial(
        _app.model_of,
        arm_model=arm_model,
        margins=margins,
        broken=broken,
        state_time=state_time,
        known_time=lambda: _time_of(table, epoch),
    )
    tile = rs.score_tile(table, _app.instrument_of(table, instrument, read), **options)
    print(f"columns: {tile.provenance['catalog']['columns']}")
    _app.finish(tile, output, plot, report, overwrite=overwrite)


def _time_of(table, epoch: str | None):
    """Return the time of the observing conditions that a tile records or, without such a time, of --epoch."""
    provenance = table.meta.get("provenance")
    recorded = provenance.get("parameters", {}).get("conditions") if isinstance(provenance, dict) else None
    return _states.time_of(None if recorded is None else rs.ObservingConditions.from_record(recorded), epoch)
