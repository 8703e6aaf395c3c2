"""Scenes for planners of fibers: one FITS file each, which any program can read, and the generators of the scenes.

``python tests/benchmarks/planners/scene.py FOLDER [NAME ...]`` writes the scenes; ``README.rst`` describes the format.
"""

import argparse
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.table import Table, vstack

import rfpsurvey as rs
from rfpsurvey._instruments.pfs_files import pfs_fibers
from rfpsurvey.projection import TangentPlane

CENTER = SkyCoord("6h20m +23d")
DATA = os.environ.get("RFPSURVEY_TEST_DATA")
EVERY = 1e9  # limits of joints that allow all angles


@dataclass(frozen=True)
class Scene:
    """The positioners, the targets and the settings of one scene."""

    positioners: Table
    targets: Table
    settings: dict = field(default_factory=dict)

    @property
    def n_tiles(self) -> int:
        """Number of tiles, or 0 if the scene is a single field."""
        return len(self.settings.get("tiles", ()))

    def tile(self, k: int, *, without: set = frozenset()) -> "Scene":
        """Return the scene of a tile, without some science targets."""
        t = self.targets[np.asarray(self.targets["tile"]) == k]
        done = np.isin(np.asarray(t["id"]), list(without)) & (np.asarray(t["kind"]) == "science")
        settings = {name: value for name, value in self.settings.items() if name != "tiles"}
        return Scene(self.positioners, t[~done], settings)

    def write(self, path: Path) -> None:
        """Write the scene to a FITS file."""
        text = Table({"json": [json.dumps(self.settings)]})
        parts = {"POSITIONERS": self.positioners, "TARGETS": self.targets, "SETTINGS": text}
        tables = [fits.table_to_hdu(table) for table in parts.values()]
        for hdu, name in zip(tables, parts, strict=True):
            hdu.name = name
        fits.HDUList([fits.PrimaryHDU(), *tables]).writeto(path, overwrite=True)

    @classmethod
    def read(cls, path: Path) -> "Scene":
        """Read a scene from a FITS file."""
        with fits.open(path, memmap=False) as file:
            tables = [Table(file[name].data) for name in ("POSITIONERS", "TARGETS", "SETTINGS")]
        for table in tables:
            table.convert_bytestring_to_unicode()
        return cls(*tables[:2], json.loads(str(tables[2]["json"][0])))


def scene_of(
    instrument: rs.Instrument, targets: Table, requirements: tuple = (), *, name: str, rights: str = "synthetic"
) -> Scene:
    """Return the scene of an instrument with targets on its focal plane.

    ``targets`` has the columns ``x`` and ``y`` (mm), and optionally ``id``, ``priority`` (larger values first),
    ``kind``, ``category`` and ``fiber_type``.
    """
    plane, unit, n = instrument.focal_plane, instrument.focal_plane.positioner, len(instrument.focal_plane)
    home = np.rad2deg(unit.numbers.home)
    stuck = np.full((n, 2), np.nan) if plane.stuck is None else plane.stuck.to_value("deg")
    disabled = np.zeros(n, dtype=bool) if plane.disabled is None else np.asarray(plane.disabled)
    zero = np.zeros((n, 2)) if plane.zero_points is None else plane.zero_points.to_value("deg")
    columns = {"id": plane.id, "x": plane.xy[:, 0].to_value("mm"), "y": plane.xy[:, 1].to_value("mm")}
    for arm in ("central_arm", "eccentric_arm"):
        own = getattr(plane, arm)
        columns[arm] = np.full(n, getattr(unit, arm).to_value("mm")) if own is None else own.to_value("mm")
    for k, joint in enumerate(("theta", "phi")):
        limits = np.tile([-EVERY, EVERY], (n, 1))
        for given in (getattr(unit, f"{joint}_range"), getattr(plane, f"{joint}_range")):
            if given is not None:
                given = np.broadcast_to(given.to_value("deg"), (n, 2))
                limits = np.where(np.isfinite(given), given, limits)
        limits = np.where(np.abs(limits) < EVERY, limits + zero[:, k : k + 1], limits)
        columns[f"{joint}_min"], columns[f"{joint}_max"] = limits.T
        columns[f"{joint}_parked"] = np.where(np.isfinite(stuck[:, k]), stuck[:, k], home[k]) + zero[:, k]
    columns["state"] = np.where(np.isfinite(stuck[:, 0]), "stuck", np.where(disabled, "disabled", "ok"))
    columns["fiber_type"] = np.asarray(plane.fiber_type, dtype=str)
    columns["spectrograph"] = np.asarray(plane.spectrograph).reshape(n, -1)[:, 0]
    m = len(targets)
    usual = {"id": np.arange(m), "priority": np.ones(m), "kind": "science", "category": "", "fiber_type": ""}
    given = {key: targets[key] if key in targets.colnames else np.broadcast_to(usual[key], m) for key in usual}
    return Scene(
        Table(columns),
        Table({**given, "x": np.asarray(targets["x"], dtype=float), "y": np.asarray(targets["y"], dtype=float)}),
        {
            "name": name,
            "instrument": instrument.name,
            "license": rights,
            "handedness": unit.handedness,
            "min_separation": unit.min_separation.to_value("mm"),
            "clearance": unit.clearance.to_value("mm"),
            **_shape(unit),
            "circles": [] if plane.obstacles is None else plane.obstacles.to_value("mm").tolist(),
            "polygons": [one.to_value("mm").tolist() for one in plane.obstacle_polygons or ()],
            "hidden": [] if plane.hidden is None else plane.hidden.to_value("mm").tolist(),
            "requirements": [
                {
                    "what": one.what,
                    "fiber_type": one.fiber_type,
                    "minimum": one.minimum,
                    "maximum": one.maximum,
                    "per": one.per,
                }
                for one in map(rs.Requirement.parse, requirements)
            ],
        },
    )


