"""What looks like another place, for Rerun: places, examples, and where one more landmark would help."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from localiser.camera import Camera
from localiser.geometry import Array
from localiser.view.context import Context
from localiser.view.paths import WORLD

if TYPE_CHECKING:
    from localiser.landmarks import LandmarkMap

ALIKE = f"{WORLD}/building/alike"


def record_lookalikes(
    path: Path,
    camera: Camera,
    landmark_map: LandmarkMap,
    places: Array,
    share: Array,
    examples: tuple[Array, Array],
    spots: Array,
) -> None:
    """Write to a `.rrd` file from which share (P,) of headings places (P, 2) look like others. Raises OutputError.

    examples: poses (K, 3) and those (K, 3) that they look like. spots: (S, 2) where a landmark would help most.
    """
    import rerun as rr

    from localiser.view import landmark_view, palette, world
    from localiser.view.recorder import stream_to_file

    context = Context(landmark_map.name, camera, landmark_map, images=False, application="localiser map check")
    stream = stream_to_file(path, context, landmark_view.layout(landmark_map))
    stream.log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
    stream.log(f"{WORLD}/map/unseen", world.landmarks(context.landmark_ends, palette.UNSEEN, 1.2), static=True)
    # Of weights, those near the largest are brightest; a place that looks like no other is dark.
    colours = palette.of_weights(np.append(share, 1.0) ** 2)[:-1]
    stream.log(ALIKE, rr.Points3D(world.at_height(places, 0.01), colors=colours, radii=0.08), static=True)
    poses, twins = examples
    start = world.at_height(poses[:, :2], 0.05)
    arrows = rr.Arrows3D(
        origins=start, vectors=world.at_height(twins[:, :2], 0.05) - start, colors=palette.ESTIMATE, radii=0.015
    )
    stream.log(f"{ALIKE}/like", arrows, static=True)
    upright = np.stack([world.at_height(spots, 0.0), world.at_height(spots, 2.0)], axis=1).astype(np.float32)
    stream.log(f"{ALIKE}/spots", rr.LineStrips3D(upright, colors=palette.MATCHED, radii=0.03), static=True)
    stream.flush()
    stream.disconnect()
