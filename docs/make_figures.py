"""Draw the figures of docs/, with the package's own functions: python docs/make_figures.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Arc, Circle, Polygon, Rectangle
from numpy.typing import ArrayLike

from localiser import geometry
from localiser.camera import Camera, Mount
from localiser.edges import EdgeParameters, find_edges
from localiser.edges.columns import gradient_field
from localiser.edges.find import grey_image
from localiser.edges.views import ROWS_PER_BLOCK, column_view
from localiser.geometry import Array
from localiser.storage import open_log

FOLDER = Path(__file__).resolve().parent / "figures"
LOG = Path(__file__).resolve().parents[1] / "logs" / "corridor"
FRAME = 96
INK, MUTED, ROBOT, CAMERA, LANDMARK = "#22303c", "#8a97a3", "#4878a8", "#d1782f", "#3f8f5f"


def write(axes: Axes, point: ArrayLike, text: str, colour: str, **style: Any) -> None:
    """Write text at a point of the page."""
    axes.text(*np.asarray(point), text, color=colour, **style)


def line(axes: Axes, start: ArrayLike, end: ArrayLike, colour: str, **style: Any) -> None:
    """Draw a straight line between two points of the page."""
    axes.plot(*np.array([start, end]).T, **{"color": colour, "lw": 1.6, "solid_capstyle": "butt", **style})


def arrow(axes: Axes, start: ArrayLike, end: ArrayLike, colour: str, arrowstyle: str = "-|>") -> None:
    """Draw an arrow between two points of the page."""
    properties = {"arrowstyle": arrowstyle, "color": colour, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", np.asarray(end), np.asarray(start), arrowprops=properties)


def angle_arc(axes: Axes, centre: Array, radius: float, span_deg: tuple[float, float], colour: str) -> Array:
    """Draw an arc anticlockwise between two directions of the page; return a point outside its middle."""
    axes.add_patch(
        Arc(centre, 2 * radius, 2 * radius, theta1=min(span_deg), theta2=max(span_deg), color=colour, lw=1.6)
    )
    middle = np.radians(np.mean(span_deg))
    return np.asarray(centre) + 1.22 * radius * np.array([np.cos(middle), np.sin(middle)])


def on_page(point: Array) -> Array:
    """Return page coordinates of a floor point (x, z): x to the right, -z up, y towards the reader."""
    return np.array([point[0], -point[1]])


def page_angle_deg(heading: float) -> float:
    """Return the direction on the page, anticlockwise from the right, that a heading faces."""
    return float(np.degrees(np.arctan2(*on_page(geometry.forward(heading))[::-1])))


def draw_from_above(axes: Axes) -> None:
    """Map, robot, camera and a landmark as a bird sees them."""
    pose = np.array([2.0, -0.9, np.radians(38)])
    camera_pose = geometry.compose(pose, [0.42, -0.42, np.radians(-26)])
    landmark = geometry.map_from_robot(camera_pose, [1.3, -1.75])

    arrow(axes, (0, 0), (0.8, 0), INK)
    arrow(axes, (0, 0), (0, -0.8), INK)
    axes.add_patch(Circle((0, 0), 0.08, facecolor="white", edgecolor=INK, lw=1.4, zorder=3))
    axes.plot(0, 0, ".", color=INK, ms=4, zorder=4)
    write(axes, (0.85, 0), "x (right)", INK, va="center")
    write(axes, (0, -0.85), "z (backward)", INK, ha="center", va="top")
    write(axes, (-0.12, 0.1), "y (up)", INK, ha="right")
    write(axes, (0, 0.4), "map", INK, ha="center", weight="bold")

    position, heading_end = on_page(pose), on_page(pose[:2] + 1.7 * geometry.forward(pose[2]))
    axes.add_patch(Circle(position, 0.4, facecolor="#dbe6f0", edgecolor=ROBOT, lw=1.6))
    line(axes, position, position + np.array([0, 1.5]), MUTED, ls=":")
    write(axes, position + np.array([0.07, 1.4]), "−z", MUTED, va="center")
    arrow(axes, position, heading_end, ROBOT)
    label = angle_arc(axes, position, 1.05, (90, page_angle_deg(pose[2])), ROBOT)
    write(axes, label, "heading", ROBOT, ha="center", va="center", size=9)
    write(axes, position + np.array([-0.48, -0.1]), "robot", ROBOT, ha="right", weight="bold")

    eye = on_page(camera_pose)
    wings = [camera_pose[:2] + 0.3 * geometry.forward(camera_pose[2] + turn) for turn in (0.5, -0.5)]
    axes.add_patch(Polygon([eye, *map(on_page, wings)], facecolor="#f4dcc6", edgecolor=CAMERA, lw=1.6, zorder=3))
    line(axes, eye, on_page(camera_pose[:2] + 2.1 * geometry.forward(camera_pose[2])), CAMERA, ls="--")
    line(axes, eye, on_page(landmark), LANDMARK)
    axes.plot(*on_page(landmark), "s", color=LANDMARK, ms=8)
    right, back = geometry.robot_from_map(camera_pose, landmark)
    bearing_deg = float(np.degrees(np.arctan2(right, -back)))
    facing_deg = page_angle_deg(camera_pose[2])
    label = angle_arc(axes, eye, 1.25, (facing_deg - bearing_deg, facing_deg), LANDMARK)
    write(axes, label, "bearing b > 0", LANDMARK, ha="center", va="bottom", size=9)
    write(axes, on_page(landmark) + np.array([0.12, 0]), "landmark", LANDMARK, va="center", weight="bold")
    write(axes, eye + np.array([0.3, 0.02]), "camera", CAMERA, weight="bold", va="center")
    write(axes, eye + np.array([0.3, -0.1]), "offset and yaw: its mount", CAMERA, va="top", size=9)
    axes.set(xlim=(-0.75, 4.6), ylim=(-1.2, 3.85), title="From above")


def draw_from_the_side(axes: Axes) -> None:
    """Tilt, height and the foot of an edge."""
    height, tilt, foot = 1.3, np.radians(22), 2.4
    eye, ahead = np.array([0.0, height]), np.array([np.cos(tilt), -np.sin(tilt)])
    axes.add_patch(Rectangle((-0.5, -0.3), 4.9, 0.3, facecolor="#e9ecef", edgecolor="none"))
    line(axes, (-0.5, 0), (4.4, 0), INK)
    line(axes, eye, (4.3, height), MUTED, ls=":")
    write(axes, (4.3, height + 0.06), "level", MUTED, ha="right")
    line(axes, eye, eye + ahead * height / np.sin(tilt), CAMERA, ls="--")
    write(axes, (3.0, 0.22), "optical axis", CAMERA, ha="left")
    line(axes, eye, (foot, 0), LANDMARK, lw=1.2)
    line(axes, (foot, 0), (foot, 2.1), LANDMARK, lw=3)
    write(axes, (foot, 2.16), "vertical edge", LANDMARK, ha="center", weight="bold")
    write(axes, (foot, -0.15), "foot", LANDMARK, ha="center", va="center")
    across = 0.13 * np.array([ahead[1], -ahead[0]])
    wings = [eye + 0.3 * ahead + across, eye + 0.3 * ahead - across]
    axes.add_patch(Polygon([eye, *wings], facecolor="#f4dcc6", edgecolor=CAMERA, lw=1.6, zorder=3))
    label = angle_arc(axes, eye, 1.5, (-np.degrees(tilt), 0), CAMERA)
    write(axes, label + np.array([-0.18, 0.0]), "tilt θ > 0", CAMERA, va="center")
    depression_deg = np.degrees(np.arctan2(height, foot))
    angle_arc(axes, eye, 0.95, (-depression_deg, 0), LANDMARK)
    write(axes, (0.12, 0.42), "depression δ", LANDMARK)
    arrow(axes, (0, 0), (0, height), INK, arrowstyle="<|-|>")
    write(axes, (-0.08, height / 2), "height h", INK, ha="right", rotation=90, va="center")
    arrow(axes, (0, -0.45), (foot, -0.45), INK, arrowstyle="<|-|>")
    write(axes, (foot / 2, -0.53), "range r = h / tan δ", INK, ha="center", va="top")
    axes.set(xlim=(-0.6, 4.5), ylim=(-1.2, 2.9), title="From the side")


def draw_image(axes: Axes) -> None:
    """Vertical edges of a tilted camera meet at the nadir point; one has its lean drawn."""
    camera = Camera(640, 480, 554.0, 554.0, 319.5, 239.5, Mount(tilt_rad=np.radians(35), height_m=1.2))
    tilt, nadir = camera.mount.tilt_rad, camera.project_level([0.0, -1.0, 0.0])
    axes.add_patch(Rectangle((0, 0), 639, 479, facecolor="#f3f5f7", edgecolor=INK, lw=1.6))
    for bearing_deg in (-24, -12, 0, 12, 24):
        e = np.array([camera.upright_bounds[3], camera.upright_bounds[2]])
        a = np.tan(np.radians(bearing_deg)) * (np.cos(tilt) + e * np.sin(tilt))
        top, bottom = camera.pixels_from_upright(np.stack([a, e], axis=-1))
        line(axes, bottom, nadir, MUTED, ls=":", lw=1)
        line(axes, top, bottom, LANDMARK, lw=2)
        write(axes, (top[0], -12), f"{bearing_deg}°".replace("-", "−"), LANDMARK, ha="center", size=9)
    write(axes, (319.5, -62), "bearing b of each edge", LANDMARK, ha="center")
    foot = camera.pixels_from_upright([np.tan(np.radians(12)) * (np.cos(tilt) - 0.38 * np.sin(tilt)), -0.38])
    lean_deg = float(np.degrees(geometry.lean_from_bearing(np.radians(12), tilt)))
    line(axes, foot, foot - np.array([0, 330]), CAMERA, ls="--")
    # v points down the page: straight up is at -90°, and a lean to the right turns towards 0°.
    label = angle_arc(axes, foot, 290, (-90.0, -90.0 + lean_deg), CAMERA)
    write(axes, label + np.array([36, 75]), "lean\n> 0", CAMERA, size=9)
    axes.plot(*nadir, "o", color=INK)
    write(axes, nadir + np.array([25, 0]), "nadir point,\nf · cot θ below the centre", INK, va="center")
    axes.plot(319.5, 239.5, "+", color=INK, ms=10)
    for end, name in (((90, 0), "u"), ((0, 90), "v")):
        arrow(axes, (0, 0), end, INK)
        write(axes, np.array(end) + 26, name, INK, ha="center", va="center")
    axes.set(xlim=(-60, 690), ylim=(1080, -100), title="The image, tilt 35°")


def draw_lean(axes: Axes) -> None:
    """Lean and slope over bearing: lean is smooth where slope jumps."""
    bearing_deg = np.linspace(-60, 60, 481)
    for tilt_deg, colour in ((10, "#a9c3dc"), (20, "#6f9bc6"), (30, ROBOT), (45, "#23486c")):
        lean = np.degrees(geometry.lean_from_bearing(np.radians(bearing_deg), np.radians(tilt_deg)))
        axes.plot(bearing_deg, lean, color=colour, lw=2)
        write(axes, (61.5, lean[-1]), f"θ = {tilt_deg}°", colour, va="center")
    axes.axhline(0, color=MUTED, lw=0.8)
    axes.axvline(0, color=MUTED, lw=0.8)
    write(axes, (-57, 42), "tan(lean) = sin θ · tan b", ROBOT)
    axes.annotate(
        "m = 1 / tan(lean) is ±∞ here\nand changes its sign",
        (0, 0),
        (4, -36),
        color=CAMERA,
        arrowprops={"arrowstyle": "-|>", "color": CAMERA},
    )
    axes.set(xlabel="bearing b (°)", ylabel="lean (°)", xlim=(-60, 60), ylim=(-52, 52), title="Lean over bearing")
    axes.spines[["top", "right"]].set_visible(False)


def draw_edges(taken: Axes, rectified: Axes, gradient: Axes) -> None:
    """One image of the corridor log: the edges found in it, its columns, and their gradient in sigmas of its noise."""
    camera = open_log(LOG).camera
    image = cv2.imread(str(LOG / "images" / f"{FRAME:06d}.jpg"))
    edges, view = find_edges(image, camera, EdgeParameters()), column_view(camera)
    taken.imshow(image[..., ::-1], aspect="auto")
    for ends in edges.rejected_px:
        taken.plot(*ends.T, color=CAMERA, lw=1.2)
    for ends in edges.ends_px:
        taken.plot(*ends.T, color="#3df08a", lw=1.6)
    taken.set(xlim=(0, camera.width - 1), ylim=(camera.height - 1, 0))
    taken.set_title("Taken: vertical edges lean, the lens bends them")

    grey = grey_image(image, camera)
    upright = np.where(view.tables[2], 255, np.repeat(view.blocks(grey), ROWS_PER_BLOCK, axis=0))
    rectified.imshow(upright, cmap="gray", vmin=0, vmax=255, aspect="auto")
    rectified.set_title("Rectified: each is a column")
    field = gradient_field(grey, camera).smooth
    blocks = np.kron(field, np.ones((ROWS_PER_BLOCK, 1)))
    gradient.imshow(blocks, cmap="RdBu_r", vmin=-12, vmax=12, aspect="auto")
    gradient.set_title("Gradient of averaged rows, ±12 σ")
    for axes in (taken, rectified, gradient):
        axes.set(xticks=[], yticks=[])


def save(figure: plt.Figure, name: str) -> None:
    """Write a picture that is the same bytes on every run."""
    FOLDER.mkdir(exist_ok=True)
    without = {"Date": None} if name.endswith("svg") else {"Software": None}
    figure.savefig(FOLDER / name, metadata=without, facecolor="white", dpi=110)


def main() -> None:
    """Draw all figures."""
    plt.rcParams.update(
        {"svg.hashsalt": "localiser", "font.size": 10, "axes.titlesize": 11, "axes.titleweight": "bold"}
    )
    figure, (above, side) = plt.subplots(1, 2, figsize=(11, 5.2), layout="constrained")
    draw_from_above(above)
    draw_from_the_side(side)
    for axes in (above, side):
        axes.set_aspect("equal")
        axes.axis("off")
    save(figure, "frames.svg")

    figure, (image, lean) = plt.subplots(1, 2, figsize=(11, 5.6), layout="constrained", width_ratios=(1, 1.15))
    draw_image(image)
    image.set_aspect("equal")
    image.axis("off")
    draw_lean(lean)
    save(figure, "image.svg")

    figure, axes = plt.subplots(1, 3, figsize=(14, 3.9), layout="constrained", width_ratios=(1.05, 1, 1))
    draw_edges(*axes)
    save(figure, "edges.png")


if __name__ == "__main__":
    main()
