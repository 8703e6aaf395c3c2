"""Scan designs around the design of an instrument, and sensitivities of the results to the parameters of designs."""

from collections.abc import Sequence
from dataclasses import dataclass
from inspect import signature

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._common.settings import Option, number_within
from rfpsurvey._common.units import to_plain
from rfpsurvey._instruments.facts import arm_facts
from rfpsurvey._instruments.instrument import Instrument, as_instrument
from rfpsurvey._studies.design import explore_designs, scan
from rfpsurvey._studies.design_rows import AXES, instruments_of, set_formats, to_axes
from rfpsurvey.errors import InputError, check_choice, check_keywords, check_whole, warn

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
        table = table[instruments_of(table) == ""]
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


N_POINTS = 2**16
SAME = 1e-9
"""Two designs are equal if the relative differences of their parameters are below this value."""


@dataclass(frozen=True, eq=False)
class Start:
    """The design of an instrument."""

    name: str
    design: np.ndarray
    """central_arm, ratio, pitch and clearance, with lengths in mm."""
    step: float
    """Motor step, in radians."""

    def among(self, designs: np.ndarray) -> tuple[np.ndarray, int, dict]:
        """Return the designs including the design of the instrument, its row number, and a description for ``meta``."""
        same = np.isclose(designs, self.design, rtol=SAME, atol=0).all(axis=1)
        added = not same.any()
        record = {"name": self.name, "added": added, **dict(zip(AXES, self.design.tolist(), strict=True))}
        return (np.vstack([designs, self.design]), len(designs), record) if added else (designs, same.argmax(), record)


def start_of(model: Instrument) -> Start:
    """Return the design of an instrument: its arms, the pitch of its lattice, and its clearance and motor step."""
    if len(model.focal_plane) < 2:
        raise InputError(
            f"{model.name} must have at least two positioners, because a design needs a pitch, got one positioner"
        )
    if model.focal_plane.margins:
        raise InputError(
            f"{model.name} must have no margins, because the designs of a scan have none, got "
            f"{model.focal_plane.margins}; use the instrument without with_margins"
        )
    if "module" in (model.focal_plane.groups or {}):
        reach = 1 - model.focal_plane.coverage(n_points=N_POINTS, rng=0)[0]
        warn(
            f"the designs are infinite lattices without the gaps between the modules of {model.name}: all values refer "
            f"to the lattice inside a module; positioners of {model.name} reach {reach:.3f} of its focal plane"
        )
    arm_model = model.focal_plane.positioner.arm_model
    if "elbow_to_tip" in model.arm_models:
        model = model.with_arm_model("elbow_to_tip")
    elif arm_model == "outline":
        raise InputError(
            f"{model.name} must have the entry positioner.segment_clearance, because a scan of designs replaces the "
            "outline of the arms by a segment with this clearance, got no such entry"
        )
    facts = {name: float(value.to_value(u.mm)) for name, value in arm_facts(model).items()}
    unit = model.focal_plane.positioner
    if arm_model != "elbow_to_tip":
        warn(
            f"the scan uses the arm model 'elbow_to_tip' with a clearance of {unit.numbers.clearance:g} mm instead of "
            f"the arm model {arm_model!r} of {model.name}"
        )
    central_arm, eccentric_arm, clearance = facts["central_arm"], facts["eccentric_arm"], unit.numbers.clearance
    # the minimum separation is 2 c + (l1 + l2) sin(2 step), from which the step follows
    moved = (facts["min_separation"] - 2 * clearance) / (central_arm + eccentric_arm)
    if not moved < 1:
        raise InputError(
            f"the displacement of an arm of {model.name} within a motor step must be less than the total length of "
            "both arms"
        )
    design = np.array([central_arm, eccentric_arm / central_arm, facts["pitch"], clearance])
    return Start(model.name, design, float(np.arcsin(max(moved, 0.0)) / 2))


VARIED = ("central_arm", "ratio", "pitch")


