"""Selection probabilities on disk: any number of workers, interruptions, damaged files, and refused requests."""

import multiprocessing
import os
import shutil
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.table import QTable, Table

import rfpsurvey as rs
from processes import killed_at_random
from rfpsurvey._survey.selection import run as _folder

CENTER = SkyCoord(200 * u.deg, 30 * u.deg)
AS = "as for the survey"
N = 40  # two blocks of realizations that are planned together


@pytest.fixture(scope="module")
def case(small):
    """Return targets with several visits and kinds, an instrument, and tiles of two passes."""
    sky = rs.synthetic_catalog("poisson", CENTER, 3 * u.deg, density=200 / u.deg**2, rng=3)
    rng = np.random.default_rng(1)
    n = len(sky)
    kind = rng.choice(["science", "standard"], n, p=[0.9, 0.1])
    sky = rs.Catalog(sky.coord, id=5 * np.arange(n), visits=rng.integers(0, 3, n), kind=kind)
    lon, lat = (a.ravel() for a in np.meshgrid(0.8 * np.arange(-1, 2), 0.8 * np.arange(-1, 2)))
    centers = SkyCoord(lon * u.deg, lat * u.deg, frame=CENTER.skyoffset_frame()).icrs
    table = QTable({"ra": np.tile(centers.ra, 2), "dec": np.tile(centers.dec, 2)})
    table["pass"] = np.repeat([0, 1], len(centers))
    return sky, small, rs.Tiling.from_table(table)


def compute(case, folder, n=N, allocator="nearest", **options):
    return rs.selection_probabilities(*case, n, allocator=allocator, folder=folder, **options)


@pytest.fixture(scope="module")
def undisturbed(case, tmp_path_factory):
    """Return the content of all files of a computation without interruption."""
    folder = tmp_path_factory.mktemp("undisturbed") / "selection"
    compute(case, folder)
    return content(folder)


