"""The commands ``status`` and ``diff``."""

import shutil

import numpy as np
import pytest
from astropy.table import Table

import rfpsurvey as rs
from pages import Reader

NIGHT = "2026-01-03"


@pytest.fixture
def observed(plan, record):
    """Return a survey with two observed tiles, of which three visits failed, and a dropped tile."""
    folder = plan()
    failed = rs.Survey.read(folder).tile(11)["positioner"][:3]
    record(folder, tile=[11, 12, 13], date=[NIGHT, "2026-01-05", ""], state=["done", "done", "dropped"])
    record(folder, "--tile 11", positioner=failed, date=[NIGHT] * 3)
    return folder


def test_the_status_is_that_of_the_library(call, observed, tmp_path):
    before = call("status", observed)
    assert [line for line in before.out.splitlines() if len(line) > 100] == []
    assert "the last plan does not take all recorded events into account" in before.out
    call("survey {} --replan", observed)
    again = call("status {} --output {} --plot {}", observed, tmp_path / "targets.fits", tmp_path / "status.png")
    assert "the last plan does not" not in again.out
    survey, state, lines = rs.Survey.read(observed), rs.Survey.read(observed).state(), again.lines
    s = survey.summary
    assert lines["observed"] == before.lines["observed"] == [str(int(state.observed.sum()))]
    assert [lines[name] for name in ("finished", "dropped", "not yet observed")] == [["2"], ["1"], ["1"]]
    assert lines["visits requested"] == [str(s["n_visits_requested"])]
    assert lines["failed visits"] == before.lines["failed visits"] == ["3"]
    assert lines["planned"] == [str(s["n_visits_observed"] - int(state.observed.sum()))]
    assert lines["first and last date"] == [NIGHT, "2026-01-05"]
    table = Table.read(tmp_path / "targets.fits")
    assert (np.asarray(table["observed"]) == state.observed).all()
    assert table["last_date"].tolist().count("2026-01-05") == int((state.table["last_date"] == "2026-01-05").sum()) > 0
    assert (tmp_path / "status.png").read_bytes().startswith(b"\x89PNG")


def test_the_status_of_an_earlier_date(call, observed):
    found = call("status {} --until 2026-01-04", observed)
    assert found.lines["finished"] == ["1"]
    assert "the last plan" not in found.out
    assert found.lines["first and last date"] == [NIGHT, NIGHT]


def test_the_report_of_the_status(call, observed, tmp_path):
    call("status {} --report {}", observed, tmp_path / "status.html")
    page = (tmp_path / "status.html").read_text()
    for text in ("Status of a survey with sdss_apo", "Events were recorded after the last plan", "2026-01-05"):
        assert text in page
    rs.write_report(rs.Survey.read(observed).state(), tmp_path / "same.html")
    assert (tmp_path / "same.html").read_text() == page


def test_invalid_input_of_the_status_and_of_differences_is_one_sentence(run, refused, observed, tmp_path):
    assert "does not hold a survey" in refused("status", tmp_path)
    assert "date must be a date" in refused("status {} --until soon", observed)
    assert "must end in" in refused("status {} --output {}", observed, tmp_path / "x.txt")
    assert "does not hold a survey" in refused("diff", observed, tmp_path)
    assert "must end in" in refused("diff {} {} --output {}", observed, observed, tmp_path / "x.txt")
    for words in ("status {0}", "diff {0} {0}"):
        assert "must end in .html or .htm" in refused(f"{words} --report x.txt".format(observed))
    assert "Missing argument" in run("status", "--report", "x.html")[2]
    (observed / "plan.toml").unlink()
    assert "must contain the file plan.toml" in refused("status {} --report {}", observed, tmp_path / "x.html")
    assert not (tmp_path / "x.html").exists()


def test_files_are_verified(call, run, refused, observed, tmp_path):
    """Each missing or damaged file is one line, and the exit code is 1."""
    assert call("status {} --verify", observed).out == "0 files missing or damaged\n"
    call("survey {} --replan", observed)
    (observed / "notes.txt").write_text("")
    notes = "notes.txt: does not belong to the survey, and is not used"
    assert call("status {} --verify", observed).out.splitlines() == [notes, "0 files missing or damaged"]
    (observed / "tiles/000/000003.fits").write_bytes(b"")
    (observed / "events/000001.json").unlink()
    code, out, err = run("status", observed, "--verify")
    assert (code, err) == (1, "")
    assert out.splitlines() == [
        "events/000001.json: is missing, but 000002.json exists; restore it from a backup",
        "tiles/000/000003.fits: is damaged (its checksum differs from the checksum recorded in the index); it is made "
        "again when the survey is planned again",
        notes,
        "2 files missing or damaged",
    ]
    assert "does not hold a survey" in refused("status {} --verify", tmp_path)
    assert "without other options" in refused("status {} --verify --until 2026-01-04", observed)


def test_differences_of_two_plans(call, observed, tmp_path):
    before = shutil.copytree(observed, tmp_path / "before")
    out = call("diff", before, observed).text  # long paths are wrapped
    assert out.startswith("the plans are the same: 4 tiles events that were recorded in")
    assert out.count("after its last plan are not compared") == 2
    call("survey {} --replan", observed)
    found = call("diff {} {} --output {} --report {}", before, observed, tmp_path / "changes.fits", tmp_path / "d.html")
    expected = rs.survey.diff_surveys(before, observed)
    heads, rows = Reader((tmp_path / "d.html").read_text()).table("The tiles of the survey")
    changed = [int(row[heads.index("n changed")]["text"]) for row in rows]
    numbers = [((expected["tile"] == name) & (expected["positioner"] != "")).sum() for name in ("11", "12", "13", "14")]
    assert changed == numbers
    assert found.out.endswith(f"wrote {tmp_path / 'changes.fits'}\nwrote {tmp_path / 'd.html'}\n")
    assert Table.read(tmp_path / "changes.fits")["reason"].tolist() == expected["reason"].tolist()
    assert (found.lines["tiles: observed"], found.lines["tiles: dropped"]) == (["2"], ["1"])
    n = int(((expected["tile"] == "14") & (expected["positioner"] != "")).sum())
    assert f"tile 14: {n} fibers changed" in found.out
    assert "tile 11: observed\n" in found.out
