"""Names of packages that are imported on first use, because scripts and commands do not need all of them."""

import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module

__all__ = ["importer"]


def importer(package: str, modules: Mapping[str, Iterable[str]]) -> Callable[[str], object]:
    """Return the function ``__getattr__`` of a package, which imports modules on first use.

    ``modules`` lists the names that the package takes from each of its modules.
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
