"""The command ``rfpsurvey design``."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import rfpsurvey as rs
from rfpsurvey._cli import _app, _designs, _examples, _groups, _process, _surveys
from rfpsurvey._cli._command import command
from rfpsurvey._cli._keys import Located, Part
from rfpsurvey.design import LossOptions


@dataclass(frozen=True)
class DesignInstrumentKeys(_groups.StateTimeKeys):
    """The instrument around whose design a scan is made.

    Parameters
    ----------
    name : str, optional
        Instrument (preset or TOML file) whose design is varied. The values of this design replace the default values of
        the parameters.
    """

    name: Annotated[str | None, Located] = None
    arm_model = broken = margins = None


@dataclass(frozen=True)
class DesignOutputKeys(_groups.OutputKeys):
    """The files that the command writes.

    Parameters
    ----------
    path : Path, optional
        Write the finished designs to this file (.fits or .ecsv).
    resume : bool, optional
        Continue the unfinished scan in the output file.
    plot : Path, optional
        Plot the Pareto front (.png, .pdf or .svg).
    """

    path: Path | None = None
    resume: bool = False
    plot: Path | None = None


@dataclass(frozen=True, kw_only=True)
class DesignKeys:
    """The keys of the command.

    Parameters
    ----------
    spread : float, optional
        With an instrument, vary the central arm, the ratio of the arms and the pitch by up to this fraction of their
        values. By default, 0.15.
    central_arm : str, optional
        Length of the central arm (mm): a number such as 8.25, a list such as 7,8,9, a grid such as 7:9:5 (five values
        from 7 to 9), or limits LOW:HIGH with n_designs. By default, 8.25.
    ratio : str, optional
        Ratio of the length of the eccentric arm to the length of the central arm, in one of the forms of central_arm.
        The default range is 1 to 2.
    pitch : str, optional
        Distance between the centers of adjacent positioners (mm), in one of the forms of central_arm. The default range
        is 24 to 34.
    clearance : str, optional
        Clearance, which is the width of the margin around each eccentric arm (mm), in one of the forms of central_arm.
        By default, 2.25.
    n_designs : int, optional
        Number of designs, which are Sobol points between the limits LOW and HIGH of each parameter. By default, a grid
        is scanned.
    objectives : dict[str, str], optional
        Objectives of the Pareto front, two columns with max or min. By default, coverage=max and loss=min.
    """

    instrument: DesignInstrumentKeys
    loss: Annotated[dict, Part(LossOptions)]
    output: DesignOutputKeys
    spread: float | None = None
    central_arm: str | None = None
    ratio: str | None = None
    pitch: str | None = None
    clearance: str | None = None
    n_designs: int | None = None
    objectives: dict[str, str] | None = None
    rng: _groups.Seed = 0
    workers: _groups.Workers = 1
    processes: _groups.Processes = False


@command(
    DesignKeys,
    "instrument.name spread central_arm ratio pitch clearance n_designs loss.estimand loss.method "
    "loss.targets_per_positioner objectives rng workers output.path output.resume output.plot output.report "
    "output.overwrite",
    epilog=_examples.DESIGN_EXAMPLES,
)
def design(keys: DesignKeys) -> None:
    """Scan designs of positioners, optionally around the design of an instrument, and find the best designs."""
    output, around = keys.output, keys.instrument.name is not None
    _app.check_outputs(output, [keys.instrument.name], writable=None)
    if keys.spread is not None and not around:
        raise rs.InputError(
            "--spread must be used with --instrument, which names the instrument whose design is varied; "
            "got no --instrument"
        )
    parameters = {name: getattr(keys, name) for name in ("central_arm", "ratio", "pitch", "clearance")}
    scan = _designs.axes(keys.n_designs, around=around, **parameters)
    scan |= {"loss": LossOptions(**keys.loss), "objectives": keys.objectives, "n_designs": keys.n_designs}
    scan |= {"rng": keys.rng, "progress": sys.stderr.isatty()}
    scan |= {"path": output.path, "resume": output.resume, "overwrite": output.overwrite}
    kept = (
        "no designs were stored, because --output was not given"
        if output.path is None
        else f"the finished designs are stored in {output.path}; continue with --resume"
    )
    _process.tell_if_interrupted(kept)
    with _surveys.workers(keys) as executor:
        if around:
            scan |= {} if keys.spread is None else {"spread": keys.spread}
            table = rs.design.explore_around(_app.model_of(keys.instrument), executor=executor, **scan)
        else:
            table = rs.design.explore_designs(executor=executor, **scan)
    _designs.finish(table, output)
