"""Threads of HiGHS that the search abandons at the time limit, and programs that HiGHS finds infeasible."""

import subprocess
import sys
from threading import Event
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest

import flat
import rfpsurvey as rs
from rfpsurvey._assignment import local_plans as _idle
from rfpsurvey._assignment import milp as _milp
from rfpsurvey._assignment import solver as _solver
from scenes import random_scene

# The program is dense, so that its presolve takes longer than the time limit. A thread that is cancelled before the
# presolve begins ends at once; longer time limits are therefore tried until a thread continues to run. The last object
# delays the end of Python until the thread of HiGHS ends; without the exit handler, this end aborts the process.
SCRIPT = """
import atexit, time
import numpy as np
from scipy.sparse import csr_array
from rfpsurvey._assignment import solver as _solver

n, rows = 1500, 12000
column = np.random.default_rng(0).integers(0, n, 6 * rows)
matrix = csr_array((np.ones(6 * rows), (np.repeat(np.arange(rows), 6), column)), shape=(rows, n))
matrix.data[:] = 1
_solver.GRACE = 0.0
_solver.AT_EXIT = 90.0  # the thread needs longer on a busy machine
constraints = matrix, np.full(rows, -np.inf), np.ones(rows)
for seconds in (0.2, 0.4, 0.6, 0.8, 1.0, 1.5, 2.0):
    _solver._abandoned.clear()
    deadline = time.perf_counter() + seconds
    x, bound = _solver.maximize(constraints, np.ones(n), np.ones(n), deadline, integral=True, gap=0.0, presolve=True)
    assert x is None and bound == np.inf
    time.sleep(0.2)
    if any(thread.is_alive() for thread in _solver._abandoned):
        break
else:
    raise RuntimeError("no thread continued to run after its search was abandoned")

class Delay:
    wait = staticmethod(time.sleep)
    def __del__(self):
        Delay.wait({delay})

{end}
delay = Delay()
"""


def run(end: str, delay: int) -> subprocess.CompletedProcess:
    """Run the script, with the line ``end`` before its end and the given delay (s)."""
    script = SCRIPT.replace("{end}", end).replace("{delay}", str(delay))
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)


def test_the_process_ends_normally_after_a_search_was_abandoned():
    """Regression: the process was aborted, because the thread of HiGHS returned to Python after Python had ended."""
    done = run("", 4)
    assert done.returncode == 0, done.stderr


@pytest.mark.exhaustive
def test_the_process_is_aborted_without_the_exit_handler():
    done = run("atexit._clear()", 60)
    assert done.returncode < 0, done.stderr


def test_an_interrupted_search_waits_for_its_thread_at_the_end_of_the_process(monkeypatch):
    """Regression: the thread of HiGHS was not recorded if an interrupt ended the search, and aborted the process."""

    def interrupt():
        raise KeyboardInterrupt

    end, cancelled = Event(), []
    monkeypatch.setattr(_solver, "_abandoned", [])
    monkeypatch.setattr(_solver, "now", interrupt)
    with pytest.raises(KeyboardInterrupt):
        _solver._run(SimpleNamespace(run=end.wait, cancelSolve=lambda: cancelled.append(True)), 60.0)
    assert [thread.is_alive() for thread in _solver._abandoned] == [True]
    assert cancelled == [True]
    end.set()


# A scene whose program the presolve of HiGHS 1.10 to 1.14 finds infeasible.
CENTERS = """17.4 11.09 -6.85 1.35 -24.8 7.17 -7.11 11.73 -24.04 -15.85 -22.76 -4.84 -15.95 12.8 5.4 20 19.75 -15.68
-4.37 -4.35 3.8 -1.02 7.76 -19.09 -11.9 17.92 10.71 -11.3 -13.5 -3.81 -13.4 -18.49 -4.68 2.49 -12.73 -7.23 22.23 -12.48
-0.12 10.34"""
CENTRAL = (
    "15.26 13.65 13.78 15.61 15.16 15.76 15.15 14 14.63 15.46 15.47 15.47 15.74 14.68 13.87 15.42 14.3 15.66 14.6 15"
)
ECCENTRIC = "14.21 14.83 14.55 14.08 14.77 13.79 14.25 14.35 14.98 14.52 13.86 14.23 14.52 15.18 15.78 15.3 14.85 15.05"
TARGETS = """19.22 20.01 -0.09 20.76 -16.48 -6.91 -10.48 -2.52 37.7 -30.55 19.05 -18.08 28.85 -9.07 -36.19 12.62
27.18 0.08 37.91 26.91 -21.84 -27.54 -36.41 32.76"""


