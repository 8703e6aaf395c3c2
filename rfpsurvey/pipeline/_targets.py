"""The targets of a field, from the rows of a catalog; shared by surveys and by the placement of tiles."""

import numpy as np

from rfpsurvey.allocation import AllocationOptions, TargetColumns
from rfpsurvey.catalog import Catalog
from rfpsurvey.pipeline._field import FieldTargets

__all__ = ["PLANNED_COLUMNS", "field_targets", "reusable_targets"]

PLANNED_COLUMNS = ("priority", "kind", "category", "fiber_type", "subpriority")
"""Optional columns of a catalog that allocators use."""


def field_targets(
    catalog: Catalog,
    row: np.ndarray,
    vectors: np.ndarray,
    is_required: np.ndarray | None = None,
    others: np.ndarray | None = None,
) -> FieldTargets:
    """Return the targets in the given rows of a catalog, with all columns that a plan requires.

    ``vectors`` are the unit vectors of these targets, and ``is_required`` states whether each of them is required.
    ``others`` are the unit vectors of targets that are not assigned; blank sky positions must avoid these targets.
    """
    columns = {name: getattr(catalog, name) for name in PLANNED_COLUMNS}
    columns = {name: None if values is None else values[row] for name, values in columns.items()}
    extra = {name: values[row] for name, values in catalog.arrays.extra.items()}
    columns = TargetColumns(**columns, is_required=is_required)
    return FieldTargets(vectors, catalog.id[row], columns, others, extra, catalog.numbered)


def reusable_targets(
    kind: np.ndarray | None, options: AllocationOptions, is_required: np.ndarray | None
) -> np.ndarray | None:
    """Return whether each target is a standard or sky position that every tile may use; None if there are none.

    If there are requirements, every tile may use all standards and sky positions. Otherwise, every tile may use only
    those that are required targets.
    """
    if kind is None or not (options.requirements or is_required is not None):
        return None
    others = kind != "science"
    return others if options.requirements else others & is_required
