"""Comparison of allocators on one field, and the plans of each allocator for the fields of several instruments."""

import logging
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cache, partial
from numbers import Number
from zlib import crc32

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

from rfpsurvey._assignment.methods import METHODS, OPTIONS, name_of_best
from rfpsurvey._assignment.options import AllocationOptions, as_options
from rfpsurvey._assignment.plugin import warn_of_unused_options
from rfpsurvey._common.executors import map_with_progress
from rfpsurvey._common.units import to_center, to_generator
from rfpsurvey._field.constraints import project_field
from rfpsurvey._field.plan_tile import plan_tile
from rfpsurvey._field.tile import Tile
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.instrument import Instrument, as_instrument
from rfpsurvey._instruments.positioner import Positioner
from rfpsurvey._instruments.reach import on_footprint
from rfpsurvey._sky.arrays import has_role
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.partitions import as_catalog
from rfpsurvey._sky.synthetic import synthetic_catalog
from rfpsurvey.errors import (
    InputError,
    InputTypeError,
    RfpsurveyWarning,
    check_switch,
    check_whole,
    is_real,
    refusal,
    short,
    used_elsewhere,
    warn,
)

# Largest number of priority classes for which the table has separate columns.
MOST_CLASSES = 8
log = logging.getLogger("rfpsurvey")


def compare_allocators(
    catalog: Catalog | SkyCoord | Table,
    instrument: Instrument | str,
    center: SkyCoord | str | None = None,
    *,
    allocators: list[str | Callable] | None = None,
    options: AllocationOptions | None = None,
    return_tiles: bool = False,
    **others: object,
) -> QTable | tuple[QTable, dict[str, Tile]]:
    """Plan the same field with several allocators; return a table of fibers, collisions and computing times.

    Parameters
    ----------
    catalog : Catalog, SkyCoord, Table or DataFrame
        The targets.
    instrument : Instrument or str
        Instrument, name of a preset, or path of a TOML file.
    center : SkyCoord or str, optional
        Field center, as in `plan_tile`.
    allocators : list of str or callable, optional
        Allocators (see `AllocationOptions`); by default all built-in allocators.
    options : AllocationOptions, optional
        Options of every plan, such as requirements, required targets and circles that no arm may cover. The
        allocator in these options is replaced by each of ``allocators``.
    return_tiles : bool, optional
        Whether to return the planned tiles as well, for example for the argument ``plans`` of
        `~rfpsurvey.write_report`.
    **others
        Further parameters of `plan_tile`, such as ``position_angle``.

    Returns
    -------
    QTable
        Table with a row for each allocator. Columns: ``allocator``; ``science``, ``standard``, ``sky`` (number of
        fibers on each kind of target); the number of fibers on targets of each priority class, if there are from two to
        eight classes; ``missing`` (number of fibers that the requirements demand, but that the plan lacks);
        ``colliding`` (number of positioners in collision), ``pairs`` (number of colliding pairs) and ``at_obstacles``
        (number of collisions with obstacles); ``usable`` (number of science fibers without a collision); ``loss``
        (fraction by which ``usable`` is smaller than the number of science fibers of the best plan that ignores
        collisions; for allocators that ignore requirements, the loss can be negative); ``gap`` (relative difference
        between the objective of the plan and its proven upper bound; NaN without a proven bound); ``seconds`` (time for
        finding the targets in reach and for the allocation, without compilation). ``meta`` contains the
        requirements that the plan of each allocator does not meet, and the provenance.
    dict of str to Tile
        Tiles that the allocators planned; the keys are the names of the allocators. This dict is returned only if
        ``return_tiles`` is true.

    Raises
    ------
    InputError
        If `plan_tile` raises an InputError for one of the allocators.

    Warns
    -----
    RfpsurveyWarning
        If an option is given that no allocator uses, or if `plan_tile` issues a warning about the field.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> center = SkyCoord("6h20m +23d")
    >>> sky = rs.synthetic_catalog("uniform", center, 0.2 * u.deg, n_targets=2000, rng=1)
    >>> table = rs.compare_allocators(sky, "moons", center, allocators=["lamost_rule", "optimal"])
    >>> table["colliding"][1]
    np.int64(0)
    """
    check_switch(return_tiles, "return_tiles")
    methods = allocators_of(list(METHODS) if allocators is None else allocators, options, others)
    instrument, catalog = as_instrument(instrument), as_catalog(catalog)
    tiles = {}
    best = replace(methods[0], allocator=name_of_best())
    every = [best, *methods]
    warn_of_unused_options(every, instrument.focal_plane, others.get("rng", 0))
    for method in every:
        if method in tiles:
            continue
        with warnings.catch_warnings(), used_elsewhere(*OPTIONS):
            if tiles:
                warnings.simplefilter("ignore", RfpsurveyWarning)  # issue a warning about the field only once
            # this first plan has a short time limit and only compiles the code
            plan_tile(catalog, instrument, center, allocator=replace(method, time_limit=1 * u.ms), **others)
            warnings.simplefilter("ignore", RfpsurveyWarning)
            tiles[method] = plan_tile(catalog, instrument, center, allocator=method, **others)
        log.info("planned by %s: %s", method.name, tiles[method])
    blind = on_kind(tiles[best], "science")
    rows = [_row(method.name, tiles[method], blind) for method in methods]
    table = QTable({key: [row[key] for row in rows] for key in rows[0]})
    provenance = tiles[methods[0]].provenance
    software = {name: value for method in methods for name, value in tiles[method].provenance["software"].items()}
    recorded = [tiles[method].provenance["parameters"] for method in reversed(methods)]
    parameters = {k: v for record in recorded for k, v in record.items() if k != "allocator"}
    asked = methods[0].record  # a tile records only the options that its allocator uses
    parameters.update((name, asked[name]) for name in ("objective", "time_limit_s", "start"))
    table.meta.update(
        made_by="compare_allocators",
        unmet={method.name: tiles[method].summary["unmet"] for method in methods},
        blind_science=blind,
        instrument=provenance["instrument"]["name"],
        catalog=provenance["catalog"],
        arm_model=provenance["instrument"]["arm_model"],
        layout=provenance["instrument"]["layout"],
        **({"margins": str(margins)} if (margins := instrument.focal_plane.margins) else {}),
        software=software,
        parameters=parameters,
    )
    table["seconds"].unit = u.s
    return (table, {method.name: tiles[method] for method in methods}) if return_tiles else table


