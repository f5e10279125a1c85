"""Vertical edges of drawn images: what is found, where, how certain, and what is not an edge; their feet; exposure."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from edge_images import camera_of, wall_image
from folders import ROOT

from localiser.camera import Camera
from localiser.config import read_config
from localiser.edges import (
    DARK_GREY,
    DETECTORS,
    WASHED_OUT,
    EdgeParameters,
    Edges,
    Segments,
    columns,
    find,
    find_edges,
    light_of,
    lines,
    mount,
    register,
)
from localiser.edges.measure import BORDER_PX, foot_of_edges
from localiser.errors import InputError
from localiser.geometry.compiled import compiled

BEARINGS_DEG = [-20.0, -8.0, 3.0, 14.0, 22.0]
GREYS = [60.0, 120.0, 70.0, 150.0, 110.0, 180.0]
CAMERAS = {
    "tilted": camera_of(),
    "rolled": camera_of(roll_deg=3.0),
    "distorted": camera_of(roll_deg=1.0, k1=-0.25),
    "level": camera_of(tilt_deg=0.0),
    "looking up": camera_of(tilt_deg=-12.0, roll_deg=-2.0),
    "upside down": camera_of(roll_deg=180.0),
    "portrait": camera_of(480, 640, roll_deg=90.0, focal_px=554.0),
    "portrait the other way": camera_of(480, 640, roll_deg=-90.0, focal_px=554.0),
}
TOLERANCE_DEG = {"columns": 0.01, "lsd": 0.03, "hough": 0.12}


def sorted_by_bearing(edges: Edges) -> Edges:
    return edges.take(np.argsort(edges.bearing))


WITH_EXACT_ENDS = sorted(set(DETECTORS) - {"hough"})
"""Hough's segments end where the count of votes ends, often many pixels before the edge does."""


@pytest.fixture(params=sorted(DETECTORS))
def detector(request) -> str:
    return request.param


@pytest.mark.parametrize("name", CAMERAS)
def test_all_edges_of_a_wall_are_found_at_their_bearing(detector, name):
    camera = CAMERAS[name]
    image = wall_image(camera, BEARINGS_DEG, GREYS, noise_sigma=1.0)
    edges = sorted_by_bearing(find_edges(image, camera, EdgeParameters(detector=detector)))
    assert len(edges) == len(BEARINGS_DEG)
    np.testing.assert_allclose(np.rad2deg(edges.bearing), BEARINGS_DEG, atol=TOLERANCE_DEG[detector])
    np.testing.assert_array_equal(edges.polarity, np.sign(np.diff(GREYS)))
    assert np.all(np.abs(edges.bearing - np.deg2rad(BEARINGS_DEG)) < 4 * edges.bearing_sigma)
    expected_lean = np.arctan(np.sin(camera.mount.tilt_rad) * np.tan(np.deg2rad(BEARINGS_DEG)))
    assert np.all(np.abs(edges.lean - expected_lean) < 4 * edges.lean_sigma)


def test_ends_are_in_the_pixels_of_the_image_as_it_was_taken(detector):
    camera = CAMERAS["distorted"]
    edges = find_edges(wall_image(camera, BEARINGS_DEG, GREYS), camera, EdgeParameters(detector=detector))
    ends = camera.upright_from_pixels(edges.ends_px)
    tilt = camera.mount.tilt_rad
    tangent = ends[..., 0] / (np.cos(tilt) + ends[..., 1] * np.sin(tilt))
    np.testing.assert_allclose(np.arctan(tangent), np.stack([edges.bearing] * 2, axis=-1), atol=np.deg2rad(0.2))
    assert np.all(edges.ends_px[:, 0, 1] > edges.ends_px[:, 1, 1])
    assert np.all(edges.length_px > 0.8 * camera.height)


@pytest.mark.parametrize("name", ["rolled", "distorted"])
def test_half_the_resolution_finds_the_same_edges_less_certainly(name):
    camera = CAMERAS[name]
    image = wall_image(camera, BEARINGS_DEG, GREYS, noise_sigma=1.0)
    whole = sorted_by_bearing(find_edges(image, camera))
    half = sorted_by_bearing(find_edges(image, camera, EdgeParameters(half_resolution=True)))
    assert len(half) == len(BEARINGS_DEG)
    np.testing.assert_allclose(np.rad2deg(half.bearing), BEARINGS_DEG, atol=2 * TOLERANCE_DEG["columns"])
    assert np.all(np.abs(half.bearing - np.deg2rad(BEARINGS_DEG)) < 4 * half.bearing_sigma)
    assert np.all(half.bearing_sigma > whole.bearing_sigma)
    group_px = 16.0  # an edge ends where a group of eight rows of the smaller image does
    np.testing.assert_allclose(half.ends_px[..., 1], whole.ends_px[..., 1], atol=group_px)
    np.testing.assert_allclose(half.length_px, whole.length_px, atol=2 * group_px)
    assert half.mount == whole.mount


