"""The function `plan_survey`, and the validation of its parameters."""

import logging
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from functools import partial
from time import perf_counter

import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table
from astropy.time import Time

from rfpsurvey._assignment.constraints.targets import mark_required
from rfpsurvey._assignment.methods import DEFAULT_ALLOCATOR
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._assignment.plugin import warn_of_lacks, warn_of_unused_options
from rfpsurvey._assignment.rules import FEWEST_FIRST
from rfpsurvey._common.units import to_seed
from rfpsurvey._field.plan_tile import warn_of_costly_rules
from rfpsurvey._instruments.instrument import Instrument, as_instrument
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.frames import is_table
from rfpsurvey._sky.partitions import PartitionedCatalog, as_catalog
from rfpsurvey._sky.time import OF_CONDITIONS, choose_epoch
from rfpsurvey._survey.cadences import Cadences, warn_of_cadences
from rfpsurvey._survey.folder import with_recorded_moves
from rfpsurvey._survey.history.rule import VisitRule
from rfpsurvey._survey.history.state import SurveyState
from rfpsurvey._survey.joint.fixed import JointOptions, as_joint, check_for_cadences
from rfpsurvey._survey.joint.values import check_categories
from rfpsurvey._survey.plan_file import write_call
from rfpsurvey._survey.request import ORDERS, Request, make_request
from rfpsurvey._survey.run import run
from rfpsurvey._survey.source import InMemory, Partitioned, first_visits, in_memory
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.columns import times_of_tiles, warn_of_numbers, warn_of_programs, warn_of_targets
from rfpsurvey._survey.tiling.tiling import Tiling, as_tiling
from rfpsurvey.errors import (
    InputError,
    InputTypeError,
    check_choice,
    check_keywords,
    check_switch,
    short,
    warn,
    warn_no_effect,
)

log = logging.getLogger("rfpsurvey")


