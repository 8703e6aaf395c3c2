"""The command ``rfpsurvey compare-allocators``."""

from dataclasses import dataclass

import astropy.units as u

import rfpsurvey as rs
from rfpsurvey._cli import _app, _groups, _print
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

    catalog: _groups.CatalogKeys
    instrument: _groups.InstrumentKeys
    options: _groups.OptionsOnly
    output: _groups.TableOutputKeys
    allocators: list[str] | None = None
    center: _groups.Center = None
    position_angle: _groups.PositionAngle = 0 * u.deg
    equinox: _groups.Equinox = None
    epoch: _groups.Epoch = None
    rng: _groups.Seed = 0


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
    model = _app.model_of(keys.instrument, lambda: _app.time_of(None, keys.epoch))
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
