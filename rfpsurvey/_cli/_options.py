"""Command-line options and arguments that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

from rfpsurvey import tiling
from rfpsurvey._methods import help_of
from rfpsurvey.allocation import DEFAULT_ALLOCATOR, METHODS
from rfpsurvey.errors import InputError, listed

AVOIDING = listed(name for name, one in METHODS.items() if one.avoids_collisions)
SEARCHING = listed(name for name, one in METHODS.items() if one.searches)


def check_angle(value: float | None) -> float | None:
    """Return the position angle given with --pa (deg); raise an error if it is not between -360 and 360 deg."""
    if value is not None and not abs(value) <= 360:
        raise InputError(f"--pa must lie between -360 and 360 deg, got {value:g}")
    return value


CatalogArgument = Annotated[
    Path | None,
    typer.Argument(
        help="Catalog of targets: a file (FITS, ECSV, CSV, VOTable or Parquet), a folder of HEALPix "
        "partitions (HATS), or example:anticenter, a catalog that comes with the package. By default, "
        "Poisson-distributed targets are generated."
    ),
]
CenterOption = Annotated[
    str | None,
    typer.Option(
        help="Field center (ICRS): '95.1 23.0' (deg) or '06:20:24 +23:00:00'. By default, the field center "
        "is the mean direction of the targets in the catalog."
    ),
]
PaOption = Annotated[
    float,
    typer.Option(
        help="Position angle of the +y axis of the focal plane (deg), from north toward east.", callback=check_angle
    ),
]
SeedOption = Annotated[int, typer.Option(help="Seed of the random numbers.", min=0)]
FrameOption = Annotated[str, typer.Option(help="Frame of the coordinates in the catalog, such as icrs or galactic.")]
AllocatorOption = Annotated[
    str,
    typer.Option(help=f"Allocator: {help_of(METHODS)}, or an allocator of an installed package."),
]
RequireOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Number of targets of a kind that a tile must contain, KIND=NUMBER, such as sky_boss=300, or "
        "sky=20/spectrograph (20 for each spectrograph). The value instrument stands for all requirements of the "
        "instrument."
    ),
]
RequiredOption = Annotated[
    list[str] | None, typer.Option(help="Identifier of a target that takes precedence over all other targets.")
]
KeepOutOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Circle that no arm may cover, RA,DEC,RADIUS (deg, ICRS), such as 95.0,23.0,0.01. Allocators that avoid "
        f"collisions ({AVOIDING}) avoid the circle; with other allocators, an arm that covers the circle is counted as "
        "a collision."
    ),
]
SkyOption = Annotated[
    float | None, typer.Option(help="Use positions at least this far (arcsec) from all targets as sky positions.")
]
ObjectiveOption = Annotated[
    str,
    typer.Option(
        help=f"For allocators that search ({SEARCHING}): priority (maximize the number of assigned targets of the "
        "highest priority, then of the next priority, etc.) or count (maximize the total number of assigned targets "
        "first)."
    ),
]
TimeLimitOption = Annotated[float, typer.Option(help=f"Time limit of allocators that search ({SEARCHING}) (s).")]
InstrumentOption = Annotated[
    str,
    typer.Option(
        help="Instrument: the name of a preset, the path of a TOML file, or the path of the calibration "
        "files of a real instrument."
    ),
]
ArmModelOption = Annotated[
    str | None,
    typer.Option(
        help="Arm model, the shape that is used to find collisions: elbow_to_tip, capsule, fiber_tip or outline. By "
        "default, the arm model of the instrument."
    ),
]
EquinoxOption = Annotated[
    str | None,
    typer.Option(help="Equinox of the north direction from which the position angle is measured, such as J2026.0."),
]
EpochOption = Annotated[
    str | None,
    typer.Option(
        help="Apply proper motions to move targets to this epoch, such as 2026.5 or 2026-07-01. The default is the "
        "time of the observing conditions; without such a time, targets are not moved."
    ),
]
ColumnOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Name of a column of the catalog and its role, ROLE=NAME; for example, id=star reads identifiers from "
        "the column star. The form priority=-rank reverses the sign of the column rank. The form epoch=J2016 "
        "sets one epoch for all rows."
    ),
]
KeepOption = Annotated[
    list[str] | None, typer.Option(help="Column of the catalog to include in the results, such as a magnitude.")
]
UnitOption = Annotated[
    list[str] | None, typer.Option(help="Unit of a column that has no unit, ROLE=UNIT, such as ra=deg.")
]
HduOption = Annotated[
    str | None,
    typer.Option(
        help="Number or name (EXTNAME) of the table to read from a FITS file with several tables. By default, the "
        "first table is read.",
    ),
]
FillOption = Annotated[
    list[str] | None,
    typer.Option(help="Value that replaces missing values of a column, ROLE=VALUE, such as priority=0 or visits=1."),
]
SubpriorityOption = Annotated[
    str | None,
    typer.Option(
        help="Order of the targets within each priority class: a seed for random subpriorities, or the name of a "
        "column that --keep includes. Random subpriorities depend only on the seed and on the identifiers of "
        "the targets."
    ),
]
ParkedOption = Annotated[
    bool,
    typer.Option(
        help="Treat the parked arms of idle positioners as obstacles, if both arms of a positioner are equally long."
    ),
]
OutputOption = Annotated[
    Path | None,
    typer.Option(help="Write the tile (.fits or .ecsv); only FITS files contain the outcomes of all targets."),
]
PlotOption = Annotated[Path | None, typer.Option(help="Plot the focal plane (.png, .pdf or .svg).")]
TargetsOption = Annotated[
    str | None,
    typer.Option(help="Include all targets of the field in --plot, colored by outcome, kind, category or priority."),
]
QualityOption = Annotated[
    Path | None,
    typer.Option(help="Plot the numbers of targets that are in reach, assigned and observed (.png, .pdf or .svg)."),
]
MapOption = Annotated[
    Path | None, typer.Option(help="Write the collision probability of each positioner (.fits or .ecsv).")
]
ReportOption = Annotated[
    Path | None, typer.Option(help="Write a report of the result as a self-contained page (.html).")
]
OverwriteOption = Annotated[bool, typer.Option(help="Replace existing files.")]

RegionOption = Annotated[
    str | None,
    typer.Option(
        help="Region: 'cap RA DEC RADIUS', 'box RA1 RA2 DEC1 DEC2', 'polygon RA DEC ...' (deg), or sky. With a "
        "catalog, only the targets inside the region are used."
    ),
]
ExcludeOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Region to exclude, in the form of --region; the targets and the area inside are ignored. The "
        "option may be repeated."
    ),
]
DeclinationOption = Annotated[
    tuple[float, float] | None,
    typer.Option(help="Lowest and highest declination of the center of a tile (deg).", metavar="LOW HIGH"),
]
RadiusOption = Annotated[
    float | None,
    typer.Option(
        help="Radius of a tile (deg), in place of the radius of the instrument. With this option, every "
        "fiber is assumed to reach every target of the tile."
    ),
]
TilingAllocatorOption = Annotated[
    str | None,
    typer.Option(
        help=f"Allocator that plans each tile, as in a survey: {listed(METHODS)}, or an allocator of an installed "
        f"package. The default is {DEFAULT_ALLOCATOR}; with --fibers or --radius, no allocator is used by default."
    ),
]
TilingPaOption = Annotated[
    float | None,
    typer.Option(
        help="Position angle of the +y axis of the focal plane (deg), from north toward east. By default, the "
        "position angles in the table of --centers are used, or 0 if the table has none.",
        callback=check_angle,
    ),
]
TilingMethodOption = Annotated[
    str,
    typer.Option(help=f"Method of placing tiles: {help_of(tiling.METHODS)}."),
]
PassesOption = Annotated[int, typer.Option(help="Number of passes, for methods that cover the field.")]
CompletenessOption = Annotated[
    float | None,
    typer.Option(help="Stop placing tiles when this fraction of the requested visits (0 to 1) is reached."),
]
FibersOption = Annotated[
    int | None,
    typer.Option(
        help="Largest number of targets per tile. Without --allocator, every fiber is assumed to reach every "
        "target of the field."
    ),
]
NTilesOption = Annotated[int | None, typer.Option(help="Largest number of tiles.")]
TilingOutputOption = Annotated[Path | None, typer.Option(help="Write the tiling (.fits or .ecsv).")]
ChartOption = Annotated[Path | None, typer.Option(help="Plot the comparison (.png, .pdf or .svg).")]
MapPlotOption = Annotated[
    Path | None, typer.Option(help="Plot the collision probability of each positioner (.png, .pdf or .svg).")
]
TilingPlotOption = Annotated[Path | None, typer.Option(help="Plot the tiles (.png, .pdf or .svg).")]
SurveyCatalogArgument = Annotated[
    Path | None,
    typer.Argument(
        help="Catalog of targets: a file (FITS, ECSV, CSV, VOTable or Parquet), a folder of HEALPix "
        "partitions (HATS), or example:anticenter, a catalog that comes with the package. By default, "
        "Poisson-distributed targets are generated in a circle with twice the radius of the field."
    ),
]
VisitsOption = Annotated[
    int | None,
    typer.Option(
        help="Number of visits that each target requires. By default, the number of visits in the catalog, or 1 if the "
        "catalog has no column of visits.",
        min=1,
    ),
]
SomePassesOption = Annotated[
    list[int] | None,
    typer.Option(
        "--pass",
        help="Pass of the tiling to plan. If the option is repeated, the passes are planned in the order of "
        "the options.",
    ),
]
LostOption = Annotated[
    bool,
    typer.Option(
        "--lost/--kept",
        help="If the positioner of a target collides, count the target as not observed (--lost, the default) or as "
        "observed (--kept).",
    ),
]
OrderOption = Annotated[
    str,
    typer.Option(
        help="Order in which tiles are planned. color: one pass after the other; tiles of a pass that do not "
        "overlap are planned in parallel. given: the order of the table. joint: all tiles together, with --allocator "
        f"{listed(name for name, one in METHODS.items() if one.plans_jointly)}."
    ),
]
FolderOption = Annotated[Path | None, typer.Option(help="Folder to which the finished tiles are written.")]
ResumeOption = Annotated[bool, typer.Option(help="Continue the unfinished survey in the folder given with --folder.")]
WorkersOption = Annotated[
    int, typer.Option(help="Number of parallel threads or processes. The result does not depend on this number.", min=1)
]
ProcessesOption = Annotated[bool, typer.Option("--processes", help="Use processes instead of threads.")]
SchedulerOption = Annotated[str | None, typer.Option(help="Address of a Dask scheduler, such as tcp://host:8786.")]
SurveyPlotOption = Annotated[
    Path | None, typer.Option(help="Plot the tiles on the sky and the completeness (.png, .pdf or .svg).")
]
SurveyQualityOption = Annotated[
    Path | None,
    typer.Option(
        help="Plot the numbers of visits per priority class, of targets per outcome, and of fibers per kind of "
        "target (.png, .pdf or .svg)."
    ),
]
DesignInstrumentOption = Annotated[
    str | None,
    typer.Option(
        help="Instrument (preset or TOML file) whose design is varied. The values of this design replace the "
        "default values of the options below."
    ),
]
SpreadOption = Annotated[
    float | None,
    typer.Option(
        help="With --instrument, vary the central arm, the ratio of the arms and the pitch by up to this "
        "fraction of their values. By default, 0.15."
    ),
]
CentralArmOption = Annotated[
    str | None,
    typer.Option(
        help="Length of the central arm (mm): a number such as 8.25, a list such as 7,8,9, a grid such as "
        "7:9:5 (five values from 7 to 9), or limits LOW:HIGH with --n-designs. By default, 8.25."
    ),
]
RatioOption = Annotated[
    str | None,
    typer.Option(
        help="Ratio of the length of the eccentric arm to the length of the central arm, in one of the forms of "
        "--central-arm. The default range is 1 to 2."
    ),
]
PitchOption = Annotated[
    str | None,
    typer.Option(
        help="Distance between the centers of adjacent positioners (mm), in one of the forms of "
        "--central-arm. The default range is 24 to 34."
    ),
]
ClearanceOption = Annotated[
    str | None,
    typer.Option(
        help="Clearance, which is the width of the margin around each eccentric arm (mm), in one of the forms of "
        "--central-arm. By default, 2.25."
    ),
]
NDesignsOption = Annotated[
    int | None,
    typer.Option(
        help="Number of designs, which are Sobol points between the limits LOW and HIGH of each parameter. Without "
        "this option, a grid is scanned."
    ),
]
EstimandOption = Annotated[
    str | None,
    typer.Option(
        help="Definition of the fraction of fibers lost to collisions. independent: fibers that collide if "
        "their targets are independent and random. allocated: fibers that collide after allocation. "
        "collision_free: fibers that are idle if no collision is allowed."
    ),
]
EachOption = Annotated[float | None, typer.Option(help="Number of targets per positioner. By default, 4.")]
DensityOption = Annotated[
    float | None, typer.Option(help="Number of targets per mm^2, in place of --targets-per-positioner.")
]
SkiesOption = Annotated[
    int,
    typer.Option(
        help="Number of random realizations of the targets over which the fraction of lost fibers is averaged."
    ),
]
DesignObjectiveOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Objective of the Pareto front, COLUMN=max or COLUMN=min; give this option twice. By default, the "
        "objectives are coverage=max and loss=min."
    ),
]
DesignOutputOption = Annotated[
    Path | None, typer.Option(help="Write the finished designs to this file (.fits or .ecsv).")
]
DesignResumeOption = Annotated[bool, typer.Option(help="Continue the unfinished scan in the file given with --output.")]
DesignPlotOption = Annotated[Path | None, typer.Option(help="Plot the Pareto front (.png, .pdf or .svg).")]
