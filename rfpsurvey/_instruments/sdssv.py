"""SDSS-V as built: the calibration tables of the focal plane system at Apache Point or Las Campanas.

The angle alpha of the tables is theta, and beta is phi. Let a = alpha + alphaOffset and b = beta + betaOffset, and let
(fx, fy) be the position of a fiber on the beta arm. The position of the fiber relative to the base of its robot is then
tx = alphaArmLen cos(a) + fx cos(a + b) - fy sin(a + b), ty = alphaArmLen sin(a) + fx sin(a + b) + fy cos(a + b). The
wok is the plate that carries the robots. In coordinates of the wok, the position of the fiber is
(xWok, yWok) + (tx + dx) i + (ty + dy) j, where the unit vectors i and j are (0, -1) and (1, 0).
"""

import re
from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np

from rfpsurvey._common.files import to_path
from rfpsurvey._common.read_documents import is_present
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._common.units import check_unique, to_plain
from rfpsurvey._instruments.as_built import ROW, entry, impossible_entry, is_missing, number_rows
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey.errors import InputError, check_choice, listed, number_of, warn

PRESETS = {"APO": "sdss_apo", "LCO": "sdss_lco"}
TABLE = "positionerTable.csv"
OFFSETS = ("alphaOffset", "betaOffset", "dx", "dy")
FIBERS = {"BOSS": ("bossX", "bossY"), "APOGEE": ("apX", "apY"), "METROLOGY": ("metX", "metY")}
VECTORS = ("ix", "iy", "iz", "jx", "jy", "jz")
COEFFICIENTS = ("c0", "c1", "c2", "c3", "c4")
HOME = [10.0, 170.0] * u.deg  # alpha and beta of the lattice position
HOLE = re.compile(r"R[+-]?\d+C\d+")
# Limits of possible values; other values count as missing. Lengths are in mm, and angles in degrees.
LARGEST = 400.0  # distance from the center of the wok, whose radius is about 350 mm
MOST_OFFSET = {"alphaOffset": 90.0, "betaOffset": 90.0, "dx": 5.0, "dy": 5.0}
MOST_SHIFT = {"x": 100.0, "y": 100.0, "xTilt": 10.0, "yTilt": 10.0}
FARTHEST = 5.0  # distance of a hole from its nominal position
ARMS_DIFFER = 0.2  # relative difference of an arm from the nominal arm
MAPS_DIFFER = 0.1  # relative difference of the radius of a field from the nominal radius
MOST_FIBER = 998  # numbers of fibers are below the code 999 for missing values


def recognizes(path: Path) -> bool:
    """Return whether a folder contains the table of the robots of SDSS-V."""
    return is_present(path / TABLE)


def read(preset, folder, *, site: str | None = None, disabled=()):
    """Read an instrument from a folder; ``preset(name)`` returns the preset with the values that the files lack."""
    folder = to_path(folder)
    if not folder.is_dir():
        what = "this is a file" if folder.exists() else "there is no such folder"
        raise InputError(f"{folder}: {what}; give the folder with {TABLE}")
    robots = _Rows(folder / TABLE, ("site", "holeID", "alphaArmLen", *OFFSETS, *sum(FIBERS.values(), ())))
    site = robots.keep_site(site)
    nominal = preset(PRESETS[site])
    notes = [f"The positioners are the {number_of(len(robots), 'robot')} of the site {site} in {folder.name}/{TABLE}."]
    robots.order_as(nominal.focal_plane.id)
    ids = robots.text("holeID")
    robots.check_unique("holeID")
    xy, axis = _bases(folder, site, robots, nominal.focal_plane, notes)
    types, doubtful = _fiber_types(folder, site, robots, notes)
    plane = _plane(nominal.focal_plane, robots, ids, xy, axis, types, notes)
    doubtful |= {*robots.impossible.values()}
    plane = replace(plane, obstacles=_obstacles(folder, site, nominal.focal_plane.obstacles, ids, notes))
    if len(disabled):
        plane = replace(plane, disabled=plane.disabled | _named(disabled, ids))
    maps = _maps(folder, site, nominal.distortion, notes)
    _check_orientation(folder, site, notes)
    dropped = ("layout.", "positioner.eccentric_arm", "positioner.arm_angle", "positioner.theta", "positioner.phi")
    kept = {name: entry for name, entry in nominal.values.items() if not name.startswith(dropped)}
    return replace(
        nominal,
        focal_plane=plane,
        plate_scale=None,
        distortion=maps,
        layout="as built",
        values={**kept, **_entries(plane, nominal, maps, folder), **impossible_entry(len(doubtful), folder.name)},
        notes="\n".join(notes),
    )


