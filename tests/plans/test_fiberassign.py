"""Files of fiberassign that the test writes according to its data model."""

import gzip

import astropy.units as u
import desi_files
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.table import Column, QTable
from numpy.testing import assert_array_equal
from raising import refused, warned

import rfpsurvey as rs
from rfpsurvey import plans

FEW = 20  # positioners of each petal
pytestmark = pytest.mark.filterwarnings("ignore:.*DESI has 5000 positioners")


@pytest.fixture
def path(tmp_path):
    desi_files.tile(tmp_path / "fiberassign-004403.fits", per_petal=FEW)
    return tmp_path / "fiberassign-004403.fits"


@pytest.fixture
def built(tmp_path):
    """Return the instrument whose positioners the files assign."""
    desi_files.metrology(tmp_path / "fp.csv", per_petal=FEW)
    return rs.Instrument.from_desi(tmp_path / "fp.csv")


def assert_same(one, other):
    assert one.colnames == other.colnames
    for name in one.colnames:
        assert one[name].dtype == other[name].dtype, name
        assert getattr(one[name], "unit", None) == getattr(other[name], "unit", None), name
        assert_array_equal(np.asarray(one[name]), np.asarray(other[name]), name)
    assert {k: v for k, v in one.meta.items() if k != "extensions"} == {
        k: v for k, v in other.meta.items() if k != "extensions"
    }


def test_the_common_columns_are_those_of_the_file(path):
    plan, native = plans.read_plan(path), fits.getdata(path, "FIBERASSIGN")
    assert_array_equal(plan["positioner"], native["LOCATION"])
    assert_array_equal(plan["target_id"], native["TARGETID"])
    assert_array_equal(plan["x"].to_value(u.mm), -native["FIBERASSIGN_X"])
    assert_array_equal(plan["y"].to_value(u.mm), native["FIBERASSIGN_Y"])
    assert_array_equal(plan["ra"].to_value(u.deg), native["TARGET_RA"])
    assert_array_equal(plan["pm_dec"].to_value(u.mas / u.yr), native["PMDEC"])
    assert_array_equal(plan["priority"], native["PRIORITY"])
    assert_array_equal(plan["SUBPRIORITY"], native["SUBPRIORITY"])
    assert plan["FLUX_G"].unit.to_string() == "nanomaggy"
    bits, names = native["FA_TYPE"], {0: "", 1: "science", 2: "standard", 3: "science+standard"}
    kind = np.where((bits & 20) > 0, "sky", [names[one] for one in (bits & 3).tolist()])
    assert_array_equal(plan["kind"], kind)
    # stuck positioners and broken fibers have no target; restricted positioners (8) can have one
    assert_array_equal(plan["assigned"], ~np.isin(native["FIBERSTATUS"], (1, 2, 4)))
    assert plan["assigned"][3]
    meta = {"format": "fiberassign", "instrument": "desi", "racen": 170.239, "deccen": -7.093, "epoch": "J2015.500"}
    assert meta.items() <= plan.meta.items()
    assert (plan.meta["position_angle"], plan.meta["header"]["TILEID"]) == (-0.0210480650645507, 4403)
    assert plan.meta["header"]["FAARGS"] == ("--doclean n --dr dr9 " * 8).strip()
    assert "NAXIS2" not in plan.meta["header"]


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["copy.fits", "copy.fits.gz"])
def test_a_plan_that_is_written_and_read_again_is_the_same(path, tmp_path, name):
    plan = plans.read_plan(path)
    plans.write_plan(plan, tmp_path / name, format="fiberassign")
    again = plans.read_plan(tmp_path / name)
    assert_same(plan, again)
    assert len(plan.meta["extensions"]) == 4
    for one, other in zip(plan.meta["extensions"], again.meta["extensions"], strict=True):
        assert_same(one, other)
    with fits.open(path) as first, fits.open(tmp_path / name) as second:
        assert [unit.name for unit in first] == [unit.name for unit in second]
        assert first["FIBERASSIGN"].columns.names == second["FIBERASSIGN"].columns.names
        for unit, copy in zip(first[1:], second[1:], strict=True):
            assert_array_equal(unit.data, copy.data)


