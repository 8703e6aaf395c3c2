"""Sphinx configuration, based on that of astropy; the documentation can be built and read without a network."""

import sys
from importlib.metadata import version as installed_version
from pathlib import Path

from sphinx_astropy.conf.v3 import *
from typer.testing import CliRunner

from rfpsurvey._cli.application import app as command_line

sys.path.insert(0, str(Path(__file__).parent))
from inventories import linked_types, write_inventories
from planner_tables import write_tables

project = "rfpsurvey"
author = "The rfpsurvey developers"
copyright = f"2026, {author}"
release = installed_version("rfpsurvey")
version = release.split("+")[0]

# extensions that load scripts from the network, or that are not used
for name in ("sphinx.ext.mathjax", "sphinx.ext.inheritance_diagram"):
    if name in extensions:
        extensions.remove(name)
extensions += ["mathml", "matplotlib.sphinxext.plot_directive", "sphinx_design", "sphinx_gallery.gen_gallery"]
exclude_patterns = ["_build", "api/*.txt", "examples", "**sg_execution_times.rst"]
templates_path = ["_templates"]
html_theme = "pydata_sphinx_theme"
html_theme_options = {"navbar_center": [], "navbar_end": ["theme-switcher"], "show_nav_level": 1}
html_sidebars = {"**": ["contents.html"]}
html_math_renderer = "mathml"
math_eqref_format = "Eq. {number}"
html_favicon = None
html_title = f"rfpsurvey {version}"
html_static_path = ["_static"]
html_css_files = ["style.css"]
html_js_files = ["enlarge.js"]
nitpicky = True
autodoc_typehints = "none"
numpydoc_xref_param_type = True
numpydoc_xref_ignore = "all"
numpydoc_xref_aliases = linked_types()
plot_formats = [("png", 120)]
plot_html_show_formats = False
plot_html_show_source_link = False
plot_include_source = True
sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"/plot_",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "capture_repr": (),
    "default_thumb_file": str(Path(__file__).parent / "gallery/images/sphx_glr_plot_8_survey_001.png"),
    "download_all_examples": False,
    "show_signature": False,
    "min_reported_time": 1e9,
}
# links to other packages use the files in docs/inventories
intersphinx_mapping = write_inventories(Path(__file__).parent / "_build" / "inventories")


def write_help(app):
    """Write the help of all commands and the tables of the page on planners to files, which pages include."""
    folder = Path(app.srcdir) / "api"
    folder.mkdir(exist_ok=True)
    commands = (
        "plan",
        "compare",
        "compare-allocators",
        "score",
        "convert",
        "export",
        "night",
        "tile",
        "survey",
        "record",
        "status",
        "diff",
        "select",
        "potential",
        "probability",
        "design",
        "instruments",
        "benchmark",
        "benchmark collisions",
        "benchmark batches",
        "benchmark probability",
    )
    calls = {f"help_{c.replace(' ', '_').replace('-', '_')}": [*c.split(), "--help"] for c in commands}
    calls |= {"keys_survey": ["survey", "--help-keys"]}
    calls |= {"instruments": ["instruments"], "instruments_columns": ["instruments", "lamost", "desi", "sdss_apo"]}
    runner = CliRunner(env={"COLUMNS": "80"})
    for name, arguments in calls.items():
        result = runner.invoke(command_line, arguments, prog_name="rfpsurvey", catch_exceptions=False)
        if result.exit_code:
            raise RuntimeError(f"rfpsurvey {' '.join(arguments)}: {result.output}")
        (folder / f"{name}.txt").write_text(result.stdout)
    write_tables(folder)


def setup(app):
    """Connect the functions to Sphinx."""
    app.connect("builder-inited", write_help)
