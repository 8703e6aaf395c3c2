"""Comparison of models of the projection of an instrument, to find the cheapest model that is accurate enough."""

from dataclasses import dataclass, replace
from functools import lru_cache

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable

from rfpsurvey._common.units import to_center, to_scalar, to_unit
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.instrument import Instrument, as_instrument
from rfpsurvey._sky.conditions import MODELS, ObservingConditions, as_hour_angle, check_conditions
from rfpsurvey._sky.models import check_model, choose_model, displacements, field_of_model, not_included
from rfpsurvey._sky.observed_field import ObservedField
from rfpsurvey._sky.projection import FieldProjection, TangentPlane
from rfpsurvey._sky.wavelengths import observed_light, warn_outside_band
from rfpsurvey.errors import InputError, check_keywords, listed

# Numbers of points for which displacements are computed: centers of positioners, and points at the edge of the field.
N_CENTERS, N_EDGE = 240, 90
# Factor by which points without an image on the sky are moved toward the field center until they have one.
SHRINK = 0.998
ROUNDING = 1e-9 * u.mm


@dataclass(frozen=True, eq=False)
class ProjectionComparison:
    """Displacements of targets on the focal plane that models of the projection neglect.

    Parameters
    ----------
    table : QTable
        Table with a row for each model, from the cheapest to the most complete. Columns: ``model``, ``neglects`` (the
        effect that this model neglects and the next model includes), ``median``, ``p95`` and ``max`` (displacements of
        targets on the focal plane relative to the full model), ``max_on_sky`` (the largest displacement as an angle),
        and ``sufficient`` (whether ``max`` is at most the tolerance).
    tolerance : Quantity or None
        Largest negligible position error on the focal plane; None if it is unknown.
    drift : Quantity
        Largest distance between a target and its mean position during the exposure. No model of the projection can
        remove this distance.
    not_included : tuple of str
        Effects that no model includes, because the conditions do not contain the necessary data.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> conditions = rs.ObservingConditions("kitt peak", hour_angle=3 * u.hourangle)
    >>> rs.instrument.compare_projections("desi", "10h +32d", conditions).sufficient
    'refraction'
    """

    table: QTable
    tolerance: u.Quantity | None
    drift: u.Quantity
    not_included: tuple[str, ...] = ()

    @property
    def sufficient(self) -> str | None:
        """Name of the cheapest model that is accurate enough; None if the tolerance is unknown.

        Errors caused by the effects in ``not_included`` can exceed the tolerance.
        """
        if self.tolerance is None:
            return None
        return str(self.table["model"][np.flatnonzero(self.table["sufficient"])[0]])

    def __str__(self):
        """Return a sentence on the displacements of targets and the cheapest model that is accurate enough."""
        radial = self.table[list(MODELS).index("radial")]
        what = "refraction moves" if "dispersion" in " ".join(self.not_included) else "refraction and dispersion move"
        moved = f"{what} targets by up to {radial['max']:.3g} ({radial['max_on_sky']:.2g})"
        if self.drift > 0 * u.mm:
            moved += f", and by up to {self.drift:.2g} during the exposure"
        if self.tolerance is None:
            model, larger = "the tolerance is unknown", ""
        else:
            model = f"the cheapest model within the tolerance of {self.tolerance:.3g} is {self.sufficient}"
            larger = ", and possibly larger than the tolerance"
        missing = f"; not included{larger}: {listed(self.not_included)}" if self.not_included else ""
        return f"{moved}; {model}{missing}"

    @property
    def record(self) -> dict:
        """The comparison as plain numbers and text, for the records of results."""
        return {
            "sufficient": self.sufficient,
            "sentence": str(self),
            "not_included": list(self.not_included),
            "tolerance_mm": None if self.tolerance is None else self.tolerance.to_value(u.mm),
            "drift_mm": round(float(self.drift.to_value(u.mm)), 6),
            "displacement_mm": {
                str(row["model"]): {
                    name: round(float(row[name].to_value(u.mm)), 6) for name in ("median", "p95", "max")
                }
                for row in self.table
            },
        }


@check_keywords
def compare_projections(
    instrument: Instrument | str,
    center: SkyCoord | str,
    conditions: ObservingConditions,
    *,
    position_angle: u.Quantity = 0 * u.deg,
    hour_angles: u.Quantity | None = None,
    tolerance: u.Quantity | None = None,
) -> ProjectionComparison:
    """Compare models of the projection of a field, and name the cheapest model that is accurate enough.

    From the cheapest (fastest) to the most complete, the models are ``tangent`` (tangent plane), ``radial`` (radial
    map), ``refraction`` (adds refraction at the midpoint of the exposure, at the guide wavelength), ``dispersion``
    (adds the wavelength of each fiber type) and ``full`` (adds the mean over the exposure). A model is accurate enough
    if the position of each target differs by at most the tolerance from its position in the model ``full``.

    Parameters
    ----------
    instrument : Instrument or str
        Instrument, name of a preset, or path of a TOML file.
    center : SkyCoord or str
        Field center.
    conditions : ObservingConditions
        The observing conditions.
    position_angle : Quantity, optional
        Position angle of the +y axis of the focal plane, from north toward east.
    hour_angles : Quantity, optional
        Hour angles of the field center, which replace the time or hour angle of the conditions. The result then
        includes the displacements at all of these hour angles.
    tolerance : Quantity, optional
        Largest negligible position error on the focal plane. By default, the tolerance of the conditions or, if they
        have none, a tenth of the diameter of the instrument's fibers.

    Returns
    -------
    ProjectionComparison
        Table of the models, with the name of the cheapest model that is accurate enough.

    Raises
    ------
    InputError
        If the field is not above the horizon, or if a value is not valid.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> conditions = rs.ObservingConditions("xinglong", hour_angle=0 * u.deg)
    >>> hours = [-2, 0, 2] * u.hourangle
    >>> result = rs.instrument.compare_projections("lamost", "6h20m +23d", conditions, hour_angles=hours)
    >>> result.sufficient
    'refraction'
    """
    instrument = as_instrument(instrument)
    check_conditions(conditions)
    if tolerance is not None:
        to_scalar(tolerance, u.mm, "tolerance", low=0)
    plane = instrument.projection(to_center(center), position_angle)
    cases = [conditions]
    if hour_angles is not None:
        angles = to_unit(as_hour_angle(hour_angles), u.deg, "hour_angles")
        if angles.size == 0 or angles.ndim > 1:
            raise InputError(f"hour_angles must be at least one angle, shape (n,), got the shape {angles.shape}")
        cases = [conditions.at_hour_angle(angle * u.deg) for angle in np.atleast_1d(angles)]
    return _compare(instrument, plane, cases, tolerance)


