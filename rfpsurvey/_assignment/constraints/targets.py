"""The constraints `KeepOut` (circles on the sky that no arm may cover) and `Required` (targets with precedence)."""

import shlex
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np

from rfpsurvey._assignment.constraints.constraint import Constraint
from rfpsurvey._assignment.constraints.field import FAIL, PASS, ConstraintField, Verdict
from rfpsurvey._common.units import to_labels, to_lonlat, to_plain
from rfpsurvey._sky.projection import FieldProjection
from rfpsurvey._sky.region import Region
from rfpsurvey.errors import InputError, InputTypeError, brief, check_keywords, short

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


@check_keywords
@dataclass(frozen=True)
class Required(Constraint):
    """Targets, of any kind, that take precedence over all other targets.

    ``nearest`` and ``lamost_rule`` assign required targets as a class before all other classes; ``network_flow`` and
    ``optimal`` assign as many of them as possible; ``repair`` assigns the required targets for which its local moves
    find a positioner; ``balanced`` does not use this constraint. Required targets without a fiber are reported.

    Parameters
    ----------
    ids : array_like of int or str
        Identifiers of the targets.

    Raises
    ------
    InputError
        If there are no identifiers, or if they are neither integers nor text.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> str(rs.Required(["star 7", "star 8"]))
    "required 'star 7' 'star 8'"
    """

    ids: tuple[int, ...] | tuple[str, ...] | list | np.ndarray | int | str

    name = "required"
    uses_targets = False

    def __post_init__(self):
        ids = as_required(self.ids)
        if not ids:
            raise InputError(f"required targets must have at least one identifier, got {short(self.ids)}")
        object.__setattr__(self, "ids", ids)

    @classmethod
    def parse(cls, arguments: str) -> "Required":
        """Make the constraint from text.

        Parameters
        ----------
        arguments : str
            Identifiers, separated by spaces; quotes surround identifiers that contain spaces.

        Returns
        -------
        Required
            The constraint.

        Raises
        ------
        InputError
            If the text contains no identifier, or if a quote is not closed.
        """
        try:
            names = shlex.split(arguments)
        except ValueError as error:
            raise InputError(f"required must have the form 'required ID ...', got {arguments!r}: {error}") from None
        if not names:
            raise InputError(f"required must have the form 'required ID ...', got {arguments!r}")
        return cls(names)

    def __str__(self):
        return " ".join([self.name, *(shlex.quote(str(name)) for name in self.ids)])

    @property
    def required_ids(self) -> tuple:
        """Identifiers of targets that take precedence over all other targets."""
        return self.ids

    def _refuse_focal_plane(self) -> None:
        raise InputError(
            f"ids of required targets can be used only with a catalog, got {brief(self.ids)}; use "
            "plan_tile, or pass rows of targets as the argument required of allocate"
        )

    def check(self, field: ConstraintField, has_fiber: np.ndarray, n_covering: int) -> list[str]:
        """Return a sentence on the required targets outside the field.

        Parameters
        ----------
        field : ConstraintField
            The field.
        has_fiber : ndarray of bool
            Whether each target of the field has a fiber.
        n_covering : int
            Number of arms that cover obstacles of the constraint.

        Returns
        -------
        list of str
            The sentence; an empty list if all required targets are in the field.
        """
        there = are_among(self.ids, field.id[field.is_available]).tolist()
        outside = tuple(name for name, is_there in zip(self.ids, there, strict=True) if not is_there)
        where = "outside the field" if field.is_complete else "without a fiber"
        return [f"required targets {where}: {brief(outside)}"] if outside else []

    def verdict(self, field: ConstraintField, has_fiber: np.ndarray, n_covering: int) -> Verdict:
        """Return the verdict on a finished plan, which fails unless all required targets have a fiber.

        Parameters
        ----------
        field : ConstraintField
            The field.
        has_fiber : ndarray of bool
            Whether each target of the field has a fiber.
        n_covering : int
            Number of arms that cover obstacles of the constraint.

        Returns
        -------
        Verdict
            The verdict, with the number of required targets without a fiber.
        """
        given = ~field.is_added
        observed = are_among(self.ids, field.id[given & has_fiber])
        observed &= ~are_among(self.ids, field.id[given & field.is_available & ~has_fiber])  # ids can be repeated
        without = tuple(name for name, is_observed in zip(self.ids, observed.tolist(), strict=True) if not is_observed)
        note = f"without a fiber: {brief(without)}" if without else ""
        return Verdict(str(self), len(without), "no target without a fiber", FAIL if without else PASS, note)


def as_required(required: object) -> tuple[int, ...] | tuple[str, ...]:
    """Return the distinct identifiers of required targets in the given order; all are integers or all are text."""
    given = np.atleast_1d(to_plain([] if required is None else required, "required", "ids of targets"))
    if given.size == 0:
        return ()
    names = to_labels(given, "required")
    if given.dtype.kind == "b":
        raise InputTypeError("required must contain ids of targets (integers or text), got booleans")
    if names.ndim != 1:
        raise InputError(f"required must be a one-dimensional list of target ids, got the shape {names.shape}")
    if "" in names.tolist():
        raise InputError("required must contain ids of targets that are not empty, got ''")
    return tuple(dict.fromkeys(names.tolist()))


def mark_required(required: tuple, parts: Iterable[np.ndarray]) -> np.ndarray | None:
    """Return whether each target of a catalog is required, or None if no targets are required.

    The catalog may consist of several parts; ``parts`` contains an array with the identifiers of each part.
    """
    if not required:
        return None
    marked, known = [], np.zeros(len(required), dtype=bool)
    names = np.array(required)
    for ids in parts:
        wanted, comparable = _alike(names, ids)
        marked.append(np.isin(ids, wanted[comparable]))
        known |= comparable & np.isin(wanted, ids[marked[-1]])
    if not known.all():
        strange = names[~known]
        raise InputError(
            f"required must hold ids of the catalog, got {strange[0]} ({len(strange)} of {len(names)} unknown)"
        )
    return np.concatenate(marked)


def are_among(required: tuple, ids: np.ndarray) -> np.ndarray:
    """Return whether each required identifier is one of ``ids``."""
    wanted, comparable = _alike(np.array(required), ids)
    return comparable & np.isin(wanted, ids)


def _alike(names: np.ndarray, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return names with the type of ``ids`` (integers or text), and a mask of the names that can be converted."""
    if names.dtype.kind == ids.dtype.kind:
        return names, np.ones(len(names), dtype=bool)
    if ids.dtype.kind == "U":
        return names.astype(str), np.ones(len(names), dtype=bool)
    # Names from the command line are text, but identifiers of a catalog can be integers.
    numbers = np.zeros(len(names), dtype=np.int64)
    comparable = np.zeros(len(names), dtype=bool)
    for k, name in enumerate(names.tolist()):
        try:
            numbers[k] = int(name)
        except (ValueError, OverflowError):
            continue
        comparable[k] = str(numbers[k]) == name
    return numbers, comparable
