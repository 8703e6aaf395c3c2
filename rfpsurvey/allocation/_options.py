"""The options of an allocation, which tiles, surveys, tilings and comparisons share."""

from collections.abc import Callable
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cached_property

import astropy.units as u
import numpy as np

from rfpsurvey._plugins import find_function, name_of
from rfpsurvey._units import to_scalar
from rfpsurvey.allocation._constraints import as_keep_out, as_required, brief, circle_text, recorded
from rfpsurvey.allocation._requirements import Requirement, as_requirements
from rfpsurvey.errors import (
    InputError,
    InputTypeError,
    InputUnitsError,
    check_choice,
    check_keywords,
    check_switch,
    refusal,
    short,
    warn,
)
from rfpsurvey.region import Region

__all__ = ["ALLOCATORS", "GROUP", "OBJECTIVES", "AllocationOptions", "as_options"]

SEPARATION = (
    "sky_separation, the least distance of sky positions from all targets, must be an angle on the sky such as "
    "10 * u.arcsec, or a length on the focal plane such as 0.5 * u.mm"
)
OBJECTIVES = ("priority", "count")
ALLOCATORS = ("balanced", "nearest", "lamost", "sdss", "optimal", "repair")
"""Built-in allocators."""
GROUP = "rfpsurvey.allocators"
"""Entry points by which packages add allocators."""
# Values of one option that a representation lists.
MOST_SHOWN = 20


