"""Measure the time to plot 5000 positioners from existing data, and to write a PNG with 100 dots per inch.

Run ``python tests/benchmarks/plot_figures.py``, which prints the smallest of three times.
"""

import io
import time

import astropy.units as u
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from rfpsurvey.probability import Precision

CENTER = SkyCoord("10h00m00s +02d12m00s")


def seconds(draw):
    """Return the smallest of three times to draw and to write a plot."""
    times = []
    for _ in range(3):
        start = time.perf_counter()
        ax = draw()
        middle = time.perf_counter()
        ax.figure.savefig(io.BytesIO(), format="png", dpi=100)
        times.append((middle - start, time.perf_counter() - middle))
    return min(times, key=sum)


if __name__ == "__main__":
    desi = rs.Instrument.preset("desi")
    sky = rs.synthetic_catalog("uniform", CENTER, desi.field_radius, n_targets=4 * len(desi.focal_plane), rng=1)
    tile = rs.plan_tile(sky, desi, CENTER, allocator="balanced")
    estimate = rs.collision_probability(desi, method="quadrature", precision=Precision(max_iterations=32))
    pictures = {
        "plot_focal_plane of a tile": lambda: rs.plot.plot_focal_plane(tile),
        "a part of it": lambda: rs.plot.plot_focal_plane(tile, region=[[-60, -60], [60, 60]] * u.mm),
        "plot_focal_plane of an instrument": lambda: rs.plot.plot_focal_plane(desi),
        "by spectrograph": lambda: rs.plot.plot_focal_plane(desi, color="spectrograph"),
        "plot_coverage": lambda: rs.plot.plot_coverage(desi),
        "plot_collision_map of an estimate": lambda: rs.plot.plot_collision_map(estimate, desi),
        "plot_collision_map of a tile": lambda: rs.plot.plot_collision_map(tile),
    }
    print(f"{len(desi.focal_plane)} positioners, {tile.summary['n_colliding']} in collision\n")
    print(f"{'':36}{'drawn [s]':>10}{'written [s]':>13}")
    for name, draw in pictures.items():
        drawn, written = seconds(draw)
        print(f"{name:36}{drawn:10.2f}{written:13.2f}")
