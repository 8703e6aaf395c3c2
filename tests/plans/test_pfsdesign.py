import hashlib

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from pfs_files import centers, design, write_design
from raising import refused, warned

import rfpsurvey as rs
from rfpsurvey._field.format_pfsdesign_write import design_id
from rfpsurvey._instruments.pfs_files import PFI_ANGLE, pfs_fibers
from rfpsurvey.errors import InputError

REAL = "pfs/pfsDesign-0x2a3e0e7f53f47587.fits.gz"


def assert_same(one, two):
    assert one.colnames == two.colnames
    for name in one.colnames:
        a, b = np.asarray(one[name]), np.asarray(two[name])
        assert a.dtype == b.dtype, name
        assert one[name].unit == two[name].unit
        np.testing.assert_array_equal(a, b, err_msg=name)
    assert (list(one.meta), repr(one.meta)) == (list(two.meta), repr(two.meta))


def test_a_design_is_recognized_and_read(tmp_path):
    path = write_design(tmp_path / "d.fits")
    assert rs.plans.recognize_plan(path) == "pfsdesign"
    plan = rs.plans.read_plan(path)
    assert (plan["positioner"][:3].tolist(), plan["positioner"][-1]) == ([1, 2, 3], -1)
    assert plan["kind"][:6].tolist() == ["science", "science", "sky", "standard", "", "science"]
    assert (plan["assigned"].sum(), plan["target_id"][0], plan["x"].unit) == (48, 10**15 + 1, u.mm)
    assert (plan["fiberId"][0], plan["psfFlux"].shape) == (pfs_fibers()[0][0], (61, 2))
    assert (plan["psfFlux"].unit, plan["filterName"][-1].tolist()) == (u.nJy, ["", ""])
    assert (plan.meta["racen"], plan.meta["position_angle"]) == (150.0, PFI_ANGLE)
    assert plan.meta["header"]["DSGN_NAM"] == "test"
    assert plan.meta["guide_stars"]["columns"]["agX"] == [1.5, 2.0, 3.0]


def test_a_design_without_an_identifier_is_recognized(tmp_path):
    """Files of the second version of the format can lack the card W_PFDSGN; such a file was read as any table."""
    path = write_design(tmp_path / "d.fits", DAMD_VER=2)
    with fits.open(path) as units:
        units[0].header.remove("W_PFDSGN")
        units.writeto(tmp_path / "e.fits")
    plan, other = (rs.plans.read_plan(one) for one in (path, tmp_path / "e.fits"))
    assert "W_PFDSGN" not in other.meta["header"]
    assert (plan["target_id"] == other["target_id"]).all()
    assert other.meta["instrument"] == "pfs"


def test_reading_writing_and_reading_preserves_everything(tmp_path):
    plan = rs.plans.read_plan(write_design(tmp_path / "d.fits"))
    for name in ("e.fits", "e.fits.gz"):
        rs.plans.write_plan(plan, tmp_path / name)
        assert_same(plan, rs.plans.read_plan(tmp_path / name))


def test_a_design_that_was_stored_as_ecsv_can_be_written_unchanged(tmp_path):
    path = write_design(tmp_path / "d.fits")
    rs.plans.write_plan(rs.plans.read_plan(path), tmp_path / "d.ecsv")
    rs.plans.write_plan(rs.plans.read_plan(tmp_path / "d.ecsv"), tmp_path / "e.fits")
    with fits.open(path) as one, fits.open(tmp_path / "e.fits") as two:
        assert [unit.name for unit in one] == [unit.name for unit in two]
        for k in (1, 2, 3):
            assert one[k].columns.names == two[k].columns.names
            assert one[k].columns.formats == two[k].columns.formats
            assert one[k].data.tobytes() == two[k].data.tobytes()
        assert dict(one[0].header) == dict(two[0].header)


def test_the_real_design_is_preserved_to_the_byte(real_data, tmp_path):
    path = real_data(REAL)
    plan = rs.plans.read_plan(path)
    assert (len(plan), plan["assigned"].sum()) == (2458, 2082)
    rs.plans.write_plan(plan, tmp_path / "pfsDesign-0x2a3e0e7f53f47587.fits")
    assert_same(plan, rs.plans.read_plan(tmp_path / "pfsDesign-0x2a3e0e7f53f47587.fits"))
    assert fits.FITSDiff(path, tmp_path / "pfsDesign-0x2a3e0e7f53f47587.fits").identical
    assert plan.meta["rows_id"] == 0x2A3E0E7F53F47587


