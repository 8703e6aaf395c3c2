"""Target tables of DESI, PFS and SDSS-V are read as their data models define the columns."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import MaskedColumn, QTable, Table, vstack
from astropy.time import Time
from numpy.testing import assert_allclose
from pfs_files import target_list
from raising import refused, warned

import rfpsurvey as rs
from rfpsurvey.errors import InputError, RfpsurveyWarning

LRG, ELG, SKY, STD_FAINT, BAD_SKY, IN_BRIGHT_OBJECT, MWS = (1 << bit for bit in (0, 1, 32, 33, 36, 51, 61))
FIRST_ID = 39627700000000000


def desi(n=6, **columns):
    """Return a table with coordinates and identifiers as in DESI's target files, and with further columns."""
    table = QTable({"TARGETID": np.arange(FIRST_ID, FIRST_ID + n), "RA": (150 + 0.05 * np.arange(n)) * u.deg})
    table["DEC"] = np.full(n, 30.0) * u.deg
    for name, values in columns.items():
        table[name] = values
    return table


def ledger():
    done = np.array([1, 1, 1, 0, 0, 0])
    return desi(
        PRIORITY_INIT=[2000, 3000, 3400] * 2,
        PRIORITY=[2, 2, 2, 2000, 3000, 3400],
        NUMOBS_INIT=np.ones(6, int),
        NUMOBS=done,
        NUMOBS_MORE=1 - done,
    )


def sdssv(**columns):
    table = QTable({"catalogid": [1, 2], "ra": [10, 11] * u.deg, "dec": [0, 0] * u.deg, "priority": [1000, 2000]})
    for name, values in {"fiberType": ["BOSS", "BOSS"], "cadence": ["dark_1x1"] * 2, **columns}.items():
        table[name] = values
    return table


def test_target_files_of_desi_are_planned_with_initial_priorities_and_visits():
    """PRIORITY_INIT was not recognized, so all targets had the same priority."""
    catalog = rs.Catalog.from_table(ledger()["TARGETID", "RA", "DEC", "PRIORITY_INIT", "NUMOBS_INIT"])
    assert (catalog.priority.tolist(), catalog.visits.tolist()) == ([2000, 3000, 3400] * 2, [1] * 6)
    assert catalog.id.tolist() == list(range(FIRST_ID, FIRST_ID + 6))


def test_ledgers_of_desi_are_planned_with_the_remaining_visits():
    """NUMOBS, the number of visits that were made, was read as the number of requested visits."""
    catalog = rs.Catalog.from_table(ledger())
    assert catalog.visits.tolist() == [0, 0, 0, 1, 1, 1]
    assert catalog.priority.tolist() == [2, 2, 2, 2000, 3000, 3400]


def test_visits_that_were_made_are_not_requested_visits():
    assert rs.Catalog.from_table(desi(NUMOBS=np.arange(6))).visits is None


def test_columns_of_different_times_of_a_survey_are_not_combined():
    table = ledger()["TARGETID", "RA", "DEC", "PRIORITY", "PRIORITY_INIT", "NUMOBS_INIT"]
    with pytest.warns(RfpsurveyWarning, match="has the column PRIORITY but not NUMOBS_MORE; NUMOBS_INIT is not used"):
        catalog = rs.Catalog.from_table(table)
    assert catalog.visits is None
    assert catalog.priority[0] == 2
    assert rs.Catalog.from_table(table, columns={"visits": "NUMOBS_INIT", "priority": "PRIORITY"}).visits is not None


def test_named_columns_replace_the_columns_of_a_survey():
    columns = {"priority": "PRIORITY_INIT", "visits": "NUMOBS", "id": "NUMOBS"}
    catalog = rs.Catalog.from_table(ledger(), columns=columns)
    assert catalog.priority[0] == 2000
    assert catalog.visits.tolist() == catalog.id.tolist() == [1, 1, 1, 0, 0, 0]
    assert rs.Catalog.from_table(sdssv(), columns={"priority": "priority"}).priority.tolist() == [1000, 2000]


