"""Scripts that pages of the documentation name start without an error."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

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
SECONDS = 10
"""A script that runs for this time has started, and is ended."""


def test_pages_name_scripts():
    assert len(SCRIPTS) > 30
    assert set(SMALL) <= {path.stem for path in SCRIPTS}


@pytest.mark.exhaustive
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_scripts_start(script, tmp_path):
    """Regression: seven scripts used former names of parameters or columns, or did not find the modules they import."""
    given = SMALL.get(script.stem, [])
    if not os.environ.get("RFPSURVEY_TEST_DATA") and "RFPSURVEY_TEST_DATA" in script.read_text():
        pytest.skip("the script needs RFPSURVEY_TEST_DATA")
    command = [sys.executable, str(script), *given]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, cwd=tmp_path, start_new_session=True, **pipes) as process:
        try:
            _, errors = process.communicate(timeout=SECONDS)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # the script and its workers
            return
    missing = re.search(r"ModuleNotFoundError: No module named '(\w+)'", errors)
    if missing and missing[1] not in {path.stem for path in ROOT.glob("tests/**/*.py")} | {"reproduction"}:
        pytest.skip(f"{missing[1]} is not installed")
    assert process.returncode == 0, errors[-2000:]
