"""Files of plans contain the values of a plan exactly, or writing fails, or a warning states what the file contains."""

import astropy.units as u
import desi_files
import numpy as np
import pytest
from astropy.coordinates import FK5, SkyCoord
from astropy.io import fits
from astropy.time import Time
from numpy.testing import assert_array_equal
from raising import refused, warned

import rfpsurvey as rs
import sdssv_files
from rfpsurvey import plans

CENTER = SkyCoord(150 * u.deg, 20 * u.deg)
KINDS = {"fractions": lambda k: k % 4 / 4 + 0.25, "large": lambda k: 1e10 + k % 4, "integers": lambda k: k % 4 - 2.0}


@pytest.fixture
def desi(tmp_path):
    desi_files.metrology(tmp_path / "fp.csv", per_petal=20)
    return rs.Instrument.from_desi(tmp_path / "fp.csv")


def sky(instrument, n=2000, **columns):
    found = rs.synthetic_catalog("uniform", CENTER, instrument.field_radius, n_targets=n, rng=1)
    ids = np.arange(1, n + 1)
    return rs.Catalog(found.coord, id=ids, epoch=2026, **{name: make(ids) for name, make in columns.items()})


@pytest.mark.filterwarnings("ignore:.*written without the columns theta, phi", "ignore:.*DESI has 5000 positioners")
@pytest.mark.parametrize("kind", KINDS)
def test_priorities_of_a_fiberassign_file_keep_their_order_and_values(desi, tmp_path, kind):
    """Priorities from 0.25 to 1 became 0, 0, 0 and 1; large and missing ones became -2147483648."""
    tile, path = rs.plan_tile(sky(desi, priority=KINDS[kind]), desi, CENTER), tmp_path / "tile.fits"
    if kind == "integers":
        plans.write_plan(tile, path, format="fiberassign")
    else:
        with pytest.warns(rs.RfpsurveyWarning, match="PRIORITY contains ranks, which are larger for more important"):
            plans.write_plan(tile, path, format="fiberassign")
    native, has = fits.getdata(path, 1), np.asarray(tile.table["status"] == "assigned")
    given = np.asarray(tile.table["priority"])
    assert native["PRIORITY"].dtype == ">i4"
    assert len(np.unique(given[has])) == 4
    expected = [-2, -1, 0, 1] if kind == "integers" else [1, 2, 3, 4]
    assert_array_equal(native["PRIORITY"][has], np.array(expected)[np.searchsorted(np.unique(given[has]), given[has])])
    assert (native["PRIORITY"][~has] == 0).all()
    assert ("PRIORITY_VALUE" in native.names) == ("PRIORANK" in fits.getheader(path, 0)) == (kind != "integers")
    plan = plans.read_plan(path)
    assert_array_equal(plan["priority"][has], given[has])
    if kind != "integers":  # the plan is written without a loss again, and also with priorities that are integers
        warned("PRIORITY contains ranks", plans.write_plan, plan, tmp_path / "again.fits", format="fiberassign")
        assert_array_equal(plans.read_plan(tmp_path / "again.fits")["priority"], plan["priority"])
        plan["priority"] = np.arange(len(plan), dtype=float)
        plans.write_plan(plan, tmp_path / "whole.fits", format="fiberassign")
        assert fits.getdata(tmp_path / "whole.fits", 1)["PRIORITY"].dtype == ">i4"
        assert_array_equal(plans.read_plan(tmp_path / "whole.fits")["priority"], np.arange(len(plan)))
        assert "PRIORANK" not in fits.getheader(tmp_path / "whole.fits", 0)


@pytest.mark.filterwarnings("ignore:.*DESI has 5000 positioners")
@pytest.mark.parametrize("value", [0.5, np.nan, 2**40, -(2**40)])
@pytest.mark.parametrize("format_", ["fiberassign", "pfsdesign", "confsummary"])
def test_values_that_an_integer_column_cannot_represent_are_refused(tmp_path, real_data, format_, value):
    """Such values were rounded, or wrapped to other integers, without a warning."""
    if format_ == "confsummary":
        pytest.importorskip("pydl", reason="pydl is not installed")
        path, name = sdssv_files.configuration(tmp_path / "a.par"), "positionerId"
    elif format_ == "fiberassign":
        desi_files.tile(tmp_path / "a.fits", per_petal=20)
        path, name = tmp_path / "a.fits", "FIBER"
        if isinstance(value, int):
            pytest.skip("files of fiberassign keep the integer types of a plan")
    else:
        path, name = real_data("pfs/pfsDesign-0x2a3e0e7f53f47587.fits.gz"), "tract"
    plan = plans.read_plan(path)
    plan[name] = np.full(len(plan), value)
    new = tmp_path / f"new{'.par' if format_ == 'confsummary' else '.fits'}"
    refused(f"{name}'? .*must be whole numbers from -.*, got", plans.write_plan, plan, new, format=format_)
    assert not new.exists()


@pytest.mark.parametrize("ids", [np.uint64(2**63 + 5), "99999999999999999999", "star-1"])
def test_identifiers_that_are_no_64_bit_integers_are_refused(tmp_path, real_data, ids):
    """Large identifiers became other integers, or raised an OverflowError."""
    plan = plans.read_plan(real_data("pfs/pfsDesign-0x2a3e0e7f53f47587.fits.gz"))
    plan["target_id"] = np.full(len(plan), ids)
    refused("objId' of DESIGN must be whole numbers", plans.write_plan, plan, tmp_path / "new.fits", format="pfsdesign")


