"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

from rfpsurvey.errors import InputError


def check_angle(value: float | None) -> float | None:
    """Return a position angle from the command line; raise an error if it exceeds a full rotation."""
    if value is not None and not abs(value) <= 360:
        raise InputError(f"--pa must lie between -360 and 360 deg, got {value:g}")
    return value


CatalogArgument = Annotated[
    Path | None,
    typer.Argument(
        help="FITS, ECSV, CSV, VOTable or Parquet, a folder of HEALPix partitions (HATS), or example:anticenter, whose "
        "stars come with the package. By default, a synthetic Poisson catalog."
    ),
]
CenterOption = Annotated[
    str | None,
    typer.Option(
        help="Field center (ICRS): '95.1 23.0' (deg) or '06:20:24 +23:00:00'. By default, the mean "
        "direction of the catalog."
    ),
]
PaOption = Annotated[
    float, typer.Option(help="Position angle of +y (deg), from north toward east.", callback=check_angle)
]
SeedOption = Annotated[int, typer.Option(help="Seed of the random numbers.", min=0)]
FrameOption = Annotated[str, typer.Option(help="Frame of the coordinates in the catalog.")]
AllocatorOption = Annotated[
    str,
    typer.Option(
        help="lamost, nearest, balanced (ignores priorities), sdss (network flow), optimal (proven, without "
        "collisions), repair (lamost, with collisions removed by local moves), or an allocator of an installed package."
    ),
]
RequireOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Number of targets that a tile must contain, KIND=NUMBER, such as sky=20/spectrograph or sky_boss=300. "
        "The word instrument stands for the requirements of the instrument."
    ),
]
RequiredOption = Annotated[
    list[str] | None, typer.Option(help="Identifier of a target that takes precedence over all other targets.")
]
KeepOutOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Circle that no arm may cover, RA,DEC,RADIUS (deg, ICRS), such as 95.0,23.0,0.01. The allocators "
        "repair and optimal avoid it; with other allocators, an arm that covers it is counted as a collision."
    ),
]
SkyOption = Annotated[
    float | None, typer.Option(help="Use positions at least this far (arcsec) from all targets as sky positions.")
]
ObjectiveOption = Annotated[
    str,
    typer.Option(
        help="For sdss and optimal: priority (maximize one priority after the other) or count (maximize "
        "the number of all targets first)."
    ),
]
TimeLimitOption = Annotated[float, typer.Option(help="Time limit of the search (s), for sdss and optimal.")]
InstrumentOption = Annotated[
    str, typer.Option(help="Name of a preset, or path of a TOML file or of an instrument as built.")
]
EquinoxOption = Annotated[
    str | None, typer.Option(help="Measure the position angle from north at this equinox, such as J2026.0.")
]
EpochOption = Annotated[str | None, typer.Option(help="Move targets to this epoch, such as 2026.5 or 2026-07-01.")]
ColumnOption = Annotated[
    list[str] | None,
    typer.Option(
        help="ROLE=NAME of a column, such as id=star. priority=-rank reverses the sign. epoch=J2016 sets one "
        "epoch for all rows."
    ),
]
KeepOption = Annotated[
    list[str] | None, typer.Option(help="Column of the catalog to include in the results, such as a magnitude.")
]
UnitOption = Annotated[list[str] | None, typer.Option(help="ROLE=UNIT for a column without a unit, such as ra=deg.")]
FillOption = Annotated[
    list[str] | None, typer.Option(help="ROLE=VALUE that replaces missing values, such as priority=0 or visits=1.")
]
SubpriorityOption = Annotated[
    str | None,
    typer.Option(
        help="Order of the targets within each priority class: the seed of random subpriorities, which only depend on "
        "the identifiers of targets, or the name of a further column of the catalog (--keep)."
    ),
]
ParkedOption = Annotated[bool, typer.Option(help="Idle positioners whose arms have equal lengths are obstacles.")]
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
    typer.Option(help="Plot the numbers of targets in reach, assigned and observed (.png, .pdf or .svg)."),
]
MethodOption = Annotated[
    str,
    typer.Option(
        help="conditional, monte_carlo, quadrature, closed_form, overlap_ratio, close_pair, a method of an installed "
        "package, or auto, which is the fastest method with an error estimate."
    ),
]
MapOption = Annotated[Path | None, typer.Option(help="Write the probability of each positioner (.fits or .ecsv).")]
ReportOption = Annotated[Path | None, typer.Option(help="Write a self-contained page on the result (.html).")]
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
    typer.Option(help="Region whose targets or area are ignored, in the form of --region; may be repeated."),
]
CentersOption = Annotated[
    Path | None,
    typer.Option(
        help="List of permitted centers, with columns ra, dec, ... With --method given, all of them are used."
    ),
]
DeclinationOption = Annotated[
    tuple[float, float] | None,
    typer.Option(help="Lowest and highest declination of the center of a tile (deg).", metavar="LOW HIGH"),
]
RadiusOption = Annotated[
    float | None,
    typer.Option(
        help="Radius of a tile (deg), in place of the radius of the instrument. Fibers then reach any target of "
        "the tile."
    ),
]
TilingAllocatorOption = Annotated[
    str | None,
    typer.Option(
        help="Allocator that plans each tile, as in a survey: lamost, nearest, balanced, sdss, optimal, repair, "
        "or an allocator of an installed package. By default, lamost, unless --fibers or --radius is given."
    ),
]
TilingPaOption = Annotated[
    float | None,
    typer.Option(
        help="Position angle of +y (deg), from north toward east. By default, the position angle in --centers, or 0.",
        callback=check_angle,
    ),
]
TilingMethodOption = Annotated[
    str,
    typer.Option(
        help="Method: hexagonal, spiral (coverings without gaps), max_density, density_gradient, mean_shift (one "
        "tile after the other, as for LAMOST), sdss (network flow), or given (the tiles of --centers)."
    ),
]
PassesOption = Annotated[int, typer.Option(help="Number of passes, for the methods hexagonal and spiral.")]
CompletenessOption = Annotated[
    float | None, typer.Option(help="Place no more tiles when this fraction of the visits (0 to 1) is reached.")
]
FibersOption = Annotated[
    int | None,
    typer.Option(
        help="Largest number of targets of a tile; without --allocator, fibers reach any target of the field."
    ),
]
NTilesOption = Annotated[int | None, typer.Option(help="Largest number of tiles.")]
TilingOutputOption = Annotated[Path | None, typer.Option(help="Write the tiling (.fits or .ecsv).")]
ChartOption = Annotated[Path | None, typer.Option(help="Plot the table (.png, .pdf or .svg).")]
MapPlotOption = Annotated[
    Path | None, typer.Option(help="Plot the probability of each positioner (.png, .pdf or .svg).")
]
TilingPlotOption = Annotated[Path | None, typer.Option(help="Plot the tiles (.png, .pdf or .svg).")]
SurveyCatalogArgument = Annotated[
    Path | None,
    typer.Argument(
        help="FITS, ECSV, CSV, VOTable or Parquet, a folder of HEALPix partitions (HATS), or example:anticenter, whose "
        "stars come with the package. By default, a synthetic Poisson catalog that is wider than a field."
    ),
]
TilesOption = Annotated[
    Path | None,
    typer.Option(
        help="List of tiles, with columns ra, dec, pass, ... By default, two hexagonal coverings of the catalog."
    ),
]
VisitsOption = Annotated[
    int | None,
    typer.Option(help="Number of visits of each target. By default, the number in the catalog, or 1.", min=1),
]
SomePassesOption = Annotated[
    list[int] | None,
    typer.Option(
        "--pass", help="Pass of the tiling to plan. The option may be repeated; passes are planned in this order."
    ),
]
LostOption = Annotated[
    bool, typer.Option("--lost/--kept", help="Count a target as not observed if its positioner collides.")
]
OrderOption = Annotated[
    str,
    typer.Option(
        help="Order of the tiles. color: one pass after the other, where tiles of a pass that do not overlap can be "
        "planned in parallel. given: the order of the list. joint: all tiles together, with --allocator optimal."
    ),
]
FolderOption = Annotated[Path | None, typer.Option(help="Folder to which each tile is written.")]
ResumeOption = Annotated[bool, typer.Option(help="Continue the survey in --folder.")]
WorkersOption = Annotated[int, typer.Option(help="Number of threads; the result does not depend on it.", min=1)]
ProcessesOption = Annotated[bool, typer.Option("--processes", help="Use processes instead of threads.")]
SchedulerOption = Annotated[str | None, typer.Option(help="Address of a Dask scheduler, such as tcp://host:8786.")]
SurveyPlotOption = Annotated[
    Path | None, typer.Option(help="Plot the tiles on the sky and the completeness (.png, .pdf or .svg).")
]
SurveyQualityOption = Annotated[
    Path | None,
    typer.Option(help="Plot visits by class, targets by outcome, and fibers by kind (.png, .pdf or .svg)."),
]
DesignInstrumentOption = Annotated[
    str | None,
    typer.Option(
        help="Preset or TOML file of the design around which to scan; its values replace the default values below."
    ),
]
SpreadOption = Annotated[
    float | None,
    typer.Option(
        help="With --instrument, vary the central arm, the ratio and the pitch by up to this fraction. By default, "
        "0.15."
    ),
]
CentralArmOption = Annotated[
    str | None,
    typer.Option(
        help="Length of the central arm (mm): 8.25, or 7,8,9, or 7:9:5 (five nodes), or LOW:HIGH. By default, 8.25."
    ),
]
RatioOption = Annotated[
    str | None,
    typer.Option(
        help="Eccentric arm divided by central arm, in the forms of --central-arm. The default range is 1 to 2."
    ),
]
PitchOption = Annotated[
    str | None,
    typer.Option(
        help="Distance of neighboring centers (mm), in the forms of --central-arm. The default range is 24 to 34."
    ),
]
ClearanceOption = Annotated[
    str | None, typer.Option(help="Clearance of an arm (mm), in the forms of --central-arm. By default, 2.25.")
]
NDesignsOption = Annotated[
    int | None, typer.Option(help="Number of designs at Sobol points between LOW and HIGH, instead of a grid.")
]
EstimandOption = Annotated[
    str | None,
    typer.Option(
        help="Definition of the loss to collisions. independent: collisions of independent random targets. "
        "allocated: collisions after allocation. collision_free: fibers that are idle if no collision is allowed."
    ),
]
DesignMethodOption = Annotated[
    str,
    typer.Option(
        help="Method: surrogate, quadrature, conditional, optimal, repair, or auto, which is the fastest method that "
        "is accurate enough."
    ),
]
EachOption = Annotated[float | None, typer.Option(help="Number of targets per positioner. By default, 4.")]
DensityOption = Annotated[
    float | None, typer.Option(help="Number of targets per mm^2, in place of --targets-per-positioner.")
]
SkiesOption = Annotated[int, typer.Option(help="Number of realizations to average over.")]
DesignObjectiveOption = Annotated[
    list[str] | None,
    typer.Option(help="COLUMN=max or COLUMN=min; give this option twice. By default, coverage=max and loss=min."),
]
DesignOutputOption = Annotated[Path | None, typer.Option(help="Write finished designs to this file (.fits or .ecsv).")]
DesignResumeOption = Annotated[bool, typer.Option(help="Continue the scan in --output.")]
DesignPlotOption = Annotated[Path | None, typer.Option(help="Plot the front (.png, .pdf or .svg).")]

