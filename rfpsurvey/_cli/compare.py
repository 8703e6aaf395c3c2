"""The command ``rfpsurvey compare``."""

import sys
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import astropy.units as u

import rfpsurvey as rs
from rfpsurvey import inputs
from rfpsurvey._cli import _app, _print, _surveys
from rfpsurvey._cli._command import command
from rfpsurvey._io import write_table
from rfpsurvey.compare import COMPARED, parts_of
from rfpsurvey.errors import listed
from rfpsurvey.inputs import Located


@dataclass(frozen=True, kw_only=True)
class CompareKeys:
    """The keys of the command.

    Parameters
    ----------
    instruments : list[str], optional
        Names of presets, or paths of TOML files. By default, all presets.
    targets_per_positioner : float, optional
        Number of synthetic targets per positioner. By default, 1.
    density : float, optional
        Number of synthetic targets per deg2, in place of the number per positioner.
    n_realizations : int, optional
        Number of synthetic fields per instrument. By default, 4.
    """

    instruments: Annotated[list[str] | None, Located] = None
    instrument: inputs.StateKeys
    catalog: inputs.CatalogKeys
    options: inputs.OptionsOnly
    output: inputs.TableOutputKeys
    center: inputs.Center = None
    position_angle: inputs.PositionAngle = 0 * u.deg
    epoch: inputs.Epoch = None
    targets_per_positioner: float | None = None
    density: float | None = None
    n_realizations: int | None = None
    allocators: Annotated[
        list[str] | None, f"Allocators to compare. By default, the allocators {listed(COMPARED)} are used."
    ] = None
    rng: inputs.Seed = 0
    workers: inputs.Workers = 1


@command(
    CompareKeys,
    "catalog.path center position_angle epoch targets_per_positioner density n_realizations allocators "
    "options.constraints rng workers catalog.columns output.path output.plot output.report output.overwrite",
    argument="instruments",
)
def compare(keys: CompareKeys) -> None:
    r"""Compare the patrol areas, fibers and collisions of instruments, and the targets lost to collisions.

    Examples
    --------
    rfpsurvey compare
    rfpsurvey compare lamost design.toml --targets-per-positioner 2 \
        --plot comparison.png --output comparison.ecsv
    rfpsurvey compare sdss_apo moons --catalog stars.fits \
        --center "06h20m00s +23d00m00s" --allocator optimal
    rfpsurvey compare lamost desi pfs --density 1000 --n-realizations 2 \
        --report comparison.html
    """
    names, state = keys.instruments or [], keys.instrument
    _app.check_outputs(keys.output, (*names, keys.catalog.path, state.broken))
    if state.broken is not None and len(names) != 1:
        raise rs.InputError(
            "instrument.broken must be used with one instrument, because instruments have different identifiers; to "
            "compare several instruments, write TOML files with the entry layout.states"
        )
    if state.arm_model or state.margins:
        names = names or rs.available_instruments()
    named = [inputs.InstrumentKeys(**vars(state), name=name) for name in names]
    models = [_app.model_of(instrument_keys, lambda: inputs.time_of(None, keys.epoch)) for instrument_keys in named]
    if keys.catalog.path is None:
        inputs.warn_without_catalog(keys.catalog)
    with _surveys.workers(keys) as executor:
        table = rs.compare_instruments(
            "poisson" if keys.catalog.path is None else _app.read_catalog(keys.catalog),
            models or None,
            center=_app.parse_center(keys.center),
            allocators=keys.allocators or COMPARED,
            targets_per_positioner=keys.targets_per_positioner,
            density=None if keys.density is None else keys.density / u.deg**2,
            n_realizations=keys.n_realizations,
            rng=keys.rng,
            executor=executor,
            progress=sys.stderr.isatty(),
            options=rs.AllocationOptions(**keys.options),
            position_angle=keys.position_angle,
            epoch=keys.epoch,
        )
    with _print.files(
        keys.output,
        write=partial(write_table, table),
        draw=lambda: rs.plot.draw_instruments(table),
        report=(table, {"data": keys.output.path}),
    ):
        _print_comparison(table, with_margins=bool(state.margins))


def _print_comparison(table, *, with_margins: bool) -> None:
    """Print a comparison of instruments."""
    _print.print_text(table.meta["way"])
    for name, model in table.meta["instruments"].items() if with_margins else ():
        values = ", ".join(f"{key} {value:g}" for key, value in model.get("margins", {}).items())
        print(f"margins of {name}: {values or 'none'}")
    for title, part in parts_of(table).items():
        print(f"\n{title}")
        _print.print_table(part)
    print()
    _print.print_text(table.meta["comparable"], "")
