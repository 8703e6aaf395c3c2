"""Keys that several commands share: the catalog, the instrument, tiles, options of allocators, and outputs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import astropy.units as u
from astropy.time import Time

from rfpsurvey._assignment.methods import METHODS
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._common.descriptions import help_of
from rfpsurvey._common.read_tables import parse_number
from rfpsurvey._common.settings import Option, option
from rfpsurvey._common.units import MOST_SEED
from rfpsurvey._instruments.margins import Margins
from rfpsurvey._sky.conditions import ObservingConditions
from rfpsurvey._survey.key_types import Located, Part
from rfpsurvey.errors import InputError, listed

AVOIDING = listed(name for name, method in METHODS.items() if method.avoids_collisions)
Text = str | int | float
Moment = str | float | Time | None


def margins_of_text(text: str) -> dict:
    """Return the keys of margins for a text such as ``instrument,broken=0.3``, ``outer=0.2`` or ``off``."""
    first, *rest = parts = [part.strip() for part in text.split(",")]
    values: dict[str, float | bool] = {"published": first == "instrument"} if first in ("off", "instrument") else {}
    for part in rest if values else parts:
        name, _, value = part.partition("=")
        try:
            number = parse_number(value)
        except ValueError:
            number = None
        if number is None or name in values or first == "off":
            raise InputError(
                "margins must be off, instrument, or NAME=VALUE with different names, separated by commas, such as "
                f"outer=0.2,inner=0.1 (lengths in mm), got {text!r}"
            )
        values[name] = number
    return values


@dataclass(frozen=True)
class TableKeys:
    """A table, and the names and units of its columns.

    Parameters
    ----------
    path : Path, optional
        Table of tiles or centers, with at least the columns ra and dec, or other usual names such as racen and deccen.
    columns : dict[str, str], optional
        Names of columns of the table by their roles: tile (the identifier), ra, dec, position_angle and pass.
    units : dict[str, str], optional
        Units of columns that have no unit, by role, such as ra=deg.
    hdu : str or int, optional
        Number or name (EXTNAME) of the table in a FITS file with several tables.
    select : dict[str, Text], optional
        Use only rows with these values of columns, such as resolution=L.
    """

    path: Path | None = None
    columns: dict[str, str] | None = None
    units: dict[str, str] | None = None
    hdu: str | int | None = None
    select: dict[str, Text] | None = None


@dataclass(frozen=True)
class CatalogKeys(TableKeys):
    """The catalog of targets.

    Parameters
    ----------
    path : Path, optional
        Catalog of targets: a file (FITS, ECSV, CSV, VOTable or Parquet), a folder of HEALPix partitions (HATS), or
        example:anticenter, a catalog that comes with the package. By default, Poisson-distributed targets are
        generated.
    columns : dict[str, str], optional
        Names of columns of the catalog by their roles; for example, id=star reads identifiers from the column star, and
        priority=-rank reverses the sign of the column rank.
    units : dict[str, str], optional
        Units of columns that have no unit, by role, such as ra=deg.
    hdu : str or int, optional
        Number or name (EXTNAME) of the table to read from a FITS file with several tables. By default, the first table
        is read.
    fill : dict[str, Text], optional
        Values that replace missing values of columns, by role, such as priority=0.
    keep : list[str], optional
        Columns of the catalog to include in the results, such as magnitudes.
    frame : str, optional
        Frame of the coordinates in the catalog, such as icrs or galactic.
    epoch : str or float, optional
        Epoch of all positions in the catalog, such as J2016, in place of a column.
    """

    fill: dict[str, Text] | None = None
    keep: list[str] | None = None
    frame: str = "icrs"
    epoch: str | float | None = None


@dataclass(frozen=True)
class SurveyCatalogKeys(CatalogKeys):
    """The catalog of targets of a survey.

    Parameters
    ----------
    visits : int, optional
        Number of visits that each target requires. By default, the number of visits in the catalog, or 1 if the catalog
        has no column of visits.
    visits_table : Path, optional
        Table with the column visits and a row for each target, in place of one number for all targets. Surveys that are
        planned in Python write it.
    """

    visits: int | None = option(None, low=1)
    visits_table: Path | None = None


@dataclass(frozen=True)
class MarginKeys:
    """Further keys of margins.

    Parameters
    ----------
    published : bool, optional
        Whether to start from the published margins of the instrument; if false, there are no margins.
    """

    published: bool | None = None


@dataclass(frozen=True)
class StateTimeKeys:
    """The time at which the positioners of an instrument are described.

    Parameters
    ----------
    state_time : Moment, optional
        Time (UTC) at which the states of positioners are evaluated, such as 2026-07-01T06:30:00. By default, the time
        of each tile or of the observing conditions or, without such a time, the key epoch.
    """

    state_time: Moment = None


@dataclass(frozen=True)
class StateKeys(StateTimeKeys):
    """The state of the positioners of an instrument.

    Parameters
    ----------
    arm_model : str, optional
        Arm model, the shape that is used to find collisions: elbow_to_tip, capsule, fiber_tip or outline. By default,
        the arm model of the instrument.
    broken : Path, optional
        Table of broken and stuck positioners (CSV, ECSV, FITS, VOTable or Parquet) with the column id and, optionally,
        the columns state (broken, stuck or ok), from and to (dates in UTC), theta and phi (deg).
    """

    arm_model: str | None = None
    broken: Path | None = None
    margins: Annotated[dict, Part(Margins, MarginKeys, from_text=margins_of_text)] = None


@dataclass(frozen=True)
class InstrumentKeys(StateKeys):
    """The instrument, and the state of its positioners.

    Parameters
    ----------
    name : str, optional
        Instrument: the name of a preset, the path of a TOML file, or the path of the calibration files of a real
        instrument.
    """

    name: Annotated[str, Located] = "lamost"


@dataclass(frozen=True)
class TilesKeys(TableKeys):
    """The tiles of a survey.

    Parameters
    ----------
    path : Path, optional
        Table of tiles or centers, with at least the columns ra and dec, or other usual names such as racen and deccen.
        By default, two hexagonal coverings of the catalog are used.
    passes : list[int], optional
        Passes of the tiling to plan, in this order. By default, all passes in ascending order.
    """

    passes: list[int] | None = None


@dataclass(frozen=True)
class ConstraintKeys:
    """Constraints as texts.

    Parameters
    ----------
    constraints : list[str], optional
        Constraints as texts: a number of targets of a kind such as 'sky=20/spectrograph', 'required ID' (a target that
        takes precedence over all others), 'keep_out RA DEC RADIUS' (deg, ICRS; a circle that no arm may cover),
        'motion paths' (arms have planned paths without collisions), 'motion fold' (arms do not collide while they
        unfold), a rule such as 'magnitude COLUMN BRIGHTEST FAINTEST', or a constraint of an installed package.
    rules : str, optional
        Name of rules of the instrument that are added to the constraints, such as dark_monit.
    """

    constraints: list[str] | None = None
    rules: str | None = None


@dataclass(frozen=True)
class AllocatorKeys(ConstraintKeys):
    """The allocator, and constraints as texts."""

    allocator: Annotated[str, f"Allocator: {help_of(METHODS)}, or an allocator of an installed package."] = (
        AllocationOptions.allocator
    )


@dataclass(frozen=True)
class SurveyAllocatorKeys(AllocatorKeys):
    """Keys of allocators of surveys."""

    allocator: Annotated[
        str, f"Allocator: {help_of(METHODS)}, joint (all tiles together), or an allocator of an installed package."
    ] = AllocationOptions.allocator


@dataclass(frozen=True)
class ConditionsKeys:
    """Further keys of observing conditions.

    Parameters
    ----------
    path : Path, optional
        TOML file with observing conditions, whose values are replaced by the other keys of this table.
    site : str or list of float, optional
        Site of the telescope: a name such as paranal, or longitude (deg), latitude (deg) and height (m).
    """

    path: Path | None = None
    site: str | list[float] | None = None


Options = Annotated[dict, Part(AllocationOptions, AllocatorKeys)]
SurveyOptions = Annotated[dict, Part(AllocationOptions, SurveyAllocatorKeys)]
OptionsOnly = Annotated[dict, Part(AllocationOptions, ConstraintKeys, omit=("allocator",))]
Conditions = Annotated[dict, Part(ObservingConditions, ConditionsKeys, from_text=lambda text: {"path": text})]
Seed = Annotated[int, "Seed of the random numbers.", Option(low=0, high=MOST_SEED - 1)]
Epoch = Annotated[
    str | float | Time | None,
    "Apply proper motions to move targets to this epoch, such as 2026.5 or 2026-07-01. The default is the time of the "
    "tile or of the observing conditions; without such a time, targets are not moved.",
]
Center = Annotated[
    str | None,
    "Field center (ICRS): '95.1 23.0' (deg) or '06:20:24 +23:00:00'. By default, the mean direction of the targets.",
]
PositionAngle = Annotated[
    u.Quantity[u.deg], "Position angle of the +y axis of the focal plane, from north toward east."
]
Equinox = Annotated[
    str | float | Time | None,
    "Equinox of the north direction from which the position angle is measured, such as J2026.0.",
]
Workers = Annotated[int, "Number of parallel workers. The result does not depend on this number.", Option(low=1)]
Processes = Annotated[bool, "Whether the workers are processes instead of threads."]
Lost = Annotated[
    bool, "Whether a target counts as not observed if the arm at this target collides, so that other tiles observe it."
]
Order = Annotated[
    str,
    "Order in which tiles are planned. color: one pass after the other; tiles of a pass that do not overlap are "
    "planned in parallel. given: the order of the table.",
]


@dataclass(frozen=True)
class WorkerKeys:
    """The workers that plan tiles.

    Parameters
    ----------
    scheduler : str, optional
        Address of a Dask scheduler, such as tcp://host:8786.
    """

    workers: Workers = 1
    processes: Processes = False
    scheduler: str | None = None


@dataclass(frozen=True)
class OutputKeys:
    """The files that a command writes.

    Parameters
    ----------
    report : Path, optional
        Write a report of the result as a self-contained page (.html).
    plot : Path, optional
        Plot the result (.png, .pdf or .svg).
    overwrite : bool, optional
        Replace existing files.
    """

    report: Path | None = None
    plot: Path | None = None
    overwrite: bool = False


@dataclass(frozen=True)
class FileKeys:
    """The file that a command writes.

    Parameters
    ----------
    path : Path, optional
        Write the result (.fits, .ecsv or .parquet).
    overwrite : bool, optional
        Replace existing files.
    """

    path: Path | None = None
    overwrite: bool = False


@dataclass(frozen=True)
class TableOutputKeys(OutputKeys):
    """The files that a command with one table writes.

    Parameters
    ----------
    path : Path, optional
        Write the result (.fits or .ecsv).
    """

    path: Path | None = None
