"""Print the numbers of the documentation about PFS as built.

    RFPSURVEY_TEST_DATA=... python tests/benchmarks/as_built_pfs.py

Half a minute on one core.
"""

import os
from pathlib import Path

import astropy.units as u
import numpy as np

import rfpsurvey as rs

FOLDER = Path(os.environ["RFPSURVEY_TEST_DATA"]) / "pfs"
N_POINTS = 2**20


def main():
    nominal, built = rs.Instrument.preset("pfs"), rs.Instrument.read(FOLDER)
    print(built.notes, end="\n\n")
    frames(nominal, built)
    limits(built)
    differences(nominal, built)
    design(nominal, built)


def frames(nominal, built):
    """Compare the positions of dots, and the windows of the interference limits, with the nominal centers."""
    dots = built.focal_plane.arrays.hidden[:, :2]
    centers = nominal.focal_plane.xy.value[np.argsort(nominal.focal_plane.id)]
    offset = dots - centers
    plain, turned = centers @ [1, 1j], dots @ [1, 1j]
    factor, shift = np.linalg.lstsq(np.column_stack([plain, np.ones(len(plain))]), turned, rcond=None)[0]
    rest = np.abs(turned - factor * plain - shift)
    print("dots relative to nominal centers")
    print(f"  mean offset ({offset[:, 0].mean():.3f}, {offset[:, 1].mean():.3f}) mm")
    print(
        f"  scale {abs(factor):.5f}, rotation {np.rad2deg(np.angle(factor)):.4f} deg, rest {rest.max():.3f} mm at most"
    )
    moved = np.hypot(*(built.focal_plane.xy.value - centers).T)
    print(
        f"  centers from dots differ from nominal ones by {np.median(moved):.3f} mm (median), {moved.max():.3f} at most"
    )
    table = interference()
    for name, xy in (("nominal", centers), ("from dots", built.focal_plane.xy.value)):
        off = []
        for row in np.flatnonzero(np.isfinite(table[:, 0])):
            begin, end, _ = table[row]
            toward = built.focal_plane.arrays.obstacles[:, :2] - xy[row]
            x, y = toward[np.argmin(np.hypot(*toward.T))]
            off.append((np.rad2deg(np.arctan2(y, x)) - begin - (end - begin) % 360 / 2 + 180) % 360 - 180)
        error = np.std(off) / np.sqrt(len(off))
        print(f"  fiducial minus middle of the window, centers {name}: {np.mean(off):+.2f} +- {error:.2f} deg (mean)")
    print()


def interference():
    """Return the limits of each cobra in degrees."""
    return np.genfromtxt(next(FOLDER.glob("cobraInterference*.csv")), delimiter=",", skip_header=15)[:, 1:]


def interferes(xy, centers, limits, folded=-180.0):
    """Return whether cobras interfere with a fiducial at fiber positions; NaN where they are out of reach."""
    arm = 2.375
    offset = (xy - centers) @ [1, 1j]
    r, direction = np.abs(offset), np.rad2deg(np.angle(offset))
    half = np.rad2deg(np.arccos(np.where(r <= 2 * arm, r, np.nan) / (2 * arm)))
    begin, end, most = limits.T

    def in_window(angle):
        return (angle - begin) % 360 <= (end - begin) % 360

    return (-2 * half - folded > most) & (in_window(direction) | in_window(direction + half))


def limits(built):
    """Compare the joint limits of the 87 cobras with the exact rule."""
    table, plane, rng = interference(), built.focal_plane, np.random.default_rng(1)
    rows = np.flatnonzero(np.isfinite(table[:, 0]))
    forbidden, lost = [], []
    free = rs.Instrument.from_pfs(next(FOLDER.glob("black_dots*"))).focal_plane
    for row in rows:
        polar = 4.7499 * np.sqrt(rng.random(4000)) * np.exp(2j * np.pi * rng.random(4000))
        xy = plane.xy.value[row] + np.column_stack([polar.real, polar.imag])
        before, after = (_reached_by(p, row, xy) for p in (free, plane))
        bad = interferes(xy, plane.xy.value[row], table[row][None])
        assert not (bad & after).any()
        forbidden.append(np.mean(bad[before]))
        lost.append(1 - after.sum() / before.sum())
    print(f"interference limits of {len(rows)} cobras")
    print(f"  the rule forbids {np.mean(forbidden):.1%} of a patrol area (mean), {np.max(forbidden):.1%} at most")
    print(f"  the joint limits forbid {np.mean(lost):.1%} (mean), {np.max(lost):.1%} at most", end="\n\n")


