"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

from rfpsurvey.errors import InputError


def check_angle(value: float | None) -> float | None:
    """Return a position angle that was typed, if it is within one turn."""
    if value is not None and not abs(value) <= 360:
        raise InputError(f"--pa must lie between -360 and 360 deg, got {value:g}")
    return value


CatalogArgument = Annotated[
    Path | None,
    typer.Argument(
        help="FITS, ECSV, CSV, VOTable or Parquet, a folder of HEALPix partitions (HATS), or example:anticenter, whose "
        "stars come with the package. None: a synthetic Poisson "
        "catalog."
    ),
]
CenterOption = Annotated[
    str | None,
    typer.Option(help="Field center, ICRS, as '95.1 23.0' (deg) or '06:20:24 +23:00:00'. None: the mean direction."),
]
PaOption = Annotated[float, typer.Option(help="Position angle of +y, deg from north to east.", callback=check_angle)]
SeedOption = Annotated[int, typer.Option(help="Seed of random numbers.", min=0)]
FrameOption = Annotated[str, typer.Option(help="Frame of the catalog's coordinates.")]
AllocatorOption = Annotated[
    str,
    typer.Option(
        help="lamost, nearest, balanced (which does not look at priorities), sdss (network flow), optimal (no "
        "collisions, proven), repair (lamost, its collisions ended by local moves), or that of an installed package."
    ),
]
RequireOption = Annotated[
    list[str] | None,
    typer.Option(
        help="KIND=NUMBER that a tile must hold, as sky=20/spectrograph or sky_boss=300; or instrument, for its own."
    ),
]
RequiredOption = Annotated[list[str] | None, typer.Option(help="Id of a target that comes before all others.")]
KeepOutOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Circle that no arm may cover, as 95.0,23.0,0.01: RA,DEC,RADIUS, deg, ICRS. repair and optimal keep it "
        "free; with other allocators, arms there are counted as collisions."
    ),
]
SkyOption = Annotated[float | None, typer.Option(help="Positions so far from all targets, arcsec, serve as sky, too.")]
ObjectiveOption = Annotated[
    str, typer.Option(help="sdss, optimal: priority (class after class), or count (their number first).")
]
TimeLimitOption = Annotated[float, typer.Option(help="sdss, optimal: seconds for the search.")]
InstrumentOption = Annotated[str, typer.Option(help="Preset, or the path of a TOML file.")]
EquinoxOption = Annotated[
    str | None, typer.Option(help="Measure the position angle from the north of this date, as J2026.0.")
]
EpochOption = Annotated[str | None, typer.Option(help="Move targets to this epoch, as 2026.5 or 2026-07-01.")]
ColumnOption = Annotated[
    list[str] | None,
    typer.Option(help="ROLE=NAME, as id=star; priority=-rank flips it; epoch=J2016 holds for all rows."),
]
KeepOption = Annotated[
    list[str] | None, typer.Option(help="Column of the catalog that the results shall carry, such as a magnitude.")
]
UnitOption = Annotated[list[str] | None, typer.Option(help="ROLE=UNIT of a column without one, as ra=deg.")]
FillOption = Annotated[
    list[str] | None, typer.Option(help="ROLE=VALUE of rows that have none, as priority=0 or visits=1.")
]
ParkedOption = Annotated[bool, typer.Option(help="Idle equal-arm positioners are parked, as obstacles for others.")]
OutputOption = Annotated[
    Path | None,
    typer.Option(help="Write the tile, .fits or .ecsv; only FITS holds the outcomes of all targets, too."),
]
PlotOption = Annotated[Path | None, typer.Option(help="Draw the focal plane, .png, .pdf or .svg.")]
TargetsOption = Annotated[
    str | None,
    typer.Option(help="Draw all targets of the field in --plot, too, by outcome, kind, category or priority."),
]
QualityOption = Annotated[
    Path | None,
    typer.Option(help="Draw how many targets are in reach, assigned and observed, .png, .pdf or .svg."),
]
MethodOption = Annotated[
    str,
    typer.Option(
        help="conditional, monte_carlo, quadrature, closed_form, overlap_ratio, close_pair, that of an installed "
        "package, or auto: the cheapest one that has an error."
    ),
]
MapOption = Annotated[Path | None, typer.Option(help="Write the probability of each positioner, .fits or .ecsv.")]
ReportOption = Annotated[Path | None, typer.Option(help="Write a page on the result that needs no network, .html.")]
OverwriteOption = Annotated[bool, typer.Option(help="Replace files that exist.")]

