"""PFS as built. The calibration models are made from the data model; no such file of the observatory is available."""

import gzip
import re

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from pfs_files import OFFSET, centers, cobra_columns, write_cobras, write_files
from raising import refused

import rfpsurvey as rs
from rfpsurvey._instruments.pfs_files import pfs_engineering_fibers, pfs_fibers

DOTS, FIDUCIALS = "black_dots_mm-2024-11-05.csv", "fiducial_positions_20240513.csv"
INTERFERENCE = "cobraInterference_20260731.csv"
# rows of the fiber map of the observatory: cobraId, x, y, spectrograph (1 to 4), fiber hole
MAP = [
    (172, -48.497, 28.0, 1, 2), (200, -48.497, -84.0, 1, 30), (970, 48.497, 28.0, 1, 31), (983, 6.928, 60.0, 1, 46),
    (1768, 0.0, -56.0, 1, 62), (1796, 96.995, 0.0, 1, 90), (628, -159.349, 92.0, 1, 94), (1439, 117.779, 124.0, 1, 138),
    (1070, -83.138, 128.0, 4, 517), (1854, 103.923, -20.0, 4, 531), (229, -62.354, 36.0, 4, 562),
    (1027, 62.354, 36.0, 4, 591), (1043, 6.928, 68.0, 4, 609), (1825, 0.0, -72.0, 4, 622),
    (1853, 96.995, -16.0, 4, 650),
]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_files(tmp_path_factory.mktemp("pfs"))


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    return write_cobras(tmp_path_factory.mktemp("cobras") / "ALL.xml", cobra_columns())


def test_a_folder_with_dots_is_recognized_and_read(folder):
    pfs = rs.Instrument.read(folder)
    plane = pfs.focal_plane
    assert (pfs.layout, pfs.name) == ("as built", "pfs")
    assert plane.id.tolist() == list(range(1, 2395))
    np.testing.assert_allclose(plane.xy.value, centers(), atol=1e-9)
    assert (len(plane.arrays.hidden), len(plane.arrays.obstacles)) == (2394, 95)
    assert "58" in pfs.notes
    assert "1 cobras have limits" in pfs.notes
    np.testing.assert_allclose(pfs.values["layout.dot_offset"]["value"], OFFSET, atol=1e-6)
    assert pfs.values["positioner.clearance"] == rs.Instrument.preset("pfs").values["positioner.clearance"]


def test_one_file_is_enough(folder):
    pfs = rs.Instrument.from_pfs(folder / DOTS)
    assert len(pfs.focal_plane.arrays.obstacles) == 0
    assert pfs.focal_plane.theta_range is None
    assert "layout.fiducials" not in pfs.values


def test_a_file_of_dots_is_recognized_by_its_content(folder, tmp_path):
    path = tmp_path / "positions.csv"
    path.write_text((folder / DOTS).read_text())
    assert rs.Instrument.read(path).layout == "as built"
    path.write_text("x,y\n1,2\n")
    refused("cannot be read as TOML", rs.Instrument.read, path)


def test_files_in_the_folders_of_the_repository_are_found(folder, tmp_path):
    (tmp_path / f"{DOTS}.gz").write_bytes(gzip.compress((folder / DOTS).read_bytes()))
    assert len(rs.Instrument.read(tmp_path).focal_plane) == 2394
    (tmp_path / f"{DOTS}.gz").unlink()
    for name, place in {DOTS: "dot", FIDUCIALS: "fiducials", INTERFERENCE: "fiducials"}.items():
        (tmp_path / place).mkdir(exist_ok=True)
        (tmp_path / place / name).write_text((folder / name).read_text())
    plane = rs.Instrument.read(tmp_path).focal_plane
    assert len(plane.arrays.obstacles) == 95
    assert plane.theta_range is not None


def test_identifiers_and_spectrographs_are_those_of_the_fiber_map(folder, presets):
    fiber, spectrograph = pfs_fibers()
    plane = rs.Instrument.from_pfs(folder / DOTS).focal_plane
    nominal = dict(zip(presets["pfs"].focal_plane.id.tolist(), presets["pfs"].focal_plane.xy.value, strict=True))
    for cobra, x, y, number, hole in MAP:
        np.testing.assert_allclose(centers()[cobra - 1], [x, y], atol=6e-4)
        np.testing.assert_allclose(nominal[cobra], [x, y], atol=6e-4)
        assert (spectrograph[cobra - 1], fiber[cobra - 1]) == (number - 1, 651 * (number - 1) + hole)
        assert plane.spectrograph[cobra - 1] == number - 1
    assert len({*fiber.tolist(), *pfs_engineering_fibers().tolist()}) == 2394 + 64
    assert np.bincount(spectrograph).tolist() == [597, 597, 600, 600]


