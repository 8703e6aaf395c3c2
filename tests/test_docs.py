"""The documentation agrees with the package, and its plots have descriptions for readers who cannot see them."""

import doctest
import importlib.util
import re
import runpy
import shlex
import sys
import zlib
from collections import Counter, defaultdict
from operator import attrgetter
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from PIL import Image

import rfpsurvey as rs

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"


def names_on_the_api_page():
    """Return the names of classes and functions, and the names of other values."""
    lines = (DOCS / "api.rst").read_text().splitlines()
    listed = [line.strip() for line in lines if re.fullmatch(r"    [\w.]+", line)]
    return listed, [line.split()[-1] for line in lines if line.startswith(".. py:data::")]


def test_every_public_name_is_on_the_api_page_once():
    objects, others = names_on_the_api_page()
    listed = objects + others
    assert sorted(name for name in listed if "." not in name) == sorted(rs.__all__)
    assert len(set(listed)) == len(listed)
    modules = [path.stem for path in (ROOT / "rfpsurvey").glob("[a-z]*.py") if path.stem != "errors"]
    for module in (*modules, "plot"):
        for name in importlib.import_module(f"rfpsurvey.{module}").__all__:
            assert {name, f"{module}.{name}"} & {*listed}, f"{module}.{name}"


def test_all_documented_objects_of_a_module_are_documented_under_one_package():
    """The documentation links from source code to objects of a module under the package of one of them."""
    packages = defaultdict(set)
    for name in names_on_the_api_page()[0]:
        packages[getattr(attrgetter(name)(rs), "__module__", name)].add(name.rpartition(".")[0])
    assert len(packages) > 50
    assert {module: found for module, found in packages.items() if len(found) > 1} == {}


CONSOLE = [
    pytest.param(page, block, id=f"{page.stem}-{number}")
    for page in sorted(DOCS.glob("*.rst"))
    for number, block in enumerate(re.findall(r"code-block:: console\n\n((?:    .*\n|\n)+)", page.read_text()))
]


@pytest.mark.parametrize(("page", "block"), CONSOLE)
def test_commands_print_what_the_page_shows(page, block, run, tmp_path, monkeypatch):
    """Blocks with a caption are files, which the commands of the page read; a command can have several lines."""
    monkeypatch.chdir(tmp_path)
    for name, text in re.findall(r":caption: (\S+)\n\n((?:    .*\n|\n)+)", page.read_text()):
        (tmp_path / name).write_text(re.sub("^    ", "", text, flags=re.MULTILINE).strip("\n") + "\n")
    lines = re.search(r'lines = """(.*?)"""', (DOCS / "plan_tile.rst").read_text(), re.DOTALL).group(1)
    (tmp_path / "gaia.csv").write_text(lines.replace("... ", ""))
    toml = re.search(r"code-block:: toml\n\n((?:    .*\n|\n)+)", (DOCS / "instruments.rst").read_text()).group(1)
    (tmp_path / "mine.toml").write_text(re.sub("^    ", "", toml, flags=re.MULTILINE))
    same = doctest.OutputChecker().check_output
    block = re.sub(r" \\\n +", " ", block)
    for command, shown in re.findall(r"    \$ rfpsurvey (.*)\n((?:    (?!\$).*\n)*)", block):
        code, out, err = run(*shlex.split(command), brief=True)
        assert code == 0, err
        shown = re.sub("^    ", "", shown, flags=re.MULTILINE)
        assert same(shown, out, doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE), out


