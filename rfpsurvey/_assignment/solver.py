"""Run the solver HiGHS in a thread, so that the search can be ended at a deadline or when the user interrupts it."""

import atexit
import threading
from time import perf_counter

import numpy as np
from scipy.sparse import csr_array, vstack

from rfpsurvey._assignment.clock import count_program, left, now, stop

# Interval in seconds at which the caller checks for an interrupt while HiGHS runs in a different thread.
INTERVAL = 0.1
# Some steps of HiGHS do not end at the time limit of HiGHS. If a thread of HiGHS still runs this many seconds after the
# time limit, the thread is abandoned.
GRACE = 0.1
# Longest time in seconds for which the process waits for abandoned threads before it ends. The threads usually end
# within three seconds.
AT_EXIT = 15.0
# The reduced costs of HiGHS have errors of at most 1e-7. `with_errors` adds this error for each variable, and an error
# that is proportional to the bound.
ERROR_OF_ONE, ERROR = 1e-7, 1e-6
# Heuristics of HiGHS that are switched off. They search for better solutions in smaller programs, and take up to a
# third of the time. Programs whose root relaxation gives the optimum do not need these heuristics. For all other
# programs, local moves find better plans.
NOT_USED = ("rins", "rens", "root_reduced_cost")

# States of a program after which the bound of HiGHS is valid; versions of HiGHS differ in the names of interrupts.
ENDS = ("kOptimal", "kModelEmpty", "kTimeLimit", "kSolutionLimit", "kIterationLimit", "kInterrupt", "kHighsInterrupt")

_abandoned: list[threading.Thread] = []


def maximize(
    rows: tuple,
    goal: np.ndarray,
    most: np.ndarray,
    deadline: float,
    *,
    integral: bool,
    gap: float,
    presolve: bool = True,
    first: np.ndarray | None = None,
    nodes: int | None = None,
):
    """Return the variables that maximize a goal (a weighted sum of the variables), and an upper bound of the goal.

    The variables are None if no solution is found before the deadline. With presolve, HiGHS fails for some programs, or
    finds them infeasible, although they have solutions; these programs are solved again without presolve. If HiGHS
    fails again, there is neither a solution nor a bound.

    Parameters
    ----------
    rows : tuple
        Matrix of the constraints, and their lower and upper bounds.
    goal, most : ndarray of float, shape (n,)
        Coefficient and upper bound of each variable; the lower bound is 0.
    deadline : float
        Value of `now` at which the search ends.
    integral : bool
        Whether the variables must be whole numbers.
    gap : float
        Allowed relative error of the maximum.
    presolve : bool, optional
        Whether HiGHS may simplify the program first.
    first : ndarray of float, shape (n,), optional
        Values of the variables from which the search starts; the values satisfy the constraints.
    nodes : int, optional
        Largest number of nodes of the search tree. If this number ends the search, the result does not depend on the
        computer.
    """
    if left(deadline) == 0:
        return None, np.inf
    count_program()
    solver = _solver(rows, goal, most, integral=integral)
    solver.setOptionValue("time_limit", min(left(deadline), 1e9))
    solver.setOptionValue("mip_rel_gap", gap)
    solver.setOptionValue("presolve", "on" if presolve else "off")
    if nodes is not None:
        solver.setOptionValue("mip_max_nodes", nodes)
    if first is not None:
        solver.setSolution(len(first), np.arange(len(first), dtype=np.int32), first)
    if not _run(solver, deadline):
        return None, np.inf
    from highspy import HighsModelStatus as Status

    status, info = solver.getModelStatus(), solver.getInfo()
    if status not in [getattr(Status, name, None) for name in ENDS]:
        options = {"integral": integral, "gap": gap, "presolve": False, "first": first, "nodes": nodes}
        return maximize(rows, goal, most, deadline, **options) if presolve else (None, np.inf)
    has_solution = info.primal_solution_status == 2
    x = np.array(solver.getSolution().col_value) if has_solution else None
    if not integral:
        return (x, -info.objective_function_value) if status == Status.kOptimal else (None, np.inf)
    bound = -info.mip_dual_bound
    return None if x is None else np.round(x), bound if np.isfinite(bound) else np.inf


def sums_by_group(group: np.ndarray, n_groups: int, value: np.ndarray | float = 1.0) -> csr_array:
    """Return the matrix whose product with variables is the sum of those of each group, times ``value``."""
    n = len(group)
    return csr_array((np.broadcast_to(value, n), (group, np.arange(n))), shape=(n_groups, n))


def one_each(start: np.ndarray) -> csr_array:
    """Return the matrix whose product with candidates in use is their number for each positioner."""
    return sums_by_group(np.repeat(np.arange(len(start) - 1), np.diff(start)), len(start) - 1)


def choose_one_each(
    start: np.ndarray, weight: np.ndarray, sets: csr_array, most: np.ndarray, deadline: float, **limits
):
    """Return the variables of the plan with the largest weight, and an upper bound of the weight of any plan.

    A plan uses one candidate of each positioner, whose first candidates are ``start``, and at most the numbers ``most``
    of the candidates of each of the ``sets``, the rows of a matrix. The bound allows for rounding errors. ``limits``
    are parameters of `maximize`.
    """
    m, n = len(start) - 1, len(weight)
    low = np.append(np.ones(m), np.full(sets.shape[0], -np.inf))
    rows = vstack([one_each(start), sets], format="csr"), low, np.append(np.ones(m), most)
    x, bound = maximize(rows, weight, np.ones(n), deadline, integral=True, **limits)
    return x, with_errors(bound, n)