class _Rows:
    """The rows of a table for one site; each column is checked when it is read."""

    def __init__(self, path: Path, names: tuple[str, ...]):
        self.path, self.table = path, read_table(path)
        self.impossible: dict[str, str] = {}
        """Values that are not missing in the file, but count as missing, and the hole of each value."""
        number_rows(self.table, names, path)

    def __len__(self):
        return len(self.table)

    def has(self, name: str) -> bool:
        return name in self.table.colnames

    def text(self, name: str) -> np.ndarray:
        """Return a column as text; missing values are empty."""
        column = self.table[name]
        values = to_plain(column, f"{self.path}: column {name!r}").astype(str)
        return np.char.strip(np.where(np.ma.getmaskarray(np.ma.asarray(column)), "", values))

    def numbers(
        self, name: str, most: float = 1e6, *, low: float | None = None, codes: bool = True, finite: bool = False
    ) -> np.ndarray:
        """Return a column as numbers; missing values become NaN or, if ``finite`` is true, raise an error.

        Values outside the limits ``low`` (by default, ``-most``) and ``most`` count as missing, and also codes for
        missing values if ``codes`` is true.
        """
        texts = self.text(name)
        try:
            values = np.array([float(text) if text else np.nan for text in texts.tolist()])
        except ValueError as error:
            raise InputError(f"{self.path}: column {name!r} must hold numbers, {error}") from None
        missing = is_missing(values, -most if low is None else low, most, codes=codes)
        wrong = missing if finite else np.isinf(values)
        for k in np.flatnonzero(wrong):
            raise InputError(
                f"{self.path}: column {name!r} must hold finite numbers"
                f"{f' from {-most:g} to {most:g}' if most < 1e6 else ''}, and no codes such as 99 or -999, got "
                f"{str(texts[k])!r} in row {self.table[ROW][k]}"
            )
        self.doubt(missing & ~np.isnan(values), name)
        return np.where(missing, np.nan, values)

    def doubt(self, wrong: np.ndarray, name: str) -> None:
        """Record the values of a column that are impossible."""
        for k in np.flatnonzero(wrong):
            text = f"{name} = {self.text(name)[k]} in row {self.table[ROW][k]}"
            self.impossible[text] = str(self.table["holeID"][k])

    def note(self) -> list[str]:
        """Return a note on the impossible values of this table, if there are any."""
        values = ", ".join(self.impossible)
        return [f"These values in {self.path.name} are impossible and count as missing: {values}."] if values else []

    def keep_site(self, site: str | None) -> str:
        """Keep the rows of a site, and return the site; None stands for the only site of the table."""
        site_of = self.text("site")
        if site is None:
            sites = np.unique(site_of).tolist()
            if len(sites) > 1:
                raise InputError(
                    f"{self.path}: site must be one of {', '.join(sites)}, because the table has several sites"
                )
            site = sites[0]
        if site not in PRESETS:
            raise InputError(f"{self.path}: site must be {' or '.join(PRESETS)}, got {site!r}")
        if not (site_of == site).any():
            raise InputError(
                f"{self.path}: the table must have rows of the site {site}, got {listed(np.unique(site_of).tolist())}"
            )
        self.keep(site_of == site)
        return site

    def keep(self, rows: np.ndarray) -> None:
        """Keep the rows that an index or a mask selects."""
        self.table = self.table[rows]

    def order_as(self, ids: np.ndarray) -> None:
        """Sort the rows in the order of the holes in the preset; rows of other holes follow."""
        place = {name: k for k, name in enumerate(ids.tolist())}
        order = [place.get(hole, len(place)) for hole in self.text("holeID").tolist()]
        self.keep(np.argsort(order, kind="stable"))

    def check_unique(self, name: str) -> None:
        check_unique(self.text(name), f"{self.path}: column {name!r}")
        if "" in self.text(name):
            raise InputError(f"{self.path}: column {name!r} must have a value in each row, got an empty one")

    def rows_of(self, holes: np.ndarray) -> np.ndarray:
        """Return the row number of each hole; -1 if the table has no row for the hole."""
        self.check_unique("holeID")
        row = {hole: k for k, hole in enumerate(self.text("holeID").tolist())}
        return np.array([row.get(hole, -1) for hole in holes.tolist()])


