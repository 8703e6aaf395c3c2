"""Methods of `Instrument` for its projections, and for the margins, rules and cameras in its description."""

from dataclasses import replace
from functools import cached_property
from typing import Self

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._units import to_scalar
from rfpsurvey.errors import InputError, check_choice, short
from rfpsurvey.focal_plane import Margins
from rfpsurvey.instrument._entries import CAMERAS, select_entries, value_of
from rfpsurvey.instrument._entries import RULES as RULES_SECTION
from rfpsurvey.observing import ObservedField, ObservedPlane, ObservingConditions
from rfpsurvey.projection import FieldProjection, TangentPlane, field_basis

MARGINS, RULES = "margins.", f"{RULES_SECTION}."
"""Beginnings of the names of entries on which a result depends only if the margins or the rules are used."""


class Described:
    """The members that `Instrument` inherits: its projections, margins, rules and cameras."""

    @property
    def published_margins(self) -> Margins:
        """The margins in the description of the instrument, which `with_margins` uses; they may be 0."""
        return Margins(**{name: value_of(entry) for name, entry in select_entries(self.values, MARGINS).items()})

    def with_margins(self, **margins: u.Quantity | float | None) -> Self:
        """Return the instrument with margins, which plans keep from mechanical limits (:doc:`/margins`).

        Without arguments, the margins in the description of the instrument are used (``published_margins``). With
        arguments, only the given margins are used; margins of 0 remove the margins of the instrument.

        Parameters
        ----------
        **margins : Quantity or float, optional
            The fields of `Margins`: the lengths ``outer``, ``inner``, ``arms`` and ``broken``, and the factors
            ``broken_factor`` and ``hidden_factor``.

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
        given = {name: value for name, value in margins.items() if value is not None}
        used = Margins(**given) if given else self.published_margins
        if not given and not used:
            raise InputError(
                f"the description of the instrument must contain margins, got none for {self.name}; give margins such "
                "as outer=0.1 * u.mm (--set instrument.margins.outer=0.1)"
            )
        return self.use_margins(used)

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

    @property
    def cameras(self) -> dict[str, np.ndarray]:
        """Corners of the guide and focus cameras on the focal plane in mm, by the name of the camera."""
        entries = select_entries(self.values, f"{CAMERAS}.")
        return {name: np.array(v["value"]) * u.Unit(v.get("unit", "mm")).to(u.mm) for name, v in entries.items()}

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
        known = {key.partition(".")[0] for key in select_entries(self.values, RULES)}
        if not known:
            raise InputError(f"the instrument must have rules of the name {short(name)}, but {self.name} has no rules")
        check_choice(name, known, f"name of rules of {self.name}")
        values = [entry["value"] for entry in select_entries(self.values, f"{RULES}{name}.").values()]
        return tuple(text for value in values for text in ([value] if isinstance(value, str) else value))

    def projection(
        self,
        center: SkyCoord,
        position_angle: u.Quantity = 0 * u.deg,
        conditions: ObservingConditions | None = None,
    ) -> TangentPlane:
        """Return the projection of a field onto the focal plane.

        Parameters
        ----------
        center : SkyCoord
            Field center.
        position_angle : Quantity, optional
            Position angle of the +y axis of the focal plane, from north toward east.
        conditions : ObservingConditions, optional
            Observing conditions. If None, refraction and dispersion are neglected.

        Returns
        -------
        TangentPlane
            The projection; with conditions, an `~rfpsurvey.observing.ObservedPlane`.

        Raises
        ------
        InputError
            If the center is not one direction, if the position angle is not one angle, or if the field is not above the
            horizon.
        """
        to_scalar(position_angle, u.deg, "position_angle", low=-3600, high=3600)
        if conditions is None:
            return TangentPlane(center, self.plate_scale, position_angle, self.distortion)
        return ObservedPlane(center, self.plate_scale, position_angle, self.distortion, conditions, self.field_radius)

    def field_projection(
        self, ra: float, dec: float, angle: float, conditions: ObservingConditions | None = None
    ) -> FieldProjection | ObservedField:
        """Return the projection of a field for arrays without units.

        Parameters
        ----------
        ra, dec : float
            Right ascension and declination (ICRS) of the field center, in radians.
        angle : float
            Position angle of the +y axis of the focal plane, from ICRS north toward east, in radians.
        conditions : ObservingConditions, optional
            Observing conditions. If None, refraction and dispersion are neglected.

        Returns
        -------
        FieldProjection or ObservedField
            The projection; it equals ``projection(...).plain`` and is computed faster.

        Raises
        ------
        InputError
            If the field is not above the horizon.
        """
        basis = field_basis(ra, dec, angle)
        if conditions is None:
            return FieldProjection(basis, self._focal_length, self.distortion)
        return ObservedField(basis, self._focal_length, self.distortion, conditions, self.field_radius.to_value(u.rad))

    @cached_property
    def _focal_length(self) -> float:
        """Focal length in mm."""
        return self.plate_scale.to_value(u.mm / u.rad)