def _reached_by(plane, row, xy):
    pairs = plane.reachable(xy * u.mm)
    found = np.zeros(len(xy), dtype=bool)
    found[pairs.indices[pairs.indptr[row] : pairs.indptr[row + 1]]] = True
    return found


def differences(nominal, built):
    """Print reach, multiplicity and collision probability of the nominal and the real instrument."""
    without = rs.Instrument.from_pfs(next(FOLDER.glob("black_dots*")))
    plane = without.focal_plane
    bare = rs.FocalPlane(plane.xy, plane.positioner, id=plane.id)
    limited = {"nominal lattice": nominal.focal_plane, "centers from dots": bare}
    limited |= {"and dots": plane, "and interference limits": built.focal_plane}
    for name, one in limited.items():
        share = one.coverage(n_points=N_POINTS)
        mean = (share * np.arange(len(share))).sum()
        print(f"{name}: in reach {1 - share[0]:.4f}, of several {share[2:].sum():.4f}, multiplicity {mean:.4f}")
    for name, one in {"nominal lattice": nominal, "centers from dots": bare, "as built": built}.items():
        found = rs.collision_probability(one, precision=0.0003, rng=1)
        print(f"{name}: collision probability {found.value:.4f} +- {found.standard_error:.4f}")
    print()


def design(nominal, built):
    """Score the design, and compare its positions with the patrol areas of its cobras."""
    plan = rs.plans.read_plan(next(FOLDER.glob("pfsDesign*")))
    plan = plan[plan["assigned"]]
    xy = np.column_stack([plan["x"].value, plan["y"].value])
    rows = np.asarray(plan["positioner"]) - 1
    print(f"design of {len(plan)} assigned fibers")
    for name, one in {"nominal lattice": nominal, "as built": built}.items():
        tile = rs.score_tile(plan, one)
        keys = ("n_assigned", "n_out_of_reach", "n_colliding", "n_colliding_pairs", "n_obstacle_collisions")
        print(f"  {name}: { ({key: tile.summary[key] for key in keys}) }")
    apart = np.hypot(*(xy - built.focal_plane.xy.value[rows]).T)
    print(f"  within 4.75 mm of the center of its cobra: {(apart <= 4.75).sum()}; farthest {apart.max():.2f} mm")
    print(f"  behind a dot: {built.focal_plane.arrays.is_hidden(xy).sum()}")
    table = interference()[rows]
    hit = interferes(xy, built.focal_plane.xy.value[rows], table)
    print(f"  of {np.isfinite(table[:, 0]).sum()} limited cobras, interfering by the rule: {hit.sum()}")
    print(f"    cobraIds: {(rows[hit] + 1).tolist()}")
    # the design stems from an older calibration: find the displacement of each module that leaves most fibers in reach
    step = np.linspace(-2.5, 2.5, 101)
    shifts = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    offset, reached, found = xy - built.focal_plane.xy.value[rows], 0, []
    for module in range(42):
        own = offset[rows // 57 == module]
        start = (own.max(axis=0) + own.min(axis=0)) / 2
        count = (np.hypot(*(own[None] - start - shifts[:, None]).transpose(2, 0, 1)) <= 4.75).sum(axis=1)
        reached += count.max()
        found.append(start + shifts[count.argmax()])
    found = np.hypot(*np.array(found).T)
    print(
        f"  with a displacement of each of 42 modules ({found.min():.1f} to {found.max():.1f} mm): {reached} in reach"
    )
    few = np.isin(np.arange(len(plan)), np.flatnonzero(apart <= 4.75))
    tile = rs.score_tile(plan[few], built)
    print(f"  collisions among the {few.sum()} fibers within 4.75 mm: {tile.summary['n_colliding']} arms")


if __name__ == "__main__":
    main()
