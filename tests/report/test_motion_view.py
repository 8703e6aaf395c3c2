"""The motion of the arms in the report of a tile."""

import base64
import json
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from outlined import DESI_LIKE
from raising import refused

import rfpsurvey as rs
from pages import Reader
from rfpsurvey.report._tile import motion_data, motion_facts, pack_integers

VIEW = "document.querySelector('.view').view"
PARTS = (0.0, 0.1, 0.37, 0.62, 0.93, 1.0)
"""Fractions of the duration at which poses are compared."""


@pytest.fixture(scope="module")
def made():
    """Return a tile without collisions, and its paths."""
    tile = rs.plan_tile(rs.example_catalog("anticenter"), "sdss_apo", "06h20m +23d", allocator="repair")
    return tile, tile.paths()


@pytest.fixture(scope="module")
def file(made, tmp_path_factory):
    path = tmp_path_factory.mktemp("motion") / "tile.html"
    rs.write_report(made[0], path, paths=made[1])
    return path


@pytest.fixture(scope="module")
def opened(visit, file):
    page = visit(file)
    page.evaluate(f"async () => {{ while (!({VIEW}?.stage.width > 1)) await new Promise(requestAnimationFrame); }}")
    return page


@pytest.fixture
def page(opened):
    """Return the open page with planned paths; other tests of this page also show other motions."""
    opened.evaluate(f"() => {{ {VIEW}.motion.planned = true; }}")
    return opened


@pytest.fixture(scope="module")
def outlined():
    """Return paths of arms with outlines."""
    plane = rs.FocalPlane.hexagonal(DESI_LIKE, rings=3, pitch=2.1 * DESI_LIKE.eccentric_arm)
    rng, reach = np.random.default_rng(1), DESI_LIKE.outer_radius.to_value(u.mm)
    xy = plane.xy.to_value(u.mm)
    tips = np.vstack([xy + rng.uniform(-reach, reach, xy.shape) for _ in range(4)]) * u.mm
    return rs.collision.find_paths(plane, rs.allocate(plane, tips))


def unpack_integers(text):
    values, value, unit = [], 0, 1
    for byte in base64.b64decode(text):
        value, unit = value + (byte & 127) * unit, unit * 128
        if byte < 128:
            values.append(value)
            value, unit = 0, 1
    return np.array(values)


def poses_at(paths, part, *, planned=True):
    """Return the poses of all arms, interpolated between the break points of the table of paths."""
    rows, angles = paths.table[paths.table["motion"] == "unfold"], []
    for name in paths.focal_plane.id.astype(str):
        own = rows[rows["positioner"].astype(str) == name]
        own = own if planned else own[[0, -1]]
        time = part * paths.duration
        angles.append([np.interp(time, own["time"], own[c]).to_value(u.deg) for c in ("theta", "phi")])
    theta, phi = np.transpose(angles) * u.deg
    kinds = paths.focal_plane.fiber_types
    types = {"fiber_type": np.array(kinds)[paths.fiber]} if len(kinds) > 1 else {}
    return rs.collision.place_arms(paths.focal_plane, theta=theta, phi=phi, **types)


def test_integers_are_packed():
    values = [0, 1, 127, 128, 300, 16383, 16384, 10**9]
    assert unpack_integers(pack_integers(values)).tolist() == values
    assert pack_integers([]) == ""


def test_the_data_contain_the_break_points(made):
    paths = made[1]
    data, table = motion_data(paths), paths.table[paths.table["motion"] == "unfold"]
    values, n = unpack_integers(data["knots"]), len(paths.arrives)
    counts = values[:n]
    assert counts.tolist() == np.diff(paths.start).tolist()
    times = values[n : len(values) - 2 * counts.sum()]
    assert len(times) == (counts - 2).sum()
    first = np.cumsum(counts) - counts
    expected = np.delete(table["time"].to_value(u.s), np.concatenate([first, first + counts - 1]))
    found = np.concatenate([np.cumsum(part) for part in np.split(times, np.cumsum(counts - 2)[:-1])])
    np.testing.assert_allclose(found / data["per_second"], expected, atol=0.51 / data["per_second"])
    assert data["duration"] == pytest.approx(paths.duration.to_value(u.s), abs=0.51 / data["per_second"])


def test_pages_without_paths_do_not_change(made, file, tmp_path):
    tile, paths = made
    rs.write_report(tile, tmp_path / "plain.html")
    rs.write_report(tile, tmp_path / "false.html", paths=False)
    text, moving = (tmp_path / "plain.html").read_text(), file.read_text()
    assert (tmp_path / "false.html").read_text() == text
    assert "MovingFocalPlane" in moving
    assert "MovingFocalPlane" not in text
    assert "motion" not in json.loads(Reader(text).text("script")[0])
    # the script has less than 25 kB, and a break point has less than 9 bytes
    assert 0 < len(moving) - len(text) < 25_000 + 9 * len(paths.time)


