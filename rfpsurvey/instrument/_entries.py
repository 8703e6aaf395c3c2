"""Check the entries of an instrument's description; for example, the entry ``central_arm`` must be a length."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isfinite

import astropy.units as u
import numpy as np

from rfpsurvey.errors import InputError, check_choice, listed
from rfpsurvey.positioner import ARM_MODELS, HANDEDNESS

STATUSES = ("published", "derived", "assumed")
PARTS = ("value", "unit", "status", "source")
NEED = re.compile(r"observing\.(?:(\w+)_)??(sky|standards)(_per_spectrograph)?")
SCALE = u.mm / u.rad
MOST_NUMBER = 1e12


@dataclass(frozen=True)
class Kind:
    """The kind of value that an entry must have."""

    what: str
    """Text that follows "must be" in error messages."""
    fits: Callable[[object], bool]
    unit: u.UnitBase | None = None


def _is_number(value, low=-inf, high=inf) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value) and low <= value <= high


def _is_whole(value, low=-inf, high=inf) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def _is_text(value) -> bool:
    return isinstance(value, str) and bool(value.strip())


def _is_list(value, fits, n=None) -> bool:
    return isinstance(value, list) and all(map(fits, value)) and (n is None or len(value) == n)


def _number(what, low=-inf, high=MOST_NUMBER, unit=None) -> Kind:
    return Kind(what, lambda value: _is_number(value, low, high), unit)


def _whole(low, high) -> Kind:
    return Kind(f"a whole number from {low} to {high}", lambda value: _is_whole(value, low, high))


def _choice(*names) -> Kind:
    return Kind(f"one of {', '.join(names)}", lambda value: isinstance(value, str) and value in names)


def _is_point(value) -> bool:
    return _is_list(value, _is_number, 2)


def _is_class(value) -> bool:
    return (
        isinstance(value, dict)
        and set(value) <= {"places", "central_arm", "eccentric_arm"}
        and _is_list(value.get("places", []), _is_whole)
        and all(_is_number(length, TINY, MOST_NUMBER) for name, length in value.items() if name != "places")
    )


def _is_map(value) -> bool:
    if not isinstance(value, dict) or not set(value) <= {"form", "coefficients", "radius", "unit_tangent"}:
        return False
    numbers = [value[name] for name in ("radius", "unit_tangent") if name in value]
    coefficients = value.get("coefficients")
    return (
        _is_text(value.get("form"))
        and _is_list(coefficients, _is_number)
        and 0 < len(coefficients) <= 100
        and all(_is_number(number, 1e-300) for number in numbers)
    )


def _is_outline(value) -> bool:
    return (
        isinstance(value, dict)
        and {"eccentric"} <= set(value) <= {"eccentric", "central"}
        and all(_is_list(parts, _is_part) for parts in value.values())
    )


def _is_part(value) -> bool:
    return (
        isinstance(value, dict)
        and {"vertices"} <= set(value) <= {"vertices", "radius"}
        and _is_list(value["vertices"], _is_point)
        and len(value["vertices"]) > 0
        and _is_number(value.get("radius", 0), 0)
    )


TINY = 1e-300  # lower limit of positive numbers
LENGTH = _number("a length above 0", TINY, unit=u.mm)
CLOSED_LENGTH = _number("a length of at least 0", 0, unit=u.mm)
ANGLES = Kind("two angles", _is_point, u.rad)
CELLS = Kind(
    "a list of pairs of whole numbers",
    lambda value: _is_list(value, lambda cell: _is_list(cell, lambda k: _is_whole(k, -1000, 1000), 2)),
)
OUTLINE = Kind(
    "a table with the key eccentric (and, optionally, central); each key has a list of parts, and each part has "
    "vertices (and, optionally, a radius of at least 0)",
    _is_outline,
    u.mm,
)
POINTS = Kind("a list of at least three points", lambda value: _is_list(value, _is_point) and len(value) > 2, u.mm)
TEXT = Kind("text", _is_text)
STATES = Kind(
    "the name of a file, or a list of tables with the key id",
    lambda value: _is_text(value) or (_is_list(value, lambda row: isinstance(row, dict) and "id" in row) and value),
)
NAMES = Kind("a list of names", lambda value: _is_list(value, _is_text) and len(value) > 0)
ENTRIES = {
    "positioner.central_arm": LENGTH,
    "positioner.eccentric_arm": LENGTH,
    "positioner.clearance": CLOSED_LENGTH,
    "positioner.segment_clearance": CLOSED_LENGTH,
    "positioner.step": _number("an angle of at least 0", 0, unit=u.rad),
    "positioner.handedness": _choice(*HANDEDNESS),
    "positioner.theta_range": ANGLES,
    "positioner.phi_range": ANGLES,
    "positioner.home": ANGLES,
    "positioner.displacement": CLOSED_LENGTH,
    "positioner.arm_model": _choice(*ARM_MODELS),
    "positioner.arm_length": CLOSED_LENGTH,
    "positioner.arm_angle": Kind(
        "an angle, or a table with an angle for each fiber type",
        lambda value: (
            _is_number(value) or (isinstance(value, dict) and len(value) > 0 and all(map(_is_number, value.values())))
        ),
        u.rad,
    ),
    "positioner.outline": OUTLINE,
    "positioner.full_outline": OUTLINE,
    "layout.obstacle_polygons": Kind(
        "a list of polygons, which are lists of at least three points",
        lambda value: _is_list(value, POINTS.fits) and len(value) > 0,
        u.mm,
    ),
    "margins.outer": CLOSED_LENGTH,
    "margins.inner": CLOSED_LENGTH,
    "margins.arms": CLOSED_LENGTH,
    "margins.broken": CLOSED_LENGTH,
    "margins.broken_factor": _number("a number of at least 0", 0),
    "margins.hidden_factor": _number("a number of at least 1", 1),
    "layout.table": TEXT,
    "layout.states": STATES,
    "layout.rings": _whole(0, 500),
    "layout.count": _whole(1, 1_000_000),
    "layout.pitch": LENGTH,
    "layout.inner_radius": CLOSED_LENGTH,
    "layout.rows_along": _choice("x", "y"),
    "layout.vacant_cells": CELLS,
    "layout.fiducial_cells": CELLS,
    "layout.fiducial_radius": CLOSED_LENGTH,
    "layout.modules": Kind(
        "the name of a file, or a list of modules [x, y, rotation] in mm and deg",
        lambda value: _is_text(value) or (_is_list(value, lambda row: _is_list(row, _is_number, 3)) and len(value) > 0),
    ),
    "layout.module_rows": _whole(1, 200),
    "layout.module_corners": _choice("vacant", "used"),
    "layout.module_places": Kind("a list of points", lambda value: _is_list(value, _is_point) and len(value) > 0, u.mm),
    "layout.module_outline": POINTS,
    "layout.module_wall": LENGTH,
    "layout.module_classes": Kind(
        "a table whose keys are fiber types and whose values are tables with places (numbers from 1), central_arm and "
        "eccentric_arm (mm)",
        lambda value: isinstance(value, dict) and len(value) > 0 and all(map(_is_class, value.values())),
    ),
    "layout.module_side": LENGTH,
    "layout.module_gap": CLOSED_LENGTH,
    "layout.group_gap": CLOSED_LENGTH,
    "layout.group_radius": LENGTH,
    "layout.module_radius": LENGTH,
    "layout.focal_surface": Kind(
        "a radius of curvature above 0, or a list of at least three points [R, Z]",
        lambda value: POINTS.fits(value) or _is_number(value, TINY),
        u.mm,
    ),
    "layout.names": _choice("row and column", "cobra"),
    "layout.fiber_types": NAMES,
    "layout.first_type_only_cells": CELLS,
    "layout.spectrographs": Kind(
        "a whole number from 1 to 1000000, or 'one a fiber type' or 'one a module'",
        lambda value: _is_whole(value, 1, 1_000_000) or value in ("one a fiber type", "one a module"),
    ),
    "layout.spectrograph_shape": _choice("blocks", "wedges"),
    "optics.plate_scale": _number("a positive length per angle", TINY, 1e12, SCALE),
    "optics.max_angle": _number("an angle above 0", TINY, unit=u.rad),
    "optics.fiber_diameter": LENGTH,
    "optics.factor": _number("a number above 0", TINY),
    "optics.radial_map": Kind(
        "a table whose keys are fiber types (or the single key any) and whose values are tables with form and "
        "coefficients (and, optionally, radius and unit_tangent above 0)",
        lambda value: isinstance(value, dict) and len(value) > 0 and all(map(_is_map, value.values())),
    ),
    "observing.targets_per_fiber": _number("a number above 0", TINY),
}
OBSERVING = _whole(0, 1_000_000)
NEEDS = ("sky", "standards", "sky_per_spectrograph", "standards_per_spectrograph")
DEFAULTS = ("status", "source")
"""Keys of entries for which a description may set a default value at the top of the file."""
RULES = "rules"
"""Name of the section with the rules of the observatory, which contains a section for each name of rules."""
RULE = Kind(
    "the text of a constraint, or a list of such texts",
    lambda value: _is_text(value) or (_is_list(value, _is_text) and len(value) > 0),
)
CAMERAS = "cameras"
"""Name of the section with the guide and focus cameras, whose entries have the names of the cameras."""
CAMERA = Kind(
    "the corners of a camera, which are at least three points that do not lie on a line",
    lambda value: POINTS.fits(value) and np.linalg.matrix_rank(np.subtract(value, value[0]), 1e-6) == 2,
    u.mm,
)
SECTIONS = ("positioner", "margins", "layout", "optics", "observing", CAMERAS)
TABLE = Kind("a table", lambda value: isinstance(value, dict))
WORDS = Kind("text", lambda value: isinstance(value, str))
TOP = {
    "schema": Kind("1, the only schema that this version of rfpsurvey reads", lambda value: _is_whole(value, 1, 1)),
    "name": TEXT,
    "title": WORDS,
    "layout_is": WORDS,
    "notes": WORDS,
    "inherits": TEXT,
    "status": _choice(*STATUSES),
    "source": TEXT,
    "sources": Kind(
        "a table whose values are text (for a single text, write source instead of sources)",
        lambda value: isinstance(value, dict) and all(map(_is_text, value.values())),
    ),
    RULES: Kind("a table of tables", lambda value: isinstance(value, dict) and all(map(TABLE.fits, value.values()))),
    **dict.fromkeys(SECTIONS, TABLE),
}


def sections_of(content: dict) -> dict[str, dict]:
    """Return the sections of a description that contain entries, by name, such as ``optics`` or ``rules.dark``."""
    rules = {f"{RULES}.{name}": entries for name, entries in content.get(RULES, {}).items()}
    return {name: content.get(name, {}) for name in SECTIONS} | rules


def with_defaults(content: dict) -> dict:
    """Return a description in which entries without status or source have the values from the top of the file."""
    defaults = {part: content[part] for part in DEFAULTS if part in content}
    for part, value in defaults.items():
        if not TOP[part].fits(value):
            raise InputError(f"{part} must be {TOP[part].what}, got {_short(value)}")
    filled = {name: value for name, value in content.items() if name not in DEFAULTS}

    def complete(section: object) -> object:
        if not isinstance(section, dict):
            return section
        return {name: {**defaults, **entry} if isinstance(entry, dict) else entry for name, entry in section.items()}

    filled |= {section: complete(filled[section]) for section in SECTIONS if section in filled}
    if isinstance(filled.get(RULES), dict):
        filled[RULES] = {name: complete(section) for name, section in filled[RULES].items()}
    return filled


def check_description(content: dict) -> None:
    """Raise an error if an entry of a description is not valid."""
    if "name" not in content:
        raise InputError("name must be text, got no such entry")
    for name, value in content.items():
        check_choice(name, TOP, "section or entry")
        if not TOP[name].fits(value):
            raise InputError(f"{name} must be {TOP[name].what}, got {_short(value)}")
    for name in content.get(RULES, {}):
        if "." in name:
            raise InputError(f"the names of rules must contain no dot, got {name!r}")
    for section, entries in sections_of(content).items():
        for name, entry in entries.items():
            _check_entry(section, name, entry)


def _check_entry(section: str, name: str, entry: object) -> None:
    full = f"{section}.{name}"
    kind = OBSERVING if NEED.fullmatch(full) else ENTRIES.get(full)
    kind = RULE if section.startswith(f"{RULES}.") else CAMERA if section == CAMERAS else kind
    if kind is None:
        _refuse_name(section, name)
    if not isinstance(entry, dict):
        raise InputError(
            f"{full} must be a table with value, status and source, got {_short(entry)}; write {_example(kind, entry)}"
        )
    for part in entry:
        check_choice(part, PARTS, f"key of {full}")
    for part in ("value", "status", "source"):
        if part not in entry:
            remedy = f'; {part} = "..." at the top of the file applies to all entries without a {part}'
            remedy = remedy if part in DEFAULTS else ""
            remedy += f"; the status is one of {', '.join(STATUSES)}" if part == "status" else ""
            raise InputError(f"{full} must have a {part}, got only {listed(entry)}{remedy}")
    check_choice(entry["status"], STATUSES, f"status of {full}")
    if not _is_text(entry["source"]):
        raise InputError(f"the source of {full} must be text, got {_short(entry['source'])}")
    value, unit = entry["value"], _unit(full, kind, entry)
    if not kind.fits(value):
        raise InputError(f"{full} must be {kind.what}, got {_short(value)}{'' if unit is None else f' {unit}'}")


def _refuse_name(section: str, name: str) -> None:
    """Raise an error for an unknown name in a section; the message contains a similar name or the correct section."""
    home = [other for other in SECTIONS if f"{other}.{name}" in ENTRIES]
    if name in TOP:
        raise InputError(
            f"[{section}] must not have the entry {name!r}, which belongs at the top of the file, before all sections"
        )
    if home:
        raise InputError(f"[{section}] must not have the entry {name!r}, which belongs in [{home[0]}]")
    known = {key.partition(".")[2] for key in ENTRIES if key.startswith(f"{section}.")}
    check_choice(name, known | set(NEEDS if section == "observing" else ()), f"entry of [{section}]")


def _example(kind: Kind, value: object) -> str:
    """Return the text of an entry as it is written in a file."""
    plain = isinstance(value, int | float if kind.unit else int | float | str) and not isinstance(value, bool)
    shown = _short(value) if plain else "..."
    unit = "" if kind.unit is None else f', unit = "{kind.unit}"'
    return f'{{ value = {shown}{unit}, status = "assumed", source = "..." }}'


def _unit(full: str, kind: Kind, entry: dict) -> object:
    """Return the unit of an entry; raise an error if it cannot be converted to the required unit."""
    given = entry.get("unit")
    if kind.unit is None:
        if given is not None:
            raise InputError(f"{full} must have no unit, got {_short(given)}")
        return None
    try:
        fits = isinstance(given, str) and u.Unit(given).is_equivalent(kind.unit)
    except (ValueError, TypeError):
        fits = False
    if not fits:
        got = f'none; write unit = "{kind.unit}"' if given is None else _short(given)
        raise InputError(f"the unit of {full} must be convertible to {kind.unit}, got {got}")
    return given


def _short(value: object) -> str:
    text = "no such entry" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
