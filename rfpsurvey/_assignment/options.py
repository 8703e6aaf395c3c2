"""The options of an allocation, which are the same for plans of tiles, surveys, tilings and comparisons."""

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import astropy.units as u
import numpy as np

from rfpsurvey._assignment.before_and_after import is_plan
from rfpsurvey._assignment.constraints.constraint import Constraint
from rfpsurvey._assignment.constraints.motion import law_of
from rfpsurvey._assignment.constraints.requirement import Requirement, as_requirements, check_counts
from rfpsurvey._assignment.constraints.rules import Distribution
from rfpsurvey._assignment.constraints.targets import KeepOut, Required, as_circles, as_required, circle_text
from rfpsurvey._assignment.constraints.text import as_constraints, listed_in, recorded
from rfpsurvey._assignment.methods import DEFAULT_ALLOCATOR, METHODS, Allocator
from rfpsurvey._assignment.plugin import GROUP, find_allocator, find_improving, known_allocator
from rfpsurvey._assignment.rules import TIE_SEED, check_seed
from rfpsurvey._common.descriptions import describe_methods
from rfpsurvey._common.plugins import name_of, recorded_name
from rfpsurvey._common.settings import Settings, option
from rfpsurvey._sky.region import Region
from rfpsurvey.errors import InputError, check_keywords, refusal, warn_no_effect

SEPARATION = "an angle on the sky such as 10 * u.arcsec, or a length on the focal plane such as 0.5 * u.mm"
ONLY_SOME = ("objective", "time_limit", "start", "moves", "programs")
"""Options that have their default values in the record of a plan whose allocator does not use them."""
INSTRUMENT, PLAN = "instrument", "an allocation"


def _known_start(start: object) -> object:
    if is_plan(start):
        return start
    if not isinstance(start, str):
        raise refusal("start must be an Allocation, a Tile or the name of an allocator", start, str)
    find_allocator(start, what="allocator to start with", known={k: v for k, v in METHODS.items() if not v.improves})
    return start


def _recorded_start(name: str) -> str:
    if name == PLAN:
        raise InputError("start must be given as an argument of from_record, because a record does not contain plans")
    return name


def _as_requirements(given: object) -> tuple[Requirement, ...] | str:
    return given if isinstance(given, str) and given == INSTRUMENT else as_requirements(given)


def _texts(values: Iterable) -> list[str]:
    return recorded([*map(str, values)])


