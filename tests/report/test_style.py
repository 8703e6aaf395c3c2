"""Contrast of the colors of pages, computed from their style sheets; the syntax of the scripts."""

import re
import shutil
import subprocess
from importlib.resources import files

import pytest

REPORT = files("rfpsurvey.report")
SCRIPTS = ["page.js", *(f"scripts/{path.name}" for path in (REPORT / "scripts").iterdir() if path.name.endswith(".js"))]
TEXT = ("ink", "soft", "accent", "good", "bad", "open")
MARKS = ("c-arm", "c-collision", "c-idle", "c-other", "c-good", "c-obstacle", "c-star", "c-sky", "c-mark")


def colors(scheme):
    """Return the variables of both style sheets, as red, green and blue from 0 to 255."""
    found = {}
    for name in ("page.css", "scripts/view.css"):
        text = (REPORT / name).read_text()
        light, dark = re.findall(r":root \{([^}]*)\}", text)[:2]  # page.css has a third one, for paper
        for block in (light, dark) if scheme == "dark" else (light,):
            found.update(re.findall(r"--([\w-]+):\s*#([0-9a-f]{3,6})\b", block))
    return {
        name: [int(c, 16) for c in re.findall("..", v if len(v) == 6 else "".join(2 * d for d in v))]
        for name, v in found.items()
    }


def luminance(color):
    parts = [c / 255 for c in color]
    linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one, other):
    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_contrast_of_known_colors():
    """The ratios are those of the definition in WCAG 2.1 for black, white, and a gray that just suffices."""
    assert contrast([0, 0, 0], [255, 255, 255]) == pytest.approx(21)
    assert contrast([0x76] * 3, [255, 255, 255]) == pytest.approx(4.54, abs=0.01)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_and_marks_have_enough_contrast(scheme):
    """WCAG 2.1, level AA: 4.5 for text, 3 for edges of controls and for marks."""
    found = colors(scheme)
    for background in ("paper", "wash", "c-field"):
        assert {
            n: contrast(found[n], found[background]) for n in TEXT if contrast(found[n], found[background]) < 4.5
        } == {}
    for name in (*MARKS, "control"):
        assert contrast(found[name], found["c-field"]) >= 3, name
        assert contrast(found[name], found["paper"]) >= 3, name


@pytest.mark.parametrize("name", SCRIPTS)
def test_scripts_are_valid_and_never_make_html_of_text(name):
    text = (REPORT / name).read_text()
    assert not re.search(
        r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b|new Function|fetch\(|XMLHttpRequest|import\(",
        text,
    )
    assert "</script" not in text
    if shutil.which("node"):
        done = subprocess.run(["node", "--check", "-"], input=text, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
