"""Scan many designs of fiber positioners, with options that define how the loss is computed, possibly in processes.

The loss is the fraction of fibers lost to collisions.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._common.descriptions import describe_methods
from rfpsurvey._common.executors import Progress, map_in_order
from rfpsurvey._common.settings import Settings, option
from rfpsurvey._common.units import is_seed_given, to_scalar, to_seed
from rfpsurvey._studies import design_rows as _rows
from rfpsurvey._studies.losses import ESTIMANDS, METHODS, Skies, automatic, cheapest, in_box, make_lattice
from rfpsurvey.errors import InputError, check_keywords, warn, warn_of_unused

MOST_TARGETS = 1000.0


@dataclass(frozen=True)
class Task:
    """The settings of a scan that are the same for all designs; quantities are numbers without units."""

    estimand: str
    method: str
    step: float
    """Motor step, in radians."""
    targets: float
    """Number of targets: per mm^2 if ``by_area`` is true, otherwise per positioner."""
    by_area: bool
    n_skies: int
    time_limit: float
    seed: int

    def __call__(self, first: int, designs: np.ndarray) -> np.ndarray:
        """Return the records of consecutive designs; ``first`` is the index of the first design."""
        rows = _rows.blank(designs, self.estimand)
        for number, row in enumerate(rows, first):
            self._fill(row, np.random.default_rng([self.seed, number]))
        return rows

    def _fill(self, row, rng):
        lattice, reason = make_lattice(row["central_arm"], row["ratio"], row["pitch"], row["clearance"], self.step)
        if lattice is None:
            row["reason"] = reason
            return
        row["min_separation"], row["collision_type"] = lattice.unit.numbers.separation, lattice.collision_type
        row["multiplicity"], row["positioners_per_area"] = lattice.multiplicity, 100 / lattice.cell
        for depth, part in enumerate(lattice.coverage()):
            row[f"reach_{depth}"] = part
        row["coverage"] = 1 - row["reach_0"]
        each = self.targets * (lattice.cell if self.by_area else 1.0)
        row["targets"], row["empty"] = each, np.exp(-each * lattice.multiplicity)
        if each > MOST_TARGETS:
            row["reason"] = f"the number of targets per positioner exceeds {MOST_TARGETS:g}"
            return
        method = cheapest(self.estimand, lattice) if self.method == "auto" else self.method
        if METHODS[method].limited and not in_box(lattice):
            row["reason"] = f"the parameters are outside the range of the method {method!r}"
            return
        loss = METHODS[method].function(lattice, Skies(each, self.n_skies, rng, self.time_limit))
        row["method"] = method
        row["assigned"], row["loss"], row["loss_error"], row["n_unproven"], row["loss_gap"] = loss
        row["usable"] = loss.assigned * (1 - loss.loss)
        row["usable_per_area"] = row["usable"] * row["positioners_per_area"]
        if np.isnan(loss.loss):
            row["reason"] = "no fiber has a target"


PER_POSITIONER = 4.0
"""Default number of targets per positioner."""


@check_keywords
@describe_methods(METHODS)
@dataclass(frozen=True, eq=False, repr=False)
class LossOptions(Settings):
    """Definition of the fraction of fibers that a design loses to collisions, and the method that computes it.

    Parameters
    ----------
    estimand : {"independent", "allocated", "collision_free"}, optional
        Definition of the loss, see `~rfpsurvey.design.explore_designs`. By default, it is the definition that
        ``method`` uses; for the method ``auto``, it is ``independent``.
    method : str, optional
        Method that computes the loss.
        {methods}
        ``auto`` selects the fastest method that is accurate enough for a design: for ``independent``, ``surrogate`` if
        the design is within the range of this method and the result is at least 0.01, otherwise ``quadrature``; for
        ``allocated``, ``conditional``; for ``collision_free``, ``optimal``.
    targets_per_positioner : float, optional
        Mean number of Poisson-distributed targets per positioner; four by default.
    target_density : Quantity, optional
        Number of Poisson-distributed targets per area of the focal plane, instead of ``targets_per_positioner``. The
        number of targets per positioner then increases with the pitch.
    n_skies : int, optional
        Number of realizations of the targets over which methods for allocated targets average the loss. In each
        realization, 91 positioners are counted.
    time_limit : Quantity, optional
        Time limit of each search for a plan.

    Raises
    ------
    InputError
        If the estimand or the method is unknown, if the method does not compute the estimand, or if a number is out of
        range.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> rs.design.LossOptions(method="repair", n_skies=4).question
    ('collision_free', 'repair')
    """

    estimand: str | None = option(None, choices=ESTIMANDS)
    method: str = option("auto", choices=[*METHODS, "auto"], what="method of design studies")
    targets_per_positioner: float | None = option(None, above=0, high=MOST_TARGETS)
    target_density: u.Quantity[u.mm**-2] | None = option(None, above=0, below=1e3, record="target_density_per_mm2")
    n_skies: int = option(8, low=2)
    time_limit: u.Quantity[u.s] = option(10 * u.s, above=0)

    def _check(self):
        _ = self.question, self.targets  # raises an error if options do not fit each other

    @property
    def question(self) -> tuple[str, str]:
        """The estimand (definition of the loss), and the method that computes the loss."""
        if self.method == "auto":
            return self.estimand or "independent", self.method
        estimand = METHODS[self.method].estimand
        if self.estimand not in (None, estimand):
            raise InputError(f"the estimand must be {estimand!r} for the method {self.method!r}, got {self.estimand!r}")
        return estimand, self.method

    def warn_of_unused(self, also: Sequence[str] = ()) -> None:
        """Issue a warning for each given option that the method does not use.

        Parameters
        ----------
        also : sequence of str, optional
            Names of options of the scan that were given.
        """
        estimand, method = self.question
        given = [name for name in ("n_skies", "time_limit") if name in self.changed()]
        chosen = automatic(estimand) if method == "auto" else [METHODS[method]]
        warn_of_unused([*given, *also], chosen, METHODS.values(), "method")

    @property
    def targets(self) -> tuple[float, bool]:
        """Number of targets, and whether the number is per mm^2 (True) or per positioner (False)."""
        each = self.targets_per_positioner
        if each is not None and self.target_density is not None:
            raise InputError("give either targets_per_positioner or target_density, but not both")
        if self.target_density is not None:
            return float(self.target_density.to_value(u.mm**-2)), True
        return float(PER_POSITIONER if each is None else each), False


CHUNK = 8
"""Number of designs that a process computes per task. Results do not depend on this number."""


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
    """Compute the coverage of many designs of fiber positioners, and the fraction of fibers lost to collisions.

    A design is an infinite hexagonal lattice of equal, right-handed positioners without joint limits. The part of an
    arm that can collide is the segment from the elbow to the tip. The multiplicity follows exactly from the geometry of
    the lattice; the numerical error of the coverage is at most 4e-4. The loss is the fraction of fibers that are lost
    to collisions, among all fibers with a target. Losses with different definitions cannot be compared. There are three
    definitions:

    * ``independent``: every positioner has its own random target, uniform over its patrol area; fibers of positioners
      in collision are lost.
    * ``allocated``: random targets are distributed to queues (`~rfpsurvey.allocate`, ``balanced``), and every fiber
      observes one target of its queue; fibers of positioners in collision are lost.
    * ``collision_free``: the plan avoids collisions. The number of lost fibers is the number of fibers with a target in
      the best plan that ignores collisions, minus the number of fibers with a target in the plan that avoids
      collisions.

    Parameters
    ----------
    central_arm : Quantity, scalar or shape (k,)
        Length of the central arm. All combinations of the values of ``central_arm``, ``ratio``, ``pitch`` and
        ``clearance`` form a grid of designs.
    ratio : float or array_like of float, shape (k,)
        Length of the eccentric arm divided by the length of the central arm.
    pitch : Quantity, scalar or shape (k,)
        Distance between the centers of adjacent positioners.
    clearance : Quantity, scalar or shape (k,)
        Clearance of the eccentric arm: half the minimum separation if ``step`` is 0; see `~rfpsurvey.Positioner`.
    n_designs : int, optional
        Number of designs between limits, instead of a grid. Each parameter is then one value or a pair of limits (low,
        high). The designs are scrambled Sobol points; for the same seed, the first n designs do not depend on
        ``n_designs``.
    step : Quantity, optional
        Angle of one motor step, on which the minimum separation depends; see `~rfpsurvey.Positioner`.
    loss : LossOptions or {"independent", "allocated", "collision_free"}, optional
        Definition of the loss, and method that computes it. If only the name of a definition is given, the fastest
        method that is accurate enough is used.
    objectives : dict of str to str, optional
        The two columns that define the Pareto front, each with ``"max"`` or ``"min"``; by default coverage and loss.
    rng : int, Generator or None, optional
        Seed or random number generator; each design has its own stream of random numbers.
    executor : concurrent.futures.Executor, optional
        Executor that computes designs in parallel, in threads or processes; the result does not depend on the executor.
    progress : bool or callable, optional
        Show the progress on the standard error, or call a function with the number of finished designs and the
        total number of designs.
    path : str or path-like, optional
        File (.ecsv or .fits) to which finished designs are written every ten seconds and at the end.
    resume : bool, optional
        Whether to continue an unfinished scan in ``path``. The objectives may differ from the objectives of the
        unfinished scan.
    overwrite : bool, optional
        Whether to replace an existing file.

    Returns
    -------
    QTable
        Table with a row for each design: ``central_arm``, ``eccentric_arm``, ``ratio``, ``pitch``, ``clearance``,
        ``min_separation`` (D); ``collision_type`` (1: no two arms can touch, 2: only arms of first neighbors can touch,
        3: more distant arms can also touch); ``multiplicity`` (patrol area divided by the area of a lattice cell);
        ``reach_0`` to ``reach_3`` (fractions of the plane within reach of 0, 1, 2, and at least 3 positioners) and
        ``coverage`` (fraction within reach of at least one positioner); ``targets`` (number of targets per positioner)
        and ``empty`` (fraction of the positioners with no target in reach); ``assigned`` (number of fibers per
        positioner that would have a target if arms could pass through each other; it is 1 for independent targets),
        ``loss`` (fraction of the assigned fibers lost to collisions), ``loss_error`` (standard error of the loss),
        ``usable`` (number of assigned fibers per positioner that are not lost to collisions);
        ``positioners_per_area`` and ``usable_per_area`` (numbers of positioners and of usable fibers per area);
        ``estimand`` (definition of the loss) and ``method`` (method that computed the loss); ``n_unproven`` (number of
        realizations of the targets in which the search for a plan ended at the time limit; if it is not 0, the loss can
        be too large and depends on the speed of the machine); ``loss_gap`` (upper limit of the
        number of fibers that better plans of the simulated lattice could add, divided by the number of fibers with a
        target; the limit follows from the bounds that the searches prove; NaN for ``repair``, which has no bounds);
        ``reason`` (why a design has no values); ``pareto`` (True if no other design is at least as good in both
        objectives and better in one). The ``meta`` of the table contains the arguments of the scan.

    Raises
    ------
    InputError
        If a parameter is out of range, if the name of a definition or column is unknown, if another run uses the file,
        or if the file is damaged or contains another scan.
    concurrent.futures.BrokenExecutor
        If a worker process ends abruptly. Designs that were already written remain in the file.

    Warns
    -----
    RfpsurveyWarning
        If an option is given that the method does not use, if designs are impossible (they remain in the table without
        values), if the time limit ended searches, or if the scan was begun with other versions of the software.

    See Also
    --------
    rfpsurvey.design.explore_around : Scan designs around the design of an instrument.
    rfpsurvey.design.design_sensitivities : Compute how much the values depend on each parameter.
    rfpsurvey.plot.plot_designs : Plot the designs and the Pareto front.
    rfpsurvey.collision_probability : Estimate the collision probability of a finite focal plane.

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
    settings = {name: value for name, value in locals().items() if name not in _rows.AXES}
    return scan(_rows.to_axes(central_arm, ratio, pitch, clearance), None, **settings)