def test_the_page_states_the_facts_of_the_motion(made, file):
    paths, facts = made[1], Reader(file.read_text()).facts()
    assert facts["arms with a target that arrive"] == f"{paths.n_arriving} of {paths.assigned.sum()}"
    assert facts["duration"] == f"{paths.duration.value:.1f} s"
    assert facts["smallest distance of two arms (proven)"] == f"{paths.smallest_distance.value:.3f} mm"
    assert facts["speed of the joints"] == "11.72 deg / s"
    assert "arms that do not arrive" not in facts
    late = motion_facts(replace(paths, groups=((["R1", "R2"], "no path was found"),))).values
    assert late["arms that do not arrive"] == ["R1, R2 (no path was found)"]


def test_paths_are_planned_if_requested(made, file, tmp_path):
    rs.write_report(made[0], tmp_path / "page.html", paths=True)
    assert (tmp_path / "page.html").read_bytes() == file.read_bytes()


def test_wrong_paths_are_named(made, tmp_path):
    tile, paths = made
    write = lambda result, paths: lambda: rs.write_report(result, tmp_path / "page.html", paths=paths)  # noqa: E731
    refused("paths must be True or an object of the class Paths, got 'all'", write(tile, "all"))
    refused("paths must be given only for a Tile, got paths for a QTable of", write(paths.table, paths))
    other = replace(paths.focal_plane, id=np.char.add(paths.focal_plane.id, "x"))
    words = "paths must belong to the 500 positioners of the tile, got paths of 500 positioners of another focal plane"
    refused(words, write(tile, replace(paths, focal_plane=other)))
    turned = rs.plan_tile(
        rs.example_catalog("anticenter"), "sdss_apo", "06h20m +23d", allocator="repair", position_angle=9 * u.deg
    )
    refused("paths must lead to the poses of the tile, but ", write(turned, paths))
    assert not (tmp_path / "page.html").exists()


PLACE = """([part, planned]) => {
  const { motion } = document.querySelector('.view').view;
  motion.planned = planned;
  motion.at(part * motion.data.duration);
  for (let k = 0; k < motion.n; k += 1) motion.place(k);
  return ["elbow_x", "elbow_y", "tip_x", "tip_y", "arm_x", "arm_y"].map((name) => [...motion[name]]);
}"""


@pytest.mark.parametrize("planned", [True, False])
def test_the_poses_of_frames_are_those_of_the_paths(page, made, planned):
    for part in PARTS:
        found = np.array(page.evaluate(PLACE, [part, planned]))
        arms = poses_at(made[1], part, planned=planned)
        expected = np.vstack([arms.elbow.T, arms.tip.T, arms.segments[:, 2:].T])
        np.testing.assert_allclose(found, expected, atol=0.02)


MEASURE = """([data, x, y, separation, part]) => {
  const motion = new Motion(data, x, y, separation);
  const measured = [true, false].map((planned) => {
    motion.planned = planned;
    motion.reset();
    motion.at(part * data.duration);
    motion.measure();
    const pairs = [...motion.pairs], close = pairs.filter((_, p) => motion.seen[p >> 1]);
    const both = close.filter((_, p) => p % 2 === 0).map((i, p) => [i, close[2 * p + 1]].sort((a, b) => a - b));
    return [both, motion.smallest];
  });
  return [...measured, motion.error];
}"""


@pytest.mark.parametrize("shape", ["segments", "outlines"])
def test_distances_are_those_of_find_collisions(page, made, outlined, shape):
    paths = made[1] if shape == "segments" else outlined
    plane, n_close = paths.focal_plane, 0
    x, y = plane.xy.T.to_value(u.mm).tolist()
    separation = plane.positioner.min_separation.to_value(u.mm)
    for part in PARTS:
        planned, constant, error = page.evaluate(MEASURE, [motion_data(paths), x, y, separation, part])
        assert error < 0.05
        for (pairs, smallest), is_planned in ((planned, True), (constant, False)):
            report = rs.find_collisions(plane, poses_at(paths, part, planned=is_planned))
            found = {tuple(pair) for pair in pairs}
            distances = dict(zip(map(tuple, report.pairs.tolist()), report.distances.to_value(u.mm), strict=True))
            n_close += len(found)
            assert found <= set(distances)
            assert all(distances[pair] > separation - 3 * error for pair in set(distances) - found)
            if distances:
                assert max(smallest, 0) == pytest.approx(max(min(distances.values()), 0), abs=2 * error)
            else:
                assert smallest > separation - error
        assert planned[0] == []
    assert n_close > 5


