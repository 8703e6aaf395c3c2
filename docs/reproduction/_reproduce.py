"""Repeat the experiments of Chen et al. (2024), write tables and figures, and compare the results with the claims."""

import os
import platform
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib.metadata import version
from pathlib import Path

from astropy.table import QTable

from reproduction._claims import Claim, claims_page, claims_table
from reproduction._designs import Settings
from reproduction._figures import draw_reproduction
from reproduction._intervals import intervals
from reproduction._large import fit, large
from reproduction._poisson import poisson
from reproduction._report import TABLES, page_of_claims
from reproduction._small import small
from reproduction._speed import speed
from rfpsurvey._common.executors import released
from rfpsurvey._common.files import check_output, to_path
from rfpsurvey._common.folder import locked
from rfpsurvey._common.io import write_table, writing_to
from rfpsurvey.errors import InputError, check_choice, check_keywords, check_whole
from rfpsurvey.report._write import MADE_BY

__all__ = ["EXPERIMENTS", "reproduce"]

MADE_BY["reproduce"] = (page_of_claims, {"experiment", "verdict"})  # the page that write_report makes for the claims

EXPERIMENTS: dict[str, Callable] = {
    "small": small,
    "large": large,
    "poisson": poisson,
    "fit": fit,
    "intervals": intervals,
    "speed": speed,
}
"""Experiments by name; each is a function that takes `Settings` and returns a dict of tables and a list of claims."""


@check_keywords
def reproduce(
    experiment: str = "all",
    folder: str | os.PathLike = "reproduction",
    *,
    quick: bool = False,
    workers: int | None = None,
    rng: int = 0,
    overwrite: bool = False,
    progress: bool = False,
) -> QTable:
    """Repeat the experiments of Chen et al. (2024), arXiv:2409.07288, and compare the results with the claims.

    Parameters
    ----------
    experiment : {"all", "small", "large", "poisson", "fit", "intervals", "speed"}, optional
        ``small``: scans of arm ratio and pitch with 19 positioners. ``large``: comparison of formula and simulation for
        80 random designs with 469 positioners. ``poisson``: the same designs with Poisson-distributed targets, for
        every interpretation of the paper. ``fit``: the fit of the polynomial, and the errors of the surrogate for
        designs that were not used to make the surrogate. ``intervals``: how often confidence intervals contain the true
        value, for random targets and for given targets. ``speed``: the time to find collisions if each arm consists of
        64 segments, compared with the time of a method that uses swept areas. ``all``: all experiments.
    folder : str or path, optional
        Folder for the tables (ECSV), figures (PNG) and the page of claims (``claims.rst``); it is created if it does
        not exist.
    quick : bool, optional
        Whether to use few designs, repeats and iterations. The results then test the code, but not the claims.
    workers : int, optional
        Number of threads, by default the number of cores. Results other than times do not depend on this number.
    rng : int, optional
        Seed of the random number generators.
    overwrite : bool, optional
        Whether to replace outputs of an earlier run.
    progress : bool, optional
        Whether to show the progress on the standard error stream.

    Returns
    -------
    QTable
        Table with a row for each claim and the columns ``experiment``, ``claim``, ``paper`` (the result of the paper),
        ``ours`` (the result of this package), ``verdict`` (reproduced, not reproduced, or cannot be decided from the
        text), and ``reading`` (how the claim was interpreted). The ``meta`` of the table contains the settings. Its
        entry ``folder`` is the path of the folder that contains the tables of results.

    Raises
    ------
    InputError
        If the name of the experiment is unknown, if ``rng`` or ``workers`` is invalid, if ``folder`` is a file or is
        used by another run, or if outputs exist and ``overwrite`` is False.

    References
    ----------
    Chen et al. (2024), arXiv:2409.07288, "General Methods for Evaluating Collision Probability of Different Types of
    Theta-phi Positioners".

    Examples
    --------
    >>> import tempfile
    >>> from reproduction import reproduce
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     claims = reproduce("small", f"{folder}/paper", quick=True)
    >>> print(claims["claim"][0])
    the probability increases rapidly with the arm ratio
    """
    check_choice(experiment, ["all", *EXPERIMENTS], "experiment")
    names = list(EXPERIMENTS) if experiment == "all" else [experiment]
    if not isinstance(rng, int) or rng < 0:
        raise InputError(f"rng must be a seed, a whole number of at least 0, got {rng!r}")
    workers = os.cpu_count() or 1 if workers is None else workers
    check_whole(workers, "workers")
    folder = to_path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} must be a folder, but it is a file")
    folder.mkdir(parents=True, exist_ok=True)
    claims: list[Claim] = []
    made: dict[str, QTable] = {}
    with locked(folder, folder / "lock"), released(ThreadPoolExecutor(workers)) as executor:
        for name in ("claims", *(table for one in names for table in TABLES[one])):
            for ending in (".ecsv", ".rst" if name == "claims" else ".png"):
                check_output(folder / f"{name}{ending}", (ending,), overwrite=overwrite)
        settings = Settings(quick, executor, progress, rng)
        for name in names:
            run = EXPERIMENTS[name]
            if name in ("fit", "poisson") and "large" in made:  # reuse the estimates for the same designs
                run = partial(run, table=made["large"])
            tables, own = run(settings)
            made.update(tables)
            claims += own
            for key, table in tables.items():
                table.meta.update(_provenance(settings))
                write_table(table, folder / f"{key}.ecsv", overwrite=True)
            for key, figure in draw_reproduction(name, tables).items():
                with writing_to(folder / f"{key}.png", (".png",), overwrite=True) as temporary:
                    figure.savefig(temporary, dpi=150, format="png")
            _write_claims(folder, claims, settings)
    table = claims_table(claims)
    table.meta.update(_provenance(settings), made_by="reproduce", folder=str(folder))
    return table


def _write_claims(folder: Path, claims: list[Claim], settings: Settings) -> None:
    table = claims_table(claims)
    table.meta.update(_provenance(settings))
    write_table(table, folder / "claims.ecsv", overwrite=True)
    with writing_to(folder / "claims.rst", (".rst",), overwrite=True) as temporary:
        temporary.write_text(claims_page(table, _provenance(settings)), encoding="utf-8")


def _provenance(settings):
    return {
        "quick": settings.quick,
        "seed": settings.seed,
        "rfpsurvey": version("rfpsurvey"),
        "numpy": version("numpy"),
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
    }
