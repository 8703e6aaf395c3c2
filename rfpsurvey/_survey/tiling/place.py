"""Place the tiles of a survey, with a table of methods and checks of their options."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from numbers import Number

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

from rfpsurvey._assignment.methods import DEFAULT_ALLOCATOR
from rfpsurvey._assignment.options import AllocationOptions, as_options
from rfpsurvey._assignment.plugin import warn_of_unused_options
from rfpsurvey._common.descriptions import Method, describe_methods, table_of
from rfpsurvey._common.executors import Progress
from rfpsurvey._common.units import is_seed_given, to_scalar, to_seed
from rfpsurvey._field.targets import CatalogTargets, FieldBuilder
from rfpsurvey._instruments.instrument import Instrument, as_instrument
from rfpsurvey._sky.arrays import SkyIndex
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.frames import is_table
from rfpsurvey._sky.partitions import PartitionedCatalog, as_catalog
from rfpsurvey._sky.region import Region
from rfpsurvey._sky.time import choose_epoch
from rfpsurvey._survey.tiling import centers as _centers
from rfpsurvey._survey.tiling.centers import Centers, Declinations, Fibers, given_tiles
from rfpsurvey._survey.tiling.columns import COLUMNS, times_of_tiles
from rfpsurvey._survey.tiling.cover import RegionCover, cover_targets, hexagonal, in_any, spiral
from rfpsurvey._survey.tiling.greedy import density_gradient, max_density, mean_shift
from rfpsurvey._survey.tiling.network import network_flow
from rfpsurvey._survey.tiling.problem import TilingProblem, TilingState, account_of, visit_given, warn_of_rest
from rfpsurvey._survey.tiling.tiling import Tiling, to_ra_dec
from rfpsurvey.errors import (
    InputError,
    InputTypeError,
    check_choice,
    check_keywords,
    check_switch,
    check_whole,
    listed,
    refusal,
    short,
    warn,
    warn_no_effect,
    warn_of_unused,
)


@dataclass(frozen=True)
class TilingMethod(Method):
    """A method that places tiles."""

    covers: bool = False
    """Whether the function returns the centers of a covering, for which no targets are required."""
    needs_tiles: bool = False
    """Whether the method needs a list of tiles."""

    def place(self, problem: TilingProblem) -> TilingState:
        """Place the tiles for the targets of a problem."""
        return cover_targets(problem, self.function) if self.covers else self.function(problem)


METHODS = table_of(
    TilingMethod("hexagonal", hexagonal, ("passes",), "a covering without gaps", covers=True),
    TilingMethod("spiral", spiral, ("passes",), "a covering without gaps", covers=True),
    TilingMethod("max_density", max_density, summary="tile after tile, where most visits remain"),
    TilingMethod("density_gradient", density_gradient, summary="tile after tile, at maxima of the density"),
    TilingMethod("mean_shift", mean_shift, summary="tile after tile, at the mean of its targets"),
    TilingMethod("network_flow", network_flow, summary="network flow"),
    TilingMethod("given", visit_given, summary="a list of tiles", needs_tiles=True),
)
"""Methods that place tiles, by name. A function takes a `TilingProblem`, or makes the centers of a covering."""


def warn_of_unused_passes(method: TilingMethod, passes: int, *, has_goal: bool) -> None:
    """Issue a warning if a number of passes is given that has no effect."""
    if passes != 1:
        warn_of_unused(["passes"], [method], METHODS.values(), "method")
        if method.covers and has_goal:
            warn_no_effect("passes", "if n_tiles or completeness is given, which then determine the number of passes")


def check_region_options(method: TilingMethod, goals: dict, unused: dict) -> None:
    """Raise an error if a method cannot cover a region or reach the goals; issue warnings about unused options."""
    if not (method.covers or method.needs_tiles):
        able = listed(name for name, candidate in METHODS.items() if candidate.covers)
        raise InputError(f"the method {method.name!r} needs targets, got a Region; methods that cover regions: {able}")
    for name, value in goals.items():
        if value is not None:
            raise InputError(f"{name} applies only to targets, and a region has none")
    for name, value in unused.items():
        if value is not None:
            warn_no_effect(name, "on a region, which has no targets")


MOST_LEVELS = 100
"""Largest number of priority classes; tiles are placed for one class after the other."""
log = logging.getLogger("rfpsurvey")


@check_keywords
@describe_methods(METHODS)
def place_tiles(
    catalog: Catalog | PartitionedCatalog | SkyCoord | Table | Region,
    instrument: Instrument | str | None = None,
    *,
    method: str = "hexagonal",
    passes: int = 1,
    n_tiles: int | None = None,
    completeness: float | None = None,
    fibers: Fibers | int | None = None,
    allocator: AllocationOptions | str | Callable | None = None,
    radius: u.Quantity | None = None,
    centers: Centers | SkyCoord | Tiling | Table | None = None,
    exclude: Region | list[Region] | None = None,
    visits: np.ndarray | None = None,
    progress: bool | Callable = False,
    rng: int | np.random.Generator | None = 0,
) -> Tiling:
    """Place the tiles of a survey.

    A tile is a circle with the field radius of the instrument. As in a survey, an allocator and the collisions of
    arms determine which targets a tile observes. Without ``allocator``, ideal fibers are used instead if ``fibers`` or
    ``radius`` is given, or if there is no instrument. A tile can then observe any of its targets, up to the number of
    fibers, and the completeness is an upper limit, as ``summary["completeness_means"]`` states. A tile observes each
    target at most once. Only science targets are counted.

    Parameters
    ----------
    catalog : Catalog, PartitionedCatalog, SkyCoord, Table, DataFrame or Region
        The targets (all partitions are read), or a region, which only some methods can cover.
    instrument : Instrument or str, optional
        Instrument, which defines the field radius and the positioners. It is not required if ``radius`` and
        ``fibers`` are given.
    method : str, optional
        Method that places the tiles. Methods that place one tile after the other place tiles for the targets of the
        highest priority first.
        {methods}
    passes : int, optional
        Number of passes of methods that cover the field. Each pass covers the whole field with shifted
        tiles, even if no visits remain. If ``completeness`` or ``n_tiles`` is given, passes are instead added until
        this goal is reached, and tiles that observe no target are omitted.
    n_tiles : int, optional
        Largest number of tiles; for ``network_flow`` without ``completeness``, the number of tiles.
    completeness : float, optional
        Fraction of the requested visits that the tiles must provide, above 0 and at most 1. When this fraction is
        reached, no more tiles are placed.
    fibers : Fibers or int, optional
        Largest number of targets that a tile observes. `~rfpsurvey.tiling.Fibers` can also set the minimum separation
        of these targets. Without an allocator, the fibers reach any target of the field.
    allocator : AllocationOptions or str or callable, optional
        Allocator of the positioners, which determines the targets that a tile observes, as in `plan_survey`; see
        `AllocationOptions`. The default is ``repair``. By default, a target is not observed if the arm at this target
        collides; see `~rfpsurvey.tiling.Fibers`. Required targets take precedence in each tile. Circles that no arm may
        cover are obstacles in each tile.
    radius : Quantity, optional
        Angular radius of a tile; by default, the field radius of the instrument. With an allocator, tiles are placed
        with this radius, but observe targets in the whole field of the instrument.
    centers : Centers, SkyCoord, Tiling or Table, optional
        Constraints on the centers of tiles, such as a list of bright stars or limits of declination, and the position
        angle of tiles; see `~rfpsurvey.tiling.Centers`. For the method ``given``, the observing conditions of the tiles
        are used.
    exclude : Region or list of Region, optional
        Regions whose targets or area are not counted. Tiles may overlap these regions.
    visits : array_like of int, optional
        Requested number of visits of each target, shape (n,), or one number for all targets. The default is the column
        ``visits`` of the catalog. If the catalog lacks this column, one visit of each target is requested. Targets of
        any kind with 0 visits are not assigned, except required targets.
    progress : bool or callable, optional
        Show the progress on the standard error, or call a function after each tile. If ``n_tiles`` is given, the
        arguments of the function are the number of tiles so far and ``n_tiles``; otherwise, the arguments are the
        completeness so far and its goal. Methods that try several numbers of tiles restart the progress for each
        number.
    rng : int, Generator or None, optional
        Seed or random number generator for allocators that use random numbers.

    Returns
    -------
    Tiling
        The tiles. If targets are given, the tiles are in the order in which they were placed, with the
        columns ``n_targets`` (number of targets in the field that still require a visit), ``n_new`` (number of targets
        that the tile observes) and ``completeness`` (of the survey after this tile). A survey with the same allocator
        reaches the completeness of the last tile if the survey plans the tiles in this order (``order="given"``) at the
        epoch of the catalog, and nearly the same completeness in another order.

    Raises
    ------
    InputError
        If there are no targets, if the name of a method, instrument or allocator is unknown, if a unit is missing, if a
        number is out of range, if the method requires targets but a region is given, or if the lattice would have to
        cover more than a hemisphere.

    Warns
    -----
    RfpsurveyWarning
        If the completeness is not reached, if targets are beyond the limits of declination, or if the allowed centers
        do not cover the region. Also, if an option is given that the method, the allocator or a region does not use.

    References
    ----------
    Blanton et al. 2003, AJ 125, 2276 (``network_flow``).

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> middle = SkyCoord("6h20m +23d")
    >>> tiling = rs.place_tiles(rs.Region.cap(middle, 8 * u.deg), radius=2.5 * u.deg)
    >>> len(tiling), tiling.summary["covering_fraction"]
    (19, 1.0)
    """
    chosen = METHODS[check_choice(method, METHODS, "method to place tiles")]
    model = None if instrument is None else as_instrument(instrument)
    fibers = fibers if isinstance(fibers, Fibers) else Fibers(fibers)
    if allocator is not None and model is None:
        raise InputError("an allocator needs the positioners of an instrument, got none")
    if radius is None and model is None:
        raise InputError("an instrument or the radius of a tile must be given")
    by_positioners = allocator is not None or (model is not None and radius is None and not fibers.ideal)
    radius = model.field_radius if radius is None else radius
    radius_rad = np.deg2rad(to_scalar(radius, u.deg, "radius", low=0, high=90))
    passes, seed = check_whole(passes, "passes", high=10_000), to_seed(rng)
    warn_of_unused_passes(chosen, passes, has_goal=not (n_tiles is None and completeness is None))
    if not (fibers.lost_in_collision or (by_positioners and not isinstance(catalog, Region))):
        warn_no_effect("lost_in_collision", "without the positioners of an allocator")
    where, exclude = centers if isinstance(centers, Centers) else Centers(centers), _regions(exclude)
    progress = progress if callable(progress) else check_switch(progress, "progress")
    if chosen.needs_tiles and where.tiling is None:
        raise InputError(f"the method {method!r} needs a list of tiles as centers, got none")
    summary = {
        "method": method,
        "instrument": "" if model is None else model.name,
        "arm_model": model.focal_plane.positioner.arm_model if by_positioners else "",
        **({"margins": str(model.focal_plane.margins)} if by_positioners and model.focal_plane.margins else {}),
        **dict.fromkeys(("n_tiles", "passes"), 0),
        "radius_deg": float(np.rad2deg(radius_rad)),
    }
    if isinstance(catalog, Region):
        goals = {"n_tiles": n_tiles, "completeness": completeness}
        unused = {"visits": visits, "allocator": allocator, "fibers": fibers.number}
        unused |= {"min_separation": fibers.min_separation, "rng": rng if is_seed_given(rng) else None}
        check_region_options(chosen, goals, unused)
        return _place_on_region(catalog, chosen, model, radius_rad, passes, where, exclude, summary)
    times = times_of_tiles(where.tiling) if chosen.needs_tiles and by_positioners else None
    catalog, reference, moved = _targets(catalog, times)
    summary.update({} if moved is None else {"epoch": moved})
    options = as_options(DEFAULT_ALLOCATOR if allocator is None else allocator)
    if by_positioners:
        options.check_for_fields("place_tiles")
        warn_of_unused_options([options], model.focal_plane, rng)
        options = options.for_instrument(model)
    index = SkyIndex(catalog.arrays.vectors)
    builder = FieldBuilder(CatalogTargets(catalog, index), options, model, visits)
    wanted, n_away, n_beyond = _wanted(builder, exclude, where.limits, radius_rad)
    n_tiles = None if n_tiles is None else check_whole(n_tiles, "n_tiles")
    if completeness is not None and not (isinstance(completeness, int | float) and 0 < completeness <= 1):
        raise refusal("completeness must be a number above 0 and at most 1", completeness, Number)
    number, priority = _number_of_fibers(fibers, model), builder.source.by_slot("priority")
    neighbors = _neighbors(fibers, index, allocator)
    if by_positioners:
        tiles = given_tiles(where) if chosen.needs_tiles else where.angle_deg
        serve = _centers.FocalPlaneFibers(model, builder, fibers, tiles, seed, reference)
        reach = serve.radius_rad + serve.margin_rad
    else:
        serve, reach = _centers.FreeFibers(number, priority, neighbors), radius_rad
        if is_seed_given(rng):
            warn_no_effect("rng", "without the positioners of an allocator")
    goal = n_tiles or completeness or 1.0
    with Progress(progress, goal, "" if n_tiles is None else "tiles") as line:

        def tell(n, reached):
            line(min(reached if n_tiles is None else n, goal))

        goals = {"passes": passes, "n_tiles": n_tiles, "completeness": completeness, "n_beyond": n_beyond}
        others = {"where": where, "level": _levels(priority, wanted), "tell": tell}
        state = chosen.place(TilingProblem(radius_rad, index, wanted, number, serve, reach, **goals, **others))
    summary.update(fibers=number, **account_of(state, neighbors, n_away), completeness_means=serve.means)
    warn_of_rest(state, n_away, where.limits)
    rows = state.table
    table = given_tiles(where).table[: len(rows)] if chosen.needs_tiles else _table(rows["center"], rows["pass"], where)
    return _finish(table, summary, {name: rows[name] for name in ("n_targets", "n_new", "completeness")})


def _place_on_region(region, method, model, radius_rad, passes, where, exclude, summary):
    """Return the tiling of a region."""
    cover = RegionCover(region, radius_rad, exclude)
    if method.needs_tiles:
        table, vectors = given_tiles(where).table, where.tiling.vectors
    else:
        passes_of_region = cover.make_passes(method.function, passes, where)
        vectors = np.vstack(passes_of_region)
        table = _table(vectors, np.repeat(np.arange(passes) + 1, [len(centers) for centers in passes_of_region]), where)
    quality = cover.quality(vectors, where.limits)
    summary.update(area_deg2=float(region.area.to_value(u.deg**2)), **quality)
    if model is not None:
        summary["fraction_in_reach"] = cover.fraction_in_reach(model, table)
    if quality.get("fraction_beyond_declination") == 1:
        raise InputError(f"at least a part of the region must be within reach{where.limits.words}, got none")
    if quality["covering_fraction"] < 1:
        words = f"the allowed centers cover {quality['covering_fraction']:.4f} of the region"
        if quality.get("fraction_beyond_declination"):
            words += f"; {quality['fraction_beyond_declination']:.4f} of it is out of reach{where.limits.words}"
        warn(words)
    return _finish(table, summary, {})


def _targets(given, times) -> tuple:
    """Return the targets at the epoch of the tiles, this epoch, and a sentence on the epoch."""
    if not (isinstance(given, Catalog | PartitionedCatalog | SkyCoord) or is_table(given)):
        raise InputTypeError(f"catalog must be a Catalog, SkyCoord, Table, DataFrame or Region, got {short(given)}")
    catalog = as_catalog(given)
    reference, moved = choose_epoch(catalog, None, times)
    if len(catalog) == 0:
        raise InputError("the catalog must have at least one target with finite coordinates, got none")
    return catalog if reference is None else catalog.at_epoch(reference), reference, moved


def _neighbors(fibers: Fibers, index: SkyIndex, allocator):
    """Return the targets closer to each target than the minimum separation of fibers; None without this minimum."""
    if fibers.min_separation is None:
        return None
    if allocator is not None:
        raise InputError("min_separation must not be given with an allocator, whose positioners set the separation")
    return _centers.neighbors_within(index.vectors, float(fibers.min_separation.to_value(u.rad)))


def _regions(exclude) -> tuple[Region, ...]:
    """Return a tuple of regions from one region, several regions, or None."""
    regions = () if exclude is None else (exclude,) if isinstance(exclude, Region) else exclude
    if not isinstance(regions, list | tuple) or not all(isinstance(region, Region) for region in regions):
        raise InputTypeError(f"exclude must be a Region or a list of Regions, got {short(exclude)}")
    return tuple(regions)


def _number_of_fibers(fibers: Fibers, model: Instrument | None) -> int:
    """Return the given number of fibers of a tile or, by default, the number of usable positioners."""
    if fibers.number is None and model is None:
        raise InputError("an instrument or the number of fibers of a tile must be given")
    usable = None if model is None else int(np.count_nonzero(model.focal_plane.arrays.usable))
    if usable == 0:
        raise InputError(f"{model.name} must have at least one positioner that is not disabled or stuck, got none")
    return usable if fibers.number is None else int(fibers.number)


def _wanted(builder: FieldBuilder, exclude, limits: Declinations, radius_rad: float) -> tuple[np.ndarray, int, int]:
    """Return the requested visits of each target outside of the excluded regions, in the order of the spatial index.

    The visits of targets beyond the declination limits are set to 0; the numbers of these targets and of their visits
    are also returned.
    """
    vectors, wanted = builder.source.index.vectors, builder.wanted.astype(np.int64)
    wanted[in_any(exclude, vectors)] = 0
    if not wanted.any():
        raise InputError(
            "the catalog must have at least one science target that requires a visit and is not in a region of exclude"
        )
    beyond = limits.distance(vectors) > radius_rad
    n_away, n_beyond = int(np.count_nonzero(wanted[beyond])), int(wanted[beyond].sum())
    wanted[beyond] = 0
    if not wanted.any():
        raise InputError(f"at least one target must be within reach{limits.words}, got none")
    return wanted, n_away, n_beyond


def _levels(priority, wanted):
    """Return the priority class of each target (0: highest priority); None if there is a single class.

    If there are more than `MOST_LEVELS` priorities, neighboring
    priorities share a class.
    """
    if priority is None or len(values := np.unique(priority[wanted > 0])) < 2:
        return None
    rank = np.clip(np.searchsorted(values, priority), 0, len(values) - 1)
    number = min(len(values), MOST_LEVELS)
    return number - 1 - rank * number // len(values)


def _table(vectors, number, where: Centers) -> QTable:
    """Return a table of tiles with the given centers and pass numbers, and with the position angle of ``where``."""
    ra, dec = to_ra_dec(vectors)
    angles = [values * u.deg for values in (ra, dec, np.full(len(ra), where.angle_deg))]
    return QTable([np.arange(len(ra)), *angles, np.array(number, dtype=np.int64)], names=COLUMNS)


def _finish(table, summary, columns) -> Tiling:
    """Return a tiling: the table of its tiles, with further columns and the summary added."""
    table, n = table.copy(), len(table)
    for name, values in columns.items():
        table[name] = values
    summary.update(n_tiles=n, passes=len(np.unique(table["pass"])))
    table.meta.update(method=summary["method"], summary=summary)
    log.info("placed %d tiles: %s", n, summary)
    return Tiling(table)
