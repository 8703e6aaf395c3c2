"""A random catalog for pair counts, with the completeness of a survey and without vetoed areas."""

from collections.abc import Callable, Iterable
from concurrent.futures import Executor

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

from rfpsurvey._common.descriptions import Column, describe, table_of
from rfpsurvey._common.settings import Option, number_within
from rfpsurvey._common.units import to_axes, to_lonlat, to_scalar
from rfpsurvey._instruments.instrument import Instrument, as_instrument
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.partitions import as_catalog
from rfpsurvey._sky.region import Region
from rfpsurvey._survey.selection.potential import potential_assignments
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.tiling import Tiling, as_tiling
from rfpsurvey.errors import InputError, InputTypeError, check_keywords, short

RANDOM = table_of(
    Column("ra", "right ascension of the point (ICRS)", "deg"),
    Column("dec", "declination of the point (ICRS)", "deg"),
    Column("n_tiles", "number of tiles in which a positioner reaches the point"),
    Column("n_targets", "number of science targets that positioners reach in the same tiles"),
    Column("completeness", "fraction of these targets that the survey observes"),
)
"""Columns of a random catalog; the last two only with a survey."""
MOST = 10**9
"""Largest number of points per square degree."""


@check_keywords
def random_catalog(
    catalog: Catalog | Table,
    instrument: Instrument | str,
    tiles: Tiling | Table | SkyCoord,
    *,
    density: u.Quantity,
    survey: Survey | None = None,
    veto: Iterable[Region] = (),
    rng: int = 0,
    executor: Executor | None = None,
    progress: bool | Callable = False,
) -> QTable:
    """Return uniformly distributed points that a survey can observe, with the completeness at each point.

    Points in the same set of tiles have the same completeness: the fraction of the science targets in the reach of
    positioners in exactly these tiles that the survey observes at least once. Points out of reach of all positioners,
    and points in vetoed regions, are left out.

    Parameters
    ----------
    catalog : Catalog or Table
        The targets of the survey.
    instrument : Instrument or str
        Instrument, name of a preset, or path of a TOML file.
    tiles : Tiling, Table or SkyCoord
        The tiles.
    density : Quantity
        Mean number of points per solid angle, before points are left out.
    survey : Survey, optional
        The survey that was planned with the catalog and the tiles. Positioners whose target is lost to a collision
        reach no point. Without a survey, there is no completeness.
    veto : list of Region, optional
        Areas without points, such as the surroundings of bright stars.
    rng : int, optional
        Seed of the random numbers.
    executor, progress : optional
        As in `potential_assignments`.

    Returns
    -------
    QTable
        Columns ``ra``, ``dec``, ``n_tiles`` and, with a survey, ``n_targets`` and ``completeness``. Where
        ``n_targets`` is 0, the completeness is the mean of the points in the same number of tiles. ``meta`` contains
        ``n_drawn``, ``n_vetoed``, ``n_out_of_reach`` and ``n_without_targets`` (numbers of points).

    Raises
    ------
    InputError
        If a value is not valid, or if the survey was planned with other targets, tiles or another instrument.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 1.8 * u.deg, n_targets=4000, rng=1)
    >>> tiles = SkyCoord([95.0, 95.6] * u.deg, [23, 23] * u.deg)
    >>> survey = rs.plan_survey(sky, "desi", tiles)
    >>> points = rs.selection.random_catalog(sky, "desi", tiles, density=500 / u.deg**2, survey=survey)
    >>> points.colnames
    ['ra', 'dec', 'n_tiles', 'n_targets', 'completeness']
    """
    model, tiling, targets = as_instrument(instrument), as_tiling(tiles), as_catalog(catalog)
    if not isinstance(targets, Catalog):
        raise InputError("catalog must be a catalog in memory, got a partitioned catalog")
    number = number_within(to_scalar(density, u.deg**-2, "density"), "density (1 / deg2)", Option(above=0, high=MOST))
    veto = [veto] if isinstance(veto, Region) else list(veto)
    for region in veto:
        if not isinstance(region, Region):
            raise InputTypeError(f"veto must be a list of Region, got {short(region)}")
    points = _points(tiling, model.field_radius.to_value(u.rad), number, np.random.default_rng(rng))
    n_drawn, is_kept = len(points), np.ones(len(points), dtype=bool)
    for region in veto:
        is_kept &= ~region.contains(points)
    points = points[is_kept]
    if not len(points):
        raise InputError(f"density must be larger, or veto smaller: no point of {n_drawn} is left")
    parts = [[getattr(place, axis).deg for place in (points, targets.coord)] for axis in ("ra", "dec")]
    both = SkyCoord(*map(np.concatenate, parts), unit="deg")
    options = {"survey": survey, "executor": executor, "progress": progress}
    n_tiles, group = _groups(potential_assignments(Catalog(both), model, tiling, **options), len(both))
    n, in_reach = len(points), n_tiles[: len(points)] > 0
    table = QTable({"ra": points.ra[in_reach], "dec": points.dec[in_reach], "n_tiles": n_tiles[:n][in_reach]})
    table.meta = {"made_by": "random_catalog", "n_drawn": n_drawn, "n_vetoed": n_drawn - n}
    table.meta |= {"n_out_of_reach": int((~in_reach).sum()), "density_per_deg2": number}
    if survey is not None:
        is_wanted = np.ones(len(targets), dtype=bool) if targets.kind is None else has_role(targets.kind, "science")
        is_wanted &= True if targets.visits is None else targets.visits > 0
        size = group.max() + 1
        asked = np.bincount(group[n:][is_wanted], minlength=size)
        made = np.bincount(group[n:][is_wanted & _observed(survey, targets)], minlength=size)
        own = group[:n][in_reach]
        table["n_targets"], table["completeness"] = asked[own], made[own] / np.maximum(asked[own], 1)
        has_none = asked[own] == 0
        for k in np.unique(table["n_tiles"][has_none]):
            is_same = table["n_tiles"] == k
            known = table["completeness"][is_same & ~has_none]
            table["completeness"][is_same & has_none] = known.mean() if len(known) else np.nan
        table.meta["n_without_targets"] = int(has_none.sum())
    return describe(table, RANDOM)


