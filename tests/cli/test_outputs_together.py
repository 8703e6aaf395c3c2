"""The output files of a command are written together, or none of them is written."""

import os

import pytest

import rfpsurvey as rs
from refusals import sentence

WORDS = ["plan", "--instrument", "sdss_apo", "--allocator", "nearest"]
FILES = {"--output": "tile.fits", "--plot": "tile.png", "--report": "tile.html"}


def call(run, folder, *more):
    return run(*WORDS, *(word for option, name in FILES.items() for word in (option, folder / name)), *more)


def test_all_files_are_written_under_their_names(run, tmp_path):
    code, out, _ = call(run, tmp_path, "--set", f"output.quality={tmp_path / 'quality.svg'}")
    assert code == 0
    assert sorted(os.listdir(tmp_path)) == ["quality.svg", "tile.fits", "tile.html", "tile.png"]
    assert out.count("wrote ") == 4
    assert rs.Tile.read(tmp_path / "tile.fits").summary["n_assigned"] > 0
    assert (tmp_path / "tile.png").read_bytes().startswith(b"\x89PNG")
    assert "tile.fits" in (tmp_path / "tile.html").read_text()
    code, _, error = call(run, tmp_path)
    assert "exists; to replace it, use --overwrite" in sentence(code, error)
    assert call(run, tmp_path, "--overwrite")[0] == 0


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt, OSError(28, "No space left on device"), rs.InputError("bad page")]
)
def test_no_file_is_written_if_one_of_them_fails(run, tmp_path, monkeypatch, error):
    """Regression: an interrupt while the report was written left the tile and the plot."""

    def stop(*_, **__):
        raise error

    monkeypatch.setattr(rs, "write_report", stop)
    try:
        code = call(run, tmp_path)[0]
    except KeyboardInterrupt:
        code = 130
    assert code != 0
    assert os.listdir(tmp_path) == []


def test_errors_name_the_output_and_not_a_temporary_file(run, tmp_path, monkeypatch):
    def refuse(_, path, **__):
        raise rs.InputError(f"{path}: the page is too large")

    monkeypatch.setattr(rs, "write_report", refuse)
    code, _, error = call(run, tmp_path)
    assert sentence(code, error) == f"rfpsurvey: {tmp_path / 'tile.html'}: the page is too large"
