"""Designs of PFS with unusual but valid columns and header cards are read, converted to tables and written again."""

import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from pfs_files import design, write_design
from raising import refused, warned

import rfpsurvey as rs
from rfpsurvey import plans

N = 61
RAGGED = np.array([np.arange(k % 4) for k in range(N)], dtype=object)
COLUMNS = [
    fits.Column("wide", "6E", dim="(3,2)", array=np.arange(6 * N).reshape(N, 2, 3)),
    fits.Column("words", "12A", dim="(4,3)", array=np.full((N, 3), "abcd")),
    fits.Column("two", "I", bzero=2**15, array=np.arange(N).astype("u2")),
    fits.Column("eight", "K", bzero=2**63, array=np.arange(N).astype("u8") + 2**63),
    fits.Column("complex", "C", array=np.full(N, 1 + 2j)),
    fits.Column("flag", "3L", array=np.arange(3 * N).reshape(N, 3) % 2 == 0),
    fits.Column("bad name%", "E", unit="furlong/fortnight", array=np.full(N, np.nan)),
    *(fits.Column(name, "5A", array=np.full(N, "other")) for name in ("kind", "assigned", "x", "priority")),
]


def with_columns(path, extension, columns):
    """Add columns to a table of a file, or replace those with the same names."""
    names = [column.name for column in columns]
    with fits.open(path) as units:
        copies = fits.HDUList([unit.copy() for unit in units])
        own = [column for column in copies[extension].columns if column.name not in names]
        header = copies[extension].header
        copies[extension] = fits.BinTableHDU.from_columns([*own, *columns], header, name=copies[extension].name)
    copies.writeto(path, overwrite=True)
    return path


def same(one, other):
    assert one.colnames == other.colnames
    for name in one.colnames:
        np.testing.assert_array_equal(np.asarray(one[name]), np.asarray(other[name]), err_msg=name)


def test_columns_of_all_kinds_are_kept(tmp_path):
    """Columns of further types, and with the names of columns of a plan, ended with a traceback or replaced them."""
    plan = plans.read_plan(with_columns(write_design(tmp_path / "d.fits"), "DESIGN", COLUMNS))
    assert (plan["kind"][0], plan["kind_in_file"][0], plan["x"].unit) == ("science", "other", u.mm)
    for name in ("e.fits", "e.ecsv"):
        plans.write_plan(plan, tmp_path / name)
        again = plans.read_plan(tmp_path / name)
        same(plan, again)
    plans.write_plan(again, tmp_path / "f.fits", format="pfsdesign")
    same(plan, plans.read_plan(tmp_path / "f.fits"))
    with fits.open(tmp_path / "d.fits") as first, fits.open(tmp_path / "f.fits") as last:
        assert first["DESIGN"].columns.names == last["DESIGN"].columns.names
        assert first["DESIGN"].columns.formats == last["DESIGN"].columns.formats


def test_text_in_a_column_that_is_not_ascii(tmp_path):
    """Text in UTF-8 ended with a traceback; it is read, and only FITS files cannot contain it."""
    columns, *others = design(patch=np.full(N, "1,1"))
    path = write_design(tmp_path / "d.fits", (columns, *others))
    content = path.read_bytes()
    path.write_bytes(content.replace(b"1,1", "\xe91".encode(), 1))
    plan = plans.read_plan(path)
    assert plan["patch"][0] == "\xe91"
    plans.write_plan(plan, tmp_path / "e.ecsv")
    same(plan, plans.read_plan(tmp_path / "e.ecsv"))
    refused("cannot be written as FITS: 'ascii' codec can't encode", plans.write_plan, plan, tmp_path / "e.fits")
    path.write_bytes(content.replace(b"1,1", b"\xe911", 1))
    refused("cannot be read as fits: 'utf-8' codec can't decode", plans.read_plan, path)


def test_wide_fluxes_are_kept(tmp_path):
    flux = np.arange(360, dtype="f8").reshape(120, 3)
    wide = fits.Column("psfFlux", "3D", unit="uJy", array=flux)
    plan = plans.read_plan(with_columns(write_design(tmp_path / "d.fits"), "PHOTOMETRY", [wide]))
    assert plan["psfFlux"].shape == (61, 2, 3)
    np.testing.assert_array_equal(plan["psfFlux"][:60].to_value(u.uJy).reshape(120, 3), flux)
    for name in ("e.fits", "e.ecsv", "f.fits"):
        plans.write_plan(plan, tmp_path / name, format="table" if name[0] == "e" else "pfsdesign")
        np.testing.assert_allclose(plans.read_plan(tmp_path / name)["psfFlux"], plan["psfFlux"])


@pytest.mark.parametrize("extension", ["DESIGN", "PHOTOMETRY", "GUIDESTARS"])
def test_columns_with_rows_of_different_lengths_are_named(tmp_path, extension):
    column = fits.Column("psfFlux", "PJ()", array=RAGGED)
    path = with_columns(write_design(tmp_path / "d.fits"), extension, [column])
    plan = warned(f"these columns of {extension} have different lengths.*psfFlux", plans.read_plan, path)
    plans.write_plan(plan, tmp_path / "e.fits")
    same(plan, plans.read_plan(tmp_path / "e.fits"))


