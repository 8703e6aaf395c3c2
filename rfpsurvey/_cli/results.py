"""Functions that compute surveys in workers, print the results of commands and write files with the results."""

import signal
import sys
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from shutil import get_terminal_size
from textwrap import fill
from time import perf_counter

import numpy as np
from astropy.table import QTable

import rfpsurvey as rs
from rfpsurvey._cli.application import VERBOSE
from rfpsurvey._cli.process import set_up_worker, tell_if_interrupted
from rfpsurvey._common.executors import released
from rfpsurvey._common.files import is_fits, suffix_of
from rfpsurvey._common.io import write_table, writing_to
from rfpsurvey._field.facts import rules_of_tile, tile_facts, tile_objectives, tile_problems
from rfpsurvey._survey import key_groups, key_objects
from rfpsurvey._survey.columns import survey_facts
from rfpsurvey.errors import brief
from rfpsurvey.report import estimate_facts, model_facts, tiling_facts

PICTURES = (".png", ".pdf", ".svg")
MOST_OBJECTIVES = 12
MIN_WIDTH, MOST_ROWS = 60, 8
"""Smallest width of text, and largest number of rows or files that are printed without --verbose."""
DETAILS = ("method", "instrument", "arm model", "definition of the completeness", "epoch", "fibers per tile")
LONG = 44  # number of characters of the labels of a tiling
MAP = (
    "The color gives the collision probability of each positioner. The probabilities of single positioners "
    "scatter, since the number of random trials is finite. The expected probability is the same everywhere "
    "inside a regular lattice without gaps; positioners at edges and beside gaps have fewer neighbors. "
    "Dashed circles mark positioners that are not counted in the mean."
)


def is_verbose() -> bool:
    """Return whether the command prints more than its result."""
    return VERBOSE.get()


def print_text(text: str, indent: str = "  ") -> None:
    """Print text in lines as wide as the terminal; all lines except the first one begin with ``indent``."""
    width = max(get_terminal_size((100, 24)).columns, MIN_WIDTH)
    print(fill(text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False))


def tell(text: str) -> None:
    """Print text with --verbose."""
    if is_verbose():
        print_text(text)


def print_facts(facts: Mapping[str, object], width: int = 12, wide: int = 34) -> None:
    """Print labels and values, one pair per line, in columns with the given numbers of characters."""
    for label, value in facts.items():
        text = f"{value:.4f}" if isinstance(value, float) else str(value)
        print(f"{label:<{wide}}{text:>{width}}")


def print_model(name: str, allocator: str, summary: Mapping, parameters: Mapping) -> None:
    """Print the first lines of the summary of a survey: the instrument, the allocator, the model and the epoch."""
    print(f"{name}, allocator {allocator}")
    if "model" in summary and is_verbose():  # the value is missing in surveys that earlier versions wrote
        print_text(f"model: {summary['model']}")
    if is_verbose() and (text := summary.get("epoch")) and (parameters.get("epoch") is None or "the time" in text):
        print_text(f"epoch: {text}")


@contextmanager
def files(output, *, write=None, draw=None, quality=None, report=None) -> Iterator[None]:
    """Write the output files before the summary is printed, and print their names after the summary.

    The files are written first, so that they exist even if the program that reads the printed text closes the pipe.
    If writing one of them fails or is interrupted, there are no new files.
    ``output`` contains the keys of the outputs. ``write`` writes the file with the given path, and ``draw`` and
    ``quality`` return the figures of the files ``plot`` and ``quality``. ``report`` contains the result and the options
    of `write_report`.
    """
    calls = {} if write is None else {"path": lambda file, _: write(file)}
    for name, figure in (("plot", draw), ("quality", quality)):
        calls[name] = lambda file, path, figure=figure: figure().savefig(file, dpi=200, format=path.suffix[1:].lower())
    calls["report"] = lambda file, _: rs.write_report(report[0], file, **report[1])
    writers = [(path, call) for name, call in calls.items() if (path := getattr(output, name, None)) is not None]
    with ExitStack() as stack:  # all files are renamed when all of them are complete
        for path, call in writers:
            file = stack.enter_context(writing_to(path, (suffix_of(path),), overwrite=output.overwrite, gzipped=True))
            try:
                call(file, path)
            except rs.InputError as error:
                raise type(error)(str(error).replace(str(file), str(path))) from error
    yield
    for path, _ in writers:
        print(f"wrote {path}")


