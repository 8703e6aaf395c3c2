"""The targets that a tile observes, with ideal fibers or with the positioners of a focal plane."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.time import Time

from rfpsurvey._roles import has_role
from rfpsurvey._settings import Settings, option
from rfpsurvey.errors import check_keywords
from rfpsurvey.instrument import Instrument
from rfpsurvey.pipeline import FieldBuilder, plan_field
from rfpsurvey.tiling._conditions import FieldsOfTiles
from rfpsurvey.tiling._tiling import Tiling, to_ra_dec


@check_keywords
@dataclass(frozen=True, eq=False, repr=False)
class Fibers(Settings):
    """The largest number of targets that a tile observes, their minimum separation, and the effect of collisions.

    Parameters
    ----------
    number : int, optional
        Largest number of targets that a tile observes; by default the number of positioners that are neither disabled
        nor stuck.
    min_separation : Quantity, optional
        Minimum angular separation of the targets that a tile observes. This parameter applies only to ideal fibers,
        which reach any target of the field, and is not allowed with an allocator.
    lost_in_collision : bool, optional
        Whether a target counts as not observed if the arm at this target collides, as in `~rfpsurvey.plan_survey`. This
        parameter applies only if an allocator plans the tiles.

    Raises
    ------
    InputError
        If ``number`` is not a positive whole number, or if ``min_separation`` is not an angle.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> rs.tiling.Fibers(640, min_separation=55 * u.arcsec).number
    640
    """

    number: int | None = option(None, low=1, what="fibers")
    min_separation: u.Quantity[u.rad] | None = option(None, above=0, below=np.pi)
    lost_in_collision: bool = option(True)

    @property
    def ideal(self) -> bool:
        """Whether each fiber reaches every target of the field; true if ``number`` or ``min_separation`` is given."""
        return self.number is not None or self.min_separation is not None


class FreeFibers:
    """Ideal fibers that reach any target of the field, with a minimum separation of their targets.

    Targets receive fibers in the order of priority. Targets of equal priority are sorted by the number of later tiles
    that cover them (fewest first), then by the number of other targets that are too close to them (fewest first), and
    then by their order in the catalog.

    Parameters
    ----------
    fibers : int
        Largest number of targets.
    priority : ndarray or None
        Priority of each target, in the order of the spatial index.
    neighbors : tuple of ndarray or None
        Pairs of targets that are too close to each other, as `neighbors_within` returns them.
    """

    def __init__(self, fibers: int, priority: np.ndarray | None, neighbors: tuple | None):
        self.fibers, self.priority, self.neighbors = fibers, priority, neighbors
        self.means = "an upper limit: each fiber reaches any target of its field, and no arms collide"

    def __call__(self, center, near, state):
        """Return the targets that a tile observes; ``near`` lists the targets in its field that require a visit."""
        if self.neighbors is None and len(near) <= self.fibers:
            return near
        keys = [np.arange(len(near))]
        if self.neighbors is not None:
            indptr, neighbor = self.neighbors
            first, size = indptr[near], indptr[near + 1] - indptr[near]
            # the neighbors of all targets, one target after the other, without a loop
            of_pair = np.repeat(np.arange(len(near)), size)
            too_close = neighbor[np.repeat(first - np.cumsum(size) + size, size) + np.arange(len(of_pair))]
            degree = np.bincount(of_pair[np.isin(too_close, near)], minlength=len(near))
            keys.append(degree)
        if state.chances is not None:
            keys.append(state.chances[near])
        if self.priority is not None:
            keys.append(-self.priority[near])
        order = np.lexsort(keys)  # the last key is the first criterion
        if self.neighbors is not None:
            taken, blocked = degree == 0, set()
            for k in order[degree[order] > 0].tolist():
                if near[k] not in blocked:
                    taken[k] = True
                    blocked.update(neighbor[first[k] : first[k] + size[k]].tolist())
            order = order[taken[order]]
        return near[np.sort(order[: self.fibers])]


@dataclass(eq=False)
class FocalPlaneFibers(FieldsOfTiles):
    """The positioners of an instrument with an allocator; tiles are planned as in a survey."""

    instrument: Instrument
    builder: FieldBuilder
    fibers: Fibers
    tiling: Tiling | float
    """The tiles, in their order; or the position angle (degrees) of tiles that are not yet placed."""
    seed: int
    reference: Time | None

    def __post_init__(self):
        self.source = self.builder.source
        if not isinstance(self.tiling, Tiling):
            self.places, self.conditions, self.reference = None, None, None
        lost = "is not observed" if self.fibers.lost_in_collision else "counts as observed"
        self.means = f"the allocator {self.builder.options.name} plans each tile; a target whose arm collides {lost}"

    def __call__(self, center, near, state):
        """Return the targets that a tile observes; ``near`` lists the targets in its field that require a visit."""
        number = len(state.rows)
        place = [*np.concatenate(to_ra_dec(center[None])), self.tiling] if self.places is None else self.places[number]
        conditions, builder = None if self.conditions is None else self.conditions[number], self.builder
        plane = self.instrument.field_projection(*np.deg2rad(place), conditions)
        years = 0.0 if self.years is None else float(self.years[number])
        left = state.left if builder.reusable is None else np.where(builder.reusable, 1.0, state.left)
        slot, _, targets = builder.field(center, self.radius_rad, left, years=years, margin_rad=self.margin_rad)
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(number,)))
        plan = plan_field(self.instrument, plane, targets, builder.options, rng, builder.blank)
        counts = (plan.target >= 0) & has_role(plan.kind, "science")
        if self.fibers.lost_in_collision:
            counts &= ~plan.report.in_collision[plan.positioner]
        served = np.sort(plan.target[counts])
        if self.fibers.number is not None and len(served) > self.fibers.number:
            priority, is_required = targets.columns.priority, targets.columns.is_required
            keys = [np.zeros(len(slot)) if priority is None else -priority]
            keys += [] if is_required is None else [~is_required]
            order = served[np.lexsort([key[served] for key in keys])]
            served = np.sort(order[: self.fibers.number])
        return slot[served]


def neighbors_within(vectors: np.ndarray, separation_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each direction, the other directions that are closer than ``separation_rad``.

    The two arrays of the result are ``indptr`` and ``indices`` of a matrix in compressed rows.
    """
    from scipy.spatial import cKDTree

    chord = 2 * np.sin(min(separation_rad, np.pi) / 2)
    pairs = cKDTree(vectors).query_pairs(chord, output_type="ndarray")
    distance = np.linalg.norm(vectors[pairs[:, 0]] - vectors[pairs[:, 1]], axis=1)
    pairs = pairs[distance < chord]  # the tree also returns pairs exactly at this distance
    ordered = np.concatenate([pairs, pairs[:, ::-1]])
    ordered = ordered[np.lexsort((ordered[:, 1], ordered[:, 0]))]
    indptr = np.searchsorted(ordered[:, 0], np.arange(len(vectors) + 1))
    return indptr, ordered[:, 1]
