"""Measure instruments made of modules with about 20,000 positioners, and answer questions of their designers.

python tests/benchmarks/stage5_figures.py [tile growth surface arms gaps classes broken]
RFPSURVEY_TEST_DATA=... python tests/benchmarks/stage5_figures.py survey [--targets 40e6] [--workers 2]

Times are processor times of the second of two calls, apart from the survey.
"""

import resource
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from time import perf_counter, process_time

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from measure import arguments, machine, timed

import rfpsurvey as rs
from rfpsurvey._instruments.modules import grouped_modules

CENTER = SkyCoord("10h +20d")
ALLOCATORS = ("nearest", "balanced", "repair", "optimal")


def second(function, *args, **options):
    """Call a function twice; return its result and the processor time of the second call."""
    function(*args, **options)
    return timed(function, *args, **options)


def sky_for(instrument, per_positioner, rng=1):
    """Return random targets in the field of an instrument."""
    n = int(per_positioner * len(instrument.focal_plane))
    return rs.synthetic_catalog("uniform", CENTER, instrument.field_radius, n_targets=n, rng=rng)


def design(**columns):
    """Return the preset of MUST with other columns of its focal plane."""
    must = rs.Instrument.preset("must")
    return replace(must, focal_plane=replace(must.focal_plane, **columns))


def visits(instrument, catalog):
    """Return the numbers of targets that a first tile, and four tiles in almost the same direction, observe."""
    offsets = ((0, 0), (20, 0.02), (140, 0.03), (260, 0.025))
    tiles = SkyCoord([CENTER.directional_offset_by(angle * u.deg, size * u.deg) for angle, size in offsets])
    observed = np.asarray(rs.plan_survey(catalog, instrument, tiles, allocator="optimal").tiles["n_observed"])
    return observed[0], observed.sum()


def count(instrument, catalog, allocator="optimal"):
    """Return the number of targets without a collision, and the number of colliding positioners."""
    summary = rs.plan_tile(catalog, instrument, CENTER, allocator=allocator).summary
    return round(summary["n_assigned"] * (1 - summary["collision_rate_assigned"])), summary["n_colliding"]


def tile(_options):
    """Print the time of one tile of 100,000 targets."""
    must = rs.Instrument.preset("must")
    sky = rs.synthetic_catalog("uniform", CENTER, must.field_radius, n_targets=100_000, rng=1)
    for allocator in ALLOCATORS:
        one, seconds = second(rs.plan_tile, sky, must, CENTER, allocator=allocator)
        s = one.summary
        print(f"{allocator:9} {s['n_assigned']} assigned, {s['n_colliding']} collide, gap {s['gap']}, {seconds:.3f} s")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "must.html"
        begin = process_time()
        rs.write_report(one, path)
        print(f"page of the tile: {path.stat().st_size / 1e6:.2f} MB, {process_time() - begin:.1f} s")
    found, seconds = second(rs.collision_probability, must)
    print(f"{found}, {seconds:.2f} s")
    _, seconds = second(rs.compare_instruments, "poisson", ["must", "spec_s5", "desi"])
    print(f"comparison of three instruments: {seconds:.1f} s")


def growth(_options):
    """Print the time of one tile with five targets per positioner for three sizes, and the exponents."""
    for allocator in ALLOCATORS:
        found = []
        for radius in (230, 520, 1150):
            text = Path(rs.__file__).parent.joinpath("presets/must.toml").read_text()
            text = text.replace("group_radius = { value = 520.0", f"group_radius = {{ value = {float(radius)}")
            head, _, tail = text.partition("[layout.focal_surface]")  # the published profile ends at the edge of MUST
            text = head + "[optics]" + tail.partition("[optics]")[2]
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "size.toml"
                path.write_text(text.replace('name = "must"', 'name = "size"'))
                instrument = rs.Instrument.read(path)
            sky = sky_for(instrument, 5)
            _, seconds = second(rs.plan_tile, sky, instrument, CENTER, allocator=allocator)
            found.append((len(instrument.focal_plane), seconds))
        sizes, times = np.log(np.array(found)).T
        text = ", ".join(f"{n}: {seconds:.3f} s" for n, seconds in found)
        print(f"{allocator:9} {text}; exponent {np.polyfit(sizes, times, 1)[0]:.2f}")


def surface(_options):
    """Print how positions along the axis differ from true distances on the curved surface, and what this changes."""
    for name in ("must", "spec_s5"):
        curved = rs.Instrument.preset(name)
        xy = curved.focal_plane.xy.to_value(u.mm).reshape(-1, 63, 2)
        centers = xy.mean(axis=1)
        flat = _flat(name)
        shift = np.hypot(*flat.T) - np.hypot(*centers.T)
        pairs = curved.focal_plane.neighbor_pairs()
        module = np.repeat(np.arange(len(xy)), 63)
        across = module[pairs[:, 0]] != module[pairs[:, 1]]
        print(f"{name}: largest shift {shift.max():.3f} mm, {across.mean():.1%} of the neighbors in different modules")
        full = (xy - centers[:, None, :] + flat[:, None, :]).reshape(-1, 2) * u.mm
        other = replace(curved, focal_plane=replace(curved.focal_plane, xy=full))
        numbers = []
        for seed in range(20):
            rng = np.random.default_rng(seed)
            offset = 3.6 * np.sqrt(rng.random(len(module))) * np.exp(2j * np.pi * rng.random(len(module)))
            offset = np.column_stack([offset.real, offset.imag])
            own = []
            for one in (curved, other):
                report = rs.find_collisions(one.focal_plane, one.focal_plane.xy + offset * u.mm)
                own.append({tuple(pair) for pair in report.pairs.tolist()})
            numbers.append([len(own[0]), len(own[1]), len(own[0] ^ own[1])])
        n = np.sum(numbers, axis=0)
        print(f"  colliding pairs with and without the projection: {n[0]}, {n[1]}; {n[2]} differ ({n[2] / n[0]:.2%})")


