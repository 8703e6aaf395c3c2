"""Rules that determine the requested visits and the priority of a target from what was observed."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from astropy.table import QTable, Table

from rfpsurvey._common.plugins import find_function, name_of, recorded_name
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._common.settings import Settings, option
from rfpsurvey._common.units import MOST_VISITS, exact_text, to_dimensionless, to_numbers, to_plain, to_visits
from rfpsurvey.errors import InputError, check_choice, check_keywords, listed

GROUP = "rfpsurvey.visit_rules"
"""Name of the entry points of packages with visit rules."""
ANY = "any"
LAST = ("none", "good", "bad")
"""Results of the last visit of a target."""
COLUMNS = ("class", "observed", "last", "priority", "visits")
# Number of targets with which the end of a rule is checked.
PROBED = 1000


@check_keywords
@dataclass(frozen=True, eq=False, repr=False)
class VisitRule(Settings):
    """A rule that determines how often a target is observed, and with which priority, from its visits so far.

    Without a rule, each target is observed until the visits that the catalog requests are successful. The parameters
    are applied in their order; later ones replace the numbers of visits of earlier ones.

    Parameters
    ----------
    visits : int, optional
        Requested number of visits of each target, instead of the column ``visits`` of the catalog.
    after_success : int, optional
        Requested number of visits of each target whose first visit was successful; before this visit, one visit is
        requested.
    table : Table or path-like, optional
        Table with the columns ``visits`` or ``priority``, or both, and with columns that select targets: ``class`` (a
        category or a priority of the catalog, or ``any``), ``observed`` (the number of successful visits; -1 for any)
        and ``last`` (the result of the last visit: ``none``, ``good``, ``bad`` or ``any``). The first row that selects
        a target determines its priority and its requested number of visits. Values that are missing, and targets that
        no row selects, remain unchanged.
    function : str or callable, optional
        Function, or the name of an entry point of the group ``rfpsurvey.visit_rules``. It is called with a table of all
        targets (``target_id``, ``requested``, ``observed``, ``failed``, ``last`` and, if the catalog has them,
        ``priority`` and ``category``), and returns a dict or a table with the columns ``visits`` or ``priority``, or
        both.
    retries : int, optional
        Largest number of failed visits after which a target is still observed. By default, failed visits are repeated
        without limit. The visits of a tile whose observation failed as a whole are not counted.

    Raises
    ------
    InputError
        If a number is out of range, if a column of the table is missing, or if the rule requests more than 255 visits.

    Notes
    -----
    The attribute ``record`` contains the rows of ``table``, and only the name of ``function``. ``from_record`` raises
    an error if this is not the name of an entry point.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> rule = rs.survey.VisitRule(after_success=4, retries=2)
    >>> rule.record["after_success"]
    4
    """

    visits: int | None = option(None, low=0, high=MOST_VISITS, sparse=True)
    after_success: int | None = option(None, low=1, high=MOST_VISITS, sparse=True)
    table: Table | str | os.PathLike | None = option(
        None,
        words="a table or the path of a table",
        to_record="_recorded_rows",
        from_record=lambda rows: _table_of(rows),
        by_record=True,
        sparse=True,
    )
    function: str | Callable | None = option(
        None,
        words="a function or its name",
        to_record=name_of,
        from_record=lambda name: recorded_name(GROUP, (), name, "function"),
        sparse=True,
    )
    retries: int | None = option(None, low=0, high=MOST_VISITS, sparse=True)

    _order = ("visits", "after_success", "retries")

    def _check(self):
        if self.function is not None:
            _ = self._function  # raises an error if there is no such function
        if self.table is not None:
            _ = self._rows  # raises an error if the table is not valid

    @cached_property
    def _recorded_rows(self) -> list:
        return [[None if value != value else value for value in row] for row in self._rows]  # JSON has no NaN

    def apply(self, columns: dict) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the requested numbers of visits and the priorities.

        Parameters
        ----------
        columns : dict
            Arrays ``requested``, ``observed`` and ``failed`` (numbers of visits), ``last`` (index of ``LAST``), ``id``,
            and ``priority`` and ``category``, which can be None.

        Returns
        -------
        visits : ndarray of uint8, shape (n_targets,)
            Requested numbers of visits.
        priority : ndarray or None
            Priorities; None if there are none.
        """
        n = len(columns["observed"])
        visits, priority = columns["requested"], columns["priority"]
        if self.visits is not None:
            visits = np.full(n, self.visits, dtype=np.uint8)
        if self.after_success is not None:
            visits = np.where(visits == 0, 0, np.where(columns["observed"] > 0, self.after_success, 1))
        if self.table is not None:
            visits, priority = self._by_table(columns, visits, priority)
        if self.function is not None:
            visits, priority = self._by_function(columns, visits, priority)
            probed = {k: v[:PROBED] if isinstance(v, np.ndarray) else v for k, v in columns.items()}
            probed["observed"] = np.full(len(probed["observed"]), MOST_VISITS)
            self._by_function(probed, visits[:PROBED], priority if priority is None else priority[:PROBED])
        if self.retries is not None:
            visits = np.where(columns["failed"] > self.retries, np.minimum(visits, columns["observed"]), visits)
        return visits.astype(np.uint8), priority

    @cached_property
    def _rows(self) -> list[tuple]:
        """The rows of the table: class, number of visits, last result, priority and requested visits."""
        table = self.table if isinstance(self.table, Table) else read_table(self.table)
        strange = [name for name in table.colnames if name not in COLUMNS]
        if strange or not {"priority", "visits"} & {*table.colnames}:
            raise InputError(
                f"the table of a visit rule must have the column visits or priority, and may have the columns "
                f"{listed(COLUMNS[:3])}, got {listed(table.colnames)}"
            )
        n = len(table)
        names, last = (_words(table, name) for name in ("class", "last"))
        for result in last:
            check_choice(result, (*LAST, ANY), "last result of a visit rule")
        numbers = {name: np.full(n, np.nan) for name in COLUMNS if name not in ("class", "last")}
        for name in {*numbers} & {*table.colnames}:
            numbers[name] = to_numbers(table[name], f"{name} of a visit rule", unitless=True)
        observed, priority, visits = (numbers[name] for name in ("observed", "priority", "visits"))
        observed = np.where(np.isnan(observed), -1, observed)
        wrong = observed[~((observed >= -1) & (observed <= MOST_VISITS) & (observed == np.floor(observed)))]
        if wrong.size:
            raise InputError(
                f"observed of a visit rule must be whole numbers from 0 to {MOST_VISITS}, or -1, got {wrong[0]:g}"
            )
        if np.isinf(priority).any():
            raise InputError("priority of a visit rule must be finite, got inf")
        to_visits(visits[~np.isnan(visits)], int((~np.isnan(visits)).sum()))
        columns = (names, observed.astype(int).tolist(), last, priority.tolist(), visits.tolist())
        return list(zip(*columns, strict=True))

    def _by_table(self, columns: dict, visits: np.ndarray, priority: np.ndarray | None):
        """Return visits and priorities, changed by the first row of the table that selects each target."""
        free = np.ones(len(visits), dtype=bool)
        visits, new = visits.astype(np.uint8), None if priority is None else priority.astype(float)
        for name, observed, last, row_priority, row_visits in self._rows:
            rows = free & _of_class(name, priority, columns["category"], len(visits))
            if observed >= 0:
                rows &= columns["observed"] == observed
            if last != ANY:
                rows &= columns["last"] == LAST.index(last)
            free &= ~rows
            if row_visits == row_visits:
                visits[rows] = row_visits
            if row_priority == row_priority:
                new = np.zeros(len(visits)) if new is None else new
                new[rows] = row_priority
        return visits, new

    @cached_property
    def _function(self):
        return find_function(GROUP, self.function, (), "visit rule")

    def _by_function(self, columns: dict, visits: np.ndarray, priority: np.ndarray | None):
        table = QTable({"target_id": columns["id"], "requested": visits})
        for name in ("observed", "failed", "priority", "category"):
            if columns[name] is not None:
                table[name] = columns[name]
        table["last"] = np.array(LAST)[columns["last"]]
        with self._function.answering():
            answer = self._function.value(table)
            names = list(answer.keys()) if isinstance(answer, dict | Table) else []
            if not names or {*names} - {"visits", "priority"}:
                raise InputError(
                    "it must return a dict or a table with the columns visits or priority, got another result"
                )
            if "visits" in names:
                if np.max(answer["visits"], initial=0) > MOST_VISITS:
                    observed = int(np.min(columns["observed"], initial=MOST_VISITS))
                    end = "must end" if observed == MOST_VISITS else f"must request at most {MOST_VISITS} visits"
                    raise InputError(
                        f"it {end}, got {np.max(answer['visits']):g} requested visits of a target that was observed "
                        f"{observed} times"
                    )
                visits = to_visits(answer["visits"], len(visits))
            if "priority" in names:
                priority = to_dimensionless(answer["priority"], "priority").astype(float)
                if priority.shape != visits.shape or not np.isfinite(priority).all():
                    raise InputError("its priorities must be finite numbers, one for each target")
        return visits, priority


def _of_class(name: str, priority: np.ndarray | None, category: np.ndarray | None, n: int) -> np.ndarray:
    """Return which targets have the category or the priority ``name``."""
    is_in_class = np.full(n, name == ANY)
    if category is not None:
        is_in_class |= category == name
    if priority is not None:
        values = np.unique(priority)
        same = [value for value in values.tolist() if exact_text(value) == name]
        is_in_class |= np.isin(priority, same)
    return is_in_class


def _words(table: Table, name: str) -> list[str]:
    """Return the words in a column of a rule; numbers have their shortest text, and missing values stand for any."""
    if name not in table.colnames:
        return [ANY] * len(table)
    values = to_plain(table[name], name)
    texts = [exact_text(value) if values.dtype.kind in "iuf" else str(value).strip() for value in values.tolist()]
    return [ANY if text in ("", "nan") else text for text in texts]


def _table_of(rows: list) -> Table:
    """Return the table of a rule for the rows in a record."""
    columns = {"class": np.array([], dtype=str), "priority": [], "visits": []}
    if rows:
        columns = dict(zip(COLUMNS, zip(*rows, strict=True), strict=True))
    numbers = {name: np.array(columns[name], dtype=float) for name in ("priority", "visits")}
    return Table(columns | numbers)