def test_sky_positions_agree_with_those_on_the_focal_plane(tmp_path, presets):
    """Sky positions are computed as by radec2xy of fiberassign, with CS5. This tests the signs of x and of the position
    angle.
    """
    desi = presets["desi"]
    center, rotation = SkyCoord(170.239 * u.deg, -7.093 * u.deg), 0.3 * u.deg

    def place(table):
        x, y = table["FIBERASSIGN_X"], table["FIBERASSIGN_Y"]
        # the angle of a target from west toward north, seen from the field center, is that of (x, y) in CS5 minus the
        # field rotation
        angle = np.arctan2(y, x) * u.rad - rotation
        away = desi.distortion.to_angle(np.hypot(x, y) * u.mm)
        sky = center.directional_offset_by(270 * u.deg + angle, away)
        table["TARGET_RA"], table["TARGET_DEC"] = sky.ra.deg, sky.dec.deg

    desi_files.tile(tmp_path / "tile.fits", per_petal=FEW, edit=place, header={"FIELDROT": rotation.value})
    plan = plans.read_plan(tmp_path / "tile.fits")
    projection = desi.projection(
        SkyCoord(plan.meta["racen"] * u.deg, plan.meta["deccen"] * u.deg), plan.meta["position_angle"] * u.deg
    )
    xy = projection.to_focal_plane(SkyCoord(plan["ra"], plan["dec"]))
    assert np.abs(xy - np.column_stack([plan["x"], plan["y"]])).max() < 1e-4 * u.mm


def test_a_plan_can_be_scored(path, built):
    tile, native = rs.score_tile(plans.read_plan(path), built), fits.getdata(path, "FIBERASSIGN")
    used = ~np.isin(native["FIBERSTATUS"], (1, 2, 4))
    assert (tile.summary["n_assigned"], tile.summary["n_out_of_reach"]) == (used.sum(), 0)
    assert_array_equal(tile.table["target_id"][used], native["TARGETID"][used])


def test_scoring_requires_the_instrument_as_built(path, presets):
    with pytest.raises(rs.errors.InputError, match="use the instrument as built, because its positioners have the ids"):
        rs.score_tile(plans.read_plan(path), presets["desi"])


def test_a_tile_that_is_written_scores_the_same(tmp_path, built):
    center = SkyCoord(170 * u.deg, -7 * u.deg)
    sky = rs.synthetic_catalog("uniform", center, 1.6 * u.deg, density=900 / u.deg**2, rng=5)
    sky = rs.Catalog(sky.coord, id=np.arange(1, len(sky) + 1), epoch=2026.5)
    tile = rs.plan_tile(sky, built, center, position_angle=10 * u.deg, allocator="lamost_rule")
    warned("without the columns theta, phi", plans.write_plan, tile, tmp_path / "tile.fits", format="fiberassign")
    plan = plans.read_plan(tmp_path / "tile.fits")
    assert (plan.meta["position_angle"], plan.meta["racen"]) == (10, 170)
    again = rs.score_tile(plan, built)
    for name in ("id", "status", "in_collision", "colliding_with"):
        assert_array_equal(tile.table[name], again.table[name], name)
    has = tile.table["status"] == "assigned"
    assert_array_equal(tile.table["target_id"][has], again.table["target_id"][has])
    native = fits.getdata(tmp_path / "tile.fits", "FIBERASSIGN")
    assert_array_equal(native["FIBERSTATUS"] == 0, has)
    assert (native["TARGETID"][~has] < 0).all()
    assert len(np.unique(native["TARGETID"])) == len(native)
    assert_array_equal(native["PETAL_LOC"] * 1000 + native["DEVICE_LOC"], native["LOCATION"])
    assert (native["TARGETID"].dtype, native["FIBERASSIGN_X"].dtype) == (">i8", ">f4")
    assert set(native["OBJTYPE"]) <= {"TGT", ""}
    assert set(native["REF_EPOCH"]) == {2026.5}


