"""Plugins: functions that a user provides, and objects from other packages, which are imported on first use."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import entry_points

from rfpsurvey.errors import InputError, InputTypeError, check_choice, short


@dataclass(frozen=True)
class Plugin:
    """A plugin: an object from another package, or a function that a user provides."""

    what: str
    name: str
    value: object
    package: str = ""  # name of the distribution of the plugin; empty for a function that a user provides
    version: str = ""
    place: str = ""  # module and name of the object in the package, as stated by the entry point

    def __str__(self):
        origin = f" of {self.package} {self.version} ({self.place})" if self.package else ""
        return f"the {self.what} {self.name!r}{origin}"

    @property
    def software(self) -> dict[str, str]:
        """Name and version of the plugin's distribution, in the form in which results record them.

        The dictionary is empty if the plugin is a function that a user provides.
        """
        return {self.package: self.version} if self.package else {}

    @contextmanager
    def answering(self) -> Iterator[None]:
        """Convert an exception of the plugin to an InputError that names the plugin."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self}: {error}") from error
        except (Exception, SystemExit) as error:  # plugins can raise any exception, and must not end the program
            raise InputError(f"{self} failed: {type(error).__name__}: {error}") from error


def plugin_names(group: str) -> set[str]:
    """Return the names in a group of entry points, without importing any plugin."""
    return entry_points(group=group).names


def find_plugin(group: str, name: object, known: Iterable[str], what: str) -> Plugin:
    """Return the plugin with a given name.

    If the name is unknown, the error message lists the names of all plugins and the built-in names ``known``.
    """
    if isinstance(name, str):
        with suppress(LookupError):
            return _load(group, name, what)
    also = ", or a TOML file" if what == "instrument" else ""
    return _load(group, check_choice(name, {*known, *plugin_names(group)}, what, also=also), what)


def find_function(group: str, given: object, known: Iterable[str], what: str) -> Plugin:
    """Return the plugin with a given name, or make a plugin from a given function."""
    if isinstance(given, type):
        raise InputTypeError(f"the {what} must be a name or a function, got {short(given)}")
    if callable(given):
        return Plugin(what, name_of(given), given)
    plugin = find_plugin(group, given, known, what)
    if not callable(plugin.value):
        raise InputError(f"{plugin} must be a function, got {type(plugin.value).__name__}")
    return plugin


def name_of(given: str | Callable) -> str:
    """Return a given name, or the module and name of a given function as ASCII text, which results can record."""
    if not callable(given):
        return given
    definition = given if hasattr(given, "__qualname__") else type(given)
    return ascii(f"{definition.__module__}.{definition.__qualname__}")[1:-1]


def recorded_name(group: str, known: Iterable[str], name: str, parameter: str) -> str:
    """Return a name in a record; raise an error if it is neither known nor the name of a plugin, but of a function."""
    if name in known or name in plugin_names(group):
        return name
    raise InputError(
        f"{parameter} must be given as an argument of from_record, because a record contains only the name of "
        f"a function, got {name!r}"
    )


@cache
def _load(group: str, name: str, what: str) -> Plugin:
    """Import a plugin; the call can be repeated after a failure, because only successful imports are cached."""
    points = entry_points(group=group, name=name)
    if not points:
        raise LookupError(name)
    plugins = [Plugin(what, name, None, point.dist.name, point.dist.version, point.value) for point in points]
    if len(plugins) > 1:
        packages = ", ".join(sorted(f"{plugin.package} {plugin.version}" for plugin in plugins))
        raise InputError(
            f"several packages add the {what} {name!r}: {packages}; uninstall all but one of these packages"
        )
    (plugin,), (point,) = plugins, points
    with plugin.answering():
        return replace(plugin, value=point.load())
