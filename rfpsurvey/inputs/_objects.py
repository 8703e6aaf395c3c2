"""Objects for keys: the instrument, the catalog, the tiles and the observing conditions."""

from collections.abc import Callable
from dataclasses import fields, replace

import astropy.units as u
from astropy.time import Time

from rfpsurvey.catalog import Catalog, PartitionedCatalog, to_time
from rfpsurvey.constraints import Rule, as_constraints
from rfpsurvey.errors import InputError, warn_no_effect
from rfpsurvey.focal_plane import Margins
from rfpsurvey.instrument import Instrument, as_instrument, describe_states
from rfpsurvey.observing import SITES, ObservingConditions, location
from rfpsurvey.tiling import Tiling, times_of_tiles, when_of


def no_output(text: str) -> None:
    """Ignore a text, in place of a function that prints it."""


def model_of(
    keys, known_time: Callable[[], Time | None] | None = None, *, tell: Callable[[str], None] = no_output
) -> Instrument:
    """Return the instrument for its keys; ``tell`` is called with a summary of the states of its positioners.

    Without ``state_time``, the states in a TOML file and in the table ``broken`` are evaluated at the time that
    ``known_time`` returns.
    """
    time = asked = None if keys.state_time is None else to_time(keys.state_time, "state_time")
    described = keys.name.lower().endswith(".toml")
    if asked is None and known_time is not None and (described or keys.broken is not None):
        time = known_time()
    model = as_instrument(keys.name, time if described else asked)
    model = model if keys.broken is None else model.with_states(keys.broken, time=time)
    if states := describe_states(model):
        tell(states)
    elif asked is not None:
        warn_no_effect("state_time", "because no states of positioners are given")
    return with_margins(model if keys.arm_model is None else model.with_arm_model(keys.arm_model), keys.margins)


def conditions_of(given: dict) -> ObservingConditions | None:
    """Return the observing conditions for their keys, which replace the values of a file; None if there are no keys."""
    given = dict(given)
    if isinstance(site := given.get("site"), list) or "," in str(site):
        given["site"] = location(site if isinstance(site, list) else site.split(","))
    if (path := given.pop("path", None)) is not None:
        return ObservingConditions.read(path, **given)
    if given and "site" not in given:
        raise InputError(
            f"conditions.site must be given to compute refraction: [LONGITUDE, LATITUDE, HEIGHT] or {', '.join(SITES)}"
        )
    return ObservingConditions(**given) if given else None


def tiles_under(tiling: Tiling, given: dict) -> Tiling:
    """Add the observing conditions for their keys, if any are given, to a tiling; return the tiling."""
    if given and not {"time", "hour_angle"} & set(given) and when_of(tiling.table) is not None:
        given = {**given, "hour_angle": 0 * u.hourangle}  # the time or hour angle in the table of tiles replaces it
    conditions = conditions_of(given)
    return tiling if conditions is None else tiling.with_conditions(conditions)


def time_of(conditions: ObservingConditions | None, epoch: object) -> Time | None:
    """Return the time of the observing conditions or, without such a time, the epoch; None if no time is known."""
    if conditions is not None and conditions.time is not None:
        return conditions.time
    return None if epoch is None else to_time(epoch, "epoch")


def time_of_tiles(tiling: Tiling | None, epoch: object, given: dict) -> Time | None:
    """Return the times of all tiles or, without times, the time of the epoch; None if no time is known."""
    if tiling is None:
        return time_of(conditions_of(given), epoch)
    times = times_of_tiles(tiles_under(tiling, given))
    return time_of(None, epoch) if times is None else times


def with_margins(model: Instrument, margins: dict) -> Instrument:
    """Return an instrument with the given margins or, if none are given, with its own margins."""
    given = dict(margins or {})
    if not given:
        return model
    start = Margins()
    if given.pop("published", False):
        start = model.published_margins
        if not start:
            raise InputError(
                "margins must give values, such as outer=0.1, because the description of the instrument has no margins"
            )
    return model.use_margins(replace(start, **given))


def read_catalog(keys, *, tell: Callable[[str], None] = no_output) -> Catalog | PartitionedCatalog:
    """Read a catalog from a file, or from a folder with the partitions of a catalog."""
    options = {name: getattr(keys, name) or {} for name in ("columns", "units", "fill")}
    options |= {"frame": keys.frame, "keep": keys.keep}
    if keys.path.is_dir():
        for name in ("hdu", "epoch", "select"):
            if getattr(keys, name) is not None:
                kind = "FITS files" if name == "hdu" else "files"
                raise InputError(f"{name} must be used only with {kind}, got the folder {keys.path}")
        parts = PartitionedCatalog(keys.path, **options)
        for name in ("collection", "columns"):
            if name in parts.meta:
                tell(f"{name}: {parts.meta[name]}")
        return parts
    catalog = Catalog.read(keys.path, **options, hdu=keys.hdu, select=keys.select)
    if "columns" in catalog.meta:
        tell(f"columns: {catalog.meta['columns']}")
    return catalog if keys.epoch is None else replace(catalog, epoch=keys.epoch)


def with_columns_of_rules(keys, options: dict, model: Instrument):
    """Return the keys of a catalog that also keep the columns of the catalog that the rules in the options use."""
    texts = [*(options.get("constraints") or ())]
    texts += [] if options.get("rules") is None else model.rules(options["rules"])
    names = [name for rule in as_constraints(texts) if isinstance(rule, Rule) for name in rule.columns]
    return replace(keys, keep=[*dict.fromkeys([*(keys.keep or ()), *names])]) if names and keys.path else keys


def warn_without_catalog(keys) -> None:
    """Issue a warning for each given key that describes a catalog, although no catalog is given."""
    for key in fields(keys):
        if key.name != "visits" and getattr(keys, key.name) != key.default:
            warn_no_effect(f"catalog.{key.name}", "without a catalog")
