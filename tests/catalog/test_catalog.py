import gzip
import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import FK5, AltAz, Galactic, SkyCoord
from astropy.table import MaskedColumn, QTable, Table
from astropy.time import Time
from erfa import ErfaWarning
from raising import refused, warned

import rfpsurvey as rs

DEG = u.deg
PM = u.mas / u.yr


def table(**more):
    return QTable({"ra": [10.0, 20.0, 30.0] * DEG, "dec": [-5.0, 0.0, 5.0] * DEG, **more})


USUAL_NAMES = [
    ("ra", "dec"),
    ("RAJ2000", "DEJ2000"),
    ("TARGET_RA", "TARGET_DEC"),
    ("RA_ICRS", "DE_ICRS"),
    ("RA", "DEC"),
    ("Ra_Deg", "dec_deg"),
]


@pytest.mark.parametrize(("ra", "dec"), USUAL_NAMES)
def test_usual_names_are_found(ra, dec):
    catalog = rs.Catalog.from_table(QTable({ra: [1.0] * DEG, dec: [2.0] * DEG}))
    assert (catalog.coord.ra[0].deg, catalog.coord.dec[0].deg) == (1, 2)


def test_columns_are_found_by_ucd():
    t = Table({"alpha_x": [1.0], "delta_x": [2.0], "name_x": [7], "err": [0.1]})
    for name, ucd in (
        ("alpha_x", "pos.eq.ra;meta.main"),
        ("delta_x", "pos.eq.dec;meta.main"),
        ("name_x", "meta.id;meta.main"),
    ):
        t[name].meta["ucd"] = ucd
    t["err"].meta["ucd"] = "stat.error;pos.eq.ra"
    t["alpha_x"].unit = t["delta_x"].unit = DEG
    catalog = rs.Catalog.from_table(t)
    assert (catalog.coord.ra[0].deg, catalog.id.tolist()) == (1, [7])


def test_columns_and_units_can_be_given():
    t = Table({"a": [1.0, 2.0], "b": [60.0, 120.0], "rank": [1, 2], "star": ["x", "y"], "ra": [0.0, 0.0]})
    catalog = rs.Catalog.from_table(
        t, columns={"ra": "a", "dec": "b", "priority": "-rank", "id": "star"}, units={"ra": "deg", "dec": "arcmin"}
    )
    np.testing.assert_allclose(catalog.coord.dec.deg, [1, 2])
    assert (catalog.priority.tolist(), catalog.id.tolist()) == ([-1, -2], ["x", "y"])


def test_everything_that_a_catalog_can_carry():
    catalog = rs.Catalog.from_table(
        table(
            source_id=np.array([2**60 + 1, 2**60 + 2, 3]),
            priority=[3, 2, 1],
            category=["science", "sky_boss", "standard_apogee"],
            fiber_type=["BOSS", "BOSS", "APOGEE"],
            pmra=[1.0, np.nan, 3.0] * PM,
            pmdec=[0.0, 0.0, -5.0] * PM,
            ref_epoch=[2015.5, 2016.0, 2016.0] * u.yr,
        )
    )
    assert catalog.id.tolist() == [2**60 + 1, 2**60 + 2, 3]
    assert catalog.kind.tolist() == ["science", "sky", "standard"]
    assert catalog.has_proper_motion
    np.testing.assert_allclose(catalog.epoch.jyear, [2015.5, 2016, 2016])
    part = catalog[1:]
    assert (len(part), part.id.tolist(), part.fiber_type.tolist()) == (2, [2**60 + 2, 3], ["BOSS", "APOGEE"])
    np.testing.assert_allclose(part.epoch.jyear, 2016)


@pytest.mark.parametrize("suffix", [".ecsv", ".ecsv.gz", ".fits", ".fits.gz", ".csv", ".vot", ".parquet"])
def test_files_are_read_through_astropy(tmp_path, suffix):
    path = tmp_path / f"stars{suffix}"
    t = table(id=np.array([2**60, 5, 6]), priority=[1.0, 2.0, 3.0])
    if suffix == ".parquet":
        t = Table(t)
    if suffix == ".ecsv.gz":
        with gzip.open(path, "wt") as file:
            t.write(file, format="ascii.ecsv")
    else:
        t.write(path, **({"format": "votable"} if suffix == ".vot" else {}))
    catalog = rs.Catalog.read(path)
    np.testing.assert_allclose(catalog.coord.ra.deg, [10, 20, 30])
    assert (catalog.id.tolist(), catalog.priority.tolist()) == ([2**60, 5, 6], [1, 2, 3])
    assert catalog.meta["file"] == path.name


