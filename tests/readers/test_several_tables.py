"""One of several tables in a FITS file is read."""

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable

import rfpsurvey as rs
from refusals import refusal

DEG = u.deg


def test_a_table_of_a_file_is_chosen_by_its_number_or_name(tmp_path):
    """Only the first table of a FITS file could be read."""
    path = tmp_path / "a.fits"
    hdus = [fits.PrimaryHDU(), fits.ImageHDU(np.zeros((2, 2)))]
    for n, name in ((1, "TARGETS"), (2, "sky"), (3, "TWICE"), (4, "TWICE"), (5, "")):
        table = QTable({"ra": np.arange(n) * DEG, "dec": np.arange(n) * DEG})
        hdus.append(fits.table_to_hdu(table))
        hdus[-1].name = name
    fits.HDUList(hdus).writeto(path)
    for hdu, n in ((2, 1), ("2", 1), (np.int32(3), 2), ("SKY", 2), (" targets ", 1), (5, 4), (6, 5)):
        for read in (rs.Catalog.read, rs.Tiling.read):
            assert len(read(path, hdu=hdu)) == n
    with pytest.warns(
        rs.RfpsurveyWarning, match=r"2 \(TARGETS\), 3 \(SKY\), 4 .*, 6; to read another .* or --set tiles.hdu=NAME$"
    ):
        rs.Tiling.read(path)
    assert rs.Catalog.read(path, hdu="sky").meta["hdu"] == "sky"
    tables = "(2 (TARGETS), 3 (SKY), 4 (TWICE), 5 (TWICE), 6)"
    for hdu in (0, 1, 7, -1, "TWICE", "none", ""):
        text = refusal(path, lambda path, hdu=hdu: rs.Catalog.read(path, hdu=hdu))
        assert f"hdu must be the number or the unique name of a table in the file {tables}, got {hdu!r}" in text
    for hdu in (True, 2.0):
        with pytest.raises(TypeError, match="hdu must be the number or the name of a table, got"):
            rs.Catalog.read(path, hdu=hdu)
    rs.Catalog.read(path, hdu=3).write(tmp_path / "a.ecsv")
    with pytest.raises(rs.InputError, match="hdu must be used only with FITS files, got 'sky'"):
        rs.Catalog.read(tmp_path / "a.ecsv", hdu="sky")
