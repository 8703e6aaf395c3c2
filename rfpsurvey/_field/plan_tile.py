"""The function that plans a tile."""

import logging
from collections.abc import Callable
from functools import partial
from itertools import chain
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table
from astropy.time import Time

from rfpsurvey._assignment.constraints.counts import sentences
from rfpsurvey._assignment.methods import DEFAULT_ALLOCATOR
from rfpsurvey._assignment.options import AllocationOptions, as_options
from rfpsurvey._assignment.plugin import packages, warn_of_lacks, warn_of_unused_options
from rfpsurvey._common.descriptions import with_unit
from rfpsurvey._common.executors import Progress
from rfpsurvey._common.units import to_center, to_generator, to_seed, to_vectors
from rfpsurvey._field.constraints import early_violations
from rfpsurvey._field.facts import build_tile, split_objectives
from rfpsurvey._field.plan import FieldPlan, field_radius_rad, plan_field
from rfpsurvey._field.recorded import warn_of_north, where
from rfpsurvey._field.table import TableOfTile, TargetsOfField, only_with_target
from rfpsurvey._field.targets import CatalogTargets, FieldBuilder, SelectedRows, separation_rad
from rfpsurvey._field.tile import Tile
from rfpsurvey._instruments.compare_projections import choose_projection
from rfpsurvey._instruments.instrument import Instrument, as_instrument
from rfpsurvey._sky.arrays import KINDS, has_role
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.conditions import ObservingConditions
from rfpsurvey._sky.partitions import as_catalog
from rfpsurvey._sky.survey_formats import survey_of_north
from rfpsurvey._sky.time import choose_epoch, epoch_text
from rfpsurvey.errors import InputError, check_keywords, number_of, warn

# Largest number of objectives in a summary; if there are more, one item is the sum of all further classes.
MOST_OBJECTIVES = 100
# Fraction of the science targets from which a warning states that rules on the distribution of fibers cost them.
COSTLY = 0.03
STAGES = ("projection", "reach", "allocation", "arms", "collisions")
log = logging.getLogger("rfpsurvey")