def test_the_identifier_is_the_published_hash():
    # the example in the tests of the data model
    random = np.random.RandomState(123)
    ra = np.array([random.uniform(0.0, 360.0) for _ in range(2394)])
    dec = np.array([random.uniform(-90.0, 90.0) for _ in range(2394)])
    assert design_id(np.arange(2394), ra, dec) == 0x189BEF816FD508C0
    # the rule adds 0.5 arcsec and truncates toward zero, so that negative values are not rounded to the nearest arcsec
    text = "['1 0.000000 -80.999722', '456 123.700000 17.860000']"
    number = int(hashlib.sha1(text.encode()).hexdigest(), 16) % 2**63
    assert design_id(np.array([1, 456]), np.array([0.0, 123.7]), np.array([-81 - 0.1 / 3600, 17.86])) == number
    assert design_id(np.array([1, 2]), np.zeros(2), np.zeros(2)) == 0


def test_the_identifier_changes_with_the_coordinates_and_must_be_that_of_the_name(tmp_path):
    plan = rs.plans.read_plan(write_design(tmp_path / "d.fits", W_PFDSGN=77))
    rs.plans.write_plan(plan, tmp_path / "same.fits")
    assert rs.plans.read_plan(tmp_path / "same.fits").meta["header"]["W_PFDSGN"] == 77
    plan["dec"][0] += 2 * u.arcsec
    rs.plans.write_plan(plan, tmp_path / "other.fits")
    number = rs.plans.read_plan(tmp_path / "other.fits").meta["header"]["W_PFDSGN"]
    assert number == design_id(plan["fiberId"], plan["ra"].value, plan["dec"].value) != 77
    rs.plans.write_plan(plan, tmp_path / f"pfsDesign-0x{number:016x}.fits")
    with pytest.raises(InputError, match=f"must have the name pfsDesign-0x{number:016x}.fits"):
        rs.plans.write_plan(plan, tmp_path / "pfsDesign-0x000000000000004d.fits")
    assert not (tmp_path / "pfsDesign-0x000000000000004d.fits").exists()


def test_newer_columns_are_used(tmp_path):
    n = 61
    more = {
        "cobraId": np.append(np.arange(60)[::-1] + 1, 65533).astype("i4"),
        "epoch": np.full(n, "J2016.0"),
        "pmRa": np.full(n, 1.5, "f4"),
        "pmDec": np.full(n, -2.5, "f4"),
        "obCode": np.array([f"ob{k}" for k in range(n)]),
    }
    plan = rs.plans.read_plan(write_design(tmp_path / "d.fits", design(**more)))
    assert (plan["positioner"][:2].tolist(), plan["positioner"][-1]) == ([60, 59], -1)
    assert (plan["pm_ra"][0], plan.meta["epoch"]) == (1.5 * u.mas / u.yr, "J2016.0")
    rs.plans.write_plan(plan, tmp_path / "e.fits")
    assert_same(plan, rs.plans.read_plan(tmp_path / "e.fits"))


def moving(n=61):
    """Return the columns of a design of version 4 whose targets move by up to 100 arcsec in 10 years."""
    motion = np.random.default_rng(3).uniform(-1e4, 1e4, (2, n)).astype("f4")
    cobra = np.append(np.arange(1, n), 65533).astype("i4")
    return {"cobraId": cobra, "epoch": np.full(n, "J2016.0"), "pmRa": motion[0], "pmDec": motion[1]}


def test_a_design_with_an_epoch_as_text_is_scored_from_the_sky(presets, tmp_path):
    """Targets with proper motions were refused, because designs contain epochs such as J2016.0."""
    plan = rs.plans.read_plan(write_design(tmp_path / "d.fits", design(**moving())))
    with pytest.warns(rs.RfpsurveyWarning, match="out of reach"):  # the sky positions of the design are approximate
        still = rs.score_tile(plan, presets["pfs"], positions="sky")
    assert still.summary["epoch"].startswith("the targets are at the epoch of the catalog (J2016.000)")
    moved = warned("out of reach", lambda: rs.score_tile(plan, presets["pfs"], positions="sky", epoch=2026.0))
    shift = SkyCoord(moved.table["ra"], moved.table["dec"]).separation(SkyCoord(still.table["ra"], still.table["dec"]))
    expected = 10 * np.hypot(plan["pm_ra"], plan["pm_dec"])[plan["assigned"]].to_value(u.mas / u.yr)
    shift = shift[np.isfinite(shift)].to_value(u.mas)
    np.testing.assert_allclose(sorted(shift), sorted(expected), rtol=1e-3)