def test_changes_of_a_plan_are_written(path, tmp_path):
    plan = plans.read_plan(path)
    plan["assigned"][4], plan["kind"][5] = False, "sky"
    plan["x"][6] = 12.5 * u.mm
    plans.write_plan(plan, tmp_path / "new.fits", format="fiberassign")
    native, before = fits.getdata(tmp_path / "new.fits", 1), fits.getdata(path, 1)
    assert (native["FIBERSTATUS"][4], native["OBJTYPE"][5], native["FA_TYPE"][5]) == (1, "SKY", 4)
    assert native["FIBERASSIGN_X"][6] == -12.5
    assert (native["FIBERSTATUS"] != before["FIBERSTATUS"]).sum() == 1
    again = plans.read_plan(tmp_path / "new.fits")
    assert not again["assigned"][4]
    assert again["kind"][5] == "sky"


def test_a_fiber_that_gets_a_target_is_assigned(path, tmp_path):
    plan = plans.read_plan(path)
    assert not plan["assigned"][0]
    plan["assigned"][0], plan["target_id"][0], plan["kind"][0] = True, 77, "science"
    plans.write_plan(plan, tmp_path / "new.fits", format="fiberassign")
    native = fits.getdata(tmp_path / "new.fits", 1)
    assert (native["FIBERSTATUS"][0], native["TARGETID"][0], native["OBJTYPE"][0]) == (0, 77, "TGT")


def test_a_negative_target_is_none(tmp_path):
    def edit(table):
        table["TARGETID"][5] = -5

    desi_files.tile(tmp_path / "tile.fits", per_petal=FEW, edit=edit)
    plan = plans.read_plan(tmp_path / "tile.fits")
    assert plan["FIBERSTATUS"][5] == 0
    assert not plan["assigned"][5]


def test_positions_in_another_unit_are_converted(path, tmp_path):
    with fits.open(path) as units:
        units[1].data["FIBERASSIGN_X"] /= 10
        units[1].columns.change_unit("FIBERASSIGN_X", "cm")
        units.writeto(tmp_path / "cm.fits")
    one, other = plans.read_plan(path), plans.read_plan(tmp_path / "cm.fits")
    assert np.abs(one["x"] - other["x"]).max() < 1e-4 * u.mm


def test_the_format_is_recognized(path, tmp_path):
    assert plans.recognize_plan(path) == "fiberassign"
    (tmp_path / "zipped.fits.gz").write_bytes(gzip.compress(path.read_bytes()))
    assert plans.recognize_plan(tmp_path / "zipped.fits.gz") == "fiberassign"
    fits.HDUList([fits.PrimaryHDU()]).writeto(tmp_path / "empty.fits")
    assert plans.recognize_plan(tmp_path / "empty.fits") is None


def test_columns_with_the_names_of_common_columns_are_kept(tmp_path):
    """They replaced the common columns, so that text in a column ``assigned`` ended with a traceback."""

    def edit(table):
        for name in ("x", "kind", "assigned"):
            table[name] = "text"
        table.replace_column("FIBERSTATUS", Column(table["FIBERSTATUS"].astype("u1")))

    desi_files.tile(tmp_path / "a.fits", per_petal=FEW, edit=edit)
    plan = plans.read_plan(tmp_path / "a.fits")
    assert (plan["assigned"].dtype, plan["assigned_in_file"][0]) == (bool, "text")
    plan["assigned"][plan["assigned"]] = False
    plans.write_plan(plan, tmp_path / "b.fits")
    assert not plans.read_plan(tmp_path / "b.fits")["assigned"].any()
    with fits.open(tmp_path / "a.fits") as one, fits.open(tmp_path / "b.fits") as two:
        assert one["FIBERASSIGN"].columns.names == two["FIBERASSIGN"].columns.names
        assert one["FIBERASSIGN"].columns.formats == two["FIBERASSIGN"].columns.formats


