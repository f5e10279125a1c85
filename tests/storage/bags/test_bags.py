"""ROS bags of all three kinds: what goes in comes out, what other programs recorded is understood."""

import resource
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import QosDurability
from rosbags.typesys import get_types_from_msg
from small_bag import HEIGHT, KINDS, NAMES, OPTICAL, WIDTH, Recorder, bag, recording
from small_log import write_edge_log, write_small_log

from localiser.camera import Camera, RollingShutter
from localiser.errors import InputError, InputWarning, OutputError
from localiser.storage import ImageEvent, Log, open_log, write_bag
from localiser.storage.maps import map_data


def images(log: Log) -> list[tuple[int, bytes]]:
    return [(frame.t_ns, frame.encoded()) for frame in log.frames if isinstance(frame, ImageEvent)]


def assert_same(found: Log, wanted: Log, tolerance: float = 1e-9) -> None:
    """Assert that two logs hold the same, images byte by byte."""
    assert found.name == wanted.name
    assert found.camera.mount == wanted.camera.mount
    for name in ("width", "height", "fx", "fy", "cx", "cy", "distortion_model", "distortion", "name"):
        assert getattr(found.camera, name) == getattr(wanted.camera, name), name
    for mine, theirs in ((found.odometry, wanted.odometry), (found.groundtruth, wanted.groundtruth)):
        np.testing.assert_array_equal(mine.t_ns, theirs.t_ns)
        np.testing.assert_allclose(mine.poses, theirs.poses, rtol=0, atol=tolerance)
    assert images(found) == images(wanted)
    assert found.landmark_map is not None and wanted.landmark_map is not None
    assert map_data(found.landmark_map) == map_data(wanted.landmark_map)
    assert found.start.t_ns == wanted.start.t_ns
    np.testing.assert_allclose(found.start.mean, wanted.start.mean, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.start.cov, wanted.start.cov, rtol=0, atol=1e-12)
    assert found.settings == wanted.settings


@KINDS
@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_log_comes_back_from_a_bag(tmp_path: Path, kind: str, suffix: str) -> None:
    folder = write_small_log(tmp_path / "log", suffix)
    with (folder / "log.yaml").open("a") as file:
        file.write("motion: {alpha1: 0.02}\n")
    log = open_log(folder)
    write_bag(tmp_path / NAMES[kind], log, kind)
    assert_same(open_log(tmp_path / NAMES[kind]), log)


@KINDS
def test_a_rolling_shutter_survives(tmp_path: Path, kind: str) -> None:
    log = open_log(write_small_log(tmp_path / "log"))
    shutter = RollingShutter(62.5e-6, stamp_row=23.5)
    write_bag(tmp_path / NAMES[kind], replace(log, camera=replace(log.camera, shutter=shutter)), kind)
    assert open_log(tmp_path / NAMES[kind]).camera.shutter == shutter
    beyond = replace(log.camera, shutter=RollingShutter(62.5e-6, stamp_row=log.camera.height))
    write_bag(tmp_path / f"beyond{NAMES[kind]}", replace(log, camera=beyond), kind)
    with pytest.raises(InputError, match="expected a row of the image"):
        open_log(tmp_path / f"beyond{NAMES[kind]}")


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [
        ("none", ()),
        ("plumb_bob", ()),
        ("plumb_bob", (0.1, -0.2, 1e-3, 2e-3, 0.3)),
        ("equidistant", (0.01, -0.02, 0.003, 0.0004)),
        ("rational_polynomial", (0.1, 0.2, 1e-3, 1e-3, 0.3, 0.4, 0.5, 0.6)),
    ],
)
@pytest.mark.parametrize("kind", ["mcap", "ros1"])  # which name fields differently
def test_lens_models_survive(tmp_path: Path, kind: str, model: str, coefficients: tuple[float, ...]) -> None:
    with recording(tmp_path / NAMES[kind], kind) as recorder:
        name = "D" if kind == "ros1" else "d"
        recorder.info(distortion_model="" if model == "none" else model, **{name: np.array(coefficients)})
        recorder.mount()
        recorder.steps()
    log = open_log(tmp_path / NAMES[kind])
    assert (log.camera.distortion_model, log.camera.distortion) == (model, coefficients)
    write_bag(tmp_path / f"again{NAMES[kind]}", log, kind)
    again = open_log(tmp_path / f"again{NAMES[kind]}").camera
    assert (again.distortion_model, again.distortion) == (model, coefficients)


