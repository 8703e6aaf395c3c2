"""Repeat the experiments of Chen et al. (2024), arXiv:2409.07288, and compare the results with the paper.

Examples
--------
  python docs/reproduction small
  python docs/reproduction all --quick --folder quick --report quick.html
"""

import argparse
import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
import rfpsurvey as rs
from reproduction import EXPERIMENTS, reproduce
from rfpsurvey._common.temporary import remove_all


def options_of(words: list[str] | None) -> argparse.Namespace:
    """Parse the words of the command line."""
    parser = argparse.ArgumentParser(
        "reproduction", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = ", ".join([*EXPERIMENTS, "or all"])
    parser.add_argument("experiment", nargs="?", default="all", help=f"Experiment: {names}.")
    parser.add_argument(
        "--folder",
        type=Path,
        default=Path("reproduction"),
        help="Folder for the tables, the figures, and the list of the claims of the paper.",
    )
    parser.add_argument("--quick", action="store_true", help="Run a short test with few designs and repetitions.")
    parser.add_argument("--workers", type=int, help="Number of threads; by default, the number of cores.")
    parser.add_argument("--seed", type=int, default=0, help="Seed of the random numbers.")
    parser.add_argument("--report", type=Path, help="HTML page on the results.")
    parser.add_argument("--overwrite", action="store_true", help="Replace existing files.")
    return parser.parse_args(words)


def main(words: list[str] | None = None) -> None:
    """Run the experiments, write the report, and print the claims."""
    options = options_of(words)
    if options.report is not None:
        rs.report.check_report(options.report, overwrite=options.overwrite)
    settings = {"quick": options.quick, "workers": options.workers, "rng": options.seed, "overwrite": options.overwrite}
    claims = reproduce(options.experiment, options.folder, progress=sys.stderr.isatty(), **settings)
    for row in claims:
        print(f"{row['experiment']}: {row['claim']}\n    paper: {row['paper']}\n    here: {row['ours']}")
        print(f"    {row['verdict']} ({row['reading']})")
    print(f"wrote {options.folder}")
    if options.report is not None:
        rs.write_report(claims, options.report, data="claims.ecsv", overwrite=options.overwrite)
        print(f"wrote {options.report}")


if __name__ == "__main__":
    try:
        main()
    except (rs.InputError, OSError) as error:
        print(f"reproduction: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        remove_all()
        print("reproduction: interrupted", file=sys.stderr, flush=True)
        os._exit(130)  # without waiting for the threads