def scan(axes, start, *, n_designs, step, loss, objectives, rng, executor, progress, path, resume, overwrite) -> QTable:
    """Compute all designs of a scan and return their table.

    ``axes`` contains the values or the limits of each parameter, with lengths in mm. If ``start`` is given, the table
    also contains the design of this instrument.
    """
    objectives = _rows.check_objectives(_rows.OBJECTIVES if objectives is None else objectives, _rows.FIGURES)
    seed = to_seed(rng)
    loss = loss if isinstance(loss, LossOptions) else LossOptions(loss)
    loss.warn_of_unused(["rng"] if n_designs is None and is_seed_given(rng) else [])
    limit = float(loss.time_limit.to_value(u.s))
    task = Task(*loss.question, to_scalar(step, u.rad, "step"), *loss.targets, loss.n_skies, limit, seed)
    designs = _rows.to_designs(axes, n_designs, seed)
    request = {name: values.tolist() for name, values in axes.items()} | vars(task)
    request["n_designs"] = None if n_designs is None else int(n_designs)
    if start is not None:
        designs, row, record = start.among(designs)
        request["start"] = record
    with _rows.Checkpoint(path, request, designs, resume=resume, overwrite=overwrite) as checkpoint:
        starts = range(checkpoint.done, len(designs), CHUNK)
        parts = (designs[first : first + CHUNK] for first in starts)
        with Progress(progress, len(designs), "designs", done=checkpoint.done) as bar:
            for rows in map_in_order(executor, task, starts, parts):
                checkpoint.add(rows)
                checkpoint.save()
                bar(checkpoint.done)
        table = checkpoint.table(objectives=objectives)
        if start is not None:
            table["instrument"] = np.where(np.arange(len(table)) == row, start.name, "")
        table["pareto"] = _rows.on_front(table, objectives)
        checkpoint.write(table)
    _warn(table)
    return table


def _warn(table):
    """Issue warnings for designs without values, and for designs whose searches the time limit ended."""
    strange = table[table["reason"] != ""]
    if len(strange):
        warn(
            f"{len(strange)} of {len(table)} designs have no values; the column 'reason' gives the reasons, "
            f"such as: {strange['reason'][0]}"
        )
    cut = int(np.count_nonzero(table["n_unproven"]))
    if cut:
        warn(
            f"the time limit ended searches for {cut} of {len(table)} designs; the true loss of these designs "
            f"can be smaller, by at most about {np.nanmax(table['loss_gap']):.2g}"
        )