# -- times ------------------------------------------------------------------------------------------------------------


@KINDS
def test_events_are_in_the_order_of_stamps_not_of_arrival(tmp_path: Path, kind: str) -> None:
    def record(recorder: Recorder) -> None:
        for stamp, arrival in ((1, 5), (3, 6), (2, 6), (4, 6), (5, 9)):
            recorder.image(stamp * 10**8 + stamp, recorded_ns=arrival * 10**8)

    log = open_log(bag(tmp_path / NAMES[kind], record, kind))
    assert [frame.t_ns for frame in log.frames] == [stamp * 10**8 + stamp for stamp in (1, 2, 3, 4, 5)]
    for order in ((0, 1, 2, 3, 4), (4, 3, 2, 1, 0), (2, 2, 0)):  # as a replay reads, and in any other order
        for index in order:
            frame = log.frames[index]
            assert (frame.load() == frame.t_ns % 251).all()


def test_of_equal_stamps_the_first_is_kept(tmp_path: Path) -> None:
    def record(recorder: Recorder) -> None:
        recorder.image(10**8)
        recorder.image(10**8, recorded_ns=2 * 10**8, data=np.zeros(WIDTH * HEIGHT, np.uint8))
        recorder.odometry(10**9, 9.0)

    with pytest.warns(InputWarning, match="left out 1 of .* messages of .* such as") as told:
        log = open_log(bag(tmp_path / "bag", record))
    assert sum("left out 1 of 2 messages of /cam/image" in str(one.message) for one in told) == 1
    assert sum("left out 1 of 12 messages of /odom" in str(one.message) for one in told) == 1
    assert [(frame.t_ns, int(frame.load().max())) for frame in log.images] == [(10**8, 10**8 % 251)]
    assert log.odometry.poses[-1, 0] == pytest.approx(0.1)


def test_headers_without_stamps_are_told_and_times_of_recording_taken_if_asked(tmp_path: Path) -> None:
    with recording(tmp_path / "bag") as recorder:
        recorder.info()
        recorder.mount()
        for step in range(3):
            recorder.image(0, recorded_ns=step * 10**8 + 5)
            recorder.odometry(0, 0.1 * step, recorded_ns=step * 10**8)
    with pytest.raises(InputError, match=r"/cam/image: expected stamps in the headers, .*--topic times=recorded"):
        open_log(tmp_path / "bag")
    log = open_log(tmp_path / "bag", topics={"times": "recorded"})
    assert [frame.t_ns for frame in log.frames] == [5, 10**8 + 5, 2 * 10**8 + 5]
    assert log.odometry.t_ns.tolist() == [0, 10**8, 2 * 10**8]
    assert (log.images[1].load() == 0).all()
    with pytest.raises(InputError, match="expected times=recorded, found 'now'"):
        open_log(tmp_path / "bag", topics={"times": "now"})


def test_poses_of_a_lost_robot_are_left_out_and_counted(tmp_path: Path) -> None:
    def record(lost: int) -> Callable[[Recorder], None]:
        def lose(recorder: Recorder) -> None:
            recorder.images()
            for step in range(lost):
                recorder.odometry(2 * 10**9 + step, np.nan if step % 2 else 0.0, w=0.0)

        return lose

    with pytest.warns(InputWarning, match="left out 1 of 12 poses of /odom that are null or nan"):
        assert len(open_log(bag(tmp_path / "bag", record(1))).odometry) == 11
    with pytest.raises(InputError, match="at most a tenth of the poses to be null or nan, found 2 of 13"):
        open_log(bag(tmp_path / "more", record(2)))


def test_times_that_ros_has_not_are_refused(tmp_path: Path) -> None:
    folder = write_small_log(tmp_path / "log")
    rows = (folder / "odometry.csv").read_text().replace("\n0,", "\n-5,")
    (folder / "odometry.csv").write_text(rows)
    with pytest.raises(InputError, match=r"expected times from 0 to .* found -5"):
        write_bag(tmp_path / "bag", open_log(folder), "mcap")
    assert not (tmp_path / "bag").exists()