@pytest.mark.parametrize("suffix", [".ecsv", ".fits", ".ecsv.gz", ".fits.gz"])
def test_write_then_read(tmp_path, suffix):
    first = rs.Catalog.from_table(
        table(
            id=["a", "b", "c"],
            priority=[1, 2, 3],
            pmra=[1, 2, 3] * PM,
            pmdec=[1, 2, 3] * PM,
            ref_epoch=[2016] * 3 * u.yr,
        )
    )
    path = tmp_path / f"stars{suffix}"
    first.write(path)
    second = rs.Catalog.read(path)
    np.testing.assert_array_equal(second.coord.ra, first.coord.ra)
    np.testing.assert_array_equal(second.coord.pm_dec, first.coord.pm_dec)
    np.testing.assert_array_equal(second.id, first.id)
    assert second.epoch.jyear == pytest.approx(2016)
    assert (path.read_bytes()[:2] == b"\x1f\x8b") == suffix.endswith(".gz")
    refused("exists; to replace it, use overwrite=True", first.write, path)
    first.write(path, overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("frame", ["icrs", "fk5", "galactic"])
def test_any_frame_will_do(frame):
    coord = SkyCoord([10, 20] * DEG, [30, 40] * DEG)
    catalog = rs.Catalog(coord.transform_to(frame))
    np.testing.assert_allclose(catalog.arrays.vectors, coord.cartesian.xyz.value.T, atol=1e-14)
    table = QTable({"l": coord.galactic.l, "b": coord.galactic.b})
    np.testing.assert_allclose(rs.Catalog.from_table(table, frame="galactic").coord.icrs.ra.deg, [10, 20])


def test_sexagesimal_text_and_csv_without_units(tmp_path):
    (tmp_path / "a.csv").write_text("ra,dec\n06h20m00s,+23d00m00s\n")
    assert rs.Catalog.read(tmp_path / "a.csv").coord[0].ra.deg == pytest.approx(95)
    (tmp_path / "b.csv").write_text("ra,dec\n06:20:00,+23:00:00\n")
    assert rs.Catalog.read(tmp_path / "b.csv").coord[0].ra.deg == pytest.approx(95)
    (tmp_path / "c.csv").write_text("ra,dec,pmra,pmdec\n95.0,23.0,1,2\n")
    assert rs.Catalog.read(tmp_path / "c.csv").coord[0].pm_dec == 2 * PM


def test_coordinates_that_are_not_finite_are_dropped_and_counted():
    t = table(id=[1, 2, 3], priority=[1, 2, 3])
    t["ra"][1] = np.nan
    catalog = warned("1 of 3 targets have no finite coordinates", rs.Catalog.from_table, t)
    assert (catalog.n_dropped, catalog.id.tolist()) == (1, [1, 3])
    masked = Table({"ra": MaskedColumn([1.0, 2.0], mask=[True, False], unit=DEG), "dec": [1.0, 2.0] * DEG})
    with pytest.warns(rs.RfpsurveyWarning, match="1 of 2 targets"):
        assert len(rs.Catalog.from_table(masked)) == 1
    with pytest.warns(rs.RfpsurveyWarning, match="1 of 2 targets"):
        assert (
            rs.Catalog(SkyCoord([1, np.nan] * DEG, [0, 0] * DEG)).within(SkyCoord(1, 0, unit="deg"), 1 * DEG).n_dropped
            == 1
        )


def test_at_epoch_agrees_with_astropy(rng):
    n = 50
    coord = SkyCoord(
        rng.uniform(0, 360, n) * DEG,
        rng.uniform(-89, 89, n) * DEG,
        pm_ra_cosdec=rng.normal(0, 3000, n) * PM,
        pm_dec=rng.normal(0, 3000, n) * PM,
    )
    start, end = Time(2016, format="jyear", scale="tcb"), Time(2046.5, format="jyear", scale="tcb")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ErfaWarning)
        expected = SkyCoord(coord, obstime=start).apply_space_motion(new_obstime=end)
    moved = rs.Catalog(coord, epoch=start).at_epoch(2046.5)
    assert moved.coord.separation(expected).to_value(u.mas).max() < 1e-3
    assert moved.epoch.jyear == pytest.approx(2046.5)
    # a motion of 3 arcsec per year for 30 years changes the result
    assert moved.coord.separation(coord).to_value(u.arcsec).max() > 50
    assert moved.at_epoch(start).coord.separation(coord).to_value(u.mas).max() < 100


