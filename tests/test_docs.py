"""The documentation says what is there."""

import doctest
import importlib.util
import re
import shlex
from pathlib import Path

import pytest

import rfpsurvey as rs

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"


def test_every_public_name_is_on_the_api_page_once():
    lines = (DOCS / "api.rst").read_text().splitlines()
    listed = [line.strip() for line in lines if re.fullmatch(r"    [\w.]+", line)]
    listed += [line.split()[-1] for line in lines if line.startswith(".. py:data::")]
    assert sorted(name for name in listed if "." not in name) == sorted(rs.__all__)
    assert len(set(listed)) == len(listed)
    for package in ("plot", "benchmark"):
        public = [name for name in getattr(rs, package).__all__ if name.startswith(f"{package}_")]
        assert sorted(name.split(".")[1] for name in listed if name.startswith(f"{package}.")) == sorted(public)


CONSOLE = [
    pytest.param(block, id=f"{page.stem}-{number}")
    for page in sorted(DOCS.glob("*.rst"))
    for number, block in enumerate(re.findall(r"code-block:: console\n\n((?:    .*\n|\n)+)", page.read_text()))
]


@pytest.mark.parametrize("block", CONSOLE)
def test_commands_print_what_the_page_shows(block, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = re.search(r'lines = """(.*?)"""', (DOCS / "tutorial.rst").read_text(), re.DOTALL).group(1)
    (tmp_path / "gaia.csv").write_text(lines.replace("... ", ""))
    same = doctest.OutputChecker().check_output
    for command, shown in re.findall(r"    \$ rfpsurvey (.*)\n((?:    (?!\$).*\n)*)", block):
        code, out, err = run(*shlex.split(command))
        assert code == 0, err
        shown = re.sub("^    ", "", shown, flags=re.MULTILINE)
        assert same(shown, out, doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE), out


def test_broken_links_are_found(tmp_path):
    spec = importlib.util.spec_from_file_location("check_links", DOCS / "check_links.py")
    check_links = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(check_links)
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