def _shape(unit: rs.Positioner) -> dict:
    """Return the settings that describe the shape of the arms."""
    if unit.arm_model == "outline":
        parts = [{"vertices": vertices.tolist(), "radius": radius} for vertices, radius in unit.outline.parts]
        n = unit.outline.n_eccentric
        return {"shape": "outline", "eccentric": parts[:n], "central": parts[n:]}
    if unit.arm_model == "capsule":
        angles = unit.arm_angle if isinstance(unit.arm_angle, dict) else {"": unit.arm_angle}
        turned = {name: 0.0 if one is None else one.to_value("deg") for name, one in angles.items()}
        return {"shape": "segment", "length": unit.arm_length.to_value("mm"), "angle": turned}
    return {"shape": "segment", "length": None, "angle": {"": 0.0}}


def in_circle(instrument: rs.Instrument, n: int, seed: int, *, clusters: float = 0.0) -> Table:
    """Return n random targets on the focal plane of an instrument, a part of them in clusters."""
    rng, plane = np.random.default_rng(seed), instrument.focal_plane
    radius = float((np.hypot(*plane.arrays.xy.T) + plane.arrays.outer_radius).max())
    r, angle = radius * np.sqrt(rng.uniform(size=n)), rng.uniform(0, 2 * np.pi, n)
    xy = np.column_stack([r * np.cos(angle), r * np.sin(angle)])
    some = np.flatnonzero(rng.uniform(size=n) < clusters)
    pitch = float(np.sqrt(np.pi / len(plane)) * radius)
    xy[some] = xy[rng.choice(n, max(n // 20, 1))[rng.integers(max(n // 20, 1), size=len(some))]]
    xy[some] += rng.normal(0, pitch / 2, (len(some), 2))
    return Table({"id": np.arange(n), "x": xy[:, 0], "y": xy[:, 1], "priority": rng.integers(1, 4, n).astype(float)})


def with_calibration(targets: Table, n_sky: int, n_standard: int, fiber_types: tuple = ()) -> Table:
    """Return targets of which the last are sky positions and standards; fiber types alternate."""
    kind = np.full(len(targets), "science", dtype="U8")
    kind[len(kind) - n_sky :] = "sky"
    kind[len(kind) - n_sky - n_standard : len(kind) - n_sky] = "standard"
    targets["kind"] = kind
    if fiber_types:
        targets["fiber_type"] = np.array(fiber_types)[np.arange(len(targets)) % len(fiber_types)]
    return targets


def desi(per_positioner: float, *, rules: bool = False) -> Scene:
    """Return a tile of DESI with the positions of its metrology, without margins.

    Targets are in reach from 0.1 to 5.8 mm from the center, the limits that fiberassign uses for arms of 3 mm.
    """
    built = rs.Instrument.from_desi(Path(_data()) / "desi" / "fp-metrology.csv.gz")
    plain = replace(built, focal_plane=replace(built.focal_plane, margins=None))
    n = round(per_positioner * len(plain.focal_plane))
    targets = in_circle(plain, n + 3 * 4000 * rules + 1000 * rules, 1)
    requirements = ("standard=10/spectrograph", "sky=40/spectrograph") if rules else ()
    if rules:
        targets = with_calibration(targets, 12_000, 1000)
    scene = scene_of(plain, targets, requirements, name="desi", rights="positions: desihub/desimeter, BSD-3")
    for name, length in (("phi_min", 0.1), ("phi_max", 5.8)):
        scene.positioners[name] = np.round(-2 * np.rad2deg(np.arccos(length / 6)), 4)
    return scene


def preset(name: str, per_positioner: float, *, clusters: float = 0.0) -> Scene:
    """Return a preset with random targets."""
    instrument = rs.Instrument.preset(name)
    targets = in_circle(instrument, round(per_positioner * len(instrument.focal_plane)), 1, clusters=clusters)
    return scene_of(instrument, targets, name=name)


def pfs(n: int, *, rules: bool = False) -> Scene:
    """Return PFS with nominal cobras and its black dots."""
    nominal = rs.Instrument.preset("pfs")
    dots = Table.read(Path(_data()) / "pfs" / "black_dots_mm-2024-11-05.csv.gz", format="ascii.csv")
    circles = np.column_stack([dots["x"], dots["y"], dots["r"]]) * u.mm
    instrument = replace(nominal, focal_plane=replace(nominal.focal_plane, hidden=circles))
    targets = in_circle(instrument, n + 3600 * rules, 1)
    if rules:
        targets = with_calibration(targets, 3000, 600)
    rights = "dots: Subaru-PFS/pfs_instdata, no license stated"
    scene = scene_of(instrument, targets, ("sky=400", "standard=100") if rules else (), name="pfs", rights=rights)
    scene.positioners["fiber"] = pfs_fibers()[0][scene.positioners["id"] - 1]
    return scene


def sdss_dark() -> Scene:
    """Return SDSS-V with a synthetic dark field: BOSS and APOGEE targets, standards and sky positions."""
    instrument = rs.Instrument.preset("sdss_apo")
    targets = with_calibration(in_circle(instrument, 4500, 1), 2000, 500, ("BOSS", "APOGEE"))
    return scene_of(instrument, targets, tuple(instrument.requirements), name="sdss_dark")


def field_a() -> Scene:
    """Return the field of SDSS-V whose candidates are public, with the smallest numbers of each category."""
    instrument = rs.Instrument.preset("sdss_apo")
    table = Table.read(Path(_data()) / "sdssv_robostrategy_field_a.ecsv", format="ascii.ecsv")
    table = table[np.asarray(table["within"]) == 1]
    category = np.asarray(table["category"], dtype=str)
    kind = np.where(np.char.startswith(category, "sky"), "sky", "science").astype("U8")
    kind[np.char.startswith(category, "standard")] = "standard"
    columns = {
        "id": table["rsid"],
        "x": table["x_wok"],
        "y": table["y_wok"],
        "priority": -np.asarray(table["priority"], dtype=float),
        "kind": kind,
        "category": category,
        "fiber_type": np.asarray(table["fiber_type"], dtype=str),
    }
    requirements = ("sky_boss=300", "standard_boss=20", "sky_apogee=50", "standard_apogee=20")
    scene = scene_of(instrument, Table(columns), requirements, name="field_a", rights="SDSS-V, BSD-3")
    used = table[np.asarray(table["assigned"]) == 1]
    pairs = zip(used["hole_id"], used["rsid"], strict=True)
    scene.settings["recorded"] = [[str(hole), int(target)] for hole, target in pairs]
    return scene


def must() -> Scene:
    """Return the modules of MUST in one plane, with two targets per positioner."""
    modules = Table.read(Path(_data()) / "stage5" / "must_modules.csv", format="ascii.csv")
    rows = [(j, k) for j in range(11) for k in range(11 - j)]
    corners = {(0, 0), (0, 10), (10, 0)}
    step = 6.2
    inside = np.array([(step * (k + j / 2), step * np.sqrt(3) / 2 * j) for j, k in rows if (j, k) not in corners])
    inside -= np.array([5 * step, 5 * step / np.sqrt(3)])  # the centroid of the triangle
    up = np.where(np.asarray(modules["points_up"]) == 1, 1.0, -1.0)
    xy = np.column_stack([modules["x"], modules["y"]])[:, None] + inside * up[:, None, None]
    arm = rs.Positioner(1.8 * u.mm, 1.8 * u.mm, 1 * u.mm)
    plane = rs.FocalPlane(xy.reshape(-1, 2) * u.mm, arm)
    instrument = rs.Instrument("must", plane, plate_scale=116.784 * u.um / u.arcsec)
    rights = "figures: MaximeRombach/focal_plane_calc, no license stated"
    return scene_of(instrument, in_circle(instrument, 2 * len(plane), 1), name="must", rights=rights)


def hub() -> Scene:
    """Return long arms that all reach the targets of a small area."""
    plane = rs.FocalPlane.hexagonal(rs.Positioner(20 * u.mm, 20 * u.mm, 2 * u.mm), rings=3, pitch=16 * u.mm)
    rng = np.random.default_rng(2)
    x, y = rng.normal(0, 8, (2, 60))
    targets = Table({"x": x, "y": y, "priority": rng.integers(1, 4, 60).astype(float)})
    return scene_of(rs.Instrument("hub", plane, plate_scale=1 * u.mm / u.arcsec), targets, name="hub")


def stuck() -> Scene:
    """Return SDSS-V's arms, of which a quarter is stuck in random poses, and few targets."""
    instrument, rng = rs.Instrument.preset("sdss_apo"), np.random.default_rng(3)
    n = len(instrument.focal_plane)
    pose = np.column_stack([rng.uniform(0, 360, n), rng.uniform(0, 180, n)])
    pose[rng.uniform(size=n) > 0.25] = np.nan
    broken = replace(instrument, focal_plane=replace(instrument.focal_plane, stuck=pose * u.deg))
    return scene_of(broken, in_circle(broken, n, 3), name="stuck")


def _data() -> str:
    if DATA is None:
        raise FileNotFoundError("RFPSURVEY_TEST_DATA is not set")
    return DATA


def tiles_of(scene: Scene, instrument: rs.Instrument, step: u.Quantity) -> Scene:
    """Return four overlapping tiles with as many targets as fibers, each of which is observed once.

    One tile is in the center, and the others are at a distance ``step``. ``instrument`` is a preset, or has its optics.
    """
    around = CENTER.directional_offset_by([0, 120, 240] * u.deg, step)
    centers = SkyCoord([CENTER.ra, *around.ra], [CENTER.dec, *around.dec])
    radius = instrument.field_radius + step
    density = len(centers) * len(scene.positioners) / (np.pi * radius**2)
    sky = rs.synthetic_catalog("poisson", CENTER, radius, density=density, rng=1).coord
    priority = np.random.default_rng(1).integers(1, 4, len(sky)).astype(float)
    p, parts = scene.positioners, []
    edge = float((np.hypot(p["x"], p["y"]) + p["central_arm"] + p["eccentric_arm"]).max())
    for k, center in enumerate(centers):
        plane = TangentPlane(center, instrument.plate_scale, distortion=instrument.distortion)
        x, y = plane.to_focal_plane(sky).to_value("mm").T
        rows = np.flatnonzero(np.hypot(x, y) < edge)
        columns = {"id": rows, "priority": priority[rows], "kind": "science", "category": "", "fiber_type": ""}
        places = {"x": x[rows], "y": y[rows], "tile": k, "ra": sky.ra.deg[rows], "dec": sky.dec.deg[rows]}
        parts.append(Table({name: np.broadcast_to(one, len(rows)) for name, one in {**columns, **places}.items()}))
    tiles = [{"ra": float(one.ra.deg), "dec": float(one.dec.deg)} for one in centers]
    return Scene(p, vstack(parts), {**scene.settings, "preset": instrument.name, "tiles": tiles})


def desi_tiles() -> Scene:
    """Return four overlapping tiles of DESI."""
    scene = desi(1)
    return tiles_of(scene, rs.Instrument.from_desi(Path(_data()) / "desi" / "fp-metrology.csv.gz"), 0.7 * u.deg)


SCENES: dict[str, Callable[[], Scene]] = {
    "desi_1": lambda: desi(1),
    "desi_2": lambda: desi(2),
    "desi_5": lambda: desi(5),
    "desi_1_rules": lambda: desi(1, rules=True),
    "desi_2_rules": lambda: desi(2, rules=True),
    "field_a": field_a,
    "sdss_dark": sdss_dark,
    "pfs_3600": lambda: pfs(3600),
    "pfs_9600": lambda: pfs(9600),
    "pfs_rules": lambda: pfs(3600, rules=True),
    "lamost_2": lambda: preset("lamost", 2),
    "moons_crowded": lambda: preset("moons", 4, clusters=0.5),
    "must_2": must,
    "hub": hub,
    "stuck": stuck,
    "desi_tiles": desi_tiles,
}
"""Functions that make the scenes. Some of them need the files of ``RFPSURVEY_TEST_DATA``."""


def make(names: list[str]) -> Iterator[tuple[str, Scene]]:
    """Yield scenes by name or from files; scenes whose data are missing are reported and left out."""
    for name in names or SCENES:
        if name.endswith(".fits"):
            yield Path(name).stem, Scene.read(Path(name))
            continue
        try:
            yield name, SCENES[name]()
        except FileNotFoundError as error:
            print(f"{name}: skipped, {error}")


def main() -> None:
    """Write scenes to a folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"scenes: {', '.join(SCENES)}")
    given = parser.parse_args()
    if unknown := [name for name in given.names if name not in SCENES]:
        parser.error(f"the scene must be one of {', '.join(SCENES)}, got {', '.join(unknown)}")
    given.folder.mkdir(parents=True, exist_ok=True)
    for name, scene in make(given.names):
        path = given.folder / f"{name}.fits"
        scene.write(path)
        print(f"{path}: {len(scene.positioners)} positioners, {len(scene.targets)} targets")


if __name__ == "__main__":
    main()
