"""Required targets, and circles that no arm may cover, in surveys of many tiles in memory and on disk."""

from concurrent.futures import ThreadPoolExecutor

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord

import flat
import rfpsurvey as rs

CENTER = SkyCoord(0.1 * u.deg, 60 * u.deg)
NEVER = "ignore:required targets never observed"


@pytest.fixture(scope="module")
def sky():
    coord = rs.synthetic_catalog("uniform", CENTER, 1.4 * u.deg, n_targets=900, rng=3).coord
    rng = np.random.default_rng(5)
    return rs.Catalog(coord, priority=rng.integers(2, 5, len(coord)), visits=rng.integers(1, 3, len(coord)))


@pytest.fixture(scope="module")
def tiles():
    lon, lat = np.array([-0.7, 0, 0.7, 0.2, 0.4]) * u.deg, np.array([0, 0.1, 0, 0.5, -0.2]) * u.deg
    return SkyCoord(lon, lat, frame=CENTER.skyoffset_frame()).icrs


@pytest.fixture(scope="module")
def circles():
    """Return circles of different sizes; some of them are in several fields, and one is in no field."""
    rng = np.random.default_rng(1)
    lon, lat = rng.uniform(-1.2, 1.2, (2, 300)) * u.deg
    centers = SkyCoord(lon, lat, frame=CENTER.skyoffset_frame()).icrs
    found = [rs.Region.cap(c, r * u.deg) for c, r in zip(centers, rng.uniform(0, 0.02, 300), strict=True)]
    return [*found, rs.Region.cap(SkyCoord(180 * u.deg, -60 * u.deg), 1 * u.deg)]


def covered(survey, instrument, circles):
    """Count, for each tile, the pairs of an arm and a circle that it covers."""
    clearance = instrument.focal_plane.positioner.clearance.value
    found = []
    for row in survey.tiles:
        center, angle = SkyCoord(row["ra"], row["dec"]), row["position_angle"]
        scored = rs.score_tile(survey.tile(row["tile"]), instrument, center=center, position_angle=angle).table
        scored = scored[np.isin(scored["status"], ["assigned", "parked"])]
        elbow, tip = (np.stack([scored[f"{part}_{k}"].value for k in "xy"], axis=1) for part in ("elbow", "tip"))
        where, n = SkyCoord(*np.transpose([c.values[:3] for c in circles]), representation_type="cartesian"), 0
        where.representation_type = "unitspherical"
        points = instrument.projection(center, angle).to_focal_plane(where).value
        for circle, point in zip(circles, points, strict=True):
            radius = circle.values[3] * instrument.plate_scale.to_value(u.mm / u.rad)
            if np.isfinite(point).all():
                arm = tip - elbow
                along = np.clip(((point - elbow) * arm).sum(axis=1) / (arm**2).sum(axis=1), 0, 1)
                n += np.count_nonzero(np.hypot(*(elbow + along[:, None] * arm - point).T) < radius + clearance)
        found.append(n)
    return found


@pytest.mark.filterwarnings("ignore:constraint keep_out")
@pytest.mark.parametrize("allocator", ["lamost_rule", "repair"])
def test_every_arm_that_covers_a_circle_is_counted(sky, small, tiles, circles, allocator):
    survey = flat.plan_survey(sky, small, tiles, allocator=allocator, keep_out=circles)
    n = survey.tiles["n_obstacle_collisions"].tolist()
    assert n == covered(survey, small, circles)
    plain = rs.plan_survey(sky, small, tiles, allocator=allocator)
    assert not plain.tiles["n_obstacle_collisions"].any()
    assert sum(covered(plain, small, circles)) > 20
    if allocator == "lamost_rule":
        assert min(n) > 0
    else:  # arms with a target do not touch the circles
        assert not survey.targets["in_collision"].any()
        assert survey.summary["n_assigned"] > 0.8 * plain.summary["n_assigned"]


