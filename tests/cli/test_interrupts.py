"""Commands that a signal ends, such as Ctrl-C, and commands with closed standard streams."""

import os
import signal
import subprocess
import sys

import pytest

import interrupts
import rfpsurvey as rs
from rfpsurvey._assignment import clock
from rfpsurvey._cli import process as _process
from rfpsurvey._common import temporary as _temporary

pytestmark = pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs process groups")
KEPT = "rfpsurvey: interrupted; the finished tiles are stored in the folder; continue with --resume"


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["survey optimal", "survey processes"])
def test_an_interrupted_survey_ends_with_a_message_and_can_be_resumed(name, run, tmp_path, monkeypatch):
    """Regression: threads of HiGHS aborted the process after the message."""
    interrupts.make_input(tmp_path / "input")
    whole, folder = tmp_path / "whole", tmp_path / "interrupted"
    for path in (folder, whole):
        path.mkdir()
        monkeypatch.chdir(path)
    assert run(*interrupts.COMMANDS["survey optimal"])[0] == 0
    words = interrupts.COMMANDS[name]
    ended = interrupts.interrupt(words, folder, lambda: any((folder / "out").glob("tiles/**/*.fits")))
    assert not ended.faults
    assert (ended.code, ended.errors.splitlines()[-1]) == (130, KEPT)
    assert ended.seconds < 10
    monkeypatch.chdir(folder)
    assert (run(*words, "--resume")[0], interrupts.content(folder)) == (0, interrupts.content(whole))


def test_an_interrupt_during_the_imports_has_a_message(tmp_path):
    """Regression: an interrupt during the imports printed a traceback."""
    environment = {**os.environ, "PYTHONPROFILEIMPORTTIME": "1"}
    command = [sys.executable, "-m", "rfpsurvey", "plan"]
    with subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True) as process:
        for line in process.stderr:
            if line.endswith("| typer\n") or "typer.main" in line:
                process.send_signal(signal.SIGINT)
                break
        errors = process.stderr.read()
    assert (process.returncode, errors.splitlines()[-1]) == (130, "rfpsurvey: interrupted")
    assert "Traceback" not in errors


class Ended(BaseException):
    """Stands for the end of the process."""


@pytest.fixture
def ends(monkeypatch):
    """Catch signals as a command does, and return the exit codes of the process; restore everything at the end."""

    def end(code):
        found.append(code)
        raise Ended

    found, numbers = [], (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)
    before = {number: signal.getsignal(number) for number in numbers}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr(os, "_exit", end)
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    monkeypatch.setattr(_process, "_received", [])
    monkeypatch.setattr(_process, "_kept", [])
    _process._prepare()
    yield found
    signal.setitimer(signal.ITIMER_REAL, 0)
    for number, handler in before.items():
        signal.signal(number, handler)


def test_the_second_interrupt_ends_the_process_and_removes_temporary_files(ends, tmp_path, capfd):
    path = tmp_path / "table"
    with _temporary.temporary(path):
        path.mkdir()
        (path / "part").touch()
        _process.tell_if_interrupted("nothing was stored")
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        assert path.exists()
        assert not ends
        with pytest.raises(Ended):
            signal.raise_signal(signal.SIGINT)
        assert not path.exists()
    assert (ends, capfd.readouterr().err) == ([130], "rfpsurvey: interrupted; nothing was stored\n")


def test_an_interrupt_that_python_ignores_ends_the_process(ends, monkeypatch, capfd):
    class Deleted:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(sys, "__unraisablehook__", lambda _: None)
    Deleted()
    assert ends == [130]
    assert "rfpsurvey: interrupted\n" in capfd.readouterr().err


def test_a_command_that_does_not_stop_is_ended(ends, monkeypatch):
    monkeypatch.setattr(_process, "PATIENCE", 0.1)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGTERM)
    with pytest.raises(Ended):
        signal.sigtimedwait([], 10)
    assert ends == [143]


def test_a_signal_that_is_ignored_remains_ignored(ends):
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    _process._prepare()
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    assert signal.getsignal(signal.SIGINT) is _process._interrupt


def test_an_interrupted_search_of_a_plan_has_the_exit_code_of_an_interrupt(run, monkeypatch, tmp_path):
    """Regression: the exit code was 0, although the plan is not the plan of an uninterrupted run."""
    whole = rs.plan_tile

    def interrupted(*arguments, **options):
        tile = whole(*arguments, **options)
        clock.stop.set()
        return tile

    monkeypatch.setattr(rs, "plan_tile", interrupted)
    code, _, err = run("plan", "--instrument", "moons", "--output", tmp_path / "tile.fits")
    assert (code, err) == (
        130,
        "rfpsurvey: interrupted; the output is the best plan that was found before the interruption\n",
    )
    assert rs.Tile.read(tmp_path / "tile.fits").summary["n_positioners"] == 1001


@pytest.mark.few(1)
@pytest.mark.parametrize("closed", [2, 0])
def test_closed_standard_streams_change_nothing(closed, tmp_path):
    """Regression: without a standard error stream, the command ``survey`` ended without output."""
    words = f"exec {sys.executable} -m rfpsurvey survey --instrument moons --folder out {closed}>&-"
    done = subprocess.run(["sh", "-c", words], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0
    assert done.stdout.endswith("wrote out\n")
    assert "22 of 22 tiles" not in done.stdout
    assert rs.Survey.read(tmp_path / "out").summary["n_tiles"] == 22


def test_a_closed_standard_output_is_an_error_after_the_files_are_written(tmp_path):
    """Regression: the exit code was 0, although the text of the command was lost."""
    words = f"exec {sys.executable} -m rfpsurvey plan --instrument moons --output tile.fits >&-"
    done = subprocess.run(["sh", "-c", words], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (2, "rfpsurvey: standard output is closed\n")
    assert rs.Tile.read(tmp_path / "tile.fits").summary["n_positioners"] == 1001


@pytest.mark.parametrize("words", [["--version"], ["plan", "--nonsense"]])
def test_the_signal_handlers_of_a_command_are_removed_when_it_returns(words, monkeypatch):
    """Programs that run ``main`` in their process, such as tests, kept the handlers of the last command."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before, hook = [signal.getsignal(number) for number in numbers], sys.unraisablehook
    monkeypatch.setattr(sys, "argv", ["rfpsurvey", *words])
    prepare, seen = _process._prepare, []
    monkeypatch.setattr(_process, "_prepare", lambda: (prepare(), seen.append(signal.getsignal(signal.SIGINT))))
    with pytest.raises(SystemExit):
        _process.main()
    assert (seen, [signal.getsignal(number) for number in numbers]) == ([_process._interrupt], before)
    assert sys.unraisablehook is hook
