"""Numbers that pages of the documentation quote, and the scripts that print them.

In the texts, each # stands for a number, and ... for any text. White space is arbitrary.
"""

import re
from typing import NamedTuple

import numpy as np

NUMBER = r"[-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?"


class Quoted(NamedTuple):
    """Numbers of a page (without ``.rst``), and the text with which a script prints these numbers."""

    page: str
    printed: str
    quoted: str
    factor: float = 1.0
    """The quoted numbers are the printed ones multiplied by this factor, such as 100 for per cent."""


def numbers(text: str, template: str) -> list[str]:
    """Return the numbers at the places # of a template in a text."""
    parts = {"#": f"({NUMBER})", "...": ".*?"}
    pattern = "".join(parts.get(part, re.escape(part)) for part in re.split(r"(#|\.\.\.)", template))
    found = re.search(pattern, " ".join(text.split()))
    assert found, f"no text {template!r}"
    return [group.replace(",", "") for group in found.groups()]


def unit(number: str) -> float:
    """Return the unit of the last digit of a number."""
    mantissa, _, exponent = number.partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def same(printed: str, quoted: str, factor: float) -> bool:
    """Return whether a quoted number is a printed number, multiplied by a factor, apart from rounding."""
    units = unit(printed) * factor, unit(quoted)
    rounding = 0.0 if np.isclose(*units) else 0.5 * sum(units)
    return abs(float(printed) * factor - float(quoted)) <= rounding + 1e-6 * units[1]


def differences(output: str, page: str, one: Quoted) -> list[str]:
    """Return a description of each number of a page that is not the number in the output of a script."""
    printed, quoted = numbers(output, one.printed), numbers(page, one.quoted)
    assert len(printed) == len(quoted) > 0, one
    return [
        f"{one.page}: {q} in {one.quoted!r}, but the script prints {p}"
        for p, q in zip(printed, quoted, strict=True)
        if not same(p, q, one.factor)
    ]


def sdssv() -> list[Quoted]:
    """Return the rows of the table on collisions in plans of SDSS-V, for nominal arms and two calibrations."""
    plans = {name: name for name in ("design 21636", "design 21637", "design 50323")}
    plans |= {"field a": "field A", "confSummary-test": "configuration of 2024", "confSummary-998": "configuration 998"}
    plans["confSummaryF-998"] = "configuration 998 as measured"
    cells = "#, # #, # #, #"

    def printed(name, columns):
        return " ... ".join(f"{name} {kind} {columns}" for kind in ("nominal", "sdssv_apo_2021", "sdssv_apo_2024"))

    return [Quoted("as_built", printed(name, "... # ... #"), f"{row} {cells}") for name, row in plans.items()]


def pfs() -> list[Quoted]:
    """Return the rows of the table on PFS as built."""
    rows = {
        "nominal lattice": "preset ``pfs`` (nominal lattice)",
        "centers from dots": "centers from dots, dots ignored",
    }
    rows |= {"and dots": "centers from dots, dots included", "and interference limits": "all files"}
    reach = [
        Quoted("as_built", f"{name}: in reach #, of several #, multiplicity", f"{row} # % # %", 100)
        for name, row in rows.items()
    ]
    rows["as built"] = rows.pop("and interference limits")
    del rows["and dots"]
    return reach + [
        Quoted("as_built", f"{name}: collision probability # +- #", f"{row} ... % ... % ... # +- #")
        for name, row in rows.items()
    ]


def margins() -> Quoted:
    """Return the numbers of targets near the outer edges of patrol areas, in plans of SDSS-V."""
    plans = ("confSummary-998.par.gz", "confSummary-test.par.gz", "field planned by robostrategy, nominal instrument")
    printed = " ... ".join(f"{name} ... within 0.2 mm of the outer edge: # of" for name in plans)
    return Quoted("collisions", printed, "a margin of 0.2 mm would exclude #, # and # targets")


def modules() -> list[Quoted]:
    """Return the rows of the tables on designs of modules."""
    arms = " ... ".join(f"mm, {n} targets per positioner: {{'optimal': (#, ... 'nearest': (#," for n in (1, 4))
    gaps = {"0.0": "0", "2.0": "2.0", "4.4": "4.4 (the preset)", "8.0": "8.0"}
    broken = {"1%": "1 %", "3%": "3 %", "10%": "10 %"}
    return [
        *(
            Quoted("modules", f"arms of {length} {arms}", f"{length} # # # #")
            for length in ("1.8", "2.0", "2.2", "2.4")
        ),
        *(
            Quoted("modules", f"gap {name} mm, ... positioners: #% and #%", f"{row} # % # %")
            for name, row in gaps.items()
        ),
        *(
            Quoted("modules", f"{n} of 63 fibers ... mm: {{'LR': #, 'HR': #}}", f"HR fibers ... {n} # #")
            for n in (6, 12, 21)
        ),
        *(Quoted("modules", f"{name} broken: [#, #]", f"{row} # (... %) # (") for name, row in broken.items()),
    ]


