"""The result for one tile: a row for each positioner, a summary, and where it comes from."""

import json
import os
import sys
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache, cached_property
from importlib.metadata import PackageNotFoundError, version

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import MaskedColumn, QTable
from astropy.time import Time
from astropy.utils.masked import Masked

from rfpsurvey import _io
from rfpsurvey._display import to_html
from rfpsurvey.catalog import to_time
from rfpsurvey.collision import Arms, CollisionReport, nearest_distance
from rfpsurvey.errors import InputError, InputTypeError
from rfpsurvey.instrument import Instrument
from rfpsurvey.pipeline import OUTCOMES
from rfpsurvey.tile._columns import OUTCOMES_COLUMNS, TILE_COLUMNS, describe, only_with_target
from rfpsurvey.tile._model import model_sentence
from rfpsurvey.tile._targets import TargetsOfField, completeness_table

__all__ = ["Tile", "build_tile", "versions"]

MUST_HAVE = (
    "summary.n_positioners",
    "summary.n_assigned",
    "summary.n_colliding",
    "summary.collision_rate",
    "summary.seconds",
    "provenance.instrument.name",
    "provenance.parameters.allocator",
    "provenance.catalog",
)
MODEL = "static geometry in the focal plane at one wavelength; no refraction, no dynamic collisions"


