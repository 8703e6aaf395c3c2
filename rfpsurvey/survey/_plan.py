"""Plan a survey: tile after tile, until targets are observed as often as they are wanted."""

import logging
import warnings
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table
from astropy.time import Time

from rfpsurvey._plugins import name_of
from rfpsurvey._units import to_scalar, to_seed
from rfpsurvey.allocation import METHODS, OBJECTIVES, Requirement, as_requirements, find_method
from rfpsurvey.catalog import Catalog, PartitionedCatalog, as_catalog
from rfpsurvey.errors import InputError, RfpsurveyWarning, check_choice
from rfpsurvey.instrument import Instrument, as_instrument
from rfpsurvey.survey._order import ORDERS
from rfpsurvey.survey._request import make_request
from rfpsurvey.survey._run import run
from rfpsurvey.survey._source import InMemory, Partitioned
from rfpsurvey.survey._survey import Survey
from rfpsurvey.tile import to_length
from rfpsurvey.tiling import Tiling, as_tiling

__all__ = ["plan_survey"]

log = logging.getLogger("rfpsurvey")


def plan_survey(
    catalog: Catalog | PartitionedCatalog | SkyCoord | Table,
    tiles: Tiling | Table | SkyCoord,
    instrument: Instrument | str,
    *,
    allocator: str | Callable = "lamost",
    visits: int | np.ndarray | None = None,
    passes: list[int] | None = None,
    epoch: Time | str | float | None = None,
    requirements: Requirement | str | list | None = None,
    sky_separation: u.Quantity | None = None,
    objective: str = "priority",
    time_limit: u.Quantity = 60 * u.s,
    start: str = "lamost",
    parked_obstacles: bool = True,
    lost_in_collision: bool = True,
    order: str = "color",
    folder: object = None,
    resume: bool = False,
    executor: Executor | None = None,
    progress: object = False,
    rng: int | np.random.Generator | None = 0,
) -> Survey:
    """Plan tile after tile; a target leaves the list once it was observed as often as it is wanted.

    Each tile is planned as `plan_tile` does it. Tiles that share targets are planned one after the other, all others at
    the same time if there is an executor: the plan does not depend on it.

    Parameters
    ----------
    catalog : Catalog, PartitionedCatalog, SkyCoord or Table
        The targets; those of the kind ``standard`` and ``sky`` serve ``requirements``, without which they are not
        used, and are never used up.
    tiles : Tiling, Table or SkyCoord
        Where to point, see `place_tiles` and `Tiling.from_table`.
    instrument : Instrument or str
        The instrument, the name of a preset, or the path of a TOML file.
    allocator : {"balanced", "nearest", "lamost", "sdss", "optimal", "repair"} or str or callable, optional
        Method of the allocation, see `allocate`. Processes find it by its name: a function is for threads only.
    visits : int or array_like of int, shape (n_targets,), optional
        How often each target is wanted, 0 to 255 times, at most once a tile; by default as the catalog says, else once.
        Rows of a `PartitionedCatalog` are those of its ``read``.
    passes : list of int, optional
        Passes of the tiling to plan, in this order; all, ascending, by default.
    epoch : Time, str or float, optional
        Move the targets by their proper motions to this epoch.
    requirements, sky_separation, objective, time_limit, start, parked_obstacles : optional
        For every tile, see `plan_tile`. A search that its time limit cuts short need not give the same plan again.
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
        Show a line with rate and remaining time, or call a function with (tiles done, all tiles).
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
        If the catalog or the tiling is empty, a name is unknown, a number is impossible, or the folder is in use, holds
        another survey, or cannot be written to. Tiles that are written stay.
    concurrent.futures.BrokenExecutor
        If a worker process died, and the executor does not replace it. Tiles that are written stay.

    Warns
    -----
    RfpsurveyWarning
        If no target was observed, targets share ids, nothing in the catalog meets a requirement, an option changes
        nothing, or tiles were placed for fields of another size; on resuming, if the software is another, or files are
        damaged.

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
    >>> survey = rs.plan_survey(sky, tiles, "moons", allocator="repair")
    >>> len(survey), survey.summary["n_colliding"]
    (3, 0)
    """
    begin = perf_counter()
    if executor is not None and not isinstance(executor, Executor):
        raise InputError(f"executor must be a concurrent.futures.Executor, got {executor!r}")
    if callable(allocator) and not isinstance(executor, ThreadPoolExecutor | None):
        raise InputError(
            f"allocator must be a name where processes do the work, such as that of an entry point, got {allocator!r}"
        )
    if resume and folder is None:
        raise InputError("resume needs the folder of the survey to continue")
    instrument = as_instrument(instrument)
    if isinstance(catalog, PartitionedCatalog):
        source = Partitioned(catalog, epoch)
    else:
        catalog = as_catalog(catalog)
        if epoch is not None and not catalog.has_proper_motion:
            warnings.warn("without proper motions the epoch changes nothing", RfpsurveyWarning, stacklevel=2)
        source = InMemory(catalog if epoch is None else catalog.at_epoch(epoch))
    options = _options(
        instrument, allocator, requirements, sky_separation, objective, time_limit, start, parked_obstacles
    )
    request = make_request(
        source, as_tiling(tiles), instrument, options, visits=visits, passes=passes, seed=to_seed(rng),
        order=check_choice(order, ORDERS, "order"), epoch=None if epoch is None else str(epoch),
        lost_in_collision=bool(lost_in_collision),
    )  # fmt: skip
    _warn_of_lacks(request)
    survey = run(request, folder, executor, progress, resume=resume)
    if request.visits.any() and not survey.summary["n_visits_observed"]:
        warnings.warn("no target was observed: are the tiles where the targets are?", RfpsurveyWarning, stacklevel=2)
    log.info("planned a survey of %d tiles in %.1f s: %s", len(survey), perf_counter() - begin, survey.summary)
    return survey


