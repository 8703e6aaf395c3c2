import pickle
import sys
import textwrap
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from raising import refused

import rfpsurvey as rs
from rfpsurvey._instruments.instrument import as_instrument

COUNTS = {"lamost": 4000, "sdss_apo": 500, "sdss_lco": 500, "moons": 1001, "desi": 5000, "pfs": 2394}
TYPES = {"lamost": 2, "sdss_apo": 3, "sdss_lco": 3, "moons": 3, "desi": 2, "pfs": 2}


def test_the_shipped_instruments_are_listed():
    assert set(COUNTS) <= set(rs.available_instruments())


@pytest.mark.parametrize("name", rs.available_instruments())
def test_every_figure_has_a_status_and_a_source(presets, name):
    instrument = presets[name]
    assert len(instrument.focal_plane) == COUNTS.get(name, len(instrument.focal_plane))
    assert instrument.focal_plane.collision_type == TYPES.get(name, instrument.focal_plane.collision_type)
    assert instrument.layout == "nominal"
    assert instrument.title
    assert len(instrument.notes) > 50
    table = instrument.to_table()
    assert len(table) > 8
    assert set(table["status"]) <= {"published", "derived", "assumed"}
    assert all(len(source) > 8 for source in table["source"])


PLATE_SCALES = [
    ("sdss_apo", 1.0, 220.519, 1e-3),
    ("sdss_lco", 1.0, 331.490, 1e-3),
    ("pfs", 0.69, 226.600, 1e-3),
    ("desi", 1.6, 405.892, 5e-3),  # the fit to the Echo22 table has errors of at most 0.0039 mm
    ("lamost", 2.0, 20000 * np.tan(np.deg2rad(2.0)), 1e-9),
]


@pytest.mark.parametrize(("name", "angle", "radius", "tolerance"), PLATE_SCALES)
def test_plate_scales(presets, name, angle, radius, tolerance):
    center = SkyCoord(95, 23, unit="deg")
    plane = presets[name].projection(center)
    xy = plane.to_focal_plane(center.directional_offset_by([0, 120, 240] * u.deg, angle * u.deg))
    np.testing.assert_allclose(np.hypot(*xy.value.T), radius, atol=tolerance)


def test_plate_scales_before_the_scale_to_the_wok(presets):
    for name, radius in (("sdss_apo", 220.562), ("sdss_lco", 331.504)):
        radial = presets[name].distortion["BOSS"]
        assert radial.to_radius(1 * u.deg).value / radial.factor == pytest.approx(radius, abs=1e-3)


GEOMETRY = [
    ("lamost", 0, 16.5, 4.5, 25.6),
    ("sdss_apo", 7.5697, 22.3697, 4.0782, 22.4),
    ("sdss_lco", 7.5697, 22.3697, 4.0782, 22.4),
    ("moons", 9, 25, 4.0, 25.058),
    ("desi", 0, 6, 0, 10.4),
    ("pfs", 0, 4.75, 2.0, 8.0),
]


@pytest.mark.parametrize(("name", "inner", "outer", "separation", "pitch"), GEOMETRY)
def test_geometry(presets, name, inner, outer, separation, pitch):
    plane = presets[name].focal_plane
    unit = plane.positioner
    assert unit.inner_radius.value == pytest.approx(inner, abs=5e-5)
    assert unit.outer_radius.value == pytest.approx(outer, abs=5e-5)
    assert unit.min_separation.value == pytest.approx(separation, abs=5e-5)
    xy = plane.xy.value
    assert np.hypot(*(xy[0] - xy[1:]).T).min() == pytest.approx(pitch)


def test_lamost_lies_within_its_focal_plate(presets):
    plane = presets["lamost"].focal_plane
    assert np.hypot(*plane.xy.value.T).max() <= 848.7 + 0.05
    assert presets["lamost"].plate_scale.to_value(u.mm / u.deg) == pytest.approx(349.0659, abs=1e-4)
    groups, counts = np.unique(plane.spectrograph, return_counts=True)
    assert len(groups) == 16
    assert set(counts) == {250}
    # groups are contiguous: all distances from the mean position are less than the width of a block of 250 cells
    for g in groups:
        block = plane.xy.value[plane.spectrograph == g]
        assert np.hypot(*(block - block.mean(axis=0)).T).max() < 650


