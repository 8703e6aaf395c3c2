"""The method of `Instrument` that returns the rules of its observatory."""

from rfpsurvey.errors import InputError, check_choice, short
from rfpsurvey.instrument._entries import RULES as SECTION

RULES = f"{SECTION}."
"""Beginning of the names of entries with rules; a result depends on them only if the rules are used."""


class WithRules:
    """The method that `Instrument` inherits, which returns rules."""

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