def _warn_of_lacks(request) -> None:
    """Tell what would go wrong in every tile."""
    if request.source.has_twins:
        warnings.warn("some targets share their id with another", RfpsurveyWarning, stacklevel=3)
    asked = {one.what: one for one in request.options["requirements"] if one.minimum}
    if "sky_separation" in request.options:
        asked.pop("sky", None)
    there = {"science"}
    for name in ("kind", "category") if asked else ():
        column = request.source.by_slot(name)
        there |= set() if column is None else set(np.unique(column).tolist())
    for what, one in asked.items():
        if what not in there:
            hint = "; sky_separation would find blank sky" if what == "sky" else ""
            text = f"no target of the catalog is {what!r}, as the requirement '{one}' asks for{hint}"
            warnings.warn(text, RfpsurveyWarning, stacklevel=3)


def _options(instrument, allocator, requirements, sky_separation, objective, time_limit, start, parked_obstacles):
    """Return the options of `allocate` for every tile, checked."""
    find_method(allocator)
    find_method(start, set(METHODS) - {"repair"}, "allocator to start with")
    check_choice(objective, OBJECTIVES, "objective")
    to_scalar(time_limit, u.s, "time_limit", low=0)
    wishes = as_requirements(instrument.requirements if requirements == "instrument" else requirements)
    options = {"method": allocator, "requirements": wishes, "parked_obstacles": bool(parked_obstacles)}
    if sky_separation is not None and not any(one.what == "sky" and one.minimum for one in wishes):
        text = "sky_separation changes nothing: no requirement asks for sky, such as 'sky=20/spectrograph'"
        warnings.warn(text, RfpsurveyWarning, stacklevel=3)
    elif sky_separation is not None:
        options["sky_separation"] = to_length(sky_separation, instrument, "sky_separation")
    others = name_of(allocator) not in METHODS  # which may look at everything
    if others or allocator in ("sdss", "optimal"):
        options.update(objective=objective, time_limit=time_limit)
    if others or allocator == "repair":
        options["start"] = start
    return options