def test_targets_behind_a_dot_are_out_of_reach(folder):
    plane = rs.Instrument.from_pfs(folder / DOTS).focal_plane
    dot = plane.arrays.hidden[100]
    inside, outside = dot[:2] + [0.749, 0], dot[:2] + [0.751, 0]
    assert plane.multiplicity([inside, outside] * u.mm).tolist()[0] == 0
    assert plane.multiplicity([inside, outside] * u.mm).tolist()[1] > 0
    assert plane.reachable([inside, outside, [np.nan, 0]] * u.mm).sum(axis=0).tolist()[::2] == [0, 0]
    again = rs.FocalPlane.from_table(plane.to_table())
    np.testing.assert_array_equal(again.arrays.hidden, plane.arrays.hidden)
    assert len(again) == len(plane)


def exact_rule(theta, phi_local, phi_in, limits, l1, l2):
    """Return whether a cobra interferes, by the definition: directions in degrees, one of them in the window."""
    begin, end, most = limits
    tip = l1 * np.exp(1j * np.deg2rad(theta)) + l2 * np.exp(1j * np.deg2rad(theta + phi_local + phi_in))

    def in_window(angle):
        return (angle - begin) % 360 <= (end - begin) % 360

    return (phi_local > most) & (in_window(theta) | in_window(np.rad2deg(np.angle(tip))))


LIMITS = {
    7: (5.34, 26.95, 141), 35: (353.78, 22.21, 128), 172: (298.84, 350.53, 76), 900: (279.5, 300.32, 143),
    1141: (182.87, 242.11, 60), 2000: (10, 350, 150), 2394: (150, 160, 60),
}  # fmt: skip


@pytest.mark.few(1)
@pytest.mark.parametrize("with_model", [False, True])
def test_poses_within_the_joint_limits_never_interfere_with_a_fiducial(tmp_path, model, rng, with_model):
    write_files(tmp_path, LIMITS)
    cobras, n = model if with_model else None, 40_000
    pfs = rs.Instrument.from_pfs(tmp_path / DOTS, interference=tmp_path / INTERFERENCE, cobras=cobras)
    plane, columns = pfs.focal_plane, cobra_columns()
    free = rs.Instrument.from_pfs(tmp_path / DOTS, cobras=cobras).focal_plane
    for cobra, limits in LIMITS.items():
        k = cobra - 1
        l1, l2 = plane.arrays.central_arm[k], plane.arrays.eccentric_arm[k]
        around = (l1 + l2) * np.sqrt(rng.random(n)) * np.exp(2j * np.pi * rng.random(n))
        points = plane.arrays.xy[k] + np.column_stack([around.real, around.imag])
        pairs = plane.reachable(points * u.mm)
        reached = pairs.indices[pairs.indptr[k] : pairs.indptr[k + 1]][:4000]
        assert len(reached) > 0.2 * min(n, 4000)
        phi_in = columns["Joint2_CCW_limit_angle"][k] - 180 if with_model else -180.0
        offset = (points - plane.arrays.xy[k])[reached]
        r, direction = np.hypot(*offset.T), np.rad2deg(np.arctan2(*offset.T[::-1]))
        # the elbow is counter-clockwise of the fiber
        theta = direction + np.rad2deg(np.arccos(np.clip((l1**2 + r**2 - l2**2) / (2 * l1 * r), -1, 1)))
        phi = np.rad2deg(np.arccos(np.clip((l1**2 + l2**2 - r**2) / (2 * l1 * l2), -1, 1))) - 180
        bad = exact_rule(theta % 360, phi - phi_in, phi_in, limits, l1, l2)
        assert not bad.any(), (cobra, bad.sum())
        # the limit forbids poses of the nominal patrol area, otherwise this test could not fail
        assert np.diff(free.reachable(points * u.mm).indptr)[k] > np.diff(pairs.indptr)[k]


