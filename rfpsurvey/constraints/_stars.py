"""The base class of rules on stars, which are the targets of the catalog or the stars of a second catalog."""

from dataclasses import fields
from functools import cached_property
from hashlib import sha256
from shlex import quote

import numpy as np

from rfpsurvey._plugins import name_of
from rfpsurvey.catalog import Catalog
from rfpsurvey.constraints._constraint import ConstraintField
from rfpsurvey.constraints._rule import Rule, check_unit, to_magnitudes
from rfpsurvey.errors import InputError, listed, refusal


class StarRule(Rule):
    """A rule with the fields ``column``, the magnitude of stars, and ``stars``, their catalog, its path or None."""

    def _check_stars(self) -> None:
        """Raise an error if the stars are not a catalog with the column; an empty path stands for no catalog."""
        if self.stars == "":
            object.__setattr__(self, "stars", None)
        if not isinstance(self.stars, Catalog | str | None):
            raise refusal("stars must be a Catalog or the path of its file", self.stars, Catalog)
        if self.stars is not None and self.column not in self._catalog.arrays.extra:
            known = listed(self._catalog.arrays.extra, 8)
            raise InputError(f"the catalog of stars must have the column {self.column!r}, but its columns are: {known}")
        if self.stars is not None:
            check_unit(self.column, self._catalog.arrays.extra_units[self.column])

    def __str__(self):
        values = [(getattr(self, one.name), one.default) for one in fields(self)]
        while values and values[-1][0] == values[-1][1]:
            values.pop()
        words = [self._digest if isinstance(value, Catalog) else value for value, _ in values]
        words = [name_of(word) if callable(word) else "" if word is None else str(word) for word in words]
        return " ".join([self.name, *map(quote, words)])

    @cached_property
    def _catalog(self) -> Catalog:
        """The catalog with the stars."""
        return Catalog.read(self.stars, keep=[self.column]) if isinstance(self.stars, str) else self.stars

    @cached_property
    def _digest(self) -> str:
        arrays = self._catalog.arrays
        digest = sha256(arrays.vectors.tobytes() + np.asarray(arrays.extra[self.column]).tobytes()).hexdigest()
        return f"{len(self._catalog)} stars, digest {digest[:16]}"

    @property
    def content(self) -> str:
        """The number and a digest of the stars of a second catalog; empty text if the stars are targets."""
        return "" if self.stars is None else self._digest

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the catalog that the rule uses; none if the stars are those of a second catalog."""
        return super().columns if self.stars is None else ()

    @property
    def uses_targets(self) -> bool:
        """Whether the stars are targets of the catalog, also outside the field."""
        return self.stars is None

    def _stars(self, field: ConstraintField) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return magnitudes and directions of all stars with both, and their identifiers if they are targets."""
        if self.stars is None:
            m, vectors, ids = np.where(field.kind == "sky", np.nan, self._magnitudes(field)), field.vectors, field.id
        else:
            arrays = self._catalog.arrays
            m, vectors, ids = to_magnitudes(arrays.extra[self.column], self.column), arrays.vectors, None
        rows = np.flatnonzero(np.isfinite(m) & np.isfinite(vectors).all(axis=1))
        return m[rows], vectors[rows], None if ids is None else ids[rows]