def test_desi_and_pfs_layouts(presets):
    desi, pfs = presets["desi"].focal_plane, presets["pfs"].focal_plane
    assert set(np.unique(desi.spectrograph, return_counts=True)[1]) == {500}
    assert np.hypot(*desi.xy.value.T).min() >= 28.6
    x, y = pfs.xy.value.T
    assert (x.min(), x.max()) == pytest.approx((-193.99, 193.99), abs=0.01)
    assert (y.min(), y.max()) == pytest.approx((-220.0, 224.0))
    # three equal groups of 798, which differ by rotations of 120 deg
    turned = np.deg2rad(120)
    again = pfs.xy.value @ [[np.cos(turned), np.sin(turned)], [-np.sin(turned), np.cos(turned)]]
    assert len(np.unique(np.round(np.vstack([pfs.xy.value, again]), 6) + 0.0, axis=0)) == 2394


def test_sdss_layout(presets):
    plane = presets["sdss_apo"].focal_plane
    types, counts = np.unique(plane.fiber_type, return_counts=True)
    assert dict(zip(types.tolist(), counts.tolist(), strict=True)) == {"BOSS": 202, "BOSS+APOGEE": 298}
    assert len(plane.obstacles) == 46
    index = {name: k for k, name in enumerate(plane.id)}
    assert "R0C14" not in index  # there is no positioner in the central hole
    np.testing.assert_allclose(plane.xy[index["R0C1"]].value, [-13 * 22.4, 0], atol=1e-9)
    np.testing.assert_allclose(plane.xy[index["R+13C1"]].value, [-6.5 * 22.4, 13 * 22.4 * np.sqrt(3) / 2])
    assert np.hypot(*plane.xy.value.T).max() == pytest.approx(291.2)
    # no fiducial is at the position of a robot
    gap = np.hypot(*(plane.xy.value[:, None] - plane.obstacles.value[None, :, :2]).transpose(2, 0, 1))
    assert gap.min() == pytest.approx(22.4)
    for name, radius in (("sdss_apo", 1.414), ("sdss_lco", 0.947)):
        assert presets[name].field_radius.value == pytest.approx(radius, abs=1e-3)


def test_target_density_is_per_fiber(presets):
    lamost = presets["lamost"]
    area = 2 * np.pi * (1 - np.cos(lamost.field_radius.to_value(u.rad))) * (180 / np.pi) ** 2
    assert lamost.target_density.value * area == pytest.approx(4 * 4000)


DESCRIPTION = """
    schema = 1
    name = "mine"
    layout_is = "as built"
    [positioner]
    central_arm = { value = 0.3, unit = "cm", status = "assumed", source = "a test of mine" }
    eccentric_arm = { value = 5.0, unit = "mm", status = "assumed", source = "a test of mine" }
    clearance = { value = 1.0, unit = "mm", status = "assumed", source = "a test of mine" }
    [layout]
    rings = { value = 2, status = "assumed", source = "a test of mine" }
    pitch = { value = 12.0, unit = "mm", status = "assumed", source = "a test of mine" }
    [optics]
    plate_scale = { value = 60.0, unit = "um / arcsec", status = "assumed", source = "a test of mine" }
"""