def test_bits_of_desi_state_the_kinds_of_targets():
    bits = np.array([LRG, STD_FAINT, SKY, BAD_SKY, ELG | IN_BRIGHT_OBJECT, MWS])
    catalog = rs.Catalog.from_table(desi(DESI_TARGET=bits, PRIORITY_INIT=np.ones(6), NUMOBS_INIT=[2, -1, -1, -1, 1, 1]))
    assert catalog.kind.tolist() == ["science", "standard", "sky", "science", "science", "science"]
    assert catalog.visits.tolist() == [2, 1, 1, 0, 0, 1]
    assert rs.Catalog.from_table(desi(SV3_DESI_TARGET=bits)).visits.tolist() == [1, 1, 1, 0, 0, 1]


def test_only_the_last_entry_of_each_target_in_a_ledger_is_read(tmp_path):
    """Each change of a target adds a row to a DESI ledger; targets were planned once for each row."""
    table = ledger()
    later = table[[4, 1]]
    later["NUMOBS_MORE"], later["PRIORITY"] = [0, 3], [2, 3100]
    table = vstack([table, later])
    text = "2 of 8 rows of the DESI ledger are earlier entries of the same targets"
    for given in (table, table.to_pandas()):
        with pytest.warns(RfpsurveyWarning, match=f"^{text}; only the last entry of each target was read"):
            catalog = rs.Catalog.from_table(given, keep="NUMOBS")
        assert catalog.id.tolist() == [FIRST_ID + k for k in (0, 2, 3, 5, 4, 1)]
        assert catalog.visits.tolist() == [0, 0, 1, 1, 0, 3]
        assert catalog.priority.tolist() == [2, 2, 2000, 3400, 2, 3100]
        assert (catalog.extra["NUMOBS"].tolist(), catalog.meta["ledger"]) == ([1, 1, 0, 0, 0, 1], text)
    targets = table["TARGETID", "RA", "DEC", "PRIORITY_INIT", "NUMOBS_INIT"]
    assert len(rs.Catalog.from_table(targets)) == 8  # target files have one row for each target


def test_rows_are_selected_among_the_last_entries_of_a_ledger():
    """Rows were selected first, so that superseded entries of finished targets were planned."""
    table = vstack([ledger(), ledger()[[3]]])
    table["NUMOBS_MORE"][-1], table["PRIORITY"][-1] = 0, 2
    with pytest.warns(RfpsurveyWarning, match="1 of 7 rows of the DESI ledger are earlier entries"):
        catalog = rs.Catalog.from_table(table, select={"NUMOBS_MORE": 1})
    assert catalog.id.tolist() == [FIRST_ID + 4, FIRST_ID + 5]


@pytest.mark.parametrize("name", ["NUMOBS_INIT", "NUMOBS_MORE"])
def test_numbers_of_visits_that_desi_has_not_set_are_counted(name):
    """NUMOBS_INIT = -1 was refused in tables without DESI_TARGET, and was not reported in other tables."""
    table = desi(4, **{name: [2, -1, 1, -1], "PRIORITY_INIT" if "INIT" in name else "PRIORITY": np.ones(4)})
    text = rf"'{name}' \(visits\) is negative \(not set\) in 2 of 4 rows \(rows 2, 4\), which are not standard"
    catalog = warned(text, rs.Catalog.from_table, table)
    assert catalog.visits.tolist() == [2, 0, 1, 0]
    assert f"visits: {name} (negative, no visits requested: 2 of 4 rows (rows 2, 4))" in catalog.meta["columns"]
    table["DESI_TARGET"] = [LRG, STD_FAINT, ELG, SKY]
    catalog = rs.Catalog.from_table(table)  # without a warning, which would fail the test
    assert catalog.visits.tolist() == [2, 1, 1, 1]
    assert f"visits: {name} (negative, no visits requested: 2 of 4 rows (rows 2, 4))" in catalog.meta["columns"]
    table["DESI_TARGET"] = [LRG, STD_FAINT, ELG, LRG]
    with pytest.warns(RfpsurveyWarning, match=r"in 1 of 4 rows \(row 4\), which are not standard stars or sky"):
        assert rs.Catalog.from_table(table).visits.tolist() == [2, 1, 1, 0]
    table["visits"] = [-1, 1, 1, 1]
    refused("visits must be whole numbers from 0 to 255, got -1", rs.Catalog.from_table, table)