PLAN_EXAMPLES = """\b
Examples:
  rfpsurvey plan
  rfpsurvey plan example:anticenter --center "95 23" --epoch 2026.5
  rfpsurvey plan stars.fits --center "06h20m00s +23d00m00s" --output tile.fits --plot tile.png
  rfpsurvey plan stars.fits --output tile.fits --report tile.html
  rfpsurvey plan stars.fits --keep mag --plot tile.png --targets outcome --quality quality.png
  rfpsurvey plan stars.csv --instrument sdss_apo --center "95.0 23.0" --pa 40 --equinox J2026.0 --epoch 2026.5
  rfpsurvey plan stars.fits --allocator optimal --require instrument --sky-separation 10
  rfpsurvey plan stars.fits --allocator optimal --required 4711 --required 4712 --keep-out 95.0,23.1,0.01
"""

COMPARE_ALLOCATORS_EXAMPLES = """\b
Examples:
  rfpsurvey compare-allocators
  rfpsurvey compare-allocators stars.fits --instrument moons --plot allocators.png --report allocators.html
  rfpsurvey compare-allocators stars.fits --require instrument --sky-separation 10 --allocator sdss --allocator optimal
"""

COMPARE_EXAMPLES = """\b
Examples:
  rfpsurvey compare
  rfpsurvey compare lamost design.toml --targets 2 --plot comparison.png --output comparison.ecsv
  rfpsurvey compare sdss_apo moons --catalog stars.fits --center "06h20m00s +23d00m00s" --allocator optimal
  rfpsurvey compare lamost desi pfs --density 1000 --realizations 2 --report comparison.html
"""

