"""Comparison of several instruments, with the same targets or with the same number of targets per positioner."""

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

from rfpsurvey._assignment.methods import name_of_best
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._assignment.plugin import packages, warn_of_unused_options
from rfpsurvey._common.units import to_scalar
from rfpsurvey._field.facts import versions
from rfpsurvey._instruments.facts import arm_classes
from rfpsurvey._instruments.instrument import Instrument, as_instrument, every_instrument
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.partitions import as_catalog
from rfpsurvey._studies.compare_allocators import Plan, allocators_of, catalog_fields, plan_fields, synthetic_fields
from rfpsurvey._studies.run import rate_interval
from rfpsurvey.errors import InputError, check_choice, items_of

COMPARED = ("lamost_rule", "optimal")
SYNTHETIC = ("poisson", "uniform")
CONFIDENCE = 0.95
COMPARABLE = {
    "same targets per positioner": (
        "Each instrument observes its own synthetic targets; the expected number of targets in the footprint, per "
        "positioner, is the same for all instruments. The column targets_per_positioner contains the number of "
        "targets in reach, which differs: random numbers of targets scatter, arms reach beyond the footprint, and "
        "parts of the footprint are out of reach. Fractions of the positioners, probabilities, pairs per positioner "
        "and losses can be compared; numbers of targets and values per field or solid angle cannot be compared."
    ),
    "same density": (
        "Each instrument observes one full field, and all fields have the same density of targets. Fibers per field "
        "and per solid angle can be compared; fractions of positioners depend on the number of targets per positioner."
    ),
    "same catalog": (
        "Every instrument observes a whole field of the same catalog; areas outside the catalog contain no targets. "
        "Fibers per field and per solid angle can be compared; fractions of positioners depend on the number of "
        "targets per positioner."
    ),
}
CAUTION = (
    "Telescopes, exposure times and spectrographs are not part of the comparison. The layouts are taken from "
    "the descriptions of the instruments; most layouts are nominal lattices. Idle positioners with arms of "
    "equal length are obstacles; idle positioners with arms of unequal length avoid all other arms."
)
REACH = tuple(f"reach_{k}" for k in range(4))
"""Columns with the fractions of the footprint within reach of 0, 1, 2, and at least 3 positioners."""
PARTS = {
    "instruments": ("positioners", "arms", "field", "footprint", "type", "multiplicity", *REACH),
    "targets and fibers per field": (
        "allocator",
        "targets",
        "targets_per_positioner",
        "assigned",
        "assigned_part",
        "usable",
        "usable_per_area",
        "usable_per_solid_angle",
    ),
    "collisions": ("allocator", "probability", "low", "high", "pairs_per_positioner", "loss", "gap", "seconds"),
}
UNITS = {
    "field": u.deg,
    "footprint": u.mm**2,
    "usable_per_area": u.mm**-2,
    "usable_per_solid_angle": u.deg**-2,
    "seconds": u.s,
}
log = logging.getLogger("rfpsurvey")