def _optional(folder: Path, file: str, site: str, names: tuple[str, ...], notes: list[str]) -> _Rows | None:
    """Return the rows of a site from a file, or None if the folder does not contain a file with this name."""
    path = folder / file
    if not is_present(path):
        notes.append(f"There is no {file}; its values are taken from the preset.")
        return None
    rows = _Rows(path, ("site", *names))
    rows.keep_site(site)
    return rows


def _bases(folder, site, robots, nominal, notes):
    """Return the positions of the robots' holes (mm), and the direction of the unit vector i (rad) at each hole."""
    wok = _Rows(folder / "wokCoords.csv", ("site", "holeID", "xWok", "yWok"))
    wok.keep_site(site)
    if wok.has("wokID") and robots.has("wokID"):
        wok.keep(np.isin(wok.text("wokID"), robots.text("wokID")))
    rows = wok.rows_of(robots.text("holeID"))
    if (rows < 0).any():
        hole = robots.text("holeID")[rows < 0][0]
        raise InputError(f"{wok.path}: the table must have all holes of {TABLE}, but {hole} is missing")
    notes.append(f"wokCoords.csv has {number_of(len(wok) - len(rows), 'hole')} without a robot.")
    wok.keep(rows)
    xy = np.column_stack([wok.numbers(name, LARGEST, finite=True) for name in ("xWok", "yWok")])
    places = dict(zip(nominal.id.tolist(), nominal.arrays.xy.tolist(), strict=True))
    apart = [np.hypot(*(place - places.get(hole, place))) for hole, place in zip(wok.text("holeID"), xy, strict=True)]
    far = np.array(apart) > FARTHEST
    for k in np.flatnonzero(far):
        raise InputError(
            f"{wok.path}: xWok and yWok must be within {FARTHEST:g} mm of the nominal position of the hole, got "
            f"{xy[k].tolist()} for {wok.text('holeID')[k]} in row {wok.table[ROW][k]}"
        )
    if not all(wok.has(name) for name in VECTORS):
        return xy, np.full(len(rows), -np.pi / 2)
    i_x, i_y, i_z, j_x, j_y, j_z = (wok.numbers(name, finite=True) for name in VECTORS)
    bad = (np.abs([i_z, j_z, j_x + i_y, j_y - i_x, np.hypot(i_x, i_y) - 1]) > 1e-6).any(axis=0)
    if bad.any():
        raise InputError(
            f"{wok.path}: the robots must stand perpendicular to the focal plane, with unit vectors i and j in that "
            f"plane, got other vectors for {robots.text('holeID')[bad][0]}"
        )
    return xy, np.arctan2(i_y, i_x)


def _fiber_types(folder, site, robots, notes) -> tuple[np.ndarray, set[str]]:
    """Return whether each robot has the fibers BOSS and APOGEE, shape (n, 2), and holes with impossible numbers."""
    holes = robots.text("holeID")
    path = folder / "fiberAssignments.csv"
    if not is_present(path):
        wok = _Rows(folder / "wokCoords.csv", ("holeID", "holeType"))
        kind = np.char.lower(wok.text("holeType")[wok.rows_of(holes)])
        notes.append("There is no fiberAssignments.csv; holeType in wokCoords.csv states the fibers of each robot.")
        return np.column_stack([np.char.find(kind, word) >= 0 for word in ("boss", "apogee")]), set()
    rows = _Rows(path, ("site", "holeID", "Device", "BOSSFiber", "APOGEEFiber"))
    rows.keep_site(site)
    is_robot = np.char.lower(rows.text("Device")) == "positioner"
    n_unused = int((~is_robot).sum())
    rows.keep(is_robot)
    index = rows.rows_of(holes)
    notes.append(f"fiberAssignments.csv has {number_of(n_unused, 'row')} of other devices, which are not used.")
    lacking, extra = holes[index < 0], len(rows) - int((index >= 0).sum())
    if len(lacking):
        notes.append(f"These robots have no row in fiberAssignments.csv and thus no fibers: {', '.join(lacking)}.")
    if extra:
        text = f"fiberAssignments.csv has {number_of(extra, 'positioner')} without a row in {TABLE}"
        notes.append(f"{text}; these positioners are not used.")
        warn(f"{folder}: {text}; {TABLE} may be truncated")
    fibers = np.zeros((len(rows), 2), dtype=bool)
    for k, name in enumerate(("BOSSFiber", "APOGEEFiber")):
        numbers = rows.numbers(name, MOST_FIBER, low=1, codes=False)
        _, group, times = np.unique(numbers, return_inverse=True, return_counts=True)
        # a number that several robots have does not identify a fiber
        rows.doubt(repeated := np.isfinite(numbers) & (times[group] > 1), name)
        fibers[:, k] = np.isfinite(numbers) & ~repeated
    notes += rows.note()
    return fibers[index] & (index >= 0)[:, None], {*rows.impossible.values()}