CONVERT_EXAMPLES = """\b
Examples:
  rfpsurvey convert confSummary-26.par plan.ecsv
  rfpsurvey convert tile.fits confSummary-26.par.gz
  rfpsurvey convert tile.fits fiberassign-000001.fits --format fiberassign --overwrite
"""

SCORE_EXAMPLES = """\b
Examples:
  rfpsurvey score confSummary-26.par.gz
  rfpsurvey score confSummary-26.par.gz --instrument sloanFlatCMM
  rfpsurvey score plan.ecsv --instrument sdss_apo
  rfpsurvey score designs.ecsv --instrument sdss_lco --select design_id=503246 --equinox J2022.0
"""

TILE_EXAMPLES = """\b
Examples:
  rfpsurvey tile --region "box 180 240 25 45" --passes 2 --output tiles.ecsv --report tiles.html
  rfpsurvey tile --region sky --method spiral --instrument desi
  rfpsurvey tile stars.fits --method sdss --completeness 0.95 --allocator repair
  rfpsurvey tile stars.fits --method given --centers tiles.ecsv
  rfpsurvey tile stars.fits --region "cap 95 23 5" --exclude "cap 92.3 24.3 0.5" --declination -10 60
  rfpsurvey tile stars.fits --radius 1.5 --fibers 400
"""

