"""Tiles with sky fibers in gaps between the targets of the catalog."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from scipy.spatial import cKDTree

import flat
import rfpsurvey as rs
from oracles import tangent_plane_mm

MM = u.mm
CENTER = SkyCoord(95, 23, unit="deg")
FILLING = ["lamost_rule", "network_flow", "optimal", "repair"]


def wide_catalog(instrument, rng, text):
    """Return science targets and some standards in the whole field, without sky positions."""
    sky = rs.synthetic_catalog("uniform", CENTER, instrument.field_radius, n_targets=9000, rng=2)
    n = len(sky)
    types = instrument.focal_plane.fiber_types
    columns = {"kind": np.where(rng.random(n) < 0.15, "standard", "science"), "priority": rng.integers(0, 2, n)}
    if types != ("",):
        columns["fiber_type"] = rng.choice(types, n)
    ids = np.char.add("star number ", np.arange(n).astype(str)) if text else np.arange(n) - 50
    return rs.Catalog(sky.coord, id=ids, **columns)


@pytest.mark.parametrize(
    ("name", "allocator", "text"), [("lamost", "lamost_rule", False), ("sdss_apo", "network_flow", True)]
)
def test_a_tile_holds_what_the_instrument_needs(presets, name, allocator, text, rng, tmp_path):
    instrument, turn, separation = presets[name], 33 * u.deg, 12 * u.arcsec
    catalog = wide_catalog(instrument, rng, text)
    asked = rs.AllocationOptions(allocator, requirements="instrument", sky_separation=separation)
    tile = rs.plan_tile(catalog, instrument, CENTER, allocator=asked, position_angle=turn)
    t, needs = tile.table, [str(rs.Requirement.parse(one)) for one in instrument.requirements]
    assert (tile.summary["unmet"], tile.provenance["parameters"]["requirements"]) == ([], needs)
    if name == "lamost":
        for place in range(1, 17) if 0 not in t["spectrograph"] else range(16):
            here = t["kind"][t["spectrograph"] == place]
            assert (here == "sky").sum() == 20
            assert (here == "standard").sum() == 5 if allocator == "lamost_rule" else (here == "standard").sum() >= 5
    else:
        for fiber, n_sky, n_standard in (("BOSS", 50, 50), ("APOGEE", 35, 15)):
            kinds = t["kind"][t["fiber_type"] == fiber]
            assert ((kinds == "sky").sum(), (kinds == "standard").sum() >= n_standard) == (n_sky, True)
    blank = t["kind"] == "sky"
    assert (t["status"][blank] == "assigned").all()
    ids = t["target_id"][t["status"] == "assigned"]
    assert len(np.unique(ids)) == len(ids)
    assert not np.isin(t["target_id"][blank], catalog.id).any()
    assert np.isin(t["target_id"][~blank & (t["status"] == "assigned")], catalog.id).all()
    projection = instrument.projection(CENTER, turn)
    tips = np.column_stack([t["tip_x"], t["tip_y"]])[blank]
    there = SkyCoord(t["ra"][blank], t["dec"][blank])
    fiber = None if name == "lamost" else np.asarray(t["fiber_type"][blank])
    assert np.abs(projection.to_focal_plane(there, fiber) - tips).max() < 1e-6 * MM
    if name == "lamost":
        scale = instrument.plate_scale.to_value(MM / u.deg)
        np.testing.assert_allclose(tangent_plane_mm(there, CENTER, scale, 33), tips.value, atol=1e-6)
    seen = projection.to_focal_plane(catalog.coord, catalog.fiber_type).to_value(MM)
    seen = seen[np.isfinite(seen[:, 0])]
    assert cKDTree(seen).query(tips.value)[0].min() >= (separation * instrument.plate_scale).to_value(MM) - 1e-9
    for end in (".fits", ".ecsv"):
        tile.write(tmp_path / f"tile{end}")
        assert rs.Tile.read(tmp_path / f"tile{end}") == tile


@pytest.mark.parametrize("allocator", FILLING)
def test_a_length_is_a_separation_too(small, allocator, rng):
    sky = rs.synthetic_catalog("uniform", CENTER, small.field_radius, n_targets=60, rng=4)
    options = {"allocator": allocator, "requirements": "sky=9"}
    tile = flat.plan_tile(sky, small, CENTER, sky_separation=3 * MM, **options)
    same = flat.plan_tile(sky, small, CENTER, sky_separation=54 * u.arcsec, **options)
    assert (tile.table["kind"] == "sky").sum() >= 9
    assert tile.table["tip_x"].value == pytest.approx(same.table["tip_x"].value, nan_ok=True)


@pytest.mark.parametrize("ids", [[-1, 5], ["a", "blank-sky-3"]])
def test_names_of_found_sky_are_new(small, ids, tmp_path):
    focal_plane = replace(small.focal_plane, stuck=np.where(np.arange(37)[:, None] == 5, [20, 90], np.nan) * u.deg)
    small = replace(small, focal_plane=focal_plane)
    coord = SkyCoord([95, 95.05], [23.02, 23], unit="deg")
    asked = rs.AllocationOptions("network_flow", requirements="sky=12", sky_separation=4 * MM)
    tile = rs.plan_tile(rs.Catalog(coord, id=ids), small, CENTER, allocator=asked)
    t = tile.table
    assert (tile.summary["unmet"], t["kind"][5], t["status"][5]) == ([], "sky", "stuck")
    blank = (t["kind"] == "sky") & (t["status"] == "assigned")
    assert blank.sum() == 34
    names = t["target_id"][blank].tolist()
    assert len(set(names)) == 34
    assert not set(names) & set(ids)
    assert sorted(t["target_id"][t["kind"] == "science"]) == sorted(ids)
    np.testing.assert_array_equal(np.asarray(t["target_id"].mask), t["status"] != "assigned")
    for end in (".fits", ".ecsv"):
        tile.write(tmp_path / f"tile{end}")
        assert rs.Tile.read(tmp_path / f"tile{end}") == tile


def test_names_of_more_than_a_hundred_sky_positions_are_new(presets):
    catalog = rs.Catalog(SkyCoord([95, 95.05], [23.02, 23], unit="deg"), id=["a", "b"])
    options = {"requirements": "sky=120", "sky_separation": 10 * u.arcsec}
    tile = flat.plan_tile(catalog, presets["lamost"], CENTER, **options)
    names = tile.table["target_id"][tile.table["kind"] == "sky"].tolist()
    assert (len(names), len(set(names))) == (120, 120)


def test_a_separation_in_a_real_field(tycho, presets):
    catalog = rs.Catalog.read(tycho)
    center = SkyCoord(catalog.coord.ra.mean(), catalog.coord.dec.mean())
    options = {"requirements": "sky=20/spectrograph", "sky_separation": 10 * u.arcsec}
    tile = flat.plan_tile(catalog, presets["lamost"], center, **options)
    blank = tile.table["kind"] == "sky"
    assert (tile.summary["unmet"], blank.sum()) == ([], 320)
    there = SkyCoord(tile.table["ra"][blank], tile.table["dec"][blank])
    assert there.match_to_catalog_sky(catalog.coord)[1].min() > 9.9 * u.arcsec
