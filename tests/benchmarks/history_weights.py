"""Measure the bias of the weights of surveys with recorded failures (docs/selection.rst).

python tests/benchmarks/history_weights.py [--surveys 1800] [--realizations 128] [--rates 0 0.05 0.2] [--seed 0]
    [--varying]

Many small surveys of the same targets with three overlapping tiles are simulated, each with its own subpriorities. One
tile is observed per night. Visits fail at random, the failures are recorded, a third of them only after the next plan
was made, and the rest is planned again after each night. Small surveys at 36 places with equal declinations are planned
together. The weights of the targets and pairs that each small survey observed are then computed from its events. The
sum of the weights is compared with its expected value for unbiased weights, which follows from the fraction of the
small surveys that observed each target or pair. Only targets and pairs that at least 5 % of other small surveys
observed are counted, so that the truncation of the probabilities has no effect. With --varying, the probability of
failures of each tile is a random number between 0 and twice the given rate.
"""

import os
import tempfile
import warnings

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table, vstack
from measure import arguments

import rfpsurvey as rs

N_PLACES, DEC = 36, 30 * u.deg
CLUSTERS = {"cluster_size": 4, "cluster_scale": 0.02 * u.deg}
NIGHTS = ["2026-01-01", "2026-01-02", "2026-01-03"]
LEAST = 1 / 20
"""Smallest fraction of the small surveys that observe a target or pair that is counted."""


def scene() -> tuple:
    """Return an instrument with 37 positioners, and the targets and the three tiles of all places."""
    unit = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane.hexagonal(unit, rings=3, pitch=25.6 * u.mm)
    center = SkyCoord(0 * u.deg, DEC)
    targets = rs.synthetic_catalog("clustered", center, 0.6 * u.deg, n_targets=150, rng=1, **CLUSTERS).coord
    tiles = center.spherical_offsets_by([0.1, -0.1, 0.0] * u.deg, [0.0, 0.1, -0.15] * u.deg)
    shift = np.arange(N_PLACES)[:, None] * 360 / N_PLACES * u.deg
    copies = [SkyCoord((part.ra + shift).ravel(), np.tile(part.dec, N_PLACES)) for part in (targets, tiles)]
    return rs.Instrument("small", plane, plate_scale=200 * u.mm / u.deg), rs.Catalog(copies[0]), copies[1]


def simulate(instrument, sky, tiles, rate: float, seed: int, n: int, folder: str, *, varying: bool) -> tuple:
    """Return which targets were observed at each place, and the bits of the realizations.

    The shapes are (N_PLACES, n_targets) and (N_PLACES, n_targets, n).
    """
    rng, late = np.random.default_rng([seed, 1]), None
    rates = rng.uniform(0, 2 * rate, len(tiles)) if varying else np.full(len(tiles), rate)
    options = {"allocator": rs.AllocationOptions("nearest", subpriority=seed), "folder": folder}
    survey = rs.plan_survey(sky, instrument, tiles, **options)
    for night, date in enumerate(NIGHTS):
        if night:
            survey = rs.plan_survey(sky, instrument, tiles, visits=survey.state(sky), resume=True, **options)
        rows = np.arange(night, len(tiles), len(NIGHTS))
        positioners = {k: np.asarray(survey.tile(k)["positioner"]) for k in rows.tolist()}
        visits = vstack([Table({"tile": [k] * len(names), "positioner": names}) for k, names in positioners.items()])
        visits["date"] = date
        failed = visits[rng.random(len(visits)) < rates[visits["tile"]]]
        survey.record(Table({"tile": rows, "date": [date] * len(rows)}))
        is_late = rng.random(len(failed)) < 1 / 3
        for table in filter(None, (failed[~is_late], late)):
            survey.record(table)
        late = failed[is_late]
    if late:
        survey.record(late)
    state = survey.state(sky)
    found = rs.selection_probabilities(state, instrument, tiles, n, allocator="nearest", rng=seed)
    bits = np.array([found.observed_in(r) for r in range(n)]).T
    return (state.observed > 0).reshape(N_PLACES, -1), bits.reshape(N_PLACES, -1, n)


def sums(rate: float, seeds: range, n: int, *, varying: bool = False) -> dict[str, np.ndarray]:
    """Return the sum of the weights of each small survey in units of its expected value, for targets and for pairs."""
    parts, observed, weights = scene(), [], []
    n_targets = len(parts[1]) // N_PLACES
    first, second = np.triu_indices(n_targets, 1)
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            result = simulate(*parts, rate, seed, n, f"{folder}/survey", varying=varying)
        for seen, bits in zip(*result, strict=True):
            joint = bits.astype(np.float32) @ bits.T.astype(np.float32)
            observed.append(np.append(seen, seen[first] & seen[second]))
            number = np.append(bits.sum(axis=1), joint[first, second])
            weights.append(np.where(observed[-1], (n + 1) / (number + 1), 0).astype(np.float32))
    observed, weights = np.array(observed), np.array(weights)
    ratios = {}
    for name, columns in (("targets", slice(0, n_targets)), ("pairs", slice(n_targets, None))):
        ratios[name] = []
        for half in (0, 1):  # the other half of the small surveys determines what is counted
            counted = observed[1 - half :: 2, columns].mean(axis=0) > LEAST
            probability = observed[half::2, columns][:, counted].mean(axis=0)
            expected = (1 - (1 - probability) ** (n + 1)).sum()
            ratios[name] += (weights[half::2, columns][:, counted].sum(axis=1) / expected).tolist()
    return {name: np.array(values) for name, values in ratios.items()}


def main():
    given = arguments(__doc__, surveys=1800, realizations=128, rates=[0.0, 0.05, 0.2], seed=0, varying=False)
    os.environ["SOURCE_DATE_EPOCH"] = "1764547200"  # all plans are made on 2025-12-01, before the observations
    warnings.simplefilter("ignore")
    seeds = range(given.seed, given.seed - (-given.surveys // N_PLACES))
    for rate in given.rates:
        for name, values in sums(rate, seeds, given.realizations, varying=given.varying).items():
            error = values.std(ddof=1) / np.sqrt(len(values))
            print(f"{100 * rate:g} % failures, {name}: {values.mean():.4f} +- {error:.4f}", flush=True)


if __name__ == "__main__":
    main()