def test_rows_of_different_lengths_and_their_texts(path, tmp_path):
    """Text with different lengths cannot be written to FITS; writing it ended with a traceback."""
    numbers = np.array([np.arange(k % 3) for k in range(200)], dtype=object)
    for form, values, message in (("PJ()", numbers, None), ("PA()", ["ab" * (k % 3) for k in range(200)], "vary")):
        with fits.open(path) as units:
            copies = fits.HDUList([unit.copy() for unit in units])
            column = fits.Column("vary", form, array=np.array(values, dtype=object))
            columns = [*copies[1].columns, column]
            copies[1] = fits.BinTableHDU.from_columns(columns, copies[1].header, name="FIBERASSIGN")
        copies.writeto(tmp_path / "a.fits", overwrite=True)
        plan = plans.read_plan(tmp_path / "a.fits")
        for name, kind in (("b.fits", "fiberassign"), ("c.fits", "table"), ("d.ecsv", "table")):
            if message and name != "d.ecsv":
                with pytest.raises(rs.InputError, match=f"{name}.* cannot be written as FITS: "):
                    plans.write_plan(plan, tmp_path / name, format=kind, overwrite=True)
                continue
            plan.meta["extensions"] = plan.meta["extensions"] if kind == "fiberassign" else []
            plans.write_plan(plan, tmp_path / name, format=kind, overwrite=True)
            again = plans.read_plan(tmp_path / name)
            assert [list(row) for row in again["vary"]] == [list(row) for row in plan["vary"]]


def test_the_other_tables_are_lost_in_other_formats(path, tmp_path):
    plan = plans.read_plan(path)
    warned("without the other tables of the file", plans.write_plan, plan, tmp_path / "plan.ecsv")
    assert_array_equal(plan["x"], plans.read_plan(tmp_path / "plan.ecsv")["x"])
    assert "extensions" in plan.meta


def test_the_keywords_of_another_format_are_lost(path, tmp_path):
    """They were left out without a warning."""
    plan = plans.read_plan(path)
    plan.meta["format"] = "confsummary"
    with pytest.warns(rs.errors.RfpsurveyWarning, match="the keywords of the header, which this format"):
        plans.write_plan(plan, tmp_path / "new.fits", format="fiberassign")


def without(name):
    return lambda table: table.remove_column(name)


def as_text(name):
    def edit(table):
        table[name] = np.array(table[name]).astype("U22")

    return edit


DAMAGED_FILES = [
    (without("FIBERASSIGN_X"), "FIBERASSIGN must have the column 'FIBERASSIGN_X'"),
    (without("FIBERSTATUS"), "FIBERASSIGN must have the column 'FIBERSTATUS'"),
    (as_text("FIBERASSIGN_Y"), "column 'FIBERASSIGN_Y' must hold numbers, got str"),
    (as_text("TARGETID"), "column 'TARGETID' must hold whole numbers, got str"),
    (lambda table: table["LOCATION"].__setitem__(1, 0), "LOCATION must be unique, but 0 occurs more than once"),
]


@pytest.mark.parametrize(("edit", "sentence"), DAMAGED_FILES)
def test_damaged_files_are_refused(tmp_path, edit, sentence):
    desi_files.tile(tmp_path / "bad.fits", per_petal=FEW, edit=edit)
    assert "bad.fits" in refused(sentence, plans.read_plan, tmp_path / "bad.fits")


