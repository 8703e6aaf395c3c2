"""Pages run as their readers do: in a folder with ``data``, where they may write."""

from pathlib import Path

import pytest

collect_ignore = ["check_docstrings.py", "check_links.py", "conf.py", "inventories.py", "mathml.py"]


@pytest.fixture(autouse=True)
def _clean_folder(tmp_path, monkeypatch):
    (tmp_path / "data").symlink_to(Path(__file__).parents[1] / "data")
    monkeypatch.chdir(tmp_path)