@dataclass(frozen=True, eq=False)
class Tile:
    """One tile: which fiber is where, and which arms collide.

    Parameters
    ----------
    table : QTable
        A row for each positioner. Columns: ``id``, ``spectrograph`` (where there are several), ``x``, ``y`` (center),
        ``status`` (``assigned``; ``out_of_reach``: the arm cannot get to its target; ``parked``: without a target, and
        an obstacle for others; ``idle``: without a target, and no obstacle; ``disabled``; ``stuck``), ``target_id``
        (masked without a target), ``ra``, ``dec`` (ICRS), ``fiber_type`` (where there are several), ``theta``,
        ``phi``, ``elbow_x``, ``elbow_y``, ``tip_x``, ``tip_y``, ``in_collision``, ``colliding_with`` (ids, and
        ``obstacle-3`` for a circle, separated by spaces), ``clearance`` (distance to the nearest other arm minus the
        minimum separation), ``arm_x``, ``arm_y`` (end of the segment from the elbow that can collide), and in planned
        tiles ``kind`` (``science``, ``standard``, ``sky``, or empty; a stuck unit can look at sky, too), and
        ``category``, ``priority`` and the further columns of the catalog, where it has them. Numbers that do not apply
        are NaN, integers masked. Its ``meta`` holds ``summary``, ``provenance`` and ``geometry``.
    targets : QTable or TargetsOfField, optional
        All targets of the field; see `outcomes`.

    Raises
    ------
    InputError
        If the table is not that of a tile.

    Examples
    --------
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> lamost = rs.Instrument.preset("lamost")
    >>> center = SkyCoord("6h20m +23d")
    >>> sky = rs.synthetic_catalog("uniform", center, lamost.field_radius, n_targets=9000, rng=1)
    >>> tile = rs.plan_tile(sky, lamost, center)
    >>> tile.summary["n_positioners"]
    4000
    """

    table: QTable
    targets: object = field(default=None, repr=False)

    OUTCOMES = OUTCOMES
    """The outcomes of targets."""

    def __post_init__(self):
        if not isinstance(self.table, QTable):
            raise InputTypeError(f"table must be a QTable, got {type(self.table).__name__}")
        lacking = [name for name in ("summary", "provenance", "geometry") if name not in self.table.meta]
        if lacking or "in_collision" not in self.table.colnames:
            raise InputError("the table is not that of a tile: it lacks " + (", ".join(lacking) or "in_collision"))
        for path in MUST_HAVE:
            value = self.table.meta
            for name in path.split("."):
                value = value.get(name) if isinstance(value, dict) else None
            if value is None:
                raise InputError(f"the meta of a tile must have the entry {path}, got none")

    @property
    def summary(self) -> dict:
        """Counts, rates, the model that was used and why it suffices, and seconds of each stage."""
        return self.table.meta["summary"]

    @property
    def provenance(self) -> dict:
        """Versions, instrument, catalog and parameters behind the tile."""
        return self.table.meta["provenance"]

    @property
    def instrument(self) -> str:
        """Name of the instrument."""
        return self.provenance["instrument"]["name"]

    @property
    def center(self) -> SkyCoord | None:
        """Field center (ICRS); None for assignments that were scored in the focal plane."""
        parameters = self.provenance["parameters"]
        if "ra_deg" not in parameters:
            return None
        return SkyCoord(parameters["ra_deg"], parameters["dec_deg"], unit="deg")

    @property
    def position_angle(self) -> u.Quantity | None:
        """Angle from north toward east by which +y of the focal plane is turned; None where it is not known."""
        angle = self.provenance["parameters"].get("position_angle_deg")
        return None if angle is None else angle * u.deg

    @property
    def epoch(self) -> Time | None:
        """Epoch of the positions of the targets; None where it is not known."""
        epoch = self.provenance["parameters"].get("epoch")
        return None if epoch is None else to_time(epoch, "epoch")

    @cached_property
    def outcomes(self) -> QTable | None:
        """What became of every target of the field, a row each; None for tiles that were scored, or read from ECSV.

        Columns: ``target_id``, ``ra``, ``dec``, ``x``, ``y`` (in the focal plane; NaN for targets that are not
        requested), ``outcome`` (a text of `OUTCOMES`), ``positioner`` (masked or empty without one), and ``kind``,
        ``category``, ``priority`` and the further columns of the catalog, where it has them.
        """
        return self.targets.table(np.asarray(self.table["id"])) if hasattr(self.targets, "table") else self.targets

    @cached_property
    def completeness(self) -> QTable | None:
        """Counts of the targets of the field by kind, category, and priority of science targets.

        Columns: ``kind``, ``category``, ``priority`` (``all``: all of them), ``n_in_field``, ``n_reachable`` (0 for
        targets that are not requested), ``n_assigned``, ``n_observed`` (assigned, and not in collision) and
        ``completeness``, which is ``n_observed`` over ``n_in_field``. None where there are no `outcomes`.
        """
        return None if self.outcomes is None else completeness_table(self.outcomes)

    @classmethod
    def read(cls, path: str | os.PathLike) -> "Tile":
        """Read a tile that `write` wrote.

        Parameters
        ----------
        path : str or path-like
            The file.

        Returns
        -------
        Tile
            Equal to the one that was written.

        Raises
        ------
        InputError
            If the file is not there or does not hold a tile.
        """
        table = _io.read_table(path)
        try:
            table.meta = {k: v for k, v in table.meta.items() if not k.startswith("__")}
            has_target = np.isin(table["status"], ("assigned", "out_of_reach"))
            table["target_id"] = _target_column(table["target_id"], has_target)
            tile = cls(describe(_plain(table), TILE_COLUMNS))
        except (KeyError, InputError) as error:
            raise InputError(f"{path} does not hold a tile: {error}") from None
        if not tile.provenance.get("outcomes") or _io.suffix_of(_io.to_path(path)) != ".fits":
            return tile
        return cls(tile.table, describe(_plain(_io.read_table(path, number=1)), OUTCOMES_COLUMNS))

    def write(self, path: str | os.PathLike, *, overwrite: bool = False) -> None:
        """Write the tile as FITS or ECSV; the file appears whole or not at all.

        The first table of a FITS file, ``TILE``, is `table`; the second, ``OUTCOMES``, is `outcomes`, where there are
        any. ECSV holds `table` only.

        Parameters
        ----------
        path : str or path-like
            Ends in ``.fits`` or ``.ecsv``, with or without ``.gz``.
        overwrite : bool, optional
            Replace a file that exists.

        Raises
        ------
        InputError
            If the folder is missing or the file exists.
        """
        parameters = self.provenance["parameters"]
        cards = {
            "INSTRUME": (self.instrument, "instrument"),
            "RA": (parameters.get("ra_deg"), "[deg] field center"),
            "DEC": (parameters.get("dec_deg"), "[deg] field center"),
            "POSANG": (parameters.get("position_angle_deg"), "[deg] of +y, from north toward east"),
            "NORTHOF": (parameters.get("north_of"), "frame or equinox of north"),
            "RADESYS": ("ICRS", "frame of right ascensions and declinations"),
            "REFEPOCH": (parameters.get("epoch"), "epoch of the positions"),
            "ALLOCATR": (parameters.get("allocator"), "allocator"),
            "NASSIGN": (self.summary["n_assigned"], "positioners with a target"),
            "NCOLLIDE": (self.summary["n_colliding"], "positioners in collision"),
        }
        cards = {name: card for name, card in cards.items() if card[0] is not None}
        others = {} if self.outcomes is None else {"OUTCOMES": self.outcomes}
        _io.write_table(self.table, path, overwrite=overwrite, cards=cards, name="TILE", others=others)

    def __len__(self):
        return len(self.table)

    def __getitem__(self, item):
        return self.table[item]

    def __eq__(self, other):
        if not isinstance(other, Tile):
            return NotImplemented
        a, b = self.table, other.table
        # as text, in which NaN equals NaN
        same_meta = json.dumps(a.meta, sort_keys=True) == json.dumps(b.meta, sort_keys=True)
        return same_meta and _same_table(a, b) and _same_table(self.outcomes, other.outcomes)

    __hash__ = None

    def _repr_html_(self) -> str:
        return to_html(self, self.summary, self.table)

    def __repr__(self):
        s = self.summary
        return (
            f"<Tile of {self.provenance['instrument']['name']!r}: {s['n_assigned']} of {s['n_positioners']} "
            f"positioners assigned, {s['n_colliding']} in collision>"
        )


