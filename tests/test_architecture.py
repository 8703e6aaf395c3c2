"""Rules for all files of the package and of the tests."""

import ast
import importlib.util
import re
from collections import defaultdict
from functools import cache
from pathlib import Path

import pytest

from rfpsurvey import allocation, collision, probability, tiling
from rfpsurvey._field.plan_files import FORMATS

ROOT = Path(__file__).parent.parent
PACKAGE, TESTS = ROOT / "rfpsurvey", ROOT / "tests"
FILES = sorted(path for path in PACKAGE.rglob("*.py") if path.name != "_version.py")
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
# names of numba, Python and astropy, and methods of named tuples
FOREIGN = {"_repr_html_", "_cache", "_cache_file", "_exit", "_construct_mixins_from_columns", "_replace", "_asdict"}
FOREIGN |= {"_load_index", "_data_path"}
MOST_LINES, MOST_PARAMETERS = 400, 14


def package_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@cache
def nodes_of(path):
    return list(ast.walk(ast.parse(path.read_text())))


def private(name):
    return name.startswith("_") and not name.startswith("__")


def test_no_package_reaches_for_private_members_of_another():
    home = defaultdict(set)
    for path in FILES:
        for node in nodes_of(path):
            if isinstance(node, (*FUNCTIONS, ast.ClassDef)):
                home[node.name].add(package_of(path))
            elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
                home[node.attr].add(package_of(path))
    found = []
    for path in FILES:
        for node in nodes_of(path):
            if not (isinstance(node, ast.Attribute) and private(node.attr)) or node.attr in FOREIGN:
                continue
            own = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
            if not own and package_of(path) not in home[node.attr]:
                found.append(f"{path.name}:{node.lineno} {node.attr}")
    assert not found


def imports_of(path):
    """Return the modules, the names and the line numbers of the imports from rfpsurvey."""
    for node in nodes_of(path):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "rfpsurvey":
            yield node.module.split("."), [alias.name for alias in node.names], f"{path.name}:{node.lineno}"


def test_no_module_imports_private_names_of_another():
    """Modules of the same package may have private names, such as those of ``plot``."""
    found = []
    for path in FILES:
        for module, names, line in imports_of(path):
            modules = {file.stem for file in PACKAGE.joinpath(*module[1:]).glob("*")}
            inner = [*module[2:], *names] if module[1:2] != [package_of(path)] else {*names} - modules
            found += [f"{line} {name}" for name in inner if private(name)]
    assert not found


def test_public_modules_contain_imports_only_and_are_not_imported():
    public = [path for path in PACKAGE.glob("[a-z]*.py") if path.stem != "errors"]
    assert len(public) > 15
    for path in public:
        kinds = [type(node) for node in ast.parse(path.read_text()).body]
        assert kinds == [ast.Expr, *[ast.ImportFrom] * (len(kinds) - 2), ast.Assign], path.name
    stems = {path.stem for path in public}
    found = [
        f"{line} {names}"
        for path in {*FILES} - {*public, PACKAGE / "__init__.py"}
        for module, names, line in imports_of(path)
        if stems.intersection(module[1:2] or names)
    ]
    assert not found


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_files_are_small(path):
    assert len(path.read_text().splitlines()) <= MOST_LINES


def test_public_functions_have_few_parameters():
    """All parameters except the first three are passed by name. Commands and kernels are exempt."""
    long = []
    for path in FILES:
        if package_of(path) in ("_cli", "_kernels", "_common"):
            continue
        for node in nodes_of(path):
            if isinstance(node, FUNCTIONS) and not private(node.name):
                both = [*node.args.posonlyargs, *node.args.args]
                if len(both) + len(node.args.kwonlyargs) > MOST_PARAMETERS:
                    long.append(f"{path.name}:{node.lineno} {node.name}")
    assert not long


def test_folders_of_tests_are_those_of_the_package():
    packages = {path.stem.removeprefix("_") for path in PACKAGE.glob("*")}
    folders = {path.parent.name for path in TESTS.glob("*/test_*.py")}
    assert folders - packages == {"benchmarks", "cuda", "figures", "readers", "reproduction"}


TABLES = (allocation.METHODS, collision.METHODS, probability.METHODS, tiling.METHODS)


@pytest.mark.parametrize("names", [{name for table in TABLES for name in table} - {"given"}, FORMATS])
def test_names_of_methods_and_of_formats_of_plans_are_not_compared(names):
    """Other code asks for properties of records and of modules; ``given`` is also the name of a kind of targets."""
    compared = []
    for path in FILES:
        for node in nodes_of(path):
            parts = [node.left, *node.comparators] if isinstance(node, ast.Compare) else []
            texts = [one.value for part in parts for one in ast.walk(part) if isinstance(one, ast.Constant)]
            compared += [
                f"{path.name}:{node.lineno} {text}" for text in texts if isinstance(text, str) and text in names
            ]
    assert not compared


def test_paths_in_the_configuration_of_tox_exist():
    """A test or script under an old name would be missing from an environment."""
    paths = re.findall(r"(?<![\w/])(?:tests|docs|rfpsurvey)/[\w./*-]*[\w*]", (ROOT / "tox.ini").read_text())
    assert len(paths) > 15
    assert not [path for path in paths if not list(ROOT.glob(path))]


def test_tests_and_scripts_that_pages_and_docstrings_name_exist():
    texts = {path: path.read_text() for path in (*FILES, *ROOT.glob("*.rst"), *ROOT.glob("docs/*.rst"))}
    others = (*TESTS.rglob("*.py"), *ROOT.glob(".ci/*"), ROOT / "pyproject.toml")
    texts |= {path: path.read_text() for path in others if path.is_file()}
    found = {
        (path.name, name)
        for path, text in texts.items()
        for name in re.findall(r"(?<![\w/])(?:tests|\.ci)/[\w./-]*\w", text)
    }
    assert len(found) > 50
    assert not sorted((page, name) for page, name in found if not (ROOT / name).exists())
    table = re.findall(r"^``([\w/]*test_\w+\.py)``:", texts[ROOT / "docs" / "testing.rst"], re.MULTILINE)
    assert len(table) > 10
    assert not [name for name in table if not (TESTS / name).exists()]


def test_mutants_are_run_against_tests_that_exist():
    spec = importlib.util.spec_from_file_location("mutants", ROOT / ".ci" / "mutants.py")
    mutants = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(mutants)
    for pattern, tests in mutants.TESTS.items():
        assert list(ROOT.glob(pattern)), pattern
        assert all((ROOT / mutants.path_of(test)).exists() for test in tests.split()), pattern
