"""Sphinx configuration: astropy's, without anything that needs the network."""

import subprocess
import sys
from importlib.metadata import version as installed_version
from pathlib import Path

from sphinx_astropy.conf.v3 import *

project = "rfpsurvey"
author = "The rfpsurvey developers"
copyright = f"2026, {author}"
release = installed_version("rfpsurvey")
version = release.split("+")[0]

extensions += ["matplotlib.sphinxext.plot_directive"]
if "sphinx.ext.intersphinx" in extensions:
    extensions.remove("sphinx.ext.intersphinx")
exclude_patterns = ["_build", "api/*.txt", "examples"]
html_title = f"rfpsurvey {version}"
html_static_path = []
nitpicky = True
autodoc_typehints = "none"
numpydoc_xref_param_type = False
automodapi_inheritance_diagram = False
plot_formats = [("png", 120)]
plot_html_show_formats = False
plot_html_show_source_link = False
plot_include_source = True
# names of other packages, which only the network could resolve
nitpick_ignore_regex = [
    ("py:.*", r"(astropy|numpy|scipy|matplotlib|typer|click)\..*"),
    ("py:.*", r"(SkyCoord|Quantity|QTable|Table|Time)"),
]


def write_help(app):
    """Keep what commands print, for pages to include."""
    folder = Path(app.srcdir) / "api"
    folder.mkdir(exist_ok=True)
    commands = (
        "plan", "compare", "compare-allocators", "score", "tile", "survey", "probability", "reproduce", "instruments",
        "benchmark",
        "benchmark collisions", "benchmark batches", "benchmark probability",
    )  # fmt: skip
    calls = {f"help_{c.replace(' ', '_').replace('-', '_')}": [*c.split(), "--help"] for c in commands}
    for name, arguments in {**calls, "instruments": ["instruments"]}.items():
        call = [sys.executable, "-m", "rfpsurvey", *arguments]
        text = subprocess.run(call, capture_output=True, text=True, check=True).stdout
        (folder / f"{name}.txt").write_text(text)


def setup(app):
    """Connect to Sphinx."""
    app.connect("builder-inited", write_help)