def numbers(text):
    return np.array(text.split(), dtype=float)


def test_a_feasible_program_that_presolve_finds_infeasible_is_solved():
    """A required sky fiber was missing, and the search ended early with a gap."""
    unit = rs.Positioner(14.68 * u.mm, 14.68 * u.mm, 2.13 * u.mm, step=2 * u.deg, handedness="right")
    arms = {"central_arm": numbers(CENTRAL), "eccentric_arm": np.append(numbers(ECCENTRIC), [15.76, 15.05])}
    arms = {name: values * u.mm for name, values in arms.items()}
    plane = rs.FocalPlane(numbers(CENTERS).reshape(-1, 2) * u.mm, unit, **arms)
    kind = np.array(
        ["sky", "standard", *["science", "sky", "standard"], *["science", "standard"], *["science"] * 4, "sky"]
    )
    options = rs.AllocationOptions("optimal", requirements=["sky=2", "standard=0-2"], time_limit=40 * u.s)
    targets = numbers(TARGETS).reshape(-1, 2) * u.mm
    plan = rs.allocate(plane, targets, allocator=options, kind=kind, required=[3, 6, 7, 8])
    assigned = plan.target_of_positioner[plan.target_of_positioner >= 0]
    assert ((kind[assigned] == "sky").sum(), plan.gap) == (2, 0)


@pytest.mark.parametrize("word", ["kInfeasible", "kUnboundedOrInfeasible", "kSolveError", "kUnknown"])
def test_a_failure_with_presolve_is_not_believed(monkeypatch, word):
    """The second answer of HiGHS counts, for whole numbers and for fractions. After an error, the bound was 0."""
    from highspy import HighsModelStatus

    real, asked = _solver._solver, []

    def solver(*arguments, **options):
        found = real(*arguments, **options)
        asked.append(found)
        if len(asked) < 2:
            status = getattr(HighsModelStatus, word)
            found = SimpleNamespace(**{name: getattr(found, name) for name in ("setOptionValue", "run", "getInfo")})
            found.getModelStatus = lambda: status
        return found

    monkeypatch.setattr(_solver, "_solver", solver)
    rows = np.ones((1, 2)), np.array([-np.inf]), np.array([1.5])
    for integral, expected in ((True, 1), (False, 1.5)):
        asked.clear()
        options = {"integral": integral, "gap": 0.0, "presolve": True}
        x, bound = _solver.maximize(rows, np.ones(2), np.ones(2), _solver.now() + 10, **options)
        assert (x.sum(), bound) == (pytest.approx(expected), pytest.approx(expected))
        assert (len(asked), asked[1].getOptionValue("presolve")[1]) == (2, "off")
        asked.clear()
        found = _solver.maximize(rows, np.ones(2), np.ones(2), _solver.now() + 10, **{**options, "presolve": False})
        assert found == (None, np.inf)


@pytest.mark.parametrize("chunk", [0, *(pytest.param(k, marks=pytest.mark.exhaustive) for k in range(1, 8))])
def test_programs_have_the_same_optimum_with_and_without_presolve(monkeypatch, chunk):
    """All chunks together solve more than 240 programs."""
    real, solved = _solver.maximize, []

    def maximize(rows, goal, most, deadline, *, integral, gap, presolve=True, **more):
        answers = [
            real(rows, goal, most, deadline, integral=integral, gap=0.0, presolve=one, **more) for one in (True, False)
        ]
        values = [goal @ x for x, _ in answers]
        assert values[0] == pytest.approx(values[1], rel=1e-6, abs=1e-6)
        assert answers[0][1] == pytest.approx(answers[1][1], rel=1e-5, abs=1e-5)
        solved.append(values[0])
        return answers[not presolve]

    for module in (_milp, _idle):
        monkeypatch.setattr(module, "maximize", maximize)
    for seed in range(25 * chunk, 25 * (chunk + 1)):
        plane, xy, options, _ = random_scene(seed)
        flat.allocate(plane, xy * u.mm, "optimal", **options)
    assert len(solved) >= 30
