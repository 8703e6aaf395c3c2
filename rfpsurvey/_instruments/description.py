"""Read descriptions of instruments: TOML files in which every value has a status and a source.

Methods of `Instrument` return the margins, joint motion, rules and cameras of a description.
"""

from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Self

import astropy.units as u
import numpy as np

from rfpsurvey._common.read_documents import read_toml
from rfpsurvey._common.read_tables import read_table
from rfpsurvey._instruments.entries import (
    CAMERAS,
    check_description,
    sections_of,
    select_entries,
    value_of,
    with_defaults,
)
from rfpsurvey._instruments.entries import RULES as RULES_SECTION
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.joint_motion import JointMotion
from rfpsurvey._instruments.layouts import (
    ONLY_MODULES,
    SECTION,
    UNUSED,
    has_modules,
    layout_of_modules,
    refuse_unused,
    switch_inherited,
    without_replaced,
)
from rfpsurvey._instruments.margins import Margins
from rfpsurvey._instruments.modules import cell_centers, hexagonal_cells
from rfpsurvey._instruments.pfs_files import cobra_ids
from rfpsurvey._instruments.positioner import Positioner
from rfpsurvey._instruments.projections import LIGHT, Projections, light_of
from rfpsurvey._sky.radial_map import RadialMap
from rfpsurvey.errors import InputError, check_choice, short

MARGINS, MOTION, RULES, NIGHT = "margins.", "motion.", f"{RULES_SECTION}.", "night."
OPTIONAL = (MARGINS, MOTION, RULES, LIGHT, NIGHT)
"""Beginnings of names of entries on which only results with margins, paths, rules, conditions or nights depend."""


class Described(Projections):
    """The members that `Instrument` inherits: its margins, joint motion, rules and cameras, and its projections."""

    @property
    def published_margins(self) -> Margins:
        """The margins in the description of the instrument, which `with_margins` uses; they may be 0."""
        return Margins(**{name: value_of(entry) for name, entry in select_entries(self.values, MARGINS).items()})

    def with_margins(self, **margins: u.Quantity | float | None) -> Self:
        """Return the instrument with margins, which plans keep from mechanical limits (:ref:`margins`).

        Without arguments, the margins in the description of the instrument are used (``published_margins``). With
        arguments, only the given margins are used; margins of 0 remove the margins of the instrument.

        Parameters
        ----------
        **margins : Quantity or float, optional
            The fields of `Margins`: the lengths ``outer``, ``inner``, ``arms`` and ``broken``, and the factors
            ``broken_factor`` and ``hidden_factor``.

        Returns
        -------
        Instrument
            The instrument with these margins.

        Raises
        ------
        InputError
            If no arguments are given and the description of the instrument contains no margins, or if a margin is out
            of range.

        Examples
        --------
        >>> import astropy.units as u
        >>> import rfpsurvey as rs
        >>> desi = rs.Instrument.preset("desi")
        >>> desi.with_margins().focal_plane.margins.record
        {'outer_mm': 0.2, 'inner_mm': 0.1, 'arms_mm': 0.05}
        >>> desi.with_margins(outer=0.3 * u.mm).focal_plane.margins.record
        {'outer_mm': 0.3}
        """
        given = {name: value for name, value in margins.items() if value is not None}
        used = Margins(**given) if given else self.published_margins
        if not given and not used:
            raise InputError(
                f"the description of the instrument must contain margins, got none for {self.name}; give margins such "
                "as outer=0.1 * u.mm (--set instrument.margins.outer=0.1)"
            )
        return self.use_margins(used)

    def use_margins(self, margins: Margins) -> Self:
        """Return the instrument with the given margins.

        Parameters
        ----------
        margins : Margins
            The margins.

        Returns
        -------
        Instrument
            The instrument with these margins.
        """
        return replace(self, focal_plane=replace(self.focal_plane, margins=margins))

    @property
    def motion(self) -> JointMotion:
        """Ranges and speeds of the joints in the description of the instrument, on which only paths depend."""
        return JointMotion(**{name: value_of(entry) for name, entry in select_entries(self.values, MOTION).items()})

    @property
    def cameras(self) -> dict[str, np.ndarray]:
        """Corners of the guide and focus cameras on the focal plane in mm, by the name of the camera."""
        entries = select_entries(self.values, f"{CAMERAS}.")
        return {name: np.array(v["value"]) * u.Unit(v.get("unit", "mm")).to(u.mm) for name, v in entries.items()}

    def rules(self, name: str) -> tuple[str, ...]:
        """Return the rules that an observatory publishes for the plans of an instrument, as texts of constraints.

        Parameters
        ----------
        name : str
            Name of the rules, such as ``dark_monit``, a design mode of SDSS-V. The entries of ``values`` whose names
            begin with ``rules.dark_monit.`` contain the rules and their sources.

        Returns
        -------
        tuple of str
            The rules, which `AllocationOptions` and `score_tile` accept as ``constraints`` (:doc:`/rules`).

        Raises
        ------
        InputError
            If the instrument does not have rules of this name.

        Examples
        --------
        >>> import rfpsurvey as rs
        >>> rs.Instrument.preset("sdss_apo").rules("dark_rm")[:2]
        ('sky@BOSS=50', 'distribution sky 1 95 75 BOSS')
        """
        known = {key.partition(".")[0] for key in select_entries(self.values, RULES)}
        if not known:
            raise InputError(f"the instrument must have rules of the name {short(name)}, but {self.name} has no rules")
        check_choice(name, known, f"name of rules of {self.name}")
        values = [entry["value"] for entry in select_entries(self.values, f"{RULES}{name}.").values()]
        return tuple(text for value in values for text in ([value] if isinstance(value, str) else value))


