"""A survey in a folder is continued with the objects that its folder describes, as with the original objects."""

import shutil
import tomllib
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.table import QTable, Table
from astropy.time import Time

import rfpsurvey as rs
from rfpsurvey._survey.plan_file import call_of, keys_in

pytestmark = pytest.mark.filterwarnings("ignore::rfpsurvey.RfpsurveyWarning")
CENTER = SkyCoord(95 * u.deg, 23 * u.deg)
N = 300
NIGHT = Table({"tile": [0], "date": ["2099-01-03"], "state": ["done"]})


def sky_with(rng, **columns):
    where = CENTER.spherical_offsets_by(*rng.uniform(-0.4, 0.4, (2, N)) * u.deg)
    return rs.Catalog(where, **columns)


def tiles_of(n=3, **columns):
    ra = 94.9 + 0.1 * np.arange(n)
    return rs.Tiling.from_table(QTable({"ra": ra * u.deg, "dec": np.full(n, 23.0) * u.deg, **columns}))


def small_instrument(**changes):
    positioner = rs.Positioner(8.25 * u.mm, 8.25 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane.hexagonal(positioner, rings=3, pitch=17 * u.mm, **changes)
    return rs.Instrument("small", plane, plate_scale=200 * u.mm / u.deg)


def plain(rng, tmp_path):
    return {}


def columns(rng, tmp_path):
    given = {
        "id": np.array([f"s {k}" for k in rng.permutation(N)]),
        "priority": rng.random(N),
        "category": rng.choice(["bright", "std_x", ""], N),  # when files are read, categories can imply kinds
        "visits": rng.integers(0, 4, N),
        "subpriority": rng.random(N),
        "extra": QTable({"DESI_TARGET": rng.integers(0, 9, N), "mag": rng.random(N) * u.mag, "RA": rng.random(N)}),
    }
    return {"catalog": sky_with(rng, **given), "allocator": rs.AllocationOptions("nearest", subpriority=5)}


def kinds_and_motions(rng, tmp_path):
    where = CENTER.spherical_offsets_by(*rng.uniform(-0.4, 0.4, (2, N)) * u.deg)
    motion = rng.uniform(-3, 3, (2, N)) * u.arcsec / u.yr
    where = SkyCoord(where.ra, where.dec, pm_ra_cosdec=motion[0], pm_dec=motion[1], obstime=Time("J2000")).galactic
    kind = rng.choice(["science", "science+standard", "standard", "sky"], N)
    options = rs.AllocationOptions("repair", requirements=["standard=2", "sky=3-5"], sky_separation=0.5 * u.mm)
    return {"catalog": rs.Catalog(where, kind=kind), "allocator": options, "epoch": Time("J2026.5")}


def file_of_a_catalog(rng, tmp_path):
    table = Table({"star": np.arange(N), "RAJ": 95 + rng.uniform(-0.4, 0.4, N), "DEJ": 23 + rng.uniform(-0.4, 0.4, N)})
    table["rank"] = rng.integers(0, 3, N)
    table.write(tmp_path / "stars.csv")
    names = {"id": "star", "ra": "RAJ", "dec": "DEJ", "priority": "-rank"}
    sky = rs.Catalog.read(tmp_path / "stars.csv", columns=names, units={"ra": u.deg, "dec": "deg"}, keep="rank")
    return {"catalog": sky, "passes": np.array([2, 1]), "tiles": tiles_of(**{"pass": [1, 2, 1]}), "order": "given"}


def instrument_made_in_python(rng, tmp_path):
    return {"instrument": small_instrument(disabled=rng.random(37) < 0.1), "lost_in_collision": False, "rng": 7}


def broken_positioners(rng, tmp_path):
    table = Table({"id": [3, 5], "state": ["broken", "stuck"], "theta": [0.0, 30.1], "phi": [180.0, 90.7]})
    desi = rs.Instrument.preset("sdss_apo")
    table["id"] = desi.focal_plane.id[[3, 5]]
    return {"instrument": desi.with_states(table).with_arm_model("elbow_to_tip")}


def numbers_of_visits(rng, tmp_path):
    return {"visits": rng.integers(0, 4, N)}


def one_number_of_visits(rng, tmp_path):
    return {"visits": 3}


def rule(rng, tmp_path):
    table = Table({"class": ["any"], "last": ["bad"], "visits": [2]})
    return {"visits": rs.survey.VisitRule(visits=2, retries=1, table=table)}


def conditions(rng, tmp_path):
    site = rs.ObservingConditions("apache point", hour_angle=0.5 * u.hourangle)
    return {"tiles": tiles_of(time=["2026-10-01T08:00:00"] * 3).with_conditions(site)}


def constraints(rng, tmp_path):
    circles = [rs.Region.cap(SkyCoord(rng.uniform(94, 96), 23.1, unit="deg"), 0.01 * u.deg) for _ in range(40)]
    options = rs.AllocationOptions(
        "balanced", required=[*range(0, N, 2)], keep_out=circles, constraints=["motion fold"], parked_obstacles=False
    )
    return {"allocator": options}


def joint(rng, tmp_path):
    options = rs.AllocationOptions("optimal", requirements="sky=2", programs=3)
    sky = sky_with(rng, kind=rng.choice(["science", "science", "sky"], N))
    return {"catalog": sky, "allocator": rs.JointOptions(iterations=1, gap=0.01, allocator=options)}


CASES = (
    *(plain, columns, kinds_and_motions, file_of_a_catalog, instrument_made_in_python, broken_positioners),
    *(numbers_of_visits, one_number_of_visits, rule, conditions, constraints, joint),
)


def make_call(case, tmp_path):
    rng = np.random.default_rng(3)
    return {"catalog": sky_with(rng), "instrument": "sdss_apo", "tiles": tiles_of()} | case(rng, tmp_path)


def content(folder):
    files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    return {name: data for name, data in files.items() if not name.startswith(("inputs/", "plan.toml", "lock"))}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.__name__)