@check_keywords
@dataclass(frozen=True)
class AllocationOptions:
    """How targets are assigned: the allocator, and what the plan of each tile must hold.

    Functions that take these as ``allocator`` also take a plain name or function, which stands for the options with
    that allocator and everything else as by default.

    Parameters
    ----------
    allocator : {"balanced", "nearest", "lamost", "sdss", "optimal", "repair"} or str or callable, optional
        ``balanced``: science targets in catalog order, each to the positioner in reach with the shortest queue, then
        the nearest, then the lowest row; one target of each queue, drawn uniformly, is observed. No priorities.
        ``nearest``: class after class, the closest pair of positioner and target first.
        ``lamost``: class after class from the top priority, every free positioner nominates its nearest
        unassigned target of the class until none nominates; a target nominated by several goes to the
        one with the fewest unassigned targets (of any class) in reach, then the nearest, then the lowest row. Then, for
        one requirement after the other, idle positioners take what is lacking, and after them those with
        the least important targets, which are released.
        ``sdss``: network flow: as many as possible class after class, arms may collide; then the least sum of squared
        distances from the centers. ``optimal``: as many as possible class after class such that no arm with a target
        collides with another arm or an obstacle, with a proof. Idle arms that are obstacles (parked equal-arm
        units with ``parked_obstacles``, disabled and stuck units) count as other arms; two idle arms that collide
        with each other, or an idle arm at an obstacle, are left as they are.
        ``repair``: the plan ``start``, its collisions removed by local moves. Another name is that
        of an allocator of an installed package; a function of an `~rfpsurvey.allocation.AllocationProblem` is taken as
        it is.
    requirements : list of Requirement or str, or "instrument", optional
        What the plan must hold, such as ``["sky=20/spectrograph", "standard=5/spectrograph"]``; ``"instrument"``: the
        requirements of the instrument. Minima come before science, are met as far as possible and reported where they
        are not. ``balanced`` and ``nearest`` only report.
    sky_separation : Quantity, optional
        Length on the focal plane, or an angle where an instrument is known: positions at least so far from all targets
        serve as sky too, also those that stuck positioners observe. They are sought where requirements on ``sky``
        ask for some.
    objective : {"priority", "count"}, optional
        ``priority``: class after class. ``count``: the number of science targets before the classes (``sdss``,
        ``optimal``).
    time_limit : Quantity, optional
        ``sdss`` and ``optimal`` then return the best plan so far, with its gap; 60 s by default. It holds for the
        search of ``start`` too.
    start : Allocation or str, optional
        For ``repair``, and allocators that ask for it: the plan to begin with, or the allocator that makes it (not
        ``repair``).
    parked_obstacles : bool, optional
        Whether idle equal-arm positioners are obstacles.
    required : array_like of int or str, optional
        Ids of targets that come before everything else, science targets or others. ``nearest`` and ``lamost`` assign
        them as a class before all classes, ``sdss`` and ``optimal`` as many as possible, ``repair`` as far as its moves
        find a place for them; ``balanced`` does not distinguish them. Those without a fiber are reported. `allocate`
        takes rows of targets in their place.
    keep_out : Region or list of Region, optional
        Circles made by `Region.cap` that no arm may cover, such as the light of bright stars. In each field, those
        that an arm can touch are obstacles: ``optimal`` and ``repair`` avoid them, for other allocators the arms that
        cover them are counted. On the focal plane, an obstacle holds the whole image of its circle, also where the
        center of the circle is outside the field.

    Raises
    ------
    InputError
        If a name is unknown, a requirement has another form, a number is impossible, or ``keep_out`` is no circle.

    References
    ----------
    Chen et al. (2024), "General Methods for Evaluating Collision Probability of Different Types of Theta-phi
    Positioners", arXiv:2409.07288, Section 4.2 (balanced, lamost). Blanton et al. 2003, AJ 125, 2276 (network flow).

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> rs.AllocationOptions("optimal", requirements="sky=20/spectrograph").requirements
    (Requirement('sky=20/spectrograph'),)
    >>> rs.AllocationOptions(required=["star 7"], keep_out=rs.Region.parse("cap 95 23 0.5")).record["keep_out"]
    ['cap 95.0 23.0 0.5']
    """

    allocator: str | Callable = "lamost"
    requirements: tuple[Requirement, ...] | list | str | Requirement | None = ()
    sky_separation: u.Quantity | None = None
    objective: str = "priority"
    time_limit: u.Quantity = field(default=60 * u.s)
    start: object = "lamost"
    parked_obstacles: bool = True
    required: np.ndarray | list | tuple | int | str | None = ()
    keep_out: tuple[Region, ...] | list[Region] | Region | None = ()

    def __post_init__(self):
        check_allocator(self.allocator)
        if not hasattr(self.start, "target_of_positioner"):
            if not isinstance(self.start, str):
                raise refusal("start must be an Allocation or the name of an allocator", self.start, str)
            check_allocator(self.start, [name for name in ALLOCATORS if name != "repair"], "allocator to start with")
        check_choice(self.objective, OBJECTIVES, "objective")
        to_scalar(self.time_limit, u.s, "time_limit", low=0)
        if self.sky_separation is not None:
            if not isinstance(self.sky_separation, u.Quantity):
                raise InputTypeError(f"{SEPARATION}, got {short(self.sky_separation)} without a unit")
            if not (_is_angle(self.sky_separation) or self.sky_separation.unit.is_equivalent(u.mm)):
                raise InputUnitsError(f"{SEPARATION}, got {short(self.sky_separation)}")
            unit = self.sky_separation.unit if _is_angle(self.sky_separation) else u.mm
            to_scalar(self.sky_separation, unit, "sky_separation", low=0)
        if not self._of_instrument:
            object.__setattr__(self, "requirements", as_requirements(self.requirements))
        object.__setattr__(self, "parked_obstacles", check_switch(self.parked_obstacles, "parked_obstacles"))
        object.__setattr__(self, "required", as_required(self.required))
        object.__setattr__(self, "keep_out", as_keep_out(self.keep_out))

    def __repr__(self):
        given = {f.name: getattr(self, f.name) for f in fields(self)[1:]}
        usual = {f.name: f.default if f.default_factory is MISSING else f.default_factory() for f in fields(self)[1:]}
        changed = [f"{name}={_shown(value)}" for name, value in given.items() if value != usual[name]]
        return f"AllocationOptions({', '.join([repr(self.name), *changed])})"

    @property
    def _of_instrument(self) -> bool:
        return isinstance(self.requirements, str) and self.requirements == "instrument"

    def check_for_fields(self, what: str) -> None:
        """Refuse options that can only hold for one field.

        Parameters
        ----------
        what : str
            What is planned, for the error.

        Raises
        ------
        InputError
            If ``start`` is an allocation.
        """
        if not isinstance(self.start, str):
            raise InputError(f"start must be the name of an allocator for {what}, got an allocation of one field")

    @property
    def name(self) -> str:
        """Name of the allocator."""
        return name_of(self.allocator)

    @cached_property
    def circles(self) -> np.ndarray:
        """Unit vectors of the centers of ``keep_out`` and radii in radians, shape (n, 4)."""
        return np.reshape([region.values for region in self.keep_out], (-1, 4))

    @cached_property
    def seconds(self) -> float:
        """The time limit in seconds."""
        return float(self.time_limit.to_value(u.s))

    def for_instrument(self, instrument: object) -> "AllocationOptions":
        """Return the options with the requirements of an instrument, lengths in place of angles, and unused ones reset.

        Parameters
        ----------
        instrument : Instrument or None
            The instrument; None where only a focal plane is known.

        Returns
        -------
        AllocationOptions
            What `allocate` takes, and a result records.

        Raises
        ------
        InputError
            If requirements of the instrument, an angle, identifiers or circles on the sky are asked for and no
            instrument is given.
        """
        requirements, separation = self.requirements, self.sky_separation
        if instrument is None and (self._of_instrument or _is_angle(separation)):
            given = "requirements='instrument'" if self._of_instrument else f"sky_separation={separation}"
            raise InputError(f"{given} needs an instrument, as plan_tile has; allocate takes lengths and requirements")
        if instrument is None and self.required:
            raise InputError(
                f"ids of required targets need a catalog, as plan_tile has, got {brief(self.required)}; allocate takes "
                "rows of targets as its own required="
            )
        if instrument is None and self.keep_out:
            raise InputError(
                f"keep_out needs a sky, as plan_tile has, got {len(self.keep_out)} circles; allocate takes obstacles "
                "of the focal plane"
            )
        if self._of_instrument:
            requirements = as_requirements(instrument.requirements)
        if separation is not None and not _asks_for_sky(requirements):
            text = "sky_separation changes nothing: no requirement asks for sky, such as 'sky=20/spectrograph'"
            warn(text)
            separation = None
        elif separation is not None and _is_angle(separation):
            separation = (separation * instrument.plate_scale).to(u.mm)
        built_in = self.name in ALLOCATORS
        unused = {}
        if built_in and self.allocator not in ("sdss", "optimal", "repair"):  # which may begin with one of these
            unused["time_limit"] = 60 * u.s
        if built_in and self.allocator != "repair":
            unused["start"] = AllocationOptions.start
        return replace(self, requirements=requirements, sky_separation=separation, **unused)

    @property
    def record(self) -> dict:
        """The options as text and numbers that a file can hold."""
        separation, unit = self.sky_separation, "arcsec" if _is_angle(self.sky_separation) else "mm"
        requirements = self.requirements
        return {
            "allocator": self.name,
            "requirements": requirements if self._of_instrument else [str(one) for one in requirements],
            f"sky_separation_{unit}": None if separation is None else float(separation.to_value(unit)),
            "objective": self.objective,
            "time_limit_s": self.seconds,
            "start": self.start if isinstance(self.start, str) else "an allocation",
            "parked_obstacles": self.parked_obstacles,
            "required": recorded([str(name) for name in self.required]),
            "keep_out": recorded([circle_text(region) for region in self.keep_out]),
        }


def as_options(given: object) -> AllocationOptions:
    """Return options from themselves, or from an allocator alone."""
    return given if isinstance(given, AllocationOptions) else AllocationOptions(given)


def check_allocator(given: object, known=ALLOCATORS, what: str = "allocator") -> None:
    """Refuse what is neither a built-in allocator, nor one of a package, nor a function."""
    if not (isinstance(given, str) and given in known):
        find_function(GROUP, given, known, what)


def _shown(value: object) -> str:
    """Return the text of a value; of many values, the first ones."""
    return f"({brief(value)})" if isinstance(value, tuple) and len(value) > MOST_SHOWN else repr(value)


def _asks_for_sky(requirements) -> bool:
    return any(one.what == "sky" and one.minimum for one in requirements)


def _is_angle(value) -> bool:
    return isinstance(value, u.Quantity) and value.unit.is_equivalent(u.rad)
