import ast
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

BASE = "import astropy.coordinates, astropy.table, numba, scipy.spatial"
ON_USE = ("benchmark", "compare", "design", "plot", "probability", "report", "reproduction", "survey", "tiling")


def loaded(code):
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys\nprint(*sys.modules)"], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def test_import_brings_in_nothing_heavy():
    """What is not needed to plan a tile waits until it is."""
    extra = {name.split(".")[0] for name in loaded("import rfpsurvey") - loaded(BASE)}
    assert not extra & {"matplotlib", "typer", "rich", "pandas", "pyarrow", "shapely"}


def test_all_that_is_imported_is_declared():
    """Pillow and pyerfa came with other packages, and were not asked for."""
    root = Path(__file__).parent.parent
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    lists = [
        project["dependencies"],
        *(project["optional-dependencies"][name] for name in ("cuda", "distributed", "parquet")),
    ]
    declared = {re.match(r"[\w-]+", text)[0].lower().replace("_", "-") for names in lists for text in names}
    imported = set()
    for path in (root / "rfpsurvey").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module and not node.level else []
            imported |= {name.partition(".")[0] for name in names}
    found = packages_distributions()
    for name in (
        imported - sys.stdlib_module_names - {"rfpsurvey", "shapely"}
    ):  # shapely is compared with where it is there
        distributions = {d.lower().replace("_", "-") for d in found.get(name, [name])}
        assert distributions & declared, name


def test_import_costs_little(tmp_path):
    """At most 0.15 s of processor time after its dependencies are imported: the least of several fresh processes.

    Bytecode is kept in a folder of this test, since an environment may forbid Python to keep any, and then
    every process would compile all sources again.
    """
    code = f"{BASE}, time\nt = time.process_time()\nimport rfpsurvey\nprint(time.process_time() - t)"
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    environment["PYTHONPYCACHEPREFIX"] = str(tmp_path)
    seconds = []
    for _ in range(5):  # the first fills the folder
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
        seconds.append(float(done.stdout))
    assert min(seconds) < 0.15, seconds


def test_packages_that_a_plan_does_not_need_are_imported_on_use():
    assert not {f"rfpsurvey.{name}" for name in ON_USE} & loaded("import rfpsurvey")
    uses = "; ".join(f"rs.{name}" for name in ON_USE)
    assert {f"rfpsurvey.{name}" for name in ON_USE} <= loaded(f"import rfpsurvey as rs; {uses}")
    assert "rfpsurvey.plot" in loaded("from rfpsurvey import plot_coverage")


def test_unknown_names_are_refused():
    import rfpsurvey as rs

    with pytest.raises(AttributeError, match="'rfpsurvey' has no attribute 'plan_tiles'"):
        rs.plan_tiles  # noqa: B018


def test_the_public_names_are_there():
    import rfpsurvey as rs

    assert all(hasattr(rs, name) and name in dir(rs) for name in rs.__all__)
    assert rs.__version__[0].isdigit()