def test_the_rest_of_a_survey_is_planned_from_its_folder(case, tmp_path, monkeypatch):
    """The tables of both surveys are equal, apart from the origin of the tiles and of the catalog."""
    monkeypatch.chdir(tmp_path)
    call = make_call(case, tmp_path)
    survey = rs.plan_survey(**call, folder="first")
    survey.record(NIGHT, allow_future=True)
    shutil.copytree("first", "elsewhere")
    visits = call.pop("visits", None)
    given = {"rule": visits} if isinstance(visits, rs.survey.VisitRule) else {"visits": visits}
    state = survey.state(call["catalog"], **given)
    expected = rs.plan_survey(**call, visits=state, folder="first", resume=True)
    shutil.rmtree("first/inputs")  # the other folder must not use the inputs of the first
    found = rs.Survey.read("elsewhere").replan()
    files = content(tmp_path / "elsewhere")
    for name, data in content(tmp_path / "first").items():
        assert files[name] == data or not (name.startswith("tiles/") or name == "outcomes.fits"), name
    for name in expected.summary:
        assert np.array_equal(found.summary[name], expected.summary[name]), name
    again = rs.Survey.read("elsewhere").state()
    assert all(np.array_equal(getattr(again, name), getattr(state, name)) for name in ("requested", "observed", "left"))
    assert (again.rule.record, found.status()["n_observed"][0]) == (state.rule.record, again.observed.sum())


def test_catalogs_are_restored_exactly(tmp_path):
    call = make_call(columns, tmp_path)
    rs.plan_survey(**call, folder=tmp_path / "plan")
    found, given = call_of(keys_in(tmp_path / "plan"))["catalog"], call["catalog"]
    for name in ("id", "priority", "category", "visits", "subpriority", "kind", "fiber_type", "epoch", "numbered"):
        one, other = getattr(found, name), getattr(given, name)
        assert (one is None) == (other is None)
        assert np.array_equal(one, other)
        assert np.asarray(one).dtype == np.asarray(other).dtype
    assert found.coord.ra.deg.tolist() == given.coord.ra.deg.tolist()
    assert np.array_equal(found.arrays.vectors, given.arrays.vectors)
    assert found.extra.colnames == given.extra.colnames
    assert all(np.array_equal(found.extra[name], given.extra[name]) for name in given.extra.colnames)