def compare_instruments(
    catalog: Catalog | SkyCoord | Table | str = "poisson",
    instruments: Sequence[Instrument | str] | None = None,
    *,
    center: SkyCoord | str | None = None,
    allocators: Sequence[str | Callable] = COMPARED,
    targets_per_positioner: float | None = None,
    density: u.Quantity | None = None,
    options: AllocationOptions | None = None,
    n_realizations: int | None = None,
    rng: int | np.random.Generator | None = 0,
    executor: Executor | None = None,
    progress: bool | Callable = False,
    **others: object,
) -> QTable:
    """Compare instruments with the same targets, or with the same number of targets per positioner.

    Parameters
    ----------
    catalog : Catalog, SkyCoord or {"poisson", "uniform"}, optional
        Targets for all instruments, or the kind of synthetic targets, see `synthetic_catalog`.
    instruments : list of Instrument or str, optional
        Instruments, names of presets, or paths of TOML files; by default all of `available_instruments`.
    center : SkyCoord, scalar or shape (n_fields,), optional
        For a catalog: field centers, by default the mean direction of the catalog. For synthetic targets: the common
        center of all fields, by default ICRS (0, 0) deg.
    allocators : list of str or callable, optional
        Allocators, see `AllocationOptions`.
    targets_per_positioner : float, optional
        Mean number of synthetic targets in the footprint (`FocalPlane.footprint`) per positioner, the same for all
        instruments; one by default.
    density : Quantity, optional
        Number of synthetic targets per solid angle, the same for all instruments, instead of
        ``targets_per_positioner``.
    options : AllocationOptions, optional
        Options of every plan, such as requirements, required targets of a catalog and circles that no arm may cover.
        The allocator in these options is replaced by each of ``allocators``.
    n_realizations : int, optional
        Number of synthetic fields of each instrument; 4 by default. With a catalog, this parameter must be None, and
        each instrument observes one field for each center.
    rng : int, Generator or None, optional
        Seed or random number generator.
    executor : concurrent.futures.Executor, optional
        Executor that plans fields in parallel; only the column ``seconds`` depends on the executor.
    progress : bool or callable, optional
        Show the progress on the standard error, or call a function with the number of finished fields and the
        total number of fields.
    **others
        Further parameters of `plan_tile`, such as ``position_angle``.

    Returns
    -------
    QTable
        Table with a row for each instrument and allocator. Columns that describe the instrument: ``instrument``;
        ``positioners`` (number of positioners that can have a target); ``arms`` (lengths of both arms, and number of
        positioners of each class of arms); ``field`` (diameter of the field); ``footprint``
        (area of the convex hull of the positioner centers); ``type`` (1: no arms can collide, 2: only arms of first
        neighbors can collide, 3: more distant arms can also collide); ``multiplicity`` (mean number of positioners that
        reach a point of the footprint); ``reach_0``, ``reach_1``, ``reach_2``, ``reach_3`` (fraction of the footprint
        within reach of 0, 1, 2, and at least 3 positioners). Columns that describe the plans, averaged over
        the fields: ``allocator``; ``targets`` (number of science targets in reach); ``targets_per_positioner``
        (``targets`` divided by ``positioners``); ``assigned`` (number of fibers on science targets); ``assigned_part``
        (fraction of the positioners assigned to science targets); ``probability``, ``low``, ``high`` (collision
        probability of the positioners that have a target or are parked obstacles, and its 95 % confidence interval);
        ``pairs_per_positioner`` (number of colliding pairs per positioner that has a target or is a parked obstacle);
        ``usable`` (number of fibers on science targets without a collision); ``usable_per_area`` (``usable`` divided by
        the area of the footprint); ``usable_per_solid_angle`` (``usable`` divided by the solid angle of the field);
        ``loss`` (fraction by which ``usable`` is smaller than the number of science fibers of the best plan that
        ignores collisions; for ``optimal``, this is the fraction of targets lost to collisions; for allocators that
        ignore requirements, the loss can be negative); ``gap`` (relative difference between the objective of a plan and
        its proven upper bound, maximum over the fields; NaN without a proven bound); ``seconds`` (median time for
        finding the targets in reach and for the allocation of a field, without compilation). ``meta`` contains the
        provenance, and states which columns can be compared between instruments.

    Raises
    ------
    InputError
        If an instrument or an allocator is unknown, if two instruments have the same name, if a field has no target, or
        if `plan_tile` raises an error.

    Warns
    -----
    RfpsurveyWarning
        If an option is given that no allocator uses.

    See Also
    --------
    compare_allocators : Compare allocators on one field of one instrument.
    rfpsurvey.plot.plot_instruments : Plot the table.

    Notes
    -----
    The confidence interval of the collision probability is a Wilson interval with the effective number of independent
    trials, which is estimated from the scatter between positioners and the correlation of neighbors. The interval
    describes how much the probability would vary from field to field for targets of the same kind.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> table = rs.compare_instruments("poisson", ["sdss_apo", "moons"], n_realizations=2)
    >>> table["instrument", "type", "allocator"].pprint(align="<")
    instrument type allocator
    ---------- ---- -----------
    sdss_apo   3    lamost_rule
    sdss_apo   3    optimal
    moons      3    lamost_rule
    moons      3    optimal
    """
    models = _models(instruments)
    methods = allocators_of(allocators, options, others)
    warn_of_unused_options(
        [replace(methods[0], allocator=name_of_best()), *methods], rng=0 if isinstance(catalog, str) else rng
    )
    facts = [_describe(model) for model in models]
    if density is not None and targets_per_positioner is not None:
        raise InputError("give targets_per_positioner or density, not both")
    if isinstance(catalog, str):
        check_choice(catalog, SYNTHETIC, "kind of synthetic sky")
        if methods[0].required:
            raise InputError(
                f"required targets can be used only with a catalog, got synthetic targets of the kind {catalog!r}"
            )
        each = 1.0 if targets_per_positioner is None else targets_per_positioner
        if density is not None:
            to_scalar(density, u.deg**-2, "density", low=0)
        number = 4 if n_realizations is None else n_realizations
        fields = synthetic_fields(catalog, models, center, each, density, number, rng)
        way = "same density" if density is not None else "same targets per positioner"
    else:
        values = n_realizations, density, targets_per_positioner
        for name, value in zip(("n_realizations", "density", "targets_per_positioner"), values, strict=True):
            if value is not None:
                raise InputError(f"{name} cannot be used with a catalog, because it describes synthetic targets")
        fields = catalog_fields(as_catalog(catalog), models, center, rng)
        way = "same catalog"
    plans = plan_fields(fields, methods, others, executor, progress)
    rows = []
    for model, known in zip(models, facts, strict=True):
        blind, *plans_of_methods = zip(
            *(plan for field, plan in zip(fields, plans, strict=True) if field.instrument is model), strict=True
        )
        for method, plans_of_method in zip(methods, plans_of_methods, strict=True):
            rows.append({**known, **_gains(model, method, plans_of_method, blind)})
        log.info("compared %s: %d fields", model.name, len(blind))
    table = QTable({key: [row[key] for row in rows] for key in rows[0]}, units=UNITS)
    shared = {name: value for method in methods for name, value in method.record.items() if name != "allocator"}
    software = versions() | {name: value for method in methods for name, value in packages(method).items()}
    table.meta.update(
        made_by="compare_instruments",
        way=way,
        comparable=f"{COMPARABLE[way]} {CAUTION}",
        n_fields=len(fields) // len(models),
        confidence=CONFIDENCE,
        sky=catalog if isinstance(catalog, str) else dict(fields[0].catalog.meta),
        software=software,
        instruments={model.name: model.provenance for model in models},
        parameters={"rng": str(rng), **shared, **{name: str(value) for name, value in others.items()}},
    )
    if way == "same targets per positioner":
        table.meta["targets_per_positioner"] = float(each)
    elif way == "same density":
        table.meta["density_per_deg2"] = float(density.to_value(u.deg**-2))
    return table