def test_commands_of_the_cheat_sheet_run(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (DOCS / "cheatsheet.rst").read_text()
    commands = re.findall("^    rfpsurvey (.*)$", text, re.MULTILINE)
    assert len(commands) == 11
    assert 30 <= len(commands) + text.count("\n>>> ") <= 42  # more columns would not fit on a page
    for command in commands:
        code, out, err = run(*shlex.split(command, comments=True), brief=True)
        assert code == 0, (command, err)
        assert out
    for name in re.findall(r"--(?:output|plot|report|folder) (\S+)", text):
        assert (tmp_path / name).exists()


def load(name):
    """Return a module of the folder ``docs``, which is not a package."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_broken_links_are_found(tmp_path):
    check_links = load("check_links")
    (tmp_path / "part").mkdir()
    (tmp_path / "index.html").write_text(
        '<p id="here"></p><a href="part/one.html#there">good</a><a href="#here">good</a><a href="https://x.org/y">good</a>'
        '<a href="part/two.html">1</a><a href="#nowhere">2</a><script src="https://x.org/z.js"></script>'
    )
    (tmp_path / "part" / "one.html").write_text(
        '<p id="there"></p><img src="../no.png"><a href="../index.html#not">4</a>'
    )
    found = sorted(check_links.find_problems(tmp_path))
    assert found == [
        "index.html: #nowhere has no such place on its page",
        "index.html: https://x.org/z.js comes from the network",
        "index.html: part/two.html leads nowhere",
        "part/one.html: ../index.html#not has no such place on its page",
        "part/one.html: ../no.png leads nowhere",
    ]


def index_of_pages(pages):
    """Return an index in the form of Sphinx, of pages with a title, words, and main index entries."""
    index = {"docnames": list(pages), "titles": [one[0] for one in pages.values()], "objects": {}, "objnames": {}}
    index |= {"alltitles": {}, "indexentries": {}, "terms": defaultdict(list), "titleterms": defaultdict(list)}
    for number, (title, words, entries) in enumerate(pages.values()):
        index["alltitles"][title] = [[number, None]]
        index["indexentries"] |= {entry: [[number, "index-0", True]] for entry in entries}
        for word in words.split():
            index["terms"][word].append(number)
        for word in title.lower().split():
            index["titleterms"][word].append(number)
    return index


def test_the_search_prefers_index_entries_and_titles_to_texts(monkeypatch):
    pytest.importorskip("sphinx")
    check_search = load("check_search")
    pages = {"text": ("Words", "night sky joint plan", ()), "title": ("Joint plan", "night joint plan", ())}
    pages["entry"] = "Change log", "night joint plan", ("bad night",)
    index = index_of_pages(pages)
    assert check_search.search(index, "joint plan") == ["title", "entry", "text"]
    assert check_search.search(index, "bad night") == ["entry"]
    assert check_search.search(index, "sky") == ["text"]
    assert check_search.search(index, "tonight") == []
    monkeypatch.setattr(check_search, "QUERIES", {"joint plan": "title", "sky": "title", "tonight": "text"})
    assert list(check_search.find_misses(index)) == [
        "search for 'sky': title must be the first page, got text",
        "search for 'tonight': text must be the first page, got no page",
    ]


def test_pages_that_users_search_for_exist():
    check_search = load("check_search")
    assert len(check_search.QUERIES) - check_search.MOST_MISSES >= 18
    assert {f"{page}.rst" for page in check_search.QUERIES.values()} <= {page.name for page in DOCS.glob("*.rst")}
    for page in ("architecture", "bibliography", "changes", "testing"):
        assert (DOCS / f"{page}.rst").read_text().startswith(":nosearch:\n")


@pytest.mark.parametrize("path", sorted((DOCS / "inventories").glob("*.txt")), ids=lambda path: path.stem)
def test_inventories_list_names_that_exist(path):
    address, entries = load("inventories").read(path)
    assert address.startswith("https://")
    assert address.endswith("/")
    assert entries == sorted(entries)
    for role, name, page in entries:
        assert re.fullmatch(r"[\w/.-]+\.html#[\w.-]+", page)
        assert page.split("#")[1] == (f"term-{name}" if role == "std:term" else name)
        if role != "std:term":
            module, _, attribute = name.rpartition(".")
            assert hasattr(importlib.import_module(module or "builtins"), attribute) or attribute == "None"


def test_inventories_are_written_as_sphinx_reads_them(tmp_path):
    inventories = load("inventories")
    address, written = inventories.write_inventories(tmp_path)["scipy"]
    assert address == "https://docs.scipy.org/doc/scipy/"
    *head, compressed = Path(written).read_bytes().split(b"\n", 4)
    assert head[0] == b"# Sphinx inventory version 2"
    assert b"zlib" in head[3]
    page = "reference/generated/scipy.sparse.csr_array.html#scipy.sparse.csr_array"
    assert zlib.decompress(compressed).decode() == f"scipy.sparse.csr_array py:class 1 {page} -\n"
    assert inventories.linked_types()["FocalPlane"] == ":class:`FocalPlane <rfpsurvey.FocalPlane>`"
    assert inventories.linked_types()["Quantity"] == ":class:`~astropy.units.Quantity`"


def table_words(path):
    """Return the words of the table that compares packages, without references."""
    table = re.search(r"^(={5,} .*?)\n\n", path.read_text(), re.MULTILINE | re.DOTALL).group(1)
    return Counter(re.sub(r"\[\w\d\]_|={5,}", "", table).split())


def test_the_readme_compares_packages_as_the_page_with_the_sources_does():
    assert table_words(ROOT / "README.rst") == table_words(DOCS / "related.rst")


def test_the_readme_has_two_small_figures_and_the_two_commands():
    text = (ROOT / "README.rst").read_text()
    first, second = re.findall(r"^\.\. image:: (.*)$", text, re.MULTILINE)
    assert all(10_000 < (ROOT / image).stat().st_size < 200_000 for image in (first, second))
    for command in (
        ".venv/bin/pip install . && .venv/bin/rfpsurvey plan",
        ".venv/bin/pip install tox && .venv/bin/tox -e test",
    ):
        assert f"    python3 -m venv .venv && {command}\n" in text


@pytest.mark.parametrize("page", sorted(DOCS.glob("*.rst")), ids=lambda page: page.stem)
def test_pages_have_at_most_400_lines(page):
    assert len(page.read_text().splitlines()) <= 400


def test_all_sources_that_are_cited_are_listed():
    text = (DOCS / "related.rst").read_text()
    assert set(re.findall(r"(?<!\.\. )\[(\w\d)\]_", text)) == set(re.findall(r"^\.\. \[(\w\d)\]", text, re.MULTILINE))


PAGES = sorted(page for page in DOCS.glob("*.rst") if ".. plot::" in page.read_text())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_plots_have_alternative_texts(page):
    """Without an alternative text, Sphinx uses the name of the file."""
    texts = []
    for options in re.findall(r"^\.\. plot::.*\n((?:    :.*\n)*)", page.read_text(), re.MULTILINE):
        if ":nofigs:" not in options:
            texts += re.findall(r":alt: (.*)", options) or [""]
    for text in texts:
        assert len(text) > 40
        assert text.endswith(".")
    assert len(set(texts)) == len(texts)


def test_scripts_of_the_gallery_have_thumbnails_of_their_own():
    """Regression: all scripts that are not run had the same thumbnail."""
    scripts = [path for path in (DOCS / "examples" / "scripts").glob("*.py") if not path.name.startswith("plot_")]
    found = [re.findall(r"sphinx_gallery_thumbnail_path = [\"'](.*)[\"']", script.read_text()) for script in scripts]
    assert all(len(paths) == 1 for paths in found)
    files = [(DOCS / path).read_bytes() for (path,) in found]
    assert len(set(files)) == len(scripts)
    assert max(map(len, files)) < 60_000


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["needed_models", "speed_accuracy", "failures"])
def test_plots_of_trade_offs_can_be_drawn_for_an_own_instrument(name, tmp_path, monkeypatch):
    toml = re.search(r"code-block:: toml\n\n((?:    .*\n|\n)+)", (DOCS / "instruments.rst").read_text()).group(1)
    (tmp_path / "mine.toml").write_text(re.sub("^    ", "", toml, flags=re.MULTILINE))
    monkeypatch.syspath_prepend(DOCS / "figures")
    monkeypatch.setattr(sys, "argv", [name, str(tmp_path / "mine.toml"), str(tmp_path / "mine.png")])
    with plt.rc_context():
        drawn = runpy.run_path(str(DOCS / "figures" / f"{name}.py"))
        assert "mine" in drawn["figure"].get_supxlabel()
        heights = {text.get_size() for ax in drawn["figure"].axes for text in [*ax.texts, *ax.get_xticklabels()]}
        plt.close(drawn["figure"])
    with Image.open(tmp_path / "mine.png") as image:
        assert min(heights) / 72 * 120 * 500 / image.width >= 9  # pixels, if the plot is 500 pixels wide


def test_errors_of_probabilities_have_one_measure_that_does_not_saturate(monkeypatch):
    """Regression: one figure showed absolute errors, another relative errors, of which all are at most 100 % if the
    estimate is too small.
    """
    monkeypatch.syspath_prepend(DOCS / "figures")
    import trade_offs

    assert trade_offs.excess(1.01) == pytest.approx(0.01)
    assert (
        trade_offs.excess(0.061 / 0.418) == pytest.approx(trade_offs.excess(0.418 / 0.061)) == pytest.approx(5.85, 0.01)
    )
    assert trade_offs.excess(0.1) > 3 * trade_offs.excess(0.3)
    for name in ("speed_accuracy", "failures"):
        assert "set_ylabel(trade_offs.FACTOR" in (DOCS / "figures" / f"{name}.py").read_text()
