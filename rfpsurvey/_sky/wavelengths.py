"""The light that an instrument observes: bands and wavelengths of its fibers, its guider, and its compensator."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np

from rfpsurvey._common.settings import Checked, option
from rfpsurvey._common.units import ByValue, to_unit
from rfpsurvey._sky.conditions import WAVELENGTHS, ObservingConditions, in_micrometers
from rfpsurvey.errors import InputError, InputTypeError, check_choice, check_keywords, listed, short, warn

ASSUMED_UM = 0.54
COMPENSATORS = ("yes", "no", "unknown")
REMOVED = ("shift", "rotation", "scale")


def _bands(value: object) -> u.Quantity | dict[str, u.Quantity]:
    """Return a band, or the band of each fiber type, after a check."""
    if isinstance(value, dict) and value and not any(isinstance(band, dict) for band in value.values()):
        return {name: _bands(band) for name, band in value.items()}
    low_high = to_unit(value, u.um, "band")
    if low_high.shape != (2,) or not 0 < low_high[0] < low_high[1] < np.inf:
        raise InputError(f"band must be two wavelengths, of which the first is below the second, got {short(value)}")
    return value


def _removed(value: Sequence[str]) -> tuple[str, ...]:
    if not isinstance(value, list | tuple):
        raise InputTypeError(f"guider_removes must be a list of names, got {short(value)}")
    return tuple(check_choice(name, REMOVED, "displacement that the guider removes") for name in value)


@check_keywords
@dataclass(frozen=True, eq=False)
class Light(Checked, ByValue):
    """The light that an instrument observes; plans without observing conditions do not depend on it.

    Parameters
    ----------
    band : Quantity, shape (2,), or dict of str to Quantity, optional
        Shortest and longest wavelength that fibers observe, or a dict with a band for each fiber type.
    wavelength : Quantity or dict of str to Quantity, optional
        Wavelength for which the positions of fibers are computed, or a dict with one wavelength for each fiber type.
    guide_wavelength : Quantity, optional
        Wavelength at which the telescope follows the field.
    dispersion_compensator : {"yes", "no", "unknown"}, optional
        Whether a compensator removes atmospheric dispersion, so that images at all wavelengths are at the position of
        the image at the guide wavelength. For ``unknown``, the full dispersion is assumed.
    guider_removes : sequence of str, optional
        What the guider of the telescope removes: ``shift`` and ``rotation``, and possibly the mean ``scale``.

    Raises
    ------
    InputError
        If a wavelength or band is not valid.

    Examples
    --------
    >>> import rfpsurvey as rs
    >>> light = rs.Instrument.preset("sdss_apo").light
    >>> light.wavelength["APOGEE"], light.dispersion_compensator
    (<Quantity 1.66 um>, 'no')
    """

    band: u.Quantity | dict[str, u.Quantity] | None = option(None, convert=_bands)
    wavelength: u.Quantity[u.um] | dict[str, u.Quantity[u.um]] | None = option(None, **WAVELENGTHS)
    guide_wavelength: u.Quantity[u.um] | None = option(None, **WAVELENGTHS)
    dispersion_compensator: str = option("unknown", choices=COMPENSATORS)
    guider_removes: tuple[str, ...] = option(REMOVED[:2], convert=_removed)

    def _check(self):
        for name in ("band", "wavelength"):
            value = getattr(self, name)
            if isinstance(value, dict) and not (value and all(isinstance(kind, str) for kind in value)):
                raise InputError(f"{name} must have one value, or one for each fiber type, got {short(value)}")

    @cached_property
    def _numbers(self) -> tuple:
        return in_micrometers(self.wavelength), in_micrometers(self.guide_wavelength)


def _by_type(value: object) -> dict:
    return {} if value is None else value if isinstance(value, dict) else {"": value}


@dataclass(frozen=True)
class ObservedLight:
    """Wavelengths (micrometers) of an observation: of the fibers, or of each fiber type, and of the guider."""

    fibers: dict[str, float] | float
    guide: float
    compensated: bool = False
    assumed: bool = False  # whether the wavelengths of the fibers are known neither for the instrument nor given
    removes_scale: bool = False  # whether the guider removes the mean scale

    @property
    def distinct(self) -> list[float]:
        """The wavelengths at which fibers observe; with a compensator, positions are those at the guide wavelength."""
        if self.compensated:
            return [self.guide]
        return sorted({*self.fibers.values()}) if isinstance(self.fibers, dict) else [self.fibers]

    def of(self, fiber_type: str) -> float:
        """Return the wavelength of the image of a target of a fiber type; ``""`` is the first type."""
        if self.compensated or not isinstance(self.fibers, dict):
            return self.guide if self.compensated else self.fibers
        fiber_type = fiber_type or next(iter(self.fibers))
        if fiber_type not in self.fibers:
            raise InputError(
                f"wavelength must have a value for the fiber type {fiber_type!r}, got values for {listed(self.fibers)}"
            )
        return self.fibers[fiber_type]

    @property
    def record(self) -> dict:
        """The wavelengths as plain numbers and text, for the records of results."""
        record = {"fibers_um": self.fibers, "guide_um": self.guide, "compensated": self.compensated}
        return record | ({"guider_removes_scale": True} if self.removes_scale else {})

    def __str__(self):
        """Return a text with the wavelengths."""
        one = "" if not isinstance(self.fibers, dict) else ", ".join(f"{k} {v:g} um" for k, v in self.fibers.items())
        fibers = one or f"{self.fibers:g} um"
        source = " (assumed)" if self.assumed else ""
        removed = ", dispersion is compensated" if self.compensated else ""
        return f"wavelengths: fibers {fibers}{source}, guider {self.guide:g} um{removed}"


def observed_light(light: Light, conditions: ObservingConditions) -> ObservedLight:
    """Return the wavelengths of an observation; those of the conditions replace those of the instrument."""
    given, (of_fibers, of_guider) = conditions.numbers, light._numbers
    fibers = of_fibers if given.wavelength is None else given.wavelength
    assumed, fibers = fibers is None, ASSUMED_UM if fibers is None else fibers
    guide = of_guider if given.guide_wavelength is None else given.guide_wavelength
    if guide is None:
        guide = next(iter(fibers.values())) if isinstance(fibers, dict) else fibers
    ideal = conditions.compensator == "ideal"
    ideal |= conditions.compensator == "instrument" and light.dispersion_compensator == "yes"
    return ObservedLight(fibers, guide, ideal, assumed, "scale" in light.guider_removes)


def warn_outside_band(light: Light, conditions: ObservingConditions | None) -> None:
    """Warn of wavelengths in the observing conditions that are outside the bands of the instrument."""
    given = None if conditions is None else conditions.wavelength
    for kind, wave in {} if given is None else _by_type(given).items():
        bands = {name: band for name, band in _by_type(light.band).items() if kind in (name, "") or name == ""}
        if bands and not any(band[0] <= wave <= band[1] for band in bands.values()):
            shown = listed(f"{name} {band[0].value:g} to {band[1]:g}".strip() for name, band in bands.items())
            warn(f"the wavelength {wave.to(u.um):g} is outside the band of the fibers ({shown})")
