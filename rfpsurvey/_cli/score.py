"""The command ``rfpsurvey score``."""

from dataclasses import dataclass, replace
from typing import Annotated

import astropy.units as u
from astropy.time import Time

import rfpsurvey as rs
from rfpsurvey import inputs
from rfpsurvey._cli import _app, _print
from rfpsurvey._cli._command import Given, command
from rfpsurvey.inputs import Located
from rfpsurvey.tile import north_of_date


@dataclass(frozen=True)
class AssignmentKeys(inputs.TableKeys):
    """The plan that is scored.

    Parameters
    ----------
    path : Path, optional
        Plan of another program, or a table with the positioner (or hole) and position of each target.
    columns : dict[str, str], optional
        Names of columns of the table by their roles, such as ra=RA_TARG.
    units : dict[str, str], optional
        Units of columns that have no unit, by role, such as ra=deg.
    hdu : str or int, optional
        Number or name (EXTNAME) of the table in a FITS file with several tables.
    """


@dataclass(frozen=True)
class ScoreInstrumentKeys(inputs.StateKeys):
    """The instrument of the plan.

    Parameters
    ----------
    name : str, optional
        Instrument: the name of a preset, the path of a TOML file, or the path of the calibration files of a real
        instrument. By default, the instrument named in the plan or tile is used.
    """

    name: Annotated[str | None, Located] = None


@dataclass(frozen=True, kw_only=True)
class ScoreKeys:
    """The keys of the command.

    Parameters
    ----------
    center : str, optional
        Field center (ICRS). By default, the values racen and deccen in the columns or the header of the table.
    position_angle : Quantity, optional
        Position angle. By default, the value position_angle in the columns or the header of the table.
    positions : str, optional
        Target positions to use: focal_plane or sky.
    missing : str, optional
        Treatment of assigned rows without a position: refuse, or skip (score the other rows).
    parked_obstacles : bool, optional
        Whether parked arms of idle positioners are obstacles, if both arms of a positioner are equally long.
    """

    catalog: AssignmentKeys
    instrument: ScoreInstrumentKeys
    options: inputs.ConstraintKeys
    output: inputs.TableOutputKeys
    center: str | None = None
    position_angle: u.Quantity[u.deg] | None = None
    equinox: inputs.Equinox = None
    epoch: inputs.Epoch = None
    positions: str | None = None
    missing: str = "refuse"
    parked_obstacles: bool = True


@command(
    ScoreKeys,
    "instrument.name center position_angle epoch positions missing options.constraints options.rules catalog.select "
    "catalog.columns output.path output.plot output.report output.overwrite",
    argument="catalog.path",
)
def score(keys: ScoreKeys, _: Given) -> None:
    r"""Find the collisions in an assignment that was made by another program.

    Examples
    --------
    rfpsurvey score confSummary-26.par.gz
    rfpsurvey score confSummary-26.par.gz --instrument sloanFlatCMM
    rfpsurvey score plan.ecsv --instrument sdss_apo
    rfpsurvey score designs.ecsv --instrument sdss_lco \
        --set catalog.select.design_id=503246 --set equinox=J2022.0
    rfpsurvey score tile.fits --constraint sky=20/spectrograph
    """
    path = keys.catalog.path
    if path is None:
        raise rs.InputError("catalog.path must be given: the file of the plan to score")
    _app.check_outputs(keys.output, (path, keys.instrument.name, keys.instrument.broken))
    table = _app.read_assignment(keys.catalog)
    options = {name: getattr(keys, name) for name in ("positions", "epoch", "missing", "parked_obstacles")}
    if keys.center is None:
        options["equinox"] = keys.equinox
    else:
        options["center"] = north_of_date(_app.parse_center(keys.center), keys.equinox)
    options["position_angle"] = keys.position_angle
    options |= {"columns": keys.catalog.columns or {}, "units": _app.units_of(path, keys.catalog.units)}

    def read(name: str) -> "rs.Instrument":
        return _app.model_of(replace(keys.instrument, name=name), lambda: _time_of(table, keys.epoch))

    model = _app.instrument_of(table, keys.instrument.name, read)
    constraints = keys.options.constraints
    if keys.options.rules is not None:
        constraints = [*(constraints or ()), *model.rules(keys.options.rules)]
    tile = rs.score_tile(table, model, **options, constraints=constraints)
    _print.finish(tile, keys.output)
    _print.print_text(f"columns: {tile.provenance['catalog']['columns']}")


def _time_of(table, epoch: object) -> Time | None:
    """Return the time of the observing conditions that a tile records or, without such a time, the epoch."""
    provenance = table.meta.get("provenance")
    recorded = provenance.get("parameters", {}).get("conditions") if isinstance(provenance, dict) else None
    return inputs.time_of(None if recorded is None else rs.ObservingConditions.from_record(recorded), epoch)
