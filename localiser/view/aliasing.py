"""What looks like another place, for Rerun: places, examples, and where one more landmark would help."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from localiser.camera import Camera
from localiser.view.context import Context
from localiser.view.paths import WORLD

if TYPE_CHECKING:
    from localiser.landmarks import LandmarkMap
    from localiser.mapping import Aliasing

ALIKE = f"{WORLD}/building/alike"


def record_aliasing(path: Path, camera: Camera, landmark_map: LandmarkMap, look: Aliasing) -> None:
    """Write to a `.rrd` file what looks like what, and where a landmark would help. Raises OutputError."""
    import rerun as rr

    from localiser.view import landmark_view, palette, world
    from localiser.view.recorder import new_stream
    from localiser.view.recording_file import RecordingFile

    context = Context(landmark_map.name, camera, landmark_map, images=False, application="localiser map check")
    stream = new_stream(context)
    file = RecordingFile(path, stream, landmark_view.layout(landmark_map))
    stream.log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
    stream.log(f"{WORLD}/map/unseen", world.landmarks(context.landmark_ends, palette.UNSEEN, 1.2), static=True)
    # Of weights, those near the largest are brightest; a place that looks like no other is dark.
    colours = palette.of_weights(np.append(look.share, 1.0) ** 2)[:-1]
    stream.log(ALIKE, rr.Points3D(world.at_height(look.places, 0.01), colors=colours, radii=0.08), static=True)
    poses, twins = look.examples()
    start = world.at_height(poses[:, :2], 0.05)
    arrows = rr.Arrows3D(
        origins=start, vectors=world.at_height(twins[:, :2], 0.05) - start, colors=palette.ESTIMATE, radii=0.015
    )
    stream.log(f"{ALIKE}/like", arrows, static=True)
    upright = np.stack([world.at_height(look.spots_at, height) for height in (0.0, 2.0)], axis=1).astype(np.float32)
    stream.log(f"{ALIKE}/spots", rr.LineStrips3D(upright, colors=palette.MATCHED, radii=0.03), static=True)
    file.end()