def test_cobra_models_give_centers_arms_and_joint_limits(folder, model):
    columns = cobra_columns()
    plane = rs.Instrument.from_pfs(folder / DOTS, cobras=model).focal_plane
    np.testing.assert_allclose(plane.arrays.xy[:, 0], columns["Global_base_pos_x"])
    np.testing.assert_allclose(plane.arrays.central_arm, columns["Link1_Link_Length"])
    np.testing.assert_allclose(plane.arrays.eccentric_arm, columns["Link2_Link_Length"])
    theta, phi = np.full(2394, 100.0), np.full(2394, -60.0)
    ccw = np.deg2rad(columns["CCW_Global_base_ori_z"] + theta)
    tip = columns["Link1_Link_Length"] * np.exp(1j * ccw)
    tip = tip + columns["Link2_Link_Length"] * np.exp(1j * (ccw + np.deg2rad(phi)))
    found = plane.forward(theta * u.deg, phi * u.deg).value - plane.arrays.xy
    np.testing.assert_allclose(found, np.column_stack([tip.real, tip.imag]), atol=1e-9)
    again_theta, again_phi = plane.inverse(plane.forward(theta * u.deg, phi * u.deg))
    np.testing.assert_allclose(np.mod(again_theta.value - theta + 180, 360) - 180, 0, atol=1e-6)
    np.testing.assert_allclose(again_phi.value, phi, atol=1e-6)
    span = plane.theta_range[:, 1].to_value(u.deg)
    assert ((span > 369) & (span < 386)).all()


def test_cobras_that_cannot_extend_reach_less(folder, tmp_path):
    columns = cobra_columns()
    columns["Joint2_CW_limit_angle"][41] = 120.0
    plane = rs.Instrument.from_pfs(folder / DOTS, cobras=write_cobras(tmp_path / "a.xml", columns)).focal_plane
    l1, l2 = plane.arrays.central_arm[41], plane.arrays.eccentric_arm[41]
    longest = abs(l1 + l2 * np.exp(1j * np.deg2rad(-60)))
    angle = np.linspace(0, 2 * np.pi, 60)[:, None]
    around = np.hstack([np.cos(angle), np.sin(angle)])
    assert 41 not in plane.reachable((plane.arrays.xy[41] + (longest + 0.01) * around) * u.mm).nonzero()[0]
    assert 41 in plane.reachable((plane.arrays.xy[41] + (longest - 0.01) * around) * u.mm).nonzero()[0]


def test_cobras_with_defects_are_disabled(folder, tmp_path):
    columns = cobra_columns()
    columns["Status"][[3, 8]] = 4, 2
    columns["Link1_Link_Length"][20] = 0.0
    pfs = rs.Instrument.from_pfs(folder / DOTS, cobras=write_cobras(tmp_path / "a.xml", columns))
    assert np.flatnonzero(pfs.focal_plane.disabled).tolist() == [3, 8, 20]
    assert "2 cobras whose Status is not 1" in pfs.notes
    assert "have nominal values and are also parked: 21." in pfs.notes
    assert pfs.focal_plane.arrays.central_arm[20] == 2.375


@pytest.mark.few(3)
@pytest.mark.parametrize("value", [-99.0, 9999.0])
@pytest.mark.parametrize("name", ["Global_base_pos_x", *list(cobra_columns())[5:]])
def test_impossible_values_of_cobras_count_as_missing(folder, tmp_path, name, value):
    """The code -999 as a direction of the hard stop was an angle, and as a center it displaced a parked arm."""
    columns = cobra_columns()
    columns[name][20] = value
    if name == "Global_base_pos_x":
        columns["Status"][20] = 2
    pfs = rs.Instrument.from_pfs(folder / DOTS, cobras=write_cobras(tmp_path / "a.xml", columns))
    assert np.flatnonzero(pfs.focal_plane.disabled).tolist() == [20]
    assert "are also parked: 21." in pfs.notes
    np.testing.assert_allclose(pfs.focal_plane.xy[20].value, centers()[20], atol=0.5)
    assert np.abs(pfs.focal_plane.theta_range[20].value).max() <= 540


@pytest.mark.parametrize("code", ["-999", "-99", "9999", "0"])
def test_codes_in_files_of_fiducials_and_limits_count_as_missing(folder, tmp_path, code):
    """A fiducial at (-99, -99) mm was an obstacle."""
    for name, number in ((FIDUCIALS, f"9,{code},{code},"), (INTERFERENCE, f"9,{code},{code},{code}")):
        pattern = r"\n9,[^,]*,[^,]*," if name == FIDUCIALS else r"\n9,,,"
        (tmp_path / name).write_text(re.sub(pattern, f"\n{number}", (folder / name).read_text()))
    pfs = rs.Instrument.from_pfs(folder / DOTS, fiducials=tmp_path / FIDUCIALS)
    assert len(pfs.focal_plane.obstacles) == 94
    assert "Fiducials without a position: 9, 58." in pfs.notes
    if code != "0":
        pfs = rs.Instrument.from_pfs(folder / DOTS, interference=tmp_path / INTERFERENCE)
        assert "1 cobras have limits" in pfs.notes


