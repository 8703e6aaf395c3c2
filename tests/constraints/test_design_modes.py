"""The design modes of SDSS-V on recorded configurations; each number is recomputed from the file with NumPy only."""

from functools import cache

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from configurations import places, rows_of, spot

import rfpsurvey as rs

FILES = ("sdssv_apo_2021/confSummary-998.par.gz", "sdssv_apo_2024/confSummary-test.par.gz")
MODES = ("bright_time", "dark_faint", "dark_monit", "dark_plane", "dark_rm")
BANDS = ("g", "r", "i", "bp", "gaia_g", "rp", "h")
INDEX = {"u": 0, "g": 1, "r": 2, "i": 3, "z": 4}


def magnitude(row, band):
    value = float(row["mag"][INDEX[band]] if band in INDEX else row[f"{band}_mag"])
    return None if value != value or value in (-999, -9999, 999, 0, 99.9) else value


def kind(row):
    word = row["category"]
    return "sky" if word.startswith("sky") else "standard" if word.startswith("standard") else "science"


def kth(rows, near, k):
    """Return the distance of each row from its k-th neighbor, from all distances."""
    if len(near) < k:
        return np.full(len(rows), np.inf)
    a, b = np.array([spot(row) for row in rows]), np.array([spot(row) for row in near])
    return np.sort(np.hypot(*(a[:, None] - b[None]).transpose(2, 0, 1)), axis=1)[:, k - 1]


def percentile(values, percent):
    """Return the linearly interpolated percentile of values."""
    values = np.sort(values)
    at = percent / 100 * (len(values) - 1)
    low = int(at)
    return values[low] + (at - low) * (values[min(low + 1, len(values) - 1)] - values[low])


def expected_distribution(rows, what, parameters):
    """Return number, verdict, and the percentiles of our definition and of the public check."""
    k, percent, limit = int(parameters[0]), *parameters[1:]
    near = [row for row in rows if kind(row) == what]
    science = [row for row in rows if kind(row) == "science"]
    others = [row for row in rows if kind(row) != what]
    if not science:
        return np.nan, "not checkable", None, None
    distance, public = kth(science, near, k), kth(others, near, min(k, 2))
    share = 100 * np.mean(distance <= limit)
    texts = [
        f"{percentile(one, percent):.3f} mm" if np.isfinite(one).all() else "too few fibers"
        for one in (distance, public)
    ]
    return share, "pass" if share >= percent else "fail", *texts


def outside(rows, band, low, high):
    known = [(row, m) for row in rows if (m := magnitude(row, band)) is not None]
    wrong = [row["holeId"] for row, m in known if (low == low and m <= low) or (high == high and m >= high)]
    return known, sorted(wrong)


@cache
def read(path):
    """Return the plan of a file as rfpsurvey reads it, and its rows as they are written."""
    return rs.plans.read_plan(path), rows_of(path)


@pytest.mark.filterwarnings("ignore:the recorded joint angles.*nominal")
@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("mode", MODES)
def test_each_number_of_a_design_mode_equals_an_independent_computation(file, mode, real_data):
    (plan, rows), apo = read(real_data(file)), rs.Instrument.preset("sdss_apo")
    tile = rs.score_tile(plan, apo, constraints=[*apo.rules(mode), *apo.rules("guiding")])
    check_numbers(tile, rows, mode, real_data)


def check_numbers(tile, rows, mode, real_data, bands=BANDS):
    """Compare each number of a design mode and of the guide stars with numbers computed from rows of a file.

    Rules for magnitudes that are not in ``bands`` are not checkable, and neither are guide stars without their catalog.
    """
    published = {row["label"]: row for row in Table.read(real_data("sdssv_rules/design_modes.ecsv"))}[mode]
    rules, n_checked = {row["rule"]: row for row in tile.rules}, 1
    (guide,) = [row for text, row in rules.items() if text.startswith("guide_stars")]
    assert (guide["verdict"], np.isnan(guide["number"])) == ("not checkable", True)
    for fiber in ("BOSS", "APOGEE"):
        own, name = [row for row in rows if row["fiberType"] == fiber], fiber.lower()
        for word, what in (("skies", "sky"), ("stds", "standard")):
            least = published[f"{name}_n_{word}_min"]
            if least > 0:
                row, n = rules[f"{what}@{fiber}={least:.0f}"], sum(kind(one) == what for one in own)
                assert (row["number"], row["verdict"]) == (n, "pass" if n >= least else "fail")
                n_checked += 1
            parameters = published[f"{name}_min_{word}_fovmetric"]
            if np.isfinite(parameters).all():
                text = f"distribution {what} {parameters[0]:.0f} {parameters[1]} {parameters[2]} {fiber}"
                number, verdict, ours, public = expected_distribution(own, what, parameters)
                row = rules[text]
                np.testing.assert_allclose(row["number"], number, rtol=1e-12)
                assert row["verdict"] == verdict
                assert ours is None or (f": {ours}; public" in row["note"] and row["note"].endswith(f": {public}"))
                n_checked += 1
        for what, column in (("standard", "stds_mags"), ("science", "bright_limit_targets")):
            of_kind = [row for row in own if kind(row) == what]
            for band, (low, high) in zip(BANDS, published[f"{name}_{column}"], strict=True):
                if low != low and high != high:
                    continue
                ends = ["-inf" if low != low else str(low), "inf" if high != high else str(high)]
                row = rules[f"magnitude {band} {' '.join(ends)} {what} {fiber} allowed"]
                known, wrong = outside(of_kind, band, low, high) if band in bands else ([], [])
                if not known:
                    assert row["verdict"] == "not checkable"
                    assert np.isnan(row["number"])
                else:
                    assert (row["number"], row["verdict"]) == (len(wrong), "fail" if wrong else "pass")
                    assert sorted(row["fibers"].split()) == wrong
                    assert row["note"].startswith(f"{len(known)} of {len(of_kind)} ")
                n_checked += 1
        stars = [one for one in rules if one.startswith("bright_stars") and one.endswith(fiber)]
        assert all(rules[one]["verdict"] == "not checkable" for one in stars)
        n_checked += len(stars)
    n_checked += check_contrast(rules, rows, published["apogee_trace_diff_targets"])
    assert n_checked == len(rules)


