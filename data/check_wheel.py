"""Check that the wheel is smaller than 1 MB; run it as ``python data/check_wheel.py``."""

import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
LIMIT = 1_000_000  # bytes

with tempfile.TemporaryDirectory() as folder:
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, str(ROOT)]
    subprocess.run(command, check=True)
    [wheel] = Path(folder).glob("*.whl")
    size = wheel.stat().st_size
if size >= LIMIT:
    sys.exit(f"the wheel must be smaller than {LIMIT} bytes, but has {size} bytes")
print(f"the wheel has {size} bytes")
