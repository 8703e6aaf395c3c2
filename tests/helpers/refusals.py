"""What is refused, in one sentence: by commands, and by readers of files."""

import pytest

import rfpsurvey as rs


def sentence(code, err):
    """Bad input: exit code 2 and one line, no traceback."""
    assert code == 2
    lines = [line for line in err.strip().split("\n") if "warning:" not in line]
    assert len(lines) == 1
    assert lines[0].startswith("rfpsurvey: ")
    return lines[0]


def refusal(path, read=rs.Catalog.read):
    """Return the sentence with which a file is refused, without its name."""
    with pytest.raises(rs.InputError) as caught:
        read(path)
    text = str(caught.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    return text.removeprefix(str(path))
