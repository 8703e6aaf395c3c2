"""Check the entries of an instrument's description; for example, the entry ``central_arm`` must be a length."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isfinite

import astropy.units as u
import numpy as np

from rfpsurvey._instruments.outline import ArmOutline
from rfpsurvey._instruments.positioner import ARM_MODELS, HANDEDNESS
from rfpsurvey.errors import InputError, check_choice, listed

STATUSES = ("published", "derived", "assumed")
PARTS = ("value", "unit", "status", "source")
NEED = re.compile(r"observing\.(?:(\w+)_)??(sky|standards)(_per_spectrograph)?")


@dataclass(frozen=True)
class Kind:
    """The kind of value that an entry must have."""

    what: str  # text that follows "must be" in error messages
    fits: Callable[[object], bool]
    unit: u.UnitBase | None = None


def _number(low: float = -inf, high: float = inf) -> Callable:
    """Return the function that states whether a value is a number from ``low`` to ``high``."""
    return lambda value: (
        isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value) and low <= value <= high
    )


def _whole(low: float = -inf, high: float = inf) -> Callable:
    """Return the function that states whether a value is a whole number from ``low`` to ``high``."""
    return lambda value: isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def _is_text(value: object) -> bool:
    return isinstance(value, str) and bool(value.strip())


def _list(fits: Callable, least: int = 0, most: float = inf) -> Callable:
    """Return the function that states whether a value is a list of ``least`` to ``most`` values that fit."""
    return lambda value: isinstance(value, list) and all(map(fits, value)) and least <= len(value) <= most


def _table(fits: Callable, least: int = 1) -> Callable:
    """Return the function that states whether a value is a table with any keys, whose values fit."""
    return lambda value: isinstance(value, dict) and all(map(fits, value.values())) and least <= len(value)


def _keys(needed: dict[str, Callable], **optional: Callable) -> Callable:
    """Return the function that states whether a value is a table with given keys, each of which has its function."""
    known = needed | optional

    def fits(value: object) -> bool:
        has_keys = isinstance(value, dict) and needed.keys() <= value.keys() <= known.keys()
        return has_keys and all(known[name](part) for name, part in value.items())

    return fits


def _either(*fits: Callable) -> Callable:
    """Return the function that states whether a value fits one of several functions."""
    return lambda value: any(fit(value) for fit in fits)


def _choice(*names: str) -> Kind:
    return Kind(f"one of {', '.join(names)}", lambda value: isinstance(value, str) and value in names)


def _count(low: int, high: int) -> Kind:
    return Kind(f"a whole number from {low} to {high}", _whole(low, high))


def _by_program(what: str, fits: Callable, unit: u.UnitBase | None = None) -> Kind:
    return Kind(f"{what}, or a table of such values for programs", _either(fits, _table(fits)), unit)


def _is_table(value: object) -> bool:
    return isinstance(value, dict)


def _has_id(value: object) -> bool:
    return _is_table(value) and "id" in value


def _is_range(value: object) -> bool:
    return IS_POINT(value) and value[0] < value[1]


TINY, MOST = 1e-300, 1e12  # limits of positive numbers
IS_POINT, POSITIVE = _list(_number(), 2, 2), _number(TINY)
IS_LENGTH, IS_CELL = _number(TINY, MOST), _list(_whole(-1000, 1000), 2, 2)
IS_POLYGON = _list(IS_POINT, 3)
IS_PARTS = _list(_keys({"vertices": _list(IS_POINT, 1)}, radius=_number(0)))
IS_MAP = _keys({"form": _is_text, "coefficients": _list(_number(), 1, 100)}, radius=POSITIVE, unit_tangent=POSITIVE)
LENGTH = Kind("a length above 0", IS_LENGTH, u.mm)
CLOSED_LENGTH = Kind("a length of at least 0", _number(0, MOST), u.mm)
ANGLES = Kind("two angles", IS_POINT, u.rad)
RANGE = Kind("two angles, of which the first is below the second", _is_range, u.rad)
SPEED = Kind("an angular speed above 0", IS_LENGTH, u.rad / u.s)
CELLS = Kind("a list of pairs of whole numbers", _list(IS_CELL))
OUTLINE = Kind(
    "a table with the key eccentric (and, optionally, central); each key has a list of parts, and each part has "
    "vertices (and, optionally, a radius of at least 0)",
    _keys({"eccentric": IS_PARTS}, central=IS_PARTS),
    u.mm,
)
TEXT = Kind("text", _is_text)
POSITIVE_NUMBER = Kind("a number above 0", _number(TINY, MOST))
SECTION_ENTRIES = {
    "positioner": {
        **dict.fromkeys(("central_arm", "eccentric_arm"), LENGTH),
        **dict.fromkeys(("clearance", "segment_clearance", "displacement", "arm_length"), CLOSED_LENGTH),
        **dict.fromkeys(("theta_range", "phi_range", "home"), ANGLES),
        **dict.fromkeys(("outline", "full_outline"), OUTLINE),
        "step": Kind("an angle of at least 0", _number(0, MOST), u.rad),
        "handedness": _choice(*HANDEDNESS),
        "arm_model": _choice(*ARM_MODELS),
        "arm_angle": Kind(
            "an angle, or a table with an angle for each fiber type", _either(_number(), _table(_number())), u.rad
        ),
    },
    "motion": {
        **dict.fromkeys(("theta_range", "phi_range"), RANGE),
        **dict.fromkeys(("theta_speed", "phi_speed"), SPEED),
    },
    "margins": {
        **dict.fromkeys(("outer", "inner", "arms", "broken"), CLOSED_LENGTH),
        "broken_factor": Kind("a number of at least 0", _number(0, MOST)),
        "hidden_factor": Kind("a number of at least 1", _number(1, MOST)),
    },
    "layout": {
        **dict.fromkeys(("pitch", "module_wall", "module_side", "group_radius", "module_radius"), LENGTH),
        **dict.fromkeys(("inner_radius", "fiducial_radius", "module_gap", "group_gap"), CLOSED_LENGTH),
        **dict.fromkeys(("vacant_cells", "fiducial_cells", "first_type_only_cells"), CELLS),
        "table": TEXT,
        "states": Kind("the name of a file, or a list of tables with the key id", _either(_is_text, _list(_has_id, 1))),
        "rings": _count(0, 500),
        "count": _count(1, 1_000_000),
        "rows_along": _choice("x", "y"),
        "obstacle_polygons": Kind(
            "a list of polygons, which are lists of at least three points", _list(IS_POLYGON, 1), u.mm
        ),
        "modules": Kind(
            "the name of a file, or a list of modules [x, y, rotation] in mm and deg",
            _either(_is_text, _list(_list(_number(), 3, 3), 1)),
        ),
        "module_rows": _count(1, 200),
        "module_corners": _choice("vacant", "used"),
        "module_places": Kind("a list of points", _list(IS_POINT, 1), u.mm),
        "module_outline": Kind("a list of at least three points", IS_POLYGON, u.mm),
        "module_classes": Kind(
            "a table whose keys are fiber types and whose values are tables with places (numbers from 1), central_arm "
            "and eccentric_arm (mm)",
            _table(_keys({}, places=_list(_whole()), central_arm=IS_LENGTH, eccentric_arm=IS_LENGTH)),
        ),
        "focal_surface": Kind(
            "a radius of curvature above 0, or a list of at least three points [R, Z]",
            _either(IS_POLYGON, POSITIVE),
            u.mm,
        ),
        "names": _choice("row and column", "cobra"),
        "fiber_types": Kind("a list of names", _list(_is_text, 1)),
        "spectrographs": Kind(
            "a whole number from 1 to 1000000, or 'one a fiber type' or 'one a module'",
            _either(_whole(1, 1_000_000), ("one a fiber type", "one a module").__contains__),
        ),
        "spectrograph_shape": _choice("blocks", "wedges"),
    },
    "optics": {
        "plate_scale": Kind("a positive length per angle", IS_LENGTH, u.mm / u.rad),
        "max_angle": Kind("an angle above 0", IS_LENGTH, u.rad),
        "fiber_diameter": LENGTH,
        "factor": POSITIVE_NUMBER,
        "radial_map": Kind(
            "a table whose keys are fiber types (or the single key any) and whose values are tables with form and "
            "coefficients (and, optionally, radius and unit_tangent above 0)",
            _table(IS_MAP),
        ),
    },
    "observing": {"targets_per_fiber": POSITIVE_NUMBER},
    "light": {
        "band": Kind("two wavelengths, or two for each fiber type", _either(_is_range, _table(_is_range)), u.um),
        "wavelength": Kind("a wavelength, or one for each fiber type", _either(IS_LENGTH, _table(IS_LENGTH)), u.um),
        "guide_wavelength": Kind("a wavelength above 0", IS_LENGTH, u.um),
        "dispersion_compensator": _choice("yes", "no", "unknown"),
        "guider_removes": Kind("a list of names", _list(_is_text, 1)),
    },
    "night": {
        "site": TEXT,
        "exposure_time": _by_program("a time above 0", IS_LENGTH, u.s),
        "overhead": _by_program("a time of at least 0", _number(0, MOST), u.s),
        "airmass_exponent": _by_program("a number from 0 to 10", _number(0, 10)),
        "max_airmass": _by_program("a number of at least 1", _number(1, MOST)),
        "moon_illumination": _by_program("a number from 0 to 1", _number(0, 1)),
        **dict.fromkeys(
            ("min_altitude", "max_altitude", "hour_angle", "sun_altitude", "moon_separation", "moon_altitude"),
            _by_program("an angle", _number(-MOST, MOST), u.rad),
        ),
    },
}
ENTRIES = {f"{section}.{name}": kind for section, kinds in SECTION_ENTRIES.items() for name, kind in kinds.items()}
OBSERVING = _count(0, 1_000_000)
NEEDS = ("sky", "standards", "sky_per_spectrograph", "standards_per_spectrograph")
DEFAULTS = ("status", "source")
"""Keys of entries for which a description may set a default value at the top of the file."""
RULES = "rules"
"""Name of the section with the rules of the observatory, which contains a section for each name of rules."""
RULE = Kind("the text of a constraint, or a list of such texts", _either(_is_text, _list(_is_text, 1)))
CAMERAS = "cameras"
"""Name of the section with the guide and focus cameras, whose entries have the names of the cameras."""
CAMERA = Kind(
    "the corners of a camera, which are at least three points that do not lie on a line",
    lambda value: IS_POLYGON(value) and np.linalg.matrix_rank(np.subtract(value, value[0]), 1e-6) == 2,
    u.mm,
)
SECTIONS = (*SECTION_ENTRIES, CAMERAS)
TABLE = Kind("a table", _is_table)
WORDS = Kind("text", lambda value: isinstance(value, str))
TOP = {
    "schema": Kind("1, the only schema that this version of rfpsurvey reads", _whole(1, 1)),
    "name": TEXT,
    "title": WORDS,
    "layout_is": WORDS,
    "notes": WORDS,
    "inherits": TEXT,
    "status": _choice(*STATUSES),
    "source": TEXT,
    "sources": Kind(
        "a table whose values are text (for a single text, write source instead of sources)", _table(_is_text, 0)
    ),
    RULES: Kind("a table of tables", _table(_is_table, 0)),
    **dict.fromkeys(SECTIONS, TABLE),
}


def sections_of(content: dict) -> dict[str, dict]:
    """Return the sections of a description that contain entries, by name, such as ``optics`` or ``rules.dark``."""
    rules = {f"{RULES}.{name}": entries for name, entries in content.get(RULES, {}).items()}
    return {name: content.get(name, {}) for name in SECTIONS} | rules


def select_entries(values: dict, beginning: str) -> dict:
    """Return the entries whose names have a beginning, such as ``positioner.``, by the rests of their names."""
    return {name.removeprefix(beginning): entry for name, entry in values.items() if name.startswith(beginning)}


def value_of(entry: dict) -> object:
    """Return the value of an entry: an outline, a quantity, a dict of quantities, or a plain value."""
    value, unit = entry["value"], u.Unit(entry.get("unit", ""))
    if isinstance(value, dict) and isinstance(value.get("eccentric"), list):
        return ArmOutline.from_dict(value, unit)
    if "unit" not in entry:
        return value
    return {kind: number * unit for kind, number in value.items()} if isinstance(value, dict) else value * unit


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
    home = [section for section, kinds in SECTION_ENTRIES.items() if name in kinds]
    if name in TOP:
        raise InputError(
            f"[{section}] must not have the entry {name!r}, which belongs at the top of the file, before all sections"
        )
    if home:
        raise InputError(f"[{section}] must not have the entry {name!r}, which belongs in [{home[0]}]")
    known = {*SECTION_ENTRIES.get(section, ()), *(NEEDS if section == "observing" else ())}
    check_choice(name, known, f"entry of [{section}]")


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
