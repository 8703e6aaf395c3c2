"""Place the tiles of a survey."""

import logging
import warnings
from collections.abc import Callable
from numbers import Number

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

from rfpsurvey._units import to_generator, to_scalar, to_vectors, to_visits
from rfpsurvey.allocation import AllocationOptions, as_options
from rfpsurvey.catalog import Catalog, PartitionedCatalog, SkyIndex, as_catalog
from rfpsurvey.errors import InputError, InputTypeError, RfpsurveyWarning, check_choice, refusal
from rfpsurvey.instrument import Instrument, as_instrument
from rfpsurvey.region import Region, is_inside
from rfpsurvey.tiling._cover import cover_region
from rfpsurvey.tiling._methods import COVERINGS, METHODS
from rfpsurvey.tiling._problem import TilingProblem, TilingState
from rfpsurvey.tiling._serve import Fibers, FocalPlaneFibers, FreeFibers, neighbors_within
from rfpsurvey.tiling._tiling import Tiling, place_of, to_ra_dec

__all__ = ["place_tiles"]

log = logging.getLogger("rfpsurvey")


def place_tiles(
    field: Catalog | PartitionedCatalog | SkyCoord | Table | Region,
    instrument: Instrument | str | None = None,
    *,
    method: str = "hexagonal",
    passes: int = 1,
    n_tiles: int | None = None,
    completeness: float | None = None,
    fibers: Fibers | int | None = None,
    allocator: AllocationOptions | str | Callable | None = None,
    radius: u.Quantity | None = None,
    position_angle: u.Quantity = 0 * u.deg,
    centers: SkyCoord | None = None,
    exclude: Region | None = None,
    visits: np.ndarray | None = None,
    rng: int | np.random.Generator | None = 0,
) -> Tiling:
    """Decide where the tiles of a survey go.

    A tile is a circle of the instrument's field radius that observes up to ``fibers`` of the targets in it, each at
    most once; of a catalog that has kinds, the science targets count.

    Parameters
    ----------
    field : Catalog, PartitionedCatalog, SkyCoord, Table or Region
        The targets (partitions are read as a whole), or a region to cover (``hexagonal`` and ``spiral``).
    instrument : Instrument or str, optional
        Gives the radius of the field and the number of fibers; not needed where both are given.
    method : {"hexagonal", "spiral", "max_density", "density_gradient", "mean_shift", "sdss"}, optional
        ``hexagonal``: a lattice without gaps about the middle of the field, for up to a hemisphere. ``spiral``: a
        Fibonacci spiral without gaps, for up to the whole sky. ``max_density``: one tile after the other where the most
        visits are wanted. ``density_gradient``: the same, from the densest target up the smoothed density.
        ``mean_shift``: the same, the center moving to the mean of its targets. ``sdss``: a number of tiles by
        network flow, by default that of a hexagonal lattice.
    passes : int, optional
        How often coverings cover everything, each pass with its tiles elsewhere, whether or not a target is left. With
        ``completeness`` or ``n_tiles``, passes follow until that is reached, without tiles that serve nobody.
    n_tiles : int, optional
        At most so many tiles; for ``sdss`` without ``completeness``, so many.
    completeness : float, optional
        Part of the wanted visits, above 0 and at most 1, at which no more tiles are placed.
    fibers : Fibers or int, optional
        Targets that a tile observes at most, and how close to each other they may be; by default as many as there are
        positioners that are not disabled or stuck.
    allocator : AllocationOptions or str or callable, optional
        Let the positioners of the instrument decide what a tile observes, see `AllocationOptions`; what is
        assigned counts, also where arms collide (``repair`` leaves no collisions). Required targets come first in each
        tile; circles that no arm may cover are obstacles of each tile.
    radius : Quantity, optional
        Angular radius of a tile, instead of the instrument's.
    position_angle : Quantity, optional
        Of all tiles.
    centers : SkyCoord, shape (n,), optional
        The only centers that may be, such as bright stars. Coverings then need not be complete.
    exclude : Region, optional
        Targets or area inside do not count.
    visits : array_like of int, optional
        How often each target is wanted, shape (n,) or one number; by default as the catalog says, or once.
    rng : int, Generator or None, optional
        For allocators that draw.

    Returns
    -------
    Tiling
        For targets in the order of placing, with the columns ``n_targets`` (unserved in the field), ``n_new`` (served)
        and ``completeness`` (after the tile).

    Raises
    ------
    InputError
        If there are no targets, a name is unknown, a unit is missing, a number is impossible, the method needs
        targets and got a region, or the lattice would have to cover more than a hemisphere.

    Warns
    -----
    RfpsurveyWarning
        If the completeness is not reached, or if the region is not covered by the centers that may be.

    References
    ----------
    Blanton et al. 2003, AJ 125, 2276 (``sdss``).

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
    check_choice(method, METHODS, "method to place tiles")
    model = None if instrument is None else as_instrument(instrument)
    fibers = fibers if isinstance(fibers, Fibers) else Fibers(fibers)
    if allocator is not None and model is None:
        raise InputError("an allocator needs the positioners of an instrument, got none")
    if radius is None and model is None:
        raise InputError("give an instrument, or the radius of a tile")
    radius = model.field_radius if radius is None else radius
    radius_rad = to_scalar(radius, u.rad, "radius", low=0, high=np.pi / 2)
    to_scalar(position_angle, u.deg, "position_angle", low=-3600, high=3600)
    passes = _whole(passes, "passes")
    if exclude is not None and not isinstance(exclude, Region):
        raise InputTypeError(f"exclude must be a Region, got {type(exclude).__name__}")
    allowed = None if centers is None else to_vectors(centers, "centers")
    if allowed is not None:
        allowed = allowed[np.isfinite(allowed).all(axis=1)]
        if len(allowed) == 0:
            raise InputError("centers must be at least one finite direction, got none")
        allowed = allowed[np.sort(np.unique(place_of(*to_ra_dec(allowed)), axis=0, return_index=True)[1])]
    summary = {
        "method": method,
        "instrument": "" if model is None else model.name,
        "n_tiles": 0,
        "passes": 0,
        "radius_deg": float(np.rad2deg(radius_rad)),
    }
    if isinstance(field, Region):
        given = {
            "n_tiles": n_tiles,
            "completeness": completeness,
            "visits": visits,
            "allocator": allocator,
            "min_separation": fibers.min_separation,
        }
        return _place_on_region(field, method, radius_rad, passes, allowed, exclude, position_angle, summary, given)
    if not isinstance(field, Catalog | PartitionedCatalog | SkyCoord | Table):
        raise InputTypeError(f"field must be a Catalog, SkyCoord, Table or Region, got {type(field).__name__}")
    catalog = as_catalog(field)
    wanted = _wanted(catalog, visits, exclude)
    n_tiles = None if n_tiles is None else _whole(n_tiles, "n_tiles")
    if completeness is not None and not (isinstance(completeness, int | float) and 0 < completeness <= 1):
        raise refusal("completeness must be a number above 0 and at most 1", completeness, Number)
    if fibers.number is None and model is None:
        raise InputError("give an instrument, or the number of fibers of a tile")
    usable = None if model is None else int(np.count_nonzero(model.focal_plane.arrays.usable))
    if usable == 0:
        raise InputError(f"{model.name} must have at least one positioner that is not disabled or stuck, got none")
    number = usable if fibers.number is None else int(fibers.number)
    index = SkyIndex(catalog.arrays.vectors)
    neighbors = None
    if fibers.min_separation is not None:
        if allocator is not None:
            raise InputError("give min_separation or an allocator, which has positioners of its own, not both")
        neighbors = neighbors_within(index.vectors, float(fibers.min_separation.to_value(u.rad)))
    rng = to_generator(rng)
    if allocator is None:
        priority = None if catalog.priority is None else catalog.priority[index.order]
        serve = FreeFibers(number, priority, neighbors)
    else:
        options = as_options(allocator)
        options.check_for_fields("place_tiles", science_only=True)
        options = options.for_instrument(model)
        serve = FocalPlaneFibers(model, options, catalog, index, number, position_angle, rng)
    problem = TilingProblem(
        radius_rad, index, wanted[index.order], number, serve, allowed, passes, n_tiles, completeness
    )
    state = METHODS[method](problem)
    summary.update(fibers=number, **_account(state, neighbors))
    if completeness is not None and state.completeness < completeness - 1e-12:
        limit = "" if n_tiles is None or len(state.rows) < n_tiles else f", which is all that n_tiles={n_tiles} allows"
        warnings.warn(
            f"{len(state.rows)} tiles reach a completeness of {state.completeness:.4f}, not {completeness:g}{limit}",
            RfpsurveyWarning,
            stacklevel=2,
        )
    if not state.rows:
        warnings.warn("no tile serves any target", RfpsurveyWarning, stacklevel=2)
    centers_, number, n_targets, n_new, so_far = zip(*state.rows, strict=True) if state.rows else [()] * 5
    columns = {
        "n_targets": np.array(n_targets, dtype=np.int64),
        "n_new": np.array(n_new, dtype=np.int64),
        "completeness": np.array(so_far, dtype=float),
    }
    return _build(np.reshape(centers_, (-1, 3)), number, position_angle, summary, columns)


def _place_on_region(region, method, radius_rad, passes, allowed, exclude, position_angle, summary, given):
    """Cover a region."""
    if method not in COVERINGS:
        raise InputError(f"the method {method!r} needs targets, got a Region; {' and '.join(COVERINGS)} cover regions")
    for name in ("n_tiles", "completeness", "visits", "allocator", "min_separation"):
        if given[name] is not None:
            raise InputError(f"{name} is about targets, and a region has none")
    found, quality = cover_region(region, radius_rad, COVERINGS[method], passes, allowed, exclude)
    summary.update(area_deg2=float(region.area.to_value(u.deg**2)), **quality)
    if quality["covering_fraction"] < 1:
        warnings.warn(
            f"the centers that may be cover {quality['covering_fraction']:.4f} of the region",
            RfpsurveyWarning,
            stacklevel=3,
        )
    number = np.repeat(np.arange(passes) + 1, [len(one) for one in found])
    return _build(np.vstack(found), number, position_angle, summary, {})


def _wanted(catalog, visits, exclude):
    """Return the visits wanted of each target of the catalog."""
    if len(catalog) == 0:
        raise InputError("the catalog must have at least one target with finite coordinates, got none")
    visits = catalog.visits if visits is None else visits
    wanted = to_visits(1 if visits is None else visits, len(catalog)).astype(np.int64)
    if catalog.kind is not None:
        wanted[catalog.kind != "science"] = 0
    if exclude is not None:
        wanted[is_inside(exclude, catalog.arrays.vectors)] = 0
    if not wanted.any():
        raise InputError("the catalog must have at least one science target outside of exclude that wants a visit")
    return wanted


def _account(state: TilingState, neighbors) -> dict:
    """Return what was reached."""
    problem = state.problem
    wanted, made = problem.wanted, problem.wanted - state.left
    n = len(state.rows)
    tiles = np.reshape([row[0] for row in state.rows], (-1, 3))
    depth = SkyIndex(tiles).sum_near(problem.index.vectors[wanted > 0], problem.radius, np.ones(n))
    account = {
        "n_targets": int(np.count_nonzero(wanted)),
        "n_on_tiles": int(np.count_nonzero(depth)),
        "n_wanted": int(wanted.sum()),
        "n_observed": int(made.sum()),
        "completeness": float(state.completeness),
        "fiber_use": float(made.sum() / max(n * problem.fibers, 1)),
    }
    if neighbors is not None:
        some = np.flatnonzero(wanted > 0)
        indptr, other = neighbors
        # only neighbors that want a visit are in the way
        near = (
            np.add.reduceat(np.append(wanted[other] > 0, 0), np.minimum(indptr[:-1], len(other))) * np.diff(indptr) > 0
        )
        alone = some[~near[some]]
        account["n_isolated"] = len(alone)
        account["completeness_isolated"] = float(made[alone].sum() / max(wanted[alone].sum(), 1))
    return account


def _build(vectors, number, position_angle, summary, columns):
    """Return the tiling."""
    n = len(vectors)
    ra, dec = to_ra_dec(vectors)
    table = QTable(
        {
            "tile": np.arange(n),
            "ra": ra * u.deg,
            "dec": dec * u.deg,
            "position_angle": np.full(n, position_angle.to_value(u.deg)) * u.deg,
            "pass": np.array(number, dtype=np.int64),
            **columns,
        }
    )
    summary.update(n_tiles=n, passes=int(table["pass"].max(initial=0)) if n else 0)
    table.meta.update(method=summary["method"], summary=summary)
    log.info("placed %d tiles: %s", n, summary)
    return Tiling(table)


def _whole(value, name):
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise refusal(f"{name} must be a whole number of at least 1", value, Number)
    return int(value)