WRONG_TYPES = [
    ("DESIGN", fits.Column("ra", "2D", array=np.ones((N, 2))), "'ra' of DESIGN must have one value per row"),
    ("DESIGN", fits.Column("cobraId", "3A", array=np.full(N, "abc")), "'cobraId' of DESIGN must hold whole"),
    ("DESIGN", fits.Column("pmRa", "3A", array=np.full(N, "abc")), "'pmRa' of DESIGN must hold numbers, got <U3"),
    ("DESIGN", fits.Column("targetType", "2J", array=np.ones((N, 2))), "'targetType' of DESIGN must have one"),
    ("PHOTOMETRY", fits.Column("fiberId", "2J", array=np.ones((120, 2))), "'fiberId' of PHOTOMETRY must have one"),
    ("PHOTOMETRY", fits.Column("psfFlux", "L", array=np.ones(120)), "'psfFlux' of PHOTOMETRY must hold numbers"),
    ("PHOTOMETRY", fits.Column("psfFlux", "E", unit="m", array=np.ones(120)), "convertible to nJy, got m"),
    ("PHOTOMETRY", fits.Column("filterName", "J", array=np.ones(120)), "'filterName' of PHOTOMETRY must hold text"),
]


@pytest.mark.parametrize(("extension", "column", "message"), WRONG_TYPES)
def test_columns_of_a_wrong_type_are_refused(tmp_path, extension, column, message):
    path = with_columns(write_design(tmp_path / "d.fits"), extension, [column])
    refused(message, plans.read_plan, path)


def test_fluxes_without_a_filter_are_kept(tmp_path):
    """They disappeared when the design was written again."""
    columns, flux, stars = design()
    flux["filterName"] = np.where(np.arange(120) % 3, "g_ps1", "")
    with pytest.warns(rs.RfpsurveyWarning, match="40 of 120 rows of PHOTOMETRY have no filterName, and are named none"):
        plan = plans.read_plan(write_design(tmp_path / "d.fits", (columns, flux, stars)))
    plans.write_plan(plan, tmp_path / "e.fits")
    same(plan, plans.read_plan(tmp_path / "e.fits"))
    assert len(fits.getdata(tmp_path / "e.fits", "PHOTOMETRY")) == 120


def test_cards_of_all_kinds_are_kept(tmp_path):
    """Undefined values ended with a traceback, and cards such as COMMENT and TELALT5 were lost."""
    path = write_design(tmp_path / "d.fits")
    cards = {"UNDEF": None, "LONGTEXT": "it's " * 50, "TELALT5": 3.5, "HIERARCH odd Key": True, "BIG": 10**30}
    with fits.open(path, mode="update") as units:
        units[0].header.update(cards)
        units[0].header["CPLX"], units[0].header["EMPTY"] = 1 + 2j, ""
        for text in ("first", "second"):
            units[0].header["COMMENT"] = units[0].header["HISTORY"] = text
    plan = plans.read_plan(path)
    assert plan.meta["header"]["UNDEF"] is None
    assert plan.meta["header"]["COMMENT"] == "first\nsecond"
    plans.write_plan(plan, tmp_path / "e.ecsv")
    plans.write_plan(plan, tmp_path / "t.fits", format="table")
    plans.write_plan(plan, tmp_path / "e.fits")
    assert plans.read_plan(tmp_path / "e.fits").meta["header"] == plan.meta["header"]


POSANG = b"POSANG  =                  0.0"


@pytest.mark.parametrize("new", [b"                  NaN", b"                     ", b"                    T"])
def test_a_position_angle_that_is_no_number_is_refused(tmp_path, new):
    """NaN, no value and a boolean ended with a traceback, or were read as 0 or 1."""
    path = write_design(tmp_path / "d.fits")
    path.write_bytes(path.read_bytes().replace(POSANG, POSANG[:9] + new))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        refused("the header card POSANG must be a finite number, got (None|True)", plans.read_plan, path)


def test_cards_that_cannot_be_read_are_named(tmp_path):
    """They ended with a traceback."""
    path = write_design(tmp_path / "d.fits")
    path.write_bytes(path.read_bytes().replace(b"ARMS    = 'br      '", b"ARMS    = br        "))
    plan = warned("these header cards cannot be read and are omitted: ARMS", plans.read_plan, path)
    for name in ("e.fits", "e.ecsv"):
        plans.write_plan(plan, tmp_path / name)
        assert plans.read_plan(tmp_path / name).meta["header"] == plan.meta["header"]


def test_text_that_is_not_ascii_is_read(tmp_path):
    path = write_design(tmp_path / "d.fits")
    path.write_bytes(path.read_bytes().replace(b"'br      '", b"'b\xe9      '"))
    assert plans.read_plan(path).meta["header"]["ARMS"] == "b?"
