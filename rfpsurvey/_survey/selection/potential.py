"""Potential assignments: the tiles and positioners that can reach the points of a random catalog."""

import json
import os
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table, vstack
from astropy.time import Time

from rfpsurvey._common import io as _io
from rfpsurvey._common.descriptions import Column, describe, table_of
from rfpsurvey._common.executors import Progress
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.partitions import PartitionedCatalog
from rfpsurvey._survey.columns import NOT_PLANNED
from rfpsurvey._survey.plan import prepare_request
from rfpsurvey._survey.request import Request
from rfpsurvey._survey.selection.probabilities import count_type
from rfpsurvey._survey.selection.run import IN_FLIGHT
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.columns import places_of_tiles
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey._survey.work import Job, reach_of, run_rounds
from rfpsurvey.errors import InputError, InputTypeError, check_keywords, check_switch, number_of, short

COLUMNS = table_of(
    Column("tile", "identifier of the tile"),
    Column("positioner", "identifier of the positioner"),
    Column("point", "row of the point in the catalog of points"),
)
PLACE = ("tile", "ra", "dec", "position_angle", "pass")
# Largest difference (degrees) between the centers and position angles of equal tiles.
ROUNDING = 1e-8


@check_keywords
def potential_assignments(
    catalog: Catalog | PartitionedCatalog | SkyCoord | Table,
    instrument: Instrument | str,
    tiles: Tiling | Table | SkyCoord,
    *,
    passes: list[int] | None = None,
    epoch: Time | str | float | None = None,
    survey: Survey | None = None,
    executor: Executor | None = None,
    progress: bool | Callable = False,
) -> "PotentialAssignments":
    """Find which tiles and positioners can reach each point of a random catalog.

    Disabled and stuck positioners reach no point. Joint limits, fiber types, and circles of the focal plane that
    receive no light are taken into account. Collisions are taken into account only if a survey is given.

    Parameters
    ----------
    catalog : Catalog, PartitionedCatalog, SkyCoord, Table or DataFrame
        The points.
    instrument : Instrument or str
        Instrument, name of a preset, or path of a TOML file.
    tiles : Tiling, Table or SkyCoord
        Tiles or field centers, see `~rfpsurvey.place_tiles` and `~rfpsurvey.Tiling.from_table`.
    passes : list of int, optional
        Passes of the tiling to use; by default all passes.
    epoch : Time, str or float, optional
        Epoch to which the points are moved by their proper motions; by default, the times of the tiles, if they
        have times, as in `~rfpsurvey.plan_survey`.
    survey : Survey, optional
        A survey planned with these tiles. In each tile, positioners whose target is lost to a collision reach no point.
    executor : concurrent.futures.Executor, optional
        Executor that processes several tiles in parallel, such as a pool of threads.
    progress : bool or callable, optional
        Show the progress on the standard error, or call a function with the number of finished tiles and the number of
        all tiles.

    Returns
    -------
    PotentialAssignments
        An object that computes the assignments tile by tile when they are read, so that the assignments of all tiles
        need not fit into memory.

    Raises
    ------
    InputError
        If the points or the tiles are empty, if a name is unknown, or if the survey was planned with other tiles or
        another instrument.

    See Also
    --------
    rfpsurvey.selection_probabilities : Compute the probabilities with which targets are observed.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> points = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=4000, rng=1)
    >>> found = rs.selection.potential_assignments(points, "desi", SkyCoord([95.0, 95.1] * u.deg, [23, 23] * u.deg))
    >>> found.table.colnames
    ['tile', 'positioner', 'point']
    >>> int(found.n_tiles().max())
    2
    """
    if survey is not None and not isinstance(survey, Survey):
        raise InputTypeError(f"survey must be a Survey, got {short(survey)}")
    if not callable(progress):
        check_switch(progress, "progress")
    options = {"allocator": "nearest", "lost_in_collision": False}
    options |= {"passes": passes, "epoch": epoch, "executor": executor}
    request = prepare_request(catalog, instrument, tiles, **options)
    potential = PotentialAssignments(request, survey, executor, progress)
    if survey is not None:
        _check_survey(request, survey)
    return potential


