"""Positions of assigned rows: projected from the sky, or read from columns with positions on the focal plane."""

import warnings

import astropy.units as u
import numpy as np
from astropy.table import Table

from rfpsurvey._units import to_center, to_direction
from rfpsurvey.catalog import Catalog, Finder, choose_epoch, epoch_text, read_columns
from rfpsurvey.errors import RfpsurveyWarning, warn_no_effect
from rfpsurvey.instrument import choose_projection
from rfpsurvey.observing import ObservingConditions
from rfpsurvey.tile._field import (
    field_center,
    field_value,
    north_of_date,
    recorded_equinox,
    recorded_projection,
    warn_of_north,
    where,
)
from rfpsurvey.tile._recorded import on_focal_plane, sky_deg_of, warn_of_neglected


def project_rows(find, instrument, fibers, columns, units, *, center, position_angle, equinox, epoch, conditions):
    """Project the sky positions of assigned rows; the parameters are those of `score_tile`.

    The returned tuple contains the positions on the focal plane and on the sky (NaN for rows without coordinates), the
    projection, a sentence on the epoch, and the parameters to record.
    """
    part = find.table
    warn_of_neglected(part, sky=True)
    form = find.format.name if find.format else "SDSS-V" if part.meta.get("format") == "confsummary" else ""
    north = center is not None or position_angle is not None or equinox is not None or "north_of" in part.meta
    warn_of_north(form, is_given=north)
    recorded, model = recorded_projection(part), None
    if conditions is None:
        model = recorded.get("projection")
        if recorded.get("conditions") is not None:
            conditions = ObservingConditions.from_record(recorded["conditions"])
    catalog, there = _catalog(part, columns, units)
    of_catalog = part.meta.get("format") == "confsummary" and find.name_of("ra") == "ra"
    if epoch is None and of_catalog and catalog.epoch is not None:
        epoch = part.meta.get("epoch")
    used, moved = choose_epoch(catalog, epoch, None)
    catalog = catalog if used is None else catalog.at_epoch(used)
    if center is None:
        is_recorded = equinox is None and position_angle is None
        center = north_of_date(field_center(part), recorded_equinox(part) if is_recorded else equinox)
    center = to_center(center)
    if position_angle is None:
        position_angle = field_value(part, "position angle") * u.deg
    plain, chosen = choose_projection(instrument, instrument.projection(center, position_angle), conditions, model)
    icrs, xy, sky_deg = catalog.coord.icrs, np.full((len(part), 2), np.nan), np.full((2, len(part)), np.nan)
    xy[there] = plain.project(catalog.arrays.vectors, fibers[there])
    sky_deg[:, there] = icrs.ra.deg, icrs.dec.deg
    parameters = {**where(center, position_angle), "epoch": epoch_text(catalog.epoch)}
    if conditions is not None:
        parameters["conditions"] = conditions.record
    if conditions is not None or chosen["model"] != "radial":
        parameters["projection"] = chosen["model"]
    return xy, sky_deg, plain, moved, parameters


def read_positions(find: Finder, xy_names: list, who: np.ndarray, n: int, given: dict) -> tuple:
    """Return the same as `project_rows`, with the positions on the focal plane that the table contains.

    ``given`` contains parameters of `project_rows`, which must be None, because they have no effect.
    """
    warn_of_neglected(find.table, sky=False)
    if None in xy_names:
        raise find.missing("x and y")
    for unused in (name for name, value in given.items() if value is not None):
        remedy = "to use positions on the sky, give positions='sky' (or --positions sky)"
        warn_no_effect(unused, f"because the table has positions on the focal plane; {remedy}")
    return on_focal_plane(find, xy_names, n, who)[who], sky_deg_of(find), None, None, {}


def _catalog(part: Table, columns: dict, units: dict | None) -> tuple[Catalog, np.ndarray]:
    """Return the assigned rows with finite coordinates as a catalog, and the numbers of these rows."""
    # added sky positions have no priority, which a score does not use
    found = read_columns(part, columns, units, "icrs", {"priority": 0.0}, None, assume_units=False)
    place = to_direction(found["coord"]).data
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*have no finite coordinates", RfpsurveyWarning)  # `_placed` names the rows
        catalog = Catalog(**found)
    return catalog, np.flatnonzero(np.isfinite(place.lon.value) & np.isfinite(place.lat.value))