@pytest.mark.parametrize("pole", [90, -90])
def test_fast_stars_next_to_a_pole_move(rng, pole):
    """Regression: the stars did not move, and their proper motions became 0."""
    # two stars move past the pole, and one moves a part of the way
    n, years = 40, np.where(np.arange(40) % 2, 30.0, 0.004)
    sign, gap, angle = np.sign(pole), 0.05, rng.uniform(0, 2 * np.pi, n)
    dec = pole - sign * gap * np.where(np.arange(n) % 5, 1, 0) / 3600  # every fifth star is at the pole
    east, north = 10 * np.cos(angle), 10 * np.sin(angle)  # arcsec / yr
    ra = rng.uniform(0, 360, n)
    coord = SkyCoord(ra * DEG, dec * DEG, pm_ra_cosdec=east * 1000 * PM, pm_dec=north * 1000 * PM)
    catalog = rs.Catalog(coord, epoch=Time(2000 + np.zeros(n), format="jyear", scale="tdb"))
    moved = catalog.at_epoch(Time(2000 + years, format="jyear", scale="tdb"))

    def plane(ra_deg, dec_deg):
        """Return positions (arcsec) in the plane that touches the sphere at the pole, which is accurate enough for 300
        arcsec.
        """
        distance, angle = (90 - np.abs(dec_deg)) * 3600, np.deg2rad(ra_deg)
        return np.column_stack([distance * np.cos(angle), distance * np.sin(angle)])

    turn = np.deg2rad(ra)
    eastward = np.column_stack([-np.sin(turn), np.cos(turn)])
    northward = -sign * np.column_stack([np.cos(turn), np.sin(turn)])
    expected = plane(ra, dec) + years[:, None] * (east[:, None] * eastward + north[:, None] * northward)
    np.testing.assert_allclose(plane(moved.coord.ra.deg, moved.coord.dec.deg), expected, atol=2e-3)
    speed = np.hypot(moved.coord.pm_ra_cosdec, moved.coord.pm_dec).to_value(u.arcsec / u.yr)
    np.testing.assert_allclose(speed, 10, rtol=1e-5)
    assert moved.at_epoch(2000.0 * u.yr).coord.separation(coord).to_value(u.arcsec).max() < 2e-3


def test_stars_faster_than_any_known_leave_their_partition(tmp_path):
    """Regression: the limit of the motion of targets was computed from the fastest known star."""
    pytest.importorskip("pyarrow")
    model = rs.Instrument.preset("moons")
    star = SkyCoord([10.0, 50.0] * DEG, [20.0, 20.0] * DEG, pm_ra_cosdec=[0, 0] * PM, pm_dec=[3e5, 0] * PM)
    parts = rs.catalog.partition_catalog(rs.Catalog(star, id=[7, 8], epoch=2000.0), tmp_path / "fast", order=6)
    field = SkyCoord([10.0] * DEG, [20.05 + np.rad2deg(np.arctan(np.deg2rad(50 * 300 / 3600)))] * DEG)
    assert rs.plan_survey(parts, model, field, epoch=2050.0).tiles["n_in_field"].tolist() == [1]


