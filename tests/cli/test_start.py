"""The start of commands: nothing large is imported for lists and versions, and a message explains compilation."""

import gc
import inspect
import subprocess
import sys
from importlib import import_module

import numba
import pytest
import typer
from numba.core import event

import rfpsurvey as rs
from rfpsurvey._cli import application
from rfpsurvey._cli.application import COMMANDS, MODULES

PROGRAM = """
import runpy, sys
sys.argv = ["rfpsurvey", *sys.argv[1:]]
try:
    runpy.run_module("rfpsurvey", run_name="__main__", alter_sys=True)
finally:
    print(sorted({"astropy", "numba", "numpy", "scipy", "matplotlib"} & set(sys.modules)))
"""


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_nothing_large_is_imported(option):
    done = subprocess.run([sys.executable, "-c", PROGRAM, option], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
    assert ("Usage" if option == "--help" else rs.__version__) in done.stdout


@pytest.mark.parametrize("name", [name for name in COMMANDS if name != "benchmark"])
def test_the_list_contains_the_first_sentence_of_each_command(name, run):
    module = import_module(f"rfpsurvey._cli.{MODULES.get(name, name)}")
    text = inspect.getdoc(getattr(module, name.replace("-", "_")))
    assert " ".join(text.split("\n\n")[0].split()) == COMMANDS[name]
    assert COMMANDS[name] in " ".join(run("--help")[1].split())


def test_garbage_is_collected_again_after_the_import_of_a_command(run):
    run("plan", "--help")
    assert gc.isenabled()


def test_a_command_is_built_once_in_a_process(run, monkeypatch):
    """Each call built all commands that were called before, which took longer than most tests of commands."""
    run("convert", "--help")
    monkeypatch.setattr(typer.main, "get_command", None)
    assert run("convert", "--help")[0] == 0


def test_every_command_has_its_help(run):
    for name in COMMANDS:
        assert f"rfpsurvey {name} [" in run(name, "--help")[1]
    code, _, err = run("nonsense")
    assert code == 2
    assert "No such command 'nonsense'" in err


register = event.register


@pytest.fixture
def registered(monkeypatch):
    """Return the listeners that the command registers, and check that none remains after the test."""
    found = []
    monkeypatch.setattr(event, "register", lambda kind, one: (found.append(one), register(kind, one)))
    yield found
    for one in found:
        event.unregister("numba:compile", one)


@pytest.mark.parametrize("watched", [True, False])
def test_it_is_printed_once_if_a_person_watches(monkeypatch, capsys, registered, watched):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: watched, raising=False)
    application.announce_compilation()
    assert len(registered) == int(watched)
    monkeypatch.setattr(event, "register", register)  # numba registers further listeners
    if numba.config.DISABLE_JIT:
        pytest.skip("nothing is compiled")
    for _ in range(2):
        assert numba.njit(lambda x: x + 1)(1) == 2
    assert capsys.readouterr().err.count("compiling") == int(watched)
