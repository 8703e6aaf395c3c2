"""Computing time for arms of 64 segments, compared with the times for swept areas and for exact distances."""

import numpy as np
from astropy.table import QTable

from reproduction._claims import NOT_REPRODUCED, REPRODUCED, UNDECIDED, Claim
from reproduction._designs import Settings
from rfpsurvey.benchmark import benchmark_collisions

__all__ = ["speed"]

FAR_LESS = 1.0
"""If arms of 64 segments take more than this percentage of the computing time of swept areas, the claim is refuted."""


def speed(settings: Settings) -> tuple[dict[str, QTable], list[Claim]]:
    """Return the times of four methods that find the collisions of LAMOST's arms, and the claims about the times."""
    table = benchmark_collisions(
        "lamost",
        methods=["exact", "sampled", "sweep", "scipy"],
        n_configurations=settings.pick(3, 1),
        repeats=settings.pick(10, 1),
        seconds=settings.pick(3, 0),
        rng=settings.seed,
        progress=settings.progress,
    )

    def row(method, n_points=-1):
        return table[(table["method"] == method) & (np.ma.filled(table["n_points"], -1) == n_points)][0]

    sampled, sweep, exact = row("sampled", 65), row("sweep", 65), row("exact")
    ratio = 100 * float(sampled["time"] / sweep["time"])
    missed, count, error = sampled["n_missed"], sampled["n_colliding_true"], sampled["max_error"].to_value("mm")
    claims = [
        Claim(
            "speed",
            "arms of 64 segments take 0.15 % of the computing time of swept areas",
            "0.15 %",
            f"{ratio:.2g} %",
            UNDECIDED if ratio <= FAR_LESS else NOT_REPRODUCED,
            "both methods are implemented in rfpsurvey, run on one core, and skip pairs that cannot touch; the paper "
            "compares a GPU with a machine that it does not describe; therefore, the agreement of the two numbers "
            "proves little",
        ),
        Claim(
            "speed",
            "finding the collisions of 4000 positioners takes 0.45 s",
            "0.45 s on an RTX 4090D",
            f"{sampled['time'].to_value('ms'):.2g} ms with 65 points, {exact['time'].to_value('ms'):.2g} ms "
            "with exact distances",
            REPRODUCED if sampled["time"].to_value("s") <= 0.45 else NOT_REPRODUCED,
            "interpreted as at most 0.45 s, on one core of this machine; pairs that cannot touch are skipped",
        ),
        Claim(
            "speed",
            "the accuracy of arms of 64 segments satisfies the requirements",
            "stated",
            f"{missed} of {count} pairs missed, distances up to {error:.2g} mm too long",
            REPRODUCED if missed == 0 else NOT_REPRODUCED,
            "LAMOST's arms; the results are compared with exact rational arithmetic; the paper states no requirement; "
            "here, no pair may be missed",
        ),
    ]
    return {"speed": table}, claims