def test_at_epoch_leaves_targets_without_proper_motion_in_place():
    t = table(pmra=[1000, np.nan, 0] * PM, pmdec=[0, np.nan, 0] * PM, ref_epoch=[2016, 2016, 2000] * u.yr)
    moved = rs.Catalog.from_table(t).at_epoch("2026-01-01")
    shift = moved.coord.separation(SkyCoord(t["ra"], t["dec"])).to_value(u.arcsec)
    np.testing.assert_allclose(shift, [10, 0, 0], atol=1e-2)
    still = rs.Catalog.from_table(table())
    assert still.at_epoch(2030) is still
    no_epoch = rs.Catalog.from_table(table(pmra=[1, 1, 1] * PM, pmdec=[1, 1, 1] * PM))
    refused("proper motions but no epoch", no_epoch.at_epoch, 2030)
    refused("time must be a Time, a Julian year", still.at_epoch, "soon")


def test_epochs_can_be_text():
    """Julian years such as J2016.0 and dates are converted; text that is no epoch counts for moving targets only."""
    t = table(pmra=[9, 9, 0] * PM, pmdec=[9, 9, 0] * PM)
    t["epoch"] = ["J2015.5", "2016-01-01", "unknown"]
    np.testing.assert_allclose(rs.Catalog.from_table(t).epoch.jyear[:2], [2015.5, 2016], atol=2e-3)
    t["epoch"] = ["J2015.5", "", "J2016.0"]
    refused("1 of these targets have other values, such as nan", rs.Catalog.from_table, t)
    t["epoch"] = ["J2015.5", "soon", "J2016.0"]
    refused(r"column 'epoch' \(epoch\) must be a Time, .* or a date such as .*, got 'soon'", rs.Catalog.from_table, t)


def test_epoch_from_the_meta_of_a_table(tycho):
    catalog = rs.Catalog.read(tycho)
    assert (len(catalog), catalog.epoch.jyear, catalog.id[0]) == (8830, pytest.approx(2000), "1319-143-1")
    assert catalog.has_proper_motion


@pytest.mark.parametrize("center", [(0.1, 0), (200, 90), (123, -45)])
def test_within_agrees_with_astropy(center, rng):
    center = SkyCoord(*center, unit="deg")
    catalog = rs.synthetic_catalog("uniform", center, 10 * DEG, n_targets=2000, rng=1)
    inside, expected = catalog.within(center, 4 * DEG), catalog.coord.separation(center) <= 4 * DEG
    np.testing.assert_array_equal(inside.id, np.flatnonzero(expected))


ONE = {"ra": [1.0] * DEG, "dec": [1.0] * DEG}
TEXT = "decimal numbers or sexagesimal text"
BAD_TABLES = [
    ({"ra": [1.0] * DEG}, "there is no column for dec; the columns are: ra"),
    ({"x": [1.0]}, "there is no column for ra and dec; the columns are: x"),
    ({"ra": [1.0], "dec": [1.0] * DEG}, "column 'ra' has no unit; state the unit, for example"),
    ({"ra": [1.0] * u.mm, "dec": [1.0] * DEG}, "column 'ra' .ra. must have a unit convertible to deg, got mm"),
    ({"ra": [1.0] * DEG, "dec": [91.0] * DEG}, "column 'dec' must lie between -90 and 90 deg, got 91"),
    ({"ra": ["x"], "dec": ["y"]}, f"column 'ra' .ra. must hold {TEXT}, got 'x': "),
    ({"ra": ["10,5"], "dec": ["0,5"]}, "got '10,5'; replace the decimal comma with a point"),
    ({"ra": ["10.5", "06:20:11"], "dec": ["1", "2"]}, f"{TEXT}, the same in all rows, got '10.5' and '06:20:11'"),
    ({"ra": ["10.5", "abc"], "dec": ["1", "2"]}, f"{TEXT}, got 'abc'"),
    ({"ra": ["--5", "10.5"], "dec": ["1", "2"]}, f"{TEXT}, got '--5'"),
    ({"ra": ["10.5", "10,5"], "dec": ["1", "2"]}, "got '10,5'; replace the decimal comma with a point"),
    ({"ra": ["95:06:20"], "dec": ["1"]}, "An invalid value for 'hours' was found"),
    ({**ONE, "priority": ["high"]}, "column 'priority' .priority. must hold numbers"),
    ({**ONE, "kind": ["galaxy"]}, "column 'kind' .kind. must be science, standard or sky, .* got 'galaxy'"),
    (
        {"ra": np.ones(9) * DEG, "dec": np.ones(9) * DEG, "priority": [1, *[np.nan] * 7, 2]},
        r"column 'priority' .priority. must have a number in every row, but 7 of 9 rows .rows 2, 3, 4, .... have "
        r"none; state a value for these rows, for example fill=.'priority': 0. or --set catalog.fill.priority=0",
    ),
    ({**ONE, "visits": [np.nan]}, "1 of 1 rows .row 1. have none; state"),
    (
        {**ONE, "ref_epoch": [12.0], "pmra": [1] * PM, "pmdec": [1] * PM},
        "must hold Julian years for targets with a proper motion, but 1 of these targets have other values",
    ),
    ({**ONE, "pmra": [1] * PM}, "there is no column for pmdec"),
    ({**ONE, "id": [1.5]}, "must be integers or text for every row"),
]


