"""The interface of all constraints, and the description of a field that constraints receive."""

import shlex
from dataclasses import MISSING, dataclass, fields, replace
from functools import cached_property
from hashlib import sha256
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from rfpsurvey._readers import parse_number
from rfpsurvey._units import values_at
from rfpsurvey.constraints._abilities import EXACTLY, LEVELS, ONLY_CHECKED, Abilities
from rfpsurvey.constraints._verdict import FAIL, PASS, Verdict
from rfpsurvey.errors import INCONVERTIBLE, InputError, listed, number_of
from rfpsurvey.projection import FieldProjection

if TYPE_CHECKING:
    from rfpsurvey.instrument import Instrument

MOST_LISTED, NO_CIRCLES = 5, np.empty((0, 3))


@dataclass(frozen=True, eq=False)
class ConstraintField:
    """The targets in a field and near its edge, as constraints receive them; arrays have one element per target.

    Parameters
    ----------
    instrument : Instrument
        The instrument.
    projection : FieldProjection or None
        Projection of the sky onto the focal plane; None if only positions on the focal plane are known.
    vectors : ndarray of float, shape (n, 3)
        Directions of the targets as ICRS unit vectors; NaN if they are not known.
    xy : ndarray of float, shape (n, 2)
        Positions of the targets on the focal plane in mm; NaN for targets outside the image.
    id : ndarray
        Identifiers of the targets (integers or text).
    is_available : ndarray of bool
        Whether each target can be observed in this field. The other targets are outside the field, or have no
        remaining visits; a constraint can exclude targets that are close to them.
    kind : ndarray of str
        Kind of each target: ``science``, ``standard`` or ``sky``.
    category : ndarray of str
        Category of each target; empty text if it has none.
    priority : ndarray of float
        Priority of each target.
    extra : dict
        Further columns of the catalog, by name.
    is_complete : bool, optional
        Whether the field contains all targets of the catalog in the field; False if only the targets are known that
        have a fiber, as in the plan of another program.
    has_kinds : bool, optional
        Whether the kinds of the targets are known; False for the plan of another program that does not contain them.
    fiber_type : ndarray of str, optional
        Fiber type that each target requires, or has in a finished plan; empty text if it is not known. By default, it
        is not known.
    is_added : ndarray of bool, optional
        Whether each target is a sky position that is not in the catalog; its identifier has no meaning.
    """

    instrument: "Instrument"
    projection: FieldProjection | None
    vectors: np.ndarray
    xy: np.ndarray
    id: np.ndarray
    is_available: np.ndarray
    kind: np.ndarray
    category: np.ndarray
    priority: np.ndarray
    extra: dict
    is_complete: bool = True
    has_kinds: bool = True
    fiber_type: np.ndarray | None = None
    is_added: np.ndarray | None = None

    def __post_init__(self):
        for name, usual in (("fiber_type", ""), ("is_added", False)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.broadcast_to(usual, len(self.id)))

    def column(self, name: str) -> np.ndarray:
        """Return a further column of the catalog, such as a magnitude.

        Parameters
        ----------
        name : str
            Name of the column.

        Returns
        -------
        ndarray
            One value per target; NaN, empty text, False or -1 for a sky position that rfpsurvey adds.

        Raises
        ------
        InputError
            If the catalog has no column of this name.
        """
        if name not in self.extra:
            known = f"{listed(self.extra, 8)} (further columns are read by keep= or --set catalog.keep=NAME)"
            raise InputError(f"the catalog must have the column {name!r}, but its further columns are: {known}")
        return self.extra[name]

    def is_near(self, centers: np.ndarray, radius_rad: float) -> np.ndarray:
        """Return whether each target is within an angle of at least one of several directions.

        Parameters
        ----------
        centers : ndarray of float, shape (k, 3)
            Unit vectors.
        radius_rad : float
            The angle in radians.

        Returns
        -------
        ndarray of bool
            One value per target.
        """
        from scipy.spatial import cKDTree

        near, there = np.zeros(len(self.vectors), dtype=bool), np.isfinite(self.vectors).all(axis=1)
        centers = centers[np.isfinite(centers).all(axis=1)]
        if len(centers) and there.any():
            near[there] = cKDTree(centers).query(self.vectors[there])[0] <= 2 * np.sin(min(radius_rad, np.pi) / 2)
        return near

    def with_blank_sky(
        self, vectors: np.ndarray, xy: np.ndarray, fiber_type: np.ndarray | None = None
    ) -> "ConstraintField":
        """Return the field with additional available targets of the kind ``sky``, which have no other properties.

        Parameters
        ----------
        vectors : ndarray of float, shape (k, 3)
            Directions of the sky positions.
        xy : ndarray of float, shape (k, 2)
            Positions on the focal plane in mm.
        fiber_type : ndarray of str, shape (k,), optional
            Fiber type that each sky position requires; by default, it is not known.

        Returns
        -------
        ConstraintField
            The field, whose last k targets are the sky positions.
        """
        rows = np.append(np.arange(len(self.id)), np.full(len(xy), -1))
        columns = {name: values_at(getattr(self, name), rows) for name in ("id", "category", "priority")}
        columns["extra"] = {name: values_at(values, rows) for name, values in self.extra.items()}
        more = {"vectors": vectors, "xy": xy, "is_available": np.ones(len(xy), bool), "kind": np.full(len(xy), "sky")}
        more["is_added"] = np.ones(len(xy), dtype=bool)
        more["fiber_type"] = np.full(len(xy), "") if fiber_type is None else fiber_type
        columns.update((name, np.concatenate([getattr(self, name), values])) for name, values in more.items())
        return replace(self, **columns)


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
    """Law of time by which arms must unfold without collisions; empty text if the constraint does not require it."""
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
        names = [one.name for one in fields(cls)]
        try:
            words = shlex.split(arguments)
            types = [getattr(one.type, "__name__", one.type) for one in fields(cls)]
            values = [CONVERTERS.get(kind, str)(word) for kind, word in zip(types, words, strict=False)]
            if sum(one.default is MISSING for one in fields(cls)) <= len(words) <= len(names):
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
        words = [cls.name, *(one.name.upper() for one in fields(cls))]
        return f"the constraint must have the form '{' '.join(words)}'"

    def __str__(self):
        return " ".join([self.name, *(shlex.quote(_text_of(getattr(self, one.name))) for one in fields(self))])

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
        found = [f"{self}: {number_of(n_covering, 'arm covers', 'arms cover')} circles"] if n_covering else []
        if "exclusion" in self.parts:
            excluded = self.excluded(field)
            wrong = [] if excluded is None else field.id[excluded & has_fiber].tolist()
            if wrong:
                text = number_of(len(wrong), "excluded target has", "excluded targets have")
                found.append(f"{self}: {text} a fiber ({listed(wrong, MOST_LISTED)})")
        return found

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
        found = self.check(field, has_fiber, n_covering)
        excluded = self.excluded(field) if "exclusion" in self.parts else None
        rows = np.empty(0, dtype=int) if excluded is None else np.flatnonzero(excluded & has_fiber)
        note = "; ".join(text.removeprefix(f"{self}: ") for text in found)
        return Verdict(str(self), len(found), "no violation", FAIL if found else PASS, note, rows=rows)

    @cached_property
    def parts(self) -> frozenset[str]:
        """Parts of the interface that the constraint uses: the names in ``Abilities``, and ``exclusion``."""
        own = {part for part, name in METHODS.items() if getattr(type(self), name) is not getattr(Constraint, name)}
        given = {"precedence": self.required_ids, "counts": self.counts, "distribution": self.distributions}
        given["motion"] = self.motion_law
        return frozenset(own | {part for part, values in given.items() if values})

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
