"""`localiser map build`: a landmark map from a log."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localiser.commands.map.options import NewMap, edges_with_progress, parse_poses, summary_table, warn
from localiser.commands.options import BagCamera, ConfigFile, Overrides, Topics, is_quiet, open_with_settings, show
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.config import Config
    from localiser.mapping import MapBuilt
    from localiser.storage import Log
    from localiser.view import Growing

EXAMPLES = """Examples:

`localiser map build logs/corridor -o mine.yaml`

`localiser map build logs/corridor --poses slam -o mine.yaml --rrd mine.rrd`, then `localiser view mine.rrd`

`localiser map build monday tuesday -o mine.yaml`

`localiser map build logs/corridor --poses mine.tum -o mine.yaml --set mapping.parallax_min_deg=8`"""


def build(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG…",
            help="Log folder or ROS bag. Several make one map, by their truth.",
        ),
    ],
    out: NewMap,
    poses: Annotated[
        str | None,
        typer.Option(
            metavar="truth|FILE|odometry|slam",
            help="Where the robot was: the log's truth, a trajectory (TUM, or CSV t_ns,x,z,heading), or its odometry; "
            "`slam` finds it out along with the map. By default the truth, and `slam` without one.",
        ),
    ] = None,
    trajectory: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write where the robot was at each image (TUM).")
    ] = None,
    rrd: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Record for `localiser view` how the map came about.")
    ] = None,
    config: ConfigFile = None,
    overrides: Overrides = None,
    topics: Topics = None,
    camera: BagCamera = None,
) -> None:
    """Build a map of the vertical edges that a LOG shows, or several, with what is known of each."""
    from localiser.mapping import build_map, default_poses
    from localiser.storage import jump_text, require_new_file, write_map, write_tum

    for path in (out, trajectory, rrd):
        if path is not None:
            require_new_file(path)
    if len(logs) > 1:
        for name, value in {"--trajectory": trajectory, "--rrd": rrd}.items():
            if value is not None:
                raise InputError("expected one log with this option, found several", field=name)
    read = [open_with_settings(log, config, overrides, topics, camera) for log in logs]
    recorded, settings = [log for log, _ in read], read[0][1]
    named = poses or default_poses(recorded)
    if poses is None and named == "slam" and not is_quiet():
        typer.echo(f"{logs[0]} has no truth: where the robot was is found from the log alone, along with the map.")
    track, source = parse_poses(named)
    built = build_map(recorded, track, settings, edges_of=lambda log: edges_with_progress(log, settings), source=source)
    for log in recorded:
        if log.has_images and len(logs) == 1:
            warn(_mount_warning(log, settings, built))
        warn(jump_text(log) if named != "truth" else None)
    write_map(built.landmark_map, out)
    if trajectory is not None:
        write_tum(built.trajectory, trajectory)
    if rrd is not None:
        record_growth(recorded[0], built, rrd)
    if not is_quiet():
        show(summary_table(built.landmark_map))
        if built.slam is not None:
            typer.echo(built.slam.text())
        typer.echo(f"{len(built.landmark_map)} landmarks in {out}; `localiser map show {out}` draws them.")


def _mount_warning(log: Log, config: Config, built: MapBuilt) -> str | None:
    """Return the warning that the edges contradict the stated tilt and roll, with which the map was made."""
    from localiser.calibration import check_mount

    poses = built.trajectory.sampled([frame.t_ns for frame in log.frames]).poses
    return check_mount(built.edges[0].__getitem__, poses, log.camera, config.edges.mount_sigma_rad).warning(log.path)


# -- how a map came about: for every image its edges, and the landmarks that have been seen until then ----------------


def record_growth(log: Log, built: MapBuilt, path: Path) -> None:
    """Write to a recording for Rerun how a map came about. Raises OutputError."""
    import numpy as np

    from localiser.geometry import Trajectory
    from localiser.view import Finished, record_map

    made, slam = built.landmark_map, built.slam
    sigma_cm = 100 * np.sqrt(np.trace(made.cov, axis1=1, axis2=2) / 2)
    text = f"{len(made)} landmarks, good to {np.median(sigma_cm):.2f} cm (median)"
    before = Trajectory(built.trajectory.t_ns, slam.before) if slam else None
    finished = Finished(made, built.trajectory, before, text)
    record_map(path, log.name, log.camera, _growth(log, built), finished, images=log.has_images)


def _growth(log: Log, built: MapBuilt) -> Iterator[Growing]:
    """Yield every image with what had been seen of the map by then; landmarks stand where they do in the end."""
    import numpy as np

    from localiser.storage import ImageEvent
    from localiser.view import Growing

    sightings, made = built.sightings, built.landmark_map
    on_map = np.full(len(built.built) + 1, -1)
    on_map[built.kept] = np.arange(len(made))
    landmark = on_map[built.built.of]
    begun = np.full(len(made), sightings.frames)
    np.minimum.at(begun, landmark[landmark >= 0], sightings.frame[landmark >= 0])
    image_at = {frame.t_ns: place for place, frame in enumerate(log.frames)}
    for frame, (t_ns, pose) in enumerate(zip(built.trajectory.t_ns.tolist(), built.trajectory.poses, strict=True)):
        own = slice(sightings.first[frame], sightings.first[frame + 1])
        known = np.flatnonzero(begun <= frame)
        shown = np.flatnonzero(np.isin(known, landmark[own]))
        image, edges = log.frames[image_at[t_ns]], built.edges[0][image_at[t_ns]]
        encoded = image.encoded() if isinstance(image, ImageEvent) else None
        points, cov = made.points[known], made.cov[known]
        yield Growing(t_ns, pose, encoded, edges, landmark[own] >= 0, points, cov, shown)