# -- topics -----------------------------------------------------------------------------------------------------------


DEEP: dict[str, Any] = {"step": 2 * WIDTH, "data": np.zeros(2 * WIDTH * HEIGHT, np.uint8)}


@pytest.mark.parametrize("kind", ["PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Odometry"])
@pytest.mark.parametrize(
    "name", ["/vicon/robot/robot", "/gt", "/ground_truth/pose", "/robot/groundtruth", "/ground_truth/odom"]
)
def test_truth_is_told_by_its_name_and_of_any_type_of_poses(tmp_path: Path, kind: str, name: str) -> None:
    def record(recorder: Recorder) -> None:
        recorder.images()
        for step in range(3):
            if kind == "Odometry":
                recorder.odometry(step * 10**8, 5.0 + step, topic=name)
            else:
                recorder.pose(step * 10**8, 5.0 + step, name, kind)

    log = open_log(bag(tmp_path / "bag", record))
    np.testing.assert_allclose(log.groundtruth.poses[:, 0], [5.0, 6.0, 7.0])
    np.testing.assert_allclose(log.odometry.poses[:, 0], np.arange(11) * 0.01)


def test_truth_may_be_a_frame_and_what_is_not_used_is_named(tmp_path: Path) -> None:
    def record(recorder: Recorder) -> None:
        recorder.images()
        for step in range(3):
            recorder.transform("world", "mocap/robot", (5.0 + step, 0.0, 0.0), topic="/tf", t_ns=step * 10**8)
            for name in ("/vicon/one", "/vicon/two"):
                recorder.pose(step * 10**8, 5.0, name, "PoseStamped")

    path = bag(tmp_path / "bag", record)
    with pytest.warns(InputWarning, match="not used: /vicon/one .*/vicon/two .*--topic groundtruth=/vicon/one"):
        assert open_log(path).groundtruth is None
    log = open_log(path, topics={"groundtruth": "mocap/robot"})
    np.testing.assert_allclose(log.groundtruth.poses[:, 0], [5.0, 6.0, 7.0])
    with pytest.raises(InputError, match="found no 'mocap/robat'"):
        open_log(path, topics={"groundtruth": "mocap/robat"})


def test_a_strangers_topics_are_found_by_type_and_the_choice_is_told(tmp_path: Path) -> None:
    """Not depth, not the copy for slow networks, and not what this program drew."""

    def record(recorder: Recorder) -> None:
        _, file = cv2.imencode(".png", np.full((HEIGHT, WIDTH), 7, np.uint8))
        for step in range(3):
            recorder.image(step * 10**8, topic="/depth_cam/rgb/picture")
            recorder.compressed(step * 10**8, bytes(file), topic="/depth_cam/rgb/picture/compressed")
            recorder.compressed(step * 10**8, bytes(file), topic="/robot1/localiser/image/compressed")
            recorder.image(step * 10**8, topic="/depth_cam/depth/picture", encoding="16UC1", **DEEP)
            recorder.image(step * 10**8, topic="/depth_cam/far", encoding="32FC1", **DEEP)

    path = bag(tmp_path / "bag", record)
    with pytest.warns(InputWarning, match="taken: image /depth_cam/rgb/picture, odometry /odom, .*above base_link"):
        assert len(open_log(path).frames) == 3


def test_depth_is_never_proposed(tmp_path: Path) -> None:
    depth = {"topic": "/depth/image_rect_raw", "encoding": "16UC1", **DEEP}
    with pytest.raises(InputError, match=r"expected a topic of .*Image"):
        open_log(bag(tmp_path / "bag", lambda recorder: recorder.images(**depth)))


def test_transforms_of_old_bags_are_transforms(tmp_path: Path) -> None:
    with recording(tmp_path / "x.bag", "ros1") as recorder:
        old = get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf/msg/tfMessage")
        recorder.store.register({} if "tf/msg/tfMessage" in recorder.store.fielddefs else old)
        recorder.info()
        recorder.transform("base_link", "optical", (0.1, 0.0, 0.7), OPTICAL, msgtype="tf/msg/tfMessage")
        recorder.steps()
    assert open_log(tmp_path / "x.bag").camera.mount.height_m == pytest.approx(0.7)


