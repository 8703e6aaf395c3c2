"""The build step that puts the catalog of ``rfpsurvey.example_catalog`` into the wheel; pyproject.toml names it."""

import bz2
import gzip
from pathlib import Path

from setuptools.command.build_py import build_py

DATA = Path(__file__).parent
EXAMPLES = ("tycho2_anticenter_r8.ecsv.gz",)


class BuildWithExamples(build_py):
    """Copy examples from ``data/``, compressed by bzip2, which makes them smaller by a sixth than gzip does."""

    def run(self) -> None:
        """Build; an editable installation reads ``data/`` itself."""
        super().run()
        if not self.editable_mode:
            folder = Path(self.build_lib) / "rfpsurvey" / "catalog" / "examples"
            self.mkpath(str(folder))
            for name in EXAMPLES:
                content = gzip.decompress((DATA / name).read_bytes())
                (folder / name).with_suffix(".bz2").write_bytes(bz2.compress(content))