def test_half_the_resolution_leaves_out_an_odd_row_and_column():
    camera = replace(CAMERAS["tilted"], width=639, height=479)
    image = wall_image(CAMERAS["tilted"], BEARINGS_DEG, GREYS)[:479, :639]
    edges = sorted_by_bearing(find_edges(image, camera, EdgeParameters(half_resolution=True)))
    np.testing.assert_allclose(np.rad2deg(edges.bearing), BEARINGS_DEG, atol=2 * TOLERANCE_DEG["columns"])
    assert not len(find_edges(np.zeros((3, 9), np.uint8), camera_of(9, 3), EdgeParameters(half_resolution=True)))


@pytest.mark.parametrize("shape", [(480, 640), (480, 640, 3), (144, 176), (144, 176, 3)])
def test_a_uniform_image_has_no_edges(detector, shape):
    camera = camera_of(shape[1], shape[0], k1=-0.25)
    edges = find_edges(np.full(shape, 128, dtype=np.uint8), camera, EdgeParameters(detector=detector))
    assert len(edges) == 0
    assert edges.ends_px.shape == (0, 2, 2)
    assert edges.common.bearing_from_line.shape[0] == 0


@pytest.mark.parametrize("k1", [-0.35, 0.2])
def test_the_border_that_undistortion_leaves_is_no_edge(detector, k1):
    camera = camera_of(tilt_deg=0.0, k1=k1)
    image = np.random.default_rng(1).normal(230, 3, (480, 640)).clip(0, 255).astype(np.uint8)
    assert len(find_edges(image, camera, EdgeParameters(detector=detector))) == 0


def test_an_image_as_small_as_the_papers(detector):
    camera = camera_of(176, 144)
    image = wall_image(camera, [-10.0, 12.0], [60.0, 160.0, 90.0], noise_sigma=2.0)
    edges = sorted_by_bearing(find_edges(image, camera, EdgeParameters(detector=detector)))
    np.testing.assert_allclose(np.rad2deg(edges.bearing), [-10.0, 12.0], atol=0.3)


def test_colour_and_grey_give_the_same_edges(detector):
    camera = CAMERAS["tilted"]
    grey = wall_image(camera, BEARINGS_DEG, GREYS)
    parameters = EdgeParameters(detector=detector)
    from_grey = find_edges(grey, camera, parameters)
    from_colour = find_edges(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), camera, parameters)
    np.testing.assert_array_equal(from_grey.ends_px, from_colour.ends_px)


def test_pieces_of_a_hidden_edge_are_one_edge(detector):
    camera = CAMERAS["tilted"]
    image = wall_image(camera, [5.0], [70.0, 150.0])
    image[200:260] = 110
    edges = find_edges(image, camera, EdgeParameters(detector=detector))
    assert len(edges) == 1
    assert 0.75 * camera.height < edges.length_px[0] < 0.9 * camera.height


def test_two_sides_of_a_thin_post_stay_two_edges(detector):
    camera = CAMERAS["tilted"]
    image = wall_image(camera, [5.0, 5.6], [70.0, 150.0, 70.0])
    edges = sorted_by_bearing(find_edges(image, camera, EdgeParameters(detector=detector)))
    np.testing.assert_array_equal(edges.polarity, [1, -1])
    np.testing.assert_allclose(np.rad2deg(edges.bearing), [5.0, 5.6], atol=0.1)


def test_a_line_that_misses_the_nadir_point_is_rejected(detector):
    image = np.full((480, 640), 80, dtype=np.uint8)
    image[:, 480:] = 160  # an edge for a level camera; under tilt the edge there would lean by 6 degrees
    assert len(find_edges(image, CAMERAS["level"], EdgeParameters(detector=detector))) == 1
    edges = find_edges(image, CAMERAS["tilted"], EdgeParameters(detector=detector))
    assert len(edges) == 0 and len(edges.rejected_px) > 0