def build_tile(
    instrument: Instrument,
    ids: np.ndarray,
    sky_deg: np.ndarray,
    target_of: np.ndarray,
    fiber_type: np.ndarray,
    posed: Arms,
    report: CollisionReport,
    summary: dict,
    parameters: dict,
    catalog_meta: dict,
    kind: np.ndarray | None = None,
    carried: dict | None = None,
    targets: TargetsOfField | None = None,
    software: dict | None = None,
) -> Tile:
    """Put the columns together.

    ``ids``, ``sky_deg`` (rows ra, dec in ICRS) and ``kind`` describe the targets; ``target_of`` are their rows, -1 for
    none. Columns that are ``carried`` have a value for each positioner; ``targets`` are all of the field.
    ``software`` are packages that took part, other than the usual ones.
    """
    plane = instrument.focal_plane
    n = len(plane)
    has_target = posed.assigned
    if len(ids) == 0:  # a plan without any target
        ids, sky_deg = np.zeros(1, dtype=ids.dtype), np.full((2, 1), np.nan)
    row = np.where(has_target, target_of, 0)
    names = np.array([str(i) for i in plane.id])
    status = np.full(n, "idle", dtype="U12")
    for flag, word in (
        (posed.parked, "parked"),
        (plane.disabled, "disabled"),
        (plane.arrays.is_stuck, "stuck"),
        (has_target, "assigned"),
        (posed.clipped, "out_of_reach"),
    ):
        status[flag] = word
    table = QTable({"id": plane.id})
    if plane.spectrograph.any():
        table["spectrograph"] = _spectrograph(plane, fiber_type)
    table["x"], table["y"] = plane.arrays.xy.T * u.mm
    table["status"] = status
    table["target_id"] = _target_column(ids[row], has_target)
    table["ra"], table["dec"] = np.where(has_target, sky_deg[:, row], np.nan) * u.deg
    if plane.fiber_types != ("",):
        table["fiber_type"] = np.where(has_target, fiber_type, "")
    table["theta"], table["phi"] = np.rad2deg(posed.theta) * u.deg, np.rad2deg(posed.phi) * u.deg
    table["elbow_x"], table["elbow_y"] = posed.elbow.T * u.mm
    table["tip_x"], table["tip_y"] = posed.tip.T * u.mm
    table["in_collision"] = report.in_collision
    partners = [list(names[p]) if p else p for p in report.colliding_with]
    for i, j in report.obstacle_pairs.tolist():
        partners[i].append(f"obstacle-{j}")
    table["colliding_with"] = [" ".join(p) for p in partners]
    table["clearance"] = (nearest_distance(posed) - plane.positioner.numbers.separation) * u.mm
    table["arm_x"], table["arm_y"] = posed.segments[:, 2:].T * u.mm
    if kind is not None:
        table["kind"] = np.append(kind, "")[target_of]
    for name, values in (carried or {}).items():
        table[name] = values
    summary = {
        **summary,
        "n_positioners": n,
        "n_assigned": int(has_target.sum()),
        "n_parked": int(posed.parked.sum()),
        "n_idle": int((status == "idle").sum()),
        "n_colliding": int((report.in_collision & report.counted).sum()),
        "n_colliding_pairs": len(report.pairs),
        "n_obstacle_collisions": len(report.obstacle_pairs),
        "collision_rate": report.rate,
        "collision_rate_assigned": report.rate_assigned,
        "model": model_sentence(instrument, posed),
    }
    meta = {
        "summary": summary,
        "provenance": {
            "software": {**versions(), **(software or {})},
            "created": datetime.now(UTC).isoformat(timespec="seconds"),
            "model": MODEL,
            "instrument": instrument.provenance,
            "catalog": dict(catalog_meta),
            "parameters": parameters,
            "outcomes": targets is not None,
        },
        "geometry": {
            "inner_radius_mm": _one_or_all(plane.arrays.inner_radius),
            "outer_radius_mm": _one_or_all(plane.arrays.outer_radius),
            "min_separation_mm": float(plane.positioner.numbers.separation),
            "arm_model": plane.positioner.arm_model,
            "obstacles_mm": plane.arrays.obstacles.tolist(),
        },
    }
    table.meta = json.loads(json.dumps(meta, default=str))  # what every file can hold
    return Tile(describe(table, TILE_COLUMNS), targets)


