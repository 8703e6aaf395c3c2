"""Catalogs in many files: files are read only if they are required, and results equal those of a single table."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.time import Time
from raising import refused, warned

import rfpsurvey as rs
from rfpsurvey._sky.parts import Partitions
from rfpsurvey._survey import source as _source

pytest.importorskip("pyarrow")
import pyarrow as pa
import pyarrow.parquet as pq

import flat

CENTER = SkyCoord(359.9 * u.deg, -85 * u.deg)
OFFSETS = [(0, 0), (1, 2), (-4, 1), (0.1, 0.2), (9, -3)]
TILES = SkyCoord([CENTER.spherical_offsets_by(x * u.deg, y * u.deg) for x, y in OFFSETS])


@pytest.fixture(scope="module")
def sky():
    catalog = rs.synthetic_catalog("poisson", CENTER, 8 * u.deg, n_targets=5000, rng=4)
    n, rng = len(catalog), np.random.default_rng(4)
    return rs.Catalog(
        catalog.coord,
        id=[f"star {k}" for k in range(n)],
        priority=rng.integers(0, 3, n),
        visits=rng.integers(1, 3, n),
        kind=rng.choice(["science", "standard"], n),
    )


@pytest.fixture(scope="module")
def folder(sky, tmp_path_factory):
    folder = tmp_path_factory.mktemp("partitions") / "sky"
    rs.catalog.partition_catalog(sky, folder, order=3)
    return folder


def same(a, b):
    for name in ("tiles", "completeness", "outcomes", "targets"):
        one, other = getattr(a, name), getattr(b, name)
        assert one.colnames == other.colnames
        for c in one.colnames:
            np.testing.assert_array_equal(one[c], other[c], err_msg=f"{name} {c}")


def test_nothing_is_lost_on_the_way(sky, folder):
    parts = rs.catalog.PartitionedCatalog(folder)
    whole = parts.read()
    assert len(parts) == len(whole) == len(sky)
    rows = np.array([int(name.split()[1]) for name in whole.id])
    assert np.array_equal(np.sort(rows), np.arange(len(sky)))
    assert whole.coord.separation(sky.coord[rows]).max() < 1e-6 * u.arcsec
    for name in ("priority", "visits", "kind"):
        assert np.array_equal(getattr(whole, name), getattr(sky, name)[rows])
    assert 1 < parts.meta["n_partitions"] < 40


@pytest.mark.filterwarnings("ignore:requirement standard")
def test_the_same_survey_as_from_one_piece(folder, small):
    options = {"requirements": "standard=2", "allocator": "lamost_rule"}
    whole = flat.plan_survey(rs.catalog.PartitionedCatalog(folder).read(), small, TILES, **options)
    for kept in (10_000_000, 100):
        same(flat.plan_survey(rs.catalog.PartitionedCatalog(folder, kept_rows=kept), small, TILES, **options), whole)


def test_only_the_partitions_of_a_field_are_read(folder, small, monkeypatch):
    read, real = [], pq.read_table
    monkeypatch.setattr(
        pq,
        "read_table",
        lambda path, columns, **kw: (read.append((path, columns)), real(path, columns=columns, **kw))[1],
    )
    source = _source.Partitioned(rs.catalog.PartitionedCatalog(folder))
    field = source.field(TILES[0].cartesian.xyz.value, np.deg2rad(0.5), np.ones(len(source), dtype=np.uint8))
    assert len(field.row) > 0
    assert len({path for path, _ in read}) < 5
    assert all("_healpix_29" not in columns for _, columns in read)


@pytest.mark.parametrize(("kept", "most"), [(10_000_000, 1), (1, 100)])
def test_partitions_that_were_read_are_kept(folder, small, monkeypatch, kept, most):
    read, source = [], _source.Partitioned(rs.catalog.PartitionedCatalog(folder, kept_rows=kept))
    real = Partitions.part
    monkeypatch.setattr(Partitions, "part", lambda self, k: (read.append(k), real(self, k))[1])
    left = np.ones(len(source), dtype=np.uint8)
    for _ in range(5):
        for tile in TILES:
            source.field(tile.cartesian.xyz.value, np.deg2rad(0.5), left)
    times = np.bincount(read)[1:].max()  # the first file is also read, to find the type of the identifiers
    assert times <= most
    assert (times > 1) == (kept == 1)


def test_tiles_are_placed_on_all_partitions(folder):
    parts = rs.catalog.PartitionedCatalog(folder)
    options = {"radius": 3 * u.deg, "fibers": 500, "method": "mean_shift"}
    one, other = (rs.place_tiles(catalog, **options).table for catalog in (parts, parts.read()))
    assert len(one) > 3
    for name in one.colnames:
        np.testing.assert_array_equal(one[name], other[name])


def changes(sky):
    """Return catalogs that differ from another catalog in one value of one column."""
    n, moved = len(sky), sky.coord.dec.copy()
    moved[17] += 1 * u.arcsec
    priority, kind, visits = sky.priority.copy(), sky.kind.copy(), sky.visits.copy()
    priority[17] = (priority[17] + 1) % 3
    kind[17] = "science" if kind[17] == "standard" else "standard"
    visits[17] = 3 - visits[17]
    names = [f"star {k}" if k != 17 else "star x7" for k in range(n)]
    return {
        "position": replace(sky, coord=SkyCoord(sky.coord.ra, moved)),
        "priority": replace(sky, priority=priority),
        "kind": replace(sky, kind=kind),
        "id": replace(sky, id=names),
        "visits": replace(sky, visits=visits),
    }


def plain_partitions(catalog, folder):
    """Return partitions with uncompressed files without checksums, whose sizes do not depend on values."""
    with pytest.MonkeyPatch.context() as patch:
        write, plain = pq.write_table, {"compression": "none", "use_dictionary": False}
        patch.setattr(pq, "write_table", lambda table, path, **_: write(table, path, **plain))
        return rs.catalog.partition_catalog(catalog, folder, order=3)


def test_a_survey_is_not_resumed_with_other_contents(sky, small, tmp_path):
    """Regression: partitions were identified by the sizes of their files, which a changed value may not change."""
    stopped = tmp_path / "survey"

    def stop(done, _):
        if done == 2:
            raise KeyboardInterrupt

    one = plain_partitions(sky, tmp_path / "one")
    with pytest.raises(KeyboardInterrupt):
        rs.plan_survey(one, small, TILES, folder=stopped, progress=stop)
    for what, catalog in changes(sky).items():
        other = plain_partitions(catalog, tmp_path / what)
        sizes = [[path.stat().st_size for *_, path in parts.parts.files] for parts in (one, other)]
        assert sizes[0] == sizes[1] or what in ("kind", "id")  # words of different lengths
        refused("holds another survey: catalog", rs.plan_survey, other, small, TILES, folder=stopped, resume=True)
    rs.plan_survey(one, small, TILES, folder=stopped, resume=True)


def test_columns_that_are_not_read_may_change(sky, small, tmp_path):
    """The digest includes only the columns that a survey reads."""
    parts = rs.catalog.partition_catalog(sky, tmp_path / "sky", order=3)
    rs.plan_survey(parts, small, TILES, folder=tmp_path / "survey")
    for *_, path in parts.parts.files:
        table = pq.read_table(path, partitioning=None)
        table = table.append_column("flux", pa.array(np.arange(float(len(table)))))
        pq.write_table(table, path, write_page_checksum=True)
    wider = rs.catalog.PartitionedCatalog(tmp_path / "sky")
    rs.plan_survey(wider, small, TILES, folder=tmp_path / "survey", resume=True)


def test_resume_and_another_catalog(folder, sky, small, tmp_path):
    parts = rs.catalog.PartitionedCatalog(folder)
    rs.plan_survey(parts, small, TILES, folder=tmp_path / "survey")
    rs.plan_survey(rs.catalog.PartitionedCatalog(folder), small, TILES, folder=tmp_path / "survey", resume=True)
    other = rs.catalog.partition_catalog(sky[:-1], tmp_path / "other", order=3)
    upside_down = rs.catalog.PartitionedCatalog(folder, columns={"priority": "-priority"})
    for catalog in (other, upside_down):
        with pytest.raises(rs.InputError, match="another survey: catalog"):
            rs.plan_survey(catalog, small, TILES, folder=tmp_path / "survey", resume=True)
    with (
        pytest.raises(rs.InputError, match=r"epoch differs \(epoch was None and is now 2026.5\)"),
        pytest.warns(rs.errors.RfpsurveyWarning, match="the epoch has no effect"),
    ):
        rs.plan_survey(parts, small, TILES, folder=tmp_path / "survey", resume=True, epoch=2026.5)


def test_the_whole_sky_in_one_partition(sky, small, tmp_path):
    parts = rs.catalog.partition_catalog(sky, tmp_path / "one", order=0)
    assert parts.meta["n_partitions"] == 4  # four partitions meet at the pole
    same(rs.plan_survey(parts, small, TILES), rs.plan_survey(parts.read(), small, TILES))


@pytest.mark.filterwarnings("ignore:no target was observed")
def test_proper_motions_and_epochs(small, tmp_path):
    """A star as fast as Barnard's star moves into the field, out of the field, and out of its partition."""
    moving = SkyCoord(TILES[0].ra, TILES[0].dec, pm_ra_cosdec=0 * u.mas / u.yr, pm_dec=10_300 * u.mas / u.yr)
    catalog = rs.Catalog(moving.reshape(1), epoch=2000.0)
    parts, seen = rs.catalog.partition_catalog(catalog, tmp_path / "moving", order=9), []
    for epoch in (1720.0, 2000.0, 2290.0):
        there = TILES[0].spherical_offsets_by(0 * u.deg, (epoch - 2000) * 10_300 * u.mas).reshape(1)
        for where in (TILES[:1], there):
            a, b = (rs.plan_survey(c, small, where, epoch=epoch).summary["n_assigned"] for c in (parts, catalog))
            assert a == b
            seen.append(a)
    assert seen == [0, 1, 1, 1, 0, 1]


