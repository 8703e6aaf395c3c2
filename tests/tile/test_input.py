"""Input of tiles: centers as text, requirements on unknown categories, epochs."""

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable

import rfpsurvey as rs
from refusals import sentence

CENTER = SkyCoord(95 * u.deg, 23 * u.deg)
STARS = rs.synthetic_catalog("uniform", CENTER, 1.4 * u.deg, n_targets=500, rng=1)
TEXTS = ["95 23", "95.0, 23.0", "06:20:00 +23:00:00", "6h20m +23d", "06 20 00 +23 00 00"]


def places(tile):
    return [tile.provenance["parameters"][name] for name in ("ra_deg", "dec_deg")]


def test_a_center_may_be_text():
    for text in TEXTS:
        assert places(rs.plan_tile(STARS, "sdss_apo", text)) == pytest.approx([95, 23])
        projection = rs.Instrument.preset("sdss_apo").projection(text)
        assert projection.center.separation(CENTER) < 1e-6 * u.arcsec
        assert len(STARS.within(text, 1 * u.deg)) == len(STARS.within(CENTER, 1 * u.deg))
        assert rs.Region.cap(text, 1 * u.deg).contains(CENTER)
        assert len(rs.synthetic_catalog("uniform", text, 1 * u.deg, n_targets=9, rng=1)) == 9


def test_a_center_that_is_no_place_is_refused():
    for given, message in (
        ("M35", "center must be coordinates such as '06h20m00s .23d00m00s' or '95.0 23.0', got 'M35'"),
        ("95 123", "got '95 123'"),
        ("", "got ''"),
        ((95, 23), r"center must be a SkyCoord, got \(95, 23\)"),
        (SkyCoord([1, 2] * u.deg, [1, 2] * u.deg), r"center must be one direction, got the shape \(2,\)"),
    ):
        with pytest.raises(rs.InputError, match=message):
            rs.plan_tile(STARS, "sdss_apo", given)


def test_a_center_that_is_left_out_is_the_same_in_python_and_at_the_command_line(run, tmp_path):
    path = tmp_path / "stars.ecsv"
    STARS.write(path)
    mean = STARS.mean_direction.spherical
    expected = [mean.lon.deg, mean.lat.deg]
    assert places(rs.plan_tile(STARS, "sdss_apo")) == pytest.approx(expected)
    code, out, _ = run("plan", path, "--instrument", "sdss_apo")
    assert code == 0
    assert f"center {expected[0]:.6f} {expected[1]:+.6f} deg" in out
    found = rs.compare_allocators(STARS, "sdss_apo", allocators=["lamost_rule"])
    assert found.meta["parameters"]["ra_deg"] == pytest.approx(expected[0])


def test_an_impossible_epoch_is_refused_before_anything_is_said():
    for call in (
        lambda: rs.plan_tile(STARS, "sdss_apo", CENTER, epoch="tomorrow"),
        lambda: rs.plan_survey(STARS, "sdss_apo", SkyCoord([95] * u.deg, [23] * u.deg), epoch="tomorrow"),
    ):
        with pytest.raises(rs.InputError, match="epoch must be a Time, a Julian year .* got 'tomorrow'"):
            call()


def test_a_requirement_on_an_unknown_category_is_told(run, tmp_path):
    stars = rs.Catalog(STARS.coord, category=["quasar", "galaxy"] * 250)
    for what, hint in (
        ("skies", "did you mean 'sky'?"),
        ("qasar", "did you mean 'quasar'?"),
        ("zz", "the catalog's categories are: galaxy, quasar."),
    ):
        options = rs.AllocationOptions(requirements=f"{what}=2")
        words = f"no target of the catalog is '{what}', but the .* needs such .*; {hint[:-1]}"
        with pytest.warns(rs.RfpsurveyWarning, match=words):
            tile = rs.plan_tile(stars, "sdss_apo", CENTER, allocator=options)
        assert (hint in tile.summary["unmet"][0]) == ("did you mean" in hint)
    for what in ("quasar=2", "science=2", "zz=-2"):  # existing categories and kinds, and limits that are met
        rs.plan_tile(stars, "sdss_apo", CENTER, allocator=rs.AllocationOptions(requirements=what))
    stars.write(tmp_path / "a.ecsv")
    code, _, err = run("plan", tmp_path / "a.ecsv", "--instrument", "sdss_apo", "--constraint", "skies=20")
    assert code == 0
    assert "did you mean 'sky'?" in err


@pytest.mark.parametrize(
    ("kind", "hint"), [("sky", "; set sky_separation to add blank sky positions"), ("standard", "")]
)
def test_a_requirement_on_a_kind_without_targets_is_told(kind, hint):
    with pytest.warns(rs.RfpsurveyWarning, match=f"no target of the catalog is '{kind}', .* needs such targets{hint}$"):
        rs.plan_tile(STARS, "sdss_apo", CENTER, allocator=rs.AllocationOptions(requirements=f"{kind}=2"))
    options = rs.AllocationOptions(requirements="sky=2", sky_separation=10 * u.arcsec)
    rs.plan_tile(STARS, "sdss_apo", CENTER, allocator=options)