def with_errors(bound: float, n: int) -> float:
    """Return the bound of a program with n variables, increased by the largest possible rounding errors of HiGHS."""
    return bound + ERROR_OF_ONE * n + ERROR * (1.0 + abs(bound))


def _solver(rows, goal, most, *, integral):
    """Return a HiGHS solver that contains the program."""
    import highspy

    matrix, low, high = rows
    matrix = csr_array(matrix)
    program = highspy.HighsLp()
    program.num_col_, program.num_row_ = len(goal), matrix.shape[0]
    program.col_cost_, program.col_lower_, program.col_upper_ = -goal, np.zeros(len(goal)), most
    program.row_lower_, program.row_upper_ = low, high
    program.a_matrix_.format_ = highspy.MatrixFormat.kRowwise
    program.a_matrix_.num_col_, program.a_matrix_.num_row_ = len(goal), matrix.shape[0]
    # HiGHS only accepts 32-bit indices.
    program.a_matrix_.start_ = matrix.indptr.astype(np.int32)
    program.a_matrix_.index_ = matrix.indices.astype(np.int32)
    program.a_matrix_.value_ = matrix.data
    if integral:
        program.integrality_ = [highspy.HighsVarType.kInteger] * len(goal)
    solver = highspy.Highs()
    solver.setOptionValue("output_flag", False)
    for name in NOT_USED:
        solver.setOptionValue(f"mip_heuristic_run_{name}", False)
    solver.passModel(program)
    return solver


class LinearProgram:
    """A linear program with one goal after the other; each solution starts from the previous one.

    ``rows``, ``most`` and ``presolve`` are the parameters of `maximize`; all upper bounds of variables are finite.
    """

    def __init__(self, rows: tuple, most: np.ndarray, *, presolve: bool):
        self.rows, self.most, self.added, self.n_programs = rows, most, [], 0
        self.solver = _solver(rows, np.zeros(len(most)), most, integral=False)
        self.solver.setOptionValue("presolve", "on" if presolve else "off")

    def add(self, column: np.ndarray, value: np.ndarray, high: float) -> None:
        """Add the constraint that the sum of the values times the variables ``column`` is at most ``high``."""
        self.added.append((column, value, high))
        self.solver.addRow(-np.inf, high, len(column), column.astype(np.int32), value)

    def maximize(self, goal: np.ndarray, deadline: float) -> tuple[np.ndarray | None, float]:
        """Return the variables that maximize a goal (None if the solver does not end), and an upper bound of the goal.

        The bound is computed from the prices of the constraints, so that it is valid despite errors of the solver.
        """
        n, (matrix, low, high) = len(goal), self.rows
        if left(deadline) == 0:
            return None, np.inf
        from highspy import HighsModelStatus as Status

        self.n_programs += 1
        self.solver.changeColsCost(n, np.arange(n, dtype=np.int32), -goal)
        self.solver.setOptionValue("time_limit", min(self.solver.getRunTime() + left(deadline), 1e9))
        if not _run(self.solver, deadline) or self.solver.getModelStatus() != Status.kOptimal:
            return None, np.inf
        solution = self.solver.getSolution()
        price, of_added = np.split(-np.array(solution.row_dual), [len(high)])
        # a price of the wrong sign is a rounding error; the limits of a constraint without a price can be infinite
        price = np.where(np.isfinite(np.where(price > 0.0, high, low)), price, 0.0)
        of_added = np.maximum(of_added, 0.0)
        limit = np.where(price > 0.0, high, np.where(price < 0.0, low, 0.0))
        rest, bound = goal - matrix.T @ price, float(price @ limit)
        for p, (column, value, most) in zip(of_added, self.added, strict=True):
            rest[column] -= p * value
            bound += p * most
        return np.array(solution.col_value), bound + float(np.maximum(rest, 0.0) @ self.most)


def _run(solver, deadline: float) -> bool:
    """Run the solver in a thread, and return whether it ended in time."""
    thread = threading.Thread(target=solver.run, daemon=True, name="HiGHS")
    solver.HandleUserInterrupt = True
    try:
        thread.start()
        while thread.is_alive() and now() < deadline + GRACE and not stop.is_set():
            thread.join(min(max(deadline + GRACE - now(), 0.0), INTERVAL))
    finally:
        if thread.is_alive():
            _abandoned[:] = [thread for thread in _abandoned if thread.is_alive()] + [thread]
            solver.cancelSolve()
            thread.join(GRACE)
    return not thread.is_alive()


@atexit.register
def _wait_for_abandoned() -> None:
    """Wait until solver threads end, because the process would abort if a thread returned after Python has ended."""
    end = perf_counter() + AT_EXIT
    for thread in _abandoned:
        thread.join(max(end - perf_counter(), 0.0))