def _flat(name):
    """Return the centers of the modules on the flat grid, in the order of the preset."""
    radius, whole = {"must": (520.0, True), "spec_s5": (340.0, False)}[name]
    return grouped_modules(73.8, 0.3, 4.4, radius, whole=whole)[0]


def arms(_options):
    """Print targets and collisions for arms of several lengths."""
    for length in (1.8, 2.0, 2.2, 2.4):
        robot = rs.Positioner(length * u.mm, length * u.mm, clearance=1 * u.mm)
        instrument = design(positioner=robot)
        for per in (1, 4):
            sky = sky_for(rs.Instrument.preset("must"), per)
            found = {name: count(instrument, sky, name) for name in ("optimal", "nearest")}
            print(f"arms of {length} mm, {per} targets per positioner: {found}", flush=True)


def gaps(_options):
    """Print the targets of one pass and of four passes for several gaps between groups of modules."""
    must = rs.Instrument.preset("must")
    sky, places = sky_for(must, 1), rs.focal_plane.triangle(6.2 * u.mm, 11, corners=False)
    for gap in (0.0, 2.0, 4.4, 8.0):
        edge = 147.6 + 3**0.5 * (gap + 0.6)
        xy, turn, _ = grouped_modules(73.8, 0.3, gap, 520.0 * edge / 156.26, whole=True)
        layout = {"centers": xy * u.mm, "rotation": turn * u.rad, "places": places}
        plane = rs.FocalPlane.from_modules(must.focal_plane.positioner, **layout)
        first, four = visits(replace(must, focal_plane=plane), sky)
        inside = len(sky) * (plane.footprint / (np.pi * (must.field_radius * must.plate_scale) ** 2)).to_value("")
        print(f"gap {gap} mm, {len(plane)} positioners: {first / inside:.1%} and {four / inside:.1%}", flush=True)


def classes(_options):
    """Print the targets of each class for several fractions of high-resolution fibers with longer arms."""
    must = rs.Instrument.preset("must")
    for n_high in (0, 6, 12, 21):
        is_high = np.tile(np.isin(np.arange(63), np.linspace(0, 62, n_high).astype(int)), 336)
        length = np.where(is_high, 2.4, 1.8) * u.mm
        types = {"fiber_type": np.where(is_high, "HR", "LR")}
        instrument = design(**types, central_arm=length, eccentric_arm=length)
        sky = sky_for(must, 4)
        wanted = np.where(np.random.default_rng(7).random(len(sky)) < n_high / 63, "HR", "LR")
        one = rs.plan_tile(replace(sky, fiber_type=wanted), instrument, CENTER, allocator="optimal")
        has = np.asarray(one.table["status"]) == "assigned"
        n = {name: int((has & (is_high == (name == "HR"))).sum()) for name in ("LR", "HR")}
        print(f"{n_high} of 63 fibers with arms of 2.4 mm: {n} of {one.summary['n_in_field']} targets", flush=True)


def broken(_options):
    """Print what broken positioners cost in one pass and in four passes."""
    must = rs.Instrument.preset("must")
    sky, whole = sky_for(must, 1), None
    for part in (0, 0.01, 0.03, 0.1):
        found = np.array(visits(design(disabled=np.random.default_rng(2).random(len(must.focal_plane)) < part), sky))
        whole = found if whole is None else whole
        print(f"{part:.0%} broken: {found.tolist()} targets, {(found / whole - 1).round(4).tolist()}", flush=True)


def survey(options):
    """Plan a survey of DESI's footprint with the field of MUST, from a partitioned catalog."""
    from survey_figures import desi_tiles, make_targets

    targets = make_targets(desi_tiles(), options.targets)
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        few = targets[np.random.default_rng(1).random(len(targets)) < 2e5 / len(targets)]
        tiling = rs.place_tiles(few, radius=1.25 * u.deg, fibers=10**6, method="spiral", passes=4)
        parts = rs.catalog.partition_catalog(targets, Path(folder) / "targets")
        n = len(targets)
        del targets, few
        print(f"{n} targets, {len(parts.parts.files)} partitions, {len(tiling)} tiles", flush=True)
        begin = perf_counter()
        with ProcessPoolExecutor(options.workers) as executor:
            found = rs.plan_survey(
                parts, "must", tiling, allocator="nearest", folder=Path(folder) / "survey", executor=executor
            )
        print(f"{perf_counter() - begin:.0f} s; visits {found.summary['n_visits_observed']}")
        own, others = (
            resource.getrusage(who).ru_maxrss / 1e6 for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
        )
        print(f"peak memory {own:.2f} GB (with the making of the catalog), worker {others:.2f} GB")


PARTS = {f.__name__: f for f in (tile, growth, surface, arms, gaps, classes, broken, survey)}


def main():
    options = arguments(__doc__, [name for name in PARTS if name != "survey"], targets=40e6, workers=2, folder=str)
    print(machine())
    for name in options.words:
        PARTS[name](options)


if __name__ == "__main__":
    main()
