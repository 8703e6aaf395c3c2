"""Put the catalog of ``rfpsurvey.example_catalog`` into the wheel; all else is in pyproject.toml."""

import bz2
import gzip
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

DATA = Path(__file__).parent / "data"
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


if __name__ == "__main__":
    setup(cmdclass={"build_py": BuildWithExamples})
