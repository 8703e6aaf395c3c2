"""Instruments: focal plane, optics and the source of every value; presets are data files."""

import hashlib
import os
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cached_property, lru_cache
from numbers import Number
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table
from astropy.time import Time

from rfpsurvey._common.descriptions import to_html
from rfpsurvey._common.files import to_path
from rfpsurvey._common.plugins import find_plugin, plugin_names
from rfpsurvey._common.read_documents import is_present
from rfpsurvey._instruments import description as _description
from rfpsurvey._instruments.as_built import AsBuilt
from rfpsurvey._instruments.description import OPTIONAL, Described
from rfpsurvey._instruments.entries import NEED
from rfpsurvey._instruments.facts import Written, fact_texts, field_angles, find_facts, read_instrument
from rfpsurvey._instruments.focal_plane import FocalPlane
from rfpsurvey._instruments.focal_plane_tables import figure_of
from rfpsurvey._instruments.layouts import UNUSED, ArmModels
from rfpsurvey._instruments.states import LISTED, States, apply_entry, at_one_time, moments_at
from rfpsurvey._sky.radial_map import RadialMap
from rfpsurvey.errors import (
    InputError,
    InputTypeError,
    check_choice,
    check_fiber_type,
    check_keywords,
    number_of,
    refusal,
    short,
    warn,
)

GROUP = "rfpsurvey.instruments"
LAYOUTS = ("nominal", "as built")