@pytest.mark.filterwarnings("ignore:no target was observed")
def test_required_targets_without_a_visit_are_told_with_their_outcome(small):
    """There is one required target for each outcome: outside all fields, out of reach, not assigned, lost to a
    collision.
    """
    one = rs.Positioner(8 * u.mm, 8 * u.mm, 2.25 * u.mm)
    plane = rs.FocalPlane([[0, 0], [20, 0]] * u.mm, one)
    instrument = rs.Instrument("two", plane, plate_scale=100 * u.mm / u.deg)
    xy = np.array([[-1.0, 1.0], [-1.0, 2.0], [0.0, 30.0], [9.0, 0.0], [11.0, 0.0]])
    near = instrument.projection(CENTER).to_sky(xy * u.mm)
    coord = SkyCoord([*near, CENTER.directional_offset_by(0 * u.deg, 9 * u.deg)])
    names = np.array(["first", "second", "beyond", "left", "right", "far"])

    def plan(chosen, required):
        rows = np.flatnonzero(np.isin(names, chosen))
        catalog = rs.Catalog(coord[rows], id=names[rows])
        survey = flat.plan_survey(catalog, instrument, CENTER.reshape(1), allocator="nearest", required=required)
        assert survey.summary["n_required"] - survey.summary["n_required_observed"] == len(required)
        return survey.summary["unmet"]

    begin = "required targets never observed, "
    with pytest.warns(rs.RfpsurveyWarning, match=begin) as told:
        unmet = plan(["second", "first", "beyond", "far"], ["far", "beyond"])
    assert unmet == [f"{begin}out of reach: beyond (1 in all)", f"{begin}in no field: far (1 in all)"]
    assert [str(one.message) for one in told] == unmet
    with pytest.warns(rs.RfpsurveyWarning, match=f"{begin}lost to a collision"):
        unmet = plan(["left", "right"], ["left", "right"])
    assert unmet == [f"{begin}lost to a collision: left, right (2 in all)"]
    row = rs.FocalPlane([[0, 0]] * u.mm, one)
    instrument = rs.Instrument("one", row, plate_scale=100 * u.mm / u.deg)
    catalog = rs.Catalog(instrument.projection(CENTER).to_sky(xy[:2] * u.mm), id=["first", "second"])
    with pytest.warns(rs.RfpsurveyWarning, match=f"{begin}in reach not assigned"):
        survey = flat.plan_survey(catalog, instrument, CENTER.reshape(1), required=["first", "second"])
    assert (survey.summary["n_required_observed"], survey.tiles["n_unmet"].tolist()) == (1, [1])


@pytest.mark.filterwarnings(NEVER, "ignore:constraint keep_out")
def test_threads_and_partitions_give_the_same(sky, small, tiles, circles, tmp_path):
    options = {"allocator": "repair", "required": [str(k) for k in range(0, 900, 30)], "keep_out": circles}
    expected = flat.plan_survey(sky, small, tiles, **options, folder=tmp_path / "one")
    files = {p.relative_to(tmp_path / "one"): p.read_bytes() for p in (tmp_path / "one").rglob("*.fits")}
    assert expected.tiles["n_unmet"].any() or expected.summary["n_required_observed"] > 0
    with ThreadPoolExecutor(2) as pool:
        survey = flat.plan_survey(sky, small, tiles, **options, executor=pool, folder=tmp_path / "two")
    assert survey.summary == expected.summary
    assert {p.relative_to(tmp_path / "two"): p.read_bytes() for p in (tmp_path / "two").rglob("*.fits")} == files
    rs.catalog.partition_catalog(sky, tmp_path / "parts")
    parts = rs.catalog.PartitionedCatalog(tmp_path / "parts")
    survey = flat.plan_survey(parts, small, tiles, **options)
    whole = flat.plan_survey(parts.read(), small, tiles, **options)
    assert survey.targets["target_id"].tolist() == whole.targets["target_id"].tolist()
    assert survey.summary["n_required"] == 30 > survey.summary["n_required_observed"] > 0
    lost = [int(s.split("(")[1].split()[0]) for s in survey.summary["unmet"] if s.startswith("required")]
    assert sum(lost) == 30 - survey.summary["n_required_observed"]
    for name in ("unmet", "outcomes", "n_required_observed"):
        assert survey.summary[name] == whole.summary[name]
    with pytest.raises(rs.InputError, match=r"required must hold ids of the catalog, got 900 \(1 of 2 unknown\)"):
        flat.plan_survey(parts, small, tiles, required=[3, 900])


@pytest.mark.filterwarnings(NEVER)
def test_a_survey_is_continued_with_the_same_constraints_only(sky, small, tiles, circles, tmp_path):
    options = {"required": [1, 2, 3], "keep_out": circles[:2], "folder": tmp_path / "survey"}
    before = flat.plan_survey(sky, small, tiles, **options)
    again = flat.plan_survey(sky, small, tiles, **options, resume=True)
    assert again.summary == before.summary
    assert rs.Survey.read(tmp_path / "survey").provenance["parameters"]["required"] == ["1", "2", "3"]
    (tmp_path / "survey" / "tiles" / "000" / "000001.fits").unlink()
    with pytest.warns(rs.RfpsurveyWarning, match="000001"):
        repaired = flat.plan_survey(sky, small, tiles, **options, resume=True)
    assert repaired.summary == before.summary
    wider = rs.Region.cap(CENTER, 0.001 * u.deg)
    others = ("required", [1, 2]), ("required", None), ("keep_out", [*circles[:1], wider]), ("keep_out", ())
    for name, other in others:
        with pytest.raises(rs.InputError, match=f"holds another survey: {name} differ"):
            flat.plan_survey(sky, small, tiles, **{**options, name: other}, resume=True)


def test_many_ids_and_circles_are_recorded_by_their_number_and_a_digest(sky):
    some, more = (rs.AllocationOptions(required=np.arange(n)) for n in (1000, 1001))
    assert some.record["required"] == [str(k) for k in range(1000)]
    (text,) = more.record["required"]
    assert text.startswith("1001 in all, digest ")
    assert text != rs.AllocationOptions(required=np.arange(1, 1002)).record["required"][0]
    assert repr(more) == "AllocationOptions('repair', required=(0, 1, 2, 3, 4 (1001 in all)))"


