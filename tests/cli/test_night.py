"""The command ``night``."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import Table
from astropy.time import Time

import rfpsurvey as rs


@pytest.fixture
def folder(call, files, tmp_path):
    """Return the folder of a survey of SDSS-V."""
    call(
        "survey {} --tiles {} --instrument sdss_apo --folder {}",
        files / "stars.fits",
        files / "tiles.ecsv",
        tmp_path / "plan",
    )
    return tmp_path / "plan"


def test_a_night_is_planned_written_and_exported(call, refused, folder, tmp_path):
    out, survey = tmp_path / "night.ecsv", rs.Survey.read(folder)
    ended = call("night {} --date 2026-01-10 --output {} --folder {}", folder, out, tmp_path / "files")
    table = Table.read(out)
    assert int(ended.lines["tiles"][0]) == len(table) > 2
    names = {f"tile-{tile}.fits" for tile in table["tile"]}
    assert names <= {path.name for path in (tmp_path / "files").iterdir()}
    expected = rs.night.plan_night(survey, "2026-01-10")
    assert table["tile"].tolist() == expected.table["tile"].tolist()
    for tile, row in zip(table["tile"], expected.table, strict=True):
        line = next(line.split() for line in ended.out.splitlines() if line.split()[:1] == [str(tile)])
        assert line[1] == row["start"].isot[11:19]
    first = str(table["tile"][0])
    (tmp_path / "done.csv").write_text(f"tile,date\n{first},2026-01-10\n")
    call("record {} {}", folder, tmp_path / "done.csv")
    said = refused("night {} --date 2026-01-11", folder)
    assert said.endswith("rfpsurvey night FOLDER --update")
    page = tmp_path / "page.html"
    ended = call("night {} --date 2026-01-11 --update --report {}", folder, page)
    assert "not observed: 1 observed" in ended.text
    assert "Plan of the night 2026-01-11" in page.read_text()
    assert call("night {} --date 2026-01-11", folder).out == ended.out.replace(f"wrote {page}\n", "")


def test_files_of_a_survey_with_conditions_are_for_the_times_of_the_night(call, files, tmp_path):
    given = "--set 'conditions.site=apache point' --set conditions.hour_angle='5.3 hourangle'"
    words = f"survey {{}} --tiles {{}} --instrument sdss_apo --allocator lamost_rule {given} --folder {{}}"
    call(words, files / "stars.fits", files / "tiles.ecsv", tmp_path / "plan")
    words = "night {} --date 2026-01-10 --output {} --folder {}"
    ended = call(words, tmp_path / "plan", tmp_path / "night.ecsv", tmp_path / "files")
    table, changes = Table.read(tmp_path / "night.ecsv"), Table.read(tmp_path / "files/changes.ecsv")
    for row in table:
        middle = Time(row["start"]) + row["exposure_time"] / 2 * u.s
        record = rs.Tile.read(tmp_path / f"files/tile-{row['tile']}.fits").provenance["parameters"]["conditions"]
        assert abs(Time(record["time"]) - middle) < 1 * u.s
    text = f"at these times, {len(changes)} positioners cannot observe the planned targets; record the changes"
    assert text in " ".join(ended.text.split())
    (tmp_path / "done.csv").write_text("tile,date\n" + "".join(f"{tile},2026-01-10\n" for tile in table["tile"]))
    call("record {} {}", tmp_path / "plan", tmp_path / "done.csv")
    lines = call("record {} {}", tmp_path / "plan", tmp_path / "files/changes.ecsv").lines
    counts = [int(lines[name][0]) for name in ("swapped targets", "failed visits") if name in lines]
    assert sum(counts) == len(changes)


def test_limits_replace_those_of_the_instrument(call, files):
    words = "night {} --instrument sdss_apo --date 2026-01-10 --set limits.max_altitude=31 {}"
    tiles = files / "tiles.ecsv"
    assert call("night {} --instrument sdss_apo --date 2026-01-10", tiles).lines["tiles"][0] != "0"
    ended = call(words, tiles, "--max-airmass=1.5")
    assert "too near to the zenith" in ended.text
    airmass = [
        float(line.split()[3])
        for line in call(
            "night {} --instrument sdss_apo --date 2026-01-10 --max-airmass 1.3 --exposure-time '1 h'", tiles
        ).out.splitlines()
        if line.split()[:1] and line.split()[0].isdigit()
    ]
    assert airmass
    assert np.max(airmass) <= 1.3


WRONG = [
    ("night {}", "the folder of a survey, or a table of tiles, and --date must be given"),
    ("night {} --date 2026-01-10", "site must be given, because the description of the instrument has none"),
    ("night {} --date soon --instrument desi", "date must be a Time, a Julian year"),
    ("night {} --date 2026-01-10 --instrument desi --folder x", "--folder, --report and --update must be used with"),
    ("night {} --date 2026-01-10 --instrument must", "site must be given"),
    ("night {} --date 2026-01-10 --instrument desi --method best", "unknown method 'best'; choose one of"),
    ("night {} --date 2026-01-10 --instrument desi --max-airmass 0.2", "--max-airmass must be a number from 1 to 40"),
]


@pytest.mark.parametrize(("words", "text"), WRONG, ids=lambda value: value[:60])
def test_wrong_options_are_refused(refused, files, words, text):
    assert text in refused(words, files / "tiles.ecsv")
