"""The members of `Instrument` with the rules of its observatory, and with the cameras that rules refer to."""

import astropy.units as u
import numpy as np

from rfpsurvey.errors import InputError, check_choice, short
from rfpsurvey.instrument._entries import CAMERAS
from rfpsurvey.instrument._entries import RULES as SECTION

RULES = f"{SECTION}."
"""Beginning of the names of entries with rules; a result depends on them only if the rules are used."""


class WithRules:
    """The members that `Instrument` inherits, which return rules and cameras."""

    @property
    def cameras(self) -> dict[str, np.ndarray]:
        """Corners of the guide and focus cameras on the focal plane in mm, by the name of the camera."""
        found = {name.partition(".")[2]: one for name, one in self.values.items() if name.startswith(f"{CAMERAS}.")}
        return {name: np.array(one["value"]) * u.Unit(one.get("unit", "mm")).to(u.mm) for name, one in found.items()}

    def rules(self, name: str) -> tuple[str, ...]:
        """Return the rules that an observatory publishes for the plans of an instrument, as texts of constraints.

        Parameters
        ----------
        name : str
            Name of the rules, such as ``dark_monit``, a design mode of SDSS-V. The entries of ``values`` whose names
            begin with ``rules.dark_monit.`` contain the rules and their sources.

        Returns
        -------
        tuple of str
            The rules, which `AllocationOptions` and `score_tile` accept as ``constraints`` (:doc:`/rules`).

        Raises
        ------
        InputError
            If the instrument does not have rules of this name.

        Examples
        --------
        >>> import rfpsurvey as rs
        >>> rs.Instrument.preset("sdss_apo").rules("dark_rm")[:2]
        ('sky@BOSS=50', 'distribution sky 1 95 75 BOSS')
        """
        known = {key.split(".")[1] for key in self.values if key.startswith(RULES)}
        if not known:
            raise InputError(f"the instrument must have rules of the name {short(name)}, but {self.name} has no rules")
        prefix = f"{RULES}{check_choice(name, known, f'name of rules of {self.name}')}."
        found = [one["value"] for key, one in self.values.items() if key.startswith(prefix)]
        return tuple(text for value in found for text in ([value] if isinstance(value, str) else value))