def _target_column(ids, has_target) -> MaskedColumn:
    """Return ids with a mask."""
    ids = np.ma.filled(ids, "") if ids.dtype.kind == "U" else np.asarray(ids)
    if ids.dtype.kind == "i":
        return only_with_target(ids, has_target)
    return MaskedColumn(only_with_target(ids.astype(str), has_target), mask=~has_target, fill_value="")


def _plain(table: QTable) -> QTable:
    """Replace masks that a file has: by NaN, empty text, or where they are for integers without a target by a mask."""
    for name in table.colnames:
        column = table[name]
        if isinstance(column, Masked):
            table[name] = column.filled(np.nan)
        elif isinstance(column, MaskedColumn) and column.dtype.kind in "fU" and name != "target_id":
            table[name] = column.filled("" if column.dtype.kind == "U" else np.nan)
        elif isinstance(column, MaskedColumn) and column.dtype.kind == "b":
            table[name] = column.filled(False)
        elif isinstance(column, MaskedColumn) and column.dtype.kind == "i":
            table[name] = only_with_target(np.asarray(column), ~column.mask)
    return table


def _one_or_all(values):
    """One number where all are the same, else a list."""
    return float(values[0]) if (values == values[0]).all() else values.tolist()


def _spectrograph(plane, fiber_type):
    if plane.spectrograph.ndim == 1:
        return plane.spectrograph
    column = np.array([plane.fiber_types.index(t) if t else 0 for t in fiber_type])
    return plane.spectrograph[np.arange(len(plane)), column]


@cache
def versions() -> dict:
    """Return the versions of what makes the numbers."""
    found = {"python": sys.version.split()[0]}
    for name in ("rfpsurvey", "astropy", "numpy", "numba", "scipy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found


def _same_table(a, b) -> bool:
    """Compare tables; one that is not there, as in ECSV, is like any other."""
    return a is None or b is None or (a.colnames == b.colnames and all(_same(a[name], b[name]) for name in a.colnames))


def _same(a, b) -> bool:
    if getattr(a, "unit", None) != getattr(b, "unit", None):
        return False
    if not np.array_equal(np.ma.getmaskarray(np.ma.asarray(a)), np.ma.getmaskarray(np.ma.asarray(b))):
        return False
    if isinstance(a, MaskedColumn):
        return bool(np.array_equal(a.filled(), b.filled()))
    a, b = np.asarray(getattr(a, "value", a)), np.asarray(getattr(b, "value", b))
    return bool(np.array_equal(a, b, equal_nan=a.dtype.kind == "f"))