@check_keywords
def plan_tile(
    catalog: Catalog | SkyCoord | Table,
    instrument: Instrument | str,
    center: SkyCoord | str | None = None,
    *,
    position_angle: u.Quantity = 0 * u.deg,
    epoch: Time | str | float | None = None,
    allocator: AllocationOptions | str | Callable = DEFAULT_ALLOCATOR,
    conditions: ObservingConditions | None = None,
    projection: str | None = None,
    progress: bool | Callable = False,
    rng: int | np.random.Generator | None = 0,
) -> Tile:
    """Assign the targets of a field to fibers, and find the arms that collide.

    If there are no requirements, such as a minimum number of sky fibers, only science targets and required targets are
    assigned; all other sky positions and standard stars are only counted. Targets of any kind whose number of visits is
    0 are not assigned, except required targets. If each fiber type has its own radial map
    from the sky to the focal plane, targets without a fiber type are projected with the map of the first fiber type.

    Parameters
    ----------
    catalog : Catalog, SkyCoord, Table or DataFrame
        The targets; a DataFrame is read as in `Catalog.from_table`.
    instrument : Instrument or str
        Instrument, name of a preset, or path of a TOML file.
    center : SkyCoord or str, optional
        Field center, whose frame also defines north: for a center in ``FK5(equinox="J2026")``, position angles are
        measured from north at that equinox. Text such as ``"06h20m00s +23d00m00s"`` or ``"95.0 23.0"`` (degrees) is
        in ICRS. By default, the field center is the mean direction of the catalog.
    position_angle : Quantity, optional
        Position angle of the +y axis of the focal plane, measured from north toward east.
    epoch : Time, str or float, optional
        Epoch to which the targets are moved by their proper motions (a number is a Julian year). By default, the
        time of the conditions; without such a time, the targets are not moved. The entry ``epoch`` of the summary
        states to which epoch the targets were moved.
    allocator : AllocationOptions or str or callable, optional
        The allocator with its options, such as required numbers of sky fibers and standards, required targets, and
        circles that no arm may cover; or only the allocator. See `AllocationOptions`.
    conditions : ObservingConditions, optional
        Site, time or hour angle, wavelengths and weather, from which refraction is computed. The entry ``projection``
        of the summary then states which model of the projection is used, its largest error and those of the others
        that each simpler model neglects.
    projection : {"tangent", "radial", "refraction", "dispersion", "full", "auto"}, optional
        Model of the projection, as in `~rfpsurvey.instrument.compare_projections`; ``auto`` is the fastest model that
        is accurate enough. By default, the model of the conditions (usually ``auto``) or, without conditions,
        ``radial``.
    progress : bool or callable, optional
        Show the progress of the search by the allocator ``network_flow`` or ``optimal`` on the standard error, or call
        a function with two numbers: the finished fraction of the search, and 1.
    rng : int, Generator or None, optional
        Seed or random number generator for allocators that use random numbers. With the default seed, all calls give
        the same tile.

    Returns
    -------
    Tile
        The tile: a table with a row for each positioner, and a summary.

    Raises
    ------
    InputError
        If the catalog is empty, does not overlap the field, or has no target in reach of a positioner; if a name or the
        identifier of a required target is unknown, or if a unit is missing; or if targets have proper motions but no
        epoch.

    Warns
    -----
    RfpsurveyWarning
        If an option that the allocator does not use is given, if identifiers occur twice, if no target has the
        category that a requirement counts, if the field violates a constraint whatever targets are assigned, if rules
        on the distribution of fibers cost more than 3 % of the science targets, or if no target of the highest priority
        has a fiber although at least one is in reach.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> center = SkyCoord("6h20m +23d")
    >>> sky = rs.synthetic_catalog("poisson", center, 1.5 * u.deg, density=300 / u.deg**2, rng=1)
    >>> tile = rs.plan_tile(sky, "sdss_apo", center, position_angle=30 * u.deg)
    >>> tile.table.colnames[:4]
    ['id', 'spectrograph', 'x', 'y']
    """
    begin = perf_counter()
    instrument = as_instrument(instrument)
    asked = as_options(allocator)
    catalog = as_catalog(catalog)
    if len(catalog) == 0:
        raise InputError("the catalog must have at least one target with finite coordinates, got none")
    center = to_center(catalog.mean_direction if center is None else center)
    plane = instrument.projection(center, position_angle)
    has_north = center.frame.name != "icrs" or u.Quantity(position_angle).value == 0
    warn_of_north(survey_of_north(str(catalog.meta.get("columns", ""))), is_given=has_north)
    plain, chosen = choose_projection(instrument, plane, conditions, projection)
    options = asked.for_instrument(instrument)
    warn_of_unused_options([asked], instrument.focal_plane, rng)
    whole_catalog, radius = catalog, field_radius_rad(instrument, plain)
    warn_of_lacks(asked, partial(getattr, catalog))  # not of those of the instrument
    margin = max([separation_rad(options, instrument) or 0.0, *(c.margin_rad for c in options.all_constraints)])
    used, moved = choose_epoch(catalog, epoch, None if conditions is None else conditions.time)
    if used is not None:
        near = catalog.arrays.rows_near(center, radius + margin, used)
        catalog = catalog[near].at_epoch(used)
    rows = catalog.arrays.rows_within(center, radius)
    if len(rows) == 0:
        nearest = whole_catalog.coord.icrs.separation(center.icrs).min().deg
        raise InputError(
            f"no target lies within {instrument.field_radius:.4g} of the field center "
            f"({center.icrs.to_string('hmsdms', precision=0)}); the nearest is {nearest:.4g} deg away"
            f"{_hint_of_hours(whole_catalog.coord.icrs, center, radius)}"
        )
    outside = np.setdiff1d(catalog.arrays.rows_within(center, radius + margin), rows) if margin else rows[:0]
    wider = np.append(rows, outside)
    vectors = catalog.arrays.vectors.take(wider, axis=0)
    selected = SelectedRows(wider if used is None else near[wider], vectors, radius, len(rows))
    source = CatalogTargets(whole_catalog, selected)
    builder = FieldBuilder(source, options, instrument)
    slot, _, targets = builder.field(to_vectors(center, "center", scalar=True)[0], radius)
    if len(slot) == 0:
        _refuse_empty(builder, len(rows))
    n_twice = len(slot) - len(np.unique(targets.id)) if catalog.arrays.repeated_ids else 0
    if n_twice:
        text = f"the field has {number_of(n_twice, 'target')} with the same id as another target"
        text += "; each row is planned as a separate target"
        warn(text)
    for text in chain(*early_violations(instrument, plain, options, targets).values()):
        warn(text)
    rng, seed = _generator(rng)
    seconds = {"select": perf_counter() - begin}
    with Progress(progress) as bar:
        plan = plan_field(
            instrument, plain, targets, options, rng, builder.blank, lambda done, stage: bar(done, note=stage)
        )
    instrument, allocation = plan.instrument, plan.allocation
    seconds.update((name, plan.seconds[name]) for name in STAGES)
    if allocation.n_reachable == 0:
        what = "target" if options.counts or options.distributions else "science target"
        raise InputError(
            f"no positioner of {instrument.name} reaches a {what}; the field around the center "
            f"{center.icrs.to_string('hmsdms', precision=0)} contains {number_of(len(slot), 'target')}"
        )
    verdicts, kinds = (
        [*allocation.counts, *plan.verdicts()],
        counts_by_kind(catalog, rows[builder.visits[: len(rows)] > 0], plan),
    )
    n_lost = max(allocation.meta.get("n_lost_to_rules", 0), 0)
    warn_of_costly_rules(n_lost, kinds["science"]["n_assigned"])
    if options.method.uses_priorities and (text := _lost_class(allocation, targets.columns)):
        warn(text)
    summary = {
        "n_targets": len(whole_catalog) + whole_catalog.n_dropped,
        "n_dropped": whole_catalog.n_dropped,
        "n_in_field": len(rows),
        "n_set_aside": len(rows) - len(slot),
        "n_reachable": allocation.n_reachable,
        "objectives": _objectives(allocation.levels),
        "gap": _known(allocation.gap),
        "kinds": kinds,
        **({"n_lost_to_rules": n_lost} if n_lost else {}),
        **({"rules": [verdict.record for verdict in verdicts]} if verdicts else {}),
        "n_required": builder.n_required,
        "n_required_observed": _n_required_observed(plan, targets.columns.is_required),
        "unmet": sentences(allocation.unmet) + [text for texts in plan.violations.values() for text in texts],
        "search": allocation.meta,
        "projection": chosen,
        "epoch": moved,
        "seconds": {k: round(v, 6) for k, v in seconds.items()},
    }
    log.info("planned a tile of %s: %s", instrument.name, summary)
    parameters = {
        **where(center, position_angle),
        "epoch": epoch_text(catalog.epoch),
        "epoch_asked": None if epoch is None else str(epoch),
        "projection": chosen["model"],
        "conditions": None if conditions is None else conditions.record,
        **options.record,
        "rng": seed,
    }
    row_of = np.full(len(instrument.focal_plane), -1)
    row_of[plan.positioner] = np.arange(len(plan.positioner))
    sky_deg = np.rad2deg([plan.lon_rad, plan.lat_rad])
    carried = by_positioner(catalog, plan, row_of)
    table = TableOfTile(
        instrument, plan.id, sky_deg, row_of, allocation.fiber_type, plan.arms, plan.report, plan.kind, carried
    )
    targets = TargetsOfField(catalog, rows, slot, plan)
    return build_tile(table, summary, parameters, catalog.meta, targets, packages(options))


