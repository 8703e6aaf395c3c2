"""Comparison of uniform and Poisson-distributed targets, for every interpretation of the paper."""

from itertools import pairwise

import astropy.units as u
import numpy as np
from astropy.table import QTable, vstack

from reproduction._claims import NOT_REPRODUCED, REPRODUCED, UNDECIDED, Claim
from reproduction._designs import LARGE, N_TARGETS, Settings, each, estimate, numbers_of, random_designs
from reproduction._large import NAMED, uniform_estimate
from rfpsurvey.probability import RandomTargets

__all__ = ["drops_by_ratio", "poisson"]

PAPER = 2.6
"""Percentage by which, in the paper, the probability is larger with uniform than with Poisson-distributed targets."""
MARGIN = 0.2
"""Minimum tolerance for the agreement of a result with the paper, in percentage points.

The tolerance is this number or two standard errors of the result, whichever is larger.
"""
SEPARATIONS = (0.52, 1.05, 1.57, 1.9, 2.0)
"""Minimum separations (mm) of Poisson-disc targets.

With separations above 2.09 mm, 20,000 random targets would not fit into the circle with the radius 200 mm.
"""
DISCS = {f"disc, separation {s:.2f} mm": s for s in SEPARATIONS}
"""Minimum separation (mm) in each interpretation with Poisson-disc targets, by the name of the interpretation."""
POINT_PROCESS, COORDINATES = (
    "point process",
    ("Poisson coordinates with mean 100 mm", "Poisson coordinates with 3 standard deviations = 200 mm"),
)
PLACES = {name: k for k, name in enumerate([POINT_PROCESS, *DISCS, *COORDINATES])}
"""Number that identifies each interpretation of the paper in the random seeds, by the name of the interpretation."""
DISC_DESIGNS = 24
"""Number of random designs that are also simulated with Poisson-disc targets."""
DISC_ERROR = 3e-3
"""Relative standard error to reach for a design with Poisson-disc targets, which take a long time to draw."""
LAMOST_ERROR = 0.4
"""Standard error for LAMOST's design, divided by the standard error for other designs."""
FEW_ERROR = 5e-3
"""Standard error to reach for a design in interpretations of the paper in which few positioners reach targets.

The relative error of the mean over designs is then 0.2 %.
"""
RATIOS = (1.0, 1.25, 1.5, 2.0)
"""Limits of the ranges of the arm ratio for which averages are computed."""


def poisson(
    settings: Settings, table: QTable | None = None, *, discs: dict[str, float] = DISCS
) -> tuple[dict[str, QTable], list[Claim]]:
    """Return estimates for every interpretation of "Poisson-distributed", and the differences from uniform targets.

    The table ``poisson`` has a row for each design; the last row is LAMOST's design. The table ``poisson_disc`` has a
    row for each minimum separation, with several averages of the drop. The drop is the percentage by which the
    collision probability with uniform targets exceeds the collision probability with Poisson-disc targets. Most of the
    computing time is spent on Poisson-disc targets. If ``discs`` is empty, Poisson-disc targets are omitted, and
    ``poisson_disc`` has no rows.
    """
    random = random_designs(settings)
    l1, ratio, pitch = NAMED["LAMOST"]
    designs = vstack([random, QTable({"central_arm": [l1] * u.mm, "ratio": [ratio], "pitch": [pitch] * u.mm})])
    last = len(random)
    fine = LAMOST_ERROR * settings.precision

    def uniform(k):
        options = {"precision": fine} if k == last else {}
        return uniform_estimate(designs[k], "range_200", k, settings, **options)

    found = each(uniform, range(last + 1) if table is None else [last], settings)
    known = np.array([(e.value, e.standard_error) for e in found])
    if table is not None:
        known = np.vstack([np.column_stack([table["range_200"], table["range_200_error"]]), known])
    readings = {
        POINT_PROCESS: {"targets": RandomTargets("poisson")},
        **{name: {"targets": RandomTargets("poisson_disc", min_separation=s * u.mm)} for name, s in discs.items()},
        COORDINATES[0]: {"targets": _coordinates(1.0), "precision": FEW_ERROR},
        COORDINATES[1]: {"targets": _coordinates(200 / 30), "precision": FEW_ERROR},
    }
    few = [*range(min(settings.pick(DISC_DESIGNS, 4), last)), last]
    rows = {name: few if name in discs else list(range(last)) for name in readings}
    jobs = [(name, k) for name in readings for k in rows[name]]

    def run(job):
        name, k = job
        seed, options = [settings.seed, 26, PLACES[name], k], dict(readings[name])
        if name in discs:
            options["precision"] = fine if k == last else max(DISC_ERROR * float(known[k, 0]), settings.precision / 2)
        found = estimate(*numbers_of(designs[k]), LARGE, settings, seed, **options)
        return found.value, found.standard_error

    found = dict(zip(jobs, each(run, jobs, settings), strict=True))
    result = designs.copy()
    result["uniform"], result["uniform error"] = known.T
    for name in readings:
        own = np.array([found.get((name, k), (np.nan, np.nan)) for k in range(last + 1)])
        result[name], result[f"{name} error"] = own.T
    drops = drops_by_ratio(result, discs)
    claims = [_of_reading(name, result) for name in readings]
    return {"poisson": result, "poisson_disc": drops}, claims


