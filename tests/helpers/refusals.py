"""Errors of commands and of readers, each of which is a single sentence."""

import pytest

import rfpsurvey as rs


def sentence(code, err):
    """Check that a command refuses bad input with exit code 2 and one line without a traceback."""
    assert code == 2
    lines = [line for line in err.strip().split("\n") if "warning:" not in line]
    assert len(lines) == 1
    assert lines[0].startswith("rfpsurvey: ")
    return lines[0]


def written(path, content):
    """Write text or bytes to a file, and return its path."""
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def refusal(path, read=rs.Catalog.read):
    """Return the sentence of the error for a file, without the name of the file."""
    with pytest.raises(rs.InputError) as caught:
        read(path)
    text = str(caught.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    return text.removeprefix(str(path))
