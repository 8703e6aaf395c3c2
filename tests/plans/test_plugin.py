"""Formats of plans of other packages: the example of the page on plugins, and formats that are not complete."""

import re
from dataclasses import replace
from pathlib import Path
from textwrap import dedent

import astropy.units as u
import living
import numpy as np
import pytest
from raising import refused

import rfpsurvey as rs

PAGE = (Path(__file__).parents[2] / "docs" / "plugins.rst").read_text()
HERE = "\nimport sys\nHERE = sys.modules[__name__]\n"


@pytest.fixture
def laboratory(install):
    """Install the example of the page."""
    section = PAGE.partition("Formats of plans\n-----")[2]
    install("laboratory", dedent(re.search(r"\n\n((?:    .*\n|\n)+)", section)[1]) + HERE, plan_formats={"lab": "HERE"})


def test_plans_of_the_example_are_written_read_and_scored(laboratory, presets, tmp_path):
    path, tile = tmp_path / "plan.lab", rs.plan_tile(rs.example_catalog(), presets["moons"])
    tile.table["kind"][tile.table["status"] == "assigned"] = "sky"
    with pytest.warns(rs.RfpsurveyWarning, match="was written without kinds of targets, which this format") as found:
        rs.plans.write_plan(tile, path)
    assert len(found) == 1
    assert rs.plans.recognize_plan(path) == "lab"
    plan = rs.plans.read_plan(path)
    assert (plan.meta["format"], plan["assigned"].sum()) == ("lab", tile.summary["n_assigned"])
    score = rs.score_tile(plan, presets["moons"])
    assert score.summary["n_assigned"] == tile.summary["n_assigned"]
    assert abs(score.table["tip_x"] - tile.table["tip_x"])[score.table["status"] == "assigned"].max() < 1e-9 * u.mm
    rs.plans.write_plan(plan, tmp_path / "plan.ecsv")
    assert rs.plans.recognize_plan(tmp_path / "plan.ecsv") == "table"
    refused("plan.lab", rs.plans.write_plan, plan, path)


def test_surveys_are_exported_in_the_format_of_the_example(laboratory, tmp_path):
    sky = replace(living.targets(), kind=np.full(living.N, "science+sky"))
    survey = rs.plan_survey(sky, "moons", living.tiling(n=2), folder=tmp_path / "plan")
    with pytest.warns(rs.RfpsurveyWarning, match=r"without .* \(2 files, such as tile-11.lab\)") as caught:
        table = survey.export(format="lab", output=tmp_path)
    assert len(caught) == 1
    assert table["file"].tolist() == ["tile-11.lab", "tile-12.lab"]
    assert rs.plans.read_plan(tmp_path / "tile-12.lab")["assigned"].sum() == len(survey.tile(12)) > 0


HOOKS = """
NORTH_OF_DATE, EPOCH_OF_OBSERVATION = "Survey X", True
def magnitudes(plan):
    return {"band": plan["x"].value * 0 + 15}
def neglected(plan, sky):
    return [f"offsets of {len(plan)} targets are neglected"] if sky else ["colors are neglected"]
def lost(plan):
    return []
"""


def test_optional_names_of_a_format_are_used(install, presets, tmp_path):
    parts = "ENDINGS, read, write, recognizes = ('.hooks',), None, None, lambda path: False"
    install("hooked", parts + HOOKS + HERE, plan_formats={"hooked": "HERE"})
    tile = rs.plan_tile(rs.example_catalog(), presets["moons"], position_angle=20 * u.deg)
    plan = rs.plans.as_plan(tile)
    plan.meta["format"] = "hooked"
    n, rule = tile.summary["n_assigned"], rs.constraints.MagnitudeLimits("band", 16, 20, "science")
    with pytest.warns(rs.RfpsurveyWarning, match="colors are neglected") as caught:
        score = rs.score_tile(plan, presets["moons"], constraints=[rule])
    assert len(caught) == 1
    assert score.rules["number"].tolist() == [n]
    del plan.meta["north_of"]
    with pytest.warns(rs.RfpsurveyWarning) as caught:
        rs.score_tile(plan, presets["moons"], positions="sky")
    texts = [str(one.message) for one in caught]
    assert any(text == f"offsets of {n} targets are neglected" for text in texts)
    assert any("Survey X uses the north of date" in text for text in texts)


def test_a_broken_package_breaks_no_other_format(install, presets, tmp_path):
    install("bad", "import not_there", plan_formats={"bad": "HERE"})
    tile = rs.plan_tile(rs.example_catalog(), presets["moons"])
    rs.plans.write_plan(tile, tmp_path / "plan.ecsv")
    with pytest.warns(rs.RfpsurveyWarning, match="the format of plans 'bad' of bad 1.0 .* other formats are still"):
        assert rs.plans.read_plan(tmp_path / "plan.ecsv")["assigned"].sum() == tile.summary["n_assigned"]
    refused("the format of plans 'bad' of bad 1.0", rs.plans.write_plan, tile, tmp_path / "plan.none")


def test_incomplete_and_unknown_formats_are_named(laboratory, install, tmp_path):
    install("less", "ENDINGS = ('.less',)" + HERE, plan_formats={"less": "HERE"})
    (tmp_path / "a.lab").write_text("1 2 3 4\n")
    words = r"the format of plans 'less' of less 1.0 \(less:HERE\) must have .* lacks read, write, recognizes, lost"
    refused(words, rs.plans.read_plan, tmp_path / "a.lab", format="less")
    with pytest.raises(rs.InputError, match="unknown format of plans 'lib'; choose one of: .*lab.*Did you mean 'lab'"):
        rs.plans.read_plan(tmp_path / "a.lab", format="lib")


def test_an_ending_can_have_several_parts_and_a_format_no_instrument(install, presets, tmp_path, run):
    section = PAGE.partition("Formats of plans\n-----")[2]
    example = dedent(re.search(r"\n\n((?:    .*\n|\n)+)", section)[1]).replace('(".lab",)', '(".plain.csv",)')
    example = example.replace('.suffix == ".lab"', '.name.endswith(".plain.csv")').replace('"instrument": "lab", ', "")
    install("laboratory", example + HERE, plan_formats={"lab": "HERE"})
    tile, path = rs.plan_tile(rs.example_catalog(), presets["moons"]), tmp_path / "plan.plain.csv"
    rs.plans.write_plan(tile, path)
    assert rs.plans.recognize_plan(path) == "lab"
    with pytest.raises(rs.InputError, match=r"must end in one of .ecsv, .fits, .par, .plain.csv \(or with .gz\)"):
        rs.plans.write_plan(tile, tmp_path / "plan.csv")
    code, _, error = run("score", path)
    assert code == 2
    assert "--instrument must name the instrument of the assignment" in error
    code, out, _ = run("convert", path, tmp_path / "other.plain.csv")
    assert code == 0
    n = tile.summary["n_assigned"]
    assert f"other.plain.csv: {n} of {n} fibers have a target" in " ".join(out.split())