@dataclass(frozen=True, eq=False)
class PotentialAssignments:
    """The tiles and positioners that can reach each point, which are computed tile by tile when they are read.

    Iteration yields a table for each tile. Each iteration, and each call of a method, computes all tiles again.

    Parameters
    ----------
    request : Request
        Points, tiles and instrument.
    survey : Survey or None
        Survey that was planned with these tiles; None if collisions are ignored.
    executor : concurrent.futures.Executor or None
        Executor that processes several tiles in parallel.
    progress : bool or callable
        Whether to show the progress, or a function that is called with the progress.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> points = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=4000, rng=1)
    >>> found = rs.selection.potential_assignments(points, "desi", SkyCoord([95.0, 95.1] * u.deg, [23, 23] * u.deg))
    >>> sum(len(table) for table in found) == len(found.table)
    True
    """

    request: Request
    survey: Survey | None
    executor: Executor | None
    progress: object

    def n_tiles(self) -> np.ndarray:
        """Return the number of tiles in which at least one positioner reaches each point.

        Returns
        -------
        ndarray of int, shape (n_points,)
            Number of tiles, in the order of the catalog of points.
        """
        n_tiles = np.zeros(len(self.request.source), dtype=count_type(len(self)))
        for _, _, rows in self._pairs():
            n_tiles[np.unique(rows)] += 1
        return n_tiles

    @property
    def table(self) -> QTable:
        """All potential assignments: ``tile``, ``positioner``, and ``point`` (row in the catalog of points).

        If there are many points, use `write`, or iterate over this object, which yields a table for each tile.
        """
        return vstack(list(self), metadata_conflicts="silent")

    def __iter__(self) -> Iterator[QTable]:
        return (describe(QTable(rows), COLUMNS) for rows in self._rows())

    def __len__(self):
        return int((~self._is_dropped).sum())

    def __repr__(self):
        points = number_of(len(self.request.source), "point")
        return f"<PotentialAssignments of {points} in {number_of(len(self), 'tile')}>"

    def write(self, path: str | os.PathLike, *, overwrite: bool = False) -> int:
        """Write all potential assignments to a FITS file, tile by tile.

        Parameters
        ----------
        path : str or path-like
            Path that ends in ``.fits``.
        overwrite : bool, optional
            Whether to replace an existing file.

        Returns
        -------
        int
            Number of rows.

        Raises
        ------
        InputError
            If the folder does not exist, if the file exists and ``overwrite`` is False, or if FITS cannot represent
            some of the text.
        """
        self.request.check_text()
        cards = {
            **_io.table_cards("POTENTIAL", list(COLUMNS), {name: column.text for name, column in COLUMNS.items()}),
            "INSTRUME": (self.request.instrument.name, "instrument"),
            "NTILES": (len(self), "number of tiles"),
            "NPOINTS": (len(self.request.source), "number of points"),
            _io.META_KEY: json.dumps({"request": self.request.identity()}, separators=(",", ":"), default=str),
        }
        return _io.write_fits_rows(path, _io.FitsRows(self._dtype, cards, self._rows()), overwrite=overwrite)[0]

    @property
    def _dtype(self) -> np.dtype:
        tile, positioner = np.asarray(self.request.tiling.table["tile"]), self.request.instrument.focal_plane.id
        return np.dtype([("tile", tile.dtype), ("positioner", positioner.dtype), ("point", np.int64)])

    def _rows(self) -> Iterator[np.ndarray]:
        """Yield the rows of each tile, sorted by point, then by positioner."""
        names, ids = np.asarray(self.request.tiling.table["tile"]), self.request.instrument.focal_plane.id
        for tile, owner, point in self._pairs():
            yield np.rec.fromarrays([np.full(len(owner), names[tile]), ids[owner], point], dtype=self._dtype)

    def _pairs(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Yield, for each tile, its row, and the rows of the positioner and of the point of each pair in reach."""
        request = self.request
        open_job = partial(request.job, left=np.ones(len(request.source), dtype=np.uint8))
        tiles, names = np.flatnonzero(~self._is_dropped), np.asarray(request.tiling.table["tile"])
        with Progress(self.progress, len(tiles), "tiles") as tell:
            results = run_rounds([tiles], self.executor, reachable, open_job, most=IN_FLIGHT)
            for k, (tile, job, (owner, target), _) in enumerate(results, 1):
                if self.survey is not None:  # positioners that lose their target to a collision reach no point
                    visits = self.survey.tile(names[tile])
                    lost = np.asarray(visits["positioner"])[np.asarray(visits["in_collision"])]
                    keeps_target = ~np.isin(request.instrument.focal_plane.id[owner], lost)
                    owner, target = owner[keeps_target], target[keeps_target]
                yield tile, owner, job.field.row[target]
                tell(k)

    @cached_property
    def _is_dropped(self) -> np.ndarray:
        """Whether each tile was dropped from the survey, and is never observed."""
        names = np.asarray(self.request.tiling.table["tile"])
        if self.survey is None or "state" not in self.survey.tiles.colnames:
            return np.zeros(len(names), dtype=bool)
        table = self.survey.tiles
        return np.isin(names, np.asarray(table["tile"])[np.isin(table["state"], NOT_PLANNED)])


def reachable(job: Job) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each pair in reach, the row of the positioner and the index of the target in the field."""
    pairs = reach_of(job).pairs
    return pairs.owner, pairs.target


def _check_survey(request: Request, survey: Survey) -> None:
    """Raise an error unless a survey was planned with the same tiles and instrument."""
    row_of = {name: k for k, name in enumerate(np.asarray(survey.tiles["tile"]).tolist())}
    names = np.asarray(request.tiling.table["tile"]).tolist()
    missing = [name for name in names if name not in row_of]
    if missing:
        raise InputError(
            f"survey must contain all tiles, but it has no tile {missing[0]} "
            f"({len(missing)} of {len(request.tiling)} tiles are missing)"
        )
    there = places_of_tiles(Tiling(QTable(survey.tiles[[row_of[name] for name in names]][PLACE], meta={})))
    apart = np.abs((there - places_of_tiles(request.tiling) + 180) % 360 - 180).max(axis=1)
    for k in np.flatnonzero(apart > ROUNDING)[:1].tolist():
        raise InputError(
            f"survey must have the same centers and position angles as the tiles, got another place for tile {names[k]}"
        )
    planned, instrument = survey.provenance["instrument"], request.instrument.provenance
    if planned.get("digest") != instrument["digest"]:
        raise InputError(f"survey must be a plan for {request.instrument.name}, got one for {planned.get('name')}")