def test_several_topics_are_listed_with_the_option_that_chooses(tmp_path: Path) -> None:
    def record(recorder: Recorder) -> None:
        recorder.images()
        recorder.odometry(0, 5.0, topic="/wheel/odom")
        recorder.odometry(10**8, 6.0, topic="/wheel/odom")

    path = bag(tmp_path / "bag", record)
    with pytest.raises(InputError) as error:
        open_log(path)
    assert "/odom (Odometry, 11), /wheel/odom (Odometry, 2)" in str(error.value)
    assert "--topic odometry=/odom" in str(error.value)
    log = open_log(path, topics={"odometry": "/wheel/odom"})
    np.testing.assert_allclose(log.odometry.poses[:, 0], [5.0, 6.0])
    log = open_log(path, topics={"odometry": "/odom", "groundtruth": "/wheel/odom"})
    assert log.groundtruth is not None and len(log.odometry) == 11
    assert len(open_log(path, topics={"groundtruth": "/wheel/odom"}).odometry) == 11


def test_the_camera_info_beside_the_image_is_taken(tmp_path: Path) -> None:
    def record(recorder: Recorder) -> None:
        recorder.images()
        recorder.info(topic="/other/camera_info", focal=99.0)

    assert open_log(bag(tmp_path / "bag", record)).camera.fx == 10.0


@pytest.mark.parametrize(
    ("topics", "problem"),
    [
        ({"image": "/nothing"}, r"expected one of the topics /cam/image .*, found '/nothing'"),
        ({"images": "/cam/image"}, "unknown kind of topic.*image"),
        ({"odometry": "/cam/image"}, "expected one of the topics /odom"),
    ],
)
def test_topics_that_are_not_there(tmp_path: Path, topics: dict[str, str], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        open_log(bag(tmp_path / "bag", Recorder.images), topics=topics)


def test_a_bag_without_images_lists_what_it_has(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"CompressedImage, found .*/odom \(Odometry, 11\)"):
        open_log(bag(tmp_path / "bag", lambda _: None))


def test_topic_options_are_for_bags(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--topic is for ROS bags"):
        open_log(write_small_log(tmp_path / "log"), topics={"image": "/x"})


# -- images -----------------------------------------------------------------------------------------------------------

COLOUR = np.random.default_rng(5).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)  # blue, green, red
FLAT = np.full((HEIGHT, WIDTH, 3), (40, 90, 200), dtype=np.uint8)


def decoded(tmp_path: Path, **fields: object) -> np.ndarray:
    """Return the pixels of a raw image after reading it from a bag."""
    path = bag(tmp_path / "bag", lambda recorder: recorder.image(10**8, **fields))
    (frame,) = open_log(path).frames
    grey = frame.load()
    assert grey.shape == (HEIGHT, WIDTH)
    file = np.frombuffer(frame.encoded(), dtype=np.uint8)
    pixels = np.asarray(cv2.imdecode(file, cv2.IMREAD_UNCHANGED))
    np.testing.assert_array_equal(grey, cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY) if pixels.ndim == 3 else pixels)
    return pixels


@pytest.mark.parametrize(
    ("encoding", "pixels"),
    [
        ("bgr8", COLOUR),
        ("8UC3", COLOUR),
        ("rgb8", COLOUR[..., ::-1]),
        ("bgra8", np.dstack([COLOUR, COLOUR[..., 0]])),
        ("rgba8", np.dstack([COLOUR[..., ::-1], COLOUR[..., 0]])),
        ("mono8", COLOUR[..., 1]),
    ],
)
@pytest.mark.parametrize("padding", [0, 5])
def test_raw_images_keep_every_pixel(tmp_path: Path, encoding: str, pixels: np.ndarray, padding: int) -> None:
    rows = np.pad(pixels.reshape(HEIGHT, -1), ((0, 0), (0, padding)), constant_values=7)
    found = decoded(tmp_path, encoding=encoding, step=rows.shape[1], data=rows.ravel())
    np.testing.assert_array_equal(found, COLOUR if pixels.ndim == 3 else pixels)