def explore_around(
    instrument: Instrument | str,
    *,
    spread: float = 0.15,
    n_nodes: int = 5,
    n_designs: int | None = None,
    **others: object,
) -> QTable:
    """Scan designs around the design of an instrument; the table also contains the design of the instrument itself.

    The design of an instrument consists of the lattice and the arms of its positioners, without edges, obstacles, joint
    limits and broken positioners. See `explore_designs`.

    Parameters
    ----------
    instrument : Instrument or str
        Instrument, name of a preset, or path of a TOML file.
    spread : float, optional
        Fraction by which the central arm, the ratio of the arms and the pitch may be smaller or larger than the values
        of the instrument. All designs have the clearance and the motor step of the instrument.
    n_nodes : int, optional
        Number of values of each parameter that varies; all combinations are scanned.
    n_designs : int, optional
        Number of Sobol points between the limits that ``spread`` sets, instead of a grid.
    **others
        Parameters of `explore_designs`. If parameters of the design (``central_arm``, ``ratio``, ``pitch``,
        ``clearance``, ``step``) are given, they replace the values that follow from the instrument.

    Returns
    -------
    QTable
        Table of `explore_designs` with an additional column ``instrument``, which contains the name of the instrument
        in the row of its design and ``""`` in all other rows. If the scan does not include the design of the
        instrument, this design is added as the last row.

    Raises
    ------
    InputError
        If the instrument is unknown or has only one positioner, or if `explore_designs` raises an error.

    Warns
    -----
    RfpsurveyWarning
        If the arm model of the instrument is not ``elbow_to_tip``. All designs have the arm model ``elbow_to_tip``.

    See Also
    --------
    rfpsurvey.design.design_improvements : Compare the instrument with the best designs.
    rfpsurvey.plot.plot_designs : Plot the designs, the Pareto front and the instrument.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> table = rs.design.explore_around("lamost", spread=0.1, n_nodes=3)
    >>> len(table), table[table["instrument"] == "lamost"]["central_arm", "ratio", "pitch"].as_array().tolist()
    (27, [(8.25, 1.0, 25.6)])
    """
    parameters = signature(explore_designs).parameters
    for name in others:
        check_choice(name, parameters, "parameter of explore_designs")
    usual = {name: parameter.default for name, parameter in parameters.items() if name not in AXES}
    start = start_of(as_instrument(instrument))
    design = dict(zip(AXES, start.design.tolist(), strict=True))
    factors = _factors(spread, n_nodes, n_designs)
    values = {name: design[name] * (factors if name in VARIED else 1.0) for name in AXES}
    values = {name: value if name == "ratio" else value * u.mm for name, value in values.items()}
    values |= {name: others.pop(name) for name in AXES if name in others}
    return scan(to_axes(**values), start, **{**usual, "n_designs": n_designs, "step": start.step * u.rad, **others})


def design_improvements(table: QTable) -> QTable:
    """Compare an instrument with the best designs of a scan, for each objective.

    For each objective, the best design is selected from the designs that are at least as good as the instrument in the
    other objective.

    Parameters
    ----------
    table : QTable
        Table returned by `explore_around`.

    Returns
    -------
    QTable
        Table with a row for each objective: ``objective``; ``value`` (value of this objective for the instrument);
        ``best`` (value of this objective for the best design, or for the instrument if no design is better);
        ``change`` (``best`` minus ``value``); ``other`` (value of the other objective for the best design);
        ``central_arm``, ``ratio``, ``pitch`` and ``clearance`` of the best design. The values of objectives are plain
        numbers, in the units of the columns of ``table``.

    Raises
    ------
    InputError
        If ``table`` was not returned by `explore_around`, or if the instrument has no values of the objectives.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> table = rs.design.explore_around("lamost", spread=0.1, n_nodes=3)
    >>> found = rs.design.design_improvements(table)
    >>> for row in found:
    ...     print(f"{row['objective']} {row['value']:.3f}, at best {row['best']:.3f}: pitch {row['pitch']:.4g}")
    coverage 1.000, at best 1.000: pitch 25.6 mm
    loss 0.109, at best 0.041: pitch 28.16 mm
    """
    if not isinstance(table, QTable) or "instrument" not in table.colnames or "objectives" not in table.meta:
        raise InputError("table must be a table that explore_around returned")
    rows = np.flatnonzero(instruments_of(table) != "")
    if len(rows) != 1:
        raise InputError(f"table must have one row for the design of an instrument, got {len(rows)} rows")
    objectives = table.meta["objectives"]
    plain = {name: to_plain(table[name]) for name in objectives}
    gain = {name: -plain[name] if aim == "min" else plain[name] for name, aim in objectives.items()}
    row, rows_of_objectives = rows[0], []
    if not all(np.isfinite(values[row]) for values in gain.values()):
        raise InputError(
            f"{table['instrument'][row]} has no values of {' and '.join(objectives)}: {table['reason'][row]}"
        )
    for name, other in zip(objectives, reversed(objectives), strict=True):
        known = np.isfinite(gain[name]) & (gain[other] >= gain[other][row])
        best = max(np.flatnonzero(known), key=lambda k: (gain[name][k], gain[other][k], k == row))
        best = best if gain[name][best] > gain[name][row] else row
        rows_of_objectives.append(
            {
                "objective": name,
                "value": plain[name][row],
                "best": plain[name][best],
                "change": plain[name][best] - plain[name][row],
                "other": plain[other][best],
                **{axis: table[axis][best] for axis in AXES},
            }
        )
    improvements = QTable(rows=rows_of_objectives)
    set_formats(improvements)
    return improvements


def _factors(spread, n_nodes, n_designs):
    """Return the factors by which the parameters of an instrument are multiplied.

    These are the nodes of a grid or, if a number of random designs is given, the smallest and the largest factor.
    """
    spread = number_within(spread, "spread", Option(above=0, below=1))
    check_whole(n_nodes, "n_nodes", 2, 1000)
    return 1 + spread * np.linspace(-1, 1, n_nodes if n_designs is None else 2)
