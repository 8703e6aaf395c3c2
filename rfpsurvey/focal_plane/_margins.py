"""Margins: distances that plans keep from the edges of patrol areas, between arms, and from broken positioners."""

from collections.abc import Callable
from dataclasses import dataclass

import astropy.units as u
import numpy as np

from rfpsurvey._settings import Settings, option, options_of
from rfpsurvey.errors import InputError, InputTypeError, check_choice, check_keywords, listed, short

LENGTH = {"low": 0, "below": 1e6, "sparse": True}


@check_keywords
@dataclass(frozen=True, eq=False)
class Margins(Settings):
    """Distances that plans keep from mechanical limits and from broken positioners.

    A positioner is broken if it is disabled or stuck. All margins except ``arms`` state which targets a positioner may
    have in a plan. They do not change the minimum separation, the poses that a positioner can reach, or the collisions
    of given poses. ``arms`` increases the clearance of all arms and therefore also changes their collisions.

    Parameters
    ----------
    outer : Quantity, optional
        Smallest distance of a target from the outer edge of the patrol area. The edges are the two radii, including
        limits of phi that shorten a whole edge. Targets at this distance are in reach.
    inner : Quantity, optional
        Smallest distance of a target from the inner edge of the patrol area or, if the inner radius is 0, from the
        center. Targets at this distance are in reach.
    arms : Quantity, optional
        Length that is added to the clearance d of each arm. The minimum separation increases by twice this length.
    broken : Quantity, optional
        Length by which the distance of a planned arm from the arm of a broken positioner must exceed the minimum
        separation.
    broken_factor : float, optional
        Radius of a circle around the center of each broken positioner that contains no targets, as a fraction of the
        outer radius of the patrol area of this positioner; by default 0.
    hidden_factor : float, optional
        Factor, at least 1, by which the radii of the circles in which no target can be observed (``hidden``) are
        multiplied.

    Raises
    ------
    InputError
        If a length or a factor is out of range or has the wrong unit.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> margins = rs.Margins(outer=0.2 * u.mm, inner=0.1 * u.mm)
    >>> print(margins)
    outer 0.2 mm, inner 0.1 mm
    >>> robot = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    >>> plane = rs.FocalPlane([[0, 0]] * u.mm, robot, margins=margins)
    >>> plane.multiplicity([[16.3, 0], [16.4, 0]] * u.mm)
    array([1, 0])
    """

    outer: u.Quantity[u.mm] = option(0 * u.mm, **LENGTH, text="{:g} mm from the outer edges of patrol areas")
    inner: u.Quantity[u.mm] = option(0 * u.mm, **LENGTH, text="{:g} mm from the inner edges of patrol areas")
    arms: u.Quantity[u.mm] = option(0 * u.mm, **LENGTH, text="{:g} mm around each arm")
    broken: u.Quantity[u.mm] = option(
        0 * u.mm, **LENGTH, text="{:g} mm more than the minimum separation from arms of broken positioners"
    )
    broken_factor: float = option(
        0.0,
        low=0,
        below=1e6,
        sparse=True,
        to_record=float,
        text="{:g} patrol radii from the centers of broken positioners",
    )
    hidden_factor: float = option(
        1.0, low=1, below=1e6, sparse=True, to_record=float, text="{:g} times the radii of hidden circles"
    )

    _what = "the margin {}"

    @classmethod
    def from_numbers(cls, numbers: dict[str, float]) -> "Margins":
        """Return margins for numbers by name.

        Parameters
        ----------
        numbers : dict of str to float
            Names and values of margins; lengths are in mm.

        Returns
        -------
        Margins
            The margins.

        Raises
        ------
        InputError
            If a name is unknown, or if a value is not a number or is out of range.
        """
        if not isinstance(numbers, dict):
            raise InputTypeError(f"margins must be numbers by name, got {short(numbers)}")
        known = {field.name: field for field in options_of(cls)}
        for name in numbers:
            check_choice(name, known, "margin")
        return cls(**{name: known[name].restored(value) for name, value in numbers.items()})

    @property
    def numbers(self) -> dict[str, float]:
        """All margins by name, lengths in mm."""
        return {field.name: float(field.plain(getattr(self, field.name))) for field in options_of(Margins)}

    def __bool__(self):
        return bool(self.record)

    def __str__(self):
        return self._texts(lambda f, number: f"{f.name} {number:g}{f' {f.units[0]}' if f.units else ''}")

    @property
    def description(self) -> str:
        """The margins that have an effect as text for readers who do not know their names."""
        return self._texts(lambda f, number: f.option.text.format(number))

    def _texts(self, text: Callable) -> str:
        """Return the texts of the margins that have an effect; ``text`` makes a text of an option and its value."""
        known = [field for field in options_of(Margins) if not field.is_default(self)]
        return listed(text(field, self.numbers[field.name]) for field in known)


def check_margins(plane) -> None:
    """Check the margins of a focal plane; each usable positioner must keep a part of its patrol area."""
    margins = plane.margins
    if margins is None:
        object.__setattr__(plane, "margins", Margins())
        return
    if not isinstance(margins, Margins):
        raise InputTypeError(f"margins must be Margins, got {short(margins)}")
    if margins.outer > 0 or margins.inner > 0:
        inner, outer = plane.arrays.edges
        empty = np.flatnonzero((inner > outer) & plane.arrays.usable)
        for k in empty:
            raise InputError(
                f"the margins outer and inner must leave a part of the patrol area of each usable positioner; the area "
                f"of positioner {plane.id[k]} is from {plane.arrays.inner_radius[k]:.4g} to "
                f"{plane.arrays.outer_radius[k]:.4g} mm, got {margins}; {len(empty)} positioners have no "
                "area left; use smaller margins or disable these positioners"
            )
