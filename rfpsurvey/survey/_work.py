"""The work on one tile: a function of what it is given, so that it may run anywhere, and again."""

import pickle
from functools import cached_property, lru_cache
from typing import NamedTuple

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._io import fits_bytes
from rfpsurvey._units import to_lonlat
from rfpsurvey.instrument import Instrument
from rfpsurvey.survey._source import Field
from rfpsurvey.tile import run_stages

__all__ = ["COUNTS", "N_FIELD", "Done", "Job", "Model", "in_reach", "work"]

# Header cards of a part: what they count, and how they say so.
N_FIELD = "NFIELD"
COUNTS = {
    N_FIELD: ("n_in_field", "targets in the field, still wanted"),
    "NREACH": ("n_reachable", "of these, in reach of a positioner"),
    "NASSIGN": ("n_assigned", "positioners with a target"),
    "NSCIENCE": ("n_science", "of these, with a science target"),
    "NCOLLIDE": ("n_colliding", "positioners in collision"),
    "NCOUNTED": ("n_counted", "positioners with a target or in the way"),
    "NPAIRS": ("n_colliding_pairs", "pairs of arms in collision"),
    "NOBSTACL": ("n_obstacle_collisions", "collisions with obstacles"),
    "NUNMET": ("n_unmet", "requirements not met"),
}


class Model:
    """An instrument and the options of the allocation, which a process unpacks once."""

    def __init__(self, instrument: Instrument, options: dict, *, lost_in_collision: bool):
        self.content = instrument, options, lost_in_collision

    @cached_property
    def _packed(self) -> bytes:
        return pickle.dumps(self.content, protocol=5)

    def __reduce__(self):
        return _unpack, (self._packed,)


@lru_cache(maxsize=4)
def _unpack(packed: bytes) -> Model:
    instrument, options, lost = pickle.loads(packed)
    return Model(instrument, options, lost_in_collision=lost)


class Job(NamedTuple):
    """What is to be done for a tile."""

    model: Model
    tile: int | str
    ra_deg: float
    dec_deg: float
    position_angle_deg: float
    field: Field
    seed: np.random.SeedSequence
    as_file: bool


class Done(NamedTuple):
    """What came out."""

    part: bytes | None
    """The visits as a FITS file, where that is asked for."""
    visits: np.ndarray | None
    """The visits, where not."""
    target: np.ndarray
    """Place in the field of the target of each visit, -1 for sky positions that were found."""
    observed: np.ndarray
    in_reach: np.ndarray
    """Which targets of the field any positioner reaches."""
    counts: dict


def work(job: Job) -> Done:
    """Plan a tile."""
    instrument, options, lost_in_collision = job.model.content
    plane, field = instrument.focal_plane, job.field
    projection, xy, needs = _project(job)
    columns = {name: getattr(field, name) for name in ("priority", "kind", "category")}
    if field.rest is not None:
        columns["avoid"] = projection._project(field.rest) * u.mm
    allocation, _, report, _ = run_stages(
        plane, xy, **columns, fiber_type=needs, rng=np.random.default_rng(job.seed), **options
    )
    own = np.flatnonzero(allocation.target_of_positioner >= 0)
    target = allocation.target_of_positioner[own]
    given = target < allocation.n_given
    colliding = report.in_collision[own]
    ra, dec = _directions(field, target, given, allocation, projection)
    columns = {
        "target_id": _pick(field.id, target, given),
        "target_row": _pick(field.row, target, given),
        "positioner": plane.id[own],
        "ra": ra,
        "dec": dec,
        "in_collision": colliding,
        "observed": ~colliding if lost_in_collision else np.ones(len(own), dtype=bool),
    }
    if plane.fiber_types != ("",):
        columns["fiber_type"] = allocation.fiber_type[own]
    kind = np.full(len(own), "science")
    if field.kind is not None or "sky_separation" in options:
        kind = kind if field.kind is None else _pick(field.kind, target, given)
        columns["kind"] = kind = np.where(given, kind, "sky")
    visits = np.rec.fromarrays(list(columns.values()), names=list(columns))
    counts = {
        "n_in_field": len(field.row),
        "n_reachable": allocation.n_reachable,
        "n_assigned": len(own),
        "n_science": int((kind == "science").sum()),
        "n_colliding": int((report.in_collision & report.counted).sum()),
        "n_counted": int(report.counted.sum()),
        "n_colliding_pairs": len(report.pairs),
        "n_obstacle_collisions": len(report.obstacle_pairs),
        "n_unmet": len(allocation.unmet),
    }
    cards = {"TILE": job.tile, "RA": job.ra_deg, "DEC": job.dec_deg, "POSANG": job.position_angle_deg}
    cards.update((card, (counts[name], words)) for card, (name, words) in COUNTS.items())
    cards.update((f"TUNIT{list(columns).index(name) + 1}", "deg") for name in ("ra", "dec"))
    part, visits = (fits_bytes(visits, cards), None) if job.as_file else (None, visits)
    return Done(part, visits, np.where(given, target, -1), columns["observed"], allocation.in_reach, counts)


def in_reach(job: Job) -> np.ndarray:
    """Return which targets of the field any positioner reaches."""
    _, xy, needs = _project(job)
    return job.model.content[0].focal_plane._reach(xy, needs).covered


def _project(job: Job):
    """Return the projection of a field, its targets on the focal plane, and the fibers that they need."""
    instrument, field = job.model.content[0], job.field
    needs = instrument._needs(field.fiber_type, len(field.row))
    center = SkyCoord(job.ra_deg * u.deg, job.dec_deg * u.deg)
    projection = instrument.projection(center, job.position_angle_deg * u.deg)
    return projection, projection._project(field.vectors, needs), needs


def _directions(field, target, given, allocation, projection):
    """Return right ascension and declination (deg) of the targets, and of sky positions that were found."""
    lon, lat = np.empty(len(target)), np.empty(len(target))
    lon[given], lat[given] = to_lonlat(field.vectors[target[given]])
    if not given.all():
        blank = target[~given]
        where = projection.to_sky(allocation.xy[blank], None if allocation.wanted is None else allocation.wanted[blank])
        lon[~given], lat[~given] = where.ra.rad, where.dec.rad
    return np.rad2deg(lon) % 360, np.rad2deg(lat)


def _pick(values: np.ndarray, target: np.ndarray, given: np.ndarray) -> np.ndarray:
    """Return the values of targets; -1 or "" for sky positions that were found."""
    blank = np.array([-1 if values.dtype.kind == "i" else ""], dtype=values.dtype)
    return np.append(values, blank)[np.where(given, target, len(values))]
