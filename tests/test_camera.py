"""The camera against OpenCV's own projection, with tilt, roll, yaw, offset and lens distortion."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from cameras import floor_points
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from localiser import geometry as g
from localiser.camera import DISTORTION_COUNTS, Camera, Mount

LENSES = {
    "none": (),
    "plumb_bob": (-0.25, 0.06, 1e-3, -5e-4, -0.01),
    "rational_polynomial": (0.2, -0.05, 5e-4, 1e-3, 0.01, 0.45, -0.03, 0.005),
    "equidistant": (0.03, -0.01, 0.004, -0.001),
}


def make_camera(lens="none", distortion=None, **mount):
    mount = {"tilt_rad": np.radians(20), "height_m": 1.2, **mount}
    distortion = LENSES[lens] if distortion is None else distortion
    return Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(**mount), lens, tuple(distortion))


# -- the oracle: a full pinhole camera in OpenCV's terms ------------------------------------------------------------


def project_with_opencv(camera, robot_pose, points):
    """Project map points (K, 3) by cv2, from the mount's definition: yaw, then tilt, then roll, about the axes turned.

    Tilting down turns about -x (x right, y up, z backward); rolling the right side down turns about -z.
    """
    mount, (x, z, heading) = camera.mount, robot_pose
    map_from_robot = Rotation.from_rotvec([0, heading, 0])
    position = np.array([x, 0, z]) + map_from_robot.apply([mount.right_m, mount.height_m, mount.back_m])
    robot_from_camera = (
        Rotation.from_rotvec([0, mount.yaw_rad, 0])
        * Rotation.from_rotvec([-mount.tilt_rad, 0, 0])
        * Rotation.from_rotvec([0, 0, -mount.roll_rad])
    )
    optical_from_camera = Rotation.from_rotvec([np.pi, 0, 0])  # OpenCV's axes: right, down, ahead
    optical_from_map = optical_from_camera * (map_from_robot * robot_from_camera).inv()
    # Not cv2.Rodrigues: it loses half the digits for turns of nearly pi, which a level camera makes.
    rvec, tvec = optical_from_map.as_rotvec(), -optical_from_map.apply(position)
    points = np.asarray(points, dtype=np.float64).reshape(-1, 1, 3)
    distortion = np.array(camera.distortion)
    if camera.distortion_model == "equidistant":
        pixels, _ = cv2.fisheye.projectPoints(points, rvec, tvec, camera.matrix, distortion)
    else:
        pixels, _ = cv2.projectPoints(points, rvec, tvec, camera.matrix, distortion)
    return pixels.reshape(-1, 2)


def seen_from(camera, robot_pose, bearing, range_m):
    """Return the floor point (x, z) in the map at a bearing and distance from the camera, by the conventions."""
    heading = robot_pose[2]
    at = robot_pose[:2] + camera.mount.right_m * g.right(heading) - camera.mount.back_m * g.forward(heading)
    looking = heading + camera.mount.yaw_rad
    return at + range_m * (np.sin(bearing) * g.right(looking) + np.cos(bearing) * g.forward(looking))


# Strong, yet one to one over the radius of 0.8 that these edges reach (37° off the axis): the distorted radius grows
# there with a derivative of at least 0.28, at every corner of these bounds.
SMALL = st.floats(-2e-3, 2e-3)
PLUMB_BOB = st.tuples(st.floats(-0.3, 0.3), st.floats(-0.05, 0.1), SMALL, SMALL, st.floats(-0.02, 0.02))
RATIONAL = st.tuples(
    *(st.floats(-0.2, 0.2), st.floats(-0.05, 0.05), SMALL, SMALL, st.floats(-0.02, 0.02)),
    *(st.floats(-0.1, 0.1), st.floats(-0.03, 0.03), st.floats(-0.01, 0.01)),
)
EQUIDISTANT = st.tuples(st.floats(-0.05, 0.05), st.floats(-0.03, 0.03), st.floats(-0.01, 0.01), st.floats(-5e-3, 5e-3))
BOUNDED = {"none": st.just(()), "plumb_bob": PLUMB_BOB, "rational_polynomial": RATIONAL, "equidistant": EQUIDISTANT}

poses = st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-np.pi, np.pi)).map(np.array)
DOWNWARD = st.floats(np.radians(2), np.radians(60))
some_degrees = st.floats(np.radians(-10), np.radians(10))


@st.composite
def cameras(draw, lens, tilts=DOWNWARD):
    mount = {
        "tilt_rad": draw(tilts),
        "roll_rad": draw(some_degrees),
        "yaw_rad": draw(st.floats(-np.pi, np.pi)),
        "height_m": draw(st.floats(0.2, 2)),
        "right_m": draw(st.floats(-0.5, 0.5)),
        "back_m": draw(st.floats(-0.5, 0.5)),
    }
    return make_camera(lens, draw(BOUNDED[lens]), **mount)


@st.composite
def edges(draw, camera, robot_pose):
    """Draw a vertical edge: its bearing, and its bottom and top (2, 3) in the map, at least 4° apart in elevation."""
    bearing = draw(st.floats(np.radians(-22), np.radians(22)))
    range_m = draw(st.floats(0.5, 10))
    bottom = draw(st.floats(np.radians(-15), np.radians(11)))
    top = draw(st.floats(np.radians(4), np.radians(15 - np.degrees(bottom)))) + bottom
    x, z = seen_from(camera, robot_pose, bearing, range_m)
    # Up or down from the optical axis, as seen straight ahead.
    heights = camera.mount.height_m + range_m * np.cos(bearing) * np.tan(
        np.array([bottom, top]) - camera.mount.tilt_rad
    )
    return bearing, np.array([[x, y, z] for y in heights])


# -- a vertical edge through the whole camera -------------------------------------------------------------------------


@pytest.mark.parametrize("lens", LENSES)
@given(data=st.data(), robot_pose=poses)
def test_lean_and_bearing_come_back_from_the_pixels_of_an_edge(lens, data, robot_pose):
    camera = data.draw(cameras(lens))
    bearing, ends = data.draw(edges(camera, robot_pose))
    pixels = project_with_opencv(camera, robot_pose, ends)
    lean = np.arctan(np.sin(camera.mount.tilt_rad) * np.tan(bearing))
    # Pixels of 1e3 hold 1e-13; a lens whose derivative is 0.28 and a segment of 40 px leave some 1e-14 · 1e3 / 40.
    assert camera.lean_of_segments(pixels[None])[0] == pytest.approx(lean, abs=1e-9)
    assert camera.bearing_of_segments(pixels[None])[0] == pytest.approx(bearing, abs=1e-9)


@pytest.mark.parametrize("lens", LENSES)
@given(data=st.data(), robot_pose=poses, depression=st.floats(np.radians(3), np.radians(74)))
def test_floor_point_comes_back_from_the_pixel_of_a_foot(lens, data, robot_pose, depression):
    from_axis = data.draw(st.floats(-15, 15).map(np.radians))
    tilt = min(max(depression + from_axis, np.radians(2)), np.radians(60))
    camera = data.draw(cameras(lens, tilts=st.just(tilt)))
    bearing = data.draw(st.floats(np.radians(-22), np.radians(22)))
    range_m = camera.mount.height_m / np.tan(depression) / np.cos(bearing)
    foot = seen_from(camera, robot_pose, bearing, range_m)
    pixel = project_with_opencv(camera, robot_pose, [[foot[0], 0.0, foot[1]]])[0]
    in_level = floor_points(camera, pixel)
    # Up to 40 m away, and (r² + h²)/h = 4 km per radian at 3° of depression and 2 m: 1e-12 rad stays below 1e-8 m.
    sensitivity = (range_m**2 + camera.mount.height_m**2) / camera.mount.height_m
    np.testing.assert_allclose(
        g.map_from_robot(camera.pose_in_map(robot_pose), in_level), foot, atol=1e-9 + 1e-12 * sensitivity
    )
    assert np.hypot(*in_level) == pytest.approx(range_m, rel=1e-9)


@pytest.mark.parametrize("lens", LENSES)
@given(data=st.data(), robot_pose=poses)
def test_projection_is_that_of_opencv(lens, data, robot_pose):
    camera = data.draw(cameras(lens, tilts=st.floats(np.radians(-60), np.radians(70))))
    _, ends = data.draw(edges(camera, robot_pose))
    pixels = project_with_opencv(camera, robot_pose, ends)
    np.testing.assert_allclose(camera.project(robot_pose, ends), pixels, atol=1e-8)
    rays = camera.level_rays(pixels)
    np.testing.assert_allclose(camera.project_level(rays * [[0.7], [3.0]]), pixels, atol=1e-8)


def upright_edge(camera, bearing, e):
    """Return points (..., 2) of the edge at this bearing at upright image heights (...)."""
    tilt = camera.mount.tilt_rad
    return np.stack([np.tan(bearing) * (np.cos(tilt) + e * np.sin(tilt)), e], axis=-1)


@given(data=st.data(), e=st.lists(st.floats(-0.4, 0.4), min_size=2, max_size=5), bearing=st.floats(-0.4, 0.4))
def test_undoing_tilt_and_roll_makes_a_column_of_every_edge(data, e, bearing):
    # Design equation 3: the rotation alone does it, whatever the depth of each point.
    camera = data.draw(cameras("plumb_bob"))
    upright = upright_edge(camera, bearing, np.array(e))
    x, _, z = camera.level_rays(camera.pixels_from_upright(upright)).T
    np.testing.assert_allclose(x / -z, np.tan(bearing), atol=1e-12)


# -- lenses -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "count"), [(model, n) for model, counts in DISTORTION_COUNTS.items() for n in counts]
)
def test_every_lens_model_is_undone(model, count):
    # In ROS' order: k1 k2 p1 p2 k3 k4 k5 k6, four of a thin prism, two of a tilted sensor; k1 to k4 when equidistant.
    values = (-0.2, 0.05, 1e-3, -2e-3, 0.01, 0.05, -0.02, 0.005, 1e-3, -1e-3, 5e-4, 1e-3, 0.01, -0.02)
    camera = make_camera(model, values[:count])
    u, v = np.meshgrid(np.linspace(0, 639, 9), np.linspace(0, 479, 7))
    pixels = np.stack([u, v], axis=-1)
    image = camera.image_from_pixels(pixels)
    np.testing.assert_allclose(camera.pixels_from_image(image), pixels, atol=1e-9)
    straight = camera.ideal.image_from_pixels(pixels)
    bends = np.abs(image - straight).max()
    assert bends > 1e-3 if camera.is_distorted else bends == 0


def test_points_far_outside_do_not_fold_back_into_the_image():
    camera = make_camera("plumb_bob", (-0.25, 0, 0, 0, 0), tilt_rad=0.0)
    # r (1 - r²/4) grows up to r = √(4/3), which is 49° off the axis.
    assert camera.lens_radius == pytest.approx(np.sqrt(4 / 3), abs=0.01)
    at_45, at_55, at_63 = ([np.tan(angle), 0.0, -1.0] for angle in np.radians([45, 55, 63]))
    assert np.isfinite(camera.project_level(at_45)).all()
    assert np.isnan(camera.project_level([at_55, at_63])).all()
    assert 0 < camera.pixels_from_image([at_63[0], 0.0])[0] < camera.width  # what the bare polynomial says


@pytest.mark.parametrize("lens", ["none", "equidistant"])
def test_lenses_that_never_fold_see_far_to_the_side(lens):
    camera = make_camera(lens, (0.03, 0, 0, 0) if lens == "equidistant" else ())
    assert camera.lens_radius == np.inf


@pytest.mark.parametrize("shape", [(2,), (5, 2), (3, 2, 2), (0, 2), (0, 2, 2)])
@pytest.mark.parametrize("lens", LENSES)
def test_points_keep_their_shape(lens, shape):
    camera = make_camera(lens)
    pixels = np.random.default_rng(0).uniform(50, 400, shape)
    assert camera.image_from_pixels(pixels).shape == camera.pixels_from_image(pixels / 1000).shape == shape
    assert camera.level_rays(pixels).shape == (*shape[:-1], 3)


# -- what cannot be seen ----------------------------------------------------------------------------------------------


def test_points_behind_the_image_plane_have_no_pixel():
    camera = make_camera(tilt_rad=0.0)
    pixels = camera.project_level([[0, 0, 1.0], [0.3, 0, 0.0], [0, 0, 0], [0.1, 0, -1]])
    assert np.isnan(pixels).all(axis=-1).tolist() == [True, True, True, False]


def test_tilted_camera_sees_a_foot_below_it_but_not_overhead():
    # At 60° of tilt the point straight below is 30° off the axis; the one straight above is behind the image plane.
    camera = make_camera(tilt_rad=np.radians(60))
    below, above = camera.project_level([[0, -1.0, 0], [0, 1.0, 0]])
    np.testing.assert_allclose(below, [camera.cx, camera.cy + 554.0 / np.tan(np.radians(60))])
    assert np.isnan(above).all()


# -- the nadir point --------------------------------------------------------------------------------------------------


def test_nadir_point_is_1522_px_below_the_centre():
    nadir = make_camera().project_level([0.0, -1.0, 0.0])
    assert nadir[0] == 319.5
    assert round(nadir[1] - 239.5) == 1522


def test_without_tilt_bearing_is_still_known_from_the_column():
    camera = make_camera(tilt_rad=0.0)
    segment = np.array([[[camera.cx + 100, 400.0], [camera.cx + 100, 100.0]]])
    assert camera.lean_of_segments(segment)[0] == 0
    assert camera.bearing_of_segments(segment)[0] == pytest.approx(np.arctan(100 / 554))


# -- sigmas and Jacobians ---------------------------------------------------------------------------------------------


def edge_segment(camera, bearing, length_px, middle_e=0.0):
    """Return the pixels (1, 2, 2) of a segment of the edge at this bearing, around an upright image height."""
    lean = g.lean_from_bearing(bearing, camera.mount.tilt_rad)
    e = middle_e + np.array([-0.5, 0.5]) * length_px / camera.focal_px * np.cos(lean)
    return camera.pixels_from_upright(upright_edge(camera, bearing, e))[None]


@pytest.mark.parametrize(("bearing_deg", "sigma_deg"), [(0, 0.0388), (28, 0.0308)])
def test_bearing_sigma_of_the_design_table(bearing_deg, sigma_deg):
    camera = make_camera()
    segment = edge_segment(camera, np.radians(bearing_deg), 200)
    sigma = np.degrees(camera.bearings_of_segments(segment, np.array([0.5]))[1])
    assert sigma[0] == pytest.approx(sigma_deg, abs=5e-5)


@given(
    bearing=st.floats(-0.5, 0.5),
    tilt=st.floats(np.radians(5), np.radians(50)),
    roll=some_degrees,
    length_px=st.floats(20, 300),
)
def test_bearing_sigma_is_that_of_the_held_line(bearing, tilt, roll, length_px):
    camera = make_camera(tilt_rad=tilt, roll_rad=roll)
    segment = edge_segment(camera, bearing, length_px, middle_e=0.1)
    distance = np.linalg.norm(segment[0].mean(axis=0) - camera.project_level([0.0, -1.0, 0.0]))
    expected = g.bearing_per_lean(bearing, tilt) * 0.5 / np.sqrt(2 * distance**2 + length_px**2 / 2)
    assert camera.bearings_of_segments(segment, np.array([0.5]))[1][0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("tilt_deg", [0, 5, 20, 45])
@pytest.mark.parametrize("bearing_deg", [0, -25])
def test_sigmas_match_segments_with_noisy_ends(tilt_deg, bearing_deg):
    rng, count, sigma, length = np.random.default_rng(tilt_deg), 20_000, 0.5, 120
    camera = make_camera(tilt_rad=np.radians(tilt_deg), roll_rad=0.02)
    bearing = np.radians(bearing_deg)
    segment = edge_segment(camera, bearing, length)
    noisy = segment + sigma * rng.standard_normal((count, 2, 2))  # along the line it does not matter
    bearings, leans = camera.bearing_of_segments(noisy), camera.lean_of_segments(noisy)
    # A standard deviation of n samples errs by 1/√(2n) = 0.5 %, 4 sigma; a mean by sigma/√n.
    expected = camera.bearings_of_segments(segment, np.array([sigma]))[1][0]
    assert bearings.std() == pytest.approx(expected, rel=0.02)
    assert bearings.mean() == pytest.approx(bearing, abs=4 * expected / np.sqrt(count))
    assert leans.std() == pytest.approx(np.sqrt(2) * sigma / length, rel=0.02)


def central_difference(function, camera, name, step=1e-5):
    value = getattr(camera.mount, name)
    return (
        function(camera.with_mount(**{name: value + step})) - function(camera.with_mount(**{name: value - step}))
    ) / (2 * step)


@given(
    bearing=st.floats(-0.6, 0.6),
    middle_e=st.floats(-0.4, 0.4),
    tilt=st.floats(np.radians(5), np.radians(50)),
    roll=some_degrees,
)
def test_jacobians_of_a_bearing_match_finite_differences(bearing, middle_e, tilt, roll):
    camera = make_camera(tilt_rad=tilt, roll_rad=roll)
    segment = edge_segment(camera, bearing, 1.0, middle_e)  # short: the Jacobian is taken at the middle

    def from_lean(turned):
        return g.bearing_from_lean(turned.lean_of_segments(segment), turned.mount.tilt_rad)[0]

    def from_line(turned):
        return turned.bearing_of_segments(segment)[0]

    by_lean, by_line = camera.bearing_jacobians(np.array([bearing]), np.array([middle_e]))
    for column, name in enumerate(["tilt_rad", "roll_rad"]):
        # Differences of a 1 px segment's lean carry rounding of 1e-13 / 1e-5; its ends are 1e-3 apart, squared.
        assert by_lean[0, column] == pytest.approx(central_difference(from_lean, camera, name), abs=1e-5)
        assert by_line[0, column] == pytest.approx(central_difference(from_line, camera, name), abs=1e-5)


def test_jacobian_at_the_middle_serves_a_long_segment():
    camera = make_camera()
    segment = edge_segment(camera, 0.4, 200, middle_e=-0.1)
    _, by_line = camera.bearing_jacobians(np.array([0.4]), np.array([-0.1]))
    for column, name in enumerate(["tilt_rad", "roll_rad"]):
        exact = central_difference(lambda turned: turned.bearing_of_segments(segment)[0], camera, name)
        # Rad per rad, of order L/f · e squared; a mount that errs by 0.3° moves the bearing by 0.006° more or less.
        assert by_line[0, column] == pytest.approx(exact, abs=0.02)


def test_without_tilt_the_line_still_has_a_jacobian_and_lean_has_none():
    by_lean, by_line = make_camera(tilt_rad=0.0).bearing_jacobians(np.array([0.2]), np.array([0.1]))
    assert np.isnan(by_lean).all()
    # tan b = a / (c + e s): at s = 0 tilt moves it by -a e and roll by e, times cos²b.
    np.testing.assert_allclose(by_line, [np.cos(0.2) ** 2 * np.array([-np.tan(0.2) * 0.1, 0.1])])


# -- the image's extent and copies ------------------------------------------------------------------------------------


def assert_bounds_are_inside(camera, least):
    a_left, a_right, e_bottom, e_top = camera.upright_bounds
    assert min(-a_left, a_right, -e_bottom, e_top) > least
    a, e = np.meshgrid(np.linspace(a_left, a_right, 33), np.linspace(e_bottom, e_top, 33))
    pixels = camera.pixels_from_upright(np.stack([a, e], axis=-1))
    # The border is sampled every 10 px; between two samples a strong lens bends it by less than 0.1 px.
    assert (pixels > -0.1).all()
    assert (pixels < np.array([camera.width - 0.9, camera.height - 0.9])).all()


@pytest.mark.parametrize("lens", LENSES)
@given(data=st.data())
def test_upright_bounds_lie_inside_the_image(lens, data):
    assert_bounds_are_inside(data.draw(cameras(lens)), 0.0)


def test_upright_bounds_of_an_ideal_camera_are_the_image():
    camera = make_camera()
    expected = np.array([-319.5, 319.5, -239.5, 239.5]) / 554
    np.testing.assert_allclose(camera.upright_bounds, expected)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("roll_deg", [-170, -90, 20, 37, 45, 50, 60, 90, 135, 180, 270])
def test_upright_bounds_lie_inside_the_image_at_any_roll(lens, roll_deg):
    assert_bounds_are_inside(make_camera(lens, roll_rad=np.radians(roll_deg)), 0.2)  # 111 px of the 240 to each side


def test_upright_bounds_turn_with_the_camera():
    left, right, bottom, top = replace(make_camera(), cx=300.0, cy=250.0).upright_bounds
    expected = {
        90: (bottom, top, -right, -left),
        180: (-right, -left, -top, -bottom),
        -90: (-top, -bottom, left, right),
    }
    for roll_deg, bounds in expected.items():
        turned = replace(make_camera(roll_rad=np.radians(roll_deg)), cx=300.0, cy=250.0)
        np.testing.assert_allclose(turned.upright_bounds, bounds)


def test_changing_the_mount_or_the_lens_leaves_the_rest():
    camera = make_camera("plumb_bob", yaw_rad=0.1)
    assert camera.level_from_camera.shape == (3, 3)  # cached values must not be carried over
    tilted = camera.with_mount(tilt_rad=0.5, roll_rad=0.1)
    assert (tilted.mount.tilt_rad, tilted.mount.roll_rad, tilted.mount.yaw_rad) == (0.5, 0.1, 0.1)
    assert tilted.distortion == camera.distortion
    assert not np.allclose(tilted.level_from_camera, camera.level_from_camera)
    assert camera.ideal.mount == camera.mount
    assert not camera.ideal.is_distorted


def test_camera_pose_in_the_map():
    # 15 cm ahead, 5 cm to the right, turned left; the robot at (1, 2) faces map -x.
    camera = make_camera(right_m=0.05, back_m=-0.15, yaw_rad=0.1)
    np.testing.assert_allclose(camera.pose_in_map([1, 2, np.pi / 2]), [0.85, 1.95, np.pi / 2 + 0.1])