def content(folder):
    paths = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != "lock")
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def same(one, other):
    for name in ("target_id", "requested", "n_tiles", "bits", "n_observed", "weight", "weight_error"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for name in one.realizations.colnames:
        np.testing.assert_array_equal(one.realizations[name], other.realizations[name], err_msg=name)
    assert (one.summary, one.provenance) == (other.summary, other.provenance)


def test_the_progress_increases_to_the_number_of_plans(case):
    """Each tile is planned for each realization, after the targets in its reach are counted; 33 are two blocks."""
    told, n_tiles = [], len(case[2])
    compute(case, None, 33, progress=lambda *numbers: told.append(numbers))
    assert told == sorted(told)
    assert {total for _, total in told} == {34 * n_tiles}
    assert {n_tiles, 33 * n_tiles, 34 * n_tiles} <= {done for done, _ in told}


def test_what_is_written_is_what_is_held(case, tmp_path, undisturbed):
    assert set(undisturbed) == {"index.csv", "selection.json", "selection.fits"}
    held = compute(case, None)
    same(held, compute(case, tmp_path / "one"))
    same(held, rs.SelectionProbabilities.read(tmp_path / "one"))
    same(held, rs.SelectionProbabilities.read(tmp_path / "one" / "selection.fits"))
    held.write(tmp_path / "two.fits")
    assert (tmp_path / "two.fits").read_bytes() == undisturbed["selection.fits"]
    table = QTable.read(tmp_path / "two.fits", hdu=1)
    assert (table.colnames, table["BITWEIGHTS"].dtype.kind, table.meta["NREALIZ"]) == (held.table.colnames, "i", N)
    for name in table.colnames:
        shown = np.asarray(table[name]).reshape(np.shape(held.table[name]))
        np.testing.assert_array_equal(shown, np.asarray(held.table[name]), err_msg=name)


def test_counts_are_consistent(case):
    found = compute(case, None)
    sky, asked = case[0], found.requested > 0
    np.testing.assert_array_equal(asked, (sky.visits > 0) & (sky.kind == "science"))
    assert not found.bits[~asked].any()
    assert found.never_observed[found.unreachable].all()
    np.testing.assert_array_equal(found.n_tiles, rs.selection.potential_assignments(*case).n_tiles())
    s = found.summary
    parts = [s[f"n_{name}_observed"] for name in ("never", "sometimes", "always")]
    assert sum(parts) == s["n_targets"] == asked.sum()
    assert s["n_assigned"] - s["n_lost"] == s["n_observed"]
    times = np.array([found.observed_in(r).sum() for r in range(N)])
    assert (times <= np.asarray(found.realizations["n_observed"])).all()
    assert (times > 0).all()
    assert s["n_sometimes_observed"] > 50
    assert len(np.unique(found.realizations["seed"])) == N


def test_first_realizations_do_not_depend_on_their_number(case):
    few, many = compute(case, None, 5), compute(case, None)
    for r in range(5):
        np.testing.assert_array_equal(few.observed_in(r), many.observed_in(r))
    assert (compute(case, None, 5, rng=1).bits != few.bits).any()


def test_threads_and_processes(case, tmp_path, undisturbed):
    context = multiprocessing.get_context("spawn")
    for name, pool in {"threads": ThreadPoolExecutor(3), "processes": ProcessPoolExecutor(1, context)}.items():
        with pool as executor:
            compute(case, tmp_path / name, executor=executor)
        assert content(tmp_path / name) == undisturbed


class InterruptError(Exception):
    pass


def stop_after(n):
    """Return a function that ends a run after the progress was reported n times."""
    calls = []

    def stop(done, total):
        calls.append(done)
        if len(calls) > n:
            raise InterruptError

    return stop


@pytest.mark.parametrize("allocator", ["nearest", pytest.param("repair", marks=pytest.mark.exhaustive)])
def test_interrupted_after_any_number_of_plans(case, tmp_path, monkeypatch, undisturbed, allocator):
    """Each run ends after a few more plans of tiles; the checkpoints are those after each round."""
    monkeypatch.setattr(_folder, "EVERY", 0.0)
    options, expected = {}, undisturbed
    if allocator != "nearest":
        options = {"n": 2, "allocator": allocator}
        compute(case, tmp_path / "whole", **options)
        expected = content(tmp_path / "whole")
    folder, runs, seen = tmp_path / "selection", 0, set()
    while True:
        try:
            compute(case, folder, resume=True, progress=stop_after(24), **options)
            break
        except InterruptError:
            runs += 1
            seen |= {path.name.partition("-")[0] for path in folder.glob("*.npz")}
        assert runs < 20
    assert runs > 1
    assert seen >= {"reach.npz", "state", "block"}
    assert content(folder) == expected


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_killed_at_random_moments(case, tmp_path, monkeypatch, undisturbed, rng):
    monkeypatch.setattr(_folder, "EVERY", 0.0)
    for folder in killed_at_random(compute, case, tmp_path, 3, rng):
        assert content(folder) == undisturbed


def test_killed_before_the_checkpoints_are_removed(case, tmp_path, monkeypatch, undisturbed):
    def die(self):
        raise InterruptError

    with monkeypatch.context() as patch:
        patch.setattr(_folder.SelectionFolder, "finish", die)
        with pytest.raises(InterruptError):
            compute(case, tmp_path / "selection")
    assert list((tmp_path / "selection").glob("*.npz"))
    compute(case, tmp_path / "selection", resume=True)
    assert content(tmp_path / "selection") == undisturbed


def test_damaged_checkpoints_are_computed_again(case, tmp_path, monkeypatch, undisturbed):
    monkeypatch.setattr(_folder, "EVERY", 0.0)
    folder = tmp_path / "selection"
    with pytest.raises(InterruptError):
        compute(case, folder, progress=stop_after(45))
    good = (folder / "block-0000.npz").read_bytes()
    for k, damaged in enumerate((good[:-100], b"", good[:3000] + b"x" + good[3001:])):
        copy = shutil.copytree(folder, tmp_path / f"copy-{k}")
        (copy / "block-0000.npz").write_bytes(damaged)
        with pytest.warns(rs.RfpsurveyWarning, match=r"block-0000\.npz is damaged"):
            compute(case, copy, resume=True)
        assert content(copy) == undisturbed


def test_a_block_in_the_place_of_another_block_is_computed_again(case, tmp_path, monkeypatch, undisturbed):
    """A valid file of another block was used without a check, and the result had wrong values."""
    folder = tmp_path / "selection"
    with monkeypatch.context() as patch:
        patch.setattr(_folder.SelectionFolder, "finish", lambda self: None)
        compute(case, folder)
    shutil.copy(folder / "block-0001.npz", folder / "block-0000.npz")
    (folder / "selection.fits").unlink()
    with pytest.warns(rs.RfpsurveyWarning, match=r"block-0000\.npz is damaged .*; its tiles are planned again"):
        compute(case, folder, resume=True)
    assert content(folder) == undisturbed


def flip(content):
    return content[:-3000] + bytes([content[-3000] ^ 1]) + content[-2999:]


@pytest.mark.parametrize("damage", [flip, lambda content: content[:-2880]])
def test_a_damaged_result_is_refused_and_computed_again(case, tmp_path, undisturbed, damage):
    """A flipped bit in the file of a finished computation remained undetected, whether it was read or resumed."""
    folder = tmp_path / "selection"
    compute(case, folder)
    (folder / "selection.fits").write_bytes(damage(undisturbed["selection.fits"]))
    for path in (folder, folder / "selection.fits"):
        with pytest.raises(rs.InputError, match=r"selection\.fits is damaged \(its checksum differs"):
            rs.SelectionProbabilities.read(path)
    with pytest.warns(rs.RfpsurveyWarning, match=r"selection\.fits is damaged"):
        compute(case, folder, resume=True)
    assert content(folder) == undisturbed


def test_a_result_without_a_checksum_can_be_read_only_by_its_path(case, tmp_path):
    folder = tmp_path / "selection"
    found = compute(case, folder, 2)
    (folder / "index.csv").unlink()
    with pytest.raises(rs.InputError, match=r"the index of its folder, index.csv, does not contain its checksum"):
        rs.SelectionProbabilities.read(folder)
    same(rs.SelectionProbabilities.read(folder / "selection.fits"), found)


def test_the_result_of_another_computation_is_refused(case, tmp_path):
    one, other = tmp_path / "one", tmp_path / "other"
    compute(case, one, 2)
    compute(case, other, 2, rng=1)
    shutil.copy(other / "selection.fits", one / "selection.fits")
    with pytest.raises(rs.InputError, match=r"selection\.fits is damaged"):
        rs.SelectionProbabilities.read(one)


def test_two_computations_in_one_folder_are_refused(case, tmp_path):
    tried = []

    def intrude(done, _):
        if not tried:
            tried.append(done)
            with pytest.raises(rs.InputError, match="another run uses this folder"):
                compute(case, tmp_path / "selection", resume=True)

    compute(case, tmp_path / "selection", 2, progress=intrude)
    assert tried


def test_refused_folders(case, tmp_path):
    folder = tmp_path / "selection"
    compute(case, folder, 2)
    same(compute(case, folder, 2, resume=True), rs.SelectionProbabilities.read(folder))
    for place, n, options, message in (
        (None, N, {"resume": True}, "the folder of the computation to resume must be given"),
        (folder, 2, {}, "holds a computation of selection probabilities; continue it"),
        (folder, 3, {"resume": True}, "n_realizations differs .n_realizations was 2 and is now 3"),
        (folder, 2, {"resume": True, "lost_in_collision": False}, "lost_in_collision differ"),
    ):
        with pytest.raises(rs.InputError, match=message):
            compute(case, place, n, **options)
    case[0].write(tmp_path / "sky.fits")
    with pytest.raises(rs.InputError, match="must contain selection probabilities, got a table without target_id"):
        rs.SelectionProbabilities.read(tmp_path / "sky.fits")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("requested", 300, "visits must be whole numbers from 0 to 255, got 300"),
        ("requested", 1.5, "visits must be whole numbers from 0 to 255, got 1.5"),
        ("n_tiles", -1, "integers of at least 0 in n_tiles"),
        ("BITWEIGHTS", 0.5, "integers in BITWEIGHTS"),
    ],
)
def test_numbers_that_selections_cannot_hold_are_refused(case, tmp_path, name, value, message):
    """They were rounded, or replaced by other integers: 300 requested visits became 44."""
    compute(case, None).write(tmp_path / "all.fits")
    with fits.open(tmp_path / "all.fits") as units:
        table = Table(units[1].data)
        table[name] = np.full(table[name].shape, value)
        header = units[1].header
        units[1] = fits.table_to_hdu(table)
        units[1].header["RFPSURVY"] = header["RFPSURVY"]
        units.writeto(tmp_path / "new.fits")
    with pytest.raises(rs.InputError, match=message):
        rs.SelectionProbabilities.read(tmp_path / "new.fits")


