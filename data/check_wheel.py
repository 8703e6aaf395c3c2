"""Check that the wheel contains only expected files and is small; tox builds it, and sets ``TOX_PACKAGE`` to its path.

The wheel must be small, so that the installation is quick, and must contain no file by accident, such as test data or
cached kernels. Each file must therefore be Python code or match one of the other patterns. The limits of the sizes are
about 30 % above the present sizes. If planned additions exceed a limit, increase this limit.
"""

import os
import sys
from fnmatch import fnmatch
from pathlib import Path
from zipfile import ZipFile

LIMIT = 1_600_000  # bytes
MOST_CODE = 10_000  # bytes of one compressed file of code or of a description
LARGEST = {
    "rfpsurvey/*.py": MOST_CODE,
    "rfpsurvey/py.typed": MOST_CODE,
    "rfpsurvey/presets/*.toml": MOST_CODE,
    "rfpsurvey/report/page.*": MOST_CODE,
    "rfpsurvey/report/scripts/*": MOST_CODE,
    "rfpsurvey/_sky/*.packed": 150_000,
    "rfpsurvey/_studies/surrogate.npz": 20_000,
    "rfpsurvey-*.dist-info/*": 25_000,
}
"""Largest compressed size in bytes of the files that match each pattern."""


def problems_of(wheel: Path) -> list[str]:
    """Return a sentence for each unexpected or too large file of a wheel, and for the whole wheel."""
    found, size = [], wheel.stat().st_size
    if size >= LIMIT:
        found.append(f"the wheel must be smaller than {LIMIT} bytes, but has {size} bytes")
    with ZipFile(wheel) as content:
        for file in content.infolist():
            name = file.filename
            largest = next((most for pattern, most in LARGEST.items() if fnmatch(name, pattern)), None)
            if largest is None:
                found.append(f"the wheel must not contain {name}, which matches no pattern in data/check_wheel.py")
            elif file.compress_size > largest:
                found.append(f"{name} must have at most {largest} bytes in the wheel, but has {file.compress_size}")
    return found


if __name__ == "__main__":
    path = Path(os.environ["TOX_PACKAGE"])
    if problems := problems_of(path):
        sys.exit("\n".join(problems))
    print(f"the wheel has {path.stat().st_size} bytes")
