"""Plan a survey: tile after tile, until targets are observed as often as they are wanted."""

import logging
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from time import perf_counter

import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table
from astropy.time import Time

from rfpsurvey._units import to_seed
from rfpsurvey.allocation import AllocationOptions, as_options, hint_of_name
from rfpsurvey.catalog import Catalog, PartitionedCatalog, as_catalog, as_table, is_table, to_time
from rfpsurvey.errors import (
    InputError,
    InputTypeError,
    check_choice,
    check_keywords,
    check_switch,
    short,
    warn,
)
from rfpsurvey.instrument import Instrument, as_instrument
from rfpsurvey.survey._order import ORDERS
from rfpsurvey.survey._request import make_request
from rfpsurvey.survey._run import run
from rfpsurvey.survey._source import InMemory, Partitioned
from rfpsurvey.survey._survey import Survey
from rfpsurvey.tiling import Tiling, as_tiling, warn_of_targets

__all__ = ["plan_survey"]

log = logging.getLogger("rfpsurvey")


@check_keywords
def plan_survey(
    catalog: Catalog | PartitionedCatalog | SkyCoord | Table,
    instrument: Instrument | str,
    tiling: Tiling | Table | SkyCoord,
    *,
    allocator: AllocationOptions | str | Callable = "lamost",
    visits: int | np.ndarray | None = None,
    passes: list[int] | None = None,
    epoch: Time | str | float | None = None,
    lost_in_collision: bool = True,
    order: str = "color",
    folder: object = None,
    resume: bool = False,
    executor: Executor | None = None,
    progress: bool | Callable = False,
    rng: int | np.random.Generator | None = 0,
) -> Survey:
    """Plan tile after tile; a target leaves the list once it was observed as often as it is wanted.

    Each tile is planned as `plan_tile` plans it, by the same code. Tiles that share targets are planned one after the
    other, all others at the same time if there is an executor: the plan does not depend on it. Required targets
    (`AllocationOptions`) come first in every tile as long as visits of them are left; those that are standards or sky
    positions are never used up, and are in use without requirements, too. Circles that no arm may cover are obstacles
    of the tiles whose arms can touch them.

    Parameters
    ----------
    catalog : Catalog, PartitionedCatalog, SkyCoord, Table or DataFrame
        The targets; those of the kind ``standard`` and ``sky`` serve requirements, without which they are not
        used, and are never used up.
    instrument : Instrument or str
        The instrument, the name of a preset, or the path of a TOML file.
    tiling : Tiling, Table or SkyCoord
        Where to point, see `place_tiles` and `Tiling.from_table`.
    allocator : AllocationOptions or str or callable, optional
        The allocator and its options for every tile, or the allocator alone, see `AllocationOptions`. Processes find an
        allocator by its name: a function is for threads only. A search that its time limit cuts short need not give
        the same plan again.
    visits : int or array_like of int, shape (n_targets,), optional
        How often each target is wanted, 0 to 255 times, at most once a tile; by default as the catalog says, else once.
        Rows of a `PartitionedCatalog` are those of its ``read``.
    passes : list of int, optional
        Passes of the tiling to plan, in this order; all, ascending, by default.
    epoch : Time, str or float, optional
        Move the targets by their proper motions to this epoch.
    lost_in_collision : bool, optional
        Does a target whose arm collides count as not observed? It is then wanted again.
    order : {"color", "given"}, optional
        ``color``: pass after pass; within a pass tiles are colored so that those of one color do not overlap, and
        colors take turns. ``given``: an earlier tile of the list always comes before a later one that overlaps
        it, whatever the passes.
    folder : str or path-like, optional
        Write tile after tile here, as FITS, which holds ASCII text only. Without it all visits are held in memory.
    resume : bool, optional
        Continue the survey in the folder, if one was begun there. Its tiles are verified, damaged ones planned again.
    executor : concurrent.futures.Executor, optional
        Runs tiles in parallel: threads, processes, or a cluster through ``dask.distributed``.
    progress : bool or callable, optional
        Show a line on the standard error with rate and remaining time, which count only the tiles that are planned
        in this run, or call a function with (tiles done, all tiles).
    rng : int, Generator or None, optional
        Seed or source of random numbers; each tile has a stream of its own. A seed that is drawn is written down in
        ``provenance`` and ``survey.json``: a survey is continued with that.

    Returns
    -------
    Survey
        The same for the same input, however many workers there are, and whether or not it was interrupted.

    Raises
    ------
    InputError
        If the catalog or the tiling is empty, a name or a required id is unknown, a number is impossible, or the folder
        is in use, holds another survey, or cannot be written to. Tiles that are written stay.
    concurrent.futures.BrokenExecutor
        If a worker process died, and the executor does not replace it. Tiles that are written stay.

    Warns
    -----
    RfpsurveyWarning
        If no target was observed, required targets were never observed (``summary["unmet"]``), targets share ids,
        nothing in the catalog meets a requirement, an option changes nothing, tiles were placed for fields of
        another size, or a table of tiles looks like one of targets; on resuming, if the software is another, or files
        are damaged.

    See Also
    --------
    plan_tile : One tile.
    place_tiles : Where tiles go.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("poisson", SkyCoord("6h20m +23d"), 1 * u.deg, density=3000 / u.deg**2, rng=1)
    >>> tiles = SkyCoord([94.9, 95.1, 95.0] * u.deg, [23, 23, 23.1] * u.deg)
    >>> survey = rs.plan_survey(sky, "moons", tiles, allocator="repair")
    >>> len(survey), survey.summary["n_colliding"]
    (3, 0)
    """
    begin = perf_counter()
    if executor is not None and not isinstance(executor, Executor):
        raise InputTypeError(f"executor must be a concurrent.futures.Executor, got {short(executor)}")
    asked = as_options(allocator)
    asked.check_for_fields("a survey")
    if callable(asked.allocator) and not isinstance(executor, ThreadPoolExecutor | None):
        raise InputError(
            f"allocator must be a name where processes do the work, such as that of an entry point, got "
            f"{asked.allocator!r}"
        )
    if check_switch(resume, "resume") and folder is None:
        raise InputError("resume needs the folder of the survey to continue")
    instrument = as_instrument(instrument)
    if epoch is not None:
        to_time(epoch, "epoch")
    if isinstance(catalog, PartitionedCatalog):
        source = Partitioned(catalog, epoch)
    else:
        catalog = as_catalog(catalog)
        if epoch is not None and not catalog.has_proper_motion:
            warn("without proper motions the epoch changes nothing")
        source = InMemory(catalog if epoch is None else catalog.at_epoch(epoch))
    tiles = as_tiling(tiling)
    if is_table(tiling):
        warn_of_targets(as_table(tiling)[0], len(source))
    request = make_request(
        source,
        tiles,
        instrument,
        asked.for_instrument(instrument),
        visits=visits,
        passes=passes,
        seed=to_seed(rng),
        order=check_choice(order, ORDERS, "order"),
        epoch=None if epoch is None else str(epoch),
        lost_in_collision=check_switch(lost_in_collision, "lost_in_collision"),
    )
    _warn_of_lacks(request)
    survey = run(request, folder, executor, progress, resume=resume)
    if request.visits.any() and not survey.summary["n_visits_observed"]:
        warn("no target was observed: are the tiles where the targets are?")
    for text in survey.summary["unmet"]:
        warn(text)
    log.info("planned a survey of %d tiles in %.1f s: %s", len(survey), perf_counter() - begin, survey.summary)
    return survey


def _warn_of_lacks(request) -> None:
    """Tell what would go wrong in every tile."""
    if request.source.has_twins:
        warn("some targets share their id with another")
    asked = {one.what: one for one in request.options.requirements if one.minimum}
    if request.options.sky_separation is not None:
        asked.pop("sky", None)
    there = {"science"}
    for name in ("kind", "category") if asked else ():
        column = request.source.by_slot(name)
        there |= set() if column is None else set(np.unique(column).tolist())
    for what, one in asked.items():
        if what not in there:
            hint = "sky_separation would find blank sky" if what == "sky" else hint_of_name(what, there)
            text = f"no target of the catalog is {what!r}, as the requirement '{one}' asks for{hint and '; ' + hint}"
            warn(text)
