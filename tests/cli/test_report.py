import re

import pytest

import rfpsurvey as rs
from pages import Reader


@pytest.mark.few(4)
@pytest.mark.parametrize(
    "command",
    [
        "plan --instrument sdss_apo --output t.ecsv",
        "survey --instrument sdss_apo --folder plan",
        "design --ratio 1,1.5 --pitch 24,26",
        "probability sdss_apo --method closed_form",
        "tile --region sky --method spiral --instrument lamost --output t.ecsv",
        "compare sdss_apo moons --allocator lamost_rule --n-realizations 1",
        "compare-allocators --instrument moons --allocator lamost_rule --allocator repair",
        "benchmark collisions --instrument sdss_apo --method exact --method endpoints --repeats 1",
    ],
)
def test_commands_write_pages(call, tmp_path, monkeypatch, command):
    monkeypatch.chdir(tmp_path)
    assert call(f"{command} --report page.html").out.endswith("wrote page.html\n")
    text = (tmp_path / "page.html").read_text()
    page = Reader(text)
    assert len(page.all("svg")) == {"plan": 3, "survey": 2, "compare-allocators": 3}.get(command.split()[0], 1)
    if command.startswith("plan"):
        call("score t.ecsv --report score.html")
        scored = Reader((tmp_path / "score.html").read_text()).facts()
        assert scored["in collision"] == page.facts()["in collision"]
        # the figure of the quality
        assert "Targets that are available, in reach and assigned." in text
        assert "fraction of science targets" in text
        assert "positioners assigned, " not in text.partition("Completeness")[2].partition("Focal plane")[0]
    elif command.startswith("tile"):
        captions = "".join(t["caption"] for t in page.tables)
        assert re.search(r"Shown: 1000 of \d+ rows; t.ecsv contains all rows", captions)


WORK = {
    "plan": "plan_tile",
    "tile --region sky": "place_tiles",
    "survey": "plan_survey",
    "compare-allocators": "compare_allocators",
    "compare": "compare_instruments",
    "design": "design.explore_designs",
    "probability": "collision_probability",
    "benchmark collisions": "benchmark.benchmark_collisions",
}


@pytest.mark.few(3)
@pytest.mark.parametrize("command", WORK)
def test_a_page_that_cannot_be_written_is_refused_before_the_work(refused, tmp_path, monkeypatch, command):
    def work(*_, **__):
        raise AssertionError("the work was begun")

    monkeypatch.chdir(tmp_path)
    package, _, name = WORK[command].rpartition(".")
    monkeypatch.setattr(getattr(rs, package) if package else rs, name, work)
    (tmp_path / "old.html").write_text("old")
    for name, message in (("old.html", "old.html exists"), ("page.txt", "must end in .html or .htm")):
        assert message in refused(f"{command} --report", name)
    assert [p.name for p in tmp_path.iterdir()] == ["old.html"]