def finish(tile: "rs.Tile", output) -> None:
    """Write a tile and, if requested, its figures and its report, and print its summary."""
    path, color = output.path, getattr(output, "targets", None)
    with files(
        output,
        write=tile.write,
        draw=lambda: rs.plot.plot_focal_plane(tile, targets=color).figure,
        quality=lambda: rs.plot.plot_quality(tile)[0].figure,
        report=(tile, {"data": path}),
    ):
        print_summary(tile)
        if path is not None and tile.outcomes is not None and not is_fits(path):
            print(
                f"{path} does not contain the outcomes of targets; to keep the outcomes, write a .fits file, "
                "which can hold two tables"
            )


def finish_tiling(tiling: "rs.Tiling", shown: dict, output) -> None:
    """Write a tiling, its plot (with the targets and the region in ``shown``) and its report; print its summary."""
    with files(
        output,
        write=tiling.write,
        draw=lambda: rs.plot.draw_tiling(tiling, **shown),
        report=(tiling, {"data": output.path}),
    ):
        facts = tiling_facts(tiling)
        print_facts({label: facts[label] for label in facts if is_verbose() or label not in DETAILS}, 10, LONG)


def finish_comparison(table, plans: dict, output) -> None:
    """Print a comparison of allocators, and write the files that are requested: the table, the plot and the report."""
    with files(
        output,
        write=partial(write_table, table),
        draw=lambda: rs.plot.plot_allocators(table).figure,
        report=(table, {"data": output.path, "plans": plans}),
    ):
        kept = f", margins: {table.meta['margins']}" if "margins" in table.meta else ""
        print_table(table)
        print_text(
            f"{table.meta['instrument']}, arm model {table.meta['arm_model']}{kept}; {table.meta['blind_science']} "
            "science targets could be assigned if arms did not collide"
        )
        for name, sentences in table.meta["unmet"].items():
            for sentence in sentences:
                print_text(f"{name}: not met: {sentence}")


def finish_estimate(estimate, model: "rs.Instrument", output) -> None:
    """Print an estimate of a collision probability; write the table, the plot and the report if requested."""
    plane, shape = model.focal_plane, model.focal_plane.positioner.arm_model
    table = QTable({"id": plane.id, "x": plane.xy[:, 0], "y": plane.xy[:, 1], "probability": estimate.per_positioner})
    table.meta.update(
        estimate.meta, instrument=model.name, arm_model=shape, method=estimate.method, value=estimate.value
    )

    def draw():
        return rs.plot.plot_collision_map(estimate, plane).figure

    page = {"title": f"Collision probability of {model.name}"}
    if output.report is not None:
        page["figures"] = {MAP: draw()}
    with files(output, write=partial(write_table, table), draw=draw, report=(estimate, page)):
        kept = f", margins: {margins}" if (margins := model.focal_plane.margins) else ""
        print_text(f"{model.name}, arm model {shape}{kept}, {estimate.method}, {estimate.estimand} targets")
        print_facts(estimate_facts(estimate), 0)
        meta = {k: v for k, v in estimate.meta.items() if k not in ("confidence", "interval")}
        tell(", ".join(f"{k} {v:.6g}" if isinstance(v, float) else f"{k} {v}" for k, v in meta.items()))


def finish_table(table, draw, output) -> None:
    """Print a table of results, and write it with its plot and, if requested, its report."""
    name, page = table.meta["instrument"], {"data": output.path}
    if output.report is not None:
        caption = f"Computing time and error of each method, for {name}."
        page |= {"title": f"Benchmark: {name}", "figures": {caption: draw(table)[0]}}
    with files(output, write=partial(write_table, table), draw=lambda: draw(table)[0].figure, report=(table, page)):
        print_table(table)