@check_keywords
@describe_methods(METHODS)
@dataclass(frozen=True, eq=False, repr=False)
class AllocationOptions(Settings):
    """Options of an allocation: the allocator, and the constraints and requirements of each plan.

    Functions that accept these options as ``allocator`` also accept the name of an allocator or a function; all other
    options then have their default values.

    Parameters
    ----------
    allocator : str or callable, optional
        Targets with the same priority form a class. Allocators that use priorities assign the class of the highest
        priority first.
        {methods}
        The default is ``repair``. Any other name refers to an allocator that an installed package provides. A function
        is called with an `~rfpsurvey.allocation.AllocationProblem`.
    requirements : list of Requirement or str, or "instrument", optional
        Minimum and maximum numbers of targets per plan, as in ``["sky=20/spectrograph", "standard=5/spectrograph"]``;
        ``"instrument"`` stands for the requirements of the instrument. Minima take precedence over science targets and
        are met as far as possible; minima that are not met are reported. ``balanced`` and ``nearest`` do not use
        requirements, but report requirements that are not met.
    sky_separation : Quantity, optional
        Minimum distance of sky positions from all targets: a length on the focal plane or, if the instrument is known,
        an angle. If this distance is given and a requirement counts ``sky``, rfpsurvey adds sky positions that are at
        least this far from all targets. The position at which a stuck positioner points is also added if it is at least
        this far from all targets.
    objective : {"priority", "count"}, optional
        ``priority``: maximize the number of targets, one class after the other. ``count``: first maximize the number of
        all science targets, then the number of targets of one class after the other. Only ``network_flow`` and
        ``optimal`` use this option.
    time_limit : Quantity, optional
        Time after which ``network_flow`` and ``optimal`` return the best plan that they have found, with its gap; 60 s
        by default. The limit also applies if ``start`` is ``network_flow`` or ``optimal``. ``optimal`` always makes the
        whole plan of ``repair`` before it returns a plan without proof, which is therefore never worse.
    start : Allocation, Tile or str, optional
        Plan from which ``repair`` starts, or the name of the allocator that makes this plan (any except ``repair``). A
        tile can have other targets. ``optimal`` uses plans, but no names: of all plans of equal value, it returns the
        one with the fewest changed fibers, whose number is ``summary["search"]["n_changed"]``.
    parked_obstacles : bool, optional
        Whether idle positioners are obstacles; only positioners with two arms of equal length can be obstacles.
    required : array_like of int or str, optional
        Identifiers of targets, of any kind, that take precedence over all other targets. ``nearest`` and
        ``lamost_rule`` assign required targets as a class before all other classes; ``network_flow`` and ``optimal``
        assign as many of them as possible; ``repair`` assigns the required targets for which its local moves find a
        positioner; ``balanced`` does not use this option. Required targets without a fiber are reported. `allocate` has
        a parameter of the same name, with rows in place of identifiers.
    keep_out : Region or list of Region, optional
        Circles on the sky, made by `Region.cap`, that no arm may cover, such as circles around bright stars. In each
        field, the circles that an arm can touch are obstacles. ``optimal`` and ``repair`` avoid them; with other
        allocators, an arm that covers a circle is counted as a collision. On the focal plane, an obstacle contains the
        whole image of its circle, even if the center of the circle is outside the field.
    subpriority : int or str, optional
        Order of the targets within each class; targets with larger subpriorities are served first. An integer is the
        seed of random subpriorities, which depend only on the identifiers of targets
        (`~rfpsurvey.allocation.subpriorities`). Text is the name of an additional column of the catalog, such as
        ``SUBPRIORITY``, or, in surveys, ``fewest remaining visits``: the targets that can be finished soonest. With
        subpriorities, ``nearest`` assigns the targets of a class in this order, each to its closest free positioner;
        ``balanced`` distributes the targets to the queues in this order; with ``lamost_rule``, every positioner
        nominates its unassigned target with the largest subpriority. ``network_flow`` and ``optimal`` maximize the sum
        of the subpriorities of the science targets after the numbers of targets (``network_flow`` then does not
        minimize squared distances). Differences below one millionth of the range are ignored. In large fields, or if
        the time limit ends the search, ``optimal`` finds only an approximate maximum of the sum, as does ``repair``;
        the bound in ``levels`` states this. With subpriorities and unique identifiers, the plan does not depend on the
        order of targets in the catalog. Without subpriorities, ``optimal`` and ``repair`` sort targets by a hash of
        their identifiers or, if there are none, of their positions.
    constraints : list of Constraint or str, optional
        Constraints of any kind, as objects or as text: `KeepOut` or ``keep_out RA DEC RADIUS`` (deg), `Required` or
        ``required ID ...``, `Requirement` or text such as ``sky=20/spectrograph``, and constraints of users and of
        installed packages (:doc:`/plugins`). ``requirements``, ``required`` and ``keep_out`` are short forms:
        constraints of these three kinds are moved there, and ``all_constraints`` contains all of them.
    rules : str, optional
        Name of rules of the instrument, such as ``dark_monit`` (a design mode of SDSS-V); functions that plan add them
        to the constraints. See `Instrument.rules`.
    moves : {"ejection", "exchange"}, optional
        Moves of ``repair``: a positioner takes a better target, and up to four others take other targets (``ejection``)
        or one other takes an equally good target (``exchange``, which is faster, but loses targets where arms are long;
        plans of version 0.3).
    programs : int, optional
        Largest number of linear and integer programs that ``network_flow`` and ``optimal`` solve. In contrast to
        ``time_limit``, which also applies, this limit gives the same plan on every computer.

    Raises
    ------
    InputError
        If the name of an allocator or of an objective is unknown, if a requirement cannot be read, if a number is out
        of range, or if ``keep_out`` contains a region that is not a circle.

    Notes
    -----
    Functions that plan issue a warning for each option that the allocator does not use and that does not have its
    default value. The plan then records the default value of ``objective``, ``time_limit`` and ``start``.

    References
    ----------
    Chen et al. 2024, arXiv:2409.07288, Section 4.2 (balanced, lamost). Blanton et al. 2003, AJ 125, 2276 (flow).

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> rs.AllocationOptions("optimal", requirements="sky=20/spectrograph").requirements
    (Requirement('sky=20/spectrograph'),)
    >>> rs.AllocationOptions(required=["star 7"], keep_out=rs.Region.parse("cap 95 23 0.5")).record["keep_out"]
    ['cap 95.0 23.0 0.5']
    """

    allocator: str | Callable = option(
        DEFAULT_ALLOCATOR,
        convert=known_allocator,
        to_record=name_of,
        from_record=lambda name: recorded_name(GROUP, METHODS, name, "allocator"),
    )
    requirements: tuple[Requirement, ...] | list | str | Requirement | None = option(
        (), convert=_as_requirements, to_record=lambda given: given if isinstance(given, str) else [*map(str, given)]
    )
    sky_separation: u.Quantity[u.arcsec] | u.Quantity[u.mm] | None = option(None, above=0, words=SEPARATION)
    objective: str = option("priority", choices=("priority", "count"))
    time_limit: u.Quantity[u.s] = option(60 * u.s, above=0)
    start: object = option(
        "lamost_rule",
        convert=_known_start,
        to_record=lambda start: start if isinstance(start, str) else PLAN,
        from_record=_recorded_start,
    )
    parked_obstacles: bool = option(True)
    required: np.ndarray | list | tuple | int | str | None = option(
        (), convert=as_required, to_record=_texts, from_record=listed_in, by_record=True
    )
    keep_out: tuple[Region, ...] | list[Region] | Region | None = option(
        (),
        convert=as_circles,
        to_record=lambda circles: _texts(map(circle_text, circles)),
        from_record=lambda texts: [Region.parse(text) for text in listed_in(texts)],
        by_record=True,
    )
    subpriority: int | str | None = option(
        None, convert=lambda given: given if isinstance(given, str) else check_seed(given), sparse=True
    )
    constraints: tuple[Constraint, ...] | list | Constraint | str | None = option(
        (), convert=as_constraints, to_record=_texts, from_record=listed_in, sparse=True
    )
    rules: str | None = option(None, words="the name of rules of the instrument", sparse=True)
    moves: str = option("ejection", choices=("ejection", "exchange"), record=None)
    programs: int | None = option(None, low=0, sparse=True)

    _order = (
        *("allocator", "requirements", "sky_separation_arcsec", "sky_separation_mm", "objective", "time_limit_s"),
        *("start", "parked_obstacles", "required", "keep_out", "constraints", "stars", "subpriority", "tie_seed"),
    )

    def _check(self):
        """Move the constraints that have a short form to their short form, so that each constraint is stored once."""
        short = {
            KeepOut: ("keep_out", "circles", as_circles),
            Required: ("required", "ids", as_required),
            Requirement: ("requirements", "counts", as_requirements),
        }
        kept = []
        for constraint in self.constraints:
            name, part, convert = short.get(type(constraint), ("", "", None))
            if name and not (name == "requirements" and self._of_instrument):
                object.__setattr__(self, name, convert((*getattr(self, name), *getattr(constraint, part))))
            else:
                kept.append(constraint)
        object.__setattr__(self, "constraints", tuple(kept))

    @property
    def _of_instrument(self) -> bool:
        return isinstance(self.requirements, str)

    @cached_property
    def all_constraints(self) -> tuple[Constraint, ...]:
        """All constraints: those of ``requirements``, ``required`` and ``keep_out``, then ``constraints``."""
        counts = () if self._of_instrument else self.requirements
        required = [Required(self.required)] if self.required else []
        return (*counts, *required, *([KeepOut(self.keep_out)] if self.keep_out else []), *self.constraints)

    @cached_property
    def counts(self) -> tuple[Requirement, ...]:
        """The requirements on numbers of targets of all constraints."""
        return tuple(dict.fromkeys(count for constraint in self.all_constraints for count in constraint.counts))

    @cached_property
    def distributions(self) -> tuple[Distribution, ...]:
        """The rules on the distribution of fibers that the allocator follows; none if it only checks them."""
        if not self.constraints or self.method.distribution == "no":
            return ()
        return tuple(dict.fromkeys(rule for constraint in self.constraints for rule in constraint.distributions))

    @property
    def needs(self) -> tuple[Requirement | Distribution, ...]:
        """The requirements with a minimum, and the rules that the allocator follows, which need targets of a kind."""
        return (*(count for count in self.counts if count.minimum), *self.distributions)

    @cached_property
    def motion_law(self) -> str:
        """Law of time by which arms must unfold, or ``"paths"``; empty text if no constraint refers to the motion."""
        return law_of(self.all_constraints)

    @cached_property
    def required_ids(self) -> tuple:
        """Identifiers of the targets that take precedence according to any constraint."""
        return tuple(dict.fromkeys(name for constraint in self.all_constraints for name in constraint.required_ids))

    def without(self, name: str) -> "AllocationOptions":
        """Return the options without the constraints of a kind.

        Parameters
        ----------
        name : {"counts", "distributions"}
            Whether to omit the constraints on numbers of targets, or on the distribution of fibers.

        Returns
        -------
        AllocationOptions
            The options, in which the attribute ``name`` is empty.
        """
        kept = {} if name == "distributions" else {"requirements": ()}
        return replace(self, constraints=[c for c in self.constraints if not getattr(c, name)], **kept)

    def check_for_fields(self, what: str) -> None:
        """Raise an error if ``start`` is an allocation, because an allocation is valid for a single field only.

        Parameters
        ----------
        what : str
            Text for the error message that names what is planned, such as "a survey".

        Raises
        ------
        InputError
            If ``start`` is an allocation.
        """
        if not isinstance(self.start, str):
            raise InputError(
                f"for {what}, start must be the name of an allocator, got an allocation, which is valid for one "
                "field only"
            )

    @property
    def name(self) -> str:
        """Name of the allocator."""
        return name_of(self.allocator)

    @property
    def method(self) -> Allocator:
        """Record of the allocator: the options that it uses, and properties of its plans."""
        return find_improving(self.allocator, self.start, self.moves)

    @cached_property
    def seconds(self) -> float:
        """The time limit in seconds."""
        return float(self.time_limit.to_value(u.s))

    def for_instrument(self, instrument: object) -> "AllocationOptions":
        """Return the options with the requirements of an instrument, and with ``sky_separation`` as a length.

        Parameters
        ----------
        instrument : Instrument or None
            The instrument; None if only a focal plane is known.

        Returns
        -------
        AllocationOptions
            Options that `allocate` accepts and that a result records. Options that the allocator does not use are set
            to their default values.

        Raises
        ------
        InputError
            If no instrument is given, but the options contain a value that requires an instrument or a catalog: the
            requirements of the instrument, an angle, identifiers of targets, the name of a column of subpriorities, or
            circles on the sky.
        """
        requirements, separation = self.requirements, self.sky_separation
        if instrument is None and (self._of_instrument or _is_angle(separation)):
            given = "requirements='instrument'" if self._of_instrument else f"sky_separation={separation}"
            remedy = "use plan_tile, or pass lengths and requirements"
            raise InputError(f"{given} can be used only with an instrument; {remedy}")
        if instrument is None and self.rules is not None:
            raise InputError(f"rules={self.rules!r} can be used only with an instrument; use plan_tile")
        for constraint in self.all_constraints if instrument is None else ():
            constraint.for_instrument(None)  # raises an error if a constraint requires a catalog
        if instrument is None and isinstance(self.subpriority, str):
            raise InputError(
                f"a column of subpriorities can be used only with a catalog, got {self.subpriority!r}; use "
                "plan_tile, or pass the values as the argument subpriority of allocate"
            )
        if self.rules is not None:
            options = replace(self, constraints=(*self.constraints, *instrument.rules(self.rules)), rules=None)
            return options.for_instrument(instrument)
        if self._of_instrument:
            requirements = as_requirements(instrument.requirements)
        constraints = tuple(constraint.for_instrument(instrument) for constraint in self.constraints)
        unused = {name: getattr(AllocationOptions, name) for name in ONLY_SOME if not self.method.uses(name)}
        completed = replace(self, requirements=requirements, constraints=constraints, **unused)
        if instrument is not None:
            check_counts(completed.counts, instrument.focal_plane)
        if separation is not None and not any(need.what == "sky" for need in completed.needs):
            remedy = "add a requirement such as 'sky=20/spectrograph'"
            warn_no_effect("sky_separation", f"because no requirement counts sky positions; {remedy}")
            separation = None
        elif separation is not None and _is_angle(separation):
            separation = (separation * instrument.plate_scale).to(u.mm)
        return replace(completed, sky_separation=separation)

    @property
    def breaks_ties(self) -> bool:
        """Whether a hash decides between plans that are equally good, so that the order of targets has no influence."""
        return self.subpriority is None and self.method.breaks_ties

    @property
    def record(self) -> dict:
        """The options as text and numbers, in the form in which files store the options."""
        stars = [constraint.content for constraint in self.constraints if constraint.content]
        record = super().record | ({"stars": stars} if stars else {})
        record |= {"tie_seed": TIE_SEED} if self.breaks_ties else {}
        record = {name: record[name] for name in self._order if name in record} | record
        return record if self.moves == self._moves_without_record else record | {"moves": self.moves}

    @property
    def _moves_without_record(self) -> str:
        """The moves if a record does not contain them: those of version 0.3, or the default if there are no moves."""
        return "exchange" if self.method.uses("moves") else "ejection"

    def _completed(self, record: dict, given: Collection[str]) -> "AllocationOptions":
        moves = record.get("moves", self._moves_without_record)
        return self if "moves" in given else replace(self, moves=moves)


def as_options(given: object) -> AllocationOptions:
    """Return options; if only an allocator is given, return the default options with this allocator."""
    return given if isinstance(given, AllocationOptions) else AllocationOptions(given)


def _is_angle(value) -> bool:
    return isinstance(value, u.Quantity) and value.unit.is_equivalent(u.rad)
