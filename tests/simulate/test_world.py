"""World files: what is accepted, where walls, doors and boxes stand, their edges; drives and their odometry."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from folders import ROOT
from pydantic import ValidationError

from localiser import geometry
from localiser.errors import InputError
from localiser.simulate.drive import odometry_of, truth_of
from localiser.simulate.render import scene_of
from localiser.simulate.solids import clearance_m, solids_of
from localiser.simulate.structure import structure_of, vertical_edges
from localiser.simulate.world import DriveSpec, OdometrySpec, World, world_of
from localiser.storage import simulate_log

WORLDS = sorted((ROOT / "configs" / "worlds").glob("*.yaml"))


def data(**changes: Any) -> dict[str, Any]:
    plain = {"texture": "plain", "colour": [200, 200, 200]}
    return {
        "format": "localiser-world/1",
        "name": "test",
        "materials": dict.fromkeys(("wall", "frame", "door", "floor", "art"), plain),
        "floor": {"material": "floor"},
        "ceiling": {"material": "floor"},
        "camera": {"focal_px": 500.0, "mount": {"tilt_deg": 20.0, "height_m": 0.9}},
        "drive": {"path": [{"to": [0.0, 0.0]}, {"to": [0.0, -1.0]}]},
        **changes,
    }


def world(**changes: Any) -> World:
    return world_of(data(**changes))


def edges_of(**changes: Any) -> set[tuple[float, float, float, float]]:
    edges = vertical_edges(solids_of(world(**changes)))
    columns = np.column_stack([edges.points, edges.bottom_m, edges.top_m])
    return {tuple(row) for row in (np.round(columns, 3) + 0.0).tolist()}


CAMERA = {"focal_px": 500.0, "mount": {"tilt_deg": 20.0, "height_m": 0.9}}
POSTER = {"at_m": 2.0, "width_m": 0.6, "bottom_m": 1.0, "top_m": 1.5, "side": "left", "material": "art"}

# -- the file ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "loc"),
    [
        ({"colour": 3}, ("colour",)),
        ({"format": "localiser-world/2"}, ("format",)),
        ({"ceiling_m": "high"}, ("ceiling_m",)),
        ({"ceiling_m": float("nan")}, ("ceiling_m",)),
        ({"ceiling_m": 1e9}, ("ceiling_m",)),
        ({"walls": [{"from": [0, 0], "to": [2, 0]}] * 10_001}, ()),
        ({"camera": CAMERA | {"rolling_shutter": {"row_time_us": 9, "stamp_row": 480}}}, ("camera",)),
        ({"walls": [{"from": [0, 0], "to": [0, 0]}]}, ("walls", 0)),
        ({"walls": [{"from": [0, 0], "to": [2, 0], "doors": [{"at_m": 1.8}]}]}, ("walls", 0)),
        ({"walls": [{"from": [0, 0], "to": [4, 0], "doors": [{"at_m": 1.5}, {"at_m": 2.0}]}]}, ("walls", 0)),
        ({"walls": [{"from": [0, 0], "to": [2, 0], "material": "gold"}]}, ("walls", 0, "material")),
        ({"walls": [{"from": [0, 0], "to": [2, 0], "doors": [{"at_m": 1.0, "leaf": {"material": "gold"}}]}]}, (
            "walls", 0, "doors", 0, "leaf", "material")),
        ({"posts": [{"x": 0, "z": 0, "width_m": 0.2, "sides": 9, "material": "wall"}]}, ("posts", 0, "sides")),
        ({"furniture": [
            {"x": 0, "z": 0, "width_m": 1, "depth_m": 1, "bottom_m": 1, "top_m": 0.5, "material": "wall"}
        ]}, ("furniture", 0)),
        ({"posts": [{"x": 0, "z": 0, "width_m": 0.2, "bottom_m": 1, "top_m": 1, "material": "wall"}]}, ("posts", 0)),
        ({"walls": [{"from": [0, 0], "to": [2, 0], "posters": [POSTER | {"top_m": 1}]}]}, ("walls", 0, "posters", 0)),
        ({"ceiling_m": 0.9}, ()),
        ({"camera": CAMERA | {"motion": {"height_m": {"amplitude": -0.9, "hz": 1.0}}}}, ()),
        ({"camera": CAMERA | {"motion": {"yaw_deg": {"amplitude": 180.5, "hz": 1.0}}}}, ()),
        ({"start": {"sigma_m": 1001}}, ("start", "sigma_m")),
        ({"start": {"sigma_deg": 361}}, ("start", "sigma_deg")),
        ({"drive": {"path": [{"to": [0, 0]}]}}, ("drive", "path")),
        ({"camera": CAMERA | {"distortion_model": "plumb_bob", "distortion": [0.1]}}, ("camera",)),
    ],
)  # fmt: skip
def test_errors_lead_to_their_place_in_the_file(changes: dict[str, Any], loc: tuple[str | int, ...]) -> None:
    with pytest.raises(ValidationError) as caught:
        world(**changes)
    assert caught.value.errors()[0]["loc"] == loc


# -- edges ------------------------------------------------------------------------------------------------------------


def test_a_box_has_its_four_corners_between_its_heights() -> None:
    box = {"x": 1.0, "z": -2.0, "width_m": 0.4, "depth_m": 0.2, "bottom_m": 0.3, "top_m": 0.8, "material": "wall"}
    assert edges_of(furniture=[box]) == {(x, z, 0.3, 0.8) for x in (0.8, 1.2) for z in (-2.1, -1.9)}


def test_a_box_against_a_wall_keeps_its_concave_edges_and_loses_those_inside() -> None:
    wall = {"from": [-3, 0], "to": [3, 0]}
    box = {"x": 0.0, "z": -0.25, "width_m": 1.0, "depth_m": 0.5, "top_m": 0.7, "material": "wall"}
    edges = edges_of(walls=[wall], furniture=[box])
    assert {e for e in edges if abs(e[0]) < 1} == {(x, z, 0.0, 0.7) for x in (-0.5, 0.5) for z in (-0.5, -0.06)}


def test_a_box_on_a_box_makes_one_edge_where_they_are_flush() -> None:
    box = {"x": 0.0, "z": 0.0, "width_m": 0.4, "depth_m": 0.4, "top_m": 0.5, "material": "wall"}
    upper = {**box, "bottom_m": 0.5, "top_m": 1.2}
    assert {(low, high) for _, _, low, high in edges_of(furniture=[box, upper])} == {(0.0, 1.2)}


def test_a_door_has_edges_of_its_opening_and_frame_up_to_their_heights() -> None:
    door = {"at_m": 2.0, "width_m": 1.0, "height_m": 2.0, "frame_m": 0.1, "frame_out_m": 0.03}
    edges = edges_of(walls=[{"from": [0, 0], "to": [4, 0], "doors": [door]}])
    inner = {e for e in edges if abs(e[0] - 2.0) < 0.55}
    # The lining narrows the opening by 2 cm on either side and 2 cm above.
    assert inner == {(x, z, 0.0, 1.98) for x in (1.52, 2.48) for z in (-0.09, 0.09)}
    outer = {e for e in edges if 0.55 <= abs(e[0] - 2.0) < 0.65}
    assert outer == {(x, z, 0.0, 2.1) for x in (1.4, 2.6) for z in (-0.09, -0.06, 0.06, 0.09)}


@pytest.mark.parametrize(
    ("hinge", "side", "x", "z_sign"), [("from", "left", 1.5, -1), ("to", "left", 2.5, -1), ("to", "right", 2.5, 1)]
)
def test_an_open_door_leaf_stands_at_its_hinge_on_its_side(hinge: str, side: str, x: float, z_sign: int) -> None:
    leaf = {"angle_deg": 90.0, "hinge": hinge, "side": side}
    door = {"at_m": 2.0, "width_m": 1.0, "leaf": leaf}
    # From [0, 0] to [4, 0] left is -z.
    solids = solids_of(world(walls=[{"from": [0, 0], "to": [4, 0], "doors": [door]}]))
    corners = solids.corners[solids.material.index("door")]
    assert np.abs(corners[:, 0] - x).max() < 0.08 and z_sign * corners[:, 1].sum() > 0
    assert 0.9 < np.abs(corners[:, 1]).max() < 1.0


@pytest.mark.parametrize("hinge", ["from", "to"])
def test_a_closed_door_leaf_fills_its_opening(hinge: str) -> None:
    door = {"at_m": 2.0, "width_m": 1.0, "leaf": {"hinge": hinge, "thickness_m": 0.06}}
    solids = solids_of(world(walls=[{"from": [0, 0], "to": [4, 0], "doors": [door]}]))
    corners = solids.corners[solids.material.index("door")]
    np.testing.assert_allclose(np.sort(corners[:, 0]), [1.52, 1.52, 2.48, 2.48], atol=1e-12)
    np.testing.assert_allclose(np.sort(corners[:, 1]), [-0.03, -0.03, 0.03, 0.03], atol=1e-12)


def test_pictures_are_no_landmarks_but_are_known_to_the_renderer() -> None:
    bare, hung = ([{"from": [0, 0], "to": [4, 0], "posters": posters}] for posters in ([], [POSTER]))
    assert len(structure_of(world(walls=hung)).landmark_map) == len(structure_of(world(walls=bare)).landmark_map)
    edges = vertical_edges(solids_of(world(walls=hung)))
    pictured = edges.points[edges.is_flat]
    assert {round(float(x), 3) for x in pictured[:, 0]} == {1.7, 2.3}


# -- landmarks --------------------------------------------------------------------------------------------------------


def test_edges_within_two_centimetres_are_one_landmark_in_their_middle() -> None:
    thin = {"x": 0.0, "z": 0.0, "width_m": 1.0, "depth_m": 0.015, "top_m": 1.0, "material": "wall"}
    landmarks = structure_of(world(furniture=[thin])).landmark_map
    assert landmarks.source == ("simulated", "simulated")
    np.testing.assert_allclose(sorted(landmarks.points.tolist()), [[-0.5, 0.0], [0.5, 0.0]], atol=1e-12)
    assert len(structure_of(world(furniture=[{**thin, "depth_m": 0.025}])).landmark_map) == 4


# -- clearance --------------------------------------------------------------------------------------------------------


def test_clearance_is_the_distance_from_the_nearest_solid_in_the_robots_way() -> None:
    wall = {"from": [-3, 0], "to": [3, 0]}
    shelf = {"x": 0.0, "z": -1.0, "width_m": 1.0, "depth_m": 0.4, "bottom_m": 1.5, "top_m": 1.7, "material": "wall"}
    solids = solids_of(world(walls=[wall], furniture=[shelf]))
    distance = clearance_m(solids, np.array([[0.0, -1.0], [0.0, 0.0], [4.06, 1.06]]), height_m=1.2)
    np.testing.assert_allclose(distance, [0.94, -0.06, np.hypot(1.0, 1.0)], atol=1e-9)


@pytest.mark.parametrize("path", WORLDS, ids=lambda path: path.stem)
def test_worlds_that_ship_are_valid(path: Path) -> None:
    shipped = world_of(yaml.safe_load(path.read_text(encoding="utf-8")))
    assert shipped.name == path.stem and len(structure_of(shipped).landmark_map) > 30
    way = truth_of(shipped.drive).poses[:, :2]
    assert clearance_m(solids_of(shipped), way, shipped.camera.mount.height_m).min() > 0.2


@pytest.mark.parametrize(
    "changes", [{"focal_px": 0.5}, {"distortion_model": "plumb_bob", "distortion": [-0.9] + 4 * [0]}]
)
def test_a_camera_whose_file_could_not_be_read_again_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=r"camera: (camera_matrix|distortion_coefficients)\.data: expected"):
        simulate_log(world(camera=CAMERA | changes))


def test_a_drive_without_an_end_in_sight_is_refused() -> None:
    endless = {"speed_m_s": 1e-9, "path": [{"to": [0.0, 0.0]}, {"to": [0.0, -1.0]}]}
    with pytest.raises(InputError, match="expected a drive of at most 1000000 poses and images"):
        truth_of(world(drive=endless).drive)


def test_a_floor_that_is_too_large_to_be_drawn_is_refused() -> None:
    far = world(posts=[{"x": 9e4, "z": 9e4, "width_m": 1.0, "material": "wall"}])
    with pytest.raises(InputError, match="expected a floor of at most 20000 m²"):
        _ = scene_of(far).lighting


def test_a_turned_box_turns_anticlockwise_seen_from_above() -> None:
    box = {"x": 0.0, "z": 0.0, "width_m": 2.0, "depth_m": 0.2, "rotation_deg": 90.0, "top_m": 1.0, "material": "wall"}
    points = {(x, z) for x, z, _, _ in edges_of(furniture=[box])}
    assert points == {(x, z) for x in (-0.1, 0.1) for z in (-1.0, 1.0)}
    tilted = solids_of(world(furniture=[{**box, "rotation_deg": 30.0}])).corners[0]
    # The end at robot-right (+x) of an anticlockwise turn moves ahead, to -z.
    assert tilted[np.argmax(tilted[:, 0]), 1] < -0.3


def test_walls_that_meet_have_one_edge_inside_and_one_outside_and_none_between() -> None:
    walls = [{"from": [0, 0], "to": [0, -4]}, {"from": [0, 0], "to": [4, 0]}]
    points = {(x, z) for x, z, _, _ in edges_of(walls=walls)}
    near = {(x, z) for x, z in points if abs(x) < 1 and abs(z) < 1}
    assert near == {(0.06, -0.06), (-0.06, 0.06)}


def drive(*path: dict[str, Any], **changes: Any) -> DriveSpec:
    return DriveSpec.model_validate({"path": path, "odometry_hz": 50.0, **changes})


CORNER = ({"to": [0, 0]}, {"to": [0, -3], "corner_radius_m": 1.0}, {"to": [2, -3]})


def test_a_drive_starts_at_its_first_point_facing_the_second_and_ends_at_the_last() -> None:
    truth = truth_of(drive({"to": [1, 2]}, {"to": [-1, 2]}, end_turn_deg=90.0))
    np.testing.assert_allclose(truth.poses[0], [1, 2, np.pi / 2], atol=1e-12)
    np.testing.assert_allclose(truth.poses[-1, :2], [-1, 2], atol=1e-12)
    assert abs(geometry.wrap_angle(truth.poses[-1, 2] - np.pi)) < 1e-12
    assert (np.diff(truth.t_ns) == 20_000_000).all()


def test_a_rounded_corner_is_an_exact_arc() -> None:
    truth = truth_of(drive(*CORNER))
    on_arc = (truth.poses[:, 1] < -2) & (truth.poses[:, 0] < 1)
    assert on_arc.sum() > 50
    from_centre = np.hypot(truth.poses[on_arc, 0] - 1.0, truth.poses[on_arc, 1] + 2.0)
    np.testing.assert_allclose(from_centre, 1.0, atol=1e-12)
    np.testing.assert_allclose(truth.poses[-1, 2], -np.pi / 2, atol=1e-12)


def test_speed_is_constant_and_straight_ahead_also_on_the_arc() -> None:
    spec = drive(*CORNER, speed_m_s=0.4)
    truth = truth_of(spec)
    turning = 1.0 / 0.4 * np.pi / 2
    duration = (2.0 + 1.0) / 0.4 + turning
    assert truth.t_ns[-1] / 1e9 == pytest.approx(duration, abs=0.02)
    inside = truth.t_ns[:-1] / 1e9 < duration - 0.04
    for start, end in zip(truth.poses[:-1][inside], truth.poses[1:][inside], strict=True):
        motion = geometry.between(start, end)
        if abs(motion[2]) in (0.0, pytest.approx(0.4 * 0.02)):  # not where two pieces meet
            np.testing.assert_allclose(geometry.arc_log(motion), [0.0, -0.4 * 0.02], atol=1e-12)


def test_a_corner_without_radius_turns_on_the_spot_the_short_way() -> None:
    truth = truth_of(drive({"to": [0, 0]}, {"to": [0, -1], "pause_s": 1.0}, {"to": [1, -1]}, turn_deg_s=45.0))
    at_corner = np.hypot(truth.poses[:, 0], truth.poses[:, 1] + 1) < 1e-9
    assert at_corner.sum() / 50 == pytest.approx(2.0 + 1.0, abs=0.05)
    turned = np.diff(np.unwrap(truth.poses[at_corner, 2]))
    assert (turned <= 1e-12).all(), "to the right only"
    assert turned.sum() == pytest.approx(-np.pi / 2, abs=0.02)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        (({"to": [0, 0]}, {"to": [0, 0]}), "apart"),
        (({"to": [0, 0]}, {"to": [0, -0.5], "corner_radius_m": 1.0}, {"to": [2, -0.5]}), "room for the corners"),
        (({"to": [0, 0]}, {"to": [0, -3], "corner_radius_m": 0.5}, {"to": [0, 0]}), "room for the corners"),
    ],
)
def test_a_path_that_cannot_be_driven_is_refused(path: tuple[dict[str, Any], ...], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        drive(*path)


def test_odometry_without_errors_repeats_the_truth_in_its_own_frame() -> None:
    truth = truth_of(drive(*CORNER, {"to": [2, 1]}))
    odometry = odometry_of(truth, OdometrySpec(), np.random.default_rng(0))
    np.testing.assert_allclose(odometry.poses[0], 0.0)
    in_map = geometry.compose(truth.poses[0], odometry.poses)
    np.testing.assert_allclose(in_map[:, :2], truth.poses[:, :2], atol=1e-9)
    np.testing.assert_allclose(geometry.wrap_angle(in_map[:, 2] - truth.poses[:, 2]), 0.0, atol=1e-9)


def test_systematic_errors_have_the_stated_size() -> None:
    truth = truth_of(drive({"to": [0, 0]}, {"to": [0, -4]}, end_turn_deg=90.0))
    spec = OdometrySpec(distance_scale=0.1, rotation_scale=-0.2)
    end = odometry_of(truth, spec, np.random.default_rng(0)).poses[-1]
    np.testing.assert_allclose(end, [0.0, -4.4, np.deg2rad(72)], atol=1e-9)
    veering = odometry_of(truth, OdometrySpec(veer_deg_per_m=5.0), np.random.default_rng(0)).poses[-1]
    assert veering[2] == pytest.approx(np.deg2rad(90 + 4 * 5.0))
    assert veering[0] < -0.5, "a positive veer is anticlockwise: to the left"


def test_turn_noise_grows_with_the_root_of_the_turn() -> None:
    truth = truth_of(drive({"to": [0, 0]}, {"to": [0, -0.1]}, end_turn_deg=100.0))
    spec = OdometrySpec(turn_noise_deg_per_sqrt_deg=0.3)
    ends = [odometry_of(truth, spec, np.random.default_rng(seed)).poses[-1, 2] for seed in range(150)]
    assert np.rad2deg(np.std(ends)) == pytest.approx(3.0, rel=0.25)


def test_the_slow_scale_varies_by_its_sigma_and_stays_for_its_time() -> None:
    spec = OdometrySpec(slow_scale_sigma=0.05, slow_scale_time_s=4.0)
    truth = truth_of(drive({"to": [0, 0]}, {"to": [0, -400]}, speed_m_s=1.0, odometry_hz=5.0))
    odometry = odometry_of(truth, spec, np.random.default_rng(0))
    step = np.hypot(*np.diff(odometry.poses[:, :2], axis=0).T) / np.hypot(*np.diff(truth.poses[:, :2], axis=0).T) - 1
    assert step.std() == pytest.approx(0.05, rel=0.25)
    lag = 20  # 4 s
    assert np.corrcoef(step[:-lag], step[lag:])[0, 1] == pytest.approx(np.exp(-1), abs=0.2)


def test_a_half_turn_needs_no_arc() -> None:
    """There and back by the same way; numpy's warnings of the package's own numbers are errors."""
    truth = truth_of(drive({"to": [0, 0]}, {"to": [0, -1]}, {"to": [0, 0]}, turn_deg_s=90.0))
    np.testing.assert_allclose(truth.poses[-1, :2], [0, 0], atol=1e-9)
    assert abs(geometry.wrap_angle(truth.poses[-1, 2] - np.pi)) < 1e-9