@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
@pytest.mark.parametrize(("largest", "shift"), [(255, 0), (1023, 2), (3000, 4), (16383, 6), (65535, 8)])
def test_images_of_16_bits_have_the_range_that_they_use(tmp_path, encoding, largest, shift):
    values = np.random.default_rng(3).integers(0, largest, (HEIGHT, WIDTH), endpoint=True)
    values[0, 0] = largest
    for big, kind in ((0, "<u2"), (1, ">u2")):
        data = values.astype(kind).view(np.uint8).ravel()
        fields = {"encoding": encoding, "step": 2 * WIDTH, "is_bigendian": big, "data": data}
        np.testing.assert_array_equal(decoded(tmp_path / str(big), **fields), values >> shift)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_images_get_their_colours(tmp_path: Path, pattern: str) -> None:
    """The mosaic of an even colour is that colour again."""
    channel = ["bgr".index(letter) for letter in pattern]
    mosaic = np.empty((HEIGHT, WIDTH), dtype=np.uint8)
    for place in range(4):
        mosaic[place // 2 :: 2, place % 2 :: 2] = FLAT[0, 0, channel[place]]
    np.testing.assert_array_equal(decoded(tmp_path, encoding=f"bayer_{pattern}8", data=mosaic.ravel()), FLAT)


@pytest.mark.parametrize(
    ("encoding", "order"),
    [("uyvy", "uyvy"), ("yuv422", "uyvy"), ("yuyv", "yuyv"), ("yuv422_yuy2", "yuyv"), ("nv12", "uv"), ("nv21", "vu")],
)
def test_yuv_images_get_their_colours(tmp_path: Path, encoding: str, order: str) -> None:
    """BT.601 with head room, as cameras send it; the inverse of the transform is applied by hand."""
    values, pixels = yuv_of(*FLAT[0, 0]), WIDTH * HEIGHT
    data = np.array([values[letter] for letter in order] * (pixels // (4 if len(order) == 2 else 2)), dtype=np.uint8)
    planar = {"data": np.concatenate([np.full(pixels, values["y"], dtype=np.uint8), data])}
    found = decoded(tmp_path, encoding=encoding, **(planar if len(order) == 2 else {"step": 2 * WIDTH, "data": data}))
    assert np.abs(found.astype(int) - FLAT).max() <= 3


def yuv_of(blue: int, green: int, red: int) -> dict[str, int]:
    """Return y, u and v of a colour by BT.601 with head room."""
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    return {
        "y": round(16 + 219 / 255 * luma),
        "u": round(128 + 224 / 255 * (blue - luma) / 1.772),
        "v": round(128 + 224 / 255 * (red - luma) / 1.402),
    }


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"encoding": "rgb16"}, "expected an encoding of mono8, .*, found 'rgb16'"),
        ({"step": 7}, "expected rows of at least 8 bytes for 8 pixels of mono8, found 7"),
        ({"data": np.zeros(47, np.uint8)}, "expected 6 rows of 8 bytes, found 47 bytes"),
        ({"height": 2**31}, "expected 2147483648 rows of 8 bytes, found 48 bytes"),
        ({"height": 0}, "expected an image that mono8 can hold, found 8×0"),
        ({"encoding": "nv12", "height": 5}, "expected an image that nv12 can hold"),
        ({"width": 4}, "expected an image of 8×6 pixels, as the camera says, found 4×6"),
    ],
)
def test_raw_images_that_cannot_be(tmp_path: Path, fields: dict[str, object], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        decoded(tmp_path, **fields)


def test_a_compressed_image_that_is_cut_off_is_named(tmp_path: Path) -> None:
    done, file = cv2.imencode(".jpg", COLOUR)
    assert done
    path = bag(tmp_path / "bag", lambda recorder: recorder.compressed(10**8, bytes(file)[:-9]))
    (frame,) = open_log(path).frames
    with pytest.raises(InputError, match="/cam/image/compressed at 100000000 ns: expected a whole image"):
        frame.load()


@KINDS
def test_images_are_not_held_in_memory(tmp_path: Path, kind: str) -> None:
    """Three times as many images of 256 kB need as much memory as before."""
    few, many = (peak_bytes(tmp_path / f"{count}{NAMES[kind]}", kind, count) for count in (40, 120))
    assert many < few + 4 * 2**18
    assert many < 120 * 2**18 / 2


def peak_bytes(path: Path, kind: str, count: int) -> int:
    """Return how much memory it takes to read a bag of so many images, all of them."""
    side = 2**9
    grey = np.random.default_rng(0).integers(0, 256, side * side, dtype=np.uint8)
    with recording(path, kind) as recorder:
        recorder.info(width=side, height=side)
        recorder.mount()
        for step in range(count):
            recorder.odometry(step * 10**7)
            recorder.image(step * 10**7, width=side, height=side, step=side, data=grey)
    tracemalloc.start()
    try:
        for frame in open_log(path).frames:
            frame.load()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


# -- writing ----------------------------------------------------------------------------------------------------------


def test_a_bag_that_cannot_be_finished_leaves_nothing(tmp_path: Path) -> None:
    folder = write_small_log(tmp_path / "log")
    log = open_log(folder)
    (folder / "images" / "000001.jpg").write_bytes(b"\xff\xd8\xff")
    for kind, name in NAMES.items():
        with pytest.raises(InputError):
            write_bag(tmp_path / name, log, kind)
    assert [path.name for path in tmp_path.iterdir()] == ["log"]


def test_edges_do_not_fit_into_a_bag(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a log with images, found edges"):
        write_bag(tmp_path / "bag", open_log(write_edge_log(tmp_path / "log")), "mcap")


@pytest.mark.data
def test_house_as_a_bag_is_the_first_20_s_of_house(data_dir: Path) -> None:
    found, whole = open_log(data_dir / "house_bag"), open_log(data_dir / "house")
    count, frames = len(found.odometry), len(found.frames)
    assert (count, frames) == (401, 101)
    shift_ns = found.start_ns - whole.start_ns
    np.testing.assert_array_equal(found.odometry.t_ns - shift_ns, whole.odometry.t_ns[:count])
    # The bag was made from poses with all their digits, the folder has six of them.
    np.testing.assert_allclose(found.odometry.poses, whole.odometry.poses[:count], rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.groundtruth.poses, whole.groundtruth.poses[:count], rtol=0, atol=1e-6)
    assert found.camera.mount == whole.camera.mount
    np.testing.assert_array_equal(found.camera.matrix, whole.camera.matrix)
    assert [data for _, data in images(found)] == [data for _, data in images(whole)[:frames]]


@pytest.mark.parametrize("heading", [-3.141592654, 3.141592653, -3.1415926535, 3.14159265358, 1.570796327, 0.0])
def test_headings_at_the_border_settle_at_once(tmp_path: Path, heading: float) -> None:
    folder = write_small_log(tmp_path / "log")
    (folder / "odometry.csv").write_text(f"t_ns,x,z,heading\n0,0.1,0.2,{heading}\n200000000,0.1,0.2,{heading}\n")
    write_bag(tmp_path / "a.bag", open_log(folder), "ros1")
    once = open_log(tmp_path / "a.bag")
    assert np.abs(np.angle(np.exp(1j * (once.odometry.poses[:, 2] - heading)))).max() < 2e-9
    write_bag(tmp_path / "b.mcap", once, "mcap")
    np.testing.assert_array_equal(open_log(tmp_path / "b.mcap").odometry.poses, once.odometry.poses)


@KINDS
def test_a_disk_that_is_full_is_told_and_nothing_stays(tmp_path: Path, kind: str) -> None:
    """A limit on the size of files stands in for the disk."""
    log = open_log(write_small_log(tmp_path / "log", ".png"))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2**12, hard))
    try:
        with pytest.raises(OutputError, match="cannot be written"):
            write_bag(tmp_path / NAMES[kind], log, kind)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [path.name for path in tmp_path.iterdir()] == ["log"]


