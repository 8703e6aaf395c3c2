"""Functions of the command ``survey``, which read targets and tiles, start workers and print a summary."""

import signal
import sys
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from time import perf_counter

import rfpsurvey as rs
from rfpsurvey._cli import _app, _options
from rfpsurvey._cli._process import set_up_worker, tell_if_interrupted
from rfpsurvey._executors import end_with_parent, released
from rfpsurvey.plot import draw_survey
from rfpsurvey.report import survey_facts
from rfpsurvey.tiling import warn_of_targets

__all__ = ["run", "targets_of", "tiles_of", "workers"]

MANY = 0.05  # the collision rate above which a hint is printed


def targets_of(path: Path | None, model: "rs.Instrument", seed: int, column, unit, frame: str, fill, keep, hdu):
    """Read a catalog from a file or a folder of partitions; by default, make a synthetic catalog wider than a field."""
    if path is None:
        _app.warn_without_catalog(column=column, unit=unit, frame=frame, fill=fill, keep=keep, hdu=hdu)
        options = {"density": model.target_density, "rng": seed}
        return rs.synthetic_catalog(
            "poisson", _app.parse_center(_app.DEFAULT_CENTER), 2 * model.field_radius, **options
        )
    return _app.read_catalog(path, column, unit, frame, fill, keep, hdu)


def tiles_of(tiling: "rs.Tiling | None", targets, model: "rs.Instrument") -> "rs.Tiling":
    """Return the given tiles; if no tiles are given, return tiles that cover the catalog twice."""
    if tiling is not None:
        warn_of_targets(tiling, len(targets))
        return tiling
    if isinstance(targets, rs.PartitionedCatalog):
        raise rs.InputError(
            "--tiles must be given for a partitioned catalog: make a table of tiles with rfpsurvey tile --region"
        )
    return rs.place_tiles(targets, model, passes=2)


@contextmanager
def workers(number: int, scheduler: str | None, *, processes: bool):
    """Provide an executor (threads, processes or Dask), or None if all tiles are planned in the main thread."""
    if scheduler is not None:
        try:
            from distributed import Client
        except ImportError as error:
            raise rs.InputError(f"--scheduler needs dask (pip install 'rfpsurvey[distributed]'): {error}") from error
        try:
            client = Client(scheduler, timeout="10s")
        except (OSError, ValueError, TypeError) as error:
            raise rs.InputError(f"--scheduler: no Dask scheduler answers at {scheduler!r}: {error}") from error
        with client:
            yield client.get_executor()
    elif number == 1 and not processes:
        yield None
    else:
        pool: Executor
        if processes:
            # multiprocessing would warn about resources that it removes after the process was interrupted
            sys.warnoptions.append("ignore::UserWarning:multiprocessing.resource_tracker")
            pool = ProcessPoolExecutor(number, _Context(), initializer=_set_up_worker)
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


def _set_up_worker() -> None:
    set_up_worker()
    end_with_parent()


def _print_survey(survey: "rs.Survey", seconds: float) -> None:
    """Print the summary of a survey, one value per line."""
    s, name = survey.summary, survey.provenance["instrument"]["name"]
    print(f"{name}, allocator {survey.provenance['parameters']['allocator']}")
    if "model" in s:  # the value is missing in surveys that earlier versions wrote
        print(f"model: {s['model']}")
    for label, value in survey_facts(survey).items():
        print(f"{label:<34}{value:>12.4f}" if isinstance(value, float) else f"{label:<34}{value:>12}")
    if survey.joint is not None:
        last = survey.joint[survey.joint["iteration"] == survey.joint["iteration"].max()]
        print(
            "joint plan: for each priority, the number of visits to targets of at least this priority, and its "
            "upper bound:"
        )
        _app.print_table(last)
    print("visits and completeness after each pass:")
    _app.print_table(survey.completeness)
    if s["collision_rate"] > MANY:
        print(f"many arms collide; these allocators avoid collisions: {_options.AVOIDING}")
    print(f"computing time {seconds:.1f} s, {1e3 * seconds / s['n_tiles']:.2f} ms per tile")


def run(
    targets,
    tiling: "rs.Tiling",
    model: "rs.Instrument",
    executor,
    options: dict,
    plot: Path | None,
    quality: Path | None,
    report: Path | None,
    *,
    overwrite: bool,
) -> None:
    """Plan a survey and print its summary; write the plots and the report if requested."""
    begin = perf_counter()
    stored = "finished tiles" if isinstance(options["order"], str) else "state of the search and the finished tiles"
    kept = (
        f"the {stored} are stored in the folder; continue with --resume"
        if options["folder"]
        else "no tiles were stored, because --folder was not given"
    )
    tell_if_interrupted(kept)
    survey = rs.plan_survey(targets, model, tiling, executor=executor, progress=True, **options)
    seconds = perf_counter() - begin
    with _app.files(
        overwrite=overwrite,
        plot=(plot, lambda: draw_survey(survey)),
        quality=(quality, lambda: rs.plot.plot_quality(survey)[0].figure),
        report=(report, survey, {}),
    ):
        _print_survey(survey, seconds)
        if survey.folder is not None:
            print(f"wrote {survey.folder}")
