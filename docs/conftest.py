"""Run the code of each page in an empty, writable folder, as a reader of the page would."""

import pytest

collect_ignore = [
    "check_docstrings.py",
    "check_links.py",
    "check_search.py",
    "check_words.py",
    "conf.py",
    "inventories.py",
    "mathml.py",
]


@pytest.fixture(autouse=True)
def _clean_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
