"""Scan many designs of fiber positioners."""

from collections.abc import Callable
from concurrent.futures import Executor

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._executors import map_in_order
from rfpsurvey._progress import Progress
from rfpsurvey._units import to_radian, to_seed
from rfpsurvey.design._axes import to_axes, to_designs
from rfpsurvey.design._checkpoint import Checkpoint
from rfpsurvey.design._front import OBJECTIVES, check_objectives, on_front
from rfpsurvey.design._options import LossOptions
from rfpsurvey.design._rows import FIGURES, to_table
from rfpsurvey.design._start import Start
from rfpsurvey.design._work import Task
from rfpsurvey.errors import InputTypeError, check_keywords, short, warn

__all__ = ["explore_designs", "scan"]

CHUNK = 8
"""Designs of one task. Results do not depend on it."""


@check_keywords
def explore_designs(
    *,
    central_arm: u.Quantity,
    ratio: np.ndarray,
    pitch: u.Quantity,
    clearance: u.Quantity,
    n_designs: int | None = None,
    step: u.Quantity = 0 * u.deg,
    loss: LossOptions | str = "independent",
    objectives: dict[str, str] | None = None,
    rng: int | np.random.Generator | None = 0,
    executor: Executor | None = None,
    progress: bool | Callable = False,
    path: str | None = None,
    resume: bool = False,
    overwrite: bool = False,
) -> QTable:
    """Say of many designs what their positioners reach, and what they lose to collisions.

    A design is a hexagonal lattice of equal positioners without an edge: right-handed arms from elbow to tip, without
    joint limits. What geometry says (coverage, multiplicity) is exact; the loss is the part of the fibers with
    a target that collisions cost, and answers one of three questions, which must not be mixed:

    * ``independent``: every positioner draws a target of its own, uniform over its patrol area; lost is who is in
      collision.
    * ``allocated``: targets fall at random and queue up (`~rfpsurvey.allocate`, ``balanced``); every fiber takes
      one of its queue; lost is who is in collision.
    * ``collision_free``: the plan avoids collisions; lost are the fibers that it leaves idle and a plan blind to
      collisions would not.

    Parameters
    ----------
    central_arm : Quantity, scalar or shape (k,)
        Length of the central arm. Several values of a parameter are nodes of a grid of all combinations.
    ratio : float or array_like of float, shape (k,)
        Eccentric over central arm.
    pitch : Quantity, scalar or shape (k,)
        Distance of neighboring centers.
    clearance : Quantity, scalar or shape (k,)
        Radius that the eccentric arm keeps free around itself, half the minimum separation (but for ``step``).
    n_designs : int, optional
        Number of designs between limits, instead of a grid: each parameter is one value, or (low, high). They are
        scrambled points of Sobol; fewer designs of the same seed are the first of more.
    step : Quantity, optional
        Angle of one step of the motors, of which the minimum separation depends, see `~rfpsurvey.Positioner`.
    loss : LossOptions or {"independent", "allocated", "collision_free"}, optional
        Which loss, and how it is found; a name alone stands for that loss by the cheapest method that is good enough.
    objectives : dict of str to str, optional
        Two columns and whether ``"max"`` or ``"min"`` is wanted, for the front; coverage and loss by default.
    rng : int, Generator or None, optional
        Seed or source of random numbers; each design has a stream of its own.
    executor : concurrent.futures.Executor, optional
        Runs designs in parallel, on threads or processes; the result does not depend on it.
    progress : bool or callable, optional
        Show a line on the standard error, or call a function with (designs done, all designs).
    path : str or path-like, optional
        Keep what is done here, .ecsv or .fits, every ten seconds and at the end.
    resume : bool, optional
        Continue the scan in ``path``, if one was begun there. Objectives may be others than before.
    overwrite : bool, optional
        Replace a file that exists.

    Returns
    -------
    QTable
        A row for each design. ``central_arm``, ``eccentric_arm``, ``ratio``, ``pitch``, ``clearance``,
        ``min_separation`` (D); ``collision_type`` (1: no two arms can touch, 2: only those of first neighbors, 3:
        further ones too); ``multiplicity`` (patrol area over that of a cell); ``reach_0`` to ``reach_3`` (parts of the
        plane that none, one, two, and at least three positioners reach) and ``coverage`` (that any reaches);
        ``targets`` (per positioner) and ``empty`` (fraction of the positioners without any of them in reach);
        ``assigned`` (fibers with a target if arms could pass each other, per positioner; 1 for independent targets),
        ``loss`` of them,
        ``loss_error`` (standard error), ``usable`` (what is left, a positioner); ``positioners_per_area`` and
        ``usable_per_area``; ``estimand`` and ``method`` of the loss; ``n_unproven`` (searches that the time limit
        cut short, so that the loss is too large, and not the same on another machine); ``reason`` why there are no
        figures; ``pareto`` (no design is at least as good in both objectives and better in one). ``meta`` holds the
        request.

    Raises
    ------
    InputError
        If a value is impossible for every design, names are unknown, or the file holds another scan.
    concurrent.futures.BrokenExecutor
        If a worker process died. What was written stays.

    Warns
    -----
    RfpsurveyWarning
        If designs are impossible (they stay in the table without figures), searches were cut short, or the scan was
        begun with other versions of the software.

    See Also
    --------
    rfpsurvey.design.explore_around : The same around an instrument.
    rfpsurvey.design.design_sensitivities : What the figures depend on.
    rfpsurvey.plot.plot_designs : Draws the front.
    rfpsurvey.collision_probability : One instrument as it is.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> table = rs.design.explore_designs(
    ...     central_arm=8.25 * u.mm, ratio=[1, 1.5, 2], pitch=25.6 * u.mm, clearance=2.25 * u.mm
    ... )
    >>> table["coverage"].round(2).tolist(), table["loss"].round(2).tolist()
    ([1.0, 0.91, 1.0], [0.11, 0.27, 0.44])
    >>> table["pareto"].tolist()
    [True, False, False]
    """
    axes = to_axes(central_arm, ratio, pitch, clearance)
    return scan(
        axes,
        n_designs=n_designs,
        step=step,
        loss=loss,
        objectives=objectives,
        rng=rng,
        executor=executor,
        progress=progress,
        path=path,
        resume=resume,
        overwrite=overwrite,
    )


