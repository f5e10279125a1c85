"""A map as it is built: image and tracks, landmarks with shrinking ellipses, the path before and after loops closed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from localiser.camera import Camera
from localiser.edges import Edges
from localiser.frames import Image
from localiser.geometry import Array, Trajectory
from localiser.view.context import Context
from localiser.view.paths import WORLD

if TYPE_CHECKING:
    import rerun as rr

    from localiser.landmarks import LandmarkMap

PLACES, ELLIPSES, BEFORE = f"{WORLD}/building/landmarks", f"{WORLD}/building/ellipses", f"{WORLD}/trails/before loops"
ALIKE = f"{WORLD}/building/alike"
_CIRCLE = np.stack([np.cos(np.linspace(0, 2 * np.pi, 33)), np.sin(np.linspace(0, 2 * np.pi, 33))], axis=-1)
_LARGEST_M = 1.0  # an ellipse beyond this would cover everything and say nothing


@dataclass(frozen=True, slots=True, eq=False)
class Growing:
    """The landmarks (K) that are known by some frame: points (K, 2), covariances (K, 2, 2)."""

    points: Array
    cov: Array


class MapRecording:
    """Writes the building of a map to a `.rrd` file, frame by frame. Raises OutputError where it cannot be written."""

    def __init__(
        self,
        path: Path,
        name: str,
        camera: Camera,
        landmark_map: LandmarkMap,
        before: Trajectory | None,
        *,
        images: bool,
    ) -> None:
        import rerun as rr

        from localiser.view import palette, world
        from localiser.view.recorder import stream_to_file

        context = Context(name, camera, landmark_map, truth=before, images=images)
        self._camera, self._number = camera, 0
        self._stream = stream_to_file(path, context)
        log = self._stream.log
        log(WORLD, rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
        log(f"{WORLD}/camera", world.pinhole(camera), static=True)
        log(f"{WORLD}/map/unseen", world.landmarks(context.landmark_ends, palette.UNSEEN, 1.2), static=True)
        if before is not None:
            log(BEFORE, world.trail(before.poses[:, :2], palette.ODOMETRY, 1.2), static=True)

    def frame(
        self,
        t_ns: int,
        pose: Array,
        previous: Array,
        image: Image | None,
        edges: Edges,
        landmark: NDArray[np.int64],
        known: Growing,
    ) -> None:
        """Write one frame: robot pose (3,) and the one before, edges (E) and their landmarks (E,), what is known."""
        import rerun as rr

        from localiser.view import image as image_view
        from localiser.view import palette, paths, world

        stream = self._stream
        stream.set_time(paths.FRAME, sequence=self._number)
        stream.set_time(paths.TIME, duration=np.timedelta64(t_ns, "ns"))
        self._number += 1
        stream.log(paths.CAMERA, world.camera_transform(self._camera, pose))
        stream.log(paths.ESTIMATE, world.arrow(pose, palette.ESTIMATE, 4.0))
        stream.log(paths.ESTIMATE_TRAIL, world.trail(np.stack([previous[:2], pose[:2]]), palette.ESTIMATE))
        if image is not None:
            stream.log(paths.IMAGE, image_view.picture(image))
        stream.log(paths.EDGES, image_view.vertical_edges(edges, landmark >= 0))
        stream.log(PLACES, rr.Points3D(world.at_height(known.points, 0.02), colors=palette.MATCHED, radii=0.02))
        stream.log(ELLIPSES, _ellipses(known))
        stream.log(paths.COUNTS, rr.Scalars([len(edges), int((landmark >= 0).sum())]))

    def close(self) -> None:
        """End the file, which can be opened from now on."""
        self._stream.flush()
        self._stream.disconnect()


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

    from localiser.view import palette, world
    from localiser.view.recorder import stream_to_file

    context = Context(landmark_map.name, camera, landmark_map, images=False)
    stream = stream_to_file(path, context)
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


def _ellipses(known: Growing) -> rr.LineStrips3D:
    """Return the 95 % ellipses of landmarks, those that are worse than a metre left out."""
    import rerun as rr

    from localiser.view import palette, world

    variance, axes = np.linalg.eigh(known.cov)
    half = np.sqrt(world.CHI2_95_2D * np.maximum(variance, 0.0))
    shown = half[:, 1] < _LARGEST_M
    scaled = axes[shown] * half[shown, None, :]
    lines = known.points[shown, None] + np.einsum("kij,cj->kci", scaled, _CIRCLE)
    return rr.LineStrips3D(
        world.at_height(lines, 0.02).astype(np.float32), colors=palette.VISIBLE, radii=rr.Radius.ui_points(0.6)
    )