def test_refused_arguments(case, small):
    """Also joint plans with a time limit, and surveys with other options or other joint plans, are refused."""
    asked = rs.AllocationOptions("nearest", subpriority=3)
    joint = rs.JointOptions(allocator=rs.AllocationOptions("optimal", subpriority=3))
    for n, options, message in (
        (0, {}, "n_realizations must be a whole number from 1"),
        ("many", {}, "n_realizations must be a whole number from 1"),
        (2, {"allocator": asked}, "subpriority must not be given"),
        (2, {"allocator": joint}, "subpriority must not be given"),
        (2, {"order": "joint"}, "unknown order 'joint'; choose one of: color, given"),
        (2, {"allocator": rs.JointOptions(time_limit=1 * u.s)}, "must end after a number of iterations"),
    ):
        with pytest.raises(TypeError if n == "many" else rs.InputError, match=message):
            compute(case, None, n, **options)
    with pytest.raises(rs.InputError, match="realization must be a whole number from 0 to 1, got 2"):
        compute(case, None, 2).observed_in(2)
    sky = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=50, rng=1)
    first = rs.JointOptions(iterations=0, allocator=rs.AllocationOptions("optimal", subpriority=1))
    survey = rs.plan_survey(sky, small, CENTER.reshape(1), allocator=first)
    for other in ("optimal", rs.JointOptions(iterations=1)):
        with pytest.raises(rs.InputError, match="joint must be {.*}, as for the survey, got"):
            rs.selection_probabilities(sky, small, survey, 2, allocator=other)
    rs.selection_probabilities(sky, small, survey, 2, allocator=rs.JointOptions(iterations=0))