def scan(
    axes: dict[str, np.ndarray],
    start: Start | None = None,
    *,
    n_designs: int | None = None,
    step: u.Quantity = 0 * u.deg,
    loss: LossOptions | str = "independent",
    objectives: dict[str, str] | None = None,
    rng: int | np.random.Generator | None = 0,
    executor: Executor | None = None,
    progress: bool = False,
    path: str | None = None,
    resume: bool = False,
    overwrite: bool = False,
) -> QTable:
    """Return the table of the designs that axes in mm span, and of the one that the scan starts from."""
    if executor is not None and not isinstance(executor, Executor):
        raise InputTypeError(f"executor must be a concurrent.futures.Executor, got {short(executor)}")
    objectives = check_objectives(OBJECTIVES if objectives is None else objectives, FIGURES)
    seed = to_seed(rng)
    loss = loss if isinstance(loss, LossOptions) else LossOptions(loss)
    task = Task(*loss.question, float(to_radian(step, "step")), *loss.targets, loss.n_skies, loss.seconds, seed)
    designs = to_designs(axes, n_designs, seed)
    request = {name: values.tolist() for name, values in axes.items()} | vars(task)
    request["n_designs"] = None if n_designs is None else int(n_designs)
    if start is not None:
        designs, row, record = start.among(designs)
        request["start"] = record
    checkpoint = Checkpoint(path, request, designs, resume=resume, overwrite=overwrite)
    _run(task, designs, checkpoint, executor, progress=progress)
    table = to_table(checkpoint.rows, {**checkpoint.meta, "objectives": objectives})
    if start is not None:
        table["instrument"] = np.where(np.arange(len(table)) == row, start.name, "")
    table["pareto"] = on_front(table, objectives)
    checkpoint.finish(table)
    _warn(table)
    return table


def _run(task, designs, checkpoint, executor, *, progress):
    """Take all designs that are not done into the checkpoint, in their order."""
    starts = range(checkpoint.done, len(designs), CHUNK)
    parts = (designs[start : start + CHUNK] for start in starts)
    with checkpoint.open(), Progress(progress, len(designs), "designs", done=checkpoint.done) as bar:
        for rows in map_in_order(executor, task, starts, parts):
            checkpoint.add(rows)
            checkpoint.save()
            bar(checkpoint.done)


def _warn(table):
    """Tell of designs without figures, and of those that are not proven."""
    strange = table[table["reason"] != ""]
    if len(strange):
        text = (
            f"{len(strange)} of {len(table)} designs have no figures ({strange['reason'][0]}): see the column 'reason'"
        )
        warn(text)
    cut = int(np.count_nonzero(table["n_unproven"]))
    if cut:
        text = f"the time limit cut searches for {cut} of {len(table)} designs short: their loss is at most so large"
        warn(text)
