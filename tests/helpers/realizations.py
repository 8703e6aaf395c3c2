"""Targets and tiles of realizations of a survey, which are compared with surveys of the same subpriorities."""

from dataclasses import replace

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs

CENTER = SkyCoord(180 * u.deg, 20 * u.deg)


def tiles_of(step, n=3, passes=2):
    """Return overlapping tiles around the center, in two passes with different position angles."""
    lon, lat = (a.ravel() * step for a in np.meshgrid(np.arange(n) - (n - 1) / 2, [0.0] if n < 4 else np.arange(5)))
    table = {"ra": [], "dec": [], "pass": [], "position_angle": []}
    for k in range(passes):
        centers = SkyCoord((lon + k * step / 3) * u.deg, lat * u.deg, frame=CENTER.skyoffset_frame()).icrs
        table["ra"] += centers.ra.deg.tolist()
        table["dec"] += centers.dec.deg.tolist()
        table["pass"] += [k] * len(lon)
        table["position_angle"] += [10.0 * k] * len(lon)
    angles = {name: values * u.deg for name, values in table.items() if name != "pass"}
    return rs.Tiling.from_table(QTable({**angles, "pass": table["pass"]}))


def sky_of(radius, n, *, text=False, kinds=False, fiber_types=(), seed=3):
    """Return targets with priorities and up to two visits; half of them are clustered."""
    options = {"cluster_size": 8, "cluster_scale": 0.02 * u.deg}
    parts = [
        rs.synthetic_catalog("uniform", CENTER, radius * u.deg, n_targets=n // 2, rng=seed),
        rs.synthetic_catalog("clustered", CENTER, radius * u.deg, n_targets=n // 2, rng=seed, **options),
    ]
    lon, lat = (np.concatenate([getattr(part.coord, name).deg for part in parts]) for name in ("ra", "dec"))
    rng = np.random.default_rng(seed)
    n = len(lon)
    return rs.Catalog(
        SkyCoord(lon * u.deg, lat * u.deg),
        id=[f"galaxy {k}" for k in range(n)] if text else 7 * np.arange(n) - 100,
        priority=rng.integers(1, 3, n),
        visits=rng.integers(0, 3, n),
        kind=rng.choice(["science", "standard"], n, p=[0.9, 0.1]) if kinds else None,
        fiber_type=rng.choice(fiber_types, n) if fiber_types else None,
    )


def check(found, sky, instrument, tiles, allocator, realizations, **options):
    """Compare realizations with surveys, target by target, and their counts."""
    assert found.n_realizations > max(realizations)
    for r in realizations:
        seed = int(found.realizations["seed"][r])
        joint = allocator if isinstance(allocator, rs.JointOptions) else None
        asked = allocator if joint is None else joint.allocator
        asked = asked if isinstance(asked, rs.AllocationOptions) else rs.AllocationOptions(asked)
        asked = replace(asked, subpriority=seed)
        asked = asked if joint is None else replace(joint, allocator=asked)
        survey = rs.plan_survey(sky, instrument, tiles, allocator=asked, rng=seed, **options)
        observed = np.asarray(survey.outcomes["observed"]) > 0
        np.testing.assert_array_equal(found.observed_in(r), observed, err_msg=f"realization {r}")
        row, s = found.realizations[r], survey.summary
        lost = s["n_colliding_assigned"] if options.get("lost_in_collision", True) else 0
        if all((np.asarray(visits["target_row"]) >= 0).all() for visits in survey):  # no stuck fiber is on sky
            assert lost == sum(int((~np.asarray(visits["observed"])).sum()) for visits in survey)
        assert (row["n_assigned"], row["n_observed"], row["n_lost"]) == (s["n_assigned"], s["n_visits_observed"], lost)
    reached = np.asarray(survey.outcomes["outcome"])
    never = {k for k, name in enumerate(rs.Survey.OUTCOMES) if name in ("in no field", "out of reach")}
    np.testing.assert_array_equal(
        found.unreachable[found.requested > 0], np.isin(reached, list(never))[found.requested > 0]
    )