def test_a_circle_is_recorded_as_region_reads_it(circles):
    for text, circle in zip(rs.AllocationOptions(keep_out=circles).record["keep_out"], circles, strict=True):
        assert np.allclose(rs.Region.parse(text).values, circle.values, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("name", "away", "radius"), [("sdss_apo", 1.2, 0.5), ("desi", 3.0, 2.3), ("moons", 0.5, 0.2), ("moons", 0.5, 3.0)]
)
def test_no_target_in_a_circle_is_assigned(presets, name, away, radius):
    """Regression: circles with centers outside the projection were omitted, and others were smaller than on the sky."""
    instrument = presets[name]
    field = instrument.field_radius
    sky = rs.synthetic_catalog("uniform", CENTER, field, n_targets=2000, rng=1)
    center = CENTER.directional_offset_by(37 * u.deg, away * field)
    options = rs.AllocationOptions("repair", keep_out=rs.Region.cap(center, radius * field))
    plans = [rs.plan_tile(sky, instrument, CENTER, allocator=allocator) for allocator in ("repair", options)]
    inside, assigned = [], []
    for tile in plans:
        table = tile.table[tile.table["status"] == "assigned"]
        inside.append((SkyCoord(table["ra"], table["dec"]).separation(center) < radius * field).sum())
        assigned.append(len(table))
    assert inside[0] > 3
    assert inside[1] == 0
    # the free area is not larger than the circle and the width of arms around it
    assert assigned[0] - assigned[1] < 2 * inside[0] + 10


def test_targets_that_constraints_exclude_have_their_own_outcome(small, tmp_path):
    """Regression: targets in reach that a rule excludes had the outcome "in reach not assigned"."""
    sky = rs.synthetic_catalog("uniform", CENTER, 0.5 * u.deg, n_targets=120, rng=1)
    magnitude = np.random.default_rng(2).uniform(12, 20, len(sky))
    sky = rs.Catalog(sky.coord, extra={"r": magnitude})
    options = rs.AllocationOptions(constraints=["magnitude r 14 18"])
    plain = rs.plan_tile(sky, small, CENTER)
    tile = rs.plan_tile(sky, small, CENTER, allocator=options)
    rows = tile.outcomes["target_id"]
    in_reach = np.asarray(plain.outcomes["outcome"]) != "out of reach"
    excluded = in_reach & ~((magnitude >= 14) & (magnitude <= 18))[rows]
    assert excluded.sum() > 20
    np.testing.assert_array_equal(tile.outcomes["outcome"] == "excluded by a constraint", excluded)
    folder = tmp_path / "survey"
    survey = rs.plan_survey(sky, small, CENTER.reshape(1), allocator=options, folder=folder)
    np.testing.assert_array_equal(survey.outcome_names[rows], tile.outcomes["outcome"])
    for name in ("tiles.fits", "outcomes.fits"):
        (folder / name).unlink()
    resumed = rs.plan_survey(sky, small, CENTER.reshape(1), allocator=options, folder=folder, resume=True)
    assert (resumed.outcomes["outcome"] == survey.outcomes["outcome"]).all()
    survey.record([{"tile": 0, "date": "2026-01-03"}])
    replanned = survey.replan()
    assert (replanned.outcomes["outcome"] == survey.outcomes["outcome"]).all()
    status = rs.survey.survey_status(replanned, replanned.state(sky))
    assert status["n_impossible"][0] == excluded.sum() + np.count_nonzero(~in_reach) + len(sky) - len(rows)


def test_an_equal_constraint_with_another_text_continues_a_survey(tmp_path):
    coord = rs.synthetic_catalog("uniform", CENTER, 0.6 * u.deg, n_targets=200, rng=3).coord
    sky = rs.Catalog(coord, extra={"h": np.linspace(6, 14, 200)})
    limits = [rs.constraints.MagnitudeLimits("h", 7, 13), "magnitude h 7 13", "magnitude h 7 12.9"]
    assert len({str(rs.AllocationOptions(constraints=one).constraints[0]) for one in limits}) == 3

    def plan(constraint, folder, **options):
        asked = rs.AllocationOptions("nearest", constraints=constraint)
        return rs.plan_survey(sky, "moons", CENTER[None], allocator=asked, folder=folder, **options)

    first = plan(limits[0], tmp_path / "survey")
    assert plan(limits[1], tmp_path / "survey", resume=True).summary == first.summary
    with pytest.raises(rs.InputError, match="constraints differs"):
        plan(limits[2], tmp_path / "survey", resume=True)

    asked = [rs.AllocationOptions("nearest", constraints=one) for one in limits]
    folder = tmp_path / "selection"
    rs.selection_probabilities(sky, "moons", CENTER[None], 2, allocator=asked[0], folder=folder)
    rs.selection_probabilities(sky, "moons", CENTER[None], 2, allocator=asked[1], folder=folder, resume=True)
    with pytest.raises(rs.InputError, match="constraints differs"):
        rs.selection_probabilities(sky, "moons", CENTER[None], 2, allocator=asked[2], folder=folder, resume=True)