@KINDS
def test_what_is_sent_once_is_kept_for_late_subscribers(tmp_path: Path, kind: str) -> None:
    write_bag(tmp_path / NAMES[kind], open_log(write_small_log(tmp_path / "log")), kind)
    reader = (rosbag1 if kind == "ros1" else rosbag2).Reader(tmp_path / NAMES[kind])
    with reader:
        latched = {found.topic for found in reader.connections if is_latched(found.ext)}
    assert latched == {"/tf_static", "/localiser/log", "/localiser/map"}


def is_latched(ext: Any) -> bool:
    if hasattr(ext, "latching"):
        return bool(ext.latching)
    return [qos.durability for qos in ext.offered_qos_profiles] == [QosDurability.TRANSIENT_LOCAL]


RECTIFIED = {
    "d": np.array([-0.3, 0.1, 0.0, 0.0, 0.0]),
    "r": np.eye(3).ravel(),
    "p": np.array([9, 0, 3.0, 0, 0, 9, 2.0, 0, 0, 0, 1.0, 0]),
}


def camera_of(path: Path, topic: str, topics: dict[str, str] | None = None, **info: object) -> Camera:
    """Return the camera of a bag with images on a topic, and a CameraInfo of raw and rectified images."""
    with recording(path) as recorder:
        recorder.info(topic=f"{topic.rsplit('/', 1)[0]}/camera_info", **(RECTIFIED | info))
        recorder.mount()
        recorder.steps(topic=topic)
    return open_log(path, topics=topics).camera


