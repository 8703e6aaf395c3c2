"""The build step that adds the catalog of ``rfpsurvey.example_catalog`` to the wheel; pyproject.toml refers to it."""

import bz2
import gzip
from pathlib import Path

from setuptools.command.build_py import build_py

DATA = Path(__file__).parent
EXAMPLES = ("tycho2_anticenter_r8.ecsv.gz",)


class BuildWithExamples(build_py):
    """Copy examples from ``data/``, compressed by bzip2, whose files are smaller than those of gzip by a sixth."""

    def run(self) -> None:
        """Run the build. An editable installation reads ``data/`` directly."""
        super().run()
        if not self.editable_mode:
            folder = Path(self.build_lib) / "rfpsurvey" / "catalog" / "examples"
            self.mkpath(str(folder))
            for name in EXAMPLES:
                content = gzip.decompress((DATA / name).read_bytes())
                (folder / name).with_suffix(".bz2").write_bytes(bz2.compress(content))
