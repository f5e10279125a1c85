"""Poses while the robot is not found yet, or is lost, are no ordinary ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from short_log import corridor_with_edges

from localiser import Localiser, LocatedFrame
from localiser.config import read_config
from localiser.evaluate import found_images, metrics
from localiser.filter import Finding
from localiser.storage import TrackWriter, read_poses
from localiser.storage.trajectories import read_track

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
    assert first is not None
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
