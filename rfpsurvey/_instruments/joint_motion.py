"""Ranges and speeds of the joints of positioners, on which paths of the arms depend, but not static plans."""

from dataclasses import dataclass
from functools import partial

import astropy.units as u

from rfpsurvey._common.settings import Checked, option
from rfpsurvey._common.units import ByValue
from rfpsurvey._instruments.positioner import check_ranges, two_angles
from rfpsurvey.errors import check_keywords


@check_keywords
@dataclass(frozen=True, eq=False)
class JointMotion(Checked, ByValue):
    """Mechanical ranges and speeds of the joints theta and phi, on which only paths of the arms depend.

    Unlike the joint limits of a `~rfpsurvey.Positioner`, the ranges are not modulo 360 deg: a path from 350 deg to
    10 deg turns by 340 deg if the range of theta is 0 to 360 deg. They do not change the patrol areas. Joint limits of
    a `~rfpsurvey.Positioner`, or of single positioners of an instrument as built, take precedence.

    Parameters
    ----------
    theta_range : Quantity, shape (2,), optional
        Lowest and highest angle of theta. By default, there are no stops.
    phi_range : Quantity, shape (2,), optional
        Lowest and highest angle of phi, which is 0 for extended and 180 deg for folded arms. For arms with an
        ``arm_angle``, this is the range of phi plus ``arm_angle``, the direction of the axis of the eccentric arm. By
        default, there are no stops.
    theta_speed, phi_speed : Quantity, optional
        Largest angular speeds of theta and phi, above 0. By default, the speeds are not known.

    Raises
    ------
    InputError
        If a range is not two finite angles with the lower angle first, or if a speed is not above 0.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> motion = rs.Instrument.preset("sdss_apo").motion
    >>> motion.phi_range, motion.phi_speed
    (<Quantity [  0., 180.] deg>, <Quantity 11.71875 deg / s>)
    """

    theta_range: u.Quantity | None = option(None, convert=partial(two_angles, name="theta_range"))
    phi_range: u.Quantity | None = option(None, convert=partial(two_angles, name="phi_range"))
    theta_speed: u.Quantity[u.deg / u.s] | None = option(None, above=0, below=1e6)
    phi_speed: u.Quantity[u.deg / u.s] | None = option(None, above=0, below=1e6)

    def _check(self) -> None:
        check_ranges(self)
