"""Compare DESI as built with its nominal lattice: reach, multiplicity and collision probability.

Run ``python tests/benchmarks/as_built_desi.py fp-metrology.csv.gz [raytrace-tan2fp-4957-v18.csv.gz]``.
"""

import sys

import astropy.units as u
import numpy as np
from astropy.table import Table

import rfpsurvey as rs
from rfpsurvey.probability import Precision, RandomTargets

N_SKIES = 8
RADII = (100, 200, 300, 380)


def mean_and_error(values):
    """Return the mean of independent values, and its standard error."""
    values = np.array(values, dtype=float)
    return values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(len(values))


def coverage(plane):
    """Return the fractions of the footprint in reach of 0, 1 and 2 positioners, and the multiplicity, with errors."""
    found = []
    for seed in range(N_SKIES):
        parts = plane.coverage(n_points=2**18, rng=seed)
        parts = np.append(parts, np.zeros(4))[:4]
        found.append([*parts[:3], parts @ np.arange(4)])
    return mean_and_error(found)


def inside(plane, radius):
    """Return the fraction in reach and the multiplicity within a distance of the center (mm), with errors."""
    found = []
    for seed in range(N_SKIES):
        rng = np.random.default_rng(seed)
        r, angle = radius * np.sqrt(rng.uniform(size=2**17)), rng.uniform(0, 2 * np.pi, 2**17)
        many = plane.multiplicity(np.column_stack([r * np.cos(angle), r * np.sin(angle)]) * u.mm)
        found.append([(many > 0).mean(), many.mean()])
    return mean_and_error(found)


def probability(plane, density):
    """Return the collision probability of allocated targets with a given density per mm2, and that of independent
    targets.
    """
    radius = (np.hypot(*plane.arrays.xy.T) + plane.arrays.outer_radius).max()
    targets = RandomTargets(number=round(density * np.pi * radius**2))
    precision = Precision(standard_error=0.0001)
    allocated = rs.collision_probability(plane, targets=targets, precision=precision, rng=1)
    return allocated, rs.collision_probability(plane, method="quadrature", precision=precision, rng=1)


def rays(path, radial_map):
    """Print the residuals of the radial map from the ray trace, for several angles of the compensator."""
    table = Table.read(path, format="ascii.csv")
    angle = np.arctan(np.hypot(table["X_TAN"], table["Y_TAN"]))
    table = table[angle < np.deg2rad(1.601)]
    azimuth = np.arctan2(table["Y_TAN"], table["X_TAN"])
    radius = radial_map.to_radius(angle[angle < np.deg2rad(1.601)] * u.rad).to_value(u.mm)
    away = np.column_stack([table["X_FP"] - radius * np.cos(azimuth), table["Y_FP"] - radius * np.sin(azimuth)])
    print("\nresiduals of the radial map from the ray trace without their mean, mm: angle of ADC1, rms, largest")
    for adc in (0, -30, -60, -90):
        rows = away[table["ADC1"] == adc]
        size = np.hypot(*(rows - rows.mean(axis=0)).T)
        print(f"{adc:6d} deg {np.sqrt((size**2).mean()):8.3f} {size.max():8.3f}")


def main(metrology, raytrace=None):
    """Print all numbers."""
    nominal, built = rs.Instrument.preset("desi"), rs.Instrument.from_desi(metrology)
    planes = {"nominal": nominal.focal_plane, "as built": built.focal_plane}
    for name, plane in planes.items():
        value, error = coverage(plane)
        print(f"{name}: {len(plane)} positioners, footprint {plane.footprint:.0f}, {len(plane.neighbor_pairs())} pairs")
        for what, v, e in zip(("not in reach", "of one", "of two", "multiplicity"), value, error, strict=True):
            print(f"  {what:14} {v:.5f} +- {e:.5f}")
        for radius in RADII:
            (reach, many), (reach_error, many_error) = inside(plane, radius)
            print(
                f"  within {radius} mm: in reach {reach:.4f} +- {reach_error:.4f}, "
                f"multiplicity {many:.4f} +- {many_error:.4f}"
            )
    area = np.pi * (nominal.facts()["focal_plane_radius"].to_value(u.mm)) ** 2
    for each in (1, 5):
        print(f"\ncollision probability, {each} targets per positioner of the nominal layout, on the same sky")
        density = each * len(nominal.focal_plane) / area
        for name, plane in planes.items():
            allocated, independent = probability(plane, density)
            print(f"  {name}: {allocated}")
            if each == 1:
                print(f"    independent targets: {independent}")
    if raytrace is not None:
        rays(raytrace, nominal.distortion)


if __name__ == "__main__":
    main(*sys.argv[1:])
