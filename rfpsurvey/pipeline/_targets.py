"""The targets of a field, from the rows of a catalog; shared by surveys and by the placement of tiles."""

from functools import cached_property
from typing import NamedTuple

import astropy.units as u
import numpy as np

from rfpsurvey.allocation import AllocationOptions, TargetColumns
from rfpsurvey.catalog import Catalog, SkyIndex, move_vectors
from rfpsurvey.pipeline._field import FieldTargets

__all__ = ["PLANNED_COLUMNS", "CatalogFields", "Field", "reusable_targets"]

PLANNED_COLUMNS = ("priority", "kind", "category", "fiber_type", "subpriority")
"""Optional columns of a catalog that allocators use."""


class Field(NamedTuple):
    """The targets of a field, in the order of their rows in the catalog."""

    slot: np.ndarray
    """Position of each target in the spatial index; in a partitioned catalog, its row."""
    row: np.ndarray
    targets: FieldTargets


class CatalogFields:
    """The fields of a catalog; ``index`` is the spatial index of its targets, and a *slot* is a position in the index.

    Surveys and the placement of tiles plan the same fields.
    """

    def __init__(self, catalog: Catalog, index: SkyIndex):
        self.catalog, self.index = catalog, index

    @cached_property
    def _motion(self) -> np.ndarray:
        """Proper motions in radians per year, in the order of rows."""
        icrs = self.catalog.coord.icrs
        return np.column_stack([pm.to_value(u.rad / u.yr) for pm in (icrs.pm_ra_cosdec, icrs.pm_dec)])

    @property
    def fastest_rad(self) -> float:
        """Largest proper motion in radians per year."""
        return float(np.nan_to_num(np.hypot(*self._motion.T)).max(initial=0.0))

    def _vectors(self, slot: np.ndarray, years: float) -> np.ndarray:
        """Return the directions of targets after a number of years."""
        vectors = self.index.vectors[slot]
        return vectors if years == 0 else move_vectors(vectors, self._motion[self.index.order[slot]], years)

    def to_slots(self, values: np.ndarray) -> np.ndarray:
        """Reorder values from the order of the rows of the catalog to the order of slots."""
        return values[self.index.order]

    def field(
        self,
        center: np.ndarray,
        radius_rad: float,
        left: np.ndarray,
        *,
        rest: bool = False,
        by_row: bool = False,
        years: float = 0.0,
        margin_rad: float = 0.0,
        slot: np.ndarray | None = None,
    ) -> Field:
        """Return the targets in a circle that still require a visit.

        ``left`` is the number of remaining visits of each target, in the order of slots or, if ``by_row`` is true, in
        the order of rows. If ``rest`` is true, the field also contains the directions of the targets without remaining
        visits, as ``targets.others``. The targets are moved by their proper motions in a number of ``years``, by at
        most the angle ``margin_rad``. If the slots of the targets that still require a visit are known, they can be
        given as ``slot``; ``rest`` and ``years`` must then have their default values.
        """
        left, others = self.to_slots(left) if by_row else left, None
        slot = self.index.near(center, radius_rad + margin_rad, None if rest else left) if slot is None else slot
        if years:
            apart = np.linalg.norm(self._vectors(slot, years) - center, axis=1)
            slot = slot[apart <= 2 * np.sin(radius_rad / 2)]
        if rest:
            others = self._vectors(slot[left[slot] == 0], years)
            slot = slot[left[slot] > 0]
        row, catalog = self.index.order[slot], self.catalog
        columns = {name: getattr(catalog, name) for name in PLANNED_COLUMNS}
        columns = TargetColumns(**{name: None if values is None else values[row] for name, values in columns.items()})
        extra = {name: values[row] for name, values in catalog.arrays.extra.items()}
        vectors = self._vectors(slot, years)
        return Field(slot, row, FieldTargets(vectors, catalog.id[row], columns, others, extra, catalog.numbered))


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
