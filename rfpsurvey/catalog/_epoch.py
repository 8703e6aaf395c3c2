"""The epoch to which the targets of a plan are moved by their proper motions."""

import astropy.units as u
import numpy as np
from astropy.time import Time

from rfpsurvey.catalog._catalog import Catalog
from rfpsurvey.catalog._motion import moving
from rfpsurvey.catalog._time import to_time
from rfpsurvey.errors import warn


def choose_epoch(
    catalog: Catalog, epoch: object, times: Time | None, *, whole: bool = True
) -> tuple[object, str | None]:
    """Return the epoch to which the targets are moved, and a sentence that states their epoch.

    Parameters
    ----------
    catalog : Catalog
        The targets.
    epoch : Time, str, float or None
        Epoch that the user requested.
    times : Time or None
        Times of the observing conditions, one or several. Without a requested epoch, targets are moved to these times.
    whole : bool, optional
        Whether the catalog contains all targets; otherwise, the sentence does not state how far targets move.

    Returns
    -------
    Time, str, float or None
        The epoch; for several times, their midpoint; None if the targets are not moved.
    str or None
        The sentence; None if the targets have no proper motions, or only proper motions of 0.
    """
    asked = None if epoch is None else to_time(epoch, "epoch", one=True)
    if not catalog.has_proper_motion or (whole and not moving(catalog.coord).any()):
        if epoch is not None:
            warn("the epoch has no effect, because the targets have no proper motions")
        return epoch, None
    if epoch is None and times is not None and catalog.epoch is not None:
        times = times.reshape(-1)
        text = f"the targets are moved to {epoch_text(times)}, the time of the observing conditions"
        return times.min() + (times.max() - times.min()) / 2, text
    speed = np.nan_to_num(np.hypot(catalog.coord.icrs.pm_ra_cosdec, catalog.coord.icrs.pm_dec)).to(u.mas / u.yr)
    fastest = np.max(speed, initial=0 * u.mas / u.yr)
    if epoch is not None:
        text = f"the targets are moved to {epoch_text(asked)}, the requested epoch"
    else:
        own = "unknown" if catalog.epoch is None else epoch_text(catalog.epoch)
        text = f"the targets are at the epoch of the catalog ({own}), although they have proper motions"
        text += f" of up to {fastest:.4g}" if whole else ""
    if times is not None and asked is not None:
        moved = (fastest * np.max(np.abs((times.tdb - asked.tdb).to(u.yr)))).to(u.arcsec)
        distance = f" by up to {moved:.2g}" if whole else ""
        text += f"; they move{distance} until the time of the observing conditions, {epoch_text(times)}"
    elif times is not None:
        text += "; without an epoch of the catalog, they cannot be moved to the time of the observing conditions"
        warn(text)
    return epoch, text


def epoch_text(epoch: Time | None) -> str | None:
    """Return the epoch of the positions as text for the provenance."""
    if epoch is None:
        return None
    years = np.atleast_1d(epoch.jyear)
    low, high = float(years.min()), float(years.max())
    return f"J{low:.3f}" if low == high else f"J{low:.3f} to J{high:.3f}"