def parts_of(table: QTable) -> dict[str, QTable]:
    """Split a comparison into three tables that each fit on a page: for instruments, for fibers and for collisions."""
    parts = {title: table[["instrument", *columns]] for title, columns in PARTS.items()}
    rows = np.unique(np.asarray(table["instrument"]), return_index=True)[1]
    return parts | {"instruments": parts["instruments"][np.sort(rows)]}


def _models(instruments) -> list[Instrument]:
    """Return the instruments; raise an error if two instruments have the same name."""
    given = every_instrument().values() if instruments is None else instruments
    given = items_of(given, "instruments must be a list of instruments", str, Instrument)
    models = [as_instrument(instrument) for instrument in given]
    if not models:
        raise InputError("instruments must contain at least one instrument, got none")
    names = [model.name for model in models]
    twice = [name for k, name in enumerate(names) if name in names[:k]]
    if twice:
        raise InputError(f"instruments must have different names, got several instruments with the name {twice[0]!r}")
    return models


def _describe(model: Instrument) -> dict:
    """Return the columns that describe an instrument and do not depend on the targets."""
    plane = model.focal_plane
    try:
        parts = plane.coverage()
    except InputError as error:
        raise InputError(f"{model.name}: {error}") from None
    exact = np.pad(parts, (0, max(0, 4 - len(parts))))
    return {
        "instrument": model.name,
        "positioners": int(plane.arrays.usable.sum()),
        "arms": arm_classes(model),
        "field": 2 * model.field_radius.to_value(u.deg),
        "footprint": plane.footprint.to_value(u.mm**2),
        "type": plane.collision_type,
        "multiplicity": float(np.arange(len(parts)) @ parts),
        **dict(zip(REACH, [*exact[:3].tolist(), float(exact[3:].sum())], strict=True)),
    }


def _gains(model: Instrument, allocator: AllocationOptions, plans: Sequence[Plan], blind: Sequence[Plan]) -> dict:
    """Return the columns that describe the plans of an allocator, averaged over the fields of an instrument."""
    n, most = len(plans), sum(plan.n_science for plan in blind)
    targets, science, usable, pairs = (
        sum(getattr(plan, name) for plan in plans) for name in ("n_targets", "n_science", "n_usable", "n_pairs")
    )
    probabilities = [plan.probability for plan in plans]
    value, low, high = rate_interval(model.focal_plane, probabilities, CONFIDENCE)
    # without collisions by construction, not by chance
    if value == 0 and allocator.method.avoids_collisions:
        high = 0.0
    counted = np.count_nonzero(~np.isnan(probabilities))
    number = int(model.focal_plane.arrays.usable.sum())
    half = model.field_radius.to_value(u.rad) / 2
    return {
        "allocator": allocator.name,
        "targets": targets / n,
        "targets_per_positioner": targets / n / number,
        "assigned": science / n,
        "assigned_part": science / n / number,
        "probability": value,
        "low": low,
        "high": high,
        "pairs_per_positioner": pairs / counted if counted else np.nan,
        "usable": usable / n,
        "usable_per_area": usable / n / model.focal_plane.footprint.to_value(u.mm**2),
        "usable_per_solid_angle": usable / n / (4 * np.pi * u.sr.to(u.deg**2) * np.sin(half) ** 2),
        "loss": 1 - usable / most if most else np.nan,
        "gap": float(np.max([plan.gap for plan in plans])),
        "seconds": float(np.median([plan.seconds for plan in plans])),
    }
