"""Command-line options that set the observing conditions."""

from pathlib import Path
from typing import Annotated

import astropy.units as u
import typer

import rfpsurvey as rs
from rfpsurvey.catalog import to_moment
from rfpsurvey.observing import SITES, location

__all__ = [
    "ConditionsOption",
    "ExposureOption",
    "HourAngleOption",
    "ProjectionOption",
    "SiteOption",
    "TilesHourAngleOption",
    "TilesTimeOption",
    "TimeOption",
    "WavelengthOption",
    "conditions_of",
    "tiles_under",
]

ConditionsOption = Annotated[
    Path | None,
    typer.Option(
        help="TOML file with observing conditions: site, time or hour_angle, wavelength, guide_wavelength, pressure, "
        "temperature, humidity, exposure_time, tolerance. Options such as --site override the values in the file."
    ),
]
SiteOption = Annotated[
    str | None,
    typer.Option(
        help="Site of the telescope: apache point, kitt peak, las campanas, mauna kea, paranal, xinglong, or "
        "LONGITUDE,LATITUDE,HEIGHT (deg, deg, m). Without a site, refraction is neglected."
    ),
]
TimeOption = Annotated[
    str | None, typer.Option(help="Midpoint of the exposure (UTC), such as 2026-07-01T06:30:00. Also give --site.")
]
HourAngleOption = Annotated[
    float | None, typer.Option(help="Hour angle of the field center (hours, positive in the west), in place of --time.")
]
TilesTimeOption = Annotated[
    str | None,
    typer.Option(
        help="Midpoint of the exposure (UTC) for all tiles, such as 2026-07-01T06:30:00. If the table of tiles has "
        "a column time or hour_angle, the values of this column are used instead."
    ),
]
TilesHourAngleOption = Annotated[
    float | None,
    typer.Option(
        help="Hour angle of all tiles (hours), in place of --time. If the table of tiles has a column time or "
        "hour_angle, the values of this column are used instead. A column hour_angle without a unit is in hours."
    ),
]
WavelengthOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Wavelength for which the positions of fibers are computed (micrometers); for fibers of one type, "
        "TYPE=WAVELENGTH, such as BOSS=0.54."
    ),
]
ExposureOption = Annotated[float | None, typer.Option(help="Exposure time (s).")]
ProjectionOption = Annotated[
    str | None,
    typer.Option(
        help="Model of the projection onto the focal plane: tangent, radial, refraction, dispersion, full, "
        "or auto, which selects the fastest model that is accurate enough. The default is full if observing "
        "conditions are given, and radial otherwise."
    ),
]


def conditions_of(
    path: Path | None,
    site: str | None,
    time: str | None,
    hour_angle: float | None,
    wavelength: list[str] | None,
    exposure_time: float | None,
) -> "rs.ObservingConditions | None":
    """Return observing conditions from a file and from options, which override the file; None if neither is given."""
    given = {}
    if site is not None:
        given["site"] = site if "," not in site else location(site.split(","))
    if time is not None:
        given["time"] = to_moment(time, "--time")
    if hour_angle is not None:
        given["hour_angle"] = hour_angle * u.hourangle
    if wavelength:
        given["wavelength"] = _wavelengths(wavelength)
    if exposure_time is not None:
        given["exposure_time"] = exposure_time * u.s
    if path is not None:
        return rs.ObservingConditions.read(path, **given)
    if not given:
        return None
    if "site" not in given:
        raise rs.InputError(
            f"--site must be given to compute refraction: LONGITUDE,LATITUDE,HEIGHT or {', '.join(SITES)}"
        )
    return rs.ObservingConditions(**given)


def tiles_under(
    tiling: "rs.Tiling",
    path: Path | None,
    site: str | None,
    time: str | None,
    hour_angle: float | None,
    wavelength: list[str] | None,
    exposure_time: float | None,
) -> "rs.Tiling":
    """Add the observing conditions from a file or from options, if any are given, to a tiling; return the tiling."""
    given = any(value is not None for value in (path, site, time, hour_angle, exposure_time)) or wavelength
    if given and time is None and hour_angle is None and rs.tiling.when_of(tiling.table) is not None:
        hour_angle = 0.0  # a placeholder, which the time or hour angle in the table of tiles replaces
    seen = conditions_of(path, site, time, hour_angle, wavelength, exposure_time)
    return tiling if seen is None else tiling.with_conditions(seen)


def _wavelengths(texts: list[str]):
    """Convert the texts of --wavelength to one wavelength, or to a dict with a wavelength for each fiber type."""
    try:
        if len(texts) == 1 and "=" not in texts[0]:
            return float(texts[0]) * u.um
        pairs = [text.split("=") for text in texts]
        return {kind: float(value) * u.um for kind, value in pairs}
    except ValueError:
        raise rs.InputError(f"--wavelength must be WAVELENGTH, or TYPE=WAVELENGTH, got {' '.join(texts)}") from None