def _refuse_empty(builder: FieldBuilder, n: int) -> None:
    """Raise the error that states why a tile may use none of the n targets in its field, which are the first slots."""
    kind = builder.source.by_slot("kind")
    science = np.ones(n, dtype=bool) if kind is None else has_role(kind[:n], "science")
    what = "is a science target" + (" with requested visits" if science.any() else "")
    remedy = "requirements such as 'sky=20' also assign targets of other kinds"
    remedy = remedy if builder.visits[:n].any() else "the column of visits states 0 for all of them"
    raise InputError(f"none of the {len(science)} targets in the field {what}; {remedy}")


def warn_of_costly_rules(n_lost: int, n_science: int) -> None:
    """Warn if the rules on the distribution of fibers cost a large fraction of the science targets."""
    n_free = n_lost + n_science
    if n_lost > COSTLY * n_free:
        warn(
            f"the rules on the distribution of fibers cost {n_lost} of the {n_free} science targets that plans without "
            "these rules observe"
        )


def _lost_class(allocation, columns) -> str:
    """Return a text if no target of the highest priority is assigned, although at least one is in reach."""
    n = allocation.n_given
    science = np.ones(n, dtype=bool) if columns.kind is None else has_role(columns.kind, "science")
    rows = np.flatnonzero(science & allocation.in_reach[:n])
    if columns.priority is None or len(rows) == 0:
        return ""
    highest = columns.priority[rows].max()
    rows = rows[columns.priority[rows] == highest]
    if highest == columns.priority[science].min() or (allocation.positioner_of_target[rows] >= 0).any():
        return ""
    return f"no target of the highest priority ({highest:g}) has a fiber; {number_of(len(rows), 'target')} in reach"


