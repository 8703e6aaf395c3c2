"""The check of the files in the wheel."""

import sys
from pathlib import Path
from zipfile import ZIP_STORED, ZipFile

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture
def problems_of(monkeypatch):
    if not (ROOT / "data" / "check_wheel.py").is_file():
        pytest.skip("the folder data is not part of this installation")
    monkeypatch.syspath_prepend(ROOT / "data")
    yield __import__("check_wheel").problems_of
    sys.modules.pop("check_wheel")


def test_an_unexpected_or_large_file_in_the_wheel_is_named(tmp_path, problems_of):
    path = tmp_path / "some.whl"
    expected = {"rfpsurvey/tile/_tile.py": 900, "rfpsurvey/presets/desi.toml": 900, "rfpsurvey-1.0.dist-info/RECORD": 9}
    unexpected = {"tests/test_wheel.py": 9, "rfpsurvey/_kernels/__pycache__/arms.nbi": 9, "rfpsurvey/notes.txt": 9}
    large = {"rfpsurvey/_large.py": 10_001, "rfpsurvey/probability/surrogate.npz": 1_400_000}
    for files, words in ((expected, []), ({**expected, **unexpected, **large}, ["smaller", *unexpected, *large])):
        with ZipFile(path, "w", ZIP_STORED) as wheel:
            for name, size in files.items():
                wheel.writestr(name, bytes(size))
        problems = problems_of(path)
        assert len(problems) == len(words)
        assert all(word in text for word, text in zip(words, problems, strict=True))