@pytest.mark.parametrize("detector", WITH_EXACT_ENDS)
def test_the_foot_tells_the_range_of_a_wall(detector):
    camera = camera_of(roll_deg=1.0, k1=-0.1)
    image = wall_image(camera, [-8.0, 10.0], [60.0, 150.0, 60.0], wall_ahead_m=2.5, floor_grey=220.0)
    edges = sorted_by_bearing(find_edges(image, camera, EdgeParameters(detector=detector)))
    expected = 2.5 / np.cos(np.deg2rad([-8.0, 10.0]))
    np.testing.assert_allclose(edges.foot_range_m, expected, rtol=0.03)
    assert np.all(np.abs(edges.foot_range_m - expected) < 4 * edges.foot_range_sigma_m)


@pytest.mark.parametrize("detector", WITH_EXACT_ENDS)
def test_an_edge_that_goes_on_below_the_image_has_no_foot(detector):
    camera = CAMERAS["tilted"]
    edges = find_edges(wall_image(camera, [5.0], [70.0, 150.0]), camera, EdgeParameters(detector=detector))
    assert np.isnan(edges.foot_range_m).all()


def test_the_common_error_moves_bearings_as_a_wrong_tilt_does(detector):
    camera = CAMERAS["tilted"]
    image = wall_image(camera, BEARINGS_DEG, GREYS, wall_ahead_m=4.0)
    parameters = EdgeParameters(detector=detector)
    wrong_rad = np.deg2rad(0.2)
    edges = sorted_by_bearing(find_edges(image, camera, parameters))
    shifted = sorted_by_bearing(
        find_edges(image, camera.with_mount(tilt_rad=camera.mount.tilt_rad + wrong_rad), parameters)
    )
    assert len(edges) == len(shifted) == len(BEARINGS_DEG)
    predicted = edges.common.bearing_from_line[:, 0] * wrong_rad
    np.testing.assert_allclose(shifted.bearing - edges.bearing, predicted, atol=np.deg2rad(0.01))
    assert edges.common.names == ("tilt", "roll")
    np.testing.assert_allclose(edges.common.cov, np.diag(np.deg2rad([0.5, 0.3]) ** 2))


def test_beside_clipped_white_place_and_lean_are_less_certain():
    camera = CAMERAS["tilted"]
    grey, white = (
        find_edges(wall_image(camera, [3.0], [right - 130.0, right], noise_sigma=1.0), camera, EdgeParameters())
        for right in (200.0, 255.0)
    )
    assert len(grey) == len(white) == 1
    assert white.bearing_sigma > 3 * grey.bearing_sigma
    assert white.lean_sigma > 3 * grey.lean_sigma


def test_after_warming_up_nothing_is_left_to_compile():
    camera = CAMERAS["distorted"]
    find_edges(np.zeros((camera.height, camera.width), dtype=np.uint8), camera, EdgeParameters())
    modules = (columns, lines, mount, find)
    all_loops = [
        compiled(getattr(module, name)) for module in modules for name in dir(module) if name.endswith("_loop")
    ]
    signatures = [len(loop.signatures) for loop in all_loops]
    image = wall_image(camera, BEARINGS_DEG, GREYS, noise_sigma=3.0)
    image.flags.writeable = False
    assert len(find_edges(image, camera, EdgeParameters())) > 0
    assert min(signatures) > 0
    assert [len(loop.signatures) for loop in all_loops] == signatures


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((480, 640), dtype=np.float32), "expected 8-bit grey or BGR, found float32"),
        (np.zeros((480, 640, 4), dtype=np.uint8), "expected 8-bit grey or BGR, found uint8"),
        (np.zeros((240, 320), dtype=np.uint8), "expected 640×480 as the camera says, found 320×240"),
    ],
)
def test_an_image_of_another_kind_is_an_input_error(image, message):
    with pytest.raises(InputError, match=message):
        find_edges(image, CAMERAS["tilted"], EdgeParameters())


# -- a detector of one's own ------------------------------------------------------------------------------------------


def jumps(image: np.ndarray, camera: Camera) -> np.ndarray:
    """Return lines (S, 4) between two rows, from where grey values change most in one to the same in the other."""
    rows = (100, camera.height - 100)
    steps = (np.abs(np.diff(image[row].astype(float))) for row in rows)
    ends = [np.flatnonzero((step > 10) & (step > np.roll(step, 1)) & (step >= np.roll(step, -1))) for step in steps]
    return np.array([[top + 0.5, rows[0], bottom + 0.5, rows[1]] for top, bottom in zip(*ends, strict=True)])


class Stated:
    """A detector that states how its segments err."""

    def __init__(self, sigma_px: float) -> None:
        self.sigma_px = sigma_px

    def __call__(self, image: np.ndarray, camera: Camera) -> Segments:
        return Segments.of_ends(jumps(image, camera).reshape(-1, 2, 2), self.sigma_px)