def test_standard_stars_that_are_also_requested_science_targets_have_both_roles():
    """A target had one kind, so that standard stars with requested visits did not count as standard stars."""
    table = desi(3, DESI_TARGET=[MWS | STD_FAINT] * 2 + [SKY], PRIORITY=[1, 1, 0], NUMOBS_MORE=[2, 0, -1])
    catalog = rs.Catalog.from_table(table)
    assert catalog.kind.tolist() == ["science+standard", "standard", "sky"]
    assert catalog.visits.tolist() == [2, 1, 1]
    assert catalog.meta["columns"].endswith("; roles: 1 science and standard, 1 standard, 1 sky")


def test_standard_stars_of_the_backup_program_of_desi_are_recognized():
    """Bits 33 to 35 of MWS_TARGET were not read, so that stars with NUMOBS_INIT = -1 were never assigned."""
    for bit in (33, 34, 35):
        star = [0, 1 << bit, 1 << bit, 1 << 2]
        table = desi(4, DESI_TARGET=[MWS] * 4, MWS_TARGET=star, PRIORITY_INIT=[1] * 4, NUMOBS_INIT=[1, 1, -1, 1])
        catalog = rs.Catalog.from_table(table)
        assert catalog.kind.tolist() == ["science", "science+standard", "standard", "science"]
        assert "not used" not in catalog.meta["columns"]
        table["MWS_TARGET"] = MaskedColumn(star, mask=[True, False, False, False])
        assert rs.Catalog.from_table(table).kind.tolist() == catalog.kind.tolist()  # the catalog was refused
        assert catalog.visits.tolist() == [1] * 4
        table.rename_columns(["DESI_TARGET", "MWS_TARGET"], ["SV3_DESI_TARGET", "SV3_MWS_TARGET"])
        assert rs.Catalog.from_table(table).kind.tolist() == catalog.kind.tolist()
        table.rename_column("SV3_MWS_TARGET", "SCND_TARGET")  # these bits of SCND_TARGET are programs
        table["NUMOBS_INIT"] = 1
        assert rs.Catalog.from_table(table).kind.tolist() == ["science"] * 4


def test_bits_must_be_integers():
    with pytest.raises(InputError, match="column 'DESI_TARGET' must hold integers, whose bits state"):
        rs.Catalog.from_table(desi(2, DESI_TARGET=["LRG", "ELG"]))


def test_epoch_zero_of_targets_without_proper_motion_is_accepted():
    """REF_EPOCH is 0 in DESI's files if the proper motion is 0; such tables were refused."""
    motion = np.array([0, 0, 0, 0, 5, 0]) * u.mas / u.yr
    table = desi(PMRA=motion, PMDEC=0 * motion, REF_EPOCH=np.where(motion.value > 0, 2015.5, 0))
    moved = rs.Catalog.from_table(table).at_epoch(2025.5)
    shift = (moved.coord.ra - table["RA"]).to_value(u.mas) * np.cos(np.deg2rad(30))
    assert shift == pytest.approx([0, 0, 0, 0, 50, 0], abs=1e-3)
    still = rs.Catalog.from_table(table[:4])
    assert still.epoch is None
    assert (still.at_epoch(2025.5).coord.ra == table["RA"][:4]).all()
    table["REF_EPOCH"] = 0.0
    refused("1 of these targets have other values", rs.Catalog.from_table, table)


@pytest.mark.parametrize("masked", [False, True])
def test_targets_without_proper_motion_need_no_epoch(presets, masked):
    """A warning stated that targets with proper motions of 0 and no epoch cannot be moved to the time of a tile."""
    zero = np.ma.array(np.zeros(6), mask=masked) if masked else np.zeros(6)
    table = Table(desi(PMRA=zero, PMDEC=zero, REF_EPOCH=zero))
    table["PMRA"].unit = table["PMDEC"].unit = "mas / yr"
    conditions = rs.ObservingConditions("kitt peak", time=Time("2026-04-01T06:30:00"))
    catalog = rs.Catalog.from_table(table)
    tile = rs.plan_tile(catalog, presets["desi"], conditions=conditions)  # without a warning
    assert tile.summary["epoch"] is None
    tiles = rs.Tiling.from_table(table[:1]["RA", "DEC"]).with_conditions(conditions)
    assert rs.plan_survey(catalog, presets["desi"], tiles).summary["n_targets"] == 6
    with pytest.warns(RfpsurveyWarning, match="the epoch has no effect, because the targets have no proper motions"):
        rs.plan_tile(catalog, presets["desi"], epoch=2026.5)


