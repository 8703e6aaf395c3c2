"""NumPy archives of checkpoints: their arrays have known types and shapes, and use no more memory than the file."""

import io
import zipfile
from functools import partial

import numpy as np
import pytest

from rfpsurvey._common.read_documents import read_arrays
from rfpsurvey.errors import InputError

EXPECTED = {"a": ("f8", (None, 2)), "n?": ("i8", ())}


def archive(compress=zipfile.ZIP_STORED, **members):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compress) as stored:
        for name, content in members.items():
            stored.writestr(f"{name}.npy", content)
    return file


def content(write, *values):
    file = io.BytesIO()
    write(file, *values)
    return file.getvalue()


saved = partial(content, np.save)


def header(shape):
    return content(np.lib.format.write_array_header_1_0, {"descr": "<f8", "fortran_order": False, "shape": shape})


DAMAGED = archive(a=saved(np.ones((3, 2)))).getvalue().replace(np.ones(6).tobytes(), bytes(48))


def test_arrays_are_returned():
    file = io.BytesIO()
    np.savez(file, a=np.ones((3, 2)), n=np.array(7))
    found = read_arrays(file, EXPECTED, "it")
    assert found["a"].tolist() == np.ones((3, 2)).tolist()
    assert found["n"] == 7
    assert list(read_arrays(archive(a=saved(np.ones((0, 2)))), EXPECTED, "it")) == ["a"]


@pytest.mark.parametrize(
    ("file", "sentence"),
    [
        (io.BytesIO(b"text"), "cannot be read as npz"),
        (io.BytesIO(), "cannot be read as npz"),
        (archive(n=saved(np.array(7))), "must contain the array 'a', got none"),
        (archive(a=saved(np.ones((3, 3)))), r"must have the shape \(n, 2\) and the type float64, got \(3, 3\) and"),
        (archive(a=saved(np.ones((3, 2), dtype="f4"))), "got .* and float32"),
        (archive(a=saved(np.array([[None, {}]]))), "got .* and object"),
        (archive(a=saved(np.ones((3, 2)))[:-8]), "bytes in all, got the shape"),
        (archive(a=header((2**62, 2))), "bytes in all, got the shape"),
        (archive(a=header((-1, 2))), "bytes in all, got the shape"),
        (archive(a=b"nothing"), "cannot be read as npz"),
        (archive(a=header((1, 2))[:-60]), "cannot be read as npz"),
        (io.BytesIO(DAMAGED), "cannot be read as npz"),
        (archive(zipfile.ZIP_DEFLATED, a=saved(np.zeros((10**6, 2)))), "must not be compressed"),
    ],
)
def test_other_archives_are_refused(file, sentence):
    """Archives with other types or sizes caused errors of Python, or used all of the memory."""
    with pytest.raises(InputError, match=sentence):
        read_arrays(file, EXPECTED, "it")