def _plane(nominal, robots, ids, xy, axis, types, notes) -> FocalPlane:
    """Return the focal plane; robots whose values are incomplete are disabled and have nominal values."""
    places = {}
    for name, columns in FIBERS.items():
        place = np.column_stack([robots.numbers(column) for column in columns])
        length = np.hypot(*place.T)
        wrong = np.abs(length / nominal.arrays.eccentric_arm[0] - 1) > ARMS_DIFFER
        for column in columns:
            robots.doubt(wrong, column)
        places[name] = np.where(wrong[:, None], np.nan, place)
    arm = nominal.arrays.central_arm[0]
    geometry = {"alphaArmLen": robots.numbers("alphaArmLen", arm * (1 + ARMS_DIFFER), low=arm * (1 - ARMS_DIFFER))}
    geometry |= {name: robots.numbers(name, most) for name, most in MOST_OFFSET.items()}
    bad = ~np.isfinite(list(geometry.values())).all(axis=0)
    notes += robots.note()
    standard = {"alphaArmLen": arm, **dict.fromkeys(OFFSETS, 0.0)}
    values = {name: np.where(bad, standard[name], v) for name, v in geometry.items()}
    if bad.any():
        notes.append(f"These robots are disabled, because values in {TABLE} are missing: {', '.join(ids[bad])}.")
    names = ("BOSS", "APOGEE")
    for k, name in enumerate(names):
        lost = types[:, k] & ~np.isfinite(places[name]).all(axis=1)
        types[:, k] &= ~lost
        if lost.any():
            notes.append(
                f"The fiber {name} of these robots is not used, because its position in {TABLE} is missing: "
                f"{', '.join(ids[lost])}."
            )
    none = ~types.any(axis=1)
    if none.any():
        notes.append(f"These robots are disabled, because they have no fiber: {', '.join(ids[none])}.")
        arm = nominal.arrays.eccentric_arm[0]
        places["BOSS"][none & ~np.isfinite(places["BOSS"]).all(axis=1)] = arm, 0.0
        types[none, 0] = True
    # (tx + dx) i + (ty + dy) j, where j is i rotated by +90 deg
    c, s = np.cos(axis), np.sin(axis)
    base = xy + np.column_stack([c * values["dx"] - s * values["dy"], s * values["dx"] + c * values["dy"]])
    zeros = np.column_stack([axis + np.deg2rad(values["alphaOffset"]), np.deg2rad(values["betaOffset"])])
    return FocalPlane(
        base * u.mm,
        replace(
            nominal.positioner, arm_angle=None, home=HOME, theta_range=[0, 360] * u.deg, phi_range=[0, 180] * u.deg
        ),
        id=ids,
        spectrograph=np.tile(np.arange(2), (len(ids), 1)),
        fiber_type=np.array(["+".join(np.array(names)[row]) for row in types]),
        central_arm=values["alphaArmLen"] * u.mm,
        disabled=bad | none,
        fiber_xy={name: place * u.mm for name, place in places.items()},
        zero_points=np.rad2deg(zeros) * u.deg,
    )


def _obstacles(folder, site, nominal, ids, notes):
    """Return the fiducials between the robots as circles with the radius of the preset."""
    rows = _optional(folder, "fiducialCoords.csv", site, ("holeID", "xWok", "yWok"), notes)
    if rows is None:
        return nominal
    n = len(rows)
    rows.keep(np.array([HOLE.fullmatch(hole) is not None for hole in rows.text("holeID").tolist()]))
    xy = np.column_stack([rows.numbers(name, LARGEST, finite=True) for name in ("xWok", "yWok")])
    radius = nominal[0, 2].to_value(u.mm)
    notes.append(
        f"Fiducials between the robots ({len(xy)} of {n} in fiducialCoords.csv) are obstacles of radius "
        f"{radius:g} mm; other fiducials and the guide cameras are not obstacles."
    )
    return np.column_stack([xy, np.full(len(xy), radius)]) * u.mm


