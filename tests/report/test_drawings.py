"""Symbols and colors of the interactive views, which node draws on a recorder: legend, drawing and paper agree."""

import json
import shutil
import subprocess
from importlib.resources import files

import numpy as np
import pytest

from rfpsurvey.plot._style import light_scale

SCRIPTS = files("rfpsurvey.report") / "scripts"
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
    drawn, named = node((SCRIPTS / "focal_plane_drawing.js").read_text() + text.replace("SCALE", "1"))
    assert drawn == named
    assert set(named) == {"dot", "diamond", "ring"}
    css = (SCRIPTS / "view.css").read_text()
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
    found = np.array(node((SCRIPTS / "sky_map_drawing.js").read_text() + script))
    paper = 255 * light_scale()(np.linspace(0, 1, 8))[:, :3]
    assert np.abs(found - paper).max() <= 1
