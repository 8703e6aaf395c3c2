"""The command ``rfpsurvey compare-allocators``."""

from dataclasses import dataclass

import astropy.units as u

import rfpsurvey as rs
from rfpsurvey import inputs
from rfpsurvey._cli import _app, _print
from rfpsurvey._cli._command import Given, command
from rfpsurvey.tile import north_of_date


@dataclass(frozen=True, kw_only=True)
class CompareAllocatorsKeys:
    """The keys of the command.

    Parameters
    ----------
    allocators : list[str], optional
        Allocators to compare. By default, all allocators are compared.
    """

    catalog: inputs.CatalogKeys
    instrument: inputs.InstrumentKeys
    options: inputs.OptionsOnly
    output: inputs.TableOutputKeys
    allocators: list[str] | None = None
    center: inputs.Center = None
    position_angle: inputs.PositionAngle = 0 * u.deg
    equinox: inputs.Equinox = None
    epoch: inputs.Epoch = None
    rng: inputs.Seed = 0


@command(
    CompareAllocatorsKeys,
    "instrument.name center position_angle epoch allocators options.constraints rng catalog.columns output.path "
    "output.plot output.report output.overwrite",
    argument="catalog.path",
)
def compare_allocators(keys: CompareAllocatorsKeys, _: Given) -> None:
    r"""Compare allocators on the same field.

    Examples
    --------
    rfpsurvey compare-allocators
    rfpsurvey compare-allocators stars.fits --instrument moons \
        --plot allocators.png --report allocators.html
    rfpsurvey compare-allocators stars.fits --constraint sky=20 \
        --allocator network_flow --allocator optimal
    """
    _app.check_outputs(keys.output, (keys.catalog.path, keys.instrument.name, keys.instrument.broken))
    model = _app.model_of(keys.instrument, lambda: inputs.time_of(None, keys.epoch))
    targets, field = _app.targets_and_center(keys.catalog, keys.center, model, keys.rng)
    with _app.seed_of(keys.catalog.path):
        table, plans = rs.compare_allocators(
            targets,
            model,
            north_of_date(field, keys.equinox),
            allocators=keys.allocators,
            options=rs.AllocationOptions(**keys.options),
            return_tiles=True,
            position_angle=keys.position_angle,
            epoch=keys.epoch,
            rng=keys.rng,
        )
    _print.finish_comparison(table, plans, keys.output)