LCO = """waveCat,direction,R,c0,c1,c2,c3,c4
Boss,focal,9938.0,1.89824,0.0131773,0.000104445,5.77341e-05,0
Apogee,focal,8905.0,2.1189,0.0140826,0.000127996,6.99967e-05,0
"""


@pytest.mark.few(12)
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("design", [21636, 50323, 502706, 503247, 505254])
def test_the_numbers_of_five_designs_equal_an_independent_computation(design, mode, real_data, presets):
    """The designs have the magnitudes gaia_g and h only, and positions on the sky; they do not have fiber numbers."""
    table = Table.read(real_data("sdssv_eight_designs.ecsv"))
    table = table[table["design_id"] == design]
    site = str(table["observatory"][0])
    instrument = presets[f"sdss_{site.lower()}"]
    model = Table.read(real_data("sdssv_apo_2024/focalPlaneModel.csv"), format="ascii.csv", comment="#")
    model = model if site == "APO" else Table.read(LCO, format="ascii.csv")
    center, coord = SkyCoord(table["racen"][0], table["deccen"][0], unit="deg"), SkyCoord(table["ra"], table["dec"])
    rows = []
    for fiber in ("BOSS", "APOGEE"):
        own = np.asarray(table["instrument"]) == fiber
        factor = 0.9998082 if site == "APO" else 0.9999588
        x, y = places(coord[own], center, 0.0, model, fiber, factor)
        for row, px, py in zip(table[own], x, y, strict=True):
            found = {"holeId": row["holeid"], "fiberType": fiber, "category": row["category"], "fiberId": -1}
            found |= {f"{name}_mag": np.nan if row[name] is np.ma.masked else row[name] for name in ("gaia_g", "h")}
            rows.append({**found, "xFocal": px, "yFocal": py})
    constraints = [*instrument.rules(mode), *instrument.rules("guiding")]
    tile = rs.score_tile(table, instrument, equinox="J2022.0", constraints=constraints)
    assert len(rows) == len(table) == tile.summary["n_assigned"]
    check_numbers(tile, rows, mode, real_data, bands=("gaia_g", "h"))


@pytest.mark.parametrize("mode", MODES)
def test_the_numbers_of_a_field_without_magnitudes_equal_an_independent_computation(mode, real_data, presets):
    table = Table.read(real_data("sdssv_robostrategy_field_a.ecsv"))
    names = {
        "hole_id": "holeId",
        "fiber_type": "fiberType",
        "category": "category",
        "x_wok": "xFocal",
        "y_wok": "yFocal",
    }
    rows = [{new: row[old] for old, new in names.items()} | {"fiberId": -1} for row in table[table["assigned"] == 1]]
    rows, apo = [{**row, "h_mag": np.nan} for row in rows], presets["sdss_apo"]
    tile = rs.score_tile(table, apo, constraints=[*apo.rules(mode), *apo.rules("guiding")])
    assert len(rows) == tile.summary["n_assigned"]
    check_numbers(tile, rows, mode, real_data, bands=())


