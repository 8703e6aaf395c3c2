"""Plots on the pages of the documentation have descriptions for readers who cannot see them."""

import re
from pathlib import Path

import pytest

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