def _n_required_observed(plan: FieldPlan, is_required: np.ndarray | None) -> int:
    """Return the number of targets marked in ``is_required`` that are assigned and not in collision."""
    observed = plan.target[(plan.target >= 0) & ~plan.report.in_collision[plan.positioner]]
    return 0 if is_required is None else int(is_required[observed].sum())


def _objectives(levels: list) -> list:
    """Return the name, value and bound of each objective; one item can be the sum of many classes."""
    rows = [[level.name, level.value, _known(level.bound)] for level in levels]
    shown, summed, totals = split_objectives(rows, MOST_OBJECTIVES)
    more = [[f"{len(summed)} more classes", sum(value for _, value, _ in summed), None]] if summed else []
    return [*shown, *more, *totals]


def _hint_of_hours(coord: SkyCoord, center: SkyCoord, radius_rad: float) -> str:
    """Return a hint if all right ascensions are below 24, and targets would be in the field if the unit were hours."""
    if coord.ra.deg.max() >= 24:
        return ""
    n = np.count_nonzero(SkyCoord(15 * coord.ra, coord.dec).separation(center.icrs).rad <= radius_rad)
    remedy = "give their unit (units={'ra': 'hourangle'}, --set catalog.units.ra=hourangle)"
    return f"; {n} of the targets would be in the field if right ascensions were in hours: {remedy}" if n else ""


def _known(value):
    """Return a number, or None for NaN, which some file formats do not support."""
    return None if np.isnan(value) else value


def _generator(rng):
    """Return a random number generator, and the seed or state with which this generator can be made again."""
    if isinstance(rng, np.random.Generator):
        state = rng.bit_generator.state
        return rng, f"{state['bit_generator']} {state.get('state')}"
    seed = to_seed(rng) if rng is None else rng
    return to_generator(seed), int(seed) if isinstance(seed, int | np.integer) else str(seed)


def counts_by_kind(catalog: Catalog, rows: np.ndarray, plan: FieldPlan) -> dict:
    """Return, for each kind, the numbers of targets in the field, of assigned targets, and of observed targets.

    ``rows`` contains the rows, in the catalog, of the targets in the field with requested visits. A target is observed
    if it is assigned and not lost to a collision.
    """
    free = ~plan.report.in_collision[plan.positioner]
    counts_of_kind = {}
    for kind in KINDS:
        is_kind, kinds = has_role(plan.kind, kind), catalog.kind
        n_in_field = len(rows) * (kind == "science") if kinds is None else has_role(kinds[rows], kind).sum()
        counts = {"n_in_field": n_in_field, "n_assigned": is_kind.sum(), "n_observed": (is_kind & free).sum()}
        if (is_also_science := is_kind & has_role(plan.kind, "science")).any() and kind != "science":
            counts["n_also_science"] = is_also_science.sum()
        if kind == "science" or any(counts.values()):
            counts_of_kind[kind] = {name: int(number) for name, number in counts.items()}
    return counts_of_kind


def by_positioner(catalog: Catalog, plan: FieldPlan, row_of: np.ndarray) -> dict:
    """Return columns of the catalog, with the values of the target of each positioner.

    ``row_of`` contains, for each positioner, its row in the plan, or -1 if the plan has no row for the positioner.
    """
    if len(plan.target) == 0:
        return {}
    given = (row_of >= 0) & (plan.target >= 0)[row_of]
    carried = {name: only_with_target(values[row_of], given) for name, values in plan.carried.items()}
    return {name: with_unit(values, catalog.arrays.extra_units.get(name)) for name, values in carried.items()}
