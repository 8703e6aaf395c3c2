"""The targets of a catalog, and the selection of the targets of a field, which all plans share.

The *slot* of a target is its position in the order in which the targets of a catalog are stored for a plan, and its
*row* is the number of its row in the catalog.
"""

from copy import copy
from functools import cached_property
from typing import NamedTuple

import astropy.units as u
import numpy as np

from rfpsurvey._assignment.allocate import TargetColumns
from rfpsurvey._assignment.constraints.rule import Rule, check_unit
from rfpsurvey._assignment.constraints.targets import mark_required
from rfpsurvey._assignment.options import AllocationOptions
from rfpsurvey._common.units import to_visits
from rfpsurvey._field.plan import BlankIds, FieldTargets, blank_ids
from rfpsurvey._instruments.instrument import Instrument
from rfpsurvey._sky.arrays import SkyIndex, has_role, without_science
from rfpsurvey._sky.catalog import Catalog
from rfpsurvey._sky.time import move_vectors

SCALE_VARIES = 1.5
"""Factor by which the plate scale at the center of a field can exceed that at its edge."""
PLANNED_COLUMNS = ("priority", "kind", "category", "fiber_type", "subpriority")
"""Optional columns of a catalog that allocators use."""


class FieldRows(NamedTuple):
    """The targets of a field, in the order of their rows in the catalog."""

    slot: np.ndarray
    row: np.ndarray
    targets: FieldTargets


class SelectedRows(NamedTuple):
    """Given rows of a catalog, which take the place of a `SkyIndex` if there is only one field."""

    order: np.ndarray
    """Row of each target: first the targets of the field, then those around it, both in ascending order."""
    vectors: np.ndarray
    """Direction of each target as an ICRS unit vector."""
    radius_rad: float
    """Radius of the field in radians."""
    n_inside: int
    """Number of targets of the field."""

    def near(self, center: np.ndarray, radius_rad: float, left: np.ndarray | None = None) -> np.ndarray:
        """Return the slots of the targets of the field, except those for which ``left`` is 0.

        If the radius is larger than that of the field, the targets around the field are included.
        """
        n = self.n_inside if radius_rad <= self.radius_rad else len(self.order)
        return np.arange(n) if left is None else np.flatnonzero(left[:n])


class CatalogTargets:
    """The targets of a catalog in memory, in the order of slots, which is that of ``index``."""

    def __init__(self, catalog: Catalog, index: SkyIndex | SelectedRows):
        self.catalog, self.index = catalog, index

    def __len__(self):
        return len(self.index.order)

    @cached_property
    def _motion(self) -> np.ndarray:
        """Proper motions in radians per year, in the order of rows."""
        icrs = self.catalog.coord.icrs
        return np.column_stack([pm.to_value(u.rad / u.yr) for pm in (icrs.pm_ra_cosdec, icrs.pm_dec)])

    @property
    def fastest_rad(self) -> float:
        """Largest proper motion in radians per year."""
        return float(np.nan_to_num(np.hypot(*self._motion.T)).max(initial=0.0))

    def speeds(self, row: np.ndarray) -> np.ndarray:
        """Return the proper motions of the targets in given rows, in radians per year; 0 if they are unknown."""
        return np.nan_to_num(np.hypot(*self._motion[row].T))

    def _vectors(self, slot: np.ndarray, years: float) -> np.ndarray:
        """Return the directions of targets after a number of years."""
        vectors = self.index.vectors.take(slot, axis=0)  # four times as fast as vectors[slot]
        return vectors if years == 0 else move_vectors(vectors, self._motion[self.index.order[slot]], years)

    def to_slots(self, values: np.ndarray) -> np.ndarray:
        """Reorder values from the order of the rows of the catalog to the order of slots."""
        return values[self.index.order]

    def by_slot(self, name: str) -> np.ndarray | None:
        """Return a column of the catalog in the order of slots; None if the catalog does not have this column."""
        column = getattr(self.catalog, name)
        return None if column is None else self.to_slots(column)

    def ids_by_part(self) -> list[np.ndarray]:
        """Return a list with one array, the ids of all targets, because a catalog in memory has no partitions."""
        return [self.catalog.id]

    def field(
        self,
        center: np.ndarray,
        radius_rad: float,
        left: np.ndarray,
        *,
        rest_rad: float | None = None,
        by_row: bool = False,
        years: float = 0.0,
        margin_rad: float = 0.0,
        around_rad: float | None = None,
        always: np.ndarray | None = None,
    ) -> FieldRows:
        """Return the targets in a circle for which ``left`` is not 0, or for which ``always`` is true.

        ``left`` and ``always`` are in the order of slots or, if ``by_row`` is true, in the order of rows. If
        ``rest_rad`` is given, the field also contains the directions of all other targets in a circle whose radius is
        larger by this angle, as ``targets.others``. The targets are moved by their proper motions in a number of
        ``years``, by at most the angle ``margin_rad``. If ``around_rad`` is given, ``targets.around`` contains all
        other targets in a circle whose radius is larger by this angle.
        """
        left, others = self.to_slots(left) if by_row else left, None
        has_all = rest_rad is not None or always is not None
        slot = self._near(center, radius_rad, years, margin_rad, None if has_all else left)
        if has_all:
            usable = left[slot] > 0
            usable |= False if always is None else (self.to_slots(always) if by_row else always)[slot]
            slot = slot[usable]
        if rest_rad is not None:
            wide = self._near(center, radius_rad + rest_rad, years, margin_rad)
            others = self._vectors(wide[~np.isin(wide, slot)], years)
        around = None
        if around_rad is not None:
            near = self.index.near(center, radius_rad + margin_rad + around_rad)
            around = self._targets(near[~np.isin(near, slot)], years)
        return FieldRows(slot, self.index.order[slot], self._targets(slot, years, others, around))

    @property
    def units(self) -> dict:
        """Units of the additional columns (``extra``) of the catalog, by name."""
        return self.catalog.arrays.extra_units

    def _near(self, center, radius_rad: float, years: float, margin_rad: float, left=None) -> np.ndarray:
        """Return the slots of the targets in a circle after a number of years, except those for which ``left`` is 0."""
        slot = self.index.near(center, radius_rad + margin_rad, left)
        if not years:
            return slot
        return slot[np.linalg.norm(self._vectors(slot, years) - center, axis=1) <= 2 * np.sin(radius_rad / 2)]

    def _targets(self, slot: np.ndarray, years: float, others=None, around=None) -> FieldTargets:
        row, catalog = self.index.order[slot], self.catalog
        columns = {name: getattr(catalog, name) for name in PLANNED_COLUMNS}
        columns = TargetColumns(**{name: None if values is None else values[row] for name, values in columns.items()})
        extra = {name: values[row] for name, values in catalog.arrays.extra.items()}
        vectors = self._vectors(slot, years)
        return FieldTargets(vectors, catalog.id[row], columns, others, extra, catalog.numbered, around)