def _row(name, tile, blind):
    """Return the row of the table for the plan of one allocator."""
    summary, plan = tile.summary, plan_of(tile)
    values = {level: value for level, value, _ in summary["objectives"]}
    row = {"allocator": name, **{kind: on_kind(tile, kind) for kind in ("science", "standard", "sky")}}
    classes = [level for level in values if level.startswith("priority ")]
    if len(classes) <= MOST_CLASSES:
        row.update({level.replace(" ", "_"): int(values[level]) for level in classes})
    return row | {
        "missing": int(-values.get("requirements", 0)),
        "colliding": summary["n_colliding"],
        "pairs": plan.n_pairs,
        "at_obstacles": summary["n_obstacle_collisions"],
        "usable": plan.n_usable,
        "loss": 1 - plan.n_usable / blind if blind else np.nan,
        "gap": plan.gap,
        "seconds": plan.seconds,
    }


SAMPLE = 100_000


@dataclass(frozen=True, eq=False)
class Field:
    """A field of an instrument, with its targets."""

    instrument: Instrument
    catalog: Catalog
    center: SkyCoord
    seed: int


@dataclass(frozen=True, eq=False)
class Plan:
    """Numbers of fibers, targets and collisions in the plan that an allocator made for a field."""

    n_targets: int
    n_science: int
    n_usable: int
    n_pairs: int
    probability: np.ndarray
    """For each positioner: 1 if it is in collision, 0 if it is not, NaN if it is not counted."""
    gap: float
    seconds: float


def allocators_of(allocators, options: AllocationOptions | None, others: dict) -> list[AllocationOptions]:
    """Return a set of options for each allocator to compare; the sets differ only in the allocator."""
    methods = [allocators] if isinstance(allocators, str) or callable(allocators) else allocators
    if not isinstance(methods, list | tuple):
        raise InputTypeError(f"allocators must be a list of allocators, got {short(allocators)}")
    if "allocator" in others:
        raise InputError("the allocators to compare must be given as allocators=, got the argument allocator")
    if not methods:
        raise InputError("allocators must name at least one allocator, got none")
    common = AllocationOptions() if options is None else as_options(options)
    common.check_for_fields("a comparison")
    methods = [method for k, method in enumerate(methods) if method not in methods[:k]]
    return [replace(common, allocator=method) for method in methods]


def synthetic_fields(kind, models, center, each, density, number, rng) -> list[Field]:
    """Return fields of random targets for each instrument, with the same density per positioner or per solid angle."""
    check_whole(number, "n_realizations", 1, 1_000_000)
    if not is_real(each) or not 0 < each < np.inf:
        raise refusal("targets_per_positioner must be a positive number", each, Number)
    center = SkyCoord(0 * u.deg, 0 * u.deg) if center is None else center
    seed, fields = int(to_generator(rng).integers(2**63)), []
    for model in models:
        size = {"density": density}
        if density is None:
            expected = each * len(model.focal_plane) / _part_on_footprint(model, center)
            size = {"n_targets": round(expected) if kind == "uniform" else expected}
        # the seed depends on the name of the instrument, which thus has the same targets in each comparison
        rng_of_instrument = np.random.default_rng([seed, crc32(model.name.encode())])
        for rng_of_field in rng_of_instrument.spawn(int(number)):
            sky = synthetic_catalog(kind, center, model.field_radius, **size, rng=rng_of_field)
            fields.append(Field(model, sky, center, int(rng_of_field.integers(2**31))))
    return fields


