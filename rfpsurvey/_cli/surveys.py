"""Functions of the command ``survey``, which read targets and tiles, start workers and print a summary."""

import signal
import sys
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from time import perf_counter

import rfpsurvey as rs
from rfpsurvey._cli.printing import files, print_facts, print_model, print_table, print_text
from rfpsurvey._cli.process import set_up_worker, tell_if_interrupted
from rfpsurvey._common.executors import released
from rfpsurvey._survey import key_groups, key_objects
from rfpsurvey._survey.columns import survey_facts

MANY = 0.05  # the collision rate of assigned arms above which a hint is printed


LITTLE = 0.001  # the fraction of visits below which the text before a search advises against a long search


def options_of(keys) -> dict:
    """Return the parameters that `plan_survey` and `selection_probabilities` have in common, for their keys."""
    same = {name: getattr(keys, name) for name in ("epoch", "lost_in_collision", "order", "rng")}
    return same | {"passes": keys.tiles.passes, "folder": keys.output.folder, "resume": keys.output.resume}


def check_replan(keys) -> None:
    """Raise an error if the rest of a survey is to be planned, but there is no survey."""
    folder = keys.output.folder
    if keys.output.replan and (folder is None or not (folder / "survey.json").is_file()):
        raise rs.InputError(
            "--replan must be used with the folder of a survey, such as rfpsurvey survey FOLDER --replan, got "
            f"{folder or keys.catalog.path or 'no folder'}"
        )


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
    s, parameters = survey.summary, survey.provenance["parameters"]
    print_model(survey.provenance["instrument"]["name"], parameters["allocator"], s, parameters)
    print_facts(survey_facts(survey))
    if survey.joint is not None:
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
    if survey.rules is not None:
        print("constraints, with the numbers of tiles with each verdict, and the first tiles that fail:")
        print_table(survey.rules)
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
