"""Read the center and the orientation of a field from a table, and describe them in the provenance of a tile."""

import astropy.units as u
import numpy as np
from astropy.coordinates import FK5, SkyCoord

from rfpsurvey._units import to_plain
from rfpsurvey.catalog import to_time
from rfpsurvey.errors import InputError, warn

# names under which planners store the center and the orientation of a field, in columns or in the meta of a table
FIELD = {
    "ra": ("racen", "field_racen", "field_ra", "tile_ra", "tilera"),
    "dec": ("deccen", "field_deccen", "field_dec", "tile_dec", "tiledec"),
    "position angle": ("position_angle", "field_pa", "pa", "posang"),
}
# the names of the same values in the provenance of tiles that this package made
OWN = {"ra": "ra_deg", "dec": "dec_deg", "position angle": "position_angle_deg"}


def north_of_date(center: SkyCoord, equinox: str | None) -> SkyCoord:
    """Return a field center in the frame of an equinox; the north of this frame defines position angles.

    If ``equinox`` is None, the center is returned unchanged.
    """
    return center if equinox is None else center.transform_to(FK5(equinox=to_time(equinox, "equinox", one=True)))


def warn_of_north(form: str, *, is_given: bool) -> None:
    """Warn that SDSS-V measures position angles from the north of date, if its files do not state the north."""
    if form.startswith("SDSS-V") and not is_given:
        warn(
            "the position angle is measured from the north of ICRS, because the file does not state the north; SDSS-V "
            "uses the north of date: give equinox= (or --set equinox=J2026), or a center in FK5 of this equinox"
        )


def field_center(table) -> SkyCoord:
    """Return the field center that the columns or the meta of a table contain."""
    return SkyCoord(field_value(table, "ra") * u.deg, field_value(table, "dec") * u.deg)


def _degrees(value, name: str) -> np.ndarray:
    """Return angles in degrees; numbers without a unit are in degrees."""
    try:
        angles = u.Quantity(to_plain(value).astype(float), getattr(value, "unit", None) or u.deg).to_value(u.deg)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} of the field must be an angle, got {value!r}: {error}") from None
    if not np.isfinite(angles).all() or (np.abs(angles) > 90 if "dec" in name else np.abs(angles) > 360).any():
        raise InputError(
            f"{name} of the field must be an angle from -360 to 360 deg (declinations: from -90 to 90 deg), got {value}"
        )
    return angles


def field_value(table, what: str) -> float:
    """Return a value that describes the field, such as a position angle, from a column or the meta of a table."""
    lower = {c.lower(): c for c in table.colnames}
    meta = {str(k).lower(): v for k, v in table.meta.items()}
    for name in FIELD[what]:
        if name in lower:
            values = np.unique(_degrees(table[lower[name]], lower[name]))
            if len(values) > 1:
                raise InputError(
                    f"column {lower[name]!r} has {len(values)} values, so the table holds several fields: score one "
                    f"field at a time, for example with --select COLUMN=VALUE"
                )
            return float(values[0])
        if name in meta:
            return float(_degrees(meta[name], name))
    own = recorded_projection(table)
    if OWN[what] in own:
        return float(own[OWN[what]])
    option = "--position-angle" if what == "position angle" else "--center"
    raise InputError(
        f"the {what} of the field must be given ({option}), or be in a column or meta entry "
        f"{' or '.join(FIELD[what][:2])}"
    )


def recorded_projection(table) -> dict:
    """Return the meta of a table or, for a tile of this package, its parameters.

    The entries ``north_of``, ``projection`` and ``conditions`` describe how sky positions were projected.
    """
    provenance = table.meta.get("provenance")
    return provenance.get("parameters", {}) if isinstance(provenance, dict) else table.meta


def recorded_equinox(table) -> str | None:
    """Return the equinox whose north defines the position angle in a table; None stands for the north of ICRS."""
    north = recorded_projection(table).get("north_of", "icrs")
    if north == "icrs":
        return None
    frame, _, equinox = str(north).partition(" ")
    if frame != "fk5" or not equinox:
        raise InputError(
            f"the position angle in the table must be measured from the north of icrs or fk5, got {north}; give center "
            "(in the frame whose north you use) and position_angle"
        )
    return equinox


def where(center: SkyCoord, position_angle: u.Quantity) -> dict:
    """Return the center and the orientation of a field in the form in which the provenance stores them."""
    icrs = center.icrs
    return {
        "ra_deg": float(icrs.ra.deg),
        "dec_deg": float(icrs.dec.deg),
        "position_angle_deg": float(u.Quantity(position_angle).to_value(u.deg)),
        "north_of": center.frame.name + (f" J{center.equinox.jyear:.3f}" if center.frame.name == "fk5" else ""),
    }