def test_ids_that_are_row_numbers_remain_row_numbers(tmp_path):
    sky = make_call(plain, tmp_path)["catalog"][::2]
    rs.plan_survey(sky, "sdss_apo", tiles_of(), folder=tmp_path / "plan")
    found = call_of(keys_in(tmp_path / "plan"))["catalog"]
    assert found.numbered
    assert found.id.tolist() == sky.id.tolist()


@pytest.mark.parametrize("seed", [None, 2**53 + 1, 2**128 - 1])
def test_seeds_that_floats_cannot_represent_are_read_again(seed, tmp_path):
    """Such a seed was written to plan.toml, but refused when the file was read; None draws a seed of up to 63 bits."""
    survey = rs.plan_survey(**make_call(plain, tmp_path), allocator="balanced", rng=seed, folder=tmp_path / "plan")
    drawn = keys_in(tmp_path / "plan").rng
    assert seed in (None, drawn)
    assert (
        rs.Survey.read(tmp_path / "plan").replan().provenance["parameters"]["rng"]
        == survey.provenance["parameters"]["rng"]
        == drawn
    )


def by_hand(problem):
    """Assign nothing."""
    return np.full(len(problem.focal_plane), -1)


def test_what_no_file_describes_must_be_given_again(tmp_path):
    call = make_call(plain, tmp_path) | {"allocator": by_hand}
    survey = rs.plan_survey(**call, folder=tmp_path / "plan")
    file = tomllib.loads((tmp_path / "plan" / "plan.toml").read_text())
    assert (file["python"], file["options"]["allocator"]) == (["allocator"], "given in Python")
    with pytest.raises(rs.InputError, match="allocator must be given as in the first plan"):
        survey.replan()
    assert survey.replan(allocator=by_hand).summary["n_assigned"] == 0
    assert survey.state().left.sum() == N  # the state does not depend on the allocator
    with pytest.raises(rs.InputError, match="allocator"):
        survey.replan(allocator="repair")  # another allocator than that of the first plan


def any_visits(table):
    """Request the visits of the table."""
    return {"visits": table["requested"]}


def test_no_default_replaces_what_no_file_describes(tmp_path):
    """The file would otherwise name a preset with the name of the instrument, and the state a rule without effect."""
    lamost = rs.Instrument.preset("lamost")
    traced = rs.projection.DistortionMap(
        [0.0, 5000.0, 5000.0], 1, 0, max_angle=2.5 * u.deg, residuals=QTable({"n": [1]})
    )
    own = replace(lamost, plate_scale=None, distortion=traced)
    call = make_call(plain, tmp_path) | {"instrument": own, "visits": rs.survey.VisitRule(function=any_visits)}
    survey = rs.plan_survey(**call, folder=tmp_path / "plan")
    file = tomllib.loads((tmp_path / "plan" / "plan.toml").read_text())
    assert file["python"] == ["rule", "instrument"]
    assert file["instrument"]["name"] == file["rule"]["function"] == "given in Python"
    assert len(rs.survey.verify_survey(tmp_path / "plan")) == 0
    with pytest.raises(rs.InputError, match="rule must be given as in the first plan"):
        survey.state()
    assert survey.state(rule=call["visits"]).left.sum() == N
    with pytest.raises(rs.InputError, match="rule, instrument must be given"):
        survey.replan()
    found = survey.replan(rule=call["visits"], instrument=own)
    assert found.outcomes["observed"].tolist() == survey.outcomes["observed"].tolist()


