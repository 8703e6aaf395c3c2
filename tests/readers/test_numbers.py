"""Integers are read exactly, and numbers of any byte order are written to all formats."""

import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable, Table

import rfpsurvey as rs
from rfpsurvey._common.read_tables import read_table, read_tables


def test_integers_with_a_unit_stay_exact(tmp_path):
    """Identifiers with a unit became floating-point numbers, and identifiers beyond 2**53 were refused or changed."""
    wide, ids, ra = 2**53 + 2 * np.arange(3) + 1, np.arange(3), [1.0, 2, 3] * u.deg
    table = Table({"ra": ra, "dec": ra, "id": wide, "few": ids, "none": ids, "obj": wide})
    table["id"].unit, table["few"].unit, table["none"].unit, table["obj"].unit = "ct", "ct", "", "unknown_unit"
    text = "{}: the column {!r} is read without its unit, {}, because quantities cannot represent its"
    for kind in ("ascii.ecsv", "votable", "fits", "parquet"):
        path = tmp_path / f"a.{kind.removeprefix('ascii.')}"
        if kind == "parquet":
            pytest.importorskip("pyarrow")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            table.write(path, format=kind)
        with pytest.warns(rs.RfpsurveyWarning) as caught:
            found = rs.Catalog.read(path, keep=["few", "none", "obj"])
        said = [text.format(path, name, unit) for name, unit in (("id", "ct"), ("obj", "unknown_unit"))]
        assert [str(w.message).partition(" integers")[0] for w in caught] == said
        assert found.id.tolist() == found.extra["obj"].tolist() == wide.tolist(), kind
        assert found.extra["none"].dtype.kind == "i", kind
        assert (found.extra["few"] == ids * u.ct).all(), kind
    with pytest.warns(rs.RfpsurveyWarning, match="the column 'obj' is read without its unit, unknown_unit"):
        assert rs.Catalog.from_table(table, keep="obj").extra["obj"].tolist() == wide.tolist()


def big_endian(n=60):
    """Return a table as astropy reads it from a FITS file with a memory map, and the same table in native order."""
    rng = np.random.default_rng(1)
    native = Table({"ra": rng.uniform(94.5, 95.5, n), "dec": rng.uniform(22.5, 23.5, n), "id": 2**60 + np.arange(n)})
    native["priority"], native["visits"] = rng.integers(0, 3, n), rng.integers(0, 3, n).astype(np.int16)
    native["subpriority"], native["category"] = rng.random(n), np.array([f"class {k % 3}" for k in range(n)])
    native["mag"], native["flag"], native["small"] = rng.random(n), np.arange(n) % 2 == 0, np.arange(n, dtype=np.int16)
    native["note"] = np.array([f"note {k}" for k in range(n)])
    native["ra"].unit = native["dec"].unit = "deg"
    return Table({k: Table.Column(v, dtype=v.dtype.newbyteorder(">"), unit=v.unit) for k, v in native.items()}), native


KEEP = ["mag", "flag", "small", "note"]


def test_big_endian_columns_are_partitioned_and_planned_as_native_columns(tmp_path):
    """Catalogs with kept columns of FITS files could not be partitioned: ArrowNotImplementedError."""
    pytest.importorskip("pyarrow")
    swapped, native = big_endian()
    assert not swapped["note"].dtype.isnative
    native.write(tmp_path / "a.fits")
    expected = rs.Catalog.from_table(native, keep=KEEP)
    columns = {name: swapped[name] for name in ("id", "priority", "visits", "subpriority", "category")}
    columns["extra"] = {name: np.asarray(swapped[name]) for name in KEEP}
    with fits.open(tmp_path / "a.fits", memmap=True) as hdus:
        catalogs = (
            rs.Catalog.read(tmp_path / "a.fits", keep=KEEP),
            rs.Catalog.from_table(swapped, keep=KEEP),
            rs.Catalog.from_table(QTable(hdus[1].data), units={"ra": "deg", "dec": "deg"}, keep=KEEP),
            rs.Catalog(expected.coord, **columns),
        )
        for k, catalog in enumerate(catalogs):
            for name, values in {**vars(catalog), **catalog.arrays.extra}.items():
                assert not isinstance(values, np.ndarray) or values.dtype.isnative, (k, name)
            assert [catalog.arrays.extra[name].tolist() for name in KEEP] == [native[name].tolist() for name in KEEP]
            parts = rs.catalog.partition_catalog(catalog, tmp_path / f"parts{k}")
            again = rs.catalog.PartitionedCatalog(parts.folder, keep=KEEP).read()
            assert sorted(again.extra["note"].tolist()) == sorted(native["note"].tolist())
            plan = [rs.plan_tile(one, "moons", allocator="optimal", rng=1) for one in (catalog, expected)]
            assert plan[0].table["target_id"].tolist() == plan[1].table["target_id"].tolist()


def test_tables_of_files_have_the_byte_order_of_the_machine(tmp_path):
    big_endian()[0].write(tmp_path / "a.fits")
    for table in (read_table(tmp_path / "a.fits"), read_tables(tmp_path / "a.fits")[1][0]):
        assert all(column.dtype.isnative for column in table.itercols())
