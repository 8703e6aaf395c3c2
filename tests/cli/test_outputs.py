"""Output files are written together, and output that is not read or cannot be written has a standard exit code."""

import errno
import io
import json
import os
import subprocess
import sys

import pytest

import rfpsurvey as rs
from refusals import sentence
from rfpsurvey._cli import application as _main

FILES = ("tile.fits", "tile.png", "tile.html")


def words_of(folder, options=""):
    words = "plan --instrument sdss_apo --allocator nearest --output {} --plot {} --report {}"
    return (f"{words} {options}", *(folder / name for name in FILES))


def test_all_files_are_written_under_their_names(call, refused, tmp_path):
    out = call(*words_of(tmp_path), "--set", f"output.quality={tmp_path / 'quality.svg'}").out
    assert (sorted(os.listdir(tmp_path)), out.count("wrote ")) == (sorted(["quality.svg", *FILES]), 4)
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


# this program runs commands, each given with whether Python buffers the output, and with the file for the output
FORKED = """
import io, json, os, runpy, sys
import rfpsurvey._cli  # once, and not once a command, as the facts
rfpsurvey.Instrument.preset("moons").facts()
for k, (command, unbuffered, stdout) in enumerate(json.loads(sys.argv[1])):
    child = os.fork()
    if child == 0:
        os.dup2(stdout, 1)
        os.dup2(os.open(f"{k}.txt", os.O_CREAT | os.O_WRONLY), 2)
        if unbuffered:  # as python -u does
            sys.stdout = io.TextIOWrapper(io.FileIO(1, "w"), write_through=True)
        sys.argv = ["rfpsurvey", *command.split()]
        runpy.run_module("rfpsurvey", run_name="__main__", alter_sys=True)
        sys.exit()
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), open(f"{k}.txt").read(), sep="\\0", end="\\1")
"""


TO_NOBODY = [
    *((command, False) for command in ("instruments", "--help", "--version", "plan --help", "plan --instrument moons")),
    *((command, True) for command in ("instruments", "--help")),  # output of the library, and of its command line
]


@pytest.fixture(scope="module")
def ends(tmp_path_factory):
    """Return exit codes and errors of commands with output that is not read, goes to ``head``, or to a full disk."""
    folder = tmp_path_factory.mktemp("ends")
    receive, nobody = os.pipe()
    os.close(receive)
    head = subprocess.Popen(["head", "-n", "1"], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
    commands = [(command, unbuffered, nobody) for command, unbuffered in TO_NOBODY]
    commands.append(("plan --instrument moons --output a.fits", True, head.stdin.fileno()))
    files = [nobody, head.stdin.fileno()]
    if os.path.exists("/dev/full"):
        files.append(os.open("/dev/full", os.O_WRONLY))
        commands.append(("instruments", False, files[-1]))
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORKED, json.dumps(commands)],
        cwd=folder,
        pass_fds=files,
        capture_output=True,
        text=True,
        check=True,
    )
    head.stdin.close()
    head.wait()
    for file in (nobody, *files[2:]):
        os.close(file)
    found = [(int(code), text) for code, text in (part.split("\0") for part in done.stdout.split("\1")[:-1])]
    return folder, found[: len(TO_NOBODY)], *found[len(TO_NOBODY) :]


def test_a_closed_pipe_loses_no_file(ends):
    folder, _, (_, errors), *_ = ends
    assert rs.Tile.read(folder / "a.fits").summary["n_positioners"] == 1001
    assert "Traceback" not in errors


@pytest.mark.parametrize("number", range(len(TO_NOBODY)), ids=[" ".join(map(str, one)) for one in TO_NOBODY])
def test_a_reader_that_has_gone_is_told_as_any_shell_does(ends, number):
    """Regression: the exit code was 1, so that a script with pipefail could not distinguish a broken pipe from bad
    input.
    """
    assert ends[1][number] == (141, "")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no device that is full")
def test_a_full_device_is_a_sentence(ends):
    assert "No space left on device" in sentence(*ends[3])


@pytest.mark.parametrize(
    ("error", "code", "text"),
    [
        (BrokenPipeError(), 141, ""),
        (OSError(errno.ENOSPC, "No space left on device"), 2, "rfpsurvey: [Errno 28] No space left on device\n"),
        (ValueError("I/O operation on closed file"), 0, ""),
    ],
)
def test_errors_on_the_last_flush_decide_the_exit_code(monkeypatch, tmp_path, capsys, error, code, text):
    class Stream(io.FileIO):
        def flush(self):
            raise error

    with (tmp_path / "out").open("w") as file:
        monkeypatch.setattr(sys, "__stdout__", stream := Stream(os.dup(file.fileno()), "w", closefd=False))
        assert _main._flush(0) == code
        os.write(stream.fileno(), b"more")
        os.close(stream.fileno())
    assert capsys.readouterr().err == text
    # after an error, the rest of the output is discarded, so that the flush at the exit succeeds
    assert (tmp_path / "out").read_bytes() == (b"more" if code == 0 else b"")


def test_a_pipe_that_is_closed_during_a_command_has_its_exit_code(run, monkeypatch):
    def broken():
        raise BrokenPipeError

    monkeypatch.setattr(_main, "commands", lambda: broken)
    assert run("instruments") == (141, "", "")
