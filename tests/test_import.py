import os
import subprocess
import sys

BASE = "import astropy.coordinates, astropy.table, numba, scipy.spatial"


def loaded(code):
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys\nprint(*sys.modules)"], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def test_import_brings_in_nothing_heavy():
    """What is not needed to plan a tile waits until it is."""
    extra = {name.split(".")[0] for name in loaded("import rfpsurvey") - loaded(BASE)}
    assert not extra & {"matplotlib", "typer", "rich", "pandas", "pyarrow", "shapely"}


def test_import_costs_little(tmp_path):
    """At most 0.15 s of processor time above its dependencies: the least of several fresh processes, side by side.

    Bytecode is kept in a folder of this test, since an environment may forbid Python to keep any, and then
    every process would compile all sources again.
    """
    code = "import time; t = time.process_time(); {}; print(time.process_time() - t)"
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    environment["PYTHONPYCACHEPREFIX"] = str(tmp_path)
    seconds = {"import rfpsurvey": [], BASE: []}
    for _ in range(6):  # the first of each fills the folder
        for statement, times in seconds.items():
            command = [sys.executable, "-c", code.format(statement)]
            done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
            times.append(float(done.stdout))
    assert min(seconds["import rfpsurvey"]) - min(seconds[BASE]) < 0.15


def test_the_public_names_are_there():
    import rfpsurvey as rs

    assert all(hasattr(rs, name) for name in rs.__all__)
    assert rs.__version__[0].isdigit()
