"""Methods of `Instrument` that set the margins of its focal plane."""

from dataclasses import replace
from typing import Self

import astropy.units as u

from rfpsurvey.errors import InputError
from rfpsurvey.focal_plane import Margins

PREFIX = "margins."
"""Beginning of the names of entries with published margins; a result depends on them only if the margins are used."""


class WithMargins:
    """Methods that `Instrument` inherits, which list and set margins."""

    @property
    def published_margins(self) -> Margins:
        """The margins in the description of the instrument, which `with_margins` uses; they may be 0."""
        found = {name.removeprefix(PREFIX): v for name, v in self.values.items() if name.startswith(PREFIX)}
        return Margins(
            **{name: v["value"] * u.Unit(v["unit"]) if "unit" in v else v["value"] for name, v in found.items()}
        )

    def with_margins(
        self,
        *,
        outer: u.Quantity | None = None,
        inner: u.Quantity | None = None,
        arms: u.Quantity | None = None,
        broken: u.Quantity | None = None,
        broken_factor: float | None = None,
        hidden_factor: float | None = None,
    ) -> Self:
        """Return the instrument with margins, which plans keep from mechanical limits (:doc:`/margins`).

        Without arguments, the margins in the description of the instrument are used (``published_margins``). With
        arguments, only the given margins are used; margins of 0 remove the margins of the instrument.

        Parameters
        ----------
        outer, inner, arms, broken : Quantity, optional
            Lengths; see `Margins`.
        broken_factor, hidden_factor : float, optional
            Factors; see `Margins`.

        Returns
        -------
        Instrument
            The instrument with these margins.

        Raises
        ------
        InputError
            If no arguments are given and the description of the instrument contains no margins, or if a margin is out
            of range.

        Examples
        --------
        >>> import astropy.units as u
        >>> import rfpsurvey as rs
        >>> desi = rs.Instrument.preset("desi")
        >>> desi.with_margins().focal_plane.margins.record
        {'outer_mm': 0.2, 'inner_mm': 0.1, 'arms_mm': 0.05}
        >>> desi.with_margins(outer=0.3 * u.mm).focal_plane.margins.record
        {'outer_mm': 0.3}
        """
        given = {
            "outer": outer,
            "inner": inner,
            "arms": arms,
            "broken": broken,
            "broken_factor": broken_factor,
            "hidden_factor": hidden_factor,
        }
        given = {name: value for name, value in given.items() if value is not None}
        margins = Margins(**given) if given else self.published_margins
        if not given and not margins:
            raise InputError(
                f"the description of the instrument must contain margins, got none for {self.name}; give margins such "
                "as outer=0.1 * u.mm (--set instrument.margins.outer=0.1)"
            )
        return self.use_margins(margins)

    def use_margins(self, margins: Margins) -> Self:
        """Return the instrument with the given margins.

        Parameters
        ----------
        margins : Margins
            The margins.

        Returns
        -------
        Instrument
            The instrument with these margins.
        """
        return replace(self, focal_plane=replace(self.focal_plane, margins=margins))