def test_epochs_of_partitions_may_differ(small, tmp_path):
    """The first partition contains a slow star of this century, and the last partition a fast star of 1800."""
    for number, (ra, dec, epoch, speed) in enumerate([(45.0, 2.0, 2016.0, 0.0), (100.0, -60.0, 1800.0, 10_000.0)]):
        name = {0: "Norder=4/Npix=0.parquet", 1: "Norder=4/Npix=2218.parquet"}[number]
        write(tmp_path / "sky" / name, ra=[ra], dec=[dec], pmra=[0.0], pmdec=[speed], ref_epoch=[epoch], id=[number])
    with pytest.raises(rs.InputError, match="all targets must lie inside the HEALPix pixel"):
        rs.plan_survey(rs.catalog.PartitionedCatalog(tmp_path / "sky"), small, TILES)
    place = SkyCoord([45.0, 100.0] * u.deg, [2.0, -60.0] * u.deg)
    parts = rs.catalog.partition_catalog(
        rs.Catalog(
            SkyCoord(place.ra, place.dec, pm_ra_cosdec=[0, 0] * u.mas / u.yr, pm_dec=[0, 10_000] * u.mas / u.yr),
            epoch=Time([2016.0, 1800.0], format="jyear"),
        ),
        tmp_path / "parts",
        order=9,
    )
    tile = SkyCoord([100] * u.deg, [-60 + 226.5 * 10 / 3600] * u.deg)
    for catalog in (parts, parts.read()):
        assert rs.plan_survey(catalog, small, tile, epoch=2026.5).summary["n_assigned"] == 1