def _maps(folder, site, nominal, notes):
    """Return the radial map of each fiber type, with the largest field angle and scale factor of the preset."""
    rows = _optional(folder, "focalPlaneModel.csv", site, ("direction", "waveCat", "R", *COEFFICIENTS), notes)
    if rows is None:
        return nominal
    rows.keep(rows.text("direction") == "focal")
    kinds, maps = np.char.upper(rows.text("waveCat")), {}
    for name, old in nominal.items():
        matching = np.flatnonzero(kinds == name)
        if len(matching) != 1:
            raise InputError(
                f"{rows.path}: there must be one row with direction = focal, site = {site} and "
                f"waveCat = {name.title()}, got {len(matching)}"
            )
        radius, *terms = (float(rows.numbers(c, finite=True)[matching[0]]) for c in ("R", *COEFFICIENTS))
        maps[name] = replace(old, coefficients=tuple(terms), radius=radius * u.mm)
        edge = float(maps[name].to_radius(old.max_angle) / old.to_radius(old.max_angle))
        if not abs(edge - 1) < MAPS_DIFFER:
            raise InputError(
                f"{rows.path}: R and c0 to c4 must give the nominal radius of the field within {MAPS_DIFFER:.0%}, got "
                f"{edge:.3g} times this radius in row {rows.table[ROW][matching[0]]}"
            )
    return maps


def _check_orientation(folder, site, notes) -> None:
    """Warn if the wok is shifted or tilted, because projections of the sky neglect the shift and the tilt."""
    rows = _optional(folder, "wokOrientation.csv", site, tuple(MOST_SHIFT), notes)
    if rows is None:
        return
    values = {name: rows.numbers(name, most, finite=True)[0] for name, most in MOST_SHIFT.items()}
    if any(values.values()):
        given = ", ".join(f"{name} = {value:g}" for name, value in values.items() if value)
        text = f"{rows.path}: the wok is shifted or tilted ({given}); projections of the sky neglect the shift and tilt"
        notes.append(f"The wok is shifted or tilted ({given}); projections of the sky neglect the shift and tilt.")
        warn(text)


def _named(disabled, ids) -> np.ndarray:
    """Return whether each robot is in the list of disabled robots."""
    names = np.atleast_1d(to_plain(disabled, "disabled")).astype(str)
    for name in names.tolist():
        check_choice(name, ids.tolist(), "robot to disable")
    return np.isin(ids, names)


def _entries(plane, nominal, maps, folder) -> dict:
    """Return the values that were read, with their sources."""
    where = f"{folder.name}/{TABLE}"
    arm = float(np.median(plane.arrays.central_arm))
    places = {name: np.nanmedian(xy.to_value(u.mm), axis=0).tolist() for name, xy in plane.fiber_xy.items()}
    jaeger = "https://github.com/sdss/jaeger src/jaeger/etc/jaeger_APO.yml"
    entries = {
        "positioner.central_arm": entry(arm, f"{where}, median of alphaArmLen", "derived", "mm"),
        "positioner.fiber_xy": entry(places, f"{where}, medians of the positions of the fibers", "derived", "mm"),
        "positioner.home": entry(HOME.value.tolist(), jaeger, unit="deg"),
        "positioner.theta_range": entry([0.0, 360.0], jaeger, unit="deg"),
        "positioner.phi_range": entry([0.0, 180.0], jaeger, unit="deg"),
        "layout.robots": entry(len(plane), f"{where}; positions from wokCoords.csv"),
        "layout.fiducials": entry(len(plane.arrays.obstacles), f"{folder.name}/fiducialCoords.csv"),
        "layout.fiducial_radius": nominal.values["layout.fiducial_radius"],
    }
    if maps is not nominal.distortion:
        value = {
            name: {"form": m.form, "radius": m.radius.to_value(u.mm), "coefficients": list(m.coefficients)}
            for name, m in maps.items()
        }
        entries["optics.radial_map"] = entry(value, f"{folder.name}/focalPlaneModel.csv")
    return entries