@check_keywords
@dataclass(frozen=True, eq=False)
class Instrument(ArmModels, AsBuilt, Described, States, Written):
    """A fiber-positioner instrument with the optics of its telescope.

    Parameters
    ----------
    name : str
        Short name of the instrument, such as ``lamost``.
    focal_plane : FocalPlane
        Focal plane with the positioners.
    plate_scale : Quantity, optional
        Length on the focal plane per angle on the sky, at the field center; required without ``distortion``.
    distortion : RadialMap, DistortionMap, or dict of str to one of them, optional
        Radial map or distortion map of the field, or a dict with one map for each fiber type.
    title : str, optional
        Full name of the instrument.
    layout : {"nominal", "as built"}, optional
        Whether the centers are a nominal lattice or were measured on the instrument as built.
    targets_per_fiber : float, optional
        Usual number of targets per positioner, for synthetic catalogs.
    values : dict, optional
        All values that describe the instrument. The keys are dotted names, such as ``positioner.clearance``. Each value
        is a dict with ``value``, ``unit``, ``status`` (published, derived or assumed) and ``source``.
    notes : str, optional
        Notes for users of the instrument.

    Raises
    ------
    InputError
        If neither plate scale nor distortion is given.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> lamost = rs.Instrument.preset("lamost")
    >>> len(lamost.focal_plane), lamost.layout
    (4000, 'nominal')
    """

    name: str
    focal_plane: FocalPlane
    plate_scale: u.Quantity | None = None
    distortion: RadialMap | dict[str, RadialMap] | None = None
    title: str = ""
    layout: str = "nominal"
    targets_per_fiber: float = 4.0
    values: dict = field(default_factory=dict)
    notes: str = ""

    def __post_init__(self):
        if not isinstance(self.focal_plane, FocalPlane):
            raise InputTypeError(f"focal_plane must be a FocalPlane, got {type(self.focal_plane).__name__}")
        for name, kind in (("name", str), ("title", str), ("notes", str), ("values", dict)):
            if not isinstance(getattr(self, name), kind):
                raise InputTypeError(f"{name} must be a {kind.__name__}, got {short(getattr(self, name))}")
        check_choice(self.layout, LAYOUTS, "layout")
        if isinstance(self.distortion, dict):
            for name in self.distortion:
                check_fiber_type(name, self.focal_plane.fiber_types, "fiber type of the distortion")
            for name in self.focal_plane.fiber_types:
                if name not in self.distortion:
                    raise InputError(f"the distortion must have a map for the fiber type {name!r}")
        number = self.targets_per_fiber
        if not isinstance(number, int | float) or not 0 < number < np.inf:
            raise refusal("targets_per_fiber must be a positive number", self.targets_per_fiber, Number)
        plane = self.projection(SkyCoord(0 * u.deg, 0 * u.deg))  # raises an error if the optics are incomplete
        object.__setattr__(self, "plate_scale", plane.plate_scale)

    def __repr__(self):
        size, across = number_of(len(self.focal_plane), "positioner"), 2 * self.field_radius.to_value(u.deg)
        return f"<Instrument {self.name!r}: {size}, field {across:.4g} deg across, layout {self.layout}>"

    def _repr_html_(self):
        return to_html(self, fact_texts(self.facts()), figure=figure_of(self.focal_plane))

    @property
    def field_radius(self) -> u.Quantity:
        """Field angle of the outermost point that any positioner reaches."""
        plane = self.focal_plane
        edge = (np.hypot(*plane.arrays.xy.T) + plane.arrays.largest_radius).max(keepdims=True)
        return np.rad2deg(field_angles(self, edge)[0]) * u.deg

    @property
    def target_density(self) -> u.Quantity:
        """Target density (per solid angle) for which a field has ``targets_per_fiber`` targets per positioner."""
        area = 4 * np.pi * np.sin(self.field_radius.to_value(u.rad) / 2) ** 2 * u.sr  # of a spherical cap
        return (self.targets_per_fiber * len(self.focal_plane) / area).to(u.deg**-2)

    @property
    def requirements(self) -> tuple[str, ...]:
        """Requirements on sky fibers and standard stars for `allocate`, such as ``sky=20/spectrograph``."""
        texts = []
        for name, entry in self.values.items():
            if match := NEED.fullmatch(name):
                fiber, kind, per = match.groups()
                fiber = f"@{fiber.upper()}" if fiber else ""
                texts.append(f"{kind.removesuffix('s')}{fiber}={entry['value']}{'/spectrograph' if per else ''}")
        return tuple(texts)

    @classmethod
    def preset(cls, name: str) -> "Instrument":
        """Return the instrument with a given name.

        Parameters
        ----------
        name : str
            One of `available_instruments`.

        Returns
        -------
        Instrument
            A new object for the instrument.

        Raises
        ------
        InputError
            If the name is unknown (the message lists the known names), or if a package provides an invalid instrument.
        """
        shipped = _shipped()
        if isinstance(name, str) and name in shipped:
            return cls.read(shipped[name])
        plugin = find_plugin(GROUP, name, shipped, "instrument")
        with plugin.answering():
            source = plugin.value() if callable(plugin.value) else plugin.value
            return source if isinstance(source, cls) else cls.read(source)

    @classmethod
    def read(cls, path: str | os.PathLike, *, time: Time | str | None = None) -> "Instrument":
        """Read an instrument from a TOML file, or from a file or folder that describes an instrument as built.

        Parameters
        ----------
        path : str or path-like
            Path of a TOML file in the format of the included presets, of a file that `write` wrote, or of a file or
            folder that `~rfpsurvey.Instrument.from_sdssv`, `~rfpsurvey.Instrument.from_desi` or
            `~rfpsurvey.Instrument.from_pfs` reads.
        time : Time or str, optional
            Time (UTC) of the states of positioners in a TOML file or a log of DESI, as in `with_states`.

        Returns
        -------
        Instrument
            The instrument.

        Raises
        ------
        InputError
            If the file does not exist or is not a valid description of an instrument, or if a TOML file contains states
            with dates and no time is given.
        """
        path = to_path(path)
        moments_at(time)  # refuse an invalid time, even if the description has no states with dates
        if is_present(path) and path.suffix.lower() != ".toml":
            instrument = cls._read_as_built(path, time)
            if instrument is not None:
                return instrument
            if path.is_dir():
                raise InputError(
                    f"{path}: the folder must contain positionerTable.csv (SDSS-V), desi-focalplane_DATE.ecsv or "
                    "fp-metrology.csv (DESI), or black_dots_mm.csv (PFS), got none of them"
                )
        try:
            if path.suffix.lower() == ".ecsv":
                return cls(**read_instrument(path))
            instrument = cls(**_description.build(_description.load(path), path.parent))
            return apply_entry(instrument, path.parent, time) if LISTED in instrument.values else instrument
        except InputError as error:
            raise InputError(str(error) if str(error).startswith(str(path)) else f"{path}: {error}") from None
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            what = f"{type(error).__name__}: {error}"
            raise InputError(
                f"{path}: the file must be a valid description of an instrument, got one that causes {what}"
            ) from error

    def facts(self) -> dict:
        """Return facts about the fibers, the field, the patrol areas and their overlap, derived from the description.

        Returns
        -------
        dict
            Facts by name, as numbers, text, quantities, dicts or tuples:

            - ``positioners`` and ``usable_positioners``: numbers of all positioners, and of positioners that are
              neither disabled nor stuck.
            - ``fibers``: dict that maps each fiber type to the number of positioners with a fiber of this type. The
              type is ``""`` if fiber types are not distinguished.
            - ``spectrographs`` and ``obstacles``: numbers of spectrographs and of obstacles.
            - ``field_shape``: shape of the convex hull of the centers (circle, hexagon, square, triangle or irregular).
            - ``field_radius`` and ``focal_plane_radius``: distance from the center to the outermost point in reach, as
              an angle on the sky and as a length on the focal plane.
            - ``field_of_view``: solid angle of the convex hull of all patrol areas.
            - ``footprint``: area of the convex hull of the centers.
            - ``plate_scale``: plate scale at the field center.
            - ``pitch``: median distance from the center of a positioner to the nearest other center.
            - ``central_arm``, ``eccentric_arm``, ``inner_patrol_radius`` and ``patrol_radius``: medians over all
              positioners.
            - ``min_separation``: minimum separation of two arms.
            - ``collision_type``: 1 if no arms can touch, 2 if only arms of adjacent positioners can touch, 3 if arms
              of positioners that are not adjacent can also touch.
            - ``coverage``: fraction of the footprint that at least one positioner reaches.
            - ``multiplicity`` and ``max_multiplicity``: mean and largest number of positioners that reach a point of
              the footprint.
            - ``positioner_density``: number of positioners per area of the field of view.
            - ``layout``: ``nominal`` or ``as built``.
            - ``published``, ``derived`` and ``assumed``: names of the values with this status, see `to_table`.

            Coverage and multiplicity are computed from 2**18 points, with standard errors below 0.001. They are NaN if
            there are fewer than three centers, or if all centers lie on a line.

        Examples
        --------
        >>> import rfpsurvey as rs
        >>> facts = rs.Instrument.preset("pfs").facts()
        >>> facts["field_shape"], facts["field_of_view"].round(2), facts["pitch"]
        ('hexagon', <Quantity 1.28 deg2>, <Quantity 8. mm>)
        """
        return find_facts(self)

    def to_table(self) -> Table:
        """Return the values that describe the instrument, with their sources.

        Returns
        -------
        Table
            Table with the columns name, value, unit, status and source.
        """
        rows = [
            (name, _short(v["value"]), v.get("unit", ""), v["status"], v["source"]) for name, v in self.values.items()
        ]
        return Table(rows=rows or None, names=["name", "value", "unit", "status", "source"], dtype=[str] * 5)

    @property
    def provenance(self) -> dict:
        """Information about the instrument that is stored in the records of results."""
        plain = {name: v["value"] for name, v in self._used.items() if not isinstance(v["value"], list)}
        about = {"name": self.name, "arm_model": self.focal_plane.positioner.arm_model, "layout": self.layout}
        margins = self.focal_plane.margins
        about |= {"margins": margins.record} if margins else {}
        return {**about, "values": plain, "digest": self._digest}

    @property
    def _used(self) -> dict:
        """The values on which results depend, apart from the margins of the focal plane and the motion of joints."""
        return {k: v for k, v in self.values.items() if k not in UNUSED and not k.startswith(OPTIONAL)}

    @cached_property
    def _digest(self) -> str:
        plane = self.focal_plane
        parts = (self._used, plane.positioner, self.plate_scale, self.distortion, plane.fiber_type.tolist())
        parts += plane.id.tolist(), plane.spectrograph.tolist()
        parts += (plane.margins.record,) if plane.margins else ()
        parts += tuple((name, values.tolist()) for name, values in (plane.groups or {}).items())
        digest = hashlib.sha256("\n".join(_text(part) for part in parts).encode())
        arrays = plane.arrays
        columns = [arrays.xy, arrays.central_arm, arrays.eccentric_arm, plane.disabled, arrays.stuck, arrays.obstacles]
        if arrays.joints is not None:
            columns += [arrays.joints.theta_zero, arrays.joints.phi_zero, arrays.joints.limits]
        if arrays.fibers is not None:
            columns += [arrays.fibers.length, arrays.fibers.angle]
        columns += [arrays.hidden] if len(arrays.hidden) else []
        columns += arrays.obstacle_polygons
        for column in columns:
            digest.update(np.ascontiguousarray(column).tobytes())
        return digest.hexdigest()[:16]


