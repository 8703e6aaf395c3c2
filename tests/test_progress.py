"""The progress of work is shown on request, with the rate of the work of this run."""

import io
import re
import sys

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import rfpsurvey as rs
from rfpsurvey._common import executors as _progress
from rfpsurvey._common.executors import Progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def clock(monkeypatch):
    """Return a clock that the test sets."""
    times = [0.0]
    monkeypatch.setattr(_progress, "monotonic", lambda: times[0])
    return times


@pytest.fixture
def open_terminal(monkeypatch):
    """Return a function that replaces the standard error by a terminal."""

    def put():
        terminal = Terminal()
        monkeypatch.setattr(sys, "stderr", terminal)  # replace it during the test, because pytest replaces it before
        monkeypatch.setenv("COLUMNS", "120")
        monkeypatch.setenv("TERM", "xterm")
        return terminal

    return put


def test_the_remaining_time_after_a_resume_is_that_of_the_work_that_is_left(clock, open_terminal):
    """900 tiles are read in 30 s, and 10 are planned in 1 s. The remaining 90 tiles therefore take 9 s."""
    terminal = open_terminal()
    with Progress(True, 1000, "tiles") as tell:
        for k in range(900):
            clock[0] += 1 / 30
            tell(k + 1, new=False)
        for k in range(10):
            clock[0] += 0.1
            tell(901 + k)
        assert "910 of 1000 tiles (900 of them from an earlier run), 10.0 tiles/s, 0:00:09 left" in terminal.getvalue()


def test_what_an_earlier_run_did_does_not_count_for_the_rate(clock, open_terminal):
    terminal = open_terminal()
    with Progress(True, 100, "designs", done=80) as tell:
        clock[0] += 20
        tell(90)
        clock[0] += 20
        tell(100)
    text = terminal.getvalue()
    assert "90 of 100 designs (80 of them from an earlier run), 0.5 designs/s, 0:00:20 left" in text
    assert "100 of 100 designs (80 of them from an earlier run), 0.5 designs/s, 0:00:00 left" in text


def test_a_fraction_is_shown_in_percent_and_may_fall(clock, open_terminal):
    """The fraction decreases if the number of tiles to plan increases."""
    terminal = open_terminal()
    with Progress(True) as tell:
        for fraction in (0.5, 0.25):
            clock[0] += 10
            tell(fraction)
    assert "50%, 0:00:10 left" in terminal.getvalue()
    assert "25%, 0:01:00 left" in terminal.getvalue()


def test_the_line_is_drawn_a_few_times_a_second(clock, monkeypatch, open_terminal):
    open_terminal()
    drawn = []
    monkeypatch.setattr(Progress, "_draw", lambda self: (drawn.append(clock[0]), setattr(self, "_drawn", clock[0])))
    with Progress(True, 1000, "tiles") as tell:
        for k in range(1000):
            clock[0] += 0.001
            tell(k + 1)
    assert 8 <= len(drawn) <= 12


def test_nothing_is_shown_unless_it_is_asked_for(capsys):
    told = []
    with Progress(False, 2, "tiles") as tell:
        tell(1)
    with Progress(lambda *args: told.append(args), 2, "tiles") as tell:
        tell(1)
        tell(2, new=False)
    assert capsys.readouterr() == ("", "")
    assert told == [(1, 2), (2, 2)]


def test_a_file_gets_one_line_at_the_end_also_of_work_that_fails(capsys):
    with pytest.raises(ValueError, match="broken"), Progress(True, 3, "tiles") as tell:  # noqa: PT012
        tell(1)
        raise ValueError("broken")
    out, err = capsys.readouterr()
    assert (out, err.count("tiles,")) == ("", 1)
    assert err.endswith("\n")


def test_the_line_ends_with_the_stage(clock, open_terminal):
    terminal = open_terminal()
    with Progress(True) as tell:
        clock[0] += 1
        tell(0.25, note="class 2 of 8")
    assert "25%, 0:00:03 left, class 2 of 8" in terminal.getvalue()


def test_a_search_tells_how_many_objectives_are_proven(open_terminal):
    """Objectives are proven one after the other. A function receives the fraction; a terminal shows the objective."""
    center = SkyCoord("6h20m +23d")
    sky = rs.synthetic_catalog("uniform", center, 0.5 * u.deg, n_targets=4000, rng=1)
    sky = rs.Catalog(sky.coord, priority=np.arange(len(sky)) % 12)
    asked = rs.AllocationOptions("optimal", requirements="sky=0-5")  # in one step
    told, plain = [], rs.plan_tile(sky, "moons", center, allocator=asked)
    tile = rs.plan_tile(sky, "moons", center, allocator=asked, progress=lambda *words: told.append(words))
    assert tile.table["target_id"].tolist() == plain.table["target_id"].tolist()
    done = [fraction for fraction, total in told if total == 1]
    assert len(done) == len(told) > 1
    assert done == sorted(done)
    assert 0 == done[0] < done[-1] < 1
    terminal = open_terminal()
    rs.plan_tile(sky, "moons", center, allocator=asked, progress=True)
    assert re.search(r"objective \d+ of 1\d", terminal.getvalue())


def test_an_estimate_tells_its_realizations_and_standard_error(open_terminal):
    terminal, precision = open_terminal(), rs.probability.Precision(1e-9, max_iterations=3000)
    with pytest.warns(rs.RfpsurveyWarning, match="after 3000 iterations"):
        rs.collision_probability("moons", method="monte_carlo", precision=precision, progress=True)
    assert re.search(r"\d+ realizations, standard error \d\.\d+", terminal.getvalue())