def test_partitions_that_do_not_fit_together(small, tmp_path):
    write(tmp_path / "columns" / "Norder=0" / "Npix=0.parquet", ra=[45.0], dec=[10.0])
    write(tmp_path / "columns" / "Norder=0" / "Npix=4.parquet", ra=[0.0], dec=[0.0], priority=[1.0])
    refused(r"same columns, but some partitions have no priority", rs.catalog.PartitionedCatalog, tmp_path / "columns")
    write(tmp_path / "ids" / "Norder=0" / "Npix=0.parquet", ra=[45.0], dec=[10.0], id=[1])
    write(tmp_path / "ids" / "Norder=0" / "Npix=4.parquet", ra=[0.0], dec=[0.0], id=["a"])
    with pytest.raises(
        rs.InputError, match="must have the same type in all partitions: the column id contains numbers and text"
    ):
        rs.catalog.PartitionedCatalog(tmp_path / "ids").read()
    with pytest.raises(rs.InputError, match="ids must be integers in all partitions, or text in all"):
        rs.plan_survey(rs.catalog.PartitionedCatalog(tmp_path / "ids"), small, SkyCoord([0] * u.deg, [0] * u.deg))
    none = pa.array([], type=pa.string())
    write(tmp_path / "empty" / "Norder=0" / "Npix=0.parquet", ra=np.array([]), dec=np.array([]), id=none)
    with pytest.raises(rs.InputError, match="at least one target"):
        rs.plan_survey(rs.catalog.PartitionedCatalog(tmp_path / "empty"), small, TILES)
    write(tmp_path / "empty" / "Norder=0" / "Npix=4.parquet", ra=[0.0], dec=[0.0], id=["a"])
    survey = rs.plan_survey(
        rs.catalog.PartitionedCatalog(tmp_path / "empty"), small, SkyCoord([0] * u.deg, [0] * u.deg)
    )
    assert survey.targets["target_id"].tolist() == ["a"]


