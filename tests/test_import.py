import ast
import re
import subprocess
import sys
import tomllib
from importlib import import_module
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

BASE = "import astropy.coordinates, astropy.table, numba, scipy"
ON_USE = ("benchmark", "compare", "design", "plot", "probability", "report", "survey", "tiling")


PLAN = """
import astropy.units as u, rfpsurvey as rs
rs.plan_tile(rs.synthetic_catalog("uniform", "95 23", .2 * u.deg, n_targets=50, rng=1), "moons")
"""
# an empty step removes the modules of rfpsurvey again
STEPS = """
import sys
def loaded(step):
    if not step:
        for name in [name for name in sys.modules if name.partition(".")[0] == "rfpsurvey"]:
            del sys.modules[name]
    exec(step, {})
    return sorted(sys.modules)
sys.stdout.write(repr([loaded(step) for step in sys.argv[1:]]))
"""


@pytest.fixture(scope="module")
def stages():
    """Return the modules that the dependencies, the package, a plan, the whole package, and `plot` alone import."""
    use = "import rfpsurvey as rs; " + "; ".join(f"rs.{name}" for name in ON_USE)
    steps = (BASE, "import rfpsurvey.tile", PLAN, use, "", "from rfpsurvey import plot")
    done = subprocess.run([sys.executable, "-c", STEPS, *steps], capture_output=True, text=True, check=True)
    before, after, planned, used, _, plot = (set(names) for names in ast.literal_eval(done.stdout))
    return before, after, planned, used, plot


def test_import_brings_in_nothing_heavy(stages):
    """Modules that planning a tile does not require are imported later."""
    before, after, _, used, _ = stages
    extra = {name.split(".")[0] for name in after - before}
    assert "rfpsurvey" in extra
    assert "jinja2" not in used  # not imported before a report is written
    assert not extra & {"matplotlib", "typer", "rich", "pandas", "pyarrow", "shapely"}


def test_all_that_is_imported_is_declared():
    """Regression: Pillow and pyerfa were used, but not declared as dependencies."""
    root = Path(__file__).parent.parent
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    optional = [project["optional-dependencies"][name] for name in ("cuda", "distributed", "parquet", "regions")]
    lists = [project["dependencies"], *optional]
    declared = {re.match(r"[\w-]+", text)[0].lower().replace("_", "-") for names in lists for text in names}
    imported = set()
    for path in (root / "rfpsurvey").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module and not node.level else []
            imported |= {name.partition(".")[0] for name in names}
    found = packages_distributions()
    # shapely is used for comparisons if it is installed
    for name in imported - sys.stdlib_module_names - {"rfpsurvey", "shapely"}:
        assert {d.lower().replace("_", "-") for d in found.get(name, [name])} & declared, name


IMPORTS = f"""
{BASE}, scipy.spatial, os, time
numba.njit(lambda number: number)  # the first function takes numba 8 ms, which any package that uses it would spend
others = "asyncio unittest.mock xml.dom.minidom http.server sqlite3 multiprocessing.managers email.mime.text ftplib"
for _ in range(5):  # the first fills the folder
    if not os.fork():
        begin = time.process_time()
        for name in (others + " tarfile imaplib smtplib xmlrpc.server logging.config doctest").split():
            __import__(name)
        end = time.process_time()
        import rfpsurvey.tile
        print(end - begin, time.process_time() - end, flush=True)
        os._exit(0)
    os.wait()
"""


def test_import_costs_little(tmp_path):
    """After its dependencies, the package is imported in at most three times the processor time of some modules of
    Python, which is two times on an idle machine. On a busy machine, both times are longer.

    The test compares the smallest of several times, and writes bytecode to its own folder. If the environment forbids
    bytecode, each process would otherwise compile all sources again.
    """
    keep = f"import sys; sys.pycache_prefix = {str(tmp_path)!r}; sys.dont_write_bytecode = False\n"
    code = IMPORTS.replace("for _", keep + "for _", 1)
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, check=True)
    seconds = [[float(word) for word in line.split()] for line in done.stdout.splitlines()]
    assert len(seconds) == 5
    others, package = (min(times) for times in zip(*seconds, strict=True))
    assert package < 3 * others, seconds


def test_packages_that_a_plan_does_not_need_are_imported_on_use(stages):
    _, before, planned, after, plot = stages
    names = {f"rfpsurvey.{name}" for name in ON_USE}
    assert not names & before
    unused = {"matplotlib", "pandas", "pyarrow", "rfpsurvey._assignment.milp"}
    assert not planned & {*unused, "rfpsurvey.plot", "rfpsurvey._survey", "rfpsurvey.report"}
    assert names <= after
    assert "rfpsurvey.plot" in plot


@pytest.mark.parametrize("name", ["rfpsurvey", "rfpsurvey.report"])
def test_type_checkers_see_the_names_that_are_imported_on_use(name):
    package = import_module(name)
    nodes = [node for node in ast.parse(Path(package.__file__).read_text()).body if isinstance(node, ast.If)]
    (block,) = [node for node in nodes if ast.unparse(node.test) == "TYPE_CHECKING"]
    assert all(isinstance(node, ast.ImportFrom) for node in block.body)
    seen = {node.module.removeprefix(name).lstrip("."): {a.name for a in node.names} for node in block.body}
    on_use = package._IMPORTED_ON_USE
    assert seen.pop("", set(on_use)) == set(on_use)
    assert seen == {module: set(names) for module, names in on_use.items() if names}
    assert all(hasattr(package, one) for names in on_use.values() for one in names)


def test_unknown_names_are_refused():
    with pytest.raises(AttributeError, match="'rfpsurvey' has no attribute 'plan_tiles'"):
        import_module("rfpsurvey").plan_tiles  # noqa: B018


@pytest.mark.parametrize("path", sorted(Path(__file__).parent.parent.glob("rfpsurvey/*/__init__.py")))
def test_packages_have_all_names_of_their_lists(path):
    package = import_module(f"rfpsurvey.{path.parent.name}")
    assert all(hasattr(package, name) for name in getattr(package, "__all__", ()))


def test_the_public_names_are_there_and_are_offered():
    """Completion offers functions, classes and public subpackages, but no private modules."""
    import rfpsurvey as rs

    offered, names = dir(rs), {}
    exec("from rfpsurvey import *", names)
    assert set(rs.__all__) <= {*offered} & {*names}
    assert all(hasattr(rs, name) for name in offered)
    assert rs.__version__[0].isdigit()
    assert not {"tile", "survey", "report", "catalog", "instrument", "annotations"} & set(offered)
    assert {"plan_tile", "Tile", "plan_survey", "plot", "design", "tiling"} <= set(offered)