def _part_on_footprint(model: Instrument, center: SkyCoord) -> float:
    """Return the fraction of targets inside the footprint, if targets are uniformly distributed in the field."""
    sky = synthetic_catalog("uniform", center, model.field_radius, n_targets=SAMPLE, rng=0)
    xy, _ = project_field(model, model.projection(center).plain, sky.arrays.vectors)
    return float(on_footprint(model.focal_plane, xy).mean())


def catalog_fields(catalog: Catalog, models, center, rng) -> list[Field]:
    """Return fields of a catalog for each instrument, with the same centers for all instruments."""
    if len(catalog) == 0:
        raise InputError("the catalog must have at least one target with finite coordinates, got none")
    centers = catalog.mean_direction if center is None else center
    centers = to_center(centers) if isinstance(centers, str) else centers
    if not isinstance(centers, SkyCoord) or centers.ndim > 1 or centers.size == 0:
        raise refusal("center must be a SkyCoord with one direction or a list of directions", center, SkyCoord)
    centers = centers.reshape(-1)
    seeds = to_generator(rng).integers(2**31, size=len(centers)).tolist()
    return [Field(m, catalog, direction, seed) for m in models for direction, seed in zip(centers, seeds, strict=True)]


def plan_fields(
    fields: list[Field], allocators: list[AllocationOptions], others: dict, executor: Executor | None, progress: bool
) -> list[list[Plan]]:
    """Plan every field with the allocator that ignores collisions, then with each of ``allocators``."""
    options = _for_instruments((replace(allocators[0], allocator=name_of_best()), *allocators), fields)
    asked = [options[field.instrument.name] for field in fields]
    return map_with_progress(executor, progress, "fields", partial(plan_field, others=others), fields, asked)


def _for_instruments(allocators, fields: list[Field]) -> dict[str, list[AllocationOptions]]:
    """Return the options of all allocators for each instrument; the same warning is issued only once."""
    models = {field.instrument.name: field.instrument for field in fields}
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", RfpsurveyWarning)
        options_of = {name: [options.for_instrument(model) for options in allocators] for name, model in models.items()}
    for text in dict.fromkeys(str(warning.message) for warning in told):
        warn(text)
    return options_of


def plan_field(field: Field, allocators: Sequence[AllocationOptions], others: dict) -> list[Plan]:
    """Plan a field with each allocator, and return one `Plan` per allocator."""
    plans = []
    for options in allocators:
        if options.name in METHODS:
            _compile(options.name, options.start)
        try:
            with used_elsewhere(*OPTIONS):  # allocators use different options
                tile = plan_tile(
                    field.catalog, field.instrument, field.center, allocator=options, **{"rng": field.seed, **others}
                )
        except InputError as error:
            raise InputError(f"{field.instrument.name}: {error}") from None
        plans.append(plan_of(tile))
    return plans


def plan_of(tile: Tile) -> Plan:
    """Return the numbers of fibers, targets and collisions of a tile."""
    table, summary = tile.table, tile.summary
    counted = np.isin(table["status"], ("assigned", "out_of_reach", "parked"))
    return Plan(
        summary["n_reachable"],
        on_kind(tile, "science"),
        int(np.count_nonzero(has_role(table["kind"], "science") & ~table["in_collision"])),
        summary["n_colliding_pairs"],
        np.where(counted, table["in_collision"], np.nan),
        np.nan if summary["gap"] is None else summary["gap"],
        summary["seconds"]["reach"] + summary["seconds"]["allocation"],
    )


def on_kind(tile, kind: str) -> int:
    """Return the number of fibers with a target of the given kind."""
    return int(np.count_nonzero(has_role(tile.table["kind"], kind)))


@cache
def _compile(allocator: str, start: str) -> None:
    """Plan a small field once in each process, so that the measured times do not include compilation."""
    robot = Positioner(7.4 * u.mm, 15 * u.mm, 1.5 * u.mm)
    small = Instrument(
        "small", FocalPlane.hexagonal(robot, rings=2, pitch=22.4 * u.mm), plate_scale=1 * u.mm / u.arcmin
    )
    center = SkyCoord(0 * u.deg, 0 * u.deg)
    sky = synthetic_catalog("uniform", center, small.field_radius, n_targets=40, rng=1)
    plan_tile(sky, small, center, allocator=AllocationOptions(allocator, start=start))