def test_values_are_filled_at_the_command_line(run, tmp_path):
    path = tmp_path / "stars.csv"
    rows = [f"{c.ra.deg},{c.dec.deg},{'' if k % 7 else k}" for k, c in enumerate(STARS.coord)]
    path.write_text("\n".join(["ra,dec,mag", *rows]) + "\n")
    arguments = ("plan", path, "--instrument", "sdss_apo", "--column", "priority=-mag")
    told = sentence(*run(*arguments)[::2])
    words = (
        "428 of 500 rows (rows 2, 3, 4, ...) have none; state a value for these rows, for example fill={'priority': 0}"
    )
    assert words in told
    assert run(*arguments, "--set", "catalog.fill.priority=-99")[0] == 0


def test_the_message_on_a_sky_separation_says_what_it_is():
    for given, kind in ((10, TypeError), (10 * u.s, u.UnitsError)):
        with pytest.raises(kind, match="an angle on the sky such as 10 . u.arcsec, or a length on the focal plane"):
            rs.AllocationOptions(sky_separation=given)


def test_targets_with_no_requested_visits_are_not_assigned(presets):
    """No visits of a target of any kind with 0 visits are requested, unless the target is required."""
    sky = rs.synthetic_catalog("uniform", CENTER, 1.4 * u.deg, n_targets=1500, rng=1)
    rows, apo = np.arange(len(sky)), presets["sdss_apo"]
    catalog = rs.Catalog(sky.coord, visits=rows % 2, kind=np.where(rows < 40, "sky", "science"), id=rows)
    asked = rs.AllocationOptions("lamost_rule", requirements="sky=5", required=[100])
    tile = rs.plan_tile(catalog, apo, CENTER, allocator=asked)
    assigned = tile.table["target_id"][tile.table["status"] == "assigned"].astype(int)
    assert set(assigned[assigned % 2 == 0].tolist()) == {100}
    assert (assigned < 40).any()
    outcomes = tile.outcomes
    unwanted = (outcomes["target_id"] % 2 == 0) & (outcomes["target_id"] != 100)
    assert (set(outcomes["outcome"][unwanted]), tile.summary["n_set_aside"]) == ({"not requested"}, unwanted.sum())
    alone = rs.plan_tile(catalog[(rows % 2 == 1) & (rows >= 40)], apo, CENTER, allocator="nearest")
    plain = rs.plan_tile(catalog, apo, CENTER, allocator="nearest")
    assert plain.table["target_id"].tolist() == alone.table["target_id"].tolist()
    counts = plain.completeness[plain.completeness["kind"] == "science"][0]
    assert counts["n_in_field"] == alone.summary["n_in_field"] == plain.summary["kinds"]["science"]["n_in_field"]
    table = rs.compare_allocators(catalog, apo, CENTER, allocators=["nearest"])
    assert table["science"][0] == alone.summary["n_assigned"]
    with pytest.raises(rs.InputError, match="the column of visits states 0 for all of them"):
        rs.plan_tile(rs.Catalog(sky.coord, visits=np.zeros(len(sky))), apo, CENTER)


@pytest.mark.exhaustive
def test_commands_and_reports_state_which_column_has_which_role(run, tmp_path):
    rng = np.random.default_rng(1)
    table = QTable({"TARGETID": np.arange(50), "RA": rng.uniform(94, 96, 50) * u.deg})
    table["DEC"], table["PRIORITY_INIT"], table["NUMOBS_INIT"] = rng.uniform(22, 24, 50) * u.deg, 3000, 1
    desi, plan, tiles, *pages = (tmp_path / name for name in ("a.ecsv", "b.ecsv", "c.ecsv", "d.html", "e.html"))
    table.write(desi)
    line = "DESI targets: priority: PRIORITY_INIT, visits: NUMOBS_INIT, id: TARGETID, ra: RA, dec: DEC"
    for command, *words in (
        ("plan", "--center", "95 23", "--output", plan, "--report", pages[0]),
        ("tile", "--output", tiles),
        ("survey", "--tiles", tiles, "--report", pages[1]),
        ("compare-allocators", "--center", "95 23"),
    ):
        code, out, _ = run(command, desi, "--instrument", "sdss_apo", *words)
        assert (code, out.splitlines()[0]) == (0, f"columns: {line}")
    assert all(line in page.read_text() for page in pages)
    assert rs.Tile.read(plan).provenance["catalog"]["columns"] == line
    code, out, _ = run("score", plan)
    columns = "columns: positioner: id, id: target_id, fiber_type: fiber_type, x: tip_x, y: "
    assert (code, any(row.startswith(columns) for row in out.splitlines())) == (0, True)
