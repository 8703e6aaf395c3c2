"""Rules that hold for every file of the package."""

import ast
from collections import defaultdict
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "rfpsurvey"
FILES = sorted(path for path in PACKAGE.rglob("*.py") if path.name != "_version.py")
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
# Of numba, the interpreter and astropy; and of named tuples.
FOREIGN = {"_repr_html_", "_cache", "_cache_file", "_exit", "_construct_mixins_from_columns", "_replace", "_asdict"}
MOST_LINES, MOST_PARAMETERS = 400, 14


def package_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def nodes_of(path):
    return ast.walk(ast.parse(path.read_text()))


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


def test_no_package_imports_private_modules_of_another():
    found = []
    for path in FILES:
        for node in nodes_of(path):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("rfpsurvey."):
                parts = node.module.split(".")
                if len(parts) > 2 and private(parts[2]) and parts[1] != package_of(path):
                    found.append(f"{path.name}:{node.lineno} {node.module}")
                names = [alias.name for alias in node.names if private(alias.name) and parts[1] != package_of(path)]
                found += [f"{path.name}:{node.lineno} {name}" for name in names]
    assert not found


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_files_are_small(path):
    assert len(path.read_text().splitlines()) <= MOST_LINES


def test_public_functions_have_few_parameters():
    """All but the first three are passed by name; commands and kernels are exempt."""
    long = []
    for path in FILES:
        if package_of(path) in ("_cli", "_kernels", "_readers"):
            continue
        for node in nodes_of(path):
            if isinstance(node, FUNCTIONS) and not private(node.name):
                both = [*node.args.posonlyargs, *node.args.args]
                if len(both) + len(node.args.kwonlyargs) > MOST_PARAMETERS:
                    long.append(f"{path.name}:{node.lineno} {node.name}")
    assert not long