def _averages(table, name):
    """Return the rows of a table that have values for an interpretation, and the drop for each of these designs.

    A drop is the percentage by which the collision probability is larger with uniform targets than with
    Poisson-distributed targets. The second result has two rows: the drops, and their standard errors.
    """
    part = table[np.isfinite(table[name])]
    uniform, error, own, own_error = (np.asarray(part[c]) for c in ("uniform", "uniform error", name, f"{name} error"))
    # without collisions, the drop is not defined, and is NaN
    own, uniform = (np.where((own > 0) & (uniform > 0), values, np.nan) for values in (own, uniform))
    drop = 100 * (uniform / own - 1)
    return part, np.array([drop, (100 + drop) * np.hypot(error / uniform, own_error / own)])


def _of_means(part, name):
    """Return the drop of the mean probability over all designs, and its standard error; `_averages` defines a drop."""
    means = [np.asarray(part[c]).mean() for c in ("uniform", name)]
    errors = [np.sqrt((np.asarray(part[f"{c} error"]) ** 2).sum()) / len(part) for c in ("uniform", name)]
    ratio = means[0] / means[1]
    return 100 * (ratio - 1), 100 * ratio * np.hypot(errors[0] / means[0], errors[1] / means[1])


def drops_by_ratio(table: QTable, discs: dict[str, float]) -> QTable:
    """Return the drop for each minimum separation of Poisson-disc targets.

    The drop is the percentage by which the collision probability is larger with uniform targets than with Poisson-disc
    targets.

    Parameters
    ----------
    table : QTable
        Values and errors of each design; the last row is LAMOST's design.
    discs : dict of str to float
        Minimum separation (mm) in each interpretation with Poisson-disc targets, by the name of the interpretation.

    Returns
    -------
    QTable
        A row for each separation: the drop of the mean over designs (``of_means``), the mean of the drops of the
        designs (``of_designs``), this mean for ranges of the ratio of the arms (``ratio_1.00_1.25``, ...), and the drop
        of LAMOST's design (``lamost_rule``), each with a standard error.
    """
    rows = []
    for name, separation in discs.items():
        part, (drop, error) = _averages(table[:-1], name)
        row = {"min_separation": separation * u.mm}
        row["of_means"], row["of_means_error"] = _of_means(part, name)
        groups = {"of_designs": np.full(len(part), True)}
        for low, high in pairwise(RATIOS):
            groups[f"ratio_{low:.2f}_{high:.2f}"] = (part["ratio"] >= low) & (part["ratio"] < high)
        for key, some in groups.items():
            row[key], row[f"{key}_error"] = _mean(drop[some], error[some])
        _, (own, own_error) = _averages(table[-1:], name)
        row["lamost"], row["lamost_error"] = own[0], own_error[0]
        rows.append(row)
    result = QTable(rows=rows)
    result.meta["n_designs"] = len(part) if rows else 0
    return result


def _of_reading(name, table):
    """Return the claim for one interpretation of the paper: compare the drops with the drop in the paper.

    A drop is the percentage by which the collision probability is larger with uniform targets than with
    Poisson-distributed targets. The drops for all designs, for designs with small arm ratios, and for LAMOST's design
    are compared. The paper averages over its designs. The claim is therefore reproduced if an average over all designs
    agrees with the paper. If the paper agrees only with the average over designs with small arm ratios or with
    LAMOST's design, the claim cannot be decided from the text of the paper.
    """
    part, (drop, error) = _averages(table[:-1], name)
    near = np.asarray(part["ratio"]) < RATIOS[1]
    ways = {"mean probability": _of_means(part, name), "mean over the designs": _mean(drop, error)}
    if near.any():
        ways[f"mean over the designs with ratios below {RATIOS[1]:g}"] = _mean(drop[near], error[near])
    if np.isfinite(table[name][-1]):
        _, ((own,), (own_error,)) = _averages(table[-1:], name)
        ways["LAMOST's design"] = own, own_error
    agree = [way for way, (value, e) in ways.items() if abs(value - PAPER) <= max(2 * e, MARGIN)]
    partly = UNDECIDED if agree else NOT_REPRODUCED
    result = REPRODUCED if {"mean probability", "mean over the designs"} & set(agree) else partly
    values = "; ".join(f"{value:+.2f} % +- {e:.2f} % ({way})" for way, (value, e) in ways.items())
    return Claim(
        "poisson",
        "positioners collide 2.6 % more often with uniform than with Poisson targets",
        "2.6 %",
        f"{values}; Poisson targets have the lower probability in {np.count_nonzero(drop > 0)} of {len(part)} designs",
        result,
        name + (f"; agrees: {', '.join(agree)}" if agree else ""),
    )


def _mean(values, errors):
    """Return the mean of the values that are not NaN, and the standard error of this mean."""
    known = np.isfinite(values)
    n = int(np.count_nonzero(known))
    return (values[known].mean(), np.sqrt((errors[known] ** 2).sum()) / n) if n else (np.nan, np.nan)


def _coordinates(scale):
    """Return a function that draws random points with Poisson-distributed coordinates.

    Each coordinate is (k - 100) times ``scale`` mm, where k is a Poisson-distributed number with the mean 100.
    """

    def sampler(rng):
        return scale * (rng.poisson(100.0, (N_TARGETS, 2)) - 100.0) * u.mm

    return sampler