@pytest.mark.parametrize("table", [ledger(), sdssv()])
def test_positions_of_surveys_without_units_are_in_degrees(table):
    """Ledgers of DESI in which only another column has a unit were refused."""
    expected, plain = rs.Catalog.from_table(table), table.copy()
    for name in [name for name in table.colnames if name.lower() in ("ra", "dec")]:
        plain[name] = table[name].value
    plain["FLUX"] = np.ones(len(table)) * u.Unit("nanomaggy", parse_strict="silent")
    catalog = rs.Catalog.from_table(plain)  # without a warning, which would fail the test
    assert (catalog.coord.ra == expected.coord.ra).all()
    assert catalog.meta["assumed_units"].lower() == "ra in deg, dec in deg"


@pytest.mark.parametrize("identifier", ["catalogid", "rsid"])
@pytest.mark.parametrize("fiber_type", ["fiberType", "fiber_type"])
@pytest.mark.parametrize("selection", ["cadence", "category"])
def test_small_priorities_of_sdssv_are_more_important(identifier, fiber_type, selection):
    """Candidates of SDSS-V were read with large priorities first."""
    table = sdssv()
    table.rename_columns(["catalogid", "fiberType", "cadence"], [identifier, fiber_type, selection])
    catalog = rs.Catalog.from_table(table)
    assert (catalog.priority.tolist(), catalog.fiber_type.tolist()) == ([-1000, -2000], ["BOSS", "BOSS"])


def manual_list():
    """Return a list of candidates of SDSS-V with the columns of the lists that are submitted, without catalogid."""
    table = sdssv(cartonname=["a", "a"], program=["b", "b"], category=["science"] * 2, inertial=[True, True])
    table.rename_columns(["catalogid", "fiberType"], ["Gaia_DR3_Source_ID", "instrument"])
    return table


def test_candidates_of_sdssv_without_catalogid_are_recognized_by_several_columns():
    """Their priorities were read with large values first."""
    catalog = rs.Catalog.from_table(manual_list())
    assert (catalog.priority.tolist(), catalog.fiber_type.tolist()) == ([-1000, -2000], ["BOSS", "BOSS"])
    assert rs.Catalog.from_table(catalog.to_table()).priority.tolist() == [-1000, -2000]
    for missing in (["instrument"], ["program", "inertial"], ["cadence", "category", "cartonname"]):
        table = manual_list()
        table.remove_columns(missing)
        assert rs.Catalog.from_table(table).priority.tolist() == [1000, 2000]


@pytest.mark.parametrize("missing", ["catalogid", "fiberType", "cadence"])
def test_large_priorities_of_other_tables_are_more_important(missing):
    table = sdssv()
    table.remove_column(missing)
    assert rs.Catalog.from_table(table).priority.tolist() == [1000, 2000]


@pytest.mark.parametrize("table", [sdssv(carton=["a", "b"]), ledger()])
def test_written_catalogs_of_surveys_are_read_unchanged(tmp_path, table):
    keep = [name for name in table.colnames if name not in ("RA", "DEC", "ra", "dec")]
    catalog = rs.Catalog.from_table(table, keep=keep)
    catalog.write(tmp_path / "catalog.ecsv")
    again = rs.Catalog.read(tmp_path / "catalog.ecsv")
    for name in ("id", "priority", "visits"):
        assert np.array_equal(getattr(again, name), getattr(catalog, name)), name


