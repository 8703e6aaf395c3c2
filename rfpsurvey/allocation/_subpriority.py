"""Subpriorities: reproducible random numbers that order the targets within each priority class."""

import numpy as np

from rfpsurvey._kernels import hashing
from rfpsurvey._units import rows_of, to_plain
from rfpsurvey.errors import INCONVERTIBLE, InputError, InputTypeError, listed, short

# Seed of the hash by which ``optimal`` breaks ties.
TIE_SEED = 0
# Positions that agree in this length (mm) have the same hash.
SAME_POSITION_MM = 1e-6


def id_numbers(ids: np.ndarray) -> np.ndarray:
    """Return one number per identifier; the random subpriorities of targets are computed from these numbers.

    Parameters
    ----------
    ids : ndarray of int or str, shape (n,)
        Identifiers. An integer and the text of this integer have the same number.

    Returns
    -------
    ndarray of uint64, shape (n,)
        The number of each identifier.
    """
    ids = np.asarray(ids)
    if ids.dtype.kind in "iu":
        return ids.astype(np.int64 if ids.dtype.kind == "i" else np.uint64).view(np.uint64)
    texts = ids.astype(str)
    texts = np.ascontiguousarray(texts, dtype=texts.dtype.newbyteorder("="))
    out = np.empty(len(texts), dtype=np.uint64)
    length = texts.dtype.itemsize // 4
    hashing.numbers_of_texts(texts.view(np.uint32).reshape(len(texts), length), out)
    return out


def subpriorities(ids: np.ndarray, seed: int) -> np.ndarray:
    """Return reproducible random subpriorities of targets, which depend only on their identifiers and a seed.

    Parameters
    ----------
    ids : array_like of int or str, shape (n,)
        Identifiers. An integer and the text of this integer have the same subpriority.
    seed : int
        Seed, 0 to 2^63 - 1.

    Returns
    -------
    ndarray of float, shape (n,)
        Subpriorities, which are uniformly distributed in [0, 1). The subpriorities are the same on all computers.

    Raises
    ------
    InputError
        If the identifiers are neither integers nor text, or if the seed is not an integer in the allowed range.

    Notes
    -----
    If an identifier is an integer or the text of an integer, its number is this integer. Otherwise, its number is the
    hash FNV-1a of the text. The number and the seed are combined by the output function of the generator
    SplitMix64 (Steele, Lea & Flood 2014, doi:10.1145/2660193.2660195).

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> rs.allocation.subpriorities([7, 8], seed=1).round(4).tolist()
    [0.4652, 0.1724]
    """
    ids = to_plain(ids, "ids")
    if ids.ndim != 1 or ids.dtype.kind not in "iuUS":
        raise InputError(f"ids must be integers or text, shape (n,), got {ids.dtype.name} of shape {ids.shape}")
    if ids.dtype.kind == "S":
        ids = np.char.decode(ids, "utf-8")
    return subpriorities_of(id_numbers(ids), check_seed(seed))


def check_seed(seed: object) -> int:
    """Convert a seed of subpriorities to an integer."""
    if isinstance(seed, bool | np.bool_) or not isinstance(seed, int | np.integer):
        raise InputTypeError(f"the seed of subpriorities must be an integer, got {short(seed)}")
    if not 0 <= seed < 2**63:
        raise InputError(f"the seed of subpriorities must be from 0 to 2^63 - 1, got {short(seed)}")
    return int(seed)


def subpriorities_of(numbers: np.ndarray, seed: int) -> np.ndarray:
    """Return the subpriorities of the targets with given `id_numbers`; the seed is not checked."""
    out = np.empty(len(numbers))
    hashing.uniforms(numbers, np.uint64(seed), out)
    return out


def to_subpriorities(given: int | str, ids: np.ndarray, extra: dict | None) -> np.ndarray:
    """Return the subpriorities of the targets of a field.

    Parameters
    ----------
    given : int or str
        Seed, or the name of a column of the catalog.
    ids : ndarray of int or str, shape (n,)
        Identifiers of the targets.
    extra : dict or None
        Additional columns of the catalog: a dictionary of column names to values.

    Returns
    -------
    ndarray of float, shape (n,)
        Subpriority of each target.

    Raises
    ------
    InputError
        If there is no such column, or if it does not contain one finite number per target.
    """
    if not isinstance(given, str):
        return subpriorities_of(id_numbers(ids), given)
    if given not in (extra or {}):
        raise InputError(
            f"subpriority must be a seed or the name of an additional column that was read from the catalog by keep= "
            f"or --set catalog.keep=NAME, got {given!r}; additional columns: {listed(extra or ())}"
        )
    return check_values(extra[given], len(ids), f"the subpriorities (column {given!r})")


def check_values(values: object, n: int, what: str) -> np.ndarray:
    """Convert subpriorities to numbers; raise an error unless each target has a finite number."""
    plain = to_plain(values, what, "numbers")
    try:
        numbers = plain.astype(float)
    except INCONVERTIBLE as error:
        raise InputError(f"{what} must be numbers: {error}") from None
    return check_one_each(numbers, n, what)


def check_one_each(values: np.ndarray, n: int, what: str) -> np.ndarray:
    """Return numbers or texts unchanged; raise an error unless each target has a finite number or a text."""
    if values.shape != (n,):
        raise InputError(f"{what} must have one value per target, shape ({n},), got {values.shape}")
    if values.dtype.kind != "U" and (lacking := ~np.isfinite(values)).any():
        raise InputError(f"{what} must be a finite number for every target, but {rows_of(lacking)} have none")
    return values


def service_order(values: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Return the rows of targets in order of decreasing subpriority; ties are decided by `id_numbers`.

    Parameters
    ----------
    values : ndarray of float, shape (n,)
        Subpriorities.
    ids : ndarray of int or str, shape (n,)
        Identifiers.

    Returns
    -------
    ndarray of int, shape (n,)
        Rows of the targets; the target with the largest subpriority is first.
    """
    order = np.argsort(-values)
    if (np.diff(values[order]) == 0).any():
        order = np.lexsort((id_numbers(ids), -values))
    return order


def tie_order(xy_mm: np.ndarray, ids: np.ndarray | None = None) -> np.ndarray:
    """Return the rows of targets in an order that does not depend on the order of the catalog.

    The targets are sorted by a hash of their identifiers or, if there are no identifiers, of their positions.

    Parameters
    ----------
    xy_mm : ndarray of float, shape (n, 2)
        Positions on the focal plane, mm.
    ids : ndarray of int or str, shape (n,), optional
        Identifiers.

    Returns
    -------
    ndarray of int, shape (n,)
        Rows of the targets.
    """
    if ids is not None:
        return service_order(subpriorities_of(id_numbers(ids), TIE_SEED), ids)
    whole = np.rint(np.nan_to_num(xy_mm) / SAME_POSITION_MM).astype(np.int64)
    x, y = np.ascontiguousarray(whole.T).view(np.uint64)
    return service_order(subpriorities_of(subpriorities_of(x, TIE_SEED).view(np.uint64) ^ y, TIE_SEED), y)
