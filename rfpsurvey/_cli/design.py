"""The command ``rfpsurvey design``."""

import sys

import rfpsurvey as rs
from rfpsurvey._cli import _app, _designs, _examples, _main, _options, _process, _states, _surveys


@_main.app.command(epilog=_examples.DESIGN_EXAMPLES)
def design(
    instrument: _options.DesignInstrumentOption = None,
    state_time: _states.OwnStateTimeOption = None,
    spread: _options.SpreadOption = None,
    central_arm: _options.CentralArmOption = None,
    ratio: _options.RatioOption = None,
    pitch: _options.PitchOption = None,
    clearance: _options.ClearanceOption = None,
    n_designs: _options.NDesignsOption = None,
    estimand: _options.EstimandOption = None,
    method: _designs.DesignMethodOption = "auto",
    targets_per_positioner: _options.EachOption = None,
    target_density: _options.DensityOption = None,
    n_skies: _options.SkiesOption = 8,
    time_limit: _options.TimeLimitOption = 10.0,
    objective: _options.DesignObjectiveOption = None,
    seed: _options.SeedOption = 0,
    workers: _options.WorkersOption = 1,
    processes: _options.ProcessesOption = False,
    output: _options.DesignOutputOption = None,
    resume: _options.DesignResumeOption = False,
    plot: _options.DesignPlotOption = None,
    report: _options.ReportOption = None,
    overwrite: _options.OverwriteOption = False,
) -> None:
    """Scan designs of positioners, optionally around the design of an instrument, and find the best designs."""
    _app.check_outputs(None, plot, report, overwrite=overwrite, inputs=[instrument])
    around = instrument is not None
    if spread is not None and not around:
        raise rs.InputError(
            "--spread must be used with --instrument, which names the instrument whose design is varied; "
            "got no --instrument"
        )
    parameters = {"central_arm": central_arm, "ratio": ratio, "pitch": pitch, "clearance": clearance}
    scan = _designs.axes(n_designs, around=around, **parameters)
    scan["loss"] = _designs.loss(estimand, method, targets_per_positioner, target_density, n_skies, time_limit)
    scan["objectives"] = _app.parse_pairs(objective, "--objective") or None
    scan |= {"n_designs": n_designs, "rng": seed, "progress": sys.stderr.isatty()}
    scan |= {"path": output, "resume": resume, "overwrite": overwrite}
    kept = (
        "no designs were stored, because --output was not given"
        if output is None
        else f"the finished designs are stored in {output}; continue with --resume"
    )
    _process.tell_if_interrupted(kept)
    with _surveys.workers(workers, None, processes=processes) as executor:
        if around:
            scan |= {} if spread is None else {"spread": spread}
            model = _app.model_of(instrument, state_time=state_time)
            table = rs.design.explore_around(model, executor=executor, **scan)
        else:
            table = rs.design.explore_designs(executor=executor, **scan)
    _designs.finish(table, output, plot, report, overwrite=overwrite)
