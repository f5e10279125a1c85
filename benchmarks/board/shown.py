"""The pictures of docs/floors.md and docs/markers.md: what the rows of floors and markers drive through."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from board import floors, marked
from board.drives import MARKERS, log_of
from board.run import SURE, located
from localiser import Localiser, read_config
from localiser.markers import name_of

LARGER = 3  # times the image
ORANGE, GREEN = (40, 120, 235), (70, 140, 50)  # BGR
COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7")


def markers(path: Path) -> None:
    """Draw an image of the shop with its edges, and the sides of markers with their names."""
    drive = marked.on("shop", 0)
    near = [float(edges.length_px[edges.landmark_id < -1].sum()) for edges in drive.edges]
    edges = drive.edges[int(np.argmax(near))]
    picture = cv2.resize(log_of("shop").frames[int(np.argmax(near))].load(), None, fx=LARGER, fy=LARGER)
    picture = picture if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    for k in np.argsort(-edges.landmark_id):  # the sides of markers last
        code, ends = int(edges.landmark_id[k]), np.round(LARGER * edges.ends_px[k]).astype(int)
        cv2.line(picture, ends[0].tolist(), ends[1].tolist(), GREEN if code < -1 else ORANGE, 3, cv2.LINE_AA)
        if code < -1:
            at = int(ends[:, 0].mean()) - 40, int(ends[:, 1].min()) - 40
            name = name_of(code, MARKERS["edges.markers"]).partition(":")[2]
            for colour, width in (((255, 255, 255), 5), ((40, 40, 30), 2)):
                cv2.putText(picture, name, at, cv2.FONT_HERSHEY_SIMPLEX, 0.7, colour, width, cv2.LINE_AA)
    cv2.imwrite(str(path), picture)


def lift(path: Path) -> None:
    """Draw where the robot is believed to be, image by image, from an unknown start on one floor to the next one."""
    drive = floors.lift(0)
    robot = Localiser(drive.landmark_map, drive.camera, read_config(None, [], drive.settings), 0)
    frames = [frame for frame, _ in located(robot, drive)]
    seconds = (drive.t_ns - drive.t_ns[0]) / 1e9
    on = np.array([frame.map_name for frame in frames])
    sure = np.array([frame.located.p_correct for frame in frames])
    places = np.array([frame.located.estimate.pose[:2] for frame in frames])
    figure = Figure(figsize=(11.0, 6.0), dpi=100)
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, floors.FLOORS, height_ratios=(3, 1), hspace=0.3, left=0.06, right=0.98, top=0.94)
    below = figure.add_subplot(grid[1, :])
    for number, (one, colour) in enumerate(zip(drive.landmark_map.maps, COLOURS, strict=True)):
        low, high = one.points.min(axis=0) - 1.0, one.points.max(axis=0) + 1.0
        plan = figure.add_subplot(grid[0, number], aspect="equal", title=one.name, xticks=[], yticks=[])
        plan.set(xlim=(low[0], high[0]), ylim=(-high[1], -low[1]))
        plan.plot(one.points[:, 0], -one.points[:, 1], ".", color="#9aa5b1", ms=3)
        here = on == one.name
        for few, fill in ((here & (sure > SURE), colour), (here & (sure <= SURE), "white")):
            plan.plot(places[few, 0], -places[few, 1], "o", color=colour, mfc=fill, ms=4, mew=0.8)
            below.plot(seconds[few], sure[few], "o", color=colour, mfc=fill, ms=4, mew=0.8)
    below.axvline(float(seconds[drive.carried]), color="#1f2933", lw=1, ls=":")
    below.text(float(seconds[drive.carried]) - 0.4, 0.5, "lift", ha="right", va="center")
    below.set(xlabel="s", ylabel="p_correct", ylim=(-0.05, 1.08))
    figure.savefig(path)
