"""Margins: distances that plans keep from the edges of patrol areas, between arms, and from broken positioners."""

from dataclasses import dataclass, field, fields

import astropy.units as u
import numpy as np

from rfpsurvey._units import to_scalar
from rfpsurvey.errors import InputError, InputTypeError, check_choice, check_keywords, refusal, short

LENGTHS = ("outer", "inner", "arms", "broken")
"""Names of the margins that are lengths."""
FACTORS = ("broken_factor", "hidden_factor")
"""Names of the margins that are factors."""
WORDS = {
    "outer": "{:g} mm from the outer edges of patrol areas",
    "inner": "{:g} mm from the inner edges of patrol areas",
    "arms": "{:g} mm around each arm",
    "broken": "{:g} mm more than the minimum separation from arms of broken positioners",
    "broken_factor": "{:g} patrol radii from the centers of broken positioners",
    "hidden_factor": "{:g} times the radii of hidden circles",
}


@check_keywords
@dataclass(frozen=True)
class Margins:
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

    outer: u.Quantity[u.mm] = field(default=0 * u.mm)
    inner: u.Quantity[u.mm] = field(default=0 * u.mm)
    arms: u.Quantity[u.mm] = field(default=0 * u.mm)
    broken: u.Quantity[u.mm] = field(default=0 * u.mm)
    broken_factor: float = 0.0
    hidden_factor: float = 1.0

    def __post_init__(self):
        for name in LENGTHS:
            to_scalar(getattr(self, name), u.mm, f"the margin {name}", low=0, high=1e6, closed=True)
        for name, low in (("broken_factor", 0), ("hidden_factor", 1)):
            value = getattr(self, name)
            if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value < 1e6:
                raise refusal(f"the margin {name} must be a number of at least {low}", value, int, float)

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
        for name, value in numbers.items():
            check_choice(name, (*LENGTHS, *FACTORS), "margin")
            if not isinstance(value, int | float) or isinstance(value, bool):
                raise InputTypeError(f"the margin {name} must be a number, got {short(value)}")
        return cls(**{name: v * u.mm if name in LENGTHS else v for name, v in numbers.items()})

    @property
    def numbers(self) -> dict[str, float]:
        """All margins by name, lengths in mm."""
        lengths = {name: float(getattr(self, name).to_value(u.mm)) for name in LENGTHS}
        return lengths | {name: float(getattr(self, name)) for name in FACTORS}

    @property
    def record(self) -> dict[str, float]:
        """The margins that have an effect, by name with the unit, such as ``outer_mm``."""
        usual = {f.name: f.default for f in fields(self) if f.name in FACTORS}
        units = dict.fromkeys(LENGTHS, "_mm")
        return {name + units.get(name, ""): v for name, v in self.numbers.items() if v != usual.get(name, 0.0)}

    def __bool__(self):
        return bool(self.record)

    def __str__(self):
        units = dict.fromkeys(LENGTHS, " mm")
        numbers = {name.removesuffix("_mm"): value for name, value in self.record.items()}
        return ", ".join(f"{name} {value:g}{units.get(name, '')}" for name, value in numbers.items()) or "none"

    @property
    def description(self) -> str:
        """The margins that have an effect as text for readers who do not know their names."""
        return ", ".join(WORDS[name.removesuffix("_mm")].format(value) for name, value in self.record.items()) or "none"


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
        if len(empty):
            k = empty[0]
            raise InputError(
                f"the margins outer and inner must leave a part of the patrol area of each usable positioner; the area "
                f"of positioner {plane.id[k]} is from {plane.arrays.inner_radius[k]:.4g} to "
                f"{plane.arrays.outer_radius[k]:.4g} mm, got {margins}; {len(empty)} positioners have no "
                "area left; use smaller margins or disable these positioners"
            )
