"""The function that computes selection probabilities."""

import json
import logging
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from time import perf_counter

import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table
from astropy.time import Time

from rfpsurvey._assignment.methods import DEFAULT_ALLOCATOR
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.partitions import PartitionedCatalog
from rfpsurvey._survey.continue_survey import call_in
from rfpsurvey._survey.history.state import SurveyState
from rfpsurvey._survey.joint.fixed import JointOptions, as_joint
from rfpsurvey._survey.plan import prepare_request
from rfpsurvey._survey.request import Request
from rfpsurvey._survey.selection.alternate import generations_of
from rfpsurvey._survey.selection.probabilities import SelectionProbabilities
from rfpsurvey._survey.selection.run import run
from rfpsurvey._survey.survey import Survey
from rfpsurvey._survey.tiling.tiling import Tiling
from rfpsurvey.errors import InputError, check_choice, check_keywords, check_switch, check_whole, used_elsewhere, warn

log = logging.getLogger("rfpsurvey")
MOST = 1 << 20


@check_keywords
def selection_probabilities(
    catalog: Catalog | PartitionedCatalog | SkyCoord | Table | SurveyState,
    instrument: Instrument | str,
    tiles: Tiling | Survey | Table | SkyCoord,
    n_realizations: int = 128,
    *,
    allocator: AllocationOptions | JointOptions | str | Callable = DEFAULT_ALLOCATOR,
    passes: list[int] | None = None,
    epoch: Time | str | float | None = None,
    lost_in_collision: bool = True,
    order: str = "color",
    folder: object = None,
    resume: bool = False,
    executor: Executor | None = None,
    progress: bool | Callable = False,
    rng: int | np.random.Generator | None = 0,
) -> SelectionProbabilities:
    """Plan a survey many times with different subpriorities, and return which realizations observed each target.

    Realization r is the survey that `plan_survey` plans with ``rng=seed`` and with the option ``subpriority=seed`` of
    `AllocationOptions`, where ``seed`` is the r-th seed of the table ``realizations``. The seeds are drawn from
    ``rng``; if ``n_realizations`` is increased, the first seeds remain the same. For the allocators ``nearest``,
    ``lamost_rule`` and ``balanced``, the targets of a field, their positions on the focal plane, the pairs in reach and
    the poses of arms are computed once for 32 realizations. With all other allocators, and with ``lamost_rule`` if
    there are requirements, each realization takes as long as a complete survey.

    Parameters
    ----------
    catalog : Catalog, PartitionedCatalog, SkyCoord, Table, DataFrame or SurveyState
        The targets, with the requested number of visits of each target. If the state of a survey is given
        (`Survey.state`), each realization repeats its recorded observations: it plans the tiles again whenever the
        survey was planned again, and the same tiles are observed, in which positioners fail at random with the
        measured rates. Cadences require this state.
    instrument : Instrument or str
        Instrument, name of a preset, or path of a TOML file.
    tiles : Tiling, Survey, Table or SkyCoord
        Tiles or field centers, see `place_tiles` and `Tiling.from_table`. If a survey is given, its tiles are planned,
        and its instrument, allocator, options, order and epoch must be the same as those of the realizations.
    n_realizations : int, optional
        Number of realizations, at least 1.
    allocator : AllocationOptions or JointOptions or str or callable, optional
        The allocator for all tiles, with or without its options; it must be the allocator of the survey whose
        selection is studied. A joint plan must have no time limit. The default is the default of `plan_survey`. The
        option ``subpriority`` must not be given.
    passes : list of int, optional
        Passes of the tiling to plan, in this order; by default all passes in ascending order.
    epoch : Time, str or float, optional
        Epoch to which the targets are moved by their proper motions; by default, the times of the tiles, if they
        have times, as in `~rfpsurvey.plan_survey`.
    lost_in_collision : bool, optional
        Whether a target counts as not observed if the arm of its positioner collides; other tiles can then observe the
        target.
    order : {"color", "given"}, optional
        Order of the tiles, as in `plan_survey`.
    folder : str or path-like, optional
        Folder for the checkpoints of an unfinished computation, and for its result, the file ``selection.fits``.
    resume : bool, optional
        Whether to continue an unfinished computation from the checkpoints in ``folder``.
    executor : concurrent.futures.Executor, optional
        Executor that plans tiles in parallel: threads, processes, or a cluster with ``dask.distributed``. Threads need
        the least memory. They run in parallel, because the compiled code releases Python's global interpreter lock.
    progress : bool or callable, optional
        Show the progress on the standard error, or call a function with the number of finished plans and the number of
        all plans. There is one plan for each tile and realization. For each tile, the search for the targets in reach
        counts as one additional plan.
    rng : int, Generator or None, optional
        Seed or random number generator. With None, a seed is drawn; it is recorded in ``provenance``.

    Returns
    -------
    SelectionProbabilities
        For each target, the realizations that observed it (as bits), and the resulting probability. With cadences, also
        the probability that its cadence is completed. The result does not depend on the number of workers or on
        interruptions.

    Raises
    ------
    InputError
        If the catalog or the tiling is empty, if two targets with requested visits have the same id, if a name or the
        identifier of a required target is unknown, if a number is out of range, if a subpriority is given, if a joint
        plan has a time limit or observed tiles, if a survey or its state is given that was planned with another
        instrument or with other options, if a survey with cadences is given without its state, if the rule of the state
        has a table or a function, or if the folder is in use, contains another computation, or is not writable.
    concurrent.futures.BrokenExecutor
        If a worker process ends abruptly and the executor does not replace it. The checkpoints remain.

    Warns
    -----
    RfpsurveyWarning
        If no target was observed, if a survey is given whose plan was not random, if no target has the kind or category
        that a requirement counts, if an option has no effect, if the tiles were placed for fields of another size, or
        if a table of tiles looks like a catalog of targets; on resuming, if the versions of the software differ or
        files are damaged.

    See Also
    --------
    plan_survey : Plan the survey once.
    rfpsurvey.selection.potential_assignments : Find the points of a random catalog that positioners reach.

    References
    ----------
    Bianchi & Percival 2017, MNRAS 472, 1106. Percival & Bianchi 2017, MNRAS 472, L40. Bianchi et al. 2018, MNRAS 481,
    2338. Lasker et al. 2024, arXiv:2404.03006.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> sky = rs.synthetic_catalog("uniform", SkyCoord("6h20m +23d"), 0.3 * u.deg, n_targets=4000, rng=1)
    >>> tiles = SkyCoord([95.0, 95.1] * u.deg, [23, 23] * u.deg)
    >>> found = rs.selection_probabilities(sky, "desi", tiles, n_realizations=64)
    >>> found
    <SelectionProbabilities of 4000 targets in 64 realizations: ...>
    """
    begin = perf_counter()
    is_state, survey = isinstance(catalog, SurveyState), tiles if isinstance(tiles, Survey) else None
    if survey is not None and "cadences" in survey.provenance["parameters"]:
        if not is_state:
            raise InputError(
                "catalog must be the state of a survey with cadences (Survey.state), which contains the cadences, got "
                "a catalog; Survey.select and rfpsurvey select FOLDER read the state from the folder of the survey"
            )
        tiles = catalog.given[3]
    elif survey is not None:
        names = ("tile", "ra", "dec", "position_angle", "pass", *["time"] * ("time" in survey.tiles.colnames))
        tiles = survey.tiles[names]
    check_whole(n_realizations, "n_realizations", 1, MOST)
    if check_switch(resume, "resume") and folder is None:
        raise InputError(
            "the folder of the computation to resume must be given with folder= (or --folder), got no folder"
        )
    check_choice(order, ("color", "given"), "order")
    base = allocator.allocator if isinstance(allocator, JointOptions) else allocator
    if getattr(base, "subpriority", None) is not None:
        raise InputError(
            f"subpriority must not be given, because each realization has its own subpriorities, got {base.subpriority}"
        )
    options = {"allocator": allocator, "passes": passes, "epoch": epoch, "order": order}
    options |= {"lost_in_collision": lost_in_collision, "executor": executor, "rng": rng}

    def prepare(state: SurveyState) -> Request:
        return prepare_request(state.catalog, instrument, tiles, visits=state, **options)

    with used_elsewhere("rng"):
        request = prepare(catalog) if is_state else prepare_request(catalog, instrument, tiles, **options)
    ids = request.source.ids()[request.source.by_row(request.builder.wanted) > 0]
    if len(np.unique(ids)) < len(ids):
        raise InputError(
            "the targets must have different ids, because the random subpriority of a target follows from its id; give "
            "each row of the catalog its own id"
        )
    if request.joint is not None:
        _check_joint(request)
    generations = None
    if is_state:
        _check_same(Survey.read(catalog.folder).provenance, request)
        with used_elsewhere("rng"):
            generations = generations_of(catalog, prepare)
    elif survey is not None:
        if "conditions" in survey.provenance["parameters"]:
            raise InputError(
                "tiles must be a survey that was planned without observing conditions; give the tiling of other surveys"
            )
        _check_same(survey.provenance, request)
    result = run(request, int(n_realizations), folder, executor, progress, resume=resume, generations=generations)
    if request.builder.wanted.any() and result.never_observed.all():
        warn("no target was observed: check that tiles and targets are in the same part of the sky")
    log.info("planned %d realizations in %.1f s: %s", n_realizations, perf_counter() - begin, result.summary)
    return result


