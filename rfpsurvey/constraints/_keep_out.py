"""The constraint `KeepOut`: circles on the sky that no arm may cover."""

from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np

from rfpsurvey._units import to_lonlat
from rfpsurvey.constraints._constraint import Constraint
from rfpsurvey.constraints._field import ConstraintField
from rfpsurvey.errors import InputError, InputTypeError, check_keywords, short
from rfpsurvey.projection import FieldProjection
from rfpsurvey.region import Region

# Number of points on the rim of a circle on the sky, and factor by which the radius of the image is enlarged. The
# factor is larger than 1 because the image of the rim can be slightly farther from the center between two of these
# points.
N_RIM, MARGIN = 360, 1 + 1e-4


@check_keywords
@dataclass(frozen=True)
class KeepOut(Constraint):
    """Circles on the sky that no arm may cover, such as circles around bright stars.

    In each field, the circles that an arm can touch are obstacles. Allocators that avoid collisions also avoid these
    circles; with other allocators, an arm that covers a circle is counted as a collision. On the focal plane, an
    obstacle contains the whole image of its circle, even if the center of the circle is outside the field.

    Parameters
    ----------
    circles : Region or list of Region
        One or more circles, made by `Region.cap`.

    Raises
    ------
    InputError
        If there is no region, or if a region is not a circle.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> str(rs.KeepOut(rs.Region.parse("cap 95 23 0.5")))
    'keep_out 95.0 23.0 0.5'
    """

    circles: tuple[Region, ...] | list[Region] | Region

    name = "keep_out"
    uses_targets = False

    def __post_init__(self):
        circles = as_circles(self.circles)
        if not circles:
            raise InputError(f"keep_out must contain at least one circle, got {short(self.circles)}")
        object.__setattr__(self, "circles", circles)

    @classmethod
    def parse(cls, arguments: str) -> "KeepOut":
        """Make the constraint from text.

        Parameters
        ----------
        arguments : str
            Right ascension, declination (ICRS) and radius of each circle in deg, separated by spaces or commas.

        Returns
        -------
        KeepOut
            The constraint.

        Raises
        ------
        InputError
            If the text does not consist of three numbers per circle, or if a number is out of range.
        """
        words = arguments.replace(",", " ").split()
        if not words or len(words) % 3:
            raise InputError(f"keep_out must have the form 'keep_out RA DEC RADIUS' (deg), got {arguments!r}")
        try:
            return cls([Region.parse(" ".join(["cap", *words[k : k + 3]])) for k in range(0, len(words), 3)])
        except InputError as error:
            raise InputError(
                f"keep_out must have the form 'keep_out RA DEC RADIUS' (deg), got {arguments!r} ({error})"
            ) from None

    def __str__(self):
        return " ".join([self.name, *(circle_text(circle).removeprefix("cap ") for circle in self.circles)])

    def _refuse_focal_plane(self) -> None:
        raise InputError(
            f"keep_out can be used only with positions on the sky, got {len(self.circles)} circles; use "
            "plan_tile, or define obstacles of the focal plane"
        )

    @cached_property
    def _values(self) -> np.ndarray:
        """Unit vectors of the centers of the circles, and their radii in radians, shape (n, 4)."""
        return np.reshape([region.values for region in self.circles], (-1, 4))

    def obstacles(self, field: ConstraintField) -> np.ndarray:
        """Return the images of the circles that are close enough to the field that arms can touch them.

        Parameters
        ----------
        field : ConstraintField
            The field.

        Returns
        -------
        ndarray of float, shape (k, 3)
            Positions x and y of the centers, and radii, in mm.
        """
        circles, projection = self._values, field.projection
        arrays = field.instrument.focal_plane.arrays
        size = (np.hypot(*arrays.xy.T) + arrays.arm_reach).max() + arrays.separation
        # The arms at the edge extend slightly beyond the field.
        limit = circles[:, 3] + 1.1 * size / field.instrument.plate_scale.to_value(u.mm / u.rad)
        apart = np.arccos(np.clip(circles[:, :3] @ projection.basis[2], -1, 1))
        images = np.array([image_of_circle(projection, *circles[k]) for k in np.flatnonzero(apart <= limit)])
        images = images.reshape(-1, 3)
        # If a circle contains all directions that have an image, its rim has no image.
        images[np.isnan(images[:, 2]) & (apart < circles[:, 3])[apart <= limit]] = 0, 0, 2 * size
        return images[np.hypot(*images[:, :2].T) <= size + images[:, 2]]  # false if the circle has no image


def as_circles(keep_out: object) -> tuple[Region, ...]:
    """Convert one circle on the sky, a list of circles, or None to a tuple of circles."""
    regions = () if keep_out is None else (keep_out,) if isinstance(keep_out, Region) else keep_out
    what = "keep_out must be one or more circles made by Region.cap"
    if not isinstance(regions, list | tuple):
        raise InputTypeError(f"{what}, got {type(keep_out).__name__}")
    for region in regions:
        if not isinstance(region, Region):
            raise InputTypeError(f"{what}, got {type(region).__name__} in the list")
        if region.kind != "cap":
            raise InputError(f"{what}, got {region!r}")
    return tuple(regions)


def circle_text(region: Region) -> str:
    """Return a circle in the form ``cap RA DEC RADIUS`` (deg), with the numbers that were given or with all digits."""
    degrees = region.degrees
    if degrees is None:
        lon, lat = to_lonlat(region.values[:3])
        degrees = np.rad2deg([lon % (2 * np.pi), lat, region.values[3]]).tolist()
    return " ".join(["cap", *map(repr, degrees)])


def image_of_circle(
    projection: FieldProjection, x: float, y: float, z: float, radius_rad: float
) -> tuple[float, float, float]:
    """Return x, y and radius (mm) of a circle on the focal plane that contains the image of a circle on the sky.

    The image is not a circle if the plate scale varies across the field. The image can also depend on the fiber type;
    the returned circle contains the images for all fiber types. The center of the circle on the sky may be so far from
    the field that the center has no image, although a part of the circle has an image. The returned radius is NaN if no
    point of the rim has an image.
    """
    center = np.array([x, y, z])
    names = list(projection.distortion) if isinstance(projection.distortion, dict) else [None]
    east = np.cross(center, projection.basis[2])
    # If the circle is around the field center, ``east`` is zero. Any perpendicular direction can then replace it.
    east = east / np.linalg.norm(east) if np.linalg.norm(east) > 1e-9 else projection.basis[0]
    inward = np.cross(east, center)
    turn = np.linspace(0, 2 * np.pi, N_RIM, endpoint=False)[:, None]
    rim = np.cos(radius_rad) * center + np.sin(radius_rad) * (np.cos(turn) * inward + np.sin(turn) * east)
    rims = np.vstack([projection.project(rim, name) for name in names])
    middle = np.mean([projection.project(center[None], name)[0] for name in names], axis=0)
    if not np.isfinite(middle).all():
        # Extrapolate from the point of the rim nearest to the field center, with the scale at that point.
        step = 1e-4
        angles = np.array([[radius_rad], [radius_rad + step]])
        steps = np.cos(angles) * center + np.sin(angles) * inward
        nearest, beyond = projection.project(steps, names[0])
        middle = nearest - (beyond - nearest) * radius_rad / step
    apart = np.hypot(*(rims - middle).T)
    return *middle, np.max(apart[np.isfinite(apart)], initial=np.nan if np.isnan(apart).all() else 0.0) * MARGIN
