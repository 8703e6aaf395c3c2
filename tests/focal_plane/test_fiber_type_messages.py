"""Messages about fiber types of focal planes with other fiber types, or without fiber types."""

import astropy.units as u
import pytest
from raising import refused

import rfpsurvey as rs
from rfpsurvey.errors import check_choice, check_fiber_type, listed

CENTERS = [[0, 0], [22.4, 0]] * u.mm
ANGLES = [0, 0] * u.deg


def plane_of(presets, *fiber_types):
    """Return two positioners of SDSS-V, whose arm has an angle for BOSS and an angle for APOGEE."""
    columns = {"fiber_type": fiber_types} if fiber_types else {}
    return rs.FocalPlane(CENTERS, presets["sdss_apo"].focal_plane.positioner, **columns)


OTHER_ANGLES = [
    (
        (),
        "arm_angle must be one angle, because the positioners of the focal plane have no fiber types, got angles "
        "for BOSS, APOGEE; give the column fiber_type of the focal plane, or one angle",
    ),
    (("BOS", "APOGEE"), "arm_angle must have the fiber types of the focal plane, BOS, APOGEE, got BOSS; correct"),
    (("BOS", "BOS"), "arm_angle must have the fiber types of the focal plane, BOS, got BOSS, APOGEE; correct"),
]


@pytest.mark.parametrize(("fiber_types", "text"), OTHER_ANGLES)
def test_angles_of_other_fiber_types_are_explained(presets, fiber_types, text):
    plane = plane_of(presets, *fiber_types)
    refused(text, rs.find_collisions, plane, CENTERS + 15 * u.mm)


def test_the_two_remedies_work(presets):
    positioner = presets["sdss_apo"].focal_plane.positioner
    options = {name: getattr(positioner, name) for name in ("central_arm", "eccentric_arm", "clearance")}
    options |= {"arm_model": "capsule", "arm_length": positioner.arm_length, "arm_angle": 1.4 * u.deg}
    rs.find_collisions(rs.FocalPlane(CENTERS, rs.Positioner(**options)), CENTERS + 15 * u.mm)
    rs.find_collisions(plane_of(presets, "BOSS", "APOGEE"), CENTERS + 15 * u.mm)


def test_no_message_ends_with_an_empty_list(presets):
    plain = rs.FocalPlane(CENTERS, rs.Positioner(8 * u.mm, 8 * u.mm, 2 * u.mm))
    radial = rs.projection.RadialMap("theta", [349.1], max_angle=2 * u.deg)
    for call in (
        lambda: plain.forward(ANGLES, ANGLES, "BOSS"),
        lambda: plain.inverse(CENTERS, ["BOSS", ""]),
        lambda: rs.find_collisions(plain, CENTERS, fiber_type=["BOSS", ""]),
        lambda: rs.Instrument("mine", plain, distortion={"BOSS": radial}),
        lambda: rs.allocate(plain, CENTERS, allocator=rs.AllocationOptions("lamost_rule", requirements="sky@BOSS=1")),
    ):
        refused("'BOSS': the positioners have no fiber types; the", call)


def test_lists_of_choices():
    assert listed([]) == "none"
    assert listed(["a", 2]) == "a, 2"
    assert listed("abcd", 2) == "a, b and 2 more"
    refused("unknown method 'x'; choose one of: none\\.", check_choice, "x", [], "method")
    with pytest.raises(rs.InputTypeError, match="unknown fiber 3; choose one of: A\\."):
        check_choice(3, ["", "A"], "fiber")
    with pytest.raises(rs.InputError, match=r"'R5'; choose one of: R10, .*, R\d+ and 440 more\. Did you mean 'R.5'"):
        check_choice("R5", [f"R{k}" for k in range(10, 510)], "robot")
    refused("unknown fiber type 'C'; choose one of: A, B", check_fiber_type, "C", ("A", "B"))


def test_only_columns_of_numbers_are_offered_for_colors():
    tiles = rs.place_tiles(rs.Region.parse("cap 95 23 1"), "lamost")
    tiles.table["night"] = ["first"] * len(tiles)
    text = refused("", rs.plot.plot_tiling, tiles, color="night")
    assert "ra, dec" in text
    assert "night," not in text
