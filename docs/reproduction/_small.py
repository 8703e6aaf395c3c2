"""Collision probability of 19 positioners as a function of arm ratio and pitch."""

from dataclasses import replace

import astropy.units as u
import numpy as np
from astropy.table import QTable

from reproduction._claims import NOT_REPRODUCED, REPRODUCED, Claim
from reproduction._designs import SMALL, Settings, each, estimate, plane_of, scaled

__all__ = ["small"]

L1, PITCH = 8.25, 25.6
RAPIDLY = 2.0
"""A probability changes rapidly if it changes by at least this factor over a scan; the paper states no factor."""
COMPARABLE = 0.1
"""Largest difference at which two normalized curves count as comparable; the paper states no limit."""


def small(settings: Settings) -> tuple[dict[str, QTable], list[Claim]]:
    """Return the scans of the arm ratio and of the pitch, and the claims about them."""
    ratios, pitches = np.linspace(1, 3, settings.pick(9, 3)), np.linspace(25.6, 35, settings.pick(9, 3))
    scans = {
        "ratio": [(L1, r, PITCH) for r in ratios],
        "pitch": [(L1, 1.0, p) for p in pitches],
        "pitch at ratio 2": [(L1, 2.0, p) for p in pitches],
    }
    jobs = [(name, design, k) for name, designs in scans.items() for k, design in enumerate(designs)]

    def run(job):
        name, design, k = job
        seed = [settings.seed, 19, list(scans).index(name), k]
        # the claim divides by the smallest probability of the pitches
        finer = settings if settings.quick or name != "pitch" else replace(settings, error=1e-5)
        found = estimate(*design, SMALL, finer, seed)
        formula = estimate(*design, SMALL, settings, seed, method="closed_form")
        return (name, *design, found.value, found.low, found.high, found.standard_error, formula.value)

    rows = each(run, jobs, settings)
    names = ("scan", "central_arm", "ratio", "pitch", "value", "low", "high", "standard_error", "closed_form")
    table = QTable(rows=rows, names=names, units={"central_arm": u.mm, "pitch": u.mm})
    claims = []
    trends = ("ratio", 1, "increases rapidly with the arm ratio"), ("pitch", -1, "decreases rapidly with the pitch")
    for name, sign, words in trends:
        part = table[table["scan"] == name]
        steps, errors = sign * np.diff(part["value"]), np.hypot(part["standard_error"][1:], part["standard_error"][:-1])
        low, high = part["value"][[0, -1]][::sign]
        holds = (steps > -3 * errors).all() and high > RAPIDLY * low
        claims.append(
            Claim(
                "small",
                f"the probability {words}",
                "figure",
                f"{part['value'][0]:.4f} to {part['value'][-1]:.4f}, a factor of {high / low:.3g}",
                REPRODUCED if holds else NOT_REPRODUCED,
                f"19 positioners, central arm {L1} mm; 'rapidly' means a monotonic change by a factor of {RAPIDLY:g} "
                "or more",
            )
        )
    for name in scans:
        part = table[table["scan"] == name]
        away = scaled(part["closed_form"]) - scaled(part["value"])
        gap, n_zero = float(np.abs(away).max()), int(np.count_nonzero(part["closed_form"] <= 0))
        factor = np.asarray(part["value"] / np.where(part["closed_form"] > 0, part["closed_form"], np.nan))
        claims.append(
            Claim(
                "small",
                f"formula and simulation yield comparable outcomes ({name})",
                "figure, normalized",
                f"the normalized curves differ by up to {gap:.3f}; in absolute terms the formula is too low by a "
                f"factor of {np.nanmin(factor):.1f} to {np.nanmax(factor):.1f}"
                + (f", and it is 0 for {n_zero} of {len(part)} designs" if n_zero else ""),
                REPRODUCED if gap < COMPARABLE else NOT_REPRODUCED,
                f"both curves are scaled to the range from 0 to 1; 'comparable' means a difference below {COMPARABLE:g}"
                + (", a condition that this scan barely meets" if 0.8 * COMPARABLE < gap < COMPARABLE else ""),
            )
        )
    table.meta["n_positioners"] = len(plane_of(L1, 1.0, PITCH, SMALL["rings"]))
    return {"small": table}, claims
