"""Files with complete instruments: the table of a focal plane, whose ``meta`` contains the other values."""

import json
import os
from dataclasses import fields, is_dataclass
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable

from rfpsurvey._io import write_table
from rfpsurvey._outputs import check_output
from rfpsurvey._readers import parse_json, read_table
from rfpsurvey.errors import InputError
from rfpsurvey.focal_plane import FocalPlane
from rfpsurvey.projection import DistortionMap, RadialMap

META = "instrument"
"""Name of the entry of the ``meta`` of the table with the values that the columns do not contain."""
PLAIN = ("name", "title", "layout", "targets_per_fiber", "values", "notes")


class Written:
    """The method that `Instrument` inherits, which writes an instrument."""

    def write(self, path: str | os.PathLike, *, overwrite: bool = False) -> None:
        """Write the instrument, with all its positioners and their states, as an ECSV file that `read` reads.

        Parameters
        ----------
        path : str or path-like
            Path that ends in ``.ecsv``.
        overwrite : bool, optional
            Whether to replace an existing file.

        Raises
        ------
        InputError
            If the path does not end in ``.ecsv``, if the file exists and ``overwrite`` is False, or if the instrument
            has a distortion map with residuals.
        """
        path = check_output(path, (".ecsv",), overwrite=overwrite)
        table, optics = self.focal_plane.to_table(), self.distortion
        about = {name: getattr(self, name) for name in PLAIN} | {"plate_scale": _text(self.plate_scale)}
        if isinstance(optics, dict):
            about["distortions"] = {name: _map_to_meta(field_map) for name, field_map in optics.items()}
        elif optics is not None:
            about["distortion"] = _map_to_meta(optics)
        table.meta[META] = json.dumps(about)  # YAML would sort the names and change some numbers
        write_table(table, path, overwrite=overwrite)


def read_instrument(path: Path) -> dict:
    """Return the arguments of `Instrument` in a file that its method ``write`` wrote."""
    table = read_table(path)
    about = parse_json(table.meta.pop(META, None), f"the entry {META} of meta")
    values = {name: about[name] for name in PLAIN if name in about}
    values["focal_plane"] = FocalPlane.from_table(QTable(table))
    if "distortion" in about:
        return values | {"distortion": _map_from_meta(about["distortion"])}
    if "distortions" in about:
        return values | {"distortion": {name: _map_from_meta(meta) for name, meta in about["distortions"].items()}}
    return values | {"plate_scale": u.Quantity(about["plate_scale"])}


def _text(value: object) -> object:
    """Return a quantity as text that represents its numbers exactly, and other values as ECSV stores them."""
    if isinstance(value, u.Quantity):
        numbers = np.asarray(value.value).tolist()
        return f"{numbers!r} {value.unit}" if value.isscalar else [f"{number!r} {value.unit}" for number in numbers]
    return list(value) if isinstance(value, tuple) else value


def _map_to_meta(optics: RadialMap | DistortionMap) -> dict:
    if not is_dataclass(optics) or getattr(optics, "residuals", None) is not None:
        raise InputError("an instrument with a distortion map that contains residuals cannot be written")
    values = {field.name: getattr(optics, field.name) for field in fields(optics)}
    return {name: _text(value) for name, value in values.items() if value is not None}


def _map_from_meta(meta: dict) -> RadialMap | DistortionMap:
    quantities = {"max_angle", "unit_angle", "radius", "adc"}
    given = {name: u.Quantity(value) if name in quantities else value for name, value in meta.items()}
    return (RadialMap if "form" in given else DistortionMap)(**given)
