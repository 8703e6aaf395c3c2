"""Sensitivities of the results of a scan to the parameters of the designs."""

from collections.abc import Sequence

import numpy as np
from astropy.table import QTable

from rfpsurvey._units import to_plain
from rfpsurvey.design._rows import AXES, set_formats
from rfpsurvey.errors import InputError, check_choice, check_keywords

DEGREE = 4


@check_keywords
def design_sensitivities(
    table: QTable, *, figures: Sequence[str] = ("coverage", "loss", "usable", "usable_per_area")
) -> QTable:
    """Return the fraction of the variance of each column that each parameter of a scan explains.

    The values of a column are fitted by a sum of polynomials, one for each parameter that varies. A polynomial has
    degree four, or less if the parameter has fewer than five values. The share of a parameter is the variance of its
    polynomial divided by the variance of the column. This is the first-order Sobol index; it is exact on a grid with at
    most five values of each parameter. The rest of the variance is due to interactions between parameters and to noise
    in the values of the column. Random noise increases each share by at most about the number of coefficients of the
    polynomial divided by the number of designs.

    Parameters
    ----------
    table : QTable
        Table returned by `~rfpsurvey.design.explore_designs`. Designs without values are ignored. The design of an
        instrument is also ignored if `~rfpsurvey.design.explore_around` added it to the scan.
    figures : sequence of str, optional
        Names of the columns whose variance is analyzed.

    Returns
    -------
    QTable
        Table with a row for each pair of an explained column and a parameter that varies, and a row ``rest`` for the
        unexplained variance of each column. Columns: ``figure`` (the explained column), ``parameter``, ``share`` (0 to
        1; NaN for values that do not vary), and ``slope`` (change of the values in percent if the parameter grows by
        one percent). The slope is computed at the mean of all designs, from a fit that is linear in all parameters.

    Raises
    ------
    InputError
        If a column is missing or does not contain numbers, if no parameter varies, or if the number of designs with
        values is not larger than the number of coefficients of the fit.

    See Also
    --------
    rfpsurvey.design.explore_designs : Scan many designs.

    References
    ----------
    Sobol, I. M. 2001, Mathematics and Computers in Simulation, 55, 271 (indices).

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> import rfpsurvey as rs
    >>> table = rs.design.explore_designs(
    ...     central_arm=[7, 8, 9] * u.mm, ratio=[1, 1.2], pitch=[24, 26] * u.mm, clearance=2.25 * u.mm
    ... )
    >>> found = rs.design.design_sensitivities(table, figures=["loss"])
    >>> [str(name) for name in found["parameter"]]
    ['central_arm', 'ratio', 'pitch', 'rest']
    """
    if not isinstance(table, QTable) or not {*AXES, "loss"} <= set(table.colnames):
        raise InputError("table must be a table that explore_designs returned")
    figures = [figures] if isinstance(figures, str) else list(figures)
    numbers = [name for name in table.colnames if table[name].dtype.kind in "if"]
    for name in figures:
        check_choice(name, numbers, "column of designs")
    start = table.meta.get("request", {}).get("start", {})
    if start.get("added"):  # the design of an instrument would make a grid irregular
        table = table[np.asarray(np.ma.filled(table["instrument"], "")) == ""]
    known = np.isfinite(to_plain(table["loss"]))
    values = {name: to_plain(table[name])[known] for name in AXES}
    axes = {name: v for name, v in values.items() if len(v) and np.ptp(v) > 0}
    if not axes:
        raise InputError("at least one of central_arm, ratio, pitch and clearance must vary among designs with values")
    blocks = {name: _polynomials(v) for name, v in axes.items()}
    n_terms = 1 + sum(block.shape[1] for block in blocks.values())
    if known.sum() <= n_terms:
        raise InputError(f"sensitivities need more than {n_terms} designs with values, got {int(known.sum())}")
    rows = []
    for figure in figures:
        y = to_plain(table[figure])[known].astype(float)
        shares = _shares(y, blocks)
        slopes = _slopes(y, axes)
        rows += [(figure, name, shares[name], slopes.get(name, np.nan)) for name in [*axes, "rest"]]
    sensitivities = QTable(rows=rows, names=("figure", "parameter", "share", "slope"))
    set_formats(sensitivities)
    return sensitivities


def _polynomials(x):
    """Return the values of polynomials of a parameter as columns, each with the mean 0."""
    degree = min(DEGREE, len(np.unique(x)) - 1)
    scaled = 2 * (x - x.min()) / np.ptp(x) - 1
    block = np.polynomial.legendre.legvander(scaled, degree)[:, 1:]
    return block - block.mean(axis=0)


def _shares(y, blocks):
    """Return the fraction of the variance that each block of columns explains, and the unexplained fraction."""
    variance = float(y.var())
    if variance <= (1e-12 * np.abs(y).max(initial=0.0)) ** 2:
        return dict.fromkeys([*blocks, "rest"], np.nan)
    weights = np.linalg.lstsq(np.column_stack(list(blocks.values())), y - y.mean(), rcond=None)[0]
    parts = np.split(weights, np.cumsum([block.shape[1] for block in blocks.values()])[:-1])
    fits = {name: block @ part for (name, block), part in zip(blocks.items(), parts, strict=True)}
    left = y - y.mean() - sum(fits.values())
    return {name: float(fit.var() / variance) for name, fit in fits.items()} | {"rest": float(left.var() / variance)}


def _slopes(y, axes):
    """Return the relative change of a column per relative change of each parameter, at the mean of the designs."""
    if y.mean() == 0:
        return {}
    x = np.column_stack([v / v.mean() - 1 for v in axes.values()])
    slopes = np.linalg.lstsq(np.column_stack([np.ones(len(y)), x]), y / y.mean(), rcond=None)[0][1:]
    return dict(zip(axes, slopes.tolist(), strict=True))