def choose_projection(
    instrument: Instrument, plane: TangentPlane, conditions: ObservingConditions | None, model: str | None
) -> tuple[FieldProjection | ObservedField, dict]:
    """Return the projection of a field by a model, and a record of the errors of each model.

    By default, the model is that of the conditions; ``auto`` is the fastest model that is accurate enough.
    """
    check_conditions(conditions, optional=True)
    check_model(model, conditions)
    if conditions is None:
        model = "radial" if model in (None, "auto") else model
        return field_of_model(model, plane.plain.basis, instrument.optics), {"model": model}
    conditions = conditions if model is None else replace(conditions, projection=model)
    warn_outside_band(instrument.light, conditions)
    choice = choose_model(instrument.optics, plane.plain.basis, conditions)
    field = field_of_model(choice.model, plane.plain.basis, instrument.optics, conditions)
    return field, {"model": choice.model, **choice.record}


def _compare(instrument, plane, cases, tolerance=None) -> ProjectionComparison:
    """Compare the models of the projection for one or several observing conditions."""
    if tolerance is None:
        tolerance = cases[0].tolerance
    if tolerance is None and instrument.optics.tolerance is not None:
        tolerance = instrument.optics.tolerance * u.mm
    light = observed_light(instrument.light, cases[0])
    by_type = isinstance(instrument.distortion, dict) or (isinstance(light.fibers, dict) and not light.compensated)
    kinds = instrument.focal_plane.fiber_types if by_type else [None]
    points, n_spread = _points(instrument, plane.plain, kinds, cases[0].scale)
    moved, drift = zip(
        *(displacements(points, kinds, plane.plain.basis, instrument.optics, case) for case in cases), strict=True
    )
    moved = {name: np.concatenate([displacement[name] for displacement in moved]) * u.mm for name in MODELS}
    # models without the neglected effect differ from the model ``full`` only by rounding errors, which become 0
    moved = {name: np.where(values <= ROUNDING, 0 * u.mm, values) for name, values in moved.items()}
    drift = np.max(drift) * u.mm
    largest = u.Quantity([np.max(values) for values in moved.values()])
    table = QTable(
        {
            "model": list(MODELS),
            "neglects": ["radial map", "refraction", "dispersion", "changes of refraction during the exposure", ""],
            "median": u.Quantity([np.median(values[:, :n_spread]) for values in moved.values()]),
            "p95": u.Quantity([np.percentile(values[:, :n_spread], 95) for values in moved.values()]),
            "max": largest,
            "max_on_sky": (largest / instrument.plate_scale).to(u.arcsec),
            "sufficient": np.zeros(len(MODELS), dtype=bool) if tolerance is None else largest <= tolerance,
        }
    )
    for name in ("median", "p95", "max", "max_on_sky"):
        table[name].info.format = ".3g"
    return ProjectionComparison(table, tolerance, drift, not_included(instrument.light, cases[0]))


def _points(instrument, static: FieldProjection, kinds, scale: float) -> tuple[np.ndarray, int]:
    """Return points (mm) for each fiber type, shape (m, n, 2), and how many of them are centers of positioners.

    The other points are on the boundary of the convex hull of all patrol areas, where displacements are largest.
    """
    arrays = instrument.focal_plane.arrays
    order = np.argsort(np.hypot(*arrays.xy.T), kind="stable")
    rows = np.unique(np.linspace(0, len(order) - 1, N_CENTERS).round().astype(int))
    points = np.array([np.vstack([arrays.xy[order[rows]], _edge(instrument.focal_plane)])] * len(kinds))
    for xy, kind in zip(points, kinds, strict=True):
        # the radial map of the fiber type can end inside the patrol areas
        while (beyond := np.isnan(static.unproject(xy / scale, kind)).any(axis=1)).any():
            xy[beyond] *= SHRINK
    return points, len(rows)


@lru_cache(maxsize=4)
def _edge(plane: FocalPlane) -> np.ndarray:
    """Return points (mm) on the boundary of the convex hull of all patrol areas, in equally spaced directions."""
    arrays, turn = plane.arrays, 2 * np.pi * np.arange(N_EDGE) / N_EDGE
    normals = np.column_stack([np.cos(turn), np.sin(turn)])
    distance = sum(np.multiply.outer(*axis) for axis in zip(normals.T, arrays.xy.T, strict=True))
    row = np.argmax(distance + arrays.largest_radius, axis=1)
    return arrays.xy[row] + arrays.largest_radius[row, None] * normals