def test_truncated_files_are_refused(path, tmp_path):
    content = path.read_bytes()
    for n in (100, 3000, 12_000, len(content) - 2880):
        (tmp_path / "cut.fits").write_bytes(content[:n])
        refused(r"cut\.fits", plans.read_plan, tmp_path / "cut.fits", format="fiberassign")
    zipped = gzip.compress(content)
    (tmp_path / "cut.fits.gz").write_bytes(zipped[: len(zipped) // 2])
    refused(r"cut\.fits\.gz cannot be read", plans.read_plan, tmp_path / "cut.fits.gz", format="fiberassign")


def test_wrong_units_and_keywords_are_refused(path, tmp_path):
    for unit, key, sentence in (
        ("deg", None, "column 'FIBERASSIGN_X' must have a unit convertible to mm, got deg"),
        (None, "TILERA", "the keyword TILERA must be an angle in degrees, got 'north'"),
    ):
        with fits.open(path) as units:
            header = units["FIBERASSIGN"].header
            if unit:
                number = units["FIBERASSIGN"].columns.names.index("FIBERASSIGN_X") + 1
                header[f"TUNIT{number}"] = unit
            else:
                header[key] = "north"
            units.writeto(tmp_path / "bad.fits", overwrite=True)
        refused(sentence, plans.read_plan, tmp_path / "bad.fits")


def test_plans_that_the_format_cannot_represent_are_refused(path, tmp_path, presets):
    plan = plans.read_plan(path)
    x, y = presets["lamost"].focal_plane.xy.T
    lamost = rs.score_tile(QTable({"positioner": np.arange(4000), "x": x, "y": y}), presets["lamost"])
    with pytest.raises(rs.errors.InputError, match="the instrument of a fiberassign file must be desi, got lamost"):
        plans.write_plan(lamost, tmp_path / "no.fits", format="fiberassign")
    nominal = QTable({"positioner": [4999], "x": [0.0] * u.mm, "y": [0.0] * u.mm})
    nominal = warned("out of reach", lambda: rs.score_tile(nominal, presets["desi"]))
    with pytest.raises(rs.errors.InputError, match="positioner must be a LOCATION of DESI"):
        plans.write_plan(nominal, tmp_path / "no.fits", format="fiberassign")
    refused(r"must end in .fits", plans.write_plan, plan, tmp_path / "no.ecsv", format="fiberassign")
    refused("exists", plans.write_plan, plan, path, format="fiberassign")
    plan.meta["header"]["OBSCON"] = "d\u00e4mmerig"
    refused("the keyword OBSCON cannot be written", plans.write_plan, plan, tmp_path / "no.fits", format="fiberassign")
    assert not list(tmp_path.glob("no*"))
    assert not list(tmp_path.glob(".rfpsurvey*"))


def test_a_tile_of_the_real_focal_plane_is_written_and_scored(tmp_path, real_data, tycho):
    desi = rs.Instrument.read(real_data("desi/fp-metrology.csv.gz"))
    center, stars = SkyCoord(95 * u.deg, 23 * u.deg), rs.Catalog.read(tycho)
    tile = rs.plan_tile(rs.Catalog(stars.coord, id=np.arange(len(stars))), desi, center, allocator="lamost_rule")
    warned("cannot hold", plans.write_plan, tile, tmp_path / "tile.fits.gz", format="fiberassign")
    again = rs.score_tile(plans.read_plan(tmp_path / "tile.fits.gz"), desi)
    assert tile.summary["n_assigned"] > 700
    for name in ("id", "spectrograph", "status", "in_collision", "colliding_with"):
        assert_array_equal(tile.table[name], again.table[name], name)
    has = tile.table["status"] == "assigned"
    assert_array_equal(tile.table["target_id"][has], again.table["target_id"][has])
    assert np.abs(tile.table["tip_x"] - again.table["tip_x"])[has].max() < 2e-5 * u.mm


def test_the_sum_of_the_bits_has_all_roles_of_a_target(path, tmp_path):
    plan = plans.read_plan(path)
    sums = {1: "science", 3: "science+standard", 5: "science+sky", 6: "standard+sky", 7: "science+standard+sky"}
    plan["kind"] = np.array([*sums.values()])[np.arange(len(plan)) % len(sums)]
    plans.write_plan(plan, tmp_path / "new.fits", format="fiberassign")
    native = fits.getdata(tmp_path / "new.fits", "FIBERASSIGN")
    expected = dict(zip(np.asarray(plan["positioner"]).tolist(), plan["kind"].tolist(), strict=True))
    assert [sums[one] for one in native["FA_TYPE"].tolist()] == [expected[one] for one in native["LOCATION"].tolist()]
    found = plans.read_plan(tmp_path / "new.fits")
    assert dict(zip(found["positioner"].tolist(), found["kind"].tolist(), strict=True)) == expected
