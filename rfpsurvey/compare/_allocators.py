"""Compare several allocators on the same field."""

import logging
import warnings
from collections.abc import Callable
from dataclasses import replace

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table

from rfpsurvey.allocation import METHODS, OPTIONS, AllocationOptions, name_of_best, warn_of_unused_options
from rfpsurvey.catalog import Catalog, as_catalog
from rfpsurvey.compare._fields import allocators_of, on_kind, plan_of
from rfpsurvey.errors import RfpsurveyWarning, check_switch, used_elsewhere
from rfpsurvey.instrument import Instrument, as_instrument
from rfpsurvey.tile import Tile, plan_tile

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
    software = {name: value for one in methods for name, value in tiles[one].provenance["software"].items()}
    recorded = [tiles[one].provenance["parameters"] for one in reversed(methods)]
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