def test_the_code_for_missing_numbers_identifies_no_target(tmp_path):
    pytest.importorskip("pydl", reason="pydl is not installed")
    plan = plans.read_plan(sdssv_files.configuration(tmp_path / "a.par"))
    plan["target_id"] = np.where(plan["assigned"], -999, -1)
    refused("catalogid must differ from -999", plans.write_plan, plan, tmp_path / "b.par")


def test_columns_of_a_tile_are_copied_to_a_design_or_named(tmp_path, presets):
    """Columns such as tract were replaced by constants, and fluxes were left out, without a warning."""
    pfs = presets["pfs"]
    table = rs.plan_tile(sky(pfs), pfs, CENTER).table
    table["tract"], table["obCode"] = np.arange(len(table)), np.full(len(table), "abc")
    table["psfFlux"] = np.full(len(table), 2.0) * u.nJy
    with pytest.warns(rs.RfpsurveyWarning, match="without the columns theta, phi, psfFlux, which"):
        plans.write_plan(table, tmp_path / "new.fits", format="pfsdesign")
    plan = plans.read_plan(tmp_path / "new.fits")
    number = dict(zip(table["id"].tolist(), range(len(table)), strict=True))
    own = plan[plan["assigned"]]
    assert len(own) > 500
    assert own["tract"].tolist() == [number[k] for k in own["positioner"].tolist()]
    assert set(own["obCode"]) == {"abc"}
    assert set(plan["obCode"][~plan["assigned"]]) == {"N/A"}


WAVES = {"BOSS": 0.54 * u.um, "APOGEE": 1.6 * u.um}
PROJECTIONS = {
    "full": {"conditions": {"hour_angle": 40 * u.deg, "exposure_time": 900 * u.s, "tolerance": 5 * u.um}},
    "refraction": {"conditions": {"time": Time("2026-03-01T08:00:00")}, "projection": "refraction"},
    "tangent": {"projection": "tangent"},
}


@pytest.mark.filterwarnings("ignore:.*written without", "ignore:.*DESI has 5000 positioners")
@pytest.mark.few(3)
@pytest.mark.parametrize("model", PROJECTIONS)
@pytest.mark.parametrize("name", ["confsummary.par", "fiberassign.fits", "pfsdesign.fits", "table.ecsv", "table.fits"])
def test_a_plan_of_a_tile_is_scored_from_the_sky_as_it_was_planned(tmp_path, presets, desi, name, model):
    """Conditions and the north of position angles were lost, so that targets at edges were out of reach."""
    form, path = name.partition(".")[0], tmp_path / name
    if form == "confsummary":
        pytest.importorskip("pydl", reason="pydl is not installed")
    instrument = {"fiberassign": desi, "pfsdesign": presets["pfs"]}.get(form, presets["sdss_apo"])
    options = dict(PROJECTIONS[model])
    if "conditions" in options:
        wavelength = WAVES if instrument is presets["sdss_apo"] else 0.54 * u.um
        options["conditions"] = rs.ObservingConditions("mauna kea", wavelength=wavelength, **options["conditions"])
    center = CENTER.transform_to(FK5(equinox="J2026"))
    tile = rs.plan_tile(sky(instrument, 400), instrument, center, position_angle=30 * u.deg, **options)
    plans.write_plan(tile, path, format=form)
    plan, planned = plans.read_plan(path), tile.provenance["parameters"]
    assert plan.meta.get("conditions") == planned["conditions"]
    plans.write_plan(plan, tmp_path / f"again-{name}", format=form)
    again = plans.read_plan(tmp_path / f"again-{name}")
    assert [again.meta.get(entry) for entry in ("conditions", "header")] == [
        plan.meta.get(entry) for entry in ("conditions", "header")
    ]
    if form == "pfsdesign":
        plan.remove_column("epoch")
    for table in (plan, tile.table):
        score = rs.score_tile(table, instrument, positions="sky")
        found = score.provenance["parameters"]
        for entry in ("conditions", "projection", "north_of", "position_angle_deg"):
            assert found.get(entry) == planned[entry], entry
        has = np.asarray(tile.table["status"] == "assigned")
        assert has.sum() > 10
        for axis in ("tip_x", "tip_y"):
            assert np.abs(score.table[axis] - tile.table[axis])[has].max() < 1e-7 * u.mm


def test_conditions_that_are_given_replace_recorded_ones(presets):
    at = rs.ObservingConditions("mauna kea", hour_angle=40 * u.deg)
    tile = rs.plan_tile(sky(presets["pfs"], 300), presets["pfs"], CENTER, conditions=at)
    other = at.at_hour_angle(0 * u.deg)
    score = rs.score_tile(tile.table, presets["pfs"], positions="sky", conditions=other)
    assert score.provenance["parameters"]["conditions"] == other.record


def test_the_north_of_another_frame_must_be_given(presets):
    tile = rs.plan_tile(sky(presets["pfs"], 300), presets["pfs"], CENTER.galactic)
    with pytest.raises(rs.InputError, match="must be measured from the north of icrs or fk5, got galactic"):
        rs.score_tile(plans.as_plan(tile), presets["pfs"], positions="sky")
    angle = 0 * u.deg
    again = rs.score_tile(
        plans.as_plan(tile), presets["pfs"], positions="sky", center=CENTER.galactic, position_angle=angle
    )
    assert again.summary["n_out_of_reach"] == 0