def check_contrast(rules, rows, limit):
    """Compare the verdict on the contrast with all pairs of neighbors; return the number of rules."""
    if limit != limit:
        return 0
    row = rules[f"contrast h {limit} APOGEE fiberId"]
    own = {int(one["fiberId"]): one for one in rows if one["fiberType"] == "APOGEE"}
    own = {number: one for number, one in own.items() if number >= 0 and magnitude(one, "h") is not None}
    steps = {n: abs(magnitude(own[n], "h") - magnitude(own[n + 1], "h")) for n in own if n + 1 in own}
    if not steps:
        assert row["verdict"] == "not checkable"
        return 1
    wrong = [n for n, step in steps.items() if step > limit]
    names = {own[n + d]["holeId"] for n in wrong for d in (0, 1)}
    np.testing.assert_allclose(row["number"], max(steps.values()), atol=1e-5)  # magnitudes are in single precision
    assert (row["verdict"], set(row["fibers"].split())) == ("fail" if wrong else "pass", names)
    assert row["note"].startswith(f"{len(steps)} pairs of neighbors")
    return 1


@pytest.mark.parametrize("mode", MODES)
def test_the_presets_have_the_published_values(mode, real_data):
    """Radii around stars depend on the magnitude limit of the mode; the limit in bright time is that of the g band."""
    published = {row["label"]: row for row in Table.read(real_data("sdssv_rules/design_modes.ecsv"))}[mode]
    texts = [text for text in rs.Instrument.preset("sdss_lco").rules(mode) if text.startswith("bright_stars")]
    night = "bright" if mode == "bright_time" else "dark"
    boss = published["boss_bright_limit_targets"][0 if night == "bright" else 1][0]
    expected = [f"bright_stars gaia_g sdssv_{night}:{boss:g} BOSS"]
    apogee = published["apogee_bright_limit_targets"][6][0]
    expected += [] if apogee != apogee else [f"bright_stars h sdssv_{night}:{apogee:g} APOGEE"]
    assert texts == expected


def test_a_plan_without_kinds_and_magnitudes_is_not_checkable(presets):
    """A rule without data is never passed, and other categories do not state kinds."""
    apo = presets["sdss_apo"]
    x, y = apo.focal_plane.xy[:3].T
    table = Table({"positioner": apo.focal_plane.id[:3], "x": x + apo.focal_plane.positioner.eccentric_arm, "y": y})
    tile = rs.score_tile(table, apo, constraints=apo.rules("dark_monit"))
    assert set(tile.rules["verdict"]) == {"not checkable"}
    assert np.isnan(tile.rules["number"]).all()
    table["category"] = ["sky_boss", "qso", "sky_boss"]
    rules = rs.score_tile(table, apo, constraints=["sky=1", "sky_boss=1", "distribution sky 1 50 100"]).rules
    assert rules["verdict"].tolist() == ["not checkable", "pass", "not checkable"]


def test_the_rules_of_desi_are_checked_in_each_petal(presets):
    """Counts in each petal, and magnitudes of standards, are recomputed from the table of the tile."""
    desi, center, rng = presets["desi"], SkyCoord(95, 23, unit="deg"), np.random.default_rng(3)
    sky = rs.synthetic_catalog("uniform", center, desi.field_radius, n_targets=12_000, rng=1)
    kind = rng.choice(["science", "standard", "sky"], len(sky), p=[0.7, 0.1, 0.2])
    sky = rs.Catalog(sky.coord, kind=kind, extra=QTable({"gaia_g": rng.uniform(14, 20, len(sky))}))
    for name, faintest in (("dark", 19), ("bright", 18)):
        tile = rs.plan_tile(sky, desi, center, allocator=rs.AllocationOptions("network_flow", rules=name))
        t = tile.table[~tile.table["target_id"].mask]
        for what, least, rows in (("sky", 40, tile.rules[:10]), ("standard", 10, tile.rules[10:20])):
            for petal, row in enumerate(rows):
                n = np.sum((t["kind"] == what) & (t["spectrograph"] == petal))
                assert row["rule"] == f"{what}={least}/spectrograph"
                assert (row["number"], row["verdict"]) == (n, "pass" if n >= least else "fail")
        mags = t["gaia_g"][t["kind"] == "standard"]
        assert (mags.min() > 16, mags.max() < faintest) == (True, True)
        assert tile.rules["verdict"][20] == "pass"


@pytest.mark.filterwarnings("ignore:.*out of reach of their positioners")
def test_the_rules_of_pfs_are_checked_on_a_design(real_data, presets):
    """The numbers equal those of targetType (2: sky, 3: flux standard) in the file, which has no magnitudes."""
    path = real_data("pfs/pfsDesign-0x2a3e0e7f53f47587.fits.gz")
    types = Table.read(path, hdu="DESIGN")["targetType"]
    tile = rs.score_tile(rs.plans.read_plan(path), presets["pfs"], constraints=presets["pfs"].rules("queue"))
    n_sky, n_standard = np.sum(types == 2), np.sum(types == 3)
    assert tile.rules["number"].tolist()[:2] == [n_sky, n_standard]
    assert tile.rules["verdict"].tolist()[:2] == ["fail", "fail"]
    assert set(tile.rules["verdict"][2:]) == {"not checkable"}
