"""The interface of all constraints, and how allocators honor constraints."""

import shlex
from dataclasses import MISSING, dataclass, fields
from functools import cached_property
from hashlib import sha256
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from rfpsurvey._assignment.constraints.field import FAIL, PASS, ConstraintField, Verdict
from rfpsurvey._common.read_tables import parse_number
from rfpsurvey.errors import INCONVERTIBLE, InputError, listed, number_of

if TYPE_CHECKING:
    from rfpsurvey._instruments.instrument import Instrument

MOST_LISTED, NO_CIRCLES = 5, np.empty((0, 3))


EXACTLY, AS_GOAL, ONLY_CHECKED = "exactly", "as a goal", "only checked"
LEVELS = (EXACTLY, AS_GOAL, ONLY_CHECKED)


@dataclass(frozen=True)
class Abilities:
    """How a method honors each part of a constraint: ``"exactly"``, ``"as a goal"`` or ``"only checked"``."""

    obstacles: str = ONLY_CHECKED  # arms avoid obstacles
    precedence: str = ONLY_CHECKED  # some targets take precedence over all other targets
    counts: str = ONLY_CHECKED  # numbers of targets are met
    distribution: str = ONLY_CHECKED  # science fibers have enough neighbors
    motion: str = ONLY_CHECKED  # arms reach their targets without collisions