@pytest.mark.parametrize(
    "name", ["image_rect", "image_rect_color", "image_color_rect", "rect/image", "rectified", "image_rect_raw"]
)
def test_rectified_images_have_the_projection_matrix_and_no_distortion(tmp_path: Path, name: str) -> None:
    camera = camera_of(tmp_path / "bag", f"/cam/{name}")
    assert (camera.fx, camera.cx, camera.cy, camera.distortion_model) == (9.0, 3.0, 2.0, "none")


@pytest.mark.parametrize("name", ["image_raw", "image_mono", "image_color", "direct/image_raw"])
def test_raw_images_have_the_matrix_and_distortion_of_the_lens(tmp_path: Path, name: str) -> None:
    camera = camera_of(tmp_path / "bag", f"/cam/{name}")
    assert (camera.fx, camera.distortion[0]) == (10.0, -0.3)


def test_images_that_may_be_rectified_or_not_are_asked_for(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--topic image_raw=/cam/image, or image_rect=/cam/image"):
        camera_of(tmp_path / "bag", "/cam/image")
    assert open_log(tmp_path / "bag", topics={"image_raw": "/cam/image"}).camera.fx == 10.0
    assert open_log(tmp_path / "bag", topics={"image_rect": "/cam/image"}).camera.fx == 9.0


@pytest.mark.parametrize(
    "info", [{"d": np.zeros(5)}, {"p": np.zeros(12)}, {"p": np.array([10, 0, 3.5, 0, 0, 10, 2.5, 0, 0, 0, 1, 0])}]
)
def test_where_both_cameras_are_one_nothing_is_asked(tmp_path: Path, info: dict[str, object]) -> None:
    assert camera_of(tmp_path / "bag", "/cam/image", **info).fx == 10.0


def test_binning_is_refused(tmp_path: Path) -> None:
    with recording(tmp_path / "bag") as recorder:
        recorder.mount()
        recorder.info(10**9, binning_x=2)
        recorder.odometry(0)
        recorder.images()
    with pytest.raises(InputError, match="/cam/camera_info: binning: expected images of the whole sensor"):
        open_log(tmp_path / "bag")


def test_a_camera_file_stands_in_for_a_bag_without_camera(tmp_path: Path) -> None:
    with recording(tmp_path / "bag") as recorder:
        recorder.steps()
    with pytest.raises(InputError, match=r"expected a topic of sensor_msgs/CameraInfo, found none; .*--camera FILE"):
        open_log(tmp_path / "bag")
    camera = tmp_path / "camera.yaml"
    camera.write_text(
        f"image_width: {WIDTH}\nimage_height: {HEIGHT}\n"
        "camera_matrix: {rows: 3, cols: 3, data: [9, 0, 1, 0, 9, 1, 0, 0, 1]}\nmount: {tilt_deg: 1, height_m: 1}\n"
    )
    assert open_log(tmp_path / "bag", camera=camera).camera.fx == 9.0
