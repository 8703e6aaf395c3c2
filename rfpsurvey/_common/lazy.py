"""Import the public names of a package only on first use, because most scripts and commands need only a few names."""

import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module


def importer(package: str, modules: Mapping[str, Iterable[str]]) -> Callable[[str], object]:
    """Return the function ``__getattr__`` of a package, which imports modules on first use.

    ``modules`` maps each module of the package to the names that the package exports from this module.
    """
    sources = {name: module for module, names in modules.items() for name in names}

    def find(name: str) -> object:
        if name in sources:
            value = getattr(import_module(f"{package}.{sources[name]}"), name)
            setattr(sys.modules[package], name, value)  # later accesses do not call this function
            return value
        if name in modules:
            return import_module(f"{package}.{name}")
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    return find
