"""Observing conditions from the keys of a command, and the time at which the states of positioners are evaluated."""

import astropy.units as u
from astropy.time import Time

import rfpsurvey as rs
from rfpsurvey.catalog import to_time
from rfpsurvey.observing import SITES, location
from rfpsurvey.tiling import times_of_tiles

__all__ = ["conditions_of", "tiles_under", "time_of", "time_of_tiles"]


def conditions_of(given: dict) -> "rs.ObservingConditions | None":
    """Return the observing conditions for their keys, which replace the values of a file; None if there are no keys."""
    given = dict(given)
    if isinstance(site := given.get("site"), list) or "," in str(site):
        given["site"] = location(site if isinstance(site, list) else site.split(","))
    path = given.pop("path", None)
    if path is not None:
        return rs.ObservingConditions.read(path, **given)
    if given and "site" not in given:
        raise rs.InputError(
            f"conditions.site must be given to compute refraction: [LONGITUDE, LATITUDE, HEIGHT] or {', '.join(SITES)}"
        )
    return rs.ObservingConditions(**given) if given else None


def tiles_under(tiling: "rs.Tiling", given: dict) -> "rs.Tiling":
    """Add the observing conditions for their keys, if any are given, to a tiling; return the tiling."""
    if given and not {"time", "hour_angle"} & set(given) and rs.tiling.when_of(tiling.table) is not None:
        given = {**given, "hour_angle": 0 * u.hourangle}  # the time or hour angle in the table of tiles replaces it
    conditions = conditions_of(given)
    return tiling if conditions is None else tiling.with_conditions(conditions)


def time_of(conditions: "rs.ObservingConditions | None", epoch: object) -> Time | None:
    """Return the time of the observing conditions or, without such a time, the epoch; None if no time is known."""
    if conditions is not None and conditions.time is not None:
        return conditions.time
    return None if epoch is None else to_time(epoch, "epoch")


def time_of_tiles(tiling: "rs.Tiling | None", epoch: object, given: dict) -> Time | None:
    """Return the times of all tiles or, without times, the time of the epoch; None if no time is known."""
    if tiling is None:
        return time_of(conditions_of(given), epoch)
    times = times_of_tiles(tiles_under(tiling, given))
    return time_of(None, epoch) if times is None else times
