"""Plots on the pages of the documentation have descriptions for readers who cannot see them."""

import re
import runpy
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from PIL import Image

DOCS = Path(__file__).parent.parent / "docs"
PAGES = sorted(page for page in DOCS.glob("*.rst") if ".. plot::" in page.read_text())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_plots_have_alternative_texts(page):
    """Without an alternative text, Sphinx uses the name of the file."""
    texts = []
    for options in re.findall(r"^\.\. plot::.*\n((?:    :.*\n)*)", page.read_text(), re.MULTILINE):
        if ":nofigs:" not in options:
            texts += re.findall(r":alt: (.*)", options) or [""]
    for text in texts:
        assert len(text) > 40
        assert text.endswith(".")
    assert len(set(texts)) == len(texts)


def test_scripts_of_the_gallery_have_thumbnails_of_their_own():
    """Regression: all scripts that are not run had the same thumbnail."""
    scripts = [path for path in (DOCS / "examples" / "scripts").glob("*.py") if not path.name.startswith("plot_")]
    found = [re.findall(r"sphinx_gallery_thumbnail_path = [\"'](.*)[\"']", script.read_text()) for script in scripts]
    assert all(len(paths) == 1 for paths in found)
    files = [(DOCS / path).read_bytes() for (path,) in found]
    assert len(set(files)) == len(scripts)
    assert max(map(len, files)) < 60_000


@pytest.mark.parametrize("name", ["speed_accuracy", "failures", "needed_models"])
def test_plots_of_trade_offs_can_be_drawn_for_an_own_instrument(name, tmp_path, monkeypatch):
    toml = re.search(r"code-block:: toml\n\n((?:    .*\n|\n)+)", (DOCS / "instruments.rst").read_text()).group(1)
    (tmp_path / "mine.toml").write_text(re.sub("^    ", "", toml, flags=re.MULTILINE))
    monkeypatch.syspath_prepend(DOCS / "figures")
    monkeypatch.setattr(sys, "argv", [name, str(tmp_path / "mine.toml"), str(tmp_path / "mine.png")])
    with plt.rc_context():
        drawn = runpy.run_path(str(DOCS / "figures" / f"{name}.py"))
        assert "mine" in drawn["figure"].get_supxlabel()
        heights = {text.get_size() for ax in drawn["figure"].axes for text in [*ax.texts, *ax.get_xticklabels()]}
        plt.close(drawn["figure"])
    with Image.open(tmp_path / "mine.png") as image:
        assert min(heights) / 72 * 120 * 500 / image.width >= 9  # pixels, if the plot is 500 pixels wide


def test_errors_of_probabilities_have_one_measure_that_does_not_saturate(monkeypatch):
    """Regression: one figure showed absolute errors, another relative errors, of which all are at most 100 % if the
    estimate is too small.
    """
    monkeypatch.syspath_prepend(DOCS / "figures")
    import trade_offs

    assert trade_offs.excess(1.01) == pytest.approx(0.01)
    assert (
        trade_offs.excess(0.061 / 0.418) == pytest.approx(trade_offs.excess(0.418 / 0.061)) == pytest.approx(5.85, 0.01)
    )
    assert trade_offs.excess(0.1) > 3 * trade_offs.excess(0.3)
    for name in ("speed_accuracy", "failures"):
        text = (DOCS / "figures" / f"{name}.py").read_text()
        assert "set_ylabel(trade_offs.FACTOR" in text
