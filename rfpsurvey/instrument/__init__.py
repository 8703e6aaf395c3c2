"""An instrument: focal plane, optics and where every figure comes from. Presets are data files."""

from rfpsurvey.instrument._instrument import Instrument, available_instruments

__all__ = ["Instrument", "available_instruments"]