def _points(tiling: Tiling, radius: float, density: float, rng: np.random.Generator) -> SkyCoord:
    """Return points of a Poisson process in the union of the fields; each point is drawn in the first of its fields."""
    from scipy.spatial import cKDTree

    centers, chord = tiling.coord.cartesian.xyz.value.T, 2 * np.sin(radius / 2)
    area, tree, parts = 2 * np.pi * (1 - np.cos(radius)) * (180 / np.pi) ** 2, cKDTree(centers), []
    for k, center in enumerate(centers):
        n = rng.poisson(density * area)
        height, angle = rng.uniform(np.cos(radius), 1, n), rng.uniform(0, 2 * np.pi, n)
        _, east, north = to_axes(*to_lonlat(center))
        across = np.sqrt(1 - height**2)[:, None] * (np.cos(angle)[:, None] * east + np.sin(angle)[:, None] * north)
        vectors = height[:, None] * center + across
        earlier = [i for i in tree.query_ball_point(center, 2 * chord * 1.0001) if i < k]
        if earlier:
            vectors = vectors[(np.linalg.norm(vectors[:, None] - centers[earlier], axis=2) > chord).all(axis=1)]
        parts.append(vectors)
    lon, lat = to_lonlat(np.concatenate(parts))
    return SkyCoord(np.rad2deg(lon) % 360, np.rad2deg(lat), unit="deg")


def _groups(potential, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of tiles that reach each point, and a number that is equal for points in the same tiles."""
    n_tiles, group, following = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64), 1
    for _, _, rows in potential._pairs():
        rows = np.unique(rows)
        before, new = np.unique(group[rows], return_inverse=True)
        group[rows], following = following + new, following + len(before)
        n_tiles[rows] += 1
    return n_tiles, np.unique(group, return_inverse=True)[1]


def _observed(survey: Survey, targets: Catalog) -> np.ndarray:
    """Return which targets the survey observes at least once."""
    is_observed = np.zeros(len(targets), dtype=bool)
    for visits in survey:
        row = np.asarray(visits["target_row"])[np.asarray(visits["observed"]).astype(bool)]
        row = row[row >= 0]
        if len(row) and row.max() >= len(targets):
            raise InputError(f"catalog must be that of the survey, got one with {len(targets)} targets")
        is_observed[row] = True
    return is_observed
