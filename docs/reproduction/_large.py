"""Random designs with 469 positioners: comparison of formula and simulation, and the fit of a polynomial."""

import astropy.units as u
import numpy as np
from astropy.table import QTable, Row

from reproduction._claims import NOT_REPRODUCED, REPRODUCED, Claim, verdict
from reproduction._designs import LARGE, D, Settings, each, estimate, numbers_of, random_designs, scaled
from reproduction._fit import PUBLISHED, features, fit_polynomial
from rfpsurvey._studies.surrogate import interior_probability
from rfpsurvey.probability import Estimate, Precision, surrogate_probability

__all__ = ["NAMED", "fit", "large", "uniform_estimate"]

COVERED = {**LARGE, "radius": None}
WAYS = {"range_200": LARGE, "covered": COVERED}
"""Circles that contain the random targets: one with the radius 200 mm, and one that covers all patrol areas."""
NAMED = {"LAMOST": (8.25, 1.0, 25.6), "SDSS-V": (7.4, 15 / 7.4, 22.4), "MOONS": (8.0, 17 / 8, 25.0)}
PROPER = 0.01
"""A number of iterations is "proper" if the relative half width of the 95 % interval is smaller than this value.

The paper calls a number of iterations "proper", but does not define the word.
"""
NORMALIZATIONS = {
    "scaled to 0 and 1": scaled,
    "divided by the largest": lambda v: v / v.max(),
}


def large(settings: Settings) -> tuple[dict[str, QTable], list[Claim]]:
    """Return estimates for all designs, plain simulations of the designs in ``NAMED``, and the claims about them."""
    designs = random_designs(settings)
    jobs = [(way, k) for way in WAYS for k in range(len(designs))]

    table = designs.copy()
    found = each(lambda job: uniform_estimate(designs[job[1]], *job, settings), jobs, settings)
    for w, way in enumerate(WAYS):
        own = found[w * len(designs) : (w + 1) * len(designs)]
        for name, attribute in (("", "value"), ("_error", "standard_error"), ("_assigned", "value_assigned")):
            table[f"{way}{name}"] = [getattr(e, attribute) for e in own]
    for variant in ("corrected", "pitch"):
        options = {"method": "closed_form", "variant": variant}
        formulas = [estimate(*numbers_of(d), LARGE, settings, [0], **options) for d in designs]
        table[f"closed_form_{variant}"] = [e.value for e in formulas]
    table["surrogate"] = surrogate_probability(
        table["central_arm"], table["ratio"] * table["central_arm"], table["pitch"], D * u.mm
    )
    plain = _plain(settings)
    differences = _differences(table, settings)
    claims = [*_of_differences(table, differences), *_of_plain(plain)]
    return {"large": table, "large_differences": differences, "large_plain": plain}, claims


def uniform_estimate(design: Row, way: str, k: int, settings: Settings, **options: object) -> Estimate:
    """Return the estimated collision probability of design number k with uniform targets.

    ``way`` is a key of ``WAYS``; it selects the circle that contains the targets.
    """
    seed = [settings.seed, 469, list(WAYS).index(way), k]
    return estimate(*numbers_of(design), WAYS[way], settings, seed, **options)


def _differences(table, settings):
    """Compare normalized results of formula and simulation, as in the paper; the errors are estimated by bootstrap."""
    rng = np.random.default_rng([settings.seed, 1])
    samples = rng.integers(0, len(table), (2000, len(table)))
    rows = []
    for way in ("range_200", "covered"):
        for variant in ("corrected", "pitch"):
            formula, simulation = np.asarray(table[f"closed_form_{variant}"]), np.asarray(table[way])
            for scaling, scale in NORMALIZATIONS.items():
                away = scale(simulation) - scale(formula)
                others = np.array([scale(simulation[s]) - scale(formula[s]) for s in samples])
                errors = others.mean(axis=1).std(), others.var(axis=1).std()
                rows.append((way, variant, scaling, away.mean(), errors[0], away.var(), errors[1]))
    names = ("targets", "closed_form", "scaling", "mean", "mean_error", "variance", "variance_error")
    return QTable(rows=rows, names=names)