def test_catalogs_state_which_column_has_which_role():
    about = rs.Catalog.from_table(ledger(), keep=["NUMOBS"]).meta["columns"]
    expected = "DESI ledger: priority: PRIORITY, visits: NUMOBS_MORE, id: TARGETID, ra: RA, dec: DEC; kept: NUMOBS; "
    assert about == expected + "not used: PRIORITY_INIT, NUMOBS_INIT"
    about = rs.Catalog.from_table(sdssv()).meta["columns"]
    assert about.startswith(
        "SDSS-V candidates: priority: priority (reversed sign), visits: none, fiber_type: fiberType"
    )
    assert about.endswith("not used: cadence")
    mixed = QTable({"coord": rs.Catalog.from_table(sdssv()).coord, "priority": [1, 2], "ra": [1, 2]})
    assert (
        rs.Catalog.from_table(mixed).meta["columns"] == "priority: priority, visits: none, coord: coord; not used: ra"
    )
    galactic = Table({"l": [1.0], "b": [2.0], "ra": [3.0], **{f"c{k}": [0] for k in range(30)}})
    galactic["l"].unit = galactic["b"].unit = "deg"
    about = rs.Catalog.from_table(galactic, frame="galactic").meta["columns"]
    assert "lon: l, lat: b; not used: ra, c0" in about
    assert about.endswith("c18, and 11 more")


def test_subpriorities_of_a_catalog_break_ties(presets):
    """SUBPRIORITY was not recognized."""
    center, n = None, 2000
    rng = np.random.default_rng(1)
    table = Table({"TARGETID": np.arange(n), "RA": 95 + rng.uniform(-1, 1, n), "DEC": 23 + rng.uniform(-1, 1, n)})
    table["RA"].unit = table["DEC"].unit = "deg"
    table["PRIORITY_INIT"], table["NUMOBS_INIT"], table["SUBPRIORITY"] = 3000, 1, rng.random(n)
    catalog = rs.Catalog.from_table(table)
    plans = [
        rs.plan_tile(one, presets["sdss_apo"], center, allocator=options).table["target_id"].filled(-1).tolist()
        for one, options in (
            (catalog, "nearest"),
            (
                rs.Catalog.from_table(table, keep="SUBPRIORITY"),
                rs.AllocationOptions("nearest", subpriority="SUBPRIORITY"),
            ),
            (catalog, rs.AllocationOptions("nearest", subpriority=5)),
            (rs.Catalog(catalog.coord), rs.AllocationOptions("nearest", subpriority=5)),
            (rs.Catalog(catalog.coord), "nearest"),
        )
    ]
    assert (plans[0], plans[2]) == (plans[1], plans[3])
    assert len({tuple(plan) for plan in plans}) == 3
    survey = rs.plan_survey(catalog, presets["sdss_apo"], catalog.mean_direction.reshape(1), allocator="nearest")
    assert sorted(survey.tile(0)["target_id"].tolist()) == sorted(t for t in plans[0] if t >= 0)


def test_real_files_of_desi_are_read_as_their_data_model_defines(real_data):
    """A survey after one night planned the 451 observed targets again, and did not plan 1098 other targets."""
    start, later = (rs.Catalog.read(real_data(f"desi/{name}_like.fits.gz")) for name in ("targets", "ledger"))
    table, science = Table.read(real_data("desi/ledger_like.fits.gz")), later.kind == "science"
    assert science.sum() == 2116
    assert (np.count_nonzero(later.visits[science]), later.visits[science].sum(dtype=int)) == (1591, 2862)
    assert (later.priority == table["PRIORITY"]).all()
    assert (start.priority == table["PRIORITY_INIT"]).all()
    assert (start.visits[science] == table["NUMOBS_INIT"][science]).all()
    assert (start.subpriority == table["SUBPRIORITY"]).all()


def test_real_candidates_of_sdssv_have_small_priorities_first(real_data):
    for name in ("sdssv_robostrategy_field_a", "sdssv_eight_designs"):
        table = QTable.read(real_data(f"{name}.ecsv"))
        assert (rs.Catalog.from_table(table).priority == -table["priority"]).all()


PFS_LISTS = target_list(), target_list(visits=[3, 2, 1, 1], single_exptime=[900.0] * 4)


def partitions_of(tables, folder):
    """Return a catalog with one partition for each table, at the pixels of their first rows."""
    parquet, pa = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow")
    (folder / "dataset" / "Norder=0" / "Dir=0").mkdir(parents=True)
    for k, table in enumerate(tables):
        first = rs.Catalog.from_table(table)[:1]
        pixel = rs.catalog.partition_catalog(first, folder / f"own_{k}", order=0).parts.files[0][1]
        columns = {name: np.asarray(getattr(table[name], "value", table[name])) for name in table.colnames}
        parquet.write_table(pa.table(columns), folder / f"dataset/Norder=0/Dir=0/Npix={pixel}.parquet")
    return rs.catalog.PartitionedCatalog(folder / "dataset")