def test_an_instrument_of_ones_own(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(textwrap.dedent(DESCRIPTION))
    mine = rs.Instrument.read(path)
    assert (mine.layout, len(mine.focal_plane)) == ("as built", 19)
    assert mine.focal_plane.positioner.outer_radius == 8 * u.mm
    assert mine.plate_scale.to_value(u.mm / u.deg) == pytest.approx(216)


def test_other_packages_add_instruments(tmp_path, monkeypatch):
    """The distribution has an entry point, as if pip had installed it."""
    (tmp_path / "mine.toml").write_text(textwrap.dedent(DESCRIPTION))
    (tmp_path / "their_package.py").write_text(
        "from pathlib import Path\nimport rfpsurvey as rs\npath = Path(__file__).with_name('mine.toml')\n"
        "def make():\n    return rs.Instrument.read(path)\n"
    )
    info = tmp_path / "their_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: their-package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[rfpsurvey.instruments]\ntheirs = their_package:make\ntheir_file = their_package:path\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert {"theirs", "their_file"} <= set(rs.available_instruments())
    for name in ("theirs", "their_file"):
        assert rs.Instrument.preset(name).name == "mine"
    sys.modules.pop("their_package", None)


BAD_DESCRIPTIONS = [
    ("[[", "cannot be read as TOML"),
    ('name = "x"', "must have the section .positioner."),
    (DESCRIPTION.replace('"assumed"', '"rumored"', 1), "unknown status of positioner.central_arm 'rumored'"),
    (DESCRIPTION.replace("rings = { value = 2", "rings = { value = 1.5"), "rings must be a whole number"),
    (DESCRIPTION.replace("value = 0.3", "value = -1"), "positioner.central_arm must be a length above 0, got -1 cm"),
    (
        DESCRIPTION.replace('unit = "um / arcsec"', 'unit = "um"'),
        "the unit of optics.plate_scale must be convertible to mm / rad, got 'um'",
    ),
    (DESCRIPTION.replace('unit = "cm"', 'unit = "centimetre"'), "centimetre"),
    (DESCRIPTION.replace("pitch = ", "pich = "), "unknown entry of .layout. 'pich'.* Did you mean 'pitch'"),
]


@pytest.mark.parametrize(("content", "message"), BAD_DESCRIPTIONS)
def test_bad_descriptions_are_named(tmp_path, content, message):
    path = tmp_path / "bad.toml"
    path.write_text(textwrap.dedent(content))
    assert "bad.toml" in refused(message, rs.Instrument.read, path)


def test_unknown_names_list_the_choices(tmp_path):
    refused(
        "unknown instrument 'lamst'; choose one of: .*lamost.* Did you mean 'lamost'", rs.Instrument.preset, "lamst"
    )
    refused("there is no such file", rs.Instrument.read, tmp_path / "missing.toml")


def test_the_description_in_the_documentation_works(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "instruments.rst").read_text()
    block = page.split(".. code-block:: toml\n")[1].split("\n``rfpsurvey plan")[0]
    path = tmp_path / "mine.toml"
    path.write_text(textwrap.dedent(block))
    assert len(rs.Instrument.read(path).focal_plane) == 469
    (tmp_path / "wider.toml").write_text('inherits = "mine"\nname = "wider"\n[layout]\nrings.value = 2\n')
    refused("layout.rings must have a status, got only value", rs.Instrument.read, tmp_path / "wider.toml")
    rings = 'rings = { value = 2, status = "assumed", source = "a smaller one" }\n'
    (tmp_path / "wider.toml").write_text(f'inherits = "mine"\nname = "wider"\n[layout]\n{rings}')
    assert len(rs.Instrument.read(tmp_path / "wider.toml").focal_plane) == 19


def test_every_fiber_type_needs_a_map(presets):
    sdss = presets["sdss_apo"]
    with pytest.raises(rs.InputError, match="must have a map for the fiber type 'APOGEE'"):
        rs.Instrument("half", sdss.focal_plane, distortion={"BOSS": sdss.distortion["BOSS"]})


def test_what_tiles_of_each_preset_must_hold(presets):
    expected = {
        "lamost": ("sky=20/spectrograph", "standard=5/spectrograph"),
        "sdss_apo": ("sky@BOSS=50", "sky@APOGEE=35", "standard@BOSS=50", "standard@APOGEE=15"),
        "sdss_lco": ("sky@BOSS=50", "sky@APOGEE=35", "standard@BOSS=50", "standard@APOGEE=15"),
        "moons": (),
        "desi": ("sky=40/spectrograph", "standard=10/spectrograph"),
        "pfs": ("sky=240", "standard=40"),
    }
    for name, texts in expected.items():
        assert presets[name].requirements == texts
        assert tuple(str(rs.Requirement.parse(text)) for text in texts) == texts


def test_descriptions_of_a_later_form_are_refused(tmp_path):
    text = (Path(rs.__file__).parent / "presets" / "lamost.toml").read_text()
    (tmp_path / "later.toml").write_text(text.replace("schema = 1", "schema = 2"))
    refused("schema must be 1, the only schema .* reads, got 2", rs.Instrument.read, tmp_path / "later.toml")


def test_copies_for_other_processes_leave_out_what_is_computed():
    """Regression: plain arrays of 3 MB for 5000 positioners were copied to each process of a survey."""
    center, desi = SkyCoord(95, 23, unit="deg"), rs.Instrument.preset("desi")
    sky = rs.synthetic_catalog("uniform", center, 1 * u.deg, n_targets=5000, rng=1)
    sizes, tile = [len(pickle.dumps(one)) for one in (desi, sky)], rs.plan_tile(sky, desi, center)
    assert "arrays" in vars(sky)
    assert "arrays" in vars(desi.focal_plane)
    np.testing.assert_allclose([len(pickle.dumps(one)) for one in (desi, sky)], sizes, atol=200)
    desi, sky = (pickle.loads(pickle.dumps(one)) for one in (desi, sky))
    again = rs.plan_tile(sky, desi, center)
    assert again.provenance["instrument"] == tile.provenance["instrument"]
    np.testing.assert_array_equal(again.table["target_id"].filled(-1), tile.table["target_id"].filled(-1))
    np.testing.assert_array_equal(again.table["tip_x"].value, tile.table["tip_x"].value)


def test_functions_share_the_instruments_that_are_given_by_name():
    """Regression: each call of `plan_tile` with the name of a preset read the preset and computed its arrays again."""
    assert as_instrument("moons") is as_instrument("moons")
    assert rs.Instrument.preset("moons") is not as_instrument("moons")
    assert rs.Instrument.preset("moons").provenance == as_instrument("moons").provenance