def as_instrument(
    instrument: Instrument | str, time: Time | str | None = None, *, may_be_dated: bool = False
) -> Instrument:
    """Return the `Instrument` for an instrument, the name of a preset or a path that `Instrument.read` accepts.

    ``time`` is the time of the states of positioners. They may depend on the tile only if ``may_be_dated`` is true.
    """
    if isinstance(instrument, os.PathLike) or (isinstance(instrument, str) and _is_path(instrument)):
        instrument = Instrument.read(instrument, time=time)
    elif isinstance(instrument, str):
        instrument = _shipped_instrument(instrument) if instrument in _shipped() else Instrument.preset(instrument)
    elif not isinstance(instrument, Instrument):
        text = "instrument must be an Instrument, the name of a preset or the path of a TOML file"
        raise InputTypeError(f"{text}, got {short(instrument)}")
    return instrument if may_be_dated else at_one_time(instrument)


@lru_cache(maxsize=4)
def _shipped_instrument(name: str) -> Instrument:
    """Return a preset that functions share, so that the arrays of its focal plane are computed only once."""
    return Instrument.preset(name)


def _is_path(text: str) -> bool:
    """Return whether the text is a path; otherwise, it is the name of a preset."""
    if text.endswith(".toml"):
        return True
    return text not in _shipped() and (os.sep in text or os.path.exists(text)) and text not in plugin_names(GROUP)


