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


def test_import_costs_little():
    """At most 0.15 s of processor time above its dependencies: the least of several fresh processes, side by side."""
    code = "import time; t = time.process_time(); {}; print(time.process_time() - t)"
    seconds = {"import rfpsurvey": [], BASE: []}
    for _ in range(5):
        for statement, times in seconds.items():
            done = subprocess.run(
                [sys.executable, "-c", code.format(statement)], capture_output=True, text=True, check=True
            )
            times.append(float(done.stdout))
    assert min(seconds["import rfpsurvey"]) - min(seconds[BASE]) < 0.15


def test_the_public_names_are_there():
    import rfpsurvey as rs

    assert all(hasattr(rs, name) for name in rs.__all__)
    assert rs.__version__[0].isdigit()