def test_a_function_of_ones_own_finds_the_segments():
    camera = CAMERAS["tilted"]
    edges = sorted_by_bearing(find_edges(wall_image(camera, BEARINGS_DEG, GREYS), camera, detector=jumps))
    np.testing.assert_allclose(np.rad2deg(edges.bearing), BEARINGS_DEG, atol=0.15)
    np.testing.assert_array_equal(edges.polarity, np.sign(np.diff(GREYS)))
    coarse, fine = (
        find_edges(wall_image(camera, BEARINGS_DEG, GREYS), camera, detector=Stated(sigma_px))
        for sigma_px in (2.0, 0.5)
    )
    np.testing.assert_allclose(coarse.lean_sigma, 4 * fine.lean_sigma)
    np.testing.assert_allclose(np.sort(fine.lean_sigma), np.sort(edges.lean_sigma))


def test_lines_of_a_bent_image_are_straightened():
    camera = CAMERAS["distorted"]
    ends = camera.pixels_from_upright([[0.1, -0.2], [0.1, 0.2]])
    level = camera.with_mount(tilt_rad=0.0)
    edges = find_edges(
        wall_image(level, [5.0], [60.0, 120.0]), level, detector=lambda image, camera: [[*ends[0], *ends[1]]]
    )
    np.testing.assert_allclose(edges.bearing, np.arctan(0.1), atol=1e-3)


def test_a_registered_detector_is_found_by_its_name():
    camera = CAMERAS["tilted"]
    image = wall_image(camera, BEARINGS_DEG, GREYS)
    with pytest.raises(InputError, match="expected 'columns', 'lsd' or 'hough', found 'jumps'"):
        read_config(None, ["edges.detector=jumps"])
    with pytest.raises(ValueError, match="'lsd', which is taken"):
        register("lsd", jumps)
    register("jumps", jumps)
    try:
        parameters = read_config(None, ["edges.detector=jumps"]).edges
        found = find_edges(image, camera, parameters)
    finally:
        del DETECTORS["jumps"]
    np.testing.assert_array_equal(found.bearing, find_edges(image, camera, detector=jumps).bearing)


@pytest.mark.parametrize("lines", [np.zeros((3, 2)), np.zeros(4), np.zeros((1, 2, 2))])
def test_lines_of_another_shape_are_an_input_error(lines):
    with pytest.raises(InputError, match=r"expected lines \(S, 4\)"):
        find_edges(np.zeros((480, 640), np.uint8), CAMERAS["tilted"], detector=lambda image, camera: lines)


def test_a_detector_of_no_known_name_is_refused():
    with pytest.raises(InputError, match=r"^detector: expected 'columns', .* or 'hough', found 'nope'"):
        find_edges(np.zeros((480, 640), dtype=np.uint8), camera_of(), EdgeParameters(detector="nope"))


def test_an_edge_that_may_be_cut_off_by_the_border_has_no_foot() -> None:
    camera = CAMERAS["tilted"]
    last = camera.height - 1
    bottom = np.array([[300.0, last - BORDER_PX + 1.0], [300.0, last - BORDER_PX - 1.0], [BORDER_PX - 1.0, 300.0]])
    range_m, _ = foot_of_edges(bottom, camera)
    np.testing.assert_array_equal(np.isnan(range_m), [True, False, True])


def test_an_edge_that_ends_above_the_horizon_has_no_foot() -> None:
    camera = camera_of(tilt_deg=5.0)
    image = wall_image(camera, [5.0], [70.0, 150.0])
    image[150:] = 110
    assert camera.level_rays(np.array([330.0, 150.0]))[1] > 0
    edges = find_edges(image, camera)
    assert len(edges) == 1
    assert np.isnan(edges.foot_range_m[0])


IMAGES = sorted((ROOT / "logs" / "corridor" / "images").iterdir())[::20]


@pytest.mark.parametrize(("gain", "verdict"), [(0.25, "dark"), (0.6, ""), (1.0, ""), (1.2, ""), (2.5, "washed out")])
def test_images_of_the_corridor_in_other_light(gain, verdict):
    found = set()
    for path in IMAGES:
        image = np.clip(gain * cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), 0, 255).astype(np.uint8)
        light = light_of(image)
        found.add("dark" if light.bright_grey < DARK_GREY else "washed out" if light.saturated > WASHED_OUT else "")
    assert found == {verdict}


def test_colour_counts_as_grey_does():
    grey = np.full((48, 64), 20, dtype=np.uint8)
    assert light_of(np.dstack([grey] * 3)) == light_of(grey)
    assert light_of(grey).bright_grey == 20 and light_of(grey).saturated == 0
