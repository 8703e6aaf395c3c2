"""Option spellings of version 0.2, which are rewritten before the command line is parsed."""

from collections.abc import Callable
from shlex import quote

from rfpsurvey._cli._keys import Key, Part
from rfpsurvey._readers import is_number
from rfpsurvey.errors import warn

__all__ = ["rewritten"]


def _circle(text: str) -> tuple[str, str]:
    return "options.constraints", f"keep_out {text.replace(',', ' ').strip().removeprefix('cap').strip()}"


def _requirement(text: str) -> tuple[str, str]:
    return ("options.requirements" if text == "instrument" else "options.constraints"), text


def _column(text: str) -> tuple[str, str]:
    """Return the epoch of all rows for text such as ``epoch=J2016``, which names no column."""
    value = text.removeprefix("epoch=J")
    is_epoch = value != text and value.replace(".", "", 1).isdigit()
    return ("catalog.epoch", f"J{value}") if is_epoch else ("catalog.columns", text)


def _targets(text: str) -> tuple[str, str]:
    """Return the number of targets per positioner for a number, and otherwise the coloring of the targets in a plot."""
    return "targets_per_positioner" if is_number(text) else "output.targets", text


FLAGS = {
    "--kept": ("lost_in_collision", "false"),
    "--lost": ("lost_in_collision", "true"),
    "--parked": ("options.parked_obstacles parked_obstacles", "true"),
    "--no-parked": ("options.parked_obstacles parked_obstacles", "false"),
    "--no-overwrite": ("output.overwrite", "false"),
    "--no-resume": ("output.resume", "false"),
    "--processes": ("processes", "true"),
    "--skip-missing": ("missing", "skip"),
}
"""Options without a value: the names that their key can have, and the value."""
OPTIONS: dict[str, str | Callable[[str], tuple[str, str]]] = {
    "--column": _column,
    "--keep-out": _circle,
    "--require": _requirement,
    "--required": lambda text: ("options.constraints", f"required {quote(text)}"),
    "--pa": "position_angle tiles.position_angle",
    "--seed": "rng",
    "--pass": "tiles.passes",
    "--realizations": "n_realizations",
    "--order": "order",
    "--targets": _targets,
    "--unit": "catalog.units",
    "--hdu": "catalog.hdu",
    "--fill": "catalog.fill",
    "--keep": "catalog.keep",
    "--frame": "catalog.frame",
    "--tiles-column": "tiles.columns",
    "--tiles-unit": "tiles.units",
    "--tiles-hdu": "tiles.hdu",
    "--conditions": "conditions.path",
    "--joint-gap": "joint.gap",
    "--joint-iterations": "joint.iterations",
    "--joint-time": "joint.time_limit",
    "--fixed": "joint.fixed",
    "--time-limit": "options.time_limit loss.time_limit",
    "--declination": "tiles.declination",
    "--select": "catalog.select",
    "--n-targets": "targets.number",
    "--target-radius": "targets.radius",
    "--min-separation": "targets.min_separation",
    **{
        f"--{name.replace('_', '-')}": f"{table}.{name}"
        for table, names in {
            "instrument": "arm_model broken state_time margins",
            "conditions": "site time hour_angle wavelength exposure_time",
            "options": "sky_separation objective subpriority",
            "output": "quality",
            "loss": "target_density n_skies",
        }.items()
        for name in names.split()
    },
    **{f"--{name}": name for name in ("equinox", "projection", "scheduler", "fibers", "radius", "exclude", "dynamic")},
}
"""Options with a value: the names that their key can have, or a function that returns these names and the new value."""


def rewritten(words: list[str], keys: dict[str, Key | Part], options: dict[str, str], n_values: dict[str, int]):
    """Return the words of a command line in which old options are replaced.

    ``options`` contains the option of each key that has one, and ``n_values`` the number of values of each option.
    """
    rest, found, warned = list(words), [], set()
    while rest and rest[0] != "--":
        word = rest.pop(0)
        name, sign, value = word.partition("=")
        n = n_values.get(name, 0 if name in FLAGS else 2 if name == "--declination" else 1 if name in OPTIONS else 0)
        given = [value] if sign else [rest.pop(0) for _ in range(min(n, len(rest)))]
        new = _replaced(name, given, keys, options, is_known=name in n_values)
        if new is None:
            found += [word] if sign else [word, *given]
            continue
        if name not in warned:
            shown = " ".join(f"'{one}'" if " " in one else one for one in new)
            warn(f"{name} will not be accepted by the next version; write {shown}")
        warned.add(name)
        found += new
    return found + rest


def _replaced(name: str, given: list[str], keys: dict, options: dict[str, str], *, is_known: bool) -> list[str] | None:
    """Return the words that replace an option and its values; None if the option is not replaced."""
    target = FLAGS.get(name) or OPTIONS.get(name)
    if target is None or (is_known and target is not _column) or (name in OPTIONS and not given):
        return None
    value = given[0] if len(given) == 1 else f"[{', '.join(given)}]"
    names, value = target if name in FLAGS else target(value) if callable(target) else (target, value)
    key = next((one for one in names.split() if one in keys), None)
    if key is None or (is_known and key == "catalog.columns"):
        return None
    if key in options and name not in FLAGS:
        return [options[key], value]
    is_entry = isinstance(keys[key], Key) and dict in keys[key].kinds and "=" in value
    return ["--set", f"{key}{'.' if is_entry else '='}{value}"]