@pytest.mark.parametrize(
    "table", [ledger(), sdssv(), desi(DESI_TARGET=[LRG, STD_FAINT, SKY, BAD_SKY, ELG, MWS]), *PFS_LISTS]
)
def test_partitioned_catalogs_of_surveys_are_read_as_tables(tmp_path, table):
    whole, parts = rs.Catalog.from_table(table, keep=[]), partitions_of([table], tmp_path)
    for catalog in (parts.read(), parts.parts.part(0)):
        for name in ("id", "priority", "visits", "kind", "fiber_type", "subpriority"):
            assert np.array_equal(getattr(catalog, name), getattr(whole, name)), name
    stated = whole.meta["columns"].replace(" (divided by 900.0 s, rounded up)", "")
    assert parts.meta["columns"] == parts.read().meta["columns"] == stated


def test_partitions_of_pfs_must_have_one_resolution(tmp_path):
    """The resolution was checked in each partition, so that surveys had targets of both resolutions."""
    lists = (
        target_list(resolution=["L"] * 4),
        target_list(resolution=["M"] * 4, ra=[10.0, 10.1, 10.2, 10.3], obj_id=[1, 2, 3, 4]),
    )
    parts = partitions_of(lists, tmp_path)
    tiling = rs.Tiling.from_table(QTable({"ra": [10.1, 150.0] * u.deg, "dec": [2.0, 2.0] * u.deg}))
    with pytest.raises(
        InputError, match=r"Npix=.*'resolution' must have one value in all rows, .* got L \(4\), M \(4\)"
    ):
        rs.plan_survey(parts, "pfs", tiling, allocator="nearest")


def test_joined_files_of_desi_are_read():
    targets = desi(2, PRIORITY_INIT=[1, 2], NUMOBS_INIT=[1, 1], DESI_TARGET=[LRG, ELG])
    sky = desi(1, PRIORITY_INIT=[-1], NUMOBS_INIT=[-1], DESI_TARGET=[SKY])
    assert rs.Catalog.from_table(vstack([targets, sky])).kind.tolist() == ["science", "science", "sky"]


def test_offsets_of_candidates_of_sdssv_are_added_to_the_positions():
    """The offsets were among the columns that are not used."""
    offsets = {"delta_ra": [30.0, -9999.99], "delta_dec": [-40.0, 0.0], "pmra": [10.0, 0.0], "pmdec": [5.0, 1.0]}
    table = sdssv(**offsets, ref_epoch=[2015.5, 2015.5])
    table["dec"] = [60, 0] * u.deg
    table["pmra"].unit = table["pmdec"].unit = "mas/yr"
    catalog, there = rs.Catalog.from_table(table), SkyCoord(table["ra"], table["dec"])
    east, north = there[0].spherical_offsets_to(catalog.coord[0])
    assert_allclose([east.arcsec, north.arcsec], [30, -40], rtol=0, atol=1e-9)
    assert catalog.coord[1].separation(there[1]).arcsec == 0
    assert_allclose(catalog.coord.pm_ra_cosdec.to_value(u.mas / u.yr), [10, 0])
    assert "delta_dec: delta_dec (added to the positions of 1 target)" in catalog.meta["columns"]
    table["delta_ra"][1] = 901
    with pytest.warns(RfpsurveyWarning, match=r"at most 900 arcsec, got larger values in 1 of 2 rows \(row 2\), which"):
        assert rs.Catalog.from_table(table).coord[1].separation(there[1]).arcsec == 0  # ignored without a message
    one = table.copy()
    one.remove_column("delta_dec")
    assert "delta_ra: " not in rs.Catalog.from_table(one).meta["columns"]
    other = Table(table)
    other.remove_column("fiberType")  # not a table of SDSS-V: the meaning of the columns is unknown
    assert rs.Catalog.from_table(other).coord[0].separation(there[0]).arcsec == 0
