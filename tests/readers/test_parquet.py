"""Parquet files of pandas and other programs, as single files and as partitions."""

import sys
from decimal import Decimal
from functools import partial

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

import rfpsurvey as rs
from refusals import refusal

pa = pytest.importorskip("pyarrow")
pd = pytest.importorskip("pandas")
pq = pytest.importorskip("pyarrow.parquet")

N = 6
UNITS = {"ra": "deg", "dec": "deg"}


def read(path):
    return rs.Catalog.read(path, units=UNITS)


def stored(path, metadata=None, **columns):
    """Write a Parquet file with coordinates and other columns, and return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table({"ra": np.full(N, 45.0), "dec": np.full(N, 3.0)} | columns, metadata=metadata), path)
    return path


def both(folder, metadata=None, **columns):
    """Return the catalog of a file, and that of partitions with the same rows."""
    stored(folder / "sky" / "Norder=0" / "Npix=0.parquet", metadata, **columns)
    return read(stored(folder / "a.parquet", metadata, **columns)), rs.catalog.PartitionedCatalog(folder / "sky").read()


TEXTS = ["a", "b", None, "c", "a", None]
NUMBERS = [1, 2, None, 4, 5, 6]
DECIMALS = [None if n is None else Decimal(n) for n in NUMBERS]


@pytest.mark.parametrize(
    "column",
    [
        *(pa.array(TEXTS, kind) for kind in (pa.string(), pa.large_string())),
        pa.array(TEXTS).dictionary_encode(),
        pa.array([None if t is None else t.encode() for t in TEXTS]),
        pa.chunked_array([pa.array(part).dictionary_encode() for part in (TEXTS[:2], TEXTS[2:])]),
    ],
)
def test_text_may_be_missing_and_in_categories(tmp_path, column):
    """Regression: categories were refused, and missing text caused an unhandled exception."""
    for catalog in both(tmp_path, category=column, id=np.arange(N)):
        assert catalog.category.tolist() == ["a", "b", "", "c", "a", ""]


@pytest.mark.parametrize(
    "column",
    [
        *(pa.array(NUMBERS, kind) for kind in (pa.int64(), pa.float32(), pa.uint8())),
        pa.array(DECIMALS, pa.decimal128(9, 3)),
        pa.array(NUMBERS, pa.int64()).dictionary_encode(),
    ],
)
def test_numbers_may_be_missing_decimal_and_in_categories(tmp_path, column):
    with pytest.raises(rs.InputError, match="must have a number in every row, but 1 of 6 rows .row 3. have none"):
        both(tmp_path, priority=column)
    whole = pa.concat_arrays([column[:2], column[3:], column[:1]])
    for catalog in both(tmp_path, priority=whole, other=column):
        assert catalog.priority.tolist() == [1, 2, 4, 5, 6, 1]
    with pytest.raises(rs.InputError, match="id.* must be integers or text .*, but 1 of 6 rows .row 3. have none"):
        both(tmp_path, id=pa.array(NUMBERS))


@pytest.mark.filterwarnings(r"ignore:column .* \(id\) is empty")
def test_frames_of_pandas(tmp_path):
    columns = {
        "name": pd.array(["a", None, "c", "d", "e", "f"], dtype="string"),
        "visits": pd.array([1, 2, 1, 1, 1, 1], dtype="Int64"),
        "good": pd.array([True, None, False, True, True, True], dtype="boolean"),
        "category": pd.Categorical(["x", "y", "x", None, "x", "y"]),
        "when": pd.to_datetime(["2026-01-01"] * N),
        "took": pd.to_timedelta([1] * N, unit="s"),
        "several": [[1, 2]] * N,
    }
    frame, path = pd.DataFrame(columns, index=np.arange(10, 10 + N)), tmp_path / "a.parquet"
    frame["ra"], frame["dec"] = 45.0, 3.0
    frame.to_parquet(path)
    assert "__index_level_0__" in pq.read_schema(path).names
    catalog = read(path)
    assert catalog.id.tolist() == ["a", "", "c", "d", "e", "f"]
    assert catalog.visits.tolist() == [1, 2, 1, 1, 1, 1]
    for name, message in (
        ("when", "column 'when' (priority) must hold numbers or text, got datetime64"),
        ("several", "there is no column 'several'"),
    ):
        assert message in refusal(path, partial(rs.Catalog.read, units=UNITS, columns={"priority": name}))
    table = pa.Table.from_pandas(frame)
    columns = dict(zip(table.column_names, table.columns, strict=True))
    for one in (catalog, *both(tmp_path, table.schema.metadata, **columns)):
        assert one.category.tolist() == ["x", "y", "x", "", "x", "y"]


def test_units_that_astropy_wrote_are_kept(tmp_path):
    QTable({"id": ["Ä", "b"], "ra": [1, 2.0] * u.hourangle, "dec": [1, 2.0] * u.deg}).write(tmp_path / "a.parquet")
    catalog = rs.Catalog.read(tmp_path / "a.parquet")
    assert catalog.coord.ra.deg == pytest.approx([15, 30])
    assert catalog.id.tolist() == ["Ä", "b"]


def test_ids_that_are_bytes(tmp_path):
    path = stored(tmp_path / "a.parquet", id=[b"\xff\xfe"] * N)
    assert "column 'id' must hold numbers or text, got the bytes b'\\xff\\xfe'" in refusal(path, read)


def test_properties_of_partitions(tmp_path):
    folder = tmp_path / "sky"
    both(tmp_path)
    (folder / "hats.properties").write_bytes(b"hats_col_ra=ra\nobs_title=M\xfcller\n")
    with pytest.raises(rs.InputError, match="hats.properties must be text in UTF-8, got the byte 0xfc"):
        rs.catalog.PartitionedCatalog(folder)
    (folder / "hats.properties").write_text("hats_nrows=7\n")
    with pytest.warns(rs.RfpsurveyWarning, match="must have the 7 rows that its properties file states, got 6"):
        assert len(rs.catalog.PartitionedCatalog(folder)) == N


def test_a_file_cannot_claim_many_rows(tmp_path):
    """A column of equal values is small on disk, but would fill the memory when it is read."""
    zeros, path = np.zeros(15_000_000), tmp_path / "a.parquet"
    pq.write_table(pa.table({"ra": zeros, "dec": zeros, "id": zeros}), path, row_group_size=len(zeros))
    assert "the number of rows must agree with the size of the file" in refusal(path, read)


def test_columns_without_any_value_are_read_as_missing_numbers(tmp_path):
    path = stored(tmp_path / "a.parquet", note=pa.nulls(N))
    column = rs.Catalog.read(path, units=UNITS, keep="note").extra["note"]
    assert np.isnan(np.ma.filled(column, np.nan)).all()
    assert column.dtype.kind == "f"


def test_parquet_without_its_package_has_a_remedy(tmp_path, monkeypatch):
    path = stored(tmp_path / "a.parquet")
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(rs.InputError, match=r"another package: .*pip install 'rfpsurvey\[parquet\]'"):
        rs.Catalog.read(path)