RegionOption = Annotated[
    str | None,
    typer.Option(
        help="Cover this: 'cap RA DEC RADIUS', 'box RA1 RA2 DEC1 DEC2', 'polygon RA DEC ...' (deg), or sky. With a "
        "catalog: its targets inside."
    ),
]
ExcludeOption = Annotated[
    list[str] | None,
    typer.Option(help="Targets or area inside do not count: a region, as --region; several are possible."),
]
CentersOption = Annotated[
    Path | None, typer.Option(help="The only centers that may be: ra, dec, ... With --method given, exactly these.")
]
DeclinationOption = Annotated[
    tuple[float, float] | None,
    typer.Option(help="Lowest and highest declination of a center, deg.", metavar="LOW HIGH"),
]
RadiusOption = Annotated[
    float | None, typer.Option(help="Radius of a tile, deg, instead of the instrument's; fibers reach all of it.")
]
TilingAllocatorOption = Annotated[
    str | None,
    typer.Option(
        help="Plan each tile with this allocator, as a survey does: lamost, nearest, balanced, sdss, optimal, repair, "
        "or that of an installed package. None: lamost, unless --fibers or --radius is given."
    ),
]
TilingPaOption = Annotated[
    float | None,
    typer.Option(
        help="Position angle of +y, deg from north to east. None: that of --centers, or 0.", callback=check_angle
    ),
]
TilingMethodOption = Annotated[
    str,
    typer.Option(
        help="hexagonal, spiral (coverings without gaps), max_density, density_gradient, mean_shift (one tile after "
        "the other, as LAMOST), sdss (network flow), or given (those of --centers)."
    ),
]
PassesOption = Annotated[int, typer.Option(help="How often coverings cover everything.")]
CompletenessOption = Annotated[float | None, typer.Option(help="Stop at this part of the targets, 0 to 1.")]
FibersOption = Annotated[
    int | None, typer.Option(help="Targets of a tile at most; without --allocator, wherever they are in the field.")
]
NTilesOption = Annotated[int | None, typer.Option(help="Maximum number of tiles.")]
TilingOutputOption = Annotated[Path | None, typer.Option(help="Write the tiling, .fits or .ecsv.")]
ChartOption = Annotated[Path | None, typer.Option(help="Draw the chart, .png, .pdf or .svg.")]
MapPlotOption = Annotated[
    Path | None, typer.Option(help="Draw the probability of each positioner, .png, .pdf or .svg.")
]
TilingPlotOption = Annotated[Path | None, typer.Option(help="Draw the tiles, .png, .pdf or .svg.")]
SurveyCatalogArgument = Annotated[
    Path | None,
    typer.Argument(
        help="FITS, ECSV, CSV, VOTable or Parquet, a folder of HEALPix partitions (HATS), or example:anticenter, whose "
        "stars come with the package. None: a synthetic Poisson "
        "catalog, wider than a field."
    ),
]
TilesOption = Annotated[
    Path | None, typer.Option(help="List of tiles: ra, dec, pass, ... None: two hexagonal coverings of the catalog.")
]
VisitsOption = Annotated[
    int | None, typer.Option(help="How often each target is wanted. None: as the catalog says, else once.", min=1)
]
SomePassesOption = Annotated[
    list[int] | None, typer.Option("--pass", help="A pass of the tiling to plan, several in this order.")
]
LostOption = Annotated[bool, typer.Option("--lost/--kept", help="A target whose arm collides is not observed.")]
OrderOption = Annotated[
    str, typer.Option(help="color: pass after pass, tiles that do not overlap at the same time; given: as listed.")
]
FolderOption = Annotated[Path | None, typer.Option(help="Write tile after tile here.")]
ResumeOption = Annotated[bool, typer.Option(help="Continue the survey in the folder.")]
WorkersOption = Annotated[int, typer.Option(help="Threads; the result does not depend on it.", min=1)]
ProcessesOption = Annotated[bool, typer.Option("--processes", help="Processes instead of threads.")]
SchedulerOption = Annotated[str | None, typer.Option(help="Address of a Dask scheduler, as tcp://host:8786.")]
SurveyPlotOption = Annotated[
    Path | None, typer.Option(help="Draw the tiles on the sky and the completeness, .png, .pdf or .svg.")
]
SurveyQualityOption = Annotated[
    Path | None,
    typer.Option(help="Draw visits by class, targets by outcome, and fibers by kind, .png, .pdf or .svg."),
]
DesignInstrumentOption = Annotated[
    str | None,
    typer.Option(help="Scan around this preset or TOML file, whose lengths hold where None is given."),
]
SpreadOption = Annotated[
    float | None,
    typer.Option(help="Vary central arm, ratio and pitch of --instrument by this fraction to either side. None: 0.15."),
]
CentralArmOption = Annotated[
    str | None, typer.Option(help="Central arm, mm: 8.25, or 7,8,9, or 7:9:5 (five nodes), or LOW:HIGH. None: 8.25.")
]
RatioOption = Annotated[str | None, typer.Option(help="Eccentric over central arm, likewise. None: from 1 to 2.")]
PitchOption = Annotated[
    str | None, typer.Option(help="Distance of neighboring centers, mm, likewise. None: from 24 to 34.")
]
ClearanceOption = Annotated[str | None, typer.Option(help="Radius that an arm keeps free, mm, likewise. None: 2.25.")]
NDesignsOption = Annotated[int | None, typer.Option(help="Number of Sobol points between LOW:HIGH, instead of a grid.")]
EstimandOption = Annotated[
    str | None,
    typer.Option(help="Loss: independent (targets of one's own), allocated (queues) or collision_free (idle fibers)."),
]
DesignMethodOption = Annotated[
    str, typer.Option(help="surrogate, quadrature, conditional, optimal, repair, or auto: the cheapest good one.")
]
EachOption = Annotated[float | None, typer.Option(help="Targets a positioner. None: 4.")]
DensityOption = Annotated[float | None, typer.Option(help="Targets per mm^2 of the focal plane instead.")]
SkiesOption = Annotated[int, typer.Option(help="Skies to average over.")]
DesignObjectiveOption = Annotated[
    list[str] | None, typer.Option(help="COLUMN=max or COLUMN=min, twice. None: coverage=max and loss=min.")
]
DesignOutputOption = Annotated[Path | None, typer.Option(help="Keep the designs here as they come, .fits or .ecsv.")]
DesignResumeOption = Annotated[bool, typer.Option(help="Continue the scan in the output.")]
DesignPlotOption = Annotated[Path | None, typer.Option(help="Draw the front, .png, .pdf or .svg.")]

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

SCORE_EXAMPLES = """\b
Examples:
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
