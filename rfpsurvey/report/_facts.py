"""Labels and values of tilings and of estimates; a label that begins with two spaces gives a detail of another one."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:  # commands print facts without importing these packages
    from rfpsurvey.probability import Estimate
    from rfpsurvey.tile import Tile
    from rfpsurvey.tiling import Tiling

TILING = {
    "n_tiles": "tiles",
    "radius_deg": "radius of a field in degrees",
    "area_deg2": "area of the region in square degrees",
    "covering_fraction": "fraction of the region that fields cover",
    "fraction_in_reach": "  in reach of a positioner",
    "fraction_beyond_declination": "  outside the limits of declination",
    "mean_depth": "mean number of fields that cover a position",
    "n_samples": "positions at which the coverage is measured",
    "fibers": "fibers per tile",
    "n_targets": "targets with requested visits",
    "n_beyond_declination": "  outside the limits of declination",
    "n_on_tiles": "  on at least one tile",
    "n_requested": "visits requested",
    "n_observed": "  observed",
    "completeness": "completeness",
    "completeness_means": "definition of the completeness",
    "fiber_use": "fraction of the fibers used",
    "n_isolated": "targets with no other target too close",
    "completeness_isolated": "  completeness of these targets",
}


def tiling_facts(tiling: "Tiling") -> dict:
    """Return the values in the summary of a tiling; a value without a label is labeled by its key."""
    return {TILING.get(key, key.replace("_", " ")): value for key, value in tiling.summary.items() if value != ""}


def model_facts(tile: "Tile") -> dict:
    """Return what a tile states about its model, about poses of arms without a target, and about its projection."""
    texts = {"model": tile.summary.get("model"), "poses": tile.summary.get("poses_without_target")}
    projection = tile.summary.get("projection", {})
    if "sentence" in projection:
        texts["projection"] = f"{projection['model']}; {projection['sentence']}"
    return {label: text for label, text in texts.items() if text}


def estimate_facts(estimate: "Estimate") -> dict:
    """Return the values of an estimate as text, with as many digits as its error allows."""
    formula, error = np.isnan(estimate.low), estimate.standard_error
    digits = 5 if formula or not 0 < error < 1e-5 else 1 - int(np.floor(np.log10(error)))
    digits = max(digits, 1 - int(np.floor(np.log10(estimate.value)))) if 0 < estimate.value < 1e-4 else digits
    unknown = f"none: {estimate.meta['no_interval']}" if "no_interval" in estimate.meta else "no error is known"
    interval = unknown if formula else f"{estimate.low:.{digits}f} to {estimate.high:.{digits}f}"
    lines = {
        "collision probability": f"{estimate.value:.{digits}f}",
        f"  {100 * estimate.meta['confidence']:g} % interval": interval,
        "  standard error": "" if formula else f"{estimate.standard_error:.2g}",
        "  of assigned positioners only": f"{estimate.value_assigned:.{digits}f}",
        "colliding pairs per positioner": "" if formula else f"{estimate.pairs_per_positioner:.5f}",
        "iterations": estimate.n or "",
        "effective number of trials": "" if formula else f"{estimate.n_effective:.0f}",
        "seconds": f"{estimate.seconds:.3f}",
    }
    return {label: value for label, value in lines.items() if value not in ("", "nan")}