def as_focal_plane(instrument: Instrument | FocalPlane | str) -> FocalPlane:
    """Return the focal plane for a focal plane, an instrument or the name of a preset."""
    if isinstance(instrument, FocalPlane):
        return instrument
    if not isinstance(instrument, str | Instrument):
        raise InputTypeError(
            f"instrument must be a name, an Instrument or a FocalPlane, got {type(instrument).__name__}"
        )
    return as_instrument(instrument).focal_plane


def available_instruments() -> list[str]:
    """Return the names of all presets of rfpsurvey and of other installed packages.

    Other packages add instruments through the entry-point group ``rfpsurvey.instruments``. Each entry point refers to
    an `Instrument`, a function that returns an `Instrument`, or the path of a TOML file.

    Returns
    -------
    list of str
        The names, sorted. `Instrument.preset` accepts each of these names.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> "lamost" in rs.available_instruments()
    True
    """
    return sorted({*plugin_names(GROUP), *_shipped()})


def every_instrument() -> dict[str, Instrument]:
    """Return all presets by name; issue a warning for each invalid preset of another package."""
    instruments = {}
    for name in available_instruments():
        try:
            instruments[name] = Instrument.preset(name)
        except InputError as error:
            warn(str(error))
    return instruments


def _shipped() -> dict[str, Path]:
    return {path.stem: path for path in _description.PRESETS.glob("*.toml")}


def _text(value) -> str:
    """Return a value as text with all digits."""
    if is_dataclass(value):
        return _text({f.name: getattr(value, f.name) for f in fields(value)})
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {_text(v)}" for k, v in sorted(value.items())) + "}"
    return value.to_string(precision=17) if isinstance(value, u.Quantity) else repr(value)


def _short(value) -> str:
    text = str(value)
    return text if len(text) <= 60 else f"{len(value)} values" if isinstance(value, list) else text[:57] + "..."
