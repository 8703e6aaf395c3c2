"""Change the code in one place at a time, and test whether the tests fail: ``python .ci/mutants.py --number 50``.

A mutant is one small change of the code: a different comparison, a difference instead of a sum, a different number, a
condition that is always true or always false, or a statement that is removed. A seed determines a random selection of
mutants. For each of them, the tests that ``TESTS`` lists for its file run in a copy of the source tree. A mutant that
exceeds the limit of processor time counts as killed. Mutants that survive must be inspected; the last result is
in ``docs/testing.rst``.
"""

import argparse
import ast
import copy
import fnmatch
import hashlib
import importlib
import os
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numba
import pytest

ROOT = Path(__file__).parents[1]
COLLISION = (
    "collision/count collision/find collision/methods collision/arms collision/exact_arithmetic regressions "
    "input_validation"
)
ALLOCATION = (
    "allocation/idle allocation/local_moves constraints/requirements allocation/repair allocation/sky "
    "allocation/allocate allocation/methods allocation/records allocation/quotas allocation/random_quotas regressions "
    "input_validation allocation/search allocation/optimal"
)
CONSTRAINTS = (
    "constraints/constraints constraints/guide_stars constraints/requirements constraints/columns "
    "constraints/keep_out constraints/user_constraint constraints/user_counts constraints/verdicts_and_fibers "
    "constraints/idle_fibers constraints/rules constraints/design_modes constraints/distribution constraints/motion "
    "input_validation"
)
PROBABILITY = (
    "probability/closed_form probability/intervals probability/targets probability/quadrature probability/hard_cases "
    "probability/collision_probability probability/surrogate probability/one_sky input_validation"
)
COUNTS = "collision/count probability/targets probability/hard_cases probability/collision_probability"


def files(package, names):
    """Return the paths of some modules of a package."""
    return [f"rfpsurvey/{package}/{name}.py" for name in names.split()]


TESTS = {
    "rfpsurvey/_assignment/plugin.py": "allocation/allocator_plugins plugins " + ALLOCATION,
    "rfpsurvey/_assignment/constraints/*": CONSTRAINTS,
    "rfpsurvey/_assignment/before_and_after.py": "tile/late_targets allocation/preselect " + ALLOCATION,
    **dict.fromkeys(files("_assignment", "distribution spread"), "constraints/distribution constraints/requirements"),
    "rfpsurvey/_assignment/allocate.py": "allocation/uses allocation/subpriority " + ALLOCATION,
    "rfpsurvey/_assignment/allocation.py": "allocation/reasons " + ALLOCATION,
    "rfpsurvey/_assignment/rules.py": "constraints/columns " + ALLOCATION,
    "rfpsurvey/_assignment/weighted.py": "allocation/row_prices " + ALLOCATION,
    **dict.fromkeys(files("_assignment", "local_plans local_search"), "allocation/ejection " + ALLOCATION),
    "rfpsurvey/_assignment/*": ALLOCATION,
    "rfpsurvey/_studies/run.py": "compare/instruments " + PROBABILITY,
    "rfpsurvey/_studies/methods.py": "probability/method_plugins plugins " + PROBABILITY,
    **dict.fromkeys(
        files("_studies", "collision_probability intervals question quadrature simulate targets surrogate"), PROBABILITY
    ),
    **dict.fromkeys(files("_instruments", "arms count_collisions"), COLLISION),
    "rfpsurvey/_instruments/collision_methods.py": COLLISION + " collision/obstacle_polygons benchmark/benchmark",
    "rfpsurvey/_instruments/find_collisions.py": COLLISION + " allocation/repair",
    **dict.fromkeys(
        files("_instruments", "find_paths paths path_arms") + files("_kernels", "joint_motion path_search path_steps"),
        "collision/joint_motion collision/paths",
    ),
    **dict.fromkeys(
        files("_instruments", "motion moves"),
        "collision/motion constraints/motion allocation/motion instrument/joint_motion",
    ),
    "rfpsurvey/_instruments/compare_projections.py": "observing/models",
    **dict.fromkeys(
        files("_sky", "conditions observed_field observed_plane"),
        "observing/observing observing/wrong_conditions observing/models settings",
    ),
    "rfpsurvey/_sky/distortion_map.py": "projection/distortion_map",
    "rfpsurvey/_survey/selection/*": (
        "selection/bits selection/work selection/potential selection/replay selection/failures selection/run "
        "selection/alternate"
    ),
    "rfpsurvey/_kernels/allocation.py": "collision/count probability/targets allocation/preselect " + ALLOCATION,
    "rfpsurvey/_kernels/arms.py": (
        "positioner/positioner focal_plane/focal_plane focal_plane/coverage allocation/sky allocation/allocate "
        + COLLISION
        + " probability/quadrature probability/collision_probability"
    ),
    "rfpsurvey/_kernels/batch.py": (
        "allocation/subpriority collision/methods collision/exact_arithmetic selection/work selection/replay "
        "selection/enumeration " + COUNTS
    ),
    "rfpsurvey/_kernels/collisions.py": COLLISION + " allocation/repair probability/quadrature",
    "rfpsurvey/_kernels/conflicts.py": (
        "allocation/search allocation/optimal allocation/repair allocation/sky allocation/quotas "
        "allocation/random_quotas"
    ),
    "rfpsurvey/_kernels/queues.py": (
        "probability/closed_form probability/targets probability/quadrature probability/collision_probability"
    ),
    "rfpsurvey/_kernels/repair.py": (
        "allocation/local_moves allocation/repair allocation/quotas allocation/random_quotas allocation/sky "
        "allocation/allocate"
    ),
    "rfpsurvey/_kernels/simulate.py": COUNTS.partition(" ")[2],
}
# These modules, which rfpsurvey and its tests import, are imported only once, not for each mutant.
IMPORTS = "astropy.coordinates astropy.table matplotlib.figure scipy.optimize scipy.spatial scipy.stats shapely"
EXCEPT = ("*/__init__.py", "rfpsurvey/_instruments/gpu.py")

