"""Options of joint plans."""

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np

from rfpsurvey._settings import Settings, not_invertible, option
from rfpsurvey.allocation import METHODS, AllocationOptions, as_options
from rfpsurvey.errors import InputError, check_keywords, short, warn_no_effect
from rfpsurvey.survey._survey import Survey

ONLY_DIGEST = not_invertible("fixed must be given as an argument of from_record, because records contain only a digest")
JOINT = "joint"
"""Name of the allocator that stands for a joint plan with default options."""


def _check_first(allocator: AllocationOptions | str) -> AllocationOptions | str:
    """Return an allocator; raise an error if its options do not allow a joint plan."""
    options = as_options(allocator)
    if not options.method.plans_jointly:
        names = " or ".join(repr(name) for name, method in METHODS.items() if method.plans_jointly)
        raise InputError(f"a joint plan needs the allocator {names}, got {options.name!r}")
    if options.objective != "priority":
        raise InputError(f"a joint plan needs the objective 'priority', got {options.objective!r}")
    return allocator


@check_keywords
@dataclass(frozen=True, eq=False, repr=False)
class JointOptions(Settings):
    """Options of a joint plan, in which all tiles of a survey are planned together; the allocator of `plan_survey`.

    The tiles are first planned one after the other, and then together, such that the number of visits increases. If the
    targets have cadences (`~rfpsurvey.survey.Cadences`), the number of complete cadences increases first. The search
    ends when the gap is small enough, after the given number of iterations, or at the time limit.

    Parameters
    ----------
    gap : float, optional
        The search ends when, for every priority, the relative difference between the number of visits and its upper
        bound is at most this value. The visits of a priority are all visits to targets with at least this priority. If
        the targets have cadences, the numbers of complete cadences are compared instead, and the number of visits must
        be equal to its bound.
    iterations : int, optional
        Largest number of iterations. If this number is 0, visits are only moved between tiles along augmenting paths,
        and the first bounds are computed.
    time_limit : Quantity, optional
        Time after which the search ends. The preceding step, in which the tiles are planned one after the other, is
        not included in this time. By default, the time is not limited. A plan whose search ends at the time limit may
        not be reproducible.
    fixed : Survey, str or path-like, optional
        An earlier survey, or its folder, whose tiles were already observed. Each of its tiles must have the same center
        and position angle as a tile of the new survey, which keeps the earlier plan. If several tiles have this center
        and position angle, the tile with the same identifier is used. Both surveys must have the same instrument,
        epoch, observing conditions, ``keep_out`` and ``lost_in_collision``, and the catalog must contain the targets of
        the earlier survey in the same rows. Positioners with the handedness ``both`` are not supported.
    inform : callable, optional
        Function that is called once before the first iteration, with a dict: ``visits_before`` is the number of visits
        of the tiles planned one after the other, ``visits`` is the number of visits after the search for augmenting
        paths, and ``bound`` is the upper bound so far. Each value is a list with one number for each priority; the
        number for a priority includes the visits to targets of all higher priorities.
    patch_size : int, optional
        The search solves an integer program for each patch of the sky. This parameter is the initial number of pairs of
        a positioner and a target in one patch, 10 to 100000. The search increases this number when the plan and the
        bounds hardly improve. Larger patches give better plans and bounds, but take longer.
    allocator : AllocationOptions or str, optional
        The allocator of the first plan, which must be ``optimal``, or options with this allocator. If they contain
        requirements, required targets or other constraints, the joint plan meets all of them that the first plan meets.
    early : bool, optional
        Whether visits are moved to earlier passes. Plans with the same numbers of visits, and with the same sum of the
        subpriorities if there are any, are compared. This option has no effect with cadences.

    Raises
    ------
    InputError
        If a number is out of range.

    Notes
    -----
    The attribute ``record`` contains a digest of ``fixed``, and neither ``inform`` nor ``allocator``. Therefore,
    ``from_record`` also needs ``allocator`` and ``fixed`` as arguments if they do not have their default values.

    Examples
    --------
    >>> import astropy.units as u
    >>> import rfpsurvey as rs
    >>> rs.JointOptions(gap=0.001, time_limit=30 * u.min).seconds
    1800.0
    """

    gap: float = option(0.0, low=0, below=1)
    iterations: int = option(10, low=0, high=100_000)
    time_limit: u.Quantity[u.s] | None = option(None, above=0)
    fixed: Survey | str | os.PathLike | None = option(
        None, words="a Survey or the path of its folder", to_record="_fixed_digest", from_record=ONLY_DIGEST
    )
    inform: Callable | None = option(None, words="a function", record=None, compare=False)
    patch_size: int = option(800, low=10, high=100_000)
    allocator: AllocationOptions | str = option("optimal", convert=_check_first, record=None)
    early: bool = option(False, sparse=True)

    @property
    def seconds(self) -> float:
        """The time limit in seconds; infinity if the time is not limited."""
        return float("inf") if self.time_limit is None else float(self.time_limit.to_value(u.s))

    @cached_property
    def _fixed_digest(self) -> str | None:
        """A digest of the visits of the fixed tiles; a plan can only be continued with the same fixed tiles."""
        if self.fixed is None:
            return None
        survey = self.fixed if isinstance(self.fixed, Survey) else Survey.read(self.fixed)
        total = hashlib.sha256()
        for name, visits in zip(np.asarray(survey.tiles["tile"]).tolist(), survey, strict=True):
            columns = [np.asarray(visits[column]).tolist() for column in ("target_row", "positioner", "observed")]
            total.update(repr((name, columns)).encode())
        return total.hexdigest()


def check_for_cadences(joint: JointOptions) -> None:
    """Raise an error, or issue a warning, if an option does not apply to targets with cadences."""
    if joint.fixed is not None:
        raise InputError("fixed must not be given for a joint plan with cadences")
    if joint.early:
        warn_no_effect("early", "with cadences")


def as_joint(allocator: object, order: object) -> tuple[AllocationOptions, JointOptions | None]:
    """Return the options of the tiles, and the options of the joint plan, if one is requested."""
    if isinstance(allocator, str) and allocator == JOINT:
        allocator = JointOptions()
    if not isinstance(allocator, JointOptions):
        return as_options(allocator), None
    if not (isinstance(order, str) and order == "color"):
        raise InputError(f"the order must be 'color' for a joint plan, got {short(order)}")
    return as_options(allocator.allocator), allocator