def print_summary(tile: "rs.Tile") -> None:
    """Print the summary of a tile, one value per line."""
    name, values, verbose = tile.provenance["instrument"]["name"], tile.provenance["parameters"], is_verbose()
    layout = f", {tile.provenance['instrument'].get('layout', '')}" if values["allocator"] == "scored" else ""
    print(f"{name}{layout.rstrip(', ')}, allocator {values['allocator']}")
    for text in tile_problems(tile):
        print_text(text)
    print_facts(tile_facts(tile, is_short=not verbose), 10)
    _print_objectives(tile)
    if not verbose:
        print(f"{'seconds':<34}{sum(tile.summary['seconds'].values()):>10.3f}")
        return
    if "ra_deg" in values:
        turn = f"position angle {values['position_angle_deg']:g} deg from the north of {values['north_of']}"
        where = f"center {values['ra_deg']:.6f} {values['dec_deg']:+.6f} deg"
        print_text(f"{where}, {turn}, epoch {values['epoch'] or 'unknown'}")
        if tile.summary.get("epoch") and values.get("epoch_asked") is None:
            print_text(f"epoch: {tile.summary['epoch']}")
    elif "positions" in values:
        print("collisions were found from positions on the focal plane, which do not require a field center")
    for label, text in model_facts(tile).items():
        print_text(f"{label}: {text}")
    kinds = {"standard", "sky"} & set([] if tile.completeness is None else tile.completeness["kind"])
    if kinds and not values["requirements"]:
        example = " ".join(f"--constraint {kind}=20" for kind in sorted(kinds))
        text = f"standard stars and sky positions are assigned only if numbers of them are required, such as {example}"
        print_text(text)
    if tile.completeness is not None and len(tile.completeness) > 1:
        print_text(
            "number of targets of the field by kind, category and priority; a target is observed if it is assigned "
            "and its positioner does not collide:"
        )
        print_table(tile.completeness)
    seconds = tile.summary["seconds"]
    each = ", ".join(f"{name} {value:.3f}" for name, value in seconds.items())
    print_text(f"{'seconds':<34}{sum(seconds.values()):>10.3f}  {each}", " " * 46)


def _print_objectives(tile: "rs.Tile") -> None:
    """Print the value of each objective, the gap to the best possible plan, and the requirements that are not met."""
    summary = tile.summary
    for name, value, proof in tile_objectives(tile, MOST_OBJECTIVES) if is_verbose() else ():
        print(f"{'  ' + name:<34}{value:>10}  {proof}".rstrip())
    if summary.get("gap") is not None:
        model = summary["search"].get("model", "")
        print(f"{'gap to the best plan':<34}{summary['gap']:>10.4f}  {model}".rstrip())
    for sentence in summary.get("unmet", []) if is_verbose() else ():
        print_text(f"not met: {sentence}")
    _print_rules(tile)


def _print_rules(tile: "rs.Tile") -> None:
    """Print the verdict on each constraint."""
    if tile.rules is None or not is_verbose():  # the first lines state what is not met
        return
    print("constraint, number, limit, verdict, and positioners that violate it:")
    for verdict in rules_of_tile(tile.rules):
        number = [] if np.isnan(verdict["number"]) else [f"{verdict['number']:.6g} ({verdict['limit']})"]
        fibers = [f"positioners {brief(tuple(verdict['fibers'].split()))}"] if verdict["fibers"] else []
        words = "; ".join([*number, *filter(None, [verdict["note"]]), *fibers])
        print_text(f"{verdict['verdict']:<14}{verdict['rule']}: {words}", " " * 16)


def print_table(table) -> None:
    """Print a table of results with four significant digits."""
    table = table.copy()
    for column in table.columns.values():
        if column.dtype.kind == "f":
            column.info.format = ".4g"
    print("\n".join(table.pformat(max_lines=-1, max_width=-1)))


MANY = 0.05  # the collision rate of assigned arms above which a hint is printed


LITTLE = 0.001  # the fraction of visits below which the text before a search advises against a long search


def options_of(keys) -> dict:
    """Return the parameters that `plan_survey` and `selection_probabilities` have in common, for their keys."""
    same = {name: getattr(keys, name) for name in ("epoch", "lost_in_collision", "order", "rng")}
    return same | {"passes": keys.tiles.passes, "folder": keys.output.folder, "resume": keys.output.resume}


@contextmanager
def workers(keys):
    """Provide an executor (threads, processes or Dask), or None if all tiles are planned in the main thread."""
    number, processes, scheduler = keys.workers, getattr(keys, "processes", False), getattr(keys, "scheduler", None)
    if scheduler is not None:
        try:
            from distributed import Client
        except ImportError as error:
            raise rs.InputError(f"scheduler needs dask (pip install 'rfpsurvey[distributed]'): {error}") from error
        try:
            client = Client(scheduler, timeout="10s")
        except (OSError, ValueError, TypeError) as error:
            raise rs.InputError(f"scheduler: no Dask scheduler answers at {scheduler!r}: {error}") from error
        with client:
            yield client.get_executor()
    elif number == 1 and not processes:
        yield None
    else:
        pool: Executor
        if processes:
            # multiprocessing would warn about resources that it removes after the process was interrupted
            sys.warnoptions.append("ignore::UserWarning:multiprocessing.resource_tracker")
            pool = ProcessPoolExecutor(number, _Context(), initializer=set_up_worker)
        else:
            pool = ThreadPoolExecutor(number)
        with released(pool):
            yield pool