@pytest.mark.parametrize(("content", "message"), BAD_TABLES)
def test_bad_tables_are_named(content, message):
    refused(message, lambda: rs.Catalog.from_table(QTable(content)))


def test_bad_overrides_are_named():
    with pytest.raises(rs.InputError, match="there is no column 'nope' for id; the columns are: ra, dec"):
        rs.Catalog.from_table(table(), columns={"id": "nope"})
    refused("unknown column role 'identity'", lambda: rs.Catalog.from_table(table(), columns={"identity": "ra"}))
    refused("id must have one value per target", lambda: rs.Catalog(SkyCoord([1, 2] * DEG, [0, 0] * DEG), id=[1]))
    refused("coord must be a SkyCoord", rs.Catalog, [1, 2])
    with pytest.raises(rs.InputError, match="'altaz' cannot be converted to ICRS"):
        rs.Catalog(SkyCoord([1] * DEG, [2] * DEG, frame=AltAz())).arrays.vectors  # noqa: B018


UNREADABLE_FILES = [
    ("missing.fits", None, "there is no such file"),
    ("broken.fits", b"not a table", "cannot be read as fits"),
    ("broken.ecsv", b"# %ECSV 1.0\n# ---\n# nonsense: [\n", "cannot be read as ascii.ecsv"),
    ("broken.parquet", b"PAR1", "cannot be read as parquet"),
    ("stars.txt", b"", "must end in one of"),
]


@pytest.mark.parametrize(("name", "content", "message"), UNREADABLE_FILES)
def test_unreadable_files_are_named(tmp_path, name, content, message):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    assert name in refused(message, rs.Catalog.read, path)


def test_frames_other_than_icrs_keep_their_proper_motions():
    c = SkyCoord([10] * DEG, [20] * DEG, pm_ra_cosdec=[500] * PM, pm_dec=[-300] * PM)
    for frame in (Galactic(), FK5(equinox="J2000")):
        moved = rs.Catalog(c.transform_to(frame), epoch=2000.0).at_epoch(2100.0)
        expected = rs.Catalog(c, epoch=2000.0).at_epoch(2100.0)
        assert moved.coord.separation(expected.coord).to_value(u.mas).max() < 1


def test_columns_stay_beside_their_rows_when_others_are_dropped():
    t = table(id=[1, 2, 3], priority=[1, 2, 3], ref_epoch=[2015.0, 2016.0, 2017.0] * u.yr)
    t["category"] = ["science", "sky", "std_boss"]
    t["pmra"], t["pmdec"] = [1, 2, 3] * PM, [4, 5, 6] * PM
    t["dec"][0] = np.nan
    with pytest.warns(rs.RfpsurveyWarning):
        catalog = rs.Catalog.from_table(t)
    assert (catalog.id.tolist(), catalog.priority.tolist()) == ([2, 3], [2, 3])
    assert catalog.kind.tolist() == ["sky", "standard"]
    np.testing.assert_allclose(catalog.epoch.jyear, [2016, 2017])
    np.testing.assert_allclose(catalog.coord.pm_dec.value, [5, 6])


