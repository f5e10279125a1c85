"""Located images are kept in a file and read again as they were; those of a robot that is lost are no ordinary ones."""

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from folders import ROOT
from short_log import corridor_with_edges

from localiser import Localiser
from localiser.config import read_config
from localiser.documents import encode
from localiser.errors import OutputError
from localiser.evaluate import found_images, metrics
from localiser.filter import Finding, LocatedFrame
from localiser.landmarks import LandmarkMap
from localiser.replay import replay_log
from localiser.replay.figures import Summary
from localiser.replay.frames import KeptFrames
from localiser.storage import TrackWriter, open_log, read_poses
from localiser.storage.trajectories import read_track


@pytest.fixture(scope="module")
def frame() -> LocatedFrame:
    """A located image."""
    log = open_log(ROOT / "logs" / "corridor")
    few = replace(log, frames=log.frames[:2])
    return replay_log(few, read_config(None, ["mcl.particles=50", "mcl.start_particles=100"])).frames[0]


def numbered(frame: LocatedFrame, number: int) -> LocatedFrame:
    return replace(frame, located=replace(frame.located, t_ns=number))


def test_images_are_read_as_they_were_in_any_order(frame: LocatedFrame) -> None:
    kept = KeptFrames()
    for number in range(5):
        kept.append(numbered(frame, number))
        assert kept[-1].located.t_ns == number
    assert len(kept) == 5
    assert [each.located.t_ns for each in kept] == [0, 1, 2, 3, 4]
    assert [each.located.t_ns for each in kept[1:4:2]] == [1, 3]
    for part in ("located", "matches", "truth", "stage_ms"):
        assert encode(getattr(kept[3], part)) == encode(getattr(numbered(frame, 3), part))
    assert type(kept[3].located.clusters) is type(frame.located.clusters) is not type(None)
    kept.append(numbered(frame, 5))
    assert [kept[index].located.t_ns for index in (5, 0, -2)] == [5, 0, 4]
    with pytest.raises(IndexError):
        kept[6]


def test_memory_and_summary_hardly_grow_with_the_length_of_a_run(frame, monkeypatch):
    in_memory = 500_000
    monkeypatch.setattr("localiser.replay.frames.IN_MEMORY", in_memory)

    def taken(work: Callable[[], object]) -> int:
        tracemalloc.start()
        result = work()
        used: int = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        del result
        return used

    count = 3 * in_memory // len(encode(frame.located))
    kept = KeptFrames()

    def keep() -> None:
        for number in range(count):
            kept.append(numbered(frame, number))

    assert taken(keep) < 1.5 * in_memory
    landmarks = LandmarkMap.from_points(np.zeros((len(frame.matches.visible), 2)))
    Summary.of(kept[:1], landmarks)  # which imports something
    assert taken(lambda: Summary.of(kept, landmarks)) < in_memory


def test_a_full_disk_is_told(frame: LocatedFrame, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full(BytesIO):
        def write(self, content: object) -> int:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("localiser.replay.frames.SpooledTemporaryFile", lambda max_size: Full())
    kept = KeptFrames()
    with pytest.raises(OutputError, match="No space left"):
        kept.append(frame)
    assert len(kept) == 0


def test_the_summary_of_nothing_is_empty() -> None:
    summary = Summary.of([], LandmarkMap.from_points(np.zeros((3, 2))))
    assert len(summary.track) == 0
    assert summary.sighted is None
    np.testing.assert_array_equal(summary.landmark_use, np.zeros((3, 2)))


PROBABILITY = [0.3, 0.7, 0.95, 0.6, 0.4, 0.8, 0.92]
FOUND = [False, False, True, True, False, False, True]


@pytest.fixture
def robot() -> Localiser:
    log, _ = corridor_with_edges()
    assert log.landmark_map is not None
    return Localiser(log.landmark_map, log.camera, read_config(None, ["mcl.particles=50", "mcl.start_particles=50"]))


def drive(robot: Localiser) -> list[LocatedFrame]:
    """Return images that are located with the probabilities above, along the beginning of the corridor."""
    log, edges = corridor_with_edges()
    frames, first = [], log.start
    robot.start(first.mean, first.cov, log.frames[0].t_ns)
    (frame,) = robot.edges(log.frames[0].t_ns, edges[log.frames[0].t_ns], by_wheels=False)
    finding = Finding.on(robot.landmark_map)
    for number, probability in enumerate(PROBABILITY):
        said = replace(frame.located, t_ns=log.frames[number].t_ns, p_correct=probability, reason="no edges")
        located, wide = finding.after(said)
        frames.append(replace(frame, located=located, wide_cov=wide))
    return frames


def test_a_robot_is_found_once_it_is_sure_and_lost_where_it_is_more_likely_wrong(robot: Localiser) -> None:
    frames = drive(robot)
    assert [frame.is_found for frame in frames] == FOUND
    assert found_images(np.array(PROBABILITY), is_found=False).tolist() == FOUND
    assert found_images(np.array(PROBABILITY), is_found=True).tolist() == [False, *FOUND[1:]]
    assert [frame.located.reason for frame in frames] == ["not found yet"] * 2 + ["no edges"] * 5


def test_a_pose_that_is_no_ordinary_one_is_wide_and_not_in_the_tum_file(robot: Localiser, tmp_path: Path) -> None:
    frames, writer = drive(robot), TrackWriter(tmp_path)
    for frame in frames:
        writer.frame(frame)
    writer.close(complete=True)
    assert read_poses(tmp_path / "trajectory.tum").t_ns.tolist() == [
        frame.located.t_ns for frame, found in zip(frames, FOUND, strict=True) if found
    ]
    track = read_track(tmp_path / "trajectory.csv")
    assert track.found.tolist() == FOUND
    length = np.ptp(robot.landmark_map.points[:, 1])
    assert (np.sqrt(track.covs[~track.found, 1, 1]) > 0.2 * length).all()
    assert (np.sqrt(track.covs[track.found, 1, 1]) < 0.3).all()
    figures = metrics(track, None, log="corridor")
    assert figures["confidence"]["not_found"] == pytest.approx(2 / 7, abs=1e-6)
    assert figures["position_3sigma_max_m"] < 1.0
