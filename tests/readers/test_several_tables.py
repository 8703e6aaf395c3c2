"""One of several tables in a FITS file is read."""

from functools import partial

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable

import rfpsurvey as rs
from refusals import refusal


def test_a_table_of_a_file_is_chosen_by_its_number_or_name(tmp_path):
    """Only the first table of a FITS file could be read."""
    path = tmp_path / "a.fits"
    hdus = [fits.PrimaryHDU(), fits.ImageHDU(np.zeros((2, 2)))]
    for n, name in ((1, "TARGETS"), (2, "sky"), (3, "TWICE"), (4, "TWICE"), (5, "")):
        hdus.append(fits.table_to_hdu(QTable({"ra": np.arange(n) * u.deg, "dec": np.arange(n) * u.deg})))
        hdus[-1].name = name
    fits.HDUList(hdus).writeto(path)
    for hdu, n in ((2, 1), ("2", 1), (np.int32(3), 2), ("SKY", 2), (" targets ", 1), (5, 4), (6, 5)):
        for read in (rs.Catalog.read, rs.Tiling.read):
            assert len(read(path, hdu=hdu)) == n
    text = (
        r"the file has 5 tables, and only the first one was read: 2 \(TARGETS\), 3 \(SKY\), 4 .*, 6; to read another "
    )
    for read, remedy in ((rs.Catalog.read, "table, give hdu= or --set "), (rs.Tiling.read, ".*--set tiles.hdu=NAME$")):
        with pytest.warns(rs.RfpsurveyWarning, match=text + remedy):
            assert len(read(path)) == 1
    assert rs.Catalog.read(path, hdu="sky").meta["hdu"] == "sky"
    rs.Catalog.read(path, hdu=3).write(tmp_path / "a.ecsv")
    tables = "the number or the unique name of a table in the file (2 (TARGETS), 3 (SKY), 4 (TWICE), 5 (TWICE), 6)"
    for name, hdu, message in (
        *(("a.fits", hdu, f"must be {tables}, got {hdu!r}") for hdu in (0, 1, 7, -1, "TWICE", "none", "")),
        ("a.ecsv", "sky", "must be used only with FITS files, got 'sky'"),
    ):
        text = refusal(tmp_path / name, partial(rs.Catalog.read, hdu=hdu))
        assert f"hdu {message}" in text
    for hdu in (True, 2.0):
        with pytest.raises(TypeError, match="hdu must be the number or the name of a table, got"):
            rs.Catalog.read(path, hdu=hdu)