@check_keywords
def plan_survey(
    catalog: Catalog | PartitionedCatalog | SkyCoord | Table,
    instrument: Instrument | str,
    tiles: Tiling | Table | SkyCoord,
    *,
    allocator: AllocationOptions | JointOptions | str | Callable = DEFAULT_ALLOCATOR,
    visits: int | np.ndarray | SurveyState | VisitRule | Cadences | None = None,
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
    """Plan the tiles of a survey such that each target is observed the requested number of times.

    Each tile is planned by the same code as in `plan_tile`. Tiles that share targets are planned one after the other.
    If an executor is given, tiles that do not share targets are planned at the same time. The plan does not depend on
    the executor. Required targets (`AllocationOptions`) take precedence in every tile as long as they have remaining
    visits, and at least one visit of each required target is requested. A standard or sky position that is a required
    target can be used any number of times, even if the options contain no requirements. Constraints apply to each tile:
    targets that they exclude are not observed, and the tile has their obstacles.

    Parameters
    ----------
    catalog : Catalog, PartitionedCatalog, SkyCoord, Table or DataFrame
        The targets. Targets of the kinds ``standard`` and ``sky`` are used only to meet requirements. Each of them can
        be used any number of times, unless its number of visits is 0.
    instrument : Instrument or str
        Instrument, name of a preset, or path of a TOML file. If the states of its positioners change with time
        (`Instrument.with_states`), each tile uses the states of its time.
    tiles : Tiling, Table or SkyCoord
        Tiles or field centers; see `place_tiles` and `Tiling.from_table`.
    allocator : AllocationOptions or JointOptions or str or callable, optional
        The allocator of every tile, or options that include the allocator; see `AllocationOptions`. With ``joint`` or
        `JointOptions`, all tiles are planned together, which increases the number of visits. If worker
        processes plan the tiles, the allocator must be given by its name; a function can only be used in threads. If
        the search of an allocator ends at its time limit, the plan may not be reproducible.
    visits : int, array_like of int of shape (n_targets,), SurveyState, VisitRule or Cadences, optional
        Requested number of visits of each target, 0 to 255, or one number from 1 to 255 for all targets. The default is
        the column ``visits`` of the catalog. If the catalog lacks this column, one visit of each target is requested.
        Targets of any kind with 0 visits are not assigned, except required targets. A tile observes a target at most
        once. For a `~rfpsurvey.catalog.PartitionedCatalog`, the values must be in the order in which its method
        ``read`` returns the targets. With a `~rfpsurvey.survey.SurveyState`, observed tiles keep their plans, and the
        other tiles are planned for the visits that remain. A `~rfpsurvey.survey.VisitRule` determines the visits of the
        first plan. With `~rfpsurvey.survey.Cadences`, the tiles have dates, and targets are observed in windows of
        time.
    passes : list of int, optional
        Passes of the tiling that are planned, in the given order; by default, all passes in ascending order.
    epoch : Time, str or float, optional
        Epoch to which the targets are moved by their proper motions. By default, the time of each tile, if the tiling
        has times (a column ``time``, ``mjd`` or ``date``, or conditions with times); otherwise, the targets are not
        moved. ``summary["epoch"]`` states the epoch.
    lost_in_collision : bool, optional
        Whether a target counts as not observed if the arm at this target collides, so that other tiles can observe it.
    order : {"color", "given"}, optional
        ``color``: pass after pass. In each pass, tiles are colored such that tiles of the same color do not overlap,
        and one color is planned after the other. ``given``: if two tiles overlap, the tile that is earlier in the
        list is planned first, even if it belongs to a later pass. The order of a joint plan is ``color``. With
        ``cadences``, tiles are planned in the order of their times, and this parameter has no effect.
    folder : str or path-like, optional
        Folder to which the visits of each tile are written as a FITS file. Identifiers and other text must then be
        ASCII, because FITS allows no other characters. Without a folder, the visits of all tiles are kept in memory.
    resume : bool, optional
        Whether to continue a survey in the folder, which is unfinished, or to which tiles are added after its own. The
        files of its tiles are verified, and tiles whose files are damaged are planned again.
    executor : concurrent.futures.Executor, optional
        Executor that plans tiles in parallel: threads, processes, or a cluster with ``dask.distributed``.
    progress : bool or callable, optional
        Show the progress on the standard error, or call a function with two arguments: the number of finished tiles,
        and the number of all tiles. The displayed rate and the remaining time are computed only from tiles that are
        planned in this run.
    rng : int, Generator or None, optional
        Seed or random number generator; each tile has its own stream of random numbers. With None, a random seed is
        drawn and recorded in ``provenance`` and ``survey.json``. Give this seed to continue the survey.

    Returns
    -------
    Survey
        The survey. The plan does not depend on the number of workers or on interruptions.

    Raises
    ------
    InputError
        If the catalog or the list of tiles is empty, if the name of an instrument, allocator or order is unknown, if a
        required target is not in the catalog, if a number is out of range, or if the folder is in use, contains another
        survey, or is not writable. The files of finished tiles remain.
    concurrent.futures.BrokenExecutor
        If a worker process ends abruptly and the executor does not replace it. The files of finished tiles remain.

    Warns
    -----
    RfpsurveyWarning
        If no target was observed, if tiles do not meet requirements or required targets were never observed
        (``summary["unmet"]``), if identifiers occur twice, if the catalog has no target of a kind or category that a
        requirement names, if rules on the distribution of fibers cost more than 3 % of the science targets
        (``summary["n_lost_to_rules"]``), if an option has no effect, if the tiles were placed for fields of another
        size, or if a table of tiles looks like a catalog of targets. There are also warnings if a survey is continued
        with other versions of the software, or if its files are damaged.

    See Also
    --------
    plan_tile : Plan a single tile.
    place_tiles : Place the tiles of a survey.

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
    if check_switch(resume, "resume") and folder is None:
        raise InputError("the folder of the survey to resume must be given with folder= (or --folder), got no folder")
    call = {"instrument": instrument, "tiles": tiles, "allocator": allocator, "visits": visits, "passes": passes}
    call["epoch"] = epoch
    others = {"lost_in_collision": lost_in_collision, "order": order, "executor": executor, "rng": rng}
    request = prepare_request(catalog, **call, **others, folder=folder if resume else None)
    survey = run(request, folder, executor, progress, resume=resume, record=partial(write_call, request, call))
    if request.builder.wanted.any() and not survey.summary["n_visits_observed"]:
        warn("no target was observed: check that tiles and targets are in the same part of the sky")
    for text in survey.summary["unmet"]:
        warn(text)
    warn_of_costly_rules(survey.summary.get("n_lost_to_rules", 0), survey.summary["n_science"])
    log.info("planned a survey of %d tiles in %.1f s: %s", len(survey), perf_counter() - begin, survey.summary)
    return survey


def prepare_request(
    catalog,
    instrument,
    tiles,
    *,
    allocator,
    passes,
    epoch,
    lost_in_collision,
    executor,
    visits=None,
    order="color",
    rng=0,
    folder=None,
) -> Request:
    """Return the validated request of a survey; the parameters are those of `plan_survey`.

    ``folder`` is the folder of an unfinished survey.
    """
    if executor is not None and not isinstance(executor, Executor):
        raise InputTypeError(f"executor must be a concurrent.futures.Executor, got {short(executor)}")
    state = visits if isinstance(visits, SurveyState) else None
    catalog = given = catalog if isinstance(catalog, PartitionedCatalog) else as_catalog(catalog)
    if isinstance(visits, VisitRule):
        catalog, visits = first_visits(catalog, visits)
    if state is not None:
        state.check_catalog(catalog)
        catalog, visits = state.catalog, state.requested
    asked, joint = as_joint(allocator, order)
    cadences = visits if isinstance(visits, Cadences) else state and state.cadences
    if cadences is not None:
        catalog = in_memory(catalog, "cadences")
        if state is None:
            visits = cadences.visits(catalog, mark_required(asked.required_ids, [catalog.id]))
        cadences = cadences, cadences.of(catalog)
        if asked.subpriority == FEWEST_FIRST:
            warn_no_effect("subpriority", "with cadences")
        if catalog.subpriority is not None:
            warn("the subpriorities of the catalog have no effect on a survey with cadences")
        if catalog.visits is not None and (catalog.visits > 1).any():
            warn("the visits of the catalog have no effect on a survey with cadences, except 0")
    asked.check_for_fields("a survey")
    asked = with_recorded_moves(asked, folder if state is None else state.folder)
    if callable(asked.allocator) and not isinstance(executor, ThreadPoolExecutor | None):
        raise InputError(
            f"allocator must be a name, such as the name of an entry point, unless the executor uses threads, got "
            f"{asked.allocator!r}"
        )
    instrument = as_instrument(instrument, may_be_dated=True)
    tiling = as_tiling(tiles)
    warn_of_unused_options([asked], instrument.focal_plane, rng if joint is None else 0)  # a joint search uses rng
    warn_of_programs(tiling)
    is_partitioned = isinstance(catalog, PartitionedCatalog)
    first = catalog.parts.part(0) if is_partitioned else catalog
    times, of = times_of_tiles(tiling, dates=False) if len(tiling) else None, OF_CONDITIONS
    if times is None and len(tiling) and first.has_proper_motion:
        times, of = times_of_tiles(tiling), "the times of the tiles"
        warn_of_numbers(tiling)
    used, moved = choose_epoch(first, epoch, times, whole=not is_partitioned, of=of)
    if is_partitioned:
        source = Partitioned(catalog, used)
    else:
        source = InMemory(catalog if used is None else catalog.at_epoch(used))
    if cadences is not None and joint is not None:
        check_for_cadences(joint)
    elif joint is not None and joint.objective != "visits":
        for name in ["early"] * joint.early + ["subpriority"] * (asked.subpriority is not None):
            warn_no_effect(name, f"with the objective {joint.objective!r}")
    if is_table(tiles):
        warn_of_targets(tiling, len(source))
    options, seed = asked.for_instrument(instrument), to_seed(rng)
    others = {"seed": seed, "order": check_choice(order, ORDERS, "order"), "joint": joint, "cadences": cadences}
    others |= {"lost_in_collision": check_switch(lost_in_collision, "lost_in_collision"), "moved": moved}
    others |= {"epoch": None, "reference": used} if epoch is None else {"epoch": str(epoch), "reference": None}
    others |= {"visits": visits, "passes": passes, "state": state, "given": given if state is None else state.first}
    request = make_request(source, tiling, instrument, options, **others)
    if joint is not None and cadences is None:
        check_categories(joint, source.by_slot("category"), request.builder.wanted)
    if cadences is not None and state is None:
        warn_of_cadences(cadences[0], np.where(visits > 0, cadences[1], -1), request.days, request.brightness)
    if request.source.has_repeated_ids:
        warn("some targets have the same id as another target")
    warn_of_lacks(request.options, request.source.by_slot)
    return request
