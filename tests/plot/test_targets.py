"""Plots of all targets of a tile or of a survey: every target is drawn once, according to its outcome."""

import io
import re
import time

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import rfpsurvey as rs
from rfpsurvey._field.verdicts import OUTCOMES, Outcome
from rfpsurvey.plot._axes import ARM, SERIES
from rfpsurvey.plot._classes import MOST, OUTCOME_COLORS, short_names

CENTER = SkyCoord(95, 23, unit="deg")
N = 1500
SKY_SEPARATION = 20 * u.arcsec
ASSIGNED = ("observed", "partly observed", "lost to a collision")


@pytest.fixture(scope="module")
def sky():
    rng = np.random.default_rng(4)
    coord = rs.synthetic_catalog("uniform", CENTER, 1.7 * u.deg, n_targets=N, rng=1).coord
    return rs.Catalog(
        coord,
        kind=rng.choice(["science", "standard", "sky"], N, p=[0.8, 0.1, 0.1]),
        category=rng.choice(["qso", "lrg", ""], N, p=[0.5, 0.3, 0.2]),
        priority=rng.integers(1, 4, N),
    )


@pytest.fixture(scope="module")
def tile(presets, sky):
    asked = rs.AllocationOptions("lamost_rule", requirements=["sky=60", "standard=15"], sky_separation=SKY_SEPARATION)
    return rs.plan_tile(sky, presets["sdss_apo"], CENTER, position_angle=20 * u.deg, allocator=asked)


@pytest.fixture(scope="module")
def science_only(presets, sky):
    return rs.plan_tile(sky, presets["sdss_apo"], CENTER)


@pytest.fixture(scope="module")
def survey(presets, sky):
    return rs.plan_survey(sky, presets["moons"], rs.place_tiles(sky, presets["moons"], n_tiles=6), visits=2)


def layers(ax):
    """Return the dots by label. Dots of unassigned targets follow those of assigned targets of their class."""
    return {c.get_label(): c for c in ax.collections if isinstance(c, PathCollection)}


def left_of(ax):
    """Return the dots of unassigned targets by color."""
    rest = [c for c in ax.collections if isinstance(c, PathCollection) and c.get_label() == "_left"]
    return {to_hex(c.get_facecolor()[0]).lower(): c for c in rest}