def test_warning_if_nothing_is_observed(case):
    with pytest.warns(rs.RfpsurveyWarning, match="no target was observed"):
        found = rs.selection_probabilities(case[0], case[1], SkyCoord([20] * u.deg, [-30] * u.deg), 3)
    assert found.unreachable.all()
    assert repr(found).endswith("never observed, 0 always>")


def test_requirements_without_effect_cause_a_warning():
    sky = rs.synthetic_catalog("uniform", CENTER, 0.1 * u.deg, n_targets=50, rng=1)
    sky = rs.Catalog(sky.coord, kind=np.where(np.arange(50) < 9, "standard", "science"))
    options = rs.AllocationOptions("nearest", requirements="standard=2")
    with pytest.warns(rs.RfpsurveyWarning, match="requirements has no effect with the allocator 'nearest'"):
        rs.selection_probabilities(sky, "moons", CENTER.reshape(1), 2, allocator=options)


def test_the_realizations_of_a_survey_have_its_options(case):
    catalog, instrument, tiling = case
    survey = rs.plan_survey(catalog, instrument, tiling, allocator=rs.AllocationOptions("nearest", subpriority=1))
    expected = rs.selection_probabilities(*case, 3, allocator="nearest")
    found = rs.selection_probabilities(catalog, instrument, survey, 3, allocator="nearest")
    assert (found.bits == expected.bits).all()
    for model, options, message in (
        (instrument, {}, "allocator must be 'nearest', as for the survey, got 'repair'"),
        ("moons", {"allocator": "nearest"}, "instrument must be 'small', as for the survey, got 'moons'"),
        (instrument, {"allocator": "nearest", "order": "given"}, f"order must be 'color', {AS}, got 'given'"),
    ):
        with pytest.raises(rs.InputError, match=message):
            rs.selection_probabilities(catalog, model, survey, 3, **options)


def test_pairs_of_unknown_targets_are_refused(case):
    """Regression: the row -1 was the last target, and rows that are too large caused an IndexError."""
    found = rs.selection_probabilities(*case, 2, allocator="nearest")
    words = r"second must be a list of rows of targets .whole numbers from 0 to \d+., got"
    for rows in ([-1], [len(found)], [0.5], [True], [[0]], 0):
        with pytest.raises(rs.InputError, match=words):
            found.pair_counts([0], rows)


def test_only_surveys_with_random_subpriorities_have_unbiased_weights():
    """The weights of the observed targets sum to the number of targets that can be observed."""
    center, tiles = SkyCoord("95d 23d"), SkyCoord([95, 95.3] * u.deg, [23, 23] * u.deg)
    options = {"density": 500 / u.deg**2, "cluster_size": 10, "cluster_scale": 0.03 * u.deg, "rng": 3}
    sky = rs.synthetic_catalog("clustered", center, 1.2 * u.deg, **options)
    found = rs.selection_probabilities(sky, "sdss_apo", tiles, 256, allocator="nearest")

    def sum_of_weights(allocator):
        survey = rs.plan_survey(sky, "sdss_apo", tiles, allocator=allocator)
        return found.weight[np.asarray(survey.outcomes["observed"]) > 0].sum(), survey

    expected = np.count_nonzero(found.n_observed)
    seeded = [sum_of_weights(rs.AllocationOptions("nearest", subpriority=seed))[0] for seed in range(8)]
    assert abs(np.mean(seeded) - expected) < 0.05 * expected
    biased, survey = sum_of_weights("nearest")
    assert biased > 1.5 * expected
    with pytest.warns(rs.RfpsurveyWarning, match="planned without the option subpriority"):
        rs.selection_probabilities(sky, "sdss_apo", survey, 2, allocator="nearest")
    column = rs.Catalog(sky.coord, subpriority=np.random.default_rng(1).random(len(sky)))
    for catalog, allocator in ((column, "nearest"), (sky, "balanced")):
        survey = rs.plan_survey(catalog, "sdss_apo", tiles, allocator=allocator)
        rs.selection_probabilities(catalog, "sdss_apo", survey, 2, allocator=allocator)