COMPARISONS = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
OPERATORS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Pow: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
CALLS = {"min": "max", "max": "min", "any": "all", "all": "any", "minimum": "maximum", "maximum": "minimum"}
NOT_CODE = {"annotation", "returns", "decorator_list"}
DROPPED = (ast.AugAssign, ast.Raise, ast.Continue, ast.Break)


def changed(node, **fields):
    """Return a copy of a node with other values of some fields."""
    new = copy.deepcopy(node)
    for name, value in fields.items():
        setattr(new, name, value)
    return new


def alternatives(node, parent):
    """Yield the nodes that replace a node."""
    match node:
        case ast.Compare():
            for k, operator in enumerate(node.ops):
                for other in COMPARISONS[type(operator)]:
                    yield changed(node, ops=[*node.ops[:k], other(), *node.ops[k + 1 :]])
        case ast.BinOp() | ast.BoolOp() | ast.AugAssign() if type(node.op) in OPERATORS:
            yield changed(node, op=OPERATORS[type(node.op)]())
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            yield node.operand
        case ast.Constant(value=bool(value)):
            yield ast.Constant(not value)
        case ast.Constant(value=int(value) | float(value)) if not isinstance(parent, ast.UnaryOp):
            yield ast.Constant(value + 1)
        case ast.Call(func=ast.Name(id=name)) if name in CALLS:
            yield changed(node, func=ast.Name(CALLS[name]))
        case ast.Call(func=ast.Attribute(attr=name)) if name in CALLS:
            yield changed(node, func=changed(node.func, attr=CALLS[name]))
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            pass
        case ast.If() | ast.IfExp():
            yield from (changed(node, test=ast.Constant(value)) for value in (True, False))
    stored = isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Subscript | ast.Attribute)
    called = isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
    if isinstance(node, DROPPED) or stored or called:
        yield ast.Pass()


def mutants(path):
    """Return the mutants of a file: line, old code, new code, source of the whole file."""
    tree, found = ast.parse(path.read_text()), []

    def visit(parent):
        for name, value in ast.iter_fields(parent):
            if name in NOT_CODE:
                continue
            items = value if isinstance(value, list) else [value]
            for k, node in enumerate(items):
                if not isinstance(node, ast.AST) or isinstance(node, ast.JoinedStr):
                    continue
                for new in alternatives(node, parent):
                    setattr(parent, name, [*items[:k], new, *items[k + 1 :]] if isinstance(value, list) else new)
                    found.append((node.lineno, brief(node), brief(new), ast.unparse(tree)))
                    setattr(parent, name, value)
                if not isinstance(node, ast.Raise):  # error messages are tested in a different way
                    visit(node)

    visit(tree)
    return found