def words(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def places(table, rows):
    return np.column_stack([table["x"].to_value(u.mm), table["y"].to_value(u.mm)])[rows]


@pytest.mark.parametrize("arms", [True, False])
def test_targets_on_the_focal_plane_by_outcome(tile, arms):
    ax, found = rs.plot.plot_focal_plane(tile, targets="outcome", arms=arms), tile.outcomes
    drawn, known = layers(ax), np.isfinite(found["x"])
    assert known.all()
    for code, color in OUTCOME_COLORS.items():
        rows = found["outcome"] == OUTCOMES[code]
        label = f"{OUTCOMES[code]}: {rows.sum()}"
        if not rows.any():
            assert not [text for text in words(ax) if text.startswith(f"{OUTCOMES[code]}:")]
            continue
        dots = drawn[label]
        np.testing.assert_array_equal(dots.get_offsets(), places(found, rows))
        assert to_hex(dots.get_facecolor()[0]).lower() == color.lower()
        assert label in words(ax)
    # targets lost to a collision also differ in shape
    lost, seen = (drawn[f"{OUTCOMES[k]}: {(found['outcome'] == OUTCOMES[k]).sum()}"] for k in (3, 1))
    assert len(lost.get_paths()[0].vertices) != len(seen.get_paths()[0].vertices)
    # all targets are inside the axes
    low, high = np.sort([ax.get_xlim(), ax.get_ylim()], axis=1).T
    assert ((places(found, known) > low) & (places(found, known) < high)).all()


def test_fibers_on_blank_sky_are_not_targets_of_the_catalog(tile):
    ax, t = rs.plot.plot_focal_plane(tile, targets="outcome"), tile.table
    blank = (t["kind"] == "sky") & ~np.isin(t["target_id"].filled(-1), tile.outcomes["target_id"])
    assert blank.sum() > 5
    dots = layers(ax)[f"fiber on blank sky: {blank.sum()}"]
    np.testing.assert_allclose(dots.get_offsets(), np.column_stack([t["tip_x"].value, t["tip_y"].value])[blank])


@pytest.mark.parametrize("color", ["kind", "category", "priority"])
def test_targets_by_class(tile, sky, color):
    found = tile.outcomes
    assigned = np.isin(found["outcome"], ASSIGNED)
    names = {"category": {"": "no category"}, "priority": {k: f"priority {k}" for k in (1, 2, 3)}}.get(color, {})
    for ax, xy in (
        (rs.plot.plot_focal_plane(tile, targets=color), places(found, slice(None))),
        (rs.plot.plot_targets(tile, color=color), None),
    ):
        drawn, left = layers(ax), left_of(ax)
        for value in set(found[color].tolist()):
            rows = found[color] == value
            label = f"{names.get(value, value)}: {(rows & assigned).sum()} of {rows.sum()}"
            assert label in words(ax)
            dots = drawn[label]
            rest = left[to_hex(dots.get_facecolor()[0]).lower()]
            assert len(dots.get_offsets()) == (rows & assigned).sum()
            assert len(rest.get_offsets()) == (rows & ~assigned).sum()
            assert rest.get_sizes()[0] < dots.get_sizes()[0]
            assert rest.get_zorder() < dots.get_zorder()
            if xy is not None:
                np.testing.assert_array_equal(dots.get_offsets(), xy[rows & assigned])
                np.testing.assert_array_equal(rest.get_offsets(), xy[rows & ~assigned])
        assert "large dots: assigned" in ax.get_legend().get_title().get_text()


def test_the_most_important_and_the_rarest_targets_are_on_top(tile):
    """Regression: the last targets that were drawn, those of the lowest priority, hid all other targets."""
    for color, order in (("priority", ["priority 1", "priority 2", "priority 3"]), ("kind", ["science", "sky"])):
        drawn = {label.split(":")[0]: dots for label, dots in layers(rs.plot.plot_targets(tile, color=color)).items()}
        assert (np.diff([drawn[name].get_zorder() for name in order]) > 0).all()


def test_kinds_have_colors_of_their_own(science_only):
    """Regression: the color of a kind was that of its rank, so that sky was blue on a tile without standard stars."""
    drawn = left_of(rs.plot.plot_targets(science_only, color="kind"))
    assert set(drawn) == {color.lower() for color in (ARM, SERIES[2], SERIES[3])}


def test_targets_that_are_not_requested_are_on_the_sky_only(science_only):
    n = (science_only.outcomes["outcome"] == "not requested").sum()
    assert n > 100
    assert not [text for text in words(rs.plot.plot_focal_plane(science_only, targets="outcome")) if "not req" in text]
    assert f"not requested: {n}" in words(rs.plot.plot_targets(science_only))


def test_a_part_counts_what_it_shows(tile):
    low, high = np.array([-60.0, -40.0]), np.array([50.0, 90.0])
    ax, found = rs.plot.plot_focal_plane(tile, targets="outcome", region=[low, high] * u.mm), tile.outcomes
    inside = ((places(found, slice(None)) >= low) & (places(found, slice(None)) <= high)).all(axis=1)
    for name in set(found["outcome"][inside]):
        assert f"{name}: {(inside & (found['outcome'] == name)).sum()}" in words(ax)


def test_targets_of_a_tile_are_where_they_are_on_the_sky(tile):
    ax, found = rs.plot.plot_targets(tile), tile.outcomes
    drawn = layers(ax)
    assert ax.get_xlim()[0] > ax.get_xlim()[1]  # east is to the left
    for name in set(found["outcome"]):
        rows = found["outcome"] == name
        east, north = CENTER.spherical_offsets_to(SkyCoord(found["ra"][rows], found["dec"][rows]))
        dots = drawn[f"{name}: {rows.sum()}"]
        np.testing.assert_allclose(dots.get_offsets(), np.column_stack([east.deg, north.deg]), atol=2e-4)
    assert ax.get_title() == f"sdss_apo: {np.isin(found['outcome'], ASSIGNED).sum()} of {len(found)} targets assigned"


def test_targets_of_a_survey(survey, sky):
    ax = rs.plot.plot_targets(survey, sky)
    drawn, outcome = layers(ax), np.asarray(survey.outcomes["outcome"])
    for code in np.unique(outcome):
        rows = outcome == code
        dots = drawn[f"{OUTCOMES[code]}: {rows.sum()}"]
        np.testing.assert_allclose(dots.get_offsets(), np.column_stack([sky.coord.ra.deg, sky.coord.dec.deg])[rows])
    assert Outcome.IN_NO_FIELD in outcome
    (fields,) = [c for c in ax.collections if isinstance(c, LineCollection)]
    assert len(fields.get_segments()) == len(survey)
    by_kind = rs.plot.plot_targets(survey, sky, color="kind")
    done = np.isin(outcome, [OUTCOMES.index(name) for name in ASSIGNED])
    assert f"science: {(done & (sky.kind == 'science')).sum()} of {(sky.kind == 'science').sum()}" in words(by_kind)


def test_a_survey_on_the_whole_sky(survey, sky):
    ax = rs.plot.plot_targets(survey, sky, ax=Figure().add_subplot(projection="aitoff"))
    dots = layers(ax)[f"in no field: {(survey.outcomes['outcome'] == Outcome.IN_NO_FIELD).sum()}"]
    rows = np.asarray(survey.outcomes["outcome"]) == Outcome.IN_NO_FIELD
    np.testing.assert_allclose(dots.get_offsets()[:, 1], sky.coord.dec.rad[rows])
    assert not [c for c in ax.collections if isinstance(c, LineCollection)]


def test_axes_and_style_can_be_given(tile):
    ax = Figure().add_subplot()
    assert rs.plot.plot_targets(tile, ax=ax, alpha=0.3) is ax
    assert {c.get_alpha() for c in ax.collections} == {0.3}


def test_a_tile_with_one_target_is_drawn(presets):
    one = rs.plan_tile(SkyCoord([95.05] * u.deg, [23.05] * u.deg), presets["moons"], CENTER)
    ax = rs.plot.plot_targets(one)
    assert (ax.get_title(), words(ax)) == ("moons: 1 of 1 targets assigned", ["observed: 1"])
    assert words(rs.plot.plot_focal_plane(one, targets="kind"))[-1] == "science: 1 of 1"


def test_what_cannot_be_drawn_is_refused(tile, survey, sky, presets):
    bare = rs.plan_tile(rs.Catalog(sky.coord), presets["moons"], CENTER)
    scored = rs.score_tile(bare.table, presets["moons"])
    for call, message in (
        (lambda: rs.plot.plot_targets("lamost"), "result must be a Tile or a Survey, got str"),
        (lambda: rs.plot.plot_targets(tile, color="outcomes"), "unknown color 'outcomes'.* Did you mean 'outcome'"),
        (lambda: rs.plot.plot_targets(tile, sky), "catalog must be None for a Tile"),
        (lambda: rs.plot.plot_targets(scored), "the tile must have outcomes of targets, got none"),
        (lambda: rs.plot.plot_targets(bare, color="priority"), "the catalog must have the column priority"),
        (lambda: rs.plot.plot_targets(survey), "catalog must be the catalog of the survey"),
        (lambda: rs.plot.plot_targets(survey, sky[:-1]), "catalog must have the 1500 targets of the survey"),
        (lambda: rs.plot.plot_targets(survey, sky[::-1]), "catalog must have the 1500 targets of the survey"),
        (lambda: rs.plot.plot_focal_plane(tile, targets="all"), "unknown targets 'all'"),
        (
            lambda: rs.plot.plot_focal_plane("lamost", targets="kind"),
            "thing must be a Tile to draw its targets by kind",
        ),
        (lambda: rs.plot.plot_focal_plane(scored, targets="kind"), "the tile must have outcomes of targets, got none"),
    ):
        with pytest.raises(rs.InputError, match=message):
            call()


@pytest.mark.exhaustive
def test_a_hundred_thousand_targets_are_quick_and_an_image_in_files_of_vectors(presets):
    desi, n = presets["desi"], 100_000
    sky = rs.synthetic_catalog("uniform", CENTER, desi.field_radius, n_targets=n, rng=1)
    tile, start = rs.plan_tile(sky, desi, CENTER, allocator="balanced"), time.perf_counter()
    ax = rs.plot.plot_focal_plane(tile, targets="outcome")
    rs.plot.plot_targets(tile).figure.savefig(io.BytesIO(), format="png", dpi=100)
    assert time.perf_counter() - start < 30
    counted = [re.fullmatch(r"[a-z ]+: (\d+)", text) for text in words(ax)]
    assert sum(int(found[1]) for found in counted if found) == n
    assert sum(len(c.get_offsets()) for c in ax.collections if isinstance(c, PathCollection)) == n
    file = io.BytesIO()
    rs.plot.plot_targets(tile).figure.savefig(file, format="svg", dpi=100)
    assert len(file.getvalue()) < 2_000_000


@pytest.mark.parametrize("make", ["tile", "survey", "column"])
def test_few_targets_are_at_the_center(presets, make):
    """One target, or targets with the same right ascension, are not at the border of the axes, and are large dots."""
    coord = SkyCoord([95.3] * u.deg, [23.2] * u.deg)
    if make == "column":
        coord = SkyCoord(np.full(5, 95.3) * u.deg, np.linspace(22.8, 23.2, 5) * u.deg)
    if make == "survey":
        ax = rs.plot.plot_targets(rs.plan_survey(coord, presets["sdss_apo"], CENTER.reshape(1)), coord)
    else:
        ax = rs.plot.plot_targets(rs.plan_tile(coord, presets["sdss_apo"], CENTER))
    (dots,) = layers(ax).values()
    limits = np.sort([ax.get_xlim(), ax.get_ylim()], axis=1).T
    at = (np.mean(dots.get_offsets(), axis=0) - limits[0]) / np.ptp(limits, axis=0)
    assert (np.abs(at - 0.5) < (0.2 if make == "survey" else 0.01)).all()
    assert np.ptp(limits, axis=0).min() > 0.05
    assert dots.get_sizes()[0] == pytest.approx(25)


SETS = {
    "same beginning": [f"bright_emission_line_galaxies_of_program_{k}" for k in range(30)],
    "same end": [f"{k}_bright_emission_line_galaxies_of_program" for k in range(30)],
    "same beginning and end": [f"bright_emission_line_{k}_galaxies_of_a_program" for k in range(30)],
    "short": ["LRG", "ELG", "QSO", ""],
    "mixed": ["LRG", "x" * 22, "x" * 23, "x" * 24],
}


@pytest.mark.parametrize("names", SETS.values(), ids=SETS)
def test_different_names_have_different_short_names(names):
    short = short_names(names)
    assert len(set(short)) == len(set(names))
    assert max(map(len, short)) <= MOST
    assert all(a == b for a, b in zip(names, short, strict=True) if names is SETS["short"])


def test_long_names_of_categories_do_not_shrink_the_axes(presets):
    """Regression: names of 40 characters reduced the axes to a third of the figure, or were cut off."""
    apo = presets["sdss_apo"]
    sky = rs.synthetic_catalog("poisson", CENTER, apo.field_radius, density=300 / u.deg**2, rng=1)
    names = np.array(SETS["same beginning"][:14])[np.arange(len(sky)) % 14]
    tile = rs.plan_tile(rs.Catalog(sky.coord, category=names), apo, CENTER)
    for ax, least in ((rs.plot.plot_quality(tile)[0], 0.3), (rs.plot.plot_focal_plane(tile, targets="category"), 0.75)):
        figure = ax.figure
        figure.canvas.draw()
        assert ax.get_position().width > least
        box = ax.get_legend().get_window_extent()
        assert box.x0 >= 0
        assert box.x1 <= figure.bbox.x1