def test_a_design_with_an_epoch_as_text_is_a_catalog(presets, tmp_path):
    path = write_design(tmp_path / "d.fits", design(**moving()))
    plan = rs.plans.read_plan(path)
    with pytest.warns(rs.RfpsurveyWarning):
        own = rs.Catalog.read(path)
    catalog = rs.Catalog.from_table(plan[plan["assigned"]])
    assert own.id.tolist() == catalog.id.tolist()
    assert set(catalog.kind.tolist()) == {"science", "sky", "standard"}
    np.testing.assert_allclose(own.epoch.jyear, 2016)
    tile = rs.plan_tile(catalog, presets["pfs"], SkyCoord(150 * u.deg, -2 * u.deg), epoch=2016.0)
    assert tile.summary["n_assigned"] > 10


def test_a_tile_becomes_a_design_with_the_same_assignment_and_collisions(presets, tmp_path):
    pfs, center = presets["pfs"], SkyCoord(150 * u.deg, 2 * u.deg)
    sky = rs.synthetic_catalog("uniform", center, pfs.field_radius, n_targets=3000, rng=2)
    tile = rs.plan_tile(sky, pfs, center, position_angle=30 * u.deg, allocator="lamost_rule")
    path = tmp_path / "d.fits"
    warned("without the columns theta, phi", rs.plans.write_plan, tile, path, format="pfsdesign")
    plan = rs.plans.read_plan(path)
    assert (len(plan), plan["fiberId"].tolist()) == (2394 + 64, sorted(plan["fiberId"].tolist()))
    np.testing.assert_allclose(plan.meta["position_angle"], 30, atol=1e-6)
    header = fits.getheader(path)
    assert header["W_PFDSGN"] == plan.meta["rows_id"]
    np.testing.assert_allclose(header["POSANG"], 30 - PFI_ANGLE)
    again = rs.score_tile(plan, pfs)
    for name in ("n_assigned", "n_colliding", "n_out_of_reach", "n_colliding_pairs"):
        assert again.summary[name] == tile.summary.get(name, 0)
    one = {row["id"]: row["target_id"] for row in tile.table if row["status"] == "assigned"}
    assert one == {row["id"]: row["target_id"] for row in again.table if row["status"] == "assigned"}


def test_the_frame_of_the_plan_is_that_of_the_sky(real_data, presets):
    """At the position angle of the plan, the projection of the preset gives the nominal positions of the design."""
    plan = rs.plans.read_plan(real_data(REAL))
    plan = plan[plan["assigned"]]
    center = SkyCoord(plan.meta["racen"] * u.deg, plan.meta["deccen"] * u.deg)
    projection = presets["pfs"].projection(center, plan.meta["position_angle"] * u.deg)
    xy = projection.to_focal_plane(SkyCoord(plan["ra"], plan["dec"])).to_value(u.mm)
    given = np.column_stack([plan["x"].value, plan["y"].value])
    # the positions of the design are smaller by 0.05 %
    assert np.abs(xy - given).max() < 0.13
    scale = (xy * given).sum() / (xy**2).sum()
    np.testing.assert_allclose(scale, 0.9995, atol=2e-5)
    assert np.abs(scale * xy - given).max() < 0.02


def test_the_fiber_map_assigns_each_fiber_of_the_design_to_a_cobra_nearby(real_data):
    """The calibration of the design differs by millimeters, but wrong boards would be farther than 10 mm."""
    plan = rs.plans.read_plan(real_data(REAL))
    plan = plan[plan["assigned"]]
    xy = np.column_stack([plan["x"].value, plan["y"].value])
    apart = np.hypot(*(xy - centers()[plan["positioner"] - 1]).T)
    assert apart.max() < 10
    assert np.median(apart) < 4


