"""The class `Region`: a circle, a box, a polygon or a set of HEALPix pixels on the sky."""

from dataclasses import dataclass, field, replace
from numbers import Number

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord

from rfpsurvey._common.descriptions import to_html
from rfpsurvey._common.read_tables import parse_number
from rfpsurvey._common.small_figures import BLUE, LIGHT, around, dots, points_in_cap
from rfpsurvey._common.units import ByValue, to_center, to_plain, to_scalar, to_vectors
from rfpsurvey._sky import shapes as _healpix
from rfpsurvey._sky import shapes as _shapes
from rfpsurvey._sky.shapes import circle_around, is_inside
from rfpsurvey.errors import INCONVERTIBLE, InputError, check_choice, refusal

FORMS = {
    "cap": "cap RA DEC RADIUS",
    "box": "box RA1 RA2 DEC1 DEC2",
    "polygon": "polygon RA DEC RA DEC RA DEC ...",
    "sky": "sky",
}


@dataclass(frozen=True, eq=False)
class Region(ByValue):
    """A region of the sky, as returned by ``cap``, ``box``, ``polygon``, ``healpix``, ``whole_sky`` or ``parse``.

    Parameters
    ----------
    kind : {"cap", "box", "polygon", "healpix"}
        Kind of the region.
    values : ndarray
        Values that define the region; angles are in radians, directions are in ICRS. Cap: unit vector of the center,
        and the radius. Box: western limit of right ascension, width in right ascension, lower and upper declination.
        Polygon: unit vectors of the vertices, shape (n, 3). HEALPix: pixel numbers in the nested order.
    nside : int, optional
        HEALPix resolution parameter; 0 for other kinds of regions.
    degrees : tuple of float, optional
        Of a cap: right ascension and declination (ICRS) and radius in degrees, as given; otherwise, they are computed.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> import rfpsurvey as rs
    >>> spring = rs.Region.box(ra=(350 * u.deg, 10 * u.deg), dec=(0 * u.deg, 30 * u.deg))
    >>> spring.area.round(3)
    <Quantity 572.958 deg2>
    >>> spring.contains(SkyCoord([0, 20] * u.deg, [5, 5] * u.deg))
    array([ True, False])
    """

    kind: str
    values: np.ndarray
    nside: int = 0
    degrees: tuple[float, ...] | None = field(default=None, compare=False)

    @classmethod
    def cap(cls, center: SkyCoord | str, radius: u.Quantity) -> "Region":
        """Make a circular region.

        Parameters
        ----------
        center : SkyCoord or str
            Center of the circle; a str has the same format as the ``center`` of `plan_tile`.
        radius : Quantity
            Angular radius of the circle, at most 180 deg.

        Returns
        -------
        Region
            The circle.

        Raises
        ------
        InputError
            If ``center`` is not a single direction, or if ``radius`` is out of range.
        """
        radius_deg = to_scalar(radius, u.deg, "radius", low=0, high=180.000001)
        direction = to_center(center)
        values = np.append(to_vectors(direction)[0], min(np.deg2rad(radius_deg), np.pi))
        given = (direction.ra.deg, direction.dec.deg, radius_deg) if direction.frame.name == "icrs" else None
        return cls("cap", values, degrees=given and tuple(map(float, given)))

    @classmethod
    def box(cls, ra: tuple[u.Quantity, u.Quantity], dec: tuple[u.Quantity, u.Quantity]) -> "Region":
        """Make a region between two meridians and two parallels.

        Parameters
        ----------
        ra : tuple of Quantity
            Western and eastern limit of right ascension. If the western limit is larger than the eastern limit, the box
            contains RA = 0. If the limits differ by 360 deg, the box contains all right ascensions.
        dec : tuple of Quantity
            Lower and upper limit of declination.

        Returns
        -------
        Region
            The box, in ICRS.

        Raises
        ------
        InputError
            If ``ra`` or ``dec`` does not have two values, if a value is out of range, if the two right ascensions are
            equal, or if the declinations are not in ascending order.
        """
        first, last = _two(ra, "ra", -360, 720)
        low, high = _two(dec, "dec", -90, 90)
        if not low < high:
            raise InputError(f"dec must be (lower, upper), got ({low:g}, {high:g}) deg")
        width = last - first
        width = 360.0 if abs(width) == 360 else width % 360
        if width == 0 or abs(last - first) > 360:
            raise InputError(
                f"ra must be two different angles that are at most 360 deg apart, got ({first:g}, {last:g}) deg"
            )
        return cls("box", np.deg2rad([first % 360, width, low, high]))

    @classmethod
    def polygon(cls, vertices: SkyCoord) -> "Region":
        """Make a polygon with great-circle edges; the polygon need not be convex.

        The edges divide the sky into two parts; the smaller part is the region.

        Parameters
        ----------
        vertices : SkyCoord, shape (n,)
            At least three vertices, clockwise or counter-clockwise.

        Returns
        -------
        Region
            The polygon.

        Raises
        ------
        InputError
            If there are fewer than three vertices, if two consecutive vertices are equal or opposite, if edges cross or
            touch each other, or if all vertices lie on one great circle.
        """
        vectors = to_vectors(vertices, "vertices")
        if len(vectors) > 1 and np.array_equal(vectors[0], vectors[-1]):
            vectors = vectors[:-1]
        if len(vectors) < 3:
            raise InputError(f"a polygon must have at least 3 vertices, got {len(vectors)}")
        if not np.isfinite(vectors).all():
            raise InputError("the vertices of a polygon must be finite")
        length = _shapes.angle(vectors, np.roll(vectors, -1, axis=0))
        bad = np.flatnonzero((length < 1e-10) | (length > np.pi - 1e-10))
        if len(bad):
            what = "the same" if length[bad[0]] < 1 else "opposite"
            raise InputError(f"vertices {bad[0] + 1} and {(bad[0] + 1) % len(vectors) + 1} of the polygon are {what}")
        crossing = _shapes.edges_cross(vectors)
        if crossing is not None:
            raise InputError(f"edges {crossing[0] + 1} and {crossing[1] + 1} of the polygon cross or touch each other")
        if not _shapes.polygon_area(vectors) > 0:
            raise InputError("the vertices of a polygon must not all lie on one great circle")
        return cls("polygon", vectors)

    @classmethod
    def healpix(cls, pixels: np.ndarray, nside: int, order: str = "nested") -> "Region":
        """Make a region from HEALPix pixels.

        Parameters
        ----------
        pixels : array_like of int
            Numbers of the HEALPix pixels; the coordinate frame of the pixels is ICRS.
        nside : int
            HEALPix resolution parameter, a power of two.
        order : {"nested", "ring"}, optional
            Order of the pixel numbers.

        Returns
        -------
        Region
            The union of the pixels.

        Raises
        ------
        InputError
            If ``pixels`` is empty, or if a pixel number does not exist for this ``nside``.
        """
        nside = _healpix.check_nside(nside)
        check_choice(order, ("nested", "ring"), "order of pixels")
        numbers = to_plain(pixels, "pixels", "whole numbers")
        if numbers.size == 0 or numbers.dtype.kind not in "iu":
            raise refusal("pixels must contain one or more whole numbers", pixels, Number, list, np.ndarray)
        numbers = np.unique(numbers)
        if numbers[0] < 0 or numbers[-1] >= 12 * nside**2:
            raise InputError(
                f"pixels must be from 0 to {12 * nside**2 - 1} for nside {nside}, got {numbers[0]} to {numbers[-1]}"
            )
        numbers = numbers.astype(np.int64)
        return cls("healpix", np.sort(_healpix.to_nested(nside, numbers)) if order == "ring" else numbers, nside)

    @classmethod
    def whole_sky(cls) -> "Region":
        """Make a region that contains the whole sky.

        Returns
        -------
        Region
            The whole sky.
        """
        return cls("cap", np.array([0.0, 0.0, 1.0, np.pi]))

    @classmethod
    def parse(cls, text: str) -> "Region":
        """Make a region from a text that contains the kind of the region, followed by angles in degrees (ICRS).

        Parameters
        ----------
        text : str
            ``cap RA DEC RADIUS``, ``box RA1 RA2 DEC1 DEC2``, ``polygon RA DEC RA DEC RA DEC ...`` or ``sky``.

        Returns
        -------
        Region
            The region.

        Raises
        ------
        InputError
            If the text does not have one of these forms.

        Examples
        --------
        >>> import rfpsurvey as rs
        >>> rs.Region.parse("cap 95 23 8")
        <Region cap of 200.7 deg2>
        """
        kind, *words = str(text).replace(",", " ").split() or [""]
        check_choice(kind, FORMS, "kind of region")
        try:
            numbers = [parse_number(word) for word in words] * u.deg
        except ValueError:
            numbers = None
        wanted = {"cap": len(words) == 3, "box": len(words) == 4, "sky": not words}
        if numbers is None or not wanted.get(kind, len(words) % 2 == 0):
            raise InputError(f"a region must have the form '{FORMS[kind]}' (deg), got {text!r}")
        if kind == "sky":
            return cls.whole_sky()
        if kind == "box":
            return cls.box(ra=(numbers[0], numbers[1]), dec=(numbers[2], numbers[3]))
        lat = numbers[1::2] if kind == "polygon" else numbers[1:2]
        if not (np.abs(lat.value) <= 90).all():
            raise InputError(f"declinations must lie between -90 and 90 deg, got {text!r}")
        if kind == "cap":
            return replace(cls.cap(SkyCoord(numbers[0], numbers[1]), numbers[2]), degrees=tuple(numbers.value.tolist()))
        return cls.polygon(SkyCoord(numbers[::2], lat))

    @property
    def area(self) -> u.Quantity:
        """Solid angle of the region."""
        if self.kind == "cap":
            size = 4 * np.pi * np.sin(self.values[3] / 2) ** 2
        elif self.kind == "healpix":
            size = len(self.values) * np.pi / (3 * self.nside**2)
        else:
            size = {"box": _shapes.box_area, "polygon": _shapes.polygon_area}[self.kind](self.values)
        return (size * u.sr).to(u.deg**2)

    def contains(self, coord: SkyCoord) -> np.ndarray:
        """Return whether directions are inside the region.

        Parameters
        ----------
        coord : SkyCoord, shape (n,)
            Directions; a scalar is one direction.

        Returns
        -------
        ndarray of bool, shape (n,)
            Whether each direction is inside the region. The borders of caps and boxes are inside.

        Raises
        ------
        InputError
            If ``coord`` is not a SkyCoord.
        """
        return is_inside(self, to_vectors(coord))

    def _repr_html_(self) -> str:
        center, radius = circle_around(self)
        points = points_in_cap(center, radius, 4000)
        inside = is_inside(self, points)
        outside = {} if inside.all() else {"points outside": (LIGHT, ~inside)}
        figure = dots(around(points, center), outside | {"points inside": (BLUE, inside)})
        return to_html(self, {"kind": self.kind, "area": f"{self.area:.6g}"}, figure=figure)

    def __repr__(self):
        return f"<Region {self.kind} of {self.area.value:.4g} deg2>"


def _two(values, name, low, high):
    """Convert two angles to degrees, and check their range."""
    try:
        first, last = values
    except INCONVERTIBLE:
        raise refusal(f"{name} must be two angles", values, list, tuple) from None
    angles = [float(to_scalar(value, u.deg, name, low=low - 1e-9, high=high + 1e-9)) for value in (first, last)]
    return [min(max(value, low), high) for value in angles]