def _of_differences(table, differences):
    claims = []
    for what, paper in (("mean", -0.050), ("variance", 0.116)):
        ours, errors = np.asarray(differences[what]), np.asarray(differences[f"{what}_error"])
        k = int(np.argmin(np.abs(ours - paper) / errors))
        row = differences[k]
        agree = np.abs(ours - paper) <= 2 * errors
        variants = [v for v in np.unique(differences["closed_form"]) if agree[differences["closed_form"] == v].any()]
        readings = f"the paper agrees within two standard errors in {agree.sum()} of {len(agree)} interpretations"
        if variants:
            readings += f", all of which use the {' or '.join(variants)} closed form"
        claims.append(
            Claim(
                "large",
                f"{what} of simulation minus formula, both normalized",
                f"{paper:.3f}",
                f"{ours[k]:.3f} +- {errors[k]:.3f} in the closest interpretation, "
                f"{ours.min():.3f} to {ours.max():.3f} in all interpretations; {readings}",
                verdict(paper, ours[k], errors[k]),
                f"targets: {row['targets'].replace('_', ' ')}; normalization: {row['scaling']}; closed form: "
                f"{row['closed_form']}; the error includes the uncertainty due to the random choice of the designs",
            )
        )
    correlation = np.corrcoef(table["closed_form_corrected"], table["covered"])[0, 1]
    some = np.asarray(table["closed_form_corrected"]) > 0
    factor = np.asarray(table["covered"])[some] / np.asarray(table["closed_form_corrected"])[some]
    claims.append(
        Claim(
            "large",
            "formula and simulation are highly correlated",
            "figure",
            f"correlation {correlation:.3f}; the simulation is {factor.min():.1f} to {factor.max():.1f} times the "
            "formula",
            REPRODUCED if correlation > 0.9 else NOT_REPRODUCED,
            "targets cover all patrol areas",
        )
    )
    values, errors = (np.array([table[f"{way}{name}"] for way in WAYS]) for name in ("", "_error"))
    edge = values[0] / values[1]
    clear = np.abs(edge - 1) > 3 * edge * np.hypot(*(errors / values))
    other = np.corrcoef(table["closed_form_corrected"], table["range_200"])[0, 1]
    claims.append(
        Claim(
            "large",
            "targets in a circle that does not cover the plane distort the simulation",
            "named as a cause of the discrepancy",
            f"for targets within 200 mm, the probability is {edge.min():.2f} to {edge.max():.2f} times the probability "
            f"for targets that cover all patrol areas; the difference is larger than 3 standard errors in "
            f"{clear.sum()} of {len(clear)} designs; the correlation with the formula is {other:.3f} for targets "
            f"within 200 mm and {correlation:.3f} for targets that cover all patrol areas",
            REPRODUCED if clear.mean() > 0.5 else NOT_REPRODUCED,
            "only the distortion is reproduced; whether the distortion causes the discrepancy between formula and "
            "simulation is not tested; positioners without targets count only if their two arms have equal lengths",
        )
    )
    return claims


def _plain(settings):
    """Return plain simulations (6000 iterations, as in the paper) and conditional simulations of ``NAMED`` designs."""

    def run(name):
        seed = [settings.seed, 6000, list(NAMED).index(name)]
        options = {"method": "monte_carlo", "precision": Precision(max_iterations=settings.pick(6000, 100))}
        plain = estimate(*NAMED[name], COVERED, settings, seed, **options)
        conditional = estimate(*NAMED[name], COVERED, settings, [*seed, 1], most_entries=None)
        row = [name]
        for e in (plain, conditional):
            row += [e.value, e.standard_error, e.n, e.seconds]
        return row

    kinds = ("plain", "conditional")
    names = ["design"] + [f"{k}_{n}" for k in kinds for n in ("value", "standard_error", "n", "seconds")]
    return QTable(rows=each(run, list(NAMED), settings), names=names, units={f"{k}_seconds": u.s for k in kinds})


def _of_plain(plain):
    claims = []
    for row in plain:
        gap = abs(row["plain_value"] - row["conditional_value"])
        error = np.hypot(row["plain_standard_error"], row["conditional_standard_error"])
        width = 1.96 * row["plain_standard_error"] / row["plain_value"]
        proper = gap <= 3 * error and width < PROPER
        gain = (row["plain_standard_error"] / row["conditional_standard_error"]) ** 2 * row["plain_n"]
        claims.append(
            Claim(
                "large",
                f"{row['plain_n']} iterations suffice ({row['design']})",
                'the paper calls 6000 iterations "proper", without a definition',
                f"plain simulation: {row['plain_value']:.4f} +- {row['plain_standard_error']:.4f}, with a 95 % "
                f"interval of +- {100 * width:.1f} %; conditional simulation: "
                f"{row['conditional_value']:.4f} +- {row['conditional_standard_error']:.4f} with "
                f"{row['conditional_n']} realizations; for the same error, plain simulation needs {gain:.0f} "
                "iterations",
                REPRODUCED if proper else NOT_REPRODUCED,
                f"targets cover the plane; 'proper' means that the 95 % interval is within {100 * PROPER:g} % of the "
                "value, and that the value agrees with the conditional estimate within 3 combined standard errors; "
                "the paper states no precision",
            )
        )
    return claims