def test_the_rest_is_planned_with_other_broken_positioners_and_another_rule(tmp_path):
    survey = rs.plan_survey(**make_call(plain, tmp_path), folder=tmp_path / "plan")
    survey.record(NIGHT, allow_future=True)
    sdss = rs.Instrument.preset("sdss_apo")
    sdss = sdss.with_states(Table({"id": sdss.focal_plane.id[:400]}))
    rule = rs.survey.VisitRule(after_success=2)
    found = survey.replan(instrument=sdss, rule=rule)
    assert found.tiles["n_assigned"][1] < survey.tiles["n_assigned"][1]
    assert (set(found.outcomes["requested"].tolist()), survey.state().rule.after_success) == ({1, 2}, 2)
    assert rs.Survey.read(tmp_path / "plan").replan().provenance["instrument"] == sdss.provenance


def test_the_selection_of_a_survey_is_computed_from_its_folder(tmp_path):
    call = make_call(columns, tmp_path)
    survey = rs.plan_survey(**call, folder=tmp_path / "plan")
    survey.record(Table({"tile": [1], "date": ["2099-01-03"], "state": ["done"]}), allow_future=True)
    call |= {"allocator": "nearest", "catalog": survey.state(call["catalog"])}
    expected = rs.selection_probabilities(**call, n_realizations=3)
    assert np.array_equal(survey.select(3).bits, expected.bits)


def test_interrupted_surveys_are_continued(tmp_path):
    def stop(done, total):
        if done == 2:
            raise KeyboardInterrupt

    call, folder = make_call(columns, tmp_path), tmp_path / "plan"
    expected = rs.plan_survey(**call)
    with pytest.raises(KeyboardInterrupt):
        rs.plan_survey(**call, folder=folder, progress=stop)
    with pytest.raises(rs.InputError, match="not finished"):
        rs.Survey.read(folder)
    assert rs.survey.continue_survey(folder).outcomes["observed"].tolist() == expected.outcomes["observed"].tolist()
    with pytest.raises(rs.InputError, match="does not hold a survey"):
        rs.survey.continue_survey(tmp_path)


DAMAGES = {
    "inputs/catalog-*.fits": (None, lambda file: file[:-1] + b"x", lambda file: file[:5000], lambda _: b""),
    "inputs/tiles-*.ecsv": (None, lambda file: file.replace(b"94.9", b"94.8"), lambda file: file[:-9]),
    "inputs/instrument-*.ecsv": (None, lambda file: file.replace(b"17.0", b"17.5"), lambda _: b"#"),
    "plan.toml": (lambda file: file.replace(b"7\n", b"8\n"), lambda file: file + b"[", lambda _: b"\0"),
}


def test_damaged_inputs_are_found_and_never_used(tmp_path):
    folder = tmp_path / "plan"
    survey = rs.plan_survey(**make_call(instrument_made_in_python, tmp_path), folder=folder)
    survey.record(NIGHT, allow_future=True)
    assert len(rs.survey.verify_survey(folder)) == 0
    before = content(folder)
    for name, damages in DAMAGES.items():
        for damage in damages:
            (path,) = folder.glob(name)
            file = path.read_bytes()
            path.unlink() if damage is None else path.write_bytes(damage(file))
            found = rs.survey.verify_survey(folder)["file"].tolist()
            is_other_seed = "rng = 8" in (folder / "plan.toml").read_text(errors="replace")  # no input is damaged
            assert found == ([] if is_other_seed else [str(path.relative_to(folder))])
            with pytest.raises(rs.InputError):
                survey.replan()
            assert content(folder) == before
            path.write_bytes(file)


def test_surveys_of_version_0_3_without_a_plan_file_say_what_to_do(tmp_path):
    survey = rs.plan_survey(**make_call(plain, tmp_path), folder=tmp_path / "plan")
    (tmp_path / "plan" / "plan.toml").unlink()
    for ask in (survey.replan, survey.state, survey.status, survey.select):
        with pytest.raises(rs.InputError, match=r"must contain the file plan\.toml, got a survey that version 0\.3"):
            ask()
    survey = rs.plan_survey(**make_call(plain, tmp_path))
    with pytest.raises(rs.InputError, match="without a folder"):
        survey.replan()
