"""Contrast of the colors of pages, the syntax of scripts, and symbols of the views, which node draws on a recorder."""

import json
import re
import shutil
import subprocess
from importlib.resources import files

import numpy as np
import pytest

from rfpsurvey.plot._axes import light_scale

REPORT = files("rfpsurvey.report")
STATES = ["science", "standard", "sky", "collision", "struck", "reach", "idle", "unusable"]
RECORDER = """
const marks = [];
let path = [];
const context = new Proxy({}, {
  get: (own, name) => own[name] ?? ((...values) => {
    if (name === "beginPath") path = [];
    if (name === "arc") path.push(["round", values[0]]);
    if (name === "lineTo") path.push(["corner", values[0]]);
    if (name === "fill" || name === "stroke") for (const [kind, x] of path) marks.push([kind, name, x]);
  }),
});
const stage = { toScreen: (x, y) => [x, y], color: (name) => name, scale: SCALE };
const drawing = new FocalPlaneDrawing();
Object.assign(drawing, { x: STATE_NAMES.map((_, k) => 100 * k), y: STATE_NAMES.map(() => 0),
  outer: STATE_NAMES.map(() => 10), data: { arm_model: "outline", separation: 1 } });
const nowhere = STATE_NAMES.map(() => NaN);
const target_id = STATE_NAMES.map((name) => (["idle", "unusable"].includes(name) ? "" : name));
const [elbow_x, elbow_y] = [nowhere, nowhere];
drawing.plan = { state: STATE_NAMES, target_id, tip_x: drawing.x, tip_y: drawing.y, elbow_x, elbow_y };
drawing[METHOD](context, stage, STATE_NAMES.map((_, k) => k), drawing.plan);
const found = STATE_NAMES.map((name, k) => {
  const own = marks.filter(([, , x]) => Math.abs(x - 100 * k) < 20);
  if (own.some(([kind, way]) => kind === "corner" && way === "fill")) return "diamond";
  return own.some(([kind, way]) => kind === "round" && way === "fill") ? "dot" : "ring";
});
console.log(JSON.stringify([found, STATE_NAMES.map((name) => STATES[name][2] ?? "dot")]));
"""


def node(script):
    if not shutil.which("node"):
        pytest.skip("node is not installed")
    done = subprocess.run(["node", "-"], input=script, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("method", ["paintDots", "paintArms"])
def test_the_legend_of_the_focal_plane_names_the_symbols_that_are_drawn(method):
    """Regression: positioners without a target were rings, but dots in the legend; collisions were dots in enlarged
    plots, but diamonds in the legend.
    """
    text = RECORDER.replace("STATE_NAMES", json.dumps(STATES)).replace("METHOD", json.dumps(method))
    drawn, named = node((REPORT / "scripts" / "focal_plane_drawing.js").read_text() + text.replace("SCALE", "1"))
    assert (drawn, set(named)) == (named, {"dot", "diamond", "ring"})
    css = (REPORT / "scripts" / "view.css").read_text()
    assert all(f".mark.{symbol} " in css for symbol in named)


@pytest.mark.parametrize("dark", [False, True])
def test_the_sky_map_has_the_colors_of_the_plot_on_paper(dark):
    """Regression: colors were in the opposite order on light screens."""
    script = f"""
    const matchMedia = () => ({{ matches: {json.dumps(dark)} }});
    const map = new SkyMapDrawing();
    map.words = Array(8).fill("");
    console.log(JSON.stringify(map.words.map((_, k) => map.binColor(k).match(/[0-9]+/g).map(Number))));
    """
    found = np.array(node((REPORT / "scripts" / "sky_map_drawing.js").read_text() + script))
    assert np.abs(found - (255 * light_scale()(np.linspace(0, 1, 8))[:, :3])).max() <= 1


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
    linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in [c / 255 for c in color]]
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