class _Worker(SpawnProcess):
    """A worker process that does not receive Ctrl-C, not even while it starts."""

    def start(self) -> None:
        """Start the process, which inherits the blocked signal."""
        if not hasattr(signal, "pthread_sigmask"):
            super().start()
            return
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Context(SpawnContext):
    Process = _Worker


def _print_survey(survey: "rs.Survey", seconds: float) -> None:
    """Print the summary of a survey, one value per line."""
    s, parameters, verbose = survey.summary, survey.provenance["parameters"], is_verbose()
    print_model(survey.provenance["instrument"]["name"], parameters["allocator"], s, parameters)
    print_facts(survey_facts(survey, is_short=not verbose))
    if survey.joint is not None and verbose:
        last = survey.joint[survey.joint["iteration"] == survey.joint["iteration"].max()]
        before = ", before arms without a path lose their targets" if "n_without_path" in s else ""
        print_text(
            "joint plan: for each priority, the number of visits to targets of at least this priority, and its "
            f"upper bound{before}:"
        )
        print_table(last)
        levels = s["joint"]["levels"]
        if "bound_without_requirements" in levels[-1]:
            print_text(
                "the bounds apply to plans in which every tile meets each requirement at least as well as in the first "
                f"plan; no plan makes more than {levels[-1]['bound_without_requirements']} visits"
            )
    if survey.rules is not None and verbose:
        print("constraints, with the numbers of tiles with each verdict, and the first tiles that fail:")
        print_table(survey.rules)
    if verbose:
        print("visits and completeness after each pass:")
        print_table(survey.completeness)
    if s.get("collision_rate_assigned", s["collision_rate"]) > MANY:
        print_text(f"many arms collide; these allocators avoid collisions: {key_groups.AVOIDING}")
    print(f"computing time {seconds:.1f} s, {1e3 * seconds / s['n_tiles']:.2f} ms per tile")


def _print_gain(state: dict) -> None:
    """Print the number of visits before the search, and the largest number of visits that the search can reach."""
    before, visits, bound = state["visits_before"][-1], state["visits"][-1], int(state["bound"][-1])
    more = max(bound - visits, 0)
    part = more / max(visits, 1)
    text = (
        f"visits: {before} with tiles planned one after the other; {visits} after visits were moved between tiles; "
        f"at most {max(bound, visits)} with any plan\n"
    )
    several = any(int(b) > v for v, b in zip(state["visits"][:-1], state["bound"][:-1], strict=True))
    if more == 0 and not several:
        text += "the search cannot add visits"
    elif part < LITTLE and not several:
        text += f"the search can add at most {more} visits ({part:.2%}); a long search is not worthwhile"
    else:
        text += f"the search can add at most {more} visits ({part:.2%})"
        text += ", or move visits from targets of lower priority to targets of higher priority" if several else ""
    print(text, file=sys.stderr)


def run(executor, options: dict, output, given) -> "rs.Survey":
    """Plan a survey, print its summary and return it; write the plots, the report and the plan file of ``given``."""
    begin = perf_counter()
    is_joint = isinstance(options["allocator"], rs.JointOptions)
    if is_joint:
        options["allocator"] = replace(options["allocator"], inform=_print_gain)
    stored = "state of the search and the finished tiles" if is_joint else "finished tiles"
    kept = (
        f"the {stored} are stored in the folder; continue with {'the same command' if output.replan else '--resume'}"
        if output.folder
        else "no tiles were stored, because --folder was not given"
    )
    tell_if_interrupted(kept)
    tables = ("options", "joint") if is_joint else ("options",)
    if options["resume"] and output.folder is not None and not (output.folder / "survey.json").is_file():
        print(f"{output.folder} does not contain a survey; a new survey is planned", file=sys.stderr)
    token = key_objects.PLAN_FILE.set(partial(given.record, tables=tables, outputs=("output.folder",)))
    try:
        survey = rs.plan_survey(executor=executor, progress=True, **options)
    finally:
        key_objects.PLAN_FILE.reset(token)
    seconds = perf_counter() - begin
    survey.provenance["plan_file"] = given.record(Path(), tables, ("output.folder",))
    with files(
        output,
        draw=lambda: rs.plot.draw_survey(survey),
        quality=lambda: rs.plot.plot_quality(survey)[0].figure,
        report=(survey, {}),
    ):
        _print_survey(survey, seconds)
        if survey.folder is not None:
            print(f"wrote {survey.folder}")
    return survey