def test_the_slack_of_distances_hides_no_collisions(page):
    """Frames with skipped distances must show the same as a computation of all distances at the same times."""
    text = """() => {
      const { motion } = document.querySelector('.view').view, { duration } = motion.data;
      const run = (all) => {
        motion.planned = false;
        motion.reset();
        return [...Array(301).keys()].map((k) => {
          motion.at(duration * (k < 200 ? k / 200 : 1 - (k - 200) / 100)); // forward and backward
          if (all) motion.known.fill(NaN);
          motion.measure();
          return [motion.smallest, motion.now, motion.total];
        });
      };
      return [run(false), run(true)];
    }"""
    found, expected = page.evaluate(text)
    assert found == expected
    assert expected[-1][2] > 10


PLAY = """async () => {
  const view = document.querySelector('.view').view, times = [];
  while (view.playing) {
    times.push(view.motion.time);
    await new Promise(requestAnimationFrame);
  }
  return [...times, view.motion.time];
}"""


def test_controls_play_the_motion(page):
    page.evaluate(f"{VIEW}.show({VIEW}.motion.data.duration)")
    clock = lambda: page.evaluate(f"{VIEW}.motion.time")  # noqa: E731
    end = clock()
    page.get_by_label("Speed").select_option("20")
    page.get_by_role("button", name="Play", exact=True).click()  # begins at 0 s
    times = page.evaluate(PLAY)
    assert times == sorted(times)
    assert (len(times) > 10, times[0] < end / 2, times[-1]) == (True, True, end)
    slider = page.get_by_label("Time", exact=True)
    slider.focus()
    page.keyboard.press("Home")
    assert clock() == 0
    page.keyboard.press("ArrowRight")
    assert clock() == pytest.approx(0.1)
    assert slider.get_attribute("aria-valuetext") == "0.10 s"
    page.get_by_label("Motion", exact=True).select_option("constant")
    page.evaluate(f"{VIEW}.show({VIEW}.motion.data.duration / 2)")
    text = page.get_by_text("Smallest distance of two arms at the times shown so far").inner_text()
    assert "minimum separation: 4.08 mm" in text
    assert int(text.partition("minimum separation: ")[2].partition(" pairs")[0].split()[-1]) > 0
    assert "closer than the minimum separation at this time" in page.locator(".legend").inner_text()
    page.get_by_role("button", name="Play", exact=True).focus()
    page.keyboard.press("Enter")
    page.get_by_role("button", name="Pause").click()
    assert end / 2 < clock() < end
    page.get_by_label("Motion", exact=True).select_option("planned")


def test_positioners_are_found_at_their_present_poses(page):
    page.evaluate(f"{VIEW}.show(0); {VIEW}.stage.show(0, 0, 8); {VIEW}.stage.paint()")
    at = """() => { const v = document.querySelector('.view').view, { motion } = v;
      const k = v.id.findIndex((_, i) => v.plan.target_id[i] && Math.hypot(v.x[i], v.y[i]) < 40);
      return [k, v.pick(motion.tip_x[k], motion.tip_y[k]), v.pick(v.plan.tip_x[k], v.plan.tip_y[k])]; }"""
    own, folded, assigned = page.evaluate(at)
    assert folded == own >= 0
    assert assigned != own
    page.evaluate(f"{VIEW}.stage.fit()")


def test_dots_are_at_the_fibers_if_arms_are_too_small(page):
    text = """() => { const v = document.querySelector('.view').view, { motion, stage } = v;
      v.show(0.6 * motion.data.duration);
      stage.scale = 0.25;
      stage.paint();
      const { width, height } = stage.canvas, ratio = width / stage.width;
      const pixels = stage.canvas.getContext("2d").getImageData(0, 0, width, height).data;
      const found = v.id.map((_, k) => k).filter((k) => v.plan.target_id[k]).map((k) => {
        const [px, py] = stage.toScreen(motion.tip_x[k], motion.tip_y[k]);
        const first = 4 * (Math.floor(py * ratio) * width + Math.floor(px * ratio));
        return pixels.slice(first, first + 4).join() === "0,114,178,255";
      });
      stage.fit();
      return found; }"""
    found = page.evaluate(text)
    assert len(found) > 300
    assert sum(found) > 0.9 * len(found)  # rings and other symbols cover some dots


def test_differences_of_plans_are_shown_without_motion(visit, made, tmp_path):
    rs.write_report(made[0], tmp_path / "two.html", paths=made[1], plans={"other": made[0]})
    page = visit(tmp_path / "two.html")
    group = page.get_by_role("group", name="Motion of the arms")
    assert not group.is_visible()
    page.get_by_label("Compared with").select_option("no other plan")
    assert group.is_visible()


def test_controls_are_large_enough_on_a_phone(visit, file):
    page = visit(file, width=400)
    sizes = page.evaluate("""[...document.querySelectorAll('.live :is(button, select, input)')].map((e) =>
        [e.textContent || e.type, e.getBoundingClientRect().width, e.getBoundingClientRect().height])""")
    assert [entry for entry in sizes if min(entry[1:]) < 32] == []
    assert page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth") <= 0