PRESETS = Path(str(files("rfpsurvey"))) / "presets"


def load(path: Path, inheriting: tuple = ()) -> dict:
    """Read a description, and add default values and the values of the description that it inherits from.

    The key ``inherits`` contains the name of the other description, which is a file in the same folder or a preset.
    """
    if path in inheriting:
        raise InputError(f"{path} inherits from itself")
    content = with_defaults(read_toml(path))
    parent = content.pop("inherits", None)
    if parent is None:
        return content
    if not isinstance(parent, str):
        raise InputError(f"{path}: inherits must be the name of another description, got {parent!r}")
    beside = path.with_name(f"{parent}.toml")
    if not beside.exists():
        known = {file.stem for folder in (path.parent, PRESETS) for file in folder.glob("*.toml")} - {path.stem}
        beside = PRESETS / f"{check_choice(parent, known, f'value of inherits in {path}:')}.toml"
    base = load(beside, (*inheriting, path))
    section = content.get("positioner")
    if isinstance(section, dict) and isinstance(base.get("positioner"), dict):
        base["positioner"] = switch_inherited(base["positioner"], section)
    if isinstance(content.get("layout"), dict) and isinstance(base.get("layout"), dict):
        base["layout"] = without_replaced(base["layout"], content["layout"])
    for key, value in content.items():
        merges = isinstance(value, dict) and isinstance(base.get(key), dict)
        base[key] = {**base[key], **value} if merges else value
    return base


def build(content: dict, folder: Path) -> dict:
    """Return the arguments of `Instrument` for a description; tables are read from ``folder``."""
    check_description(content)
    if "positioner" not in content:
        raise InputError("the description must have the section [positioner], got none")
    if lacking := {"central_arm", "eccentric_arm", "clearance"} - set(content["positioner"]):
        raise InputError(f"[positioner] lacks {', '.join(sorted(lacking))}")
    sources, values = content.get("sources", {}), {}
    for section, entries in sections_of(content).items():
        for name, entry in entries.items():
            values[f"{section}.{name}"] = {**entry, "source": sources.get(entry["source"], entry["source"])}
    light_of(values)  # raises an error if the light is not valid

    def get(name, default=None):
        return value_of(values[name]) if name in values else default

    options = {name: get(f"positioner.{name}") for name in content["positioner"]}
    for name in UNUSED:
        options.pop(name.removeprefix(SECTION), None)
    focal_plane = _layout(Positioner(**options), get, folder)
    entry = values.get("layout.obstacle_polygons")
    if entry is not None:
        polygons = [polygon * u.Unit(entry["unit"]) for polygon in entry["value"]]
        polygons = [*(focal_plane.obstacle_polygons or ()), *polygons]  # walls of modules remain
        focal_plane = replace(focal_plane, obstacle_polygons=polygons)
    maps = {
        t: RadialMap(
            m["form"],
            tuple(m["coefficients"]),
            max_angle=get("optics.max_angle"),
            radius=m["radius"] * u.mm if "radius" in m else None,
            unit_tangent=m.get("unit_tangent", 1.0),
            factor=get("optics.factor", 1.0),
        )
        for t, m in get("optics.radial_map", {}).items()
    }
    if not maps and get("optics.plate_scale") is None:
        raise InputError("[optics] must have a plate_scale, or a radial_map with max_angle")
    distortion = maps.get("any") if "any" in maps else maps or None
    return {
        "name": content["name"],
        "focal_plane": focal_plane,
        "plate_scale": get("optics.plate_scale") if distortion is None else None,
        "distortion": distortion,
        "title": content.get("title", ""),
        "layout": content.get("layout_is", "nominal"),
        "targets_per_fiber": get("observing.targets_per_fiber", 4.0),
        "values": values,
        "notes": content.get("notes", ""),
    }


