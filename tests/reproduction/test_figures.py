"""The figures of the experiments, the page on the claims, and the command that writes them."""

import subprocess
import sys
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

import rfpsurvey as rs
from pages import Reader, full
from reproduction import __main__ as command
from reproduction._claims import Claim, claims_table
from reproduction._designs import Settings
from reproduction._figures import FIGURES, draw_reproduction
from reproduction._report import FIGURES as CAPTIONS

FOLDER = Path(__file__).parents[2] / "docs" / "reproduction"


def band(collection):
    """Return the lower and upper edges of the interval by x."""
    corners = collection.get_paths()[0].vertices
    return {x: (corners[corners[:, 0] == x, 1].min(), corners[corners[:, 0] == x, 1].max()) for x in corners[:, 0]}


def test_coverages_of_intervals_are_drawn_beside_each_other_and_bars_end_at_one():
    rows = [(arms, 1.0, "uniform", n, 0.99, 0.02) for arms in ("LAMOST", "SDSS-V") for n in (37, 91)]
    names = ["arms", "targets_per_positioner", "sky", "positioners", "coverage", "coverage_error"]
    table = QTable(rows=rows, names=names)
    more = QTable({"scene": ["a"], "method": ["b"], "interval": ["c"], "stop": ["d"], "coverage": [0.98]})
    more["coverage_error"] = [0.02]
    figures = draw_reproduction("intervals", {"one_sky": table, "intervals": more})
    bars = [c.lines[2][0].get_segments() for c in figures["one_sky"].axes[0].containers]
    ends = np.array(bars)
    assert len({round(x, 6) for x in ends[..., 0].ravel()}) == 4
    np.testing.assert_allclose(ends[..., 1].max(), 1)
    np.testing.assert_allclose(ends[..., 1].min(), 0.95)
    labels = [text.get_text() for text in figures["one_sky"].legends[0].get_texts()]
    assert labels == [f"{arms}, 1 target per positioner, uniform" for arms in ("LAMOST", "SDSS-V")]
    (ends,) = figures["intervals"].axes[0].containers[0].lines[2][0].get_segments()
    np.testing.assert_allclose(ends[:, 0], [0.94, 1])


def test_the_scans_of_the_paper_have_intervals_in_both_scales():
    rows = [
        (scan, ratio, pitch, v, v - 0.01, v + 0.02, v / 5)
        for scan in ("ratio", "pitch")
        for ratio, pitch, v in ((1, 26, 0.1), (2, 28, 0.2), (3, 30, 0.5))
    ]
    names = ["scan", "ratio", "pitch", "value", "low", "high", "closed_form"]
    figure = draw_reproduction("small", {"small": QTable(rows=rows, names=names, units={"pitch": u.mm})})["small"]
    above, below = figure.axes[0], figure.axes[2]
    assert band(above.collections[0])[2] == pytest.approx((0.19, 0.22))
    assert band(below.collections[0])[2] == pytest.approx((0.09 / 0.4, 0.12 / 0.4))
    np.testing.assert_allclose(below.get_lines()[1].get_ydata(), [0, 0.25, 1])


def claims():
    """Return the result of `reproduce`, without its folder."""
    one = Claim("small", "it is so", "1", "1.1", "reproduced", "as read")
    other = Claim("small", "it is not", "2", "1.1", "not reproduced", "as read")
    table = claims_table([one, other])
    table.meta.update(made_by="reproduce", quick=True)
    return table


def test_claims_have_verdicts_and_their_experiments(tmp_path):
    rs.write_report(claims(), tmp_path / "page.html")
    page = Reader((tmp_path / "page.html").read_text())
    _, rows = page.table("The claims of the paper")
    assert [(row[3]["text"], row[3]["class"]) for row in rows] == [("reproduced", "good"), ("not reproduced", "bad")]
    assert page.text("dd")[:2] == ["1", "1"]


def test_every_figure_of_an_experiment_has_a_caption():
    """Regression: some captions were names of tables, and did not describe all lines of the figure."""
    drawn = {name for figures in FIGURES.values() for name in figures}
    assert set(CAPTIONS) == drawn
    for title, words in CAPTIONS.values():
        assert title.endswith(".")
        assert len(words) > 60
    for name in ("large", "poisson_disc", "surrogate", "intervals", "one_sky"):
        assert "gray line" in CAPTIONS[name][1]


def test_the_command_prints_the_claims_and_writes_a_page(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(Settings, "precision", 2e-2)
    words = ["small", "--quick", "--folder", f"{tmp_path}/small", "--report", f"{tmp_path}/page.html"]
    command.main(words)
    assert "small: the probability increases rapidly with the arm ratio" in capsys.readouterr().out
    assert (tmp_path / "small" / "small.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    page = Reader((tmp_path / "page.html").read_text())
    assert len(page.all("svg")) == 1
    heads, rows = page.table("Table small.")
    table = QTable.read(tmp_path / "small" / "small.ecsv")
    np.testing.assert_array_equal([full(row[heads.index("value")]) for row in rows], table["value"])
    monkeypatch.setattr(command, "reproduce", lambda *_, **__: pytest.fail("the work was begun"))
    with pytest.raises(rs.InputError, match=r"page.html exists"):
        command.main(words)


def test_bad_input_is_one_sentence(tmp_path):
    (tmp_path / "file").touch()
    run = [sys.executable, FOLDER, "small", "--folder", tmp_path / "file"]
    done = subprocess.run(run, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (2, f"reproduction: {tmp_path}/file must be a folder, but it is a file\n")
