"""Numbers on the page on clustering: what each weight of the angular correlation function corrects, and what it costs.

Run ``python tests/benchmarks/clustering_figures.py``, which takes about ten minutes on two cores. ``--mocks N`` and
``--passes N N`` change the number of mocks and of passes.
"""

import sys
from pathlib import Path
from time import perf_counter

import numpy as np
from measure import arguments

import rfpsurvey as rs

sys.path.insert(0, str(Path(__file__).parents[2] / "docs" / "examples" / "scripts"))
import clustering


def main():
    given = arguments(__doc__, mocks=10, passes=[1, 2, 3, 5])
    theta = np.sqrt(clustering.EDGES[1:] * clustering.EDGES[:-1])
    xy = np.random.default_rng(10**6).uniform(-clustering.HALF, clustering.HALF, (20_000, 2))
    random = rs.Catalog(clustering.to_sky(xy))
    clustering.survey(clustering.make_mock(0)[0], clustering.tiles_of(1))  # compiles the kernels
    for n_passes in given.passes:
        tiles, results, seconds, share, counting = clustering.tiles_of(n_passes), [], [], [], {}
        for seed in range(given.mocks):
            catalog, in_slice = clustering.make_mock(seed)
            begin = perf_counter()
            found, observed = clustering.survey(catalog, tiles, seed)
            seconds.append(perf_counter() - begin)
            share.append(observed.mean())
            pairs = found.pair_counts(*np.triu_indices(300, 1))
            results.append({})
            begin = perf_counter()
            for name, (w, _) in clustering.measure(catalog, in_slice, tiles, random, found, observed):
                results[-1][name] = w
                counting.setdefault(name, []).append(perf_counter() - begin)
                begin = perf_counter()
        print(
            f"{n_passes} passes, {given.mocks} mocks: {np.mean(share):.3f} of the targets observed, 129 surveys in "
            f"{np.median(seconds):.1f} s, {(pairs == 0).mean():.4f} of the pairs never observed"
        )
        print("  mean of (method - complete) / standard deviation of complete, by bin; chi2 of the mean difference")
        print(f"  {'deg':<18}", *(f"{value:6.4f}" for value in theta))
        complete = np.array([result["complete"] for result in results])
        scatter = complete.std(axis=0, ddof=1)
        error = scatter / np.sqrt(given.mocks)
        against = (complete.mean(axis=0) - clustering.thomas_correlation()) / error
        print(f"  {'complete - theory':<18}", *(f"{value:+6.2f}" for value in against), " in standard errors")
        for name in clustering.METHODS:
            apart = np.array([result[name] for result in results]) - complete
            mean, std = apart.mean(axis=0), apart.std(axis=0, ddof=1)
            known = np.isfinite(mean)
            chi2 = np.sum((mean / (std / np.sqrt(given.mocks)))[known] ** 2)
            rms = np.sqrt(np.mean(apart**2, axis=0))[known] / scatter[known]
            print(
                f"  {name:<18}",
                *(f"{v:+6.2f}" for v in mean / scatter),
                f" chi2 {chi2:8.1f} of {known.sum()} bins, rms {rms.mean():.2f}, {np.median(counting[name]):.2f} s",
            )


if __name__ == "__main__":
    main()