@pytest.mark.parametrize(
    "options",
    [{"columns": 5}, {"columns": "abc"}, {"units": "deg"}, {"frame": 5}, {"kept_rows": "x"}, {"kept_rows": 0}],
)
def test_bad_options(folder, options):
    refused(f"{next(iter(options))} must be", lambda: rs.catalog.PartitionedCatalog(folder, **options))


def write(path, **columns):
    path.parent.mkdir(parents=True, exist_ok=True)
    pq.write_table(pa.table(columns), path)


def test_of_threads_that_write_one_folder_one_writes(tmp_path, sky):
    def write(k):
        try:
            return len(rs.catalog.partition_catalog(sky[k:], tmp_path / "parts", order=1))
        except rs.InputError:
            return None

    with ThreadPoolExecutor(4) as pool:
        (n,) = (n for n in pool.map(write, range(4)) if n is not None)
    assert len(rs.catalog.PartitionedCatalog(tmp_path / "parts").read()) == n
    assert [path.name for path in tmp_path.iterdir()] == ["parts"]


def test_damaged_partitions_are_refused(tmp_path):
    """A flipped bit in a value of a partition remained undetected, because the pages had no checksums."""
    sky = rs.synthetic_catalog("uniform", SkyCoord("6h +23d"), 2 * u.deg, n_targets=300, rng=1)
    rs.catalog.partition_catalog(sky, tmp_path / "parts", order=0)
    (path, *_) = (tmp_path / "parts").rglob("Npix=*.parquet")
    content = bytearray(path.read_bytes())
    column = next(c for k in range(12) if (c := pq.read_metadata(path).row_group(0).column(k)).path_in_schema == "ra")
    content[column.data_page_offset + column.total_compressed_size // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(rs.InputError, match=r"\.parquet cannot be read as parquet: .*checksum verification failed"):
        rs.catalog.PartitionedCatalog(tmp_path / "parts").read()


def test_bad_folders(tmp_path, sky, folder, small):
    refused("there is no such folder", rs.catalog.PartitionedCatalog, tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    refused("must contain partitions", rs.catalog.PartitionedCatalog, tmp_path / "empty")
    write(tmp_path / "overlap" / "Norder=0" / "Npix=0.parquet", ra=[1.0], dec=[1.0])
    write(tmp_path / "overlap" / "Norder=1" / "Npix=3.parquet", ra=[1.0], dec=[1.0])
    refused("Norder=0/Npix=0 and Norder=1/Npix=3 do", rs.catalog.PartitionedCatalog, tmp_path / "overlap")
    write(tmp_path / "pixel" / "Norder=0" / "Npix=12.parquet", ra=[1.0], dec=[1.0])
    refused("impossible order or pixel", rs.catalog.PartitionedCatalog, tmp_path / "pixel")
    write(tmp_path / "names" / "Norder=0" / "Npix=0.parquet", x=[1.0], dec=[1.0])
    refused("no column for ra", rs.catalog.PartitionedCatalog, tmp_path / "names")
    (tmp_path / "names" / "hats.properties").symlink_to(tmp_path / "nowhere")  # its column names were not used
    with pytest.raises(rs.InputError, match=r"hats\.properties: the target of this link does not exist"):
        rs.catalog.PartitionedCatalog(tmp_path / "names")
    write(tmp_path / "nan" / "Norder=0" / "Npix=4.parquet", ra=[1.0, np.nan], dec=[1.0, 2.0])
    with pytest.warns(rs.RfpsurveyWarning), pytest.raises(rs.InputError, match="got 1 of 2 rows without finite"):
        rs.plan_survey(rs.catalog.PartitionedCatalog(tmp_path / "nan"), small, SkyCoord([1] * u.deg, [1] * u.deg))
    (tmp_path / "broken" / "Norder=0").mkdir(parents=True)
    (tmp_path / "broken" / "Norder=0" / "Npix=0.parquet").write_bytes(b"PAR1")
    refused(r"Npix=0.parquet cannot be read", rs.catalog.PartitionedCatalog, tmp_path / "broken")
    refused("exists; give the name of a new folder", rs.catalog.partition_catalog, sky, folder)
    refused("at least one target", lambda: rs.catalog.partition_catalog(sky[:0], tmp_path / "none"))
    for order in (14, -1, True, 2.5):
        refused("order must be", rs.catalog.partition_catalog, sky, tmp_path / "none", order=order)
    assert not any(name.startswith(".") for name in os.listdir(tmp_path))


@pytest.fixture(scope="module")
def collection(tmp_path_factory):
    """Return the folder of a HATS collection with a margin and an index, and the targets of its main table."""
    root = tmp_path_factory.mktemp("collection")
    sky = rs.synthetic_catalog("uniform", SkyCoord("3h +20d"), 5 * u.deg, n_targets=3000, rng=1)
    rs.catalog.partition_catalog(sky, root / "stars", order=4)
    margin = rs.catalog.partition_catalog(sky[:754], root / "stars_margin", order=4)
    (margin.folder / "hats.properties").write_text(
        "obs_collection=stars_margin\ndataproduct_type=margin\nhats_nrows=754\nhats_col_ra=ra\nhats_col_dec=dec\n"
        "hats_margin_threshold=600\nhats_primary_table_url=stars\n"
    )
    (root / "collection.properties").write_text(
        "#HATS Collection\nobs_collection=stars\nhats_primary_table_url=stars\nall_margins=stars_margin\n"
        "default_margin=stars_margin\nall_indexes=id stars_id_index\n"
    )
    return root, sky


def test_only_the_main_table_of_a_collection_is_read(collection, run):
    """The main table and its margin were read as one catalog: 3000 targets became 3754."""
    root, sky = collection
    parts = rs.catalog.PartitionedCatalog(root)
    assert len(parts) == len(parts.read()) == 3000
    assert sorted(parts.read().id.tolist()) == sorted(sky.id.tolist())
    about = "main table stars; not read: margin stars_margin, index stars_id_index"
    assert parts.meta["collection"] == parts.read().meta["collection"] == about
    assert len(replace(parts, kept_rows=5)) == 3000
    code, out, _ = run("plan", root, "--instrument", "sdss_apo")
    assert code == 0
    assert out.splitlines()[0] == f"collection: {about}"
    assert out.splitlines()[1].startswith("columns: priority: none, visits: none, id: id, ra: ra, dec: dec; not used: ")


@pytest.mark.parametrize("place", ["stars_margin", "stars_margin/dataset"])
def test_margins_are_refused(collection, place):
    with pytest.raises(rs.InputError, match="must be object, got margin.*; open the main table, stars"):
        rs.catalog.PartitionedCatalog(collection[0] / place)


def test_folders_of_several_catalogs_are_refused(collection, tmp_path):
    for name in ("one", "two"):
        rs.catalog.partition_catalog(collection[1], tmp_path / name, order=0)
    with pytest.raises(rs.InputError, match="must contain one catalog, got partitions in .*one/dataset and .*two/data"):
        rs.catalog.PartitionedCatalog(tmp_path)


@pytest.mark.parametrize("url", ["", "nowhere", "https://data.lsdb.io/hats/gaia"])
def test_main_tables_of_collections_must_exist(tmp_path, url):
    (tmp_path / "collection.properties").write_text(f"hats_primary_table_url={url}\n")
    refused(f"must be the folder of the main table, got '{url}'", rs.catalog.PartitionedCatalog, tmp_path)


def test_properties_state_the_epoch_and_the_identifiers(tmp_path):
    columns = {"ra": [45.0, 46.0], "dec": [1.0, 2.0], "pmra": [100.0, 0.0], "pmdec": [0.0, 0.0], "key": [7, 8]}
    write(tmp_path / "dataset" / "Norder=0" / "Npix=0.parquet", **columns)
    path = tmp_path / "hats.properties"
    path.write_text("dataproduct_type=object\nhats_coordinate_epoch=J2016.0\nhats_cols_survey_id=key\n")
    for folder in (tmp_path, tmp_path / "dataset"):
        parts = rs.catalog.PartitionedCatalog(folder)
        for catalog in (parts.read(), parts.parts.part(0)):
            assert (catalog.id.tolist(), catalog.epoch.jyear) == ([7, 8], 2016)
    path.write_text("hats_col_j2000_ra=ra\nhats_cols_survey_id=key other\n")
    assert rs.catalog.PartitionedCatalog(tmp_path).read().id.tolist() == [0, 1]
    for text, message in (
        ("hats_frame=galactic", "hats_frame must be equatorial"),
        ("hats_coordinate_epoch=long ago", "hats_coordinate_epoch must be a Time, a Julian year"),
        ("dataproduct_type=association", "got association, which means pairs of rows of two catalogs$"),
    ):
        path.write_text(f"{text}\n")
        refused(message, rs.catalog.PartitionedCatalog, tmp_path)
    path.write_text("dataproduct_type=source\n")
    warned("each detection of an object is planned as a separate target", rs.catalog.PartitionedCatalog, tmp_path)