def fit(settings: Settings, table: QTable | None = None) -> tuple[dict[str, QTable], list[Claim]]:
    """Return fits of the polynomial, the errors of the surrogate, and the claims about the fits.

    In each fit, a random quarter of the designs is held back to test the fit.
    """
    table = large(settings)[0]["large"] if table is None else table
    claims, rows = [], []
    for way in ("range_200", "covered"):
        designs = table["central_arm"], table["ratio"], table["pitch"], table[way]
        seeds = range(settings.pick(200, 40))
        splits = [fit_polynomial(*designs, rng=np.random.default_rng([settings.seed, k])) for k in seeds]
        r2 = np.array([s.r2_held_back for s in splits])
        low, median, high = np.quantile(r2, [0.025, 0.5, 0.975])
        rows.append((way, low, median, high, *np.mean([s.coefficients for s in splits], axis=0)))
        claims.append(
            Claim(
                "fit",
                "the polynomial has R^2 = 0.934 on the test set",
                "0.934",
                f"{median:.3f} ({low:.3f} to {high:.3f} in 95 % of the splits)",
                REPRODUCED if low <= 0.934 <= high else NOT_REPRODUCED,
                f"targets: {way.replace('_', ' ')}; a random quarter of the designs is not used for the fit",
            )
        )
    names = ["targets", "r2_low", "r2_median", "r2_high", *"abcdefghij"]
    claims.append(
        Claim(
            "fit",
            "coefficients of the polynomial",
            "table",
            f"the mean of the paper's polynomial over the designs is {_means_of_published(table)}; the mean of the "
            f"probabilities is {np.mean(table['covered']):.2f}; for the coefficients of the fit, see fit.ecsv",
            NOT_REPRODUCED,
            "the paper does not state how its variables and probabilities are scaled; none of four usual scalings of "
            "the variables gives the mean probability",
        )
    )
    return {"fit": QTable(rows=rows, names=names), "surrogate": _surrogate(settings)}, claims


def _means_of_published(table) -> str:
    """Return the means of the published polynomial for four scalings of the variables."""
    designs = np.column_stack([table[name].value for name in ("central_arm", "ratio", "pitch")])
    unit = (designs - designs.min(axis=0)) / np.ptp(designs, axis=0)
    scaled = {
        "without scaling (mm)": designs,
        "for standardized variables": (designs - designs.mean(axis=0)) / designs.std(axis=0),
        "for variables from 0 to 1": unit,
        "for variables from -1 to 1": 2 * unit - 1,
    }
    return ", ".join(f"{(features(x) @ PUBLISHED).mean():.2g} {name}" for name, x in scaled.items())


def _surrogate(settings):
    """Compare the surrogate with quadrature for random designs, which lie between the nodes of the surrogate's grid."""
    rng = np.random.default_rng([settings.seed, 300])
    n = settings.pick(300, 20)
    l1, ratio, pitch, distance = rng.uniform((7.25, 1, 24.6, 1.0), (14.5, 2, 35, 7.0), (n, 4)).T

    jobs = [((a / p, r, d / p), s) for a, r, p, d, s in zip(l1, ratio, pitch, distance, rng.spawn(n), strict=True)]
    points = settings.pick(1024, 128)
    found = each(lambda job: interior_probability(job[0], points, job[1]), jobs, settings)
    table = QTable({"central_arm": l1 * u.mm, "ratio": ratio, "pitch": pitch * u.mm, "min_separation": distance * u.mm})
    table["quadrature"], table["quadrature_error"] = np.array(found).T
    table["surrogate"] = surrogate_probability(l1 * u.mm, l1 * ratio * u.mm, pitch * u.mm, distance * u.mm)
    away = table["surrogate"] - table["quadrature"]
    spread = ((table["quadrature"] - table["quadrature"].mean()) ** 2).sum()
    table.meta.update(r2=float(1 - (away**2).sum() / spread), max_error=float(np.abs(away).max()))
    return table