def select_survey(survey: Survey, n_realizations: int, **options: object) -> SelectionProbabilities:
    """Compute the selection probabilities of a survey in a folder; see `Survey.select`."""
    given = {name: options.pop(name) for name in ("allocator", "instrument", "rule", "visits") if name in options}
    call = call_in(survey.folder, **given)
    call["catalog"] = call.pop("visits")
    options_of_tiles, joint = as_joint(call["allocator"], "color")
    plain = replace(options_of_tiles, subpriority=None)  # each realization has its own subpriorities
    call["allocator"] = plain if joint is None else replace(joint, allocator=plain)
    return selection_probabilities(n_realizations=n_realizations, **call | options)


def _check_joint(request: Request) -> None:
    """Raise an error if a joint plan cannot be repeated in realizations."""
    if request.joint.time_limit is not None:
        raise InputError(
            "a joint plan must end after a number of iterations in selection probabilities, so that it is "
            f"reproducible, got the time limit {request.joint.time_limit}"
        )
    if request.joint.fixed is not None or (request.state is not None and request.state.kept):
        raise InputError(
            "selection probabilities of a joint plan need a survey of which no tile was observed, got observed tiles"
        )


def _check_same(provenance: dict, request: Request) -> None:
    """Raise an error if the parameters of a survey differ from those of its realizations.

    Warn if the plan of the survey was not random.
    """
    recorded, used = {"moves": "exchange", **provenance["parameters"]}, provenance["instrument"]["name"]
    if request.instrument.name != used:
        raise InputError(f"the instrument must be {used!r}, as for the survey, got {request.instrument.name!r}")
    parameters = {"joint": None, **json.loads(json.dumps(request.parameters))}  # in the form of a survey that was read
    for name, value in parameters.items():
        if name not in ("rng", "time_limit_s", "tie_seed") and recorded.get(name) != value:
            raise InputError(f"{name} must be {recorded.get(name)!r}, as for the survey, got {value!r}")
    order = recorded.get("subpriority")
    if isinstance(order, str):
        warn(f"the weights of the targets that the survey observes are biased unless the column {order!r} is random")
    elif order is None and not request.options.method.is_random and request.source.by_slot("subpriority") is None:
        warn(
            "the survey was planned without the option subpriority, so its plan is not a random realization, and "
            "the weights of the targets that it observes are biased; plan the survey with a seed as subpriority"
        )
