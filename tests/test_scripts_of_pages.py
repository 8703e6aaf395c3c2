"""Scripts that pages of the documentation name start without an error, and print the numbers that the pages quote."""

import os
import re
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import quoted

ROOT = Path(__file__).parent.parent
PAGES = [*ROOT.glob("*.rst"), *(ROOT / "docs").glob("*.rst")]
NAMED = re.findall(r"\b(?:[\w.]+/)*\w+\.py\b", " ".join(page.read_text() for page in PAGES))
NEED_FILES = {"as_built_desi", "as_built_speed", "judge"}
"""Scripts whose arguments are files that no test has."""
SCRIPTS = sorted(
    path
    for path in (ROOT / "tests" / "benchmarks").rglob("*.py")
    if path.stem not in NEED_FILES and path.name in map(os.path.basename, NAMED)
)
SMALL = {
    "cadence_figures": ["--targets", "60", "--tiles", "4", "--iterations", "1"],
    "design_figures": ["--designs", "40", "--workers", "1"],
    "fuzz_readers": ["--number", "20"],
    "history_figures": ["--targets", "20000", "--tiles", "40", "--chunks", "3", "--compared", "1"],
    "interrupts": ["--number", "1", "--quick"],
    "joint_figures": ["lamost", "--seconds", "5", "--tile-seconds", "1"],
    "kaiju_calls": ["--repeats", "1"],
    "optimum_figures": ["--only", "oracle", "--scenes", "2"],
    "selection_figures": ["--tiles", "4", "--targets", "20000", "--realizations", "4"],
    "selection_resume": ["--tiles", "4", "--targets", "20000", "--seconds", "1"],
    "survey_figures": ["--targets", "20000", "--tiles", "4"],
}
"""Arguments that make a script short."""
SECONDS, TOGETHER = 3, 2
"""A script that runs for this time has started, and is ended; the second number is that of simultaneous scripts."""


def lacks_data(script):
    return not os.environ.get("RFPSURVEY_TEST_DATA") and "RFPSURVEY_TEST_DATA" in script.read_text()


def test_pages_name_scripts():
    assert len(SCRIPTS) > 30
    names = {path.stem for path in SCRIPTS}
    assert set(SMALL) <= names
    assert {name for name, *_ in quoted.SCRIPTS} <= names


def errors_of(script, folder):
    """Return the errors of a script that ends early with an error."""
    folder.mkdir()
    command = [sys.executable, str(script), *SMALL.get(script.stem, [])]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, cwd=folder, start_new_session=True, **pipes) as process:
        try:
            _, errors = process.communicate(timeout=SECONDS)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # the script and its workers
            return ""
    missing = re.search(r"ModuleNotFoundError: No module named '(\w+)'", errors)
    if missing and missing[1] not in {path.stem for path in ROOT.glob("tests/**/*.py")} | {"reproduction"}:
        return ""  # a package that is not installed
    return errors[-2000:] if process.returncode else ""


@pytest.mark.exhaustive
def test_scripts_start(tmp_path):
    """Regression: seven scripts used former names of parameters or columns, or did not find the modules they import."""
    compared = {name for name, *_ in quoted.SCRIPTS}
    scripts = [path for path in SCRIPTS if path.stem not in compared and not lacks_data(path)]
    with ThreadPoolExecutor(TOGETHER) as pool:
        errors = pool.map(errors_of, scripts, [tmp_path / path.stem for path in scripts])
        assert not {path.stem: text for path, text in zip(scripts, errors, strict=True) if text}


def test_differences_of_quoted_numbers_are_found():
    page, output = "A fraction of 12 % and\n1,234.5 mm", "fraction: 0.1239, length  1234.46"
    good = quoted.Quoted("page", "fraction: #", "of # %", 100), quoted.Quoted("page", "length #", "and # mm")
    assert [quoted.differences(output, page, one) for one in good] == [[], []]
    (found,) = quoted.differences(output.replace("0.1239", "0.1261"), page, good[0])
    assert quoted.same("3", "3", 1)
    assert not quoted.same("3", "4", 1)
    assert found == "page: 12 in 'of # %', but the script prints 0.1261"
    with pytest.raises(AssertionError, match="no text 'length #'"):
        quoted.differences("", page, good[1])


@pytest.mark.exhaustive
@pytest.mark.parametrize("command", quoted.SCRIPTS, ids=" ".join)
def test_pages_quote_the_numbers_that_scripts_print(command, tmp_path):
    """Regression: the collision probability of PFS as built on its page was 0.0901, but the script printed 0.0871."""
    name, *given = command
    script = ROOT / "tests" / "benchmarks" / f"{name}.py"
    if lacks_data(script):
        pytest.skip("the script needs RFPSURVEY_TEST_DATA")
    done = subprocess.run(
        [sys.executable, str(script), *given], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    for one in quoted.SCRIPTS[command]:
        assert not quoted.differences(done.stdout, (ROOT / "docs" / f"{one.page}.rst").read_text(), one)