def brief(node):
    text = " ".join(ast.unparse(ast.fix_missing_locations(node)).split())
    return text if len(text) <= 70 else text[:67] + "..."


def draw(pool, number, seed):
    """Select mutants by a hash of their change, so that edits of other lines do not change the selection."""
    met = Counter()

    def key(mutant):
        name, _, old, new, _ = mutant
        met[name, old, new] += 1
        return hashlib.sha256(f"{seed} {name} {old} {new} {met[name, old, new]}".encode()).digest()

    return sorted(pool, key=key)[:number]


def tests_of(name):
    """Return the test files of a source file, or None if its code is not changed."""
    if any(fnmatch.fnmatch(name, pattern) for pattern in EXCEPT):
        return None
    named = next((tests for pattern, tests in TESTS.items() if fnmatch.fnmatch(name, pattern)), None)
    return named and [path_of(test) for test in dict.fromkeys(named.split())]


def path_of(test):
    """Return the path of a test file, for a name in ``TESTS`` (a folder in ``tests`` and the subject of the test)."""
    folder, slash, name = test.rpartition("/")
    return f"tests/{folder}{slash}test_{name}.py"


def survives(folder, tests, seconds, cache):
    """Return whether all tests pass in the copy; they run in a child process with a limit of processor time."""
    child = os.fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        with (folder.parent / "output").open("w") as output:
            os.dup2(output.fileno(), 1)
            os.dup2(output.fileno(), 2)
        os.environ.update(PYTHONPATH=str(folder), MPLBACKEND="agg")
        numba.config.CACHE_DIR = str(folder.parent / cache)
        sys.path[:0] = [str(folder)]
        os.chdir(folder)
        code = 1
        try:
            code = pytest.main(["-x", "-q", "--no-header", "-p", "no:xdist", *tests])
        finally:
            sys.stdout.flush()
            os._exit(int(code))
    return os.waitpid(child, 0)[1] == 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--number", type=int, default=180, help="how many mutants to draw")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="*", help="pattern of files, such as 'rfpsurvey/_kernels/*'")
    parser.add_argument("--seconds", type=int, default=150, help="processor time of a mutant")
    parser.add_argument("--part", default="1/1", help="run a part of the drawn mutants, such as 1/2")
    options = parser.parse_args()
    for module in IMPORTS.split():
        importlib.import_module(module)
    files = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "rfpsurvey").rglob("*.py"))
    pool = [
        (name, *mutant)
        for name in files
        if tests_of(name) and fnmatch.fnmatch(name, options.only)
        for mutant in mutants(ROOT / name)
    ]
    drawn = draw(pool, options.number, options.seed)
    part, parts = map(int, options.part.split("/"))
    drawn = drawn[part - 1 :: parts]
    print(f"{len(drawn)} of {len(pool)} mutants, seed {options.seed}")
    n_killed = 0
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "tree"
        ignored = shutil.ignore_patterns(".*", "__pycache__", "_build", "*.egg-info")
        shutil.copytree(ROOT, folder, ignore=ignored)
        everything = sorted({test for mutant in drawn for test in tests_of(mutant[0])})
        if not survives(folder, everything, 1200, "cache"):
            sys.exit("the tests fail without a mutant:\n" + (Path(scratch) / "output").read_text())
        for name, line, old, new, source in drawn:
            start = time.monotonic()
            text = (folder / name).read_text()
            (folder / name).write_text(source)
            # kernels compiled from a mutant must not be used again
            cache = "mutant" if "_kernels" in name else "cache"
            alive = survives(folder, tests_of(name), options.seconds, cache)
            (folder / name).write_text(text)
            n_killed += not alive
            label = "SURVIVED" if alive else "killed"
            print(f"{label:8} {time.monotonic() - start:4.0f} s  {name}:{line}  {old}  ->  {new}", flush=True)
    print(f"{n_killed} of {len(drawn)} killed, {100 * n_killed / max(len(drawn), 1):.1f} %")


if __name__ == "__main__":
    main()
