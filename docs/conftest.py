"""Pages run as their readers do: in a folder without the source tree, where they may write."""

import pytest

collect_ignore = ["check_docstrings.py", "check_links.py", "conf.py", "inventories.py", "mathml.py"]


@pytest.fixture(autouse=True)
def _clean_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