class Constraint:
    """A rule for the plans of fields, such as `~rfpsurvey.KeepOut`, `~rfpsurvey.Required` and `~rfpsurvey.Requirement`.

    A subclass is a frozen dataclass whose fields are the arguments of the constraint. It overrides only what it
    requires: ``excluded``, ``obstacles``, ``required_ids``, ``counts``, ``distributions`` or ``check``. rfpsurvey calls
    these methods for each field; unless one of them is overridden, it costs no time.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> import rfpsurvey as rs
    >>> @dataclass(frozen=True)
    ... class Faint(rs.constraints.Constraint):
    ...     limit: float
    ...     name = "faint"
    ...
    ...     def excluded(self, field):
    ...         return field.column("mag") < self.limit
    >>> str(Faint(17.5)), Faint.parse("17.5").limit
    ('faint 17.5', 17.5)
    """

    name: ClassVar[str] = ""
    """First word of the text form of the constraint."""
    required_ids: tuple = ()
    """Identifiers of targets that take precedence over all other targets."""
    counts: tuple = ()
    """The requirements (`~rfpsurvey.Requirement`) on numbers of targets that the constraint consists of."""
    distributions: tuple = ()
    """The rules (`Distribution`) on the neighbors of fibers that the constraint consists of."""
    motion_law: str = ""
    """Law of time by which arms must unfold without collisions, or ``"paths"`` if their paths are planned."""
    uses_targets: ClassVar[bool] = True
    """Whether methods use positions of targets on the focal plane or around the field, which are otherwise omitted."""
    before_fibers: ClassVar[bool] = False
    """Whether ``check`` depends on the field only, so that plans state violations before fibers are assigned."""
    content: str = ""
    """Text that identifies the content of the file that the constraint reads; a survey is continued only with it."""
    margin_rad: float = 0.0
    """Angle by which ``excluded`` must know targets outside of the field, in radians, from 0 to pi."""

    @classmethod
    def parse(cls, arguments: str) -> "Constraint":
        """Make a constraint from the text that follows its name.

        Parameters
        ----------
        arguments : str
            The values of the fields, separated by spaces; quotes surround text that contains spaces.

        Returns
        -------
        Constraint
            The constraint.

        Raises
        ------
        InputError
            If the text has too few or too many values, or if a value is not valid.
        """
        names = [field.name for field in fields(cls)]
        try:
            words = shlex.split(arguments)
            types = [getattr(field.type, "__name__", field.type) for field in fields(cls)]
            values = [CONVERTERS.get(kind, str)(word) for kind, word in zip(types, words, strict=False)]
            if sum(field.default is MISSING for field in fields(cls)) <= len(words) <= len(names):
                return cls(*values)
        except InputError:
            raise
        except INCONVERTIBLE as error:
            raise InputError(f"{cls.form()}, got {arguments!r}: {error}") from None
        raise InputError(f"{cls.form()}, got {arguments!r}")

    @classmethod
    def form(cls) -> str:
        """Return the beginning of the error message for text of the wrong form.

        Returns
        -------
        str
            Text such as "the constraint must have the form 'faint LIMIT'".
        """
        words = [cls.name, *(field.name.upper() for field in fields(cls))]
        return f"the constraint must have the form '{' '.join(words)}'"

    def __str__(self):
        return " ".join([self.name, *(shlex.quote(_text_of(getattr(self, field.name))) for field in fields(self))])

    def for_instrument(self, instrument: "Instrument | None") -> "Constraint":
        """Return the constraint for an instrument; raise an error if it cannot be used.

        Parameters
        ----------
        instrument : Instrument or None
            The instrument; None if only positions on the focal plane are known, as in `~rfpsurvey.allocate`.

        Returns
        -------
        Constraint
            The constraint, in which everything that depends on the instrument is resolved.

        Raises
        ------
        InputError
            If the constraint requires positions on the sky, but only positions on the focal plane are known.
        """
        if instrument is None and self.parts != {"counts"}:
            self._refuse_focal_plane()
        return self

    def _refuse_focal_plane(self) -> None:
        """Raise the error that states that the constraint cannot be used if only a focal plane is known."""
        raise InputError(f"constraints can be used only with a catalog, got '{self}'; use plan_tile")

    def excluded(self, field: ConstraintField) -> np.ndarray | None:
        """Return which targets must not be observed.

        Parameters
        ----------
        field : ConstraintField
            The targets in the field and, up to the angle ``margin_rad``, around it.

        Returns
        -------
        ndarray of bool or None
            One value for each target of the field; None if no target is excluded.
        """
        return None

    def obstacles(self, field: ConstraintField) -> np.ndarray:
        """Return circles on the focal plane that no arm may cover.

        Parameters
        ----------
        field : ConstraintField
            The field; its arrays of targets are empty unless the constraint overrides ``excluded``.

        Returns
        -------
        ndarray of float, shape (k, 3)
            Positions x and y of the centers, and radii, in mm.
        """
        return NO_CIRCLES

    def check(self, field: ConstraintField, has_fiber: np.ndarray, n_covering: int) -> list[str]:
        """Return sentences that state how a finished plan violates the constraint, other than its counts.

        Parameters
        ----------
        field : ConstraintField
            The field.
        has_fiber : ndarray of bool
            Whether each target of the field has a fiber.
        n_covering : int
            Number of arms that cover circles of ``obstacles``.

        Returns
        -------
        list of str
            The sentences; an empty list if the plan does not violate the constraint.
        """
        texts = [f"{self}: {number_of(n_covering, 'arm covers', 'arms cover')} circles"] if n_covering else []
        if "exclusion" in self.parts:
            excluded = self.excluded(field)
            wrong = [] if excluded is None else field.id[excluded & has_fiber].tolist()
            if wrong:
                text = number_of(len(wrong), "excluded target has", "excluded targets have")
                texts.append(f"{self}: {text} a fiber ({listed(wrong, MOST_LISTED)})")
        return texts

    def verdict(self, field: ConstraintField, has_fiber: np.ndarray, n_covering: int) -> Verdict:
        """Return the verdict on a finished plan, which by default is the number of sentences of ``check``.

        Parameters
        ----------
        field : ConstraintField
            The field.
        has_fiber : ndarray of bool
            Whether each target of the field has a fiber.
        n_covering : int
            Number of arms that cover circles of ``obstacles``.

        Returns
        -------
        Verdict
            The verdict; its attribute ``rows`` contains the rows of the targets that violate the constraint.
        """
        texts = self.check(field, has_fiber, n_covering)
        excluded = self.excluded(field) if "exclusion" in self.parts else None
        rows = np.empty(0, dtype=int) if excluded is None else np.flatnonzero(excluded & has_fiber)
        note = "; ".join(text.removeprefix(f"{self}: ") for text in texts)
        return Verdict(str(self), len(texts), "no violation", FAIL if texts else PASS, note, rows=rows)

    @cached_property
    def parts(self) -> frozenset[str]:
        """Parts of the interface that the constraint uses: the names in ``Abilities``, and ``exclusion``."""
        parts = {part for part, name in METHODS.items() if getattr(type(self), name) is not getattr(Constraint, name)}
        given = {"precedence": self.required_ids, "counts": self.counts, "distribution": self.distributions}
        given["motion"] = self.motion_law
        return frozenset(parts | {part for part, values in given.items() if values})

    @cached_property
    def uses_field(self) -> bool:
        """Whether the constraint contains more than counts, so that its methods are called for each field."""
        return bool(self.parts - {"counts"}) or type(self).check is not Constraint.check

    def honored(self, abilities: Abilities) -> str:
        """Return how a method honors the constraint; if the method honors parts differently, the weakest applies.

        Parameters
        ----------
        abilities : Abilities
            How the method honors each part of a constraint. All methods honor exclusions exactly, because an excluded
            target is in reach of no positioner.

        Returns
        -------
        str
            ``"exactly"``, ``"as a goal"`` or ``"only checked"``.
        """
        return max((getattr(abilities, part, EXACTLY) for part in self.parts), key=LEVELS.index, default=ONLY_CHECKED)


def _text_of(value: object) -> str:
    """Return the text of an argument; different arrays have different texts, although the text is short."""
    if not isinstance(value, np.ndarray):
        return str(value)
    text = str(value.tolist())
    digest = sha256(text.encode()).hexdigest()[:16]
    return text if value.size <= MOST_LISTED else f"{value.size} values, digest {digest}"


METHODS = {"exclusion": "excluded", "obstacles": "obstacles"}
CONVERTERS = {"float": parse_number, "int": lambda text: parse_number(text, int), "str": str}
