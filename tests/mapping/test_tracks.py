"""The compiled loop that follows edges against plain arrays."""

from __future__ import annotations

import numpy as np
import pytest
from mapping_worlds import with_looks, world

from localiser import mapping
from localiser.geometry import Array, wrap_angle
from localiser.mapping.sightings import Index, Sightings
from localiser.mapping.tracks import (
    TrackParameters,
    assign,
    association_scores,
    first_state,
    looks_alike,
    predicted,
    update_states,
)


def followed(
    sightings: Sightings, cameras: Array, pose_sigma_rad: Array, parameters: TrackParameters, margin: float
) -> Index:
    """Return the track (S,) of each sighting, as `follow` should."""
    track, count, none = np.full(len(sightings), -1, dtype=np.int64), 0, np.zeros(0, dtype=np.int64)
    number, last, missed, origin = none, none, none, np.zeros((0, 2))
    state, cov = first_state(np.zeros(0), np.zeros(0), 1.0)
    for frame, camera in enumerate(cameras):
        seen = np.arange(sightings.first[frame], sightings.first[frame + 1])
        heading, sigma = camera[2] - sightings.bearing[seen], np.hypot(sightings.sigma[seen], pose_sigma_rad[frame])
        expected, jacobian = predicted(origin, state, camera)
        row, column = none, none
        if len(seen) and len(number):
            own = np.einsum("ki,kij,kj->k", jacobian, cov, jacobian)
            side, polarity = sightings.side, sightings.polarity
            looks = looks_alike(side[last, None], polarity[last, None], side[seen], polarity[seen])
            row, column = assign(association_scores(expected, own, heading, sigma, looks, parameters), margin)
        innovation = wrap_angle(heading[column] - expected[row])
        state[row], cov[row] = update_states(state[row], cov[row], innovation, jacobian[row], sigma[column])
        missed = missed + 1
        last[row], missed[row], track[seen[column]] = seen[column], 0, number[row]
        fresh = np.delete(np.arange(len(seen)), column)
        track[seen[fresh]] = count + np.arange(len(fresh))
        count += len(fresh)
        alive = missed <= parameters.missed_most
        begun = first_state(heading[fresh], sigma[fresh], parameters.nearest_m)
        number, last = np.append(number[alive], track[seen[fresh]]), np.append(last[alive], seen[fresh])
        missed = np.append(missed[alive], np.zeros(len(fresh), dtype=np.int64))
        origin = np.concatenate([origin[alive], np.tile(camera[:2], (len(fresh), 1))])
        state, cov = np.concatenate([state[alive], begun[0]]), np.concatenate([cov[alive], begun[1]])
    return track


@pytest.mark.parametrize("margin", [0.0, 3.0])
@pytest.mark.parametrize("looking", [True, False])
def test_tracks_are_those_of_plain_arrays(margin: float, looking: bool) -> None:
    drive, parameters = world("office"), TrackParameters(missed_most=3)
    edges = drive.edges(0, clutter=8.0)[:300]
    edges[40] = edges[40].take(np.arange(0))
    if looking:
        edges = with_looks(edges, len(drive.landmark_map), 0)
    sightings = Sightings.from_edges(edges, drive.camera)
    cameras = drive.camera.pose_in_map(drive.truth.poses[:300])
    sigma = np.full(len(cameras), 0.01)
    expected = followed(sightings, cameras, sigma, parameters, margin)
    assert expected.max() > 500
    np.testing.assert_array_equal(mapping.follow(sightings, cameras, sigma, parameters, margin), expected)


def test_images_without_edges_have_no_tracks() -> None:
    drive = world("office")
    sightings = Sightings.from_edges([edges.take(np.arange(0)) for edges in drive.edges(0)[:3]], drive.camera)
    assert len(mapping.follow(sightings, np.zeros((3, 3)), np.full(3, 0.01), TrackParameters())) == 0