DESIGN_EXAMPLES = """\b
Examples:
  rfpsurvey design --ratio 1:2:5 --pitch 22:30:9
  rfpsurvey design --instrument mine.toml --plot mine.png
  rfpsurvey design --instrument lamost --spread 0.3 --pitch 24:32:9
  rfpsurvey design --central-arm 7.25:14.5 --ratio 1:2 --pitch 24.6:35 --n-designs 4096 --plot front.png
  rfpsurvey design --ratio 1:2:5 --estimand allocated --output designs.ecsv --workers 2
  rfpsurvey design --ratio 1,1.5 --pitch 25:35:5 --estimand collision_free --targets-per-positioner 1 --processes
"""

SURVEY_EXAMPLES = """\b
Examples:
  rfpsurvey survey
  rfpsurvey survey stars.fits --tiles tiles.ecsv --visits 2 --workers 2 --folder plan --report plan.html
  rfpsurvey survey stars.fits --tiles tiles.ecsv --visits 2 --workers 2 --folder plan --resume
  rfpsurvey survey stars.fits --allocator repair --required 4711 --keep-out 95.0,23.1,0.01 --keep-out 95.4,22.8,0.02
  rfpsurvey survey stars.fits --allocator optimal --order joint --joint-time 600 --folder plan
  rfpsurvey survey hats_catalog --tiles tiles.ecsv --instrument desi --scheduler tcp://10.0.0.1:8786 --folder plan
"""

BENCHMARK_EXAMPLES = """\b
Examples:
  rfpsurvey benchmark collisions
  rfpsurvey benchmark collisions --instrument sdss_apo --method exact --method sampled --plot sdss.pdf
  rfpsurvey benchmark batches --instrument moons
  rfpsurvey benchmark probability --instrument moons --plot moons.png
"""

PROBABILITY_EXAMPLES = """\b
Examples:
  rfpsurvey probability lamost
  rfpsurvey probability sdss_apo --method monte_carlo --precision 0.002 --workers 2
  rfpsurvey probability moons --estimand independent --density shared
  rfpsurvey probability lamost --targets stars.fits --output map.fits --plot map.png
"""

REPRODUCE_EXAMPLES = """\b
Examples:
  rfpsurvey reproduce small
  rfpsurvey reproduce all --quick --folder quick --report quick.html
"""