@pytest.mark.parametrize("name", [FIDUCIALS, INTERFERENCE, "dot", "fiducials", "ALL.xml"])
def test_optional_files_that_cannot_be_read_are_refused(folder, tmp_path, name):
    """A link to a folder that does not exist counted as no folder, and the instrument had no obstacles."""
    (tmp_path / DOTS).write_text((folder / DOTS).read_text())
    (tmp_path / name).symlink_to(tmp_path / "nowhere")
    assert refused("", rs.Instrument.read, tmp_path).startswith(str(tmp_path / name))


def test_models_of_modules_in_separate_files_are_joined(folder, model, tmp_path):
    columns = cobra_columns()
    first = {name: values[:57] for name, values in columns.items()}
    others = {name: values[57:] for name, values in columns.items()}
    paths = [write_cobras(tmp_path / "b.xml", others), write_cobras(tmp_path / "a.xml", first)]
    plane = rs.Instrument.from_pfs(folder / DOTS, cobras=paths).focal_plane
    whole = rs.Instrument.from_pfs(folder / DOTS, cobras=model).focal_plane
    np.testing.assert_array_equal(plane.arrays.xy, whole.arrays.xy)


def edit(old, new, count=1):
    return lambda text: re.sub(old, new, text, count=count)


DAMAGES = [
    (DOTS, lambda text: text[: len(text) // 2], "must have 2394 rows|line"),
    (DOTS, edit("spotId,x,y,r", "spotId,x,z,r"), "must have the column 'y', got spotId, x, z, r"),
    (DOTS, edit("\n9,[^,]*", "\n9,near"), "the column 'x' must hold numbers, got 'near'"),
    (DOTS, edit("\n9,[^,]*", "\n9,"), "x, y and r must be finite"),
    (DOTS, edit("\n9,", "\n8,"), "spotId must be unique, but 8 occurs more than once"),
    (DOTS, edit("\n2394,", "\n2395,"), "spotId must be 1 to 2394, got 2395"),
    (DOTS, edit(",0.75\n", ",750\n"), "r must be radii above 0 and below 4 mm, got 750"),
    (DOTS, lambda text: "\n".join([text.split("\n")[0], *(_micron(row) for row in text.split("\n")[1:-1])]), "in mm"),
    (DOTS, lambda text: "", "got no row"),
    (DOTS, lambda text: text.split("\n")[0] + "\n", "must have at least one row, got none"),
    (FIDUCIALS, lambda text: text[: len(text) // 2], "must have 96 rows|line"),
    (FIDUCIALS, edit("x_mm", "x"), "must have the column 'x_mm'"),
    (FIDUCIALS, edit("\n9,[^,]*", "\n9,far"), "the column 'x_mm' must hold numbers, got 'far'"),
    (FIDUCIALS, edit("\n9,[^,]*", "\n9,"), r"or both be missing, got \[nan, .*\] in row 9"),
    (FIDUCIALS, edit("\n9,[^,]*", "\n9,9000"), r"or both be missing, got \[9000.0, .*\] in row 9"),
    (INTERFERENCE, lambda text: text[: len(text) // 2], "must have 2394 rows|line"),
    (INTERFERENCE, edit("theta_limit_2", "theta_2"), "must have the column 'theta_limit_2'"),
    (INTERFERENCE, edit(",141", ",wide"), "the column 'max_phi_angle' must hold numbers, got 'wide'"),
    (INTERFERENCE, edit(",26.95,", ",,"), "all three limits or none, got only some for cobra 7"),
    (INTERFERENCE, edit("5.34,26.95,141", "0.093,0.470,2.461"), "angles from 0 to 360 in degrees"),
    (INTERFERENCE, edit("\n9,", "\n8,"), "cobra_id must be unique"),
]


def _micron(row):
    number, x, y, r = row.split(",")
    return f"{number},{float(x) * 1000},{float(y) * 1000},{float(r) * 1000}"


@pytest.mark.few(5)
@pytest.mark.parametrize(("name", "damage", "message"), DAMAGES)
def test_damaged_tables_are_refused_with_one_sentence(folder, tmp_path, name, damage, message):
    for path in folder.iterdir():
        (tmp_path / path.name).write_text(path.read_text())
    text = (folder / name).read_text()
    assert damage(text) != text
    (tmp_path / name).write_text(damage(text))
    sentence = refused(message, rs.Instrument.read, tmp_path)
    assert "\n" not in sentence
    assert str(tmp_path / name) in sentence


def tag(name, value, row=10):
    """Return a function that replaces one value of a calibration model."""

    def change(text):
        begin, end = [match.span(1) for match in re.finditer(f"<{name}>([^<]*)</{name}>", text)][row]
        return text[:begin] + value + text[end:]

    return change


MODELS = [
    (lambda text: text[: len(text) // 2], "cannot be read as XML"),
    (lambda text: "<ARM_DATA></ARM_DATA>", "elements ARM_DATA_CONTAINER, one per cobra, got none"),
    (
        edit("<Link1_Link_Length>[^<]*</Link1_Link_Length>", ""),
        "Link1_Link_Length of element 1 must be a number, got no",
    ),
    (tag("Global_base_pos_x", "left"), "Global_base_pos_x of element 11 must be a number, got 'left'"),
    (tag("Global_base_pos_x", "nan"), "Global_base_pos_x of element 11 must be finite, got nan"),
    (tag("Module_Id", "2"), "must be unique, but 68 occurs more than once"),
    (tag("Module_Id", "77"), "must be 1 to 2394, got 4343"),
    (tag("Positioner_Id", "58"), "Positioner_Id must be 1 to 57, got 58"),
    (tag("Status", "1.5"), "Status of element 11 must be a whole number, got 1.5"),
    (tag("Global_base_pos_x", "50"), "within 3 mm of its nominal center"),
    (tag("Joint2_CW_limit_angle", "-20"), "got the opposite for cobra 11"),
    (edit("<ARM_DATA_CONTAINER>.*?</ARM_DATA_CONTAINER>", ""), "must have 2394 rows"),
    (edit("<ARM_DATA>", "<!DOCTYPE x><ARM_DATA>"), "no document type"),
    (edit("(<Link._Link_Length>)[^<]*", r"\g<1>29.7", count=0), "must be about 2.4 mm, got the median 29.7"),
]


@pytest.mark.few(3)
@pytest.mark.parametrize(("damage", "message"), MODELS)
def test_damaged_models_are_refused_with_one_sentence(folder, model, tmp_path, damage, message):
    text, path = model.read_text(), tmp_path / "ALL.xml"
    assert damage(text) != text
    path.write_text(damage(text))
    assert "\n" not in refused(message, rs.Instrument.from_pfs, folder / DOTS, cobras=path)


def test_files_that_do_not_exist_are_refused(folder, tmp_path):
    refused("there is no such file", rs.Instrument.from_pfs, folder / "none.csv")
    refused("there is no such file", rs.Instrument.from_pfs, folder / DOTS, cobras=folder / "none.xml")
    refused(r"must have a file black_dots_mm\*\.csv", rs.Instrument.from_pfs, tmp_path)


def test_the_real_files_agree_with_each_other(real_data):
    """The windows of the interference limits point from each cobra to its fiducial, by ids, frame and centers."""
    folder = real_data("pfs")
    pfs = rs.Instrument.read(folder)
    plane = pfs.focal_plane
    fiducials = plane.arrays.obstacles[:, :2]
    assert len(fiducials) == 92
    table = np.genfromtxt(folder / INTERFERENCE, delimiter=",", skip_header=15)
    table = table[np.isfinite(table[:, 3])]
    assert len(table) == 87
    off = []
    for cobra, begin, end, _ in table:
        toward = fiducials - plane.arrays.xy[int(cobra) - 1]
        x, y = toward[np.argmin(np.hypot(*toward.T))]
        width = (end - begin) % 360
        off.append((np.rad2deg(np.arctan2(y, x)) - begin - width / 2 + 180) % 360 - 180)
        assert abs(off[-1]) < width / 2 + 1.5
    assert abs(np.mean(off)) < 1
    assert 0.9 < pfs.facts()["coverage"] < 0.96


def test_a_planned_tile_uses_no_target_behind_a_dot(folder):
    pfs, center = rs.Instrument.read(folder), SkyCoord(150 * u.deg, 2 * u.deg)
    sky = rs.synthetic_catalog("uniform", center, pfs.field_radius, n_targets=4000, rng=3)
    tile, arrays = rs.plan_tile(sky, pfs, center), pfs.focal_plane.arrays
    assert arrays.is_hidden(np.column_stack([tile.outcomes["x"].value, tile.outcomes["y"].value])).sum() > 50
    taken = tile.table[tile.table["status"] == "assigned"]
    assert len(taken) > 1000
    assert not arrays.is_hidden(np.column_stack([taken["tip_x"].value, taken["tip_y"].value])).any()