def _layout(positioner: Positioner, get, folder: Path) -> FocalPlane:
    """Make the focal plane from the table or lattice in the section ``layout``."""
    if get("layout.table") is not None:
        refuse_unused(get, ONLY_MODULES, "with a table")
        return FocalPlane.from_table(read_table(folder / get("layout.table")), positioner)
    if has_modules(get):
        plane, n = layout_of_modules(positioner, get, folder), get("layout.spectrographs")
        if not isinstance(n, int):
            return plane
        groups = _groups(plane.xy.to_value(u.mm), n, get("layout.spectrograph_shape", "blocks"))
        return replace(plane, spectrograph=groups)
    refuse_unused(get, ONLY_MODULES, "without modules")
    if get("layout.spectrographs") == "one a module":
        raise InputError("layout.spectrographs must not be 'one a module' without modules")
    if get("layout.pitch") is None or (get("layout.rings") is None) == (get("layout.count") is None):
        raise InputError("[layout] must have a table, or a pitch with either rings or count")
    fiducials = get("layout.fiducial_cells", [])
    shape = {
        "pitch": get("layout.pitch"),
        "rings": get("layout.rings"),
        "count": get("layout.count"),
        "inner_radius": get("layout.inner_radius", 0 * u.mm),
        "vacant": [*fiducials, *get("layout.vacant_cells", [])],
        "rows_along": get("layout.rows_along", "x"),
    }
    xy, cells = hexagonal_cells(**shape)
    columns = {}
    if get("layout.names") == "row and column":
        columns["id"] = _hole_names(cells, get("layout.rings"))
    if get("layout.names") == "cobra":
        columns["id"] = cobra_ids(xy)
    if get("layout.fiber_types"):
        few = {tuple(c) for c in get("layout.first_type_only_cells", [])}
        first, *_ = types = get("layout.fiber_types")
        columns["fiber_type"] = np.array([first if tuple(c) in few else "+".join(types) for c in cells.tolist()])
        if get("layout.spectrographs") == "one a fiber type":
            columns["spectrograph"] = np.tile(np.arange(len(types)), (len(xy), 1))
    if isinstance(get("layout.spectrographs"), int):
        columns["spectrograph"] = _groups(xy, get("layout.spectrographs"), get("layout.spectrograph_shape", "blocks"))
    if fiducials:
        circles = cell_centers(*np.transpose(fiducials), shape["pitch"].to_value(u.mm), shape["rows_along"])
        radius = get("layout.fiducial_radius").to_value(u.mm)
        columns["obstacles"] = np.column_stack([circles, np.full(len(circles), radius)]) * u.mm
    return FocalPlane(xy * u.mm, positioner, **columns)


def _hole_names(cells, rings):
    """Return names of cells such as R+10C1, made of a signed row number and a column number counted from the left."""
    names = []
    for q, k in cells.tolist():
        row = f"{k:+d}" if k else "0"
        names.append(f"R{row}C{q - max(-rings, -rings - k) + 1}")
    return np.array(names)


def _groups(xy, n_groups, shape):
    """Return the spectrograph of each positioner; the positioners of a spectrograph form a wedge or a block.

    All spectrographs have almost the same number of positioners. Blocks are made by repeated division of the
    positioners into two groups.
    """
    if not 1 <= n_groups <= len(xy):
        raise InputError(f"spectrographs must be a number from 1 to the number of positioners, got {n_groups}")
    group = np.empty(len(xy), dtype=int)
    if shape == "wedges":
        order = np.lexsort((np.hypot(*xy.T), np.round(np.mod(np.arctan2(xy[:, 1], xy[:, 0]), 2 * np.pi), 9)))
        for g, rows in enumerate(np.array_split(order, n_groups)):
            group[rows] = g
        return group
    todo = [(np.arange(len(xy)), 0, n_groups)]
    while todo:
        rows, first, n = todo.pop()
        if n == 1:
            group[rows] = first
            continue
        axis = int(np.ptp(xy[rows, 1]) > np.ptp(xy[rows, 0]))
        order = rows[np.lexsort((xy[rows, 1 - axis], np.round(xy[rows, axis], 9)))]
        left = n // 2
        cut = round(len(rows) * left / n)
        todo += [(order[:cut], first, left), (order[cut:], first + left, n - left)]
    return group
