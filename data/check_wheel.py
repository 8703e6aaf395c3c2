"""Check that the wheel is smaller than 1.05 MB; tox builds the wheel, and sets ``TOX_PACKAGE`` to its path."""

import os
import sys
from pathlib import Path

LIMIT = 1_050_000  # bytes

size = Path(os.environ["TOX_PACKAGE"]).stat().st_size
if size >= LIMIT:
    sys.exit(f"the wheel must be smaller than {LIMIT} bytes, but has {size} bytes")
print(f"the wheel has {size} bytes")