def test_small_print_of_columns():
    """Details of columns: motions of sexagesimal positions, a minus sign that reverses an order, upper case, obstime as
    epoch.
    """
    t = QTable({"ra": ["06:20:00"], "dec": ["+23:00:00"], "pmra": [5.0] * PM, "pmdec": [6.0] * PM, "kind": ["SKY"]})
    catalog = rs.Catalog.from_table(t)
    assert (catalog.coord.pm_ra_cosdec[0], catalog.kind.tolist()) == (5 * PM, ["sky"])
    assert rs.Catalog.from_table(t, columns={"pmra": "-pmra"}).coord.pm_ra_cosdec[0] == -5 * PM
    with pytest.raises(rs.InputError, match="a leading minus is allowed only for columns of numbers, got id"):
        rs.Catalog.from_table(t, columns={"id": "-kind"})
    dated = SkyCoord([1] * DEG, [2] * DEG, obstime=Time("J2010.5"))
    assert rs.Catalog(dated).epoch.jyear == pytest.approx(2010.5)
    half = table(pmra=[9000, 9000, 0] * PM, pmdec=[0, np.nan, 0] * PM, ref_epoch=[2016, 2016, 2016] * u.yr)
    shift = rs.Catalog.from_table(half).at_epoch(2026).coord.separation(SkyCoord(half["ra"], half["dec"]))
    np.testing.assert_allclose(shift.to_value(u.arcsec), [90, 0, 0], atol=0.1)
    two = QTable({"a": SkyCoord([1] * DEG, [2] * DEG), "b": SkyCoord([3] * DEG, [4] * DEG)})
    refused("a single column of coordinates, got a, b", rs.Catalog.from_table, two)
    both = QTable({"guide": SkyCoord([1] * DEG, [2] * DEG), "ra": [5.0] * DEG, "dec": [6.0] * DEG})
    assert rs.Catalog.from_table(both, columns={"ra": "ra", "dec": "dec"}).coord.ra[0].deg == 5


def test_identifiers_are_text_or_counted_as_empty():
    text = QTable({"name": ["a", "", "c", ""], "ra": [1, 2, 3, 4] * u.deg, "dec": [1, 2, 3, 4] * u.deg})
    words = r"column 'name' \(id\) is empty in 2 of 4 rows \(rows 2, 4\)"
    assert warned(words, rs.Catalog.from_table, text).id.tolist() == ["a", "", "c", ""]
    ids = np.array([b"a", "b", "Ä".encode()], dtype=object)
    catalog = rs.Catalog.from_table(table(id=ids))
    assert catalog.id.tolist() == ["a", "b", "Ä"]
    words, center = r"center must be one direction, got the shape \(2,\)", SkyCoord([1, 2] * DEG, [3, 4] * DEG)
    refused(words, catalog.within, center, 1 * DEG)
    assert repr(rs.Catalog(center[:1])) == "<Catalog of 1 target>"


def test_coordinates_of_other_differentials_keep_their_proper_motions():
    """An angular velocity in right ascension is multiplied by the cosine of the declination."""
    motion = {"pm_ra": [4, 4] * PM, "pm_dec": [1, 2] * PM, "differential_type": "spherical"}
    catalog = rs.Catalog(SkyCoord(ra=[10, 20] * DEG, dec=[60, 0] * DEG, **motion))
    np.testing.assert_allclose(catalog.coord.pm_ra_cosdec.to_value(PM), [2, 4], rtol=1e-12)
    np.testing.assert_allclose(catalog.coord.pm_dec.to_value(PM), [1, 2], rtol=1e-12)


def test_a_column_target_contains_the_identifiers():
    """Tables of observations name the identifiers of targets target, and catalogs id or target_id."""
    for name in ("id", "target_id", "target"):
        table = QTable({"ra": [1, 2] * u.deg, "dec": [1, 2] * u.deg, name: ["a", "b"]})
        assert rs.Catalog.from_table(table).id.tolist() == ["a", "b"]
    coord = SkyCoord([1, 2] * u.deg, [3, 4] * u.deg)
    assert rs.Catalog.from_table(QTable({"target": coord})).id.tolist() == [0, 1]
