"""The output files of a command are written together, or none of them is written."""

import os

import pytest

import rfpsurvey as rs

FILES = ("tile.fits", "tile.png", "tile.html")


def words_of(folder, options=""):
    words = "plan --instrument sdss_apo --allocator nearest --output {} --plot {} --report {}"
    return (f"{words} {options}", *(folder / name for name in FILES))


def test_all_files_are_written_under_their_names(call, refused, tmp_path):
    out = call(*words_of(tmp_path), "--set", f"output.quality={tmp_path / 'quality.svg'}").out
    assert sorted(os.listdir(tmp_path)) == sorted(["quality.svg", *FILES])
    assert out.count("wrote ") == 4
    assert rs.Tile.read(tmp_path / "tile.fits").summary["n_assigned"] > 0
    assert (tmp_path / "tile.png").read_bytes().startswith(b"\x89PNG")
    assert "tile.fits" in (tmp_path / "tile.html").read_text()
    assert "exists; to replace it, use --overwrite" in refused(*words_of(tmp_path))
    call(*words_of(tmp_path, "--overwrite"))


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt, OSError(28, "No space left on device"), rs.InputError("bad page")]
)
def test_no_file_is_written_if_one_of_them_fails(call, tmp_path, monkeypatch, error):
    """Regression: an interrupt while the report was written left the tile and the plot."""

    def stop(*_, **__):
        raise error

    monkeypatch.setattr(rs, "write_report", stop)
    with pytest.raises((KeyboardInterrupt, AssertionError)):  # also of a code that is not 0
        call(*words_of(tmp_path))
    assert os.listdir(tmp_path) == []


def test_errors_name_the_output_and_not_a_temporary_file(refused, tmp_path, monkeypatch):
    def refuse(_, path, **__):
        raise rs.InputError(f"{path}: the page is too large")

    monkeypatch.setattr(rs, "write_report", refuse)
    assert refused(*words_of(tmp_path)) == f"rfpsurvey: {tmp_path / 'tile.html'}: the page is too large"