def test_a_design_of_another_instrument_or_with_text_identifiers_is_refused(presets, tmp_path):
    lamost = presets["lamost"]
    x, y = lamost.focal_plane.xy[:2].T
    tile = rs.score_tile(_table([0, 1], x, y), lamost)
    refused("must be pfs, got lamost", rs.plans.write_plan, tile, tmp_path / "d.fits", format="pfsdesign")
    pfs = presets["pfs"]
    x, y = pfs.focal_plane.xy[:2].T
    table = _table(pfs.focal_plane.id[:2], x, y)
    with pytest.raises(InputError, match="must have racen in its meta"):
        rs.plans.write_plan(rs.score_tile(table, pfs), tmp_path / "d.fits", format="pfsdesign")
    table["target_id"] = ["star-a", "star-b"]
    with pytest.raises(InputError, match="objId must be whole numbers"):
        rs.plans.write_plan(rs.score_tile(table, pfs), tmp_path / "d.fits", format="pfsdesign")
    assert list(tmp_path.iterdir()) == []


def _table(ids, x, y):
    from astropy.table import QTable

    return QTable({"positioner": ids, "x": x, "y": y})


DAMAGES = [
    ({"leave_out": ("PHOTOMETRY",)}, "must have the extension PHOTOMETRY, got DESIGN, GUIDESTARS"),
    ({"leave_out": ("GUIDESTARS",)}, "must have the extension GUIDESTARS, got DESIGN, PHOTOMETRY"),
    ({"leave_out": ("pfiNominal",)}, "DESIGN must have the column 'pfiNominal'"),
    ({"leave_out": ("filterName",)}, "PHOTOMETRY must have the column 'filterName'"),
    ({"RA": None}, "the header card RA must be a finite number, got None"),
    ({"RA": "east"}, "the header card RA must be a finite number, got 'east'"),
    ({"tables": design(ra=np.full(61, "12:00"))}, "the column 'ra' of DESIGN must hold numbers, got <U5"),
    ({"tables": design(objId=np.full(61, 1.5))}, "the column 'objId' of DESIGN must hold whole numbers, got float64"),
    ({"tables": design(pfiNominal=np.zeros(61, "f4"))}, "'pfiNominal' of DESIGN must have two values per row"),
    ({"tables": design(fiberId=np.full(61, 7, "i4"))}, "fiberId must be unique, but 7 occurs more than once"),
]


@pytest.mark.parametrize(("damage", "message"), DAMAGES)
def test_damaged_designs_are_refused_with_one_sentence(tmp_path, damage, message):
    path = write_design(tmp_path / "d.fits", **damage)
    text = refused(message, rs.plans.read_plan, path, format="pfsdesign")
    assert text.startswith(str(path))
    assert "\n" not in text


@pytest.mark.parametrize("fraction", [0.0, 0.1, 0.5, 0.87])
def test_truncated_designs_are_refused(tmp_path, fraction):
    content, path = write_design(tmp_path / "d.fits").read_bytes(), tmp_path / "e.fits"
    path.write_bytes(content[: int(fraction * len(content))])
    with pytest.raises(InputError, match="cut off|empty|end with the card END|multiple of 2880") as caught:
        rs.plans.read_plan(path, format="pfsdesign")
    assert "\n" not in str(caught.value)


def test_photometry_of_unknown_fibers_is_refused(tmp_path):
    columns, flux, stars = design()
    flux["fiberId"][3] = 2603
    with pytest.raises(InputError, match="only fibers of DESIGN, got the fiberId 2603"):
        rs.plans.read_plan(write_design(tmp_path / "d.fits", (columns, flux, stars)))


def test_a_failure_leaves_no_file(tmp_path):
    plan = rs.plans.read_plan(write_design(tmp_path / "d.fits"))
    plan["patch"] = np.full(len(plan), "é")
    refused("cannot be written as FITS", rs.plans.write_plan, plan, tmp_path / "e.fits")
    del plan["catId"]
    refused("the plan must have the column 'catId'", rs.plans.write_plan, plan, tmp_path / "e.fits")
    assert [path.name for path in tmp_path.iterdir()] == ["d.fits"]


def test_columns_that_a_design_cannot_hold_are_named(tmp_path):
    plan = rs.plans.read_plan(write_design(tmp_path / "d.fits"))
    plan["priority"] = 1.0
    warned("without the column priority", rs.plans.write_plan, plan, tmp_path / "e.fits")
