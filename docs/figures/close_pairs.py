"""Plot the fraction of close pairs of targets that are lost because an instrument cannot observe both targets."""

from functools import cache

import astropy.units as u
import matplotlib.pyplot as plt
import numpy as np
from astropy.coordinates import SkyCoord

import rfpsurvey as rs

CENTER = SkyCoord(180 * u.deg, 0 * u.deg)
NAMES = {"lamost": "LAMOST", "sdss_apo": "SDSS-V", "moons": "MOONS", "desi": "DESI", "pfs": "PFS"}
EDGES = np.geomspace(3, 1500, 12)  # arcsec
LEAST = 10_000  # smallest number of pairs for each curve
N_REALIZATIONS = 16
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000")


@cache
def pitch_of(name):
    """Return the pitch of an instrument on the sky (deg)."""
    instrument = rs.Instrument.preset(name)
    return (instrument.facts()["pitch"] / instrument.plate_scale).to_value(u.deg)


def lost(name, n_passes, *, collide):
    """Return the fraction of pairs that are lost in each bin of separation.

    The catalog contains one pair of targets per positioner: a target at a random position, and a companion at a random
    separation. The returned fraction is 1 - p / q. Here, p is the probability that both targets of a pair in the bin
    are observed, and q is the same probability for the pairs in the last three bins, which have the widest separations.
    """
    instrument, rng = rs.Instrument.preset(name), np.random.default_rng(0)
    radius, n = instrument.field_radius.to_value(u.deg), len(instrument.focal_plane)
    pitch = pitch_of(name)
    turn = np.arange(n_passes) * 2 * np.pi / 3  # each pass is shifted by half a pitch in another direction
    tiles = SkyCoord(CENTER.ra + pitch / 2 * np.cos(turn) * u.deg, pitch / 2 * np.sin(turn) * u.deg)
    observed, pairs = np.zeros(len(EDGES) - 1), np.zeros(len(EDGES) - 1)
    for _ in range(-(-LEAST // n)):
        r, turn = radius * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
        xy = np.column_stack([r * np.cos(turn), r * np.sin(turn)])
        apart, turn = np.exp(rng.uniform(*np.log(EDGES[[0, -1]]), n)), rng.uniform(0, 2 * np.pi, n)
        xy = np.vstack([xy, xy + (apart / 3600 * [np.cos(turn), np.sin(turn)]).T])
        catalog = rs.Catalog(SkyCoord(CENTER.ra + xy[:, 0] * u.deg, xy[:, 1] * u.deg), id=np.arange(2 * n))
        found = rs.selection_probabilities(
            catalog, instrument, tiles, n_realizations=N_REALIZATIONS, allocator="nearest", lost_in_collision=collide
        )
        row = np.flatnonzero((found.n_tiles[:n] > 0) & (found.n_tiles[n:] > 0))
        cell = np.digitize(apart[row], EDGES) - 1
        observed += np.bincount(cell, found.pair_counts(row, row + n) / N_REALIZATIONS, len(pairs))
        pairs += np.bincount(cell, minlength=len(pairs))
    return 1 - observed / pairs / (observed[-3:].sum() / pairs[-3:].sum())


theta = np.sqrt(EDGES[1:] * EDGES[:-1])
figure, axes = plt.subplots(1, 2, figsize=(9, 4.2), sharey=True, layout="constrained")
for ax, n_passes in zip(axes, (1, 3), strict=True):
    for (name, label), color in zip(NAMES.items(), COLORS, strict=True):
        for collide, style in ((True, "-"), (False, ":")):
            ax.plot(theta, lost(name, n_passes, collide=collide), style, color=color, label=label if collide else None)
    ax.axhline(0, color="0.7", lw=0.8)
    ax.set(xscale="log", xlabel="separation (arcsec)", ylim=(-0.1, 1.05))
    ax.set_title("one pass" if n_passes == 1 else f"{n_passes} passes")
axes[0].set_ylabel("fraction of pairs that are lost")
axes[1].plot([], [], ":", color="0.4", label="collisions ignored")
axes[1].legend()