def allocators() -> list[Quoted]:
    """Return the rows of the table on the default allocator, without times and without the slow method ``optimal``."""
    return [
        Quoted("allocation", f"{name} {each} ... # ... #", f"{name} {each} # #")
        for name in ("desi", "lamost", "moons", "pfs", "sdss_apo")
        for each in ("1", "5")
    ]


PAIRS = "(# percent of all pairs for LAMOST, # percent"
SCRIPTS = {
    ("accuracy_figures",): [
        Quoted("tradeoffs", "naive crossings of collinear segments: #", "reports that # of 10,000 pairs", 1e4),
        Quoted("tradeoffs", "LAMOST: single precision ... at full stretch by # mm", "mm; # mm for the elbows"),
        Quoted("tradeoffs", "SDSS-V: single precision moves tips by # mm", "as 1 m - # ... :sup:`-5` mm;", 1e5),
        Quoted("benchmarks", "LAMOST: ... middles #, ... SDSS-V: ... middles #,", f"remaining pair {PAIRS}", 100),
        Quoted("benchmarks", "LAMOST: ... by axes #; ... SDSS-V: ... by axes #;", f"not decide {PAIRS}", 100),
    ],
    ("as_built_pfs",): [
        Quoted("as_built", "scale #, rotation # deg", "the scale (#) and the rotation (# deg)"),
        Quoted("as_built", "ones by # mm (median), # at most", "by # mm in the median, and by # mm at most"),
        Quoted("as_built", "centers from dots: # +- # deg", "the mean difference is # +- # deg"),
        Quoted("as_built", "centers nominal: # +- # deg", "deg, and # +- # deg for nominal centers"),
        Quoted("as_built", "the rule forbids #%", "The interference limits forbid # % of the patrol area"),
        Quoted("as_built", "the joint limits forbid #%", "and the stricter ranges forbid # %"),
        *pfs(),
    ],
    ("as_built_sdssv",): sdssv(),
    ("margin_figures", "real"): [margins()],
    ("default_allocator", "--allocator", "lamost_rule", "--allocator", "repair"): allocators(),
    ("observing_desi",): [
        Quoted("observing", "largest residual # mm of", "any of the 19 settings is # mm"),
        Quoted("observing", "largest median # mm,", "and the largest median is # mm"),
        Quoted(
            "observing", "degree 5 # ", "from the ray trace by at most ... mm (median # mm) after one common shift of"
        ),
        Quoted("observing", "degree 5 ... # radial", "in the tangent differs from the ray trace by at most # mm"),
        Quoted("observing", "of the preset # ", "of the preset differs ... by at most ... mm (median # mm)"),
        Quoted("observing", "of the preset ... # map", "of the preset differs from the ray trace by at most # mm"),
        Quoted("observing", "# (50)", "is # mm for a polynomial of degree 3"),
        Quoted("observing", "# (75)", "a polynomial of degree 3, # mm for degree 4"),
        Quoted("observing", "# (140)", "and # mm for degree 6"),
        Quoted("observing", "# (63)", "# mm for a Fourier series of order 1"),
    ],
    ("light",): [
        *(
            Quoted(
                "observing",
                f"sdss_apo, altitude {altitude} deg, seeing 1.0 arcsec: lost # ... 1.2 arcsec: lost # ... lost #",
                f"{text} #, # and # %",
            )
            for altitude, text in (("45", "fibers lose"), ("60", "they lose"))
        ),
        Quoted("observing", "quasars ... 1.5 arcsec: # and # %", "predicts # and # %"),
        Quoted("observing", "45 deg: relative light #, and # at the best", "increases from # to #"),
        Quoted("observing", "of at least 0.8: up to # h", "h instead of # h"),
        Quoted("observing", "of at least 0.8: up to ... h, and # h", "hour angles of up to # h"),
    ],
    ("observing_models",): [
        Quoted(
            "observing", f"{name} altitude 60 deg, um: ... # ", f"dispersion move targets by ... # mm ({title})", 1e-3
        )
        for name, title in {"sdss_apo": "SDSS-V", "moons": "MOONS", "desi": "DESI", "pfs": "PFS"}.items()
    ],
    ("rule_figures", "--field", "sdss_apo:bright_time", "--seconds", "20"): [
        Quoted(
            "rules",
            "no rules # ... counts # ... magnitude # ... bright_stars # ... distribution #",
            "``bright_time`` no rules # ... numbers of fibers # ... magnitudes # ... bright stars # ... distribution #",
        ),
    ],
    ("stage5_figures", "arms", "gaps", "classes", "broken"): modules(),
}
"""The command line of each script, and the numbers that pages quote."""
