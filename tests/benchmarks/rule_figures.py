"""Print the science targets and the time of plans that follow more and more rules of observatories.

python tests/benchmarks/rule_figures.py [--seconds 60] [--field sdss_apo:dark_plane]

Each field has four science targets per positioner, and standards; sky positions are added between the targets. Each row
adds a kind of rule to the rules of the row above. The rules of SDSS-V are those of its design modes; the others are
examples, not the rules of the observatories. Times exclude compilation.
"""

import warnings
from time import perf_counter

import astropy.units as u
import numpy as np
from astropy.table import QTable
from measure import arguments

import rfpsurvey as rs
from sky_center import CENTER

EXAMPLE = ["magnitude r 16 inf science", "bright_stars gaia_g 8:60,12:10"]
FIELDS = {
    "sdss_apo:bright_time": None,
    "sdss_apo:dark_plane": None,
    "desi": ["sky=40/spectrograph", "standard=10/spectrograph", *EXAMPLE, "distribution sky 1 95 30"],
    "pfs": ["sky=60/spectrograph", "standard=15/spectrograph", *EXAMPLE, "distribution sky 1 95 30"],
}
KINDS = ("no rules", "counts", "magnitude", "bright_stars", "distribution")
BANDS = ("g", "r", "i", "bp", "rp", "gaia_g", "h")


def catalog_of(model):
    """Return science targets of three priorities with magnitudes from 11 to 20, and standards that fit the limits."""
    n = round(4.6 * len(model.focal_plane))
    sky = rs.synthetic_catalog("uniform", CENTER, model.field_radius, n_targets=n, rng=1)
    rng = np.random.default_rng(2)
    columns = {
        "kind": rng.choice(["science", "standard"], n, p=[4 / 4.6, 0.6 / 4.6]),
        "priority": rng.integers(1, 4, n),
    }
    if len(model.focal_plane.fiber_types) > 1:
        columns["fiber_type"] = rng.choice(model.focal_plane.fiber_types, n)
    bands = {}
    for band in BANDS:  # H is brighter than the other bands
        faint, standard = 11 + 9 * rng.power(3, n) - 5 * (band == "h"), rng.uniform(15.5, 17.5, n) - 6 * (band == "h")
        bands[band] = np.where(columns["kind"] == "science", faint, standard)
    return rs.Catalog(sky.coord, extra=QTable(bands), **columns)


def kind_of(text):
    return text.split()[0] if " " in text else "counts"


def row(model, catalog, rules, name, seconds):
    """Return a text with the numbers of science targets, of those of the first class, of failed rules, and the time."""
    separation = 10 * u.arcsec if rules else None
    options = rs.AllocationOptions(name, constraints=rules, sky_separation=separation, time_limit=seconds * u.s)
    begin = perf_counter()
    tile = rs.plan_tile(catalog, model, CENTER, allocator=options)
    time, n = perf_counter() - begin, np.count_nonzero(tile.table["kind"] == "science")
    failed = sum(one["verdict"] == "fail" for one in tile.rules) if rules else 0
    gap = tile.summary["gap"]
    first = dict(one[:2] for one in tile.summary["objectives"])["priority 3"]
    return f"{n:>9}{first:>8.0f}{failed:>8}{time:>9.2f}" + (f"{gap:>9.3f}" if gap is not None else f"{'':>9}")


def main():
    asked = arguments(__doc__, seconds=60.0, field="")
    warnings.simplefilter("ignore", rs.RfpsurveyWarning)
    columns = f"{'science':>9}{'first':>8}{'failed':>8}{'s':>9}{'gap':>9}"
    print(f"{'':<38}{'repair':^43}{'optimal':^43}\n{'field':<22}{'rules':<16}{columns}{columns}")
    for field in [asked.field] if asked.field else FIELDS:
        name, _, mode = field.partition(":")
        model = rs.Instrument.preset(name)
        catalog, every = catalog_of(model), FIELDS[field] or model.rules(mode)
        every = [text for text in every if kind_of(text) in KINDS]
        for k, kind in enumerate(KINDS):
            rules = [text for text in every if kind_of(text) in KINDS[: k + 1]]
            if k == 0:
                row(model, catalog, every, "repair", 1)  # compiles
                row(model, catalog, every, "optimal", 1)
            found = [row(model, catalog, rules, name, asked.seconds) for name in ("repair", "optimal")]
            print(f"{field if k == 0 else '':<22}{'+ ' * (k > 0) + kind:<16}{''.join(found)}", flush=True)


if __name__ == "__main__":
    main()