def separation_rad(options: AllocationOptions, instrument: Instrument) -> float | None:
    """Return an upper limit of the angle within which targets exclude added sky positions; None if none are added.

    All targets count, also those outside of the field and those without remaining visits.
    """
    if options.sky_separation is None:
        return None
    scale = instrument.plate_scale.to_value(u.mm / u.rad)
    return SCALE_VARIES * options.sky_separation.to_value(u.mm) / scale


class FieldBuilder:
    """The rules that determine which targets of a catalog a field contains, for tiles, surveys and tilings.

    A field contains the science targets with remaining visits. If there are requirements, each field also contains all
    standards and sky positions; otherwise, it contains those that are required targets. These can be used any number of
    times. A science target that is also a standard or sky position remains in the fields as such, without the role
    science, when it has no remaining visits. Targets of any kind whose requested number of visits is 0 are in no field,
    except required targets, for which at least one visit is requested.

    Parameters
    ----------
    source : CatalogTargets or Partitioned
        The targets.
    options : AllocationOptions
        Options, as `AllocationOptions.for_instrument` returns them.
    instrument : Instrument
        The instrument.
    visits : int or ndarray of int, optional
        Requested number of visits of each target, in the order of the catalog; by default, the column ``visits`` of the
        catalog or, without this column, 1.
    made : ndarray of int, optional
        Number of these visits that were already made, in the order of the catalog; by default 0.
    dropped : ndarray of bool, optional
        Whether no visit of each target is requested although it is required, in the order of the catalog.
    has_cadences : bool, optional
        Whether ``visits`` are those of cadences. A science target whose cadence has no epochs is then available in its
        other roles, unless its visits in the catalog are 0.

    Attributes
    ----------
    is_required : ndarray of bool or None
        Whether each target is required; None if no target is required. All arrays are in the order of slots.
    n_required : int
        Number of required targets in the catalog.
    visits : ndarray of uint8
        Requested number of visits of each target.
    wanted : ndarray of uint8
        Requested number of visits of each science target; 0 for standards and sky positions.
    left : ndarray of uint8
        Remaining visits before the first tile: ``wanted`` without the visits that were already made or, for standards
        and sky positions that fields contain, 1.
    surplus : ndarray of uint8 or None
        Number of visits that were made beyond the requested number; None if none were made.
    reusable : ndarray of bool or None
        Whether each target is a standard or sky position that fields contain; None if there are none.
    lasting : ndarray of bool or None
        Whether each target is a science target that also has another role for which fields contain it; None if there
        are none.
    around_rad : float or None
        Angle up to which constraints use targets around a field; None if no constraint uses targets.
    spends : ndarray of bool or None
        Whether a visit reduces the number of remaining visits of each target; None if this is true for all targets.
    """

    def __init__(
        self,
        source,
        options: AllocationOptions,
        instrument: Instrument,
        visits=None,
        *,
        made=None,
        dropped=None,
        has_cadences=False,
    ):
        self.source, self.options, self._instrument = source, options, instrument
        margins = [constraint.margin_rad for constraint in options.all_constraints if constraint.uses_targets]
        self.around_rad = max(margins, default=None)
        for constraint in options.all_constraints:
            if isinstance(constraint, Rule) and (column := getattr(constraint, "column", "")) in constraint.columns:
                check_unit(column, source.units.get(column, ""))
        marked = mark_required(options.required_ids, source.ids_by_part())
        self.n_required = 0 if marked is None else int(np.count_nonzero(marked))
        self.is_required = None if marked is None else source.to_slots(marked)
        kind, self._science, self._several, self.spends = source.by_slot("kind"), None, None, None
        if kind is not None:
            self._science = has_role(kind, "science")
            if options.counts or options.distributions:  # then fields also contain targets in other roles
                self._several = self._science & (kind != "science")
            self.spends = None if self._several is None and marked is None else self._science
        visits = source.by_slot("visits") if visits is None else source.to_slots(to_visits(visits, len(source)))
        visits = np.ones(len(source), dtype=np.uint8) if visits is None else visits
        self._has_cadences = has_cadences
        self._begin(visits, made, dropped)

    def _begin(self, visits, made, dropped) -> None:
        """Set the numbers of visits."""
        to_slots = self.source.to_slots
        # science targets with available visits can be used in their other roles
        available = self.source.by_slot("visits") if self._has_cadences else visits
        if self.is_required is not None:
            raised = self.is_required & (visits == 0)
            raised = raised if dropped is None else raised & ~to_slots(dropped)
            visits = np.where(raised, np.uint8(1), visits)
        self.visits, self.surplus, self.reusable, self.lasting = visits, None, None, None
        self.wanted = self.left = visits if self._science is None else np.where(self._science, visits, np.uint8(0))
        if made is not None:
            made = to_slots(made)
            self.left = self.wanted - np.minimum(made, self.wanted)
            self.surplus = made - np.minimum(made, self.wanted)
        if self.spends is not None:
            self.reusable = ~self.spends & (visits > 0)
            self.reusable &= self.is_required if self._several is None else True
            self.left = np.where(self.reusable, np.uint8(1), self.left)
        if self._several is not None:
            lasting = self._several & (True if available is None else (visits > 0) | (available > 0))
            self.lasting = lasting if lasting.any() else None

    def after(self, visits: np.ndarray, made: np.ndarray, dropped: np.ndarray) -> "FieldBuilder":
        """Return the rules with other numbers of visits.

        Parameters
        ----------
        visits, made : ndarray of uint8
            Requested number of visits of each target, and how many of them were made, in the order of the catalog.
        dropped : ndarray of bool
            Whether no visit of each target is requested although it is required, in the order of the catalog.

        Returns
        -------
        FieldBuilder
            The rules.
        """
        builder, visits = copy(self), self.source.to_slots(visits)
        builder._begin(visits, made, dropped)
        return builder

    def spending(self, slot: np.ndarray) -> np.ndarray:
        """Return the targets in ``slot`` of which a visit reduces the number of remaining visits.

        Parameters
        ----------
        slot : ndarray of int
            Slots of targets.

        Returns
        -------
        ndarray of int
            Some of the slots.
        """
        return slot if self.spends is None else slot[self.spends[slot]]

    @cached_property
    def blank(self) -> BlankIds | None:
        """Identifiers of blank sky positions; None if the options do not add blank sky positions."""
        return None if self.options.sky_separation is None else blank_ids(self.source.ids_by_part())

    def field(
        self,
        center: np.ndarray,
        radius_rad: float,
        left: np.ndarray | None = None,
        *,
        years: float = 0.0,
        margin_rad: float = 0.0,
    ) -> FieldRows:
        """Return the targets of a field, which is a circle on the sky.

        Parameters
        ----------
        center : ndarray, shape (3,)
            Unit vector of the field center.
        radius_rad : float
            Radius of the field in radians.
        left : ndarray, optional
            Remaining visits of each target; by default, those before the first tile.
        years, margin_rad : float, optional
            Number of years for which the targets are moved by their proper motions, and the largest angle of this
            motion.

        Returns
        -------
        FieldRows
            The targets.
        """
        left, rest_rad = self.left if left is None else left, separation_rad(self.options, self._instrument)
        more = {"rest_rad": rest_rad, "years": years, "margin_rad": margin_rad, "around_rad": self.around_rad}
        field = self.source.field(center, radius_rad, left, always=self.lasting, **more)
        if self.is_required is not None:
            columns = field.targets.columns._replace(is_required=self.is_required[field.slot])
            field = field._replace(targets=field.targets._replace(columns=columns))
        return field if self.lasting is None else self.in_other_roles(field, left[field.slot] == 0)

    def in_other_roles(self, field: FieldRows, where: np.ndarray) -> FieldRows:
        """Return a field in which some targets are no longer science targets, and are therefore not required.

        Parameters
        ----------
        field : FieldRows
            The field.
        where : ndarray of bool
            Whether this applies to each target of the field, if the target also has other roles (``lasting``).

        Returns
        -------
        FieldRows
            The field.
        """
        if self.lasting is None:
            return field
        columns, where = field.targets.columns, where & self.lasting[field.slot]
        columns = columns._replace(kind=np.where(where, without_science(columns.kind), columns.kind))
        if columns.is_required is not None:
            columns = columns._replace(is_required=columns.is_required & ~where)
        return field._replace(targets=field.targets._replace(columns=columns))
