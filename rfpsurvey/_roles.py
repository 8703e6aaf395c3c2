"""The roles of targets: science, standard and sky; the kind of a target with several roles joins them by plus signs."""

from collections.abc import Iterable
from itertools import combinations

import numpy as np

from rfpsurvey._units import to_plain
from rfpsurvey.errors import InputError, short

KINDS = ("science", "standard", "sky")
JOINED = tuple("+".join(names) for n in (2, 3) for names in combinations(KINDS, n))
"""Kinds of targets with several roles, such as ``science+standard``."""


def to_kinds(values: object, name: str, *, strict: bool = True) -> np.ndarray:
    """Convert text to kinds with their roles in the order of `KINDS`.

    If ``strict`` is true, other text is an error; otherwise, it remains unchanged.
    """
    values = to_plain(values, name).astype(str)
    kinds, rows = np.unique(values, return_inverse=True)
    ordered = []
    for kind in kinds.tolist():
        roles = {role.strip() for role in kind.lower().split("+")}
        if strict and not roles <= {*KINDS}:
            raise InputError(
                f"{name} must be science, standard or sky, or several of them joined by '+', such as "
                f"science+standard, got {short(kind)}"
            )
        ordered.append("+".join(role for role in KINDS if role in roles) if roles <= {*KINDS} else kind)
    ordered = np.array(ordered, dtype=str)
    # equal catalogs have the same digest only if the length of the text remains the same
    return ordered.astype(np.promote_types(ordered.dtype, values.dtype))[rows].reshape(values.shape)


def has_role(kind: np.ndarray, role: str) -> np.ndarray:
    """Return whether each target has a role; ``kind`` contains kinds as `to_kinds` returns them."""
    matches = kind == role
    if np.asarray(kind).dtype.itemsize > 4 * len("standard"):  # other kinds are too short for several roles
        for joined in JOINED:
            if role in joined.split("+"):
                matches = matches | (kind == joined)
    return matches


def count_also_science(kind: np.ndarray, counted: Iterable[str]) -> int:
    """Return the number of science targets that also have a role for which there is a requirement.

    ``counted`` contains the kinds and categories that requirements count.
    """
    has_counted = [has_role(kind, role) for role in {*KINDS[1:]}.intersection(counted)]
    return int((has_role(kind, "science") & np.any(has_counted, axis=0)).sum())


def without_science(kind: np.ndarray) -> np.ndarray:
    """Return kinds without the role science, for targets that have other roles."""
    return _without(kind, "science+")


def last_role(kind: np.ndarray) -> np.ndarray:
    """Return the last role of each target, for files that have one role for each target."""
    return np.array([roles.rpartition("+")[2] for roles in kind.tolist()], dtype=kind.dtype)


def without_role(kind: np.ndarray, role: str, where: np.ndarray) -> np.ndarray:
    """Return kinds in which the marked targets, which also have other roles, do not have a role."""
    return np.where(where, _without(_without(kind, f"{role}+"), f"+{role}"), kind)


def _without(kind: np.ndarray, text: str) -> np.ndarray:
    return np.char.replace(kind, text, "") if kind.size else kind


def count_roles(kind: np.ndarray) -> str:
    """Return text with the number of targets of each kind, or empty text if no target has several roles."""
    kinds, counts = np.unique(kind, return_counts=True)
    order = [roles for roles in (*JOINED, *KINDS) if roles in kinds]
    if not {*order} & {*JOINED}:
        return ""
    number = dict(zip(kinds.tolist(), counts.tolist(), strict=True))
    return "roles: " + ", ".join(f"{number[roles]} {roles.replace('+', ' and ')}" for roles in order)
