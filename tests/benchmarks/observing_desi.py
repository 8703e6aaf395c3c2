"""Residuals of maps of the focal plane of DESI against its ray trace, by setting of the dispersion compensator.

Run ``RFPSURVEY_TEST_DATA=... python tests/benchmarks/observing_desi.py``, which takes half a minute. It prints the
numbers on the page on observing conditions.
"""

import os
import tempfile
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import Table

import rfpsurvey as rs

PATH = Path(os.environ["RFPSURVEY_TEST_DATA"]) / "desi" / "raytrace-tan2fp-4957-v18.csv.gz"
DEGREES, HARMONICS = (3, 4, 5, 6, 7), (0, 1, 2, 3)


def points_of(table):
    """Return the points of a table in the tangent plane and on the focal plane (mm), with +x east."""
    return tuple(np.column_stack([-table[f"X_{name}"], table[f"Y_{name}"]]) for name in ("TAN", "FP"))


def line(what, error):
    distance = np.hypot(*error.T)
    print(f"{what:<44}{np.median(distance):>10.4f}{distance.max():>10.4f}")


def centered(error):
    """Return errors after one common shift."""
    return error - error.mean(axis=0)


def fitted_radial_map(tangents, traced, degree):
    """Return the points of the best odd polynomial of the tangent, with one common shift."""
    r = np.hypot(*tangents.T)
    radial = [(tangents * (r / r.max())[:, None] ** k).ravel() for k in range(0, degree, 2)]
    columns = np.array([*radial, *np.tile(np.eye(2), len(r))])
    columns /= np.abs(columns).max(axis=1, keepdims=True)
    return (np.linalg.lstsq(columns.T, traced.ravel(), rcond=None)[0] @ columns).reshape(-1, 2)


def radial_maps(table, preset):
    """Print the residuals of radial maps at the setting 0."""
    tangents, traced = points_of(table[np.asarray(table["ADC1"]) == 0])
    print(f"{'ADC 0, after one common shift (mm)':<44}{'median':>10}{'max':>10}")
    for degree in (3, 5, 7, 9):
        line(f"radial map fitted here, degree {degree}", fitted_radial_map(tangents, traced, degree) - traced)
    line("radial map of the preset", centered(preset(tangents) - traced))


def settings(table, trace, half, preset):
    """Print the residuals of all maps at each setting."""
    strength = np.asarray(table["ADC1"])
    heads = "median", "max", "max", "max", "max"
    print(f"\n{'':>6}{'':>6}{'map of the setting':>20}{'by half':>10}{'at ADC 0':>10}{'preset':>10}{'shift':>10}  (mm)")
    print(f"{'ADC1':>6}{'ADC2':>6}" + "".join(f"{head:>10}" for head in heads) + f"{'along y':>10}")
    still, medians, largest = trace.at([0, 0] * u.deg), [], []
    for angle in np.unique(strength)[::-1]:
        tangents, traced = points_of(table[strength == angle])
        left = {}
        for name, found in (("all", trace), ("half", half)):
            found = found.at([angle, -angle] * u.deg)
            left[name] = np.hypot(*(found.project(tangents) + found.shift.to_value(u.mm) - traced).T)
        others = [np.hypot(*centered(image - traced).T).max() for image in (still.project(tangents), preset(tangents))]
        shift = trace.at([angle, -angle] * u.deg).shift.to_value(u.mm)[1]
        values = np.median(left["all"]), left["all"].max(), left["half"].max(), *others, shift
        medians.append(values[0])
        largest.append(values[1])
        formats = "10.4f", "10.4f", "10.4f", "10.3f", "10.3f", "10.3f"
        text = "".join(format(value, form) for value, form in zip(values, formats, strict=True))
        print(f"{angle + 0.0:>6.0f}{0.0 - angle:>6.0f}{text}")
    print(f"largest median {max(medians):.4f} mm, largest residual {max(largest):.4f} mm of {len(table)} points")


def complexity(path):
    """Print the residuals by degree and order."""
    print("\nlargest residual (mm), and number of coefficients, by degree (rows) and order of the Fourier series")
    print(" " * 6 + "".join(f"{order:>16}" for order in HARMONICS))
    for degree in DEGREES:
        found = [
            rs.projection.DistortionMap.from_ray_trace(path, degree=degree, harmonics=order) for order in HARMONICS
        ]
        cells = (f"{one.residuals['max'].max().to_value(u.mm):.4f} ({len(one.coefficients)})" for one in found)
        print(f"{degree:>6}" + "".join(f"{cell:>16}" for cell in cells))


def main():
    table = Table.read(PATH, format="ascii.csv")
    radial = rs.Instrument.preset("desi").distortion

    def preset(tangents):
        r = np.hypot(*tangents.T)
        return radial.to_radius(np.arctan(r) * u.rad).to_value(u.mm)[:, None] * tangents / np.maximum(r, 1e-12)[:, None]

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "half.csv"
        table[np.asarray(table["ADC1"]) % 20 == 0].write(path)
        half = rs.projection.DistortionMap.from_ray_trace(path)
    radial_maps(table, preset)
    settings(table, rs.projection.DistortionMap.from_ray_trace(PATH), half, preset)
    complexity(PATH)


if __name__ == "__main__":
    main()
