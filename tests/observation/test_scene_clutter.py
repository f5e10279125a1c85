"""Clutter as an earlier image predicts it: against simulated things on no map, and against its own integral."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from passed_points import SIGMA, TURN_SIGMA, PassedPoints

from localiser.camera import Camera, Mount
from localiser.edges import Edges
from localiser.geometry import Array, wrap_angle
from localiser.landmarks import half_view_rad
from localiser.observation import Frame, ObservationParameters
from localiser.observation.clutter import (
    GROUP_RAD,
    NEAREST_M,
    NEW,
    SEEN_AGAIN,
    SHORT,
    STILL_THERE,
    EarlierFrame,
    continued_density,
    grouped_density,
    scene_clutter,
)
from localiser.observation.frame import ROW_PX, SIGMA_PX

CAMERA = Camera(640, 480, 500.0, 500.0, 319.5, 239.5, Mount(np.radians(15.0), 1.0))
SPAN = Frame(Edges.none(), CAMERA).span_rad


def edges_at(bearings: ArrayLike, sigma: float, ends_px: Array | None = None) -> Edges:
    angle = np.array(bearings, dtype=float)
    known, tilted = np.full(len(angle), sigma), np.sin(np.radians(15.0))
    return Edges.from_columns(angle, known, np.arctan(tilted * np.tan(angle)), tilted * known, ends_px=ends_px)


def density(now: Edges, before: Edges | None, motion: ArrayLike = (0, 0, 0), turn_var: float = 0.0) -> Array:
    earlier = [] if before is None else [EarlierFrame(Frame(before, CAMERA), np.array(motion, dtype=float), turn_var)]
    return scene_clutter(Frame(now, CAMERA), earlier)[0]


def seen_again(found: ArrayLike, camera: Camera, before: ArrayLike, motion: tuple[float, float, float]) -> Array:
    """Return what earlier edges at these bearings add to the density of an image of one edge."""
    bearing = np.array(before, dtype=float)
    moved = bearing + motion[2] - (motion[0] * np.cos(bearing) + motion[1] * np.sin(bearing)) / NEAREST_M / 2
    expected = SEEN_AGAIN * float(np.sum(np.abs(moved) <= half_view_rad(camera)))
    return np.asarray(found) * (expected + 1.0) / (expected + max(1.0 - expected, NEW)) - 1.0


def test_nothing_is_known_without_a_last_image() -> None:
    one, none = edges_at([0.1], 0.02), edges_at([], 0.02)
    assert density(one, none).tolist() == density(one, None).tolist() == [1.0]
    assert density(none, one).tolist() == []


def test_what_stands_where_it_was_is_as_dense_as_the_sigmas_say() -> None:
    found = density(edges_at([0.25, -0.25], 0.01), edges_at([0.2, -0.3], 0.01), (0, 0, 0.05))
    again, new = 2 * SEEN_AGAIN, 2 * NEW
    unscaled = (SEEN_AGAIN * SPAN / np.sqrt(2 * np.pi * 2e-4) + 1 / 2) / 2
    np.testing.assert_allclose(found, unscaled * (again + new) / (again + 1), rtol=1e-6)


def test_an_edge_where_none_was_and_without_neighbours_is_rare() -> None:
    row = np.linspace(-0.45, -0.1, 9)
    found = density(edges_at([*row, 0.4], 0.001), edges_at(row, 0.001))
    assert found[-1] == pytest.approx(NEW / 10, rel=1e-3) and (found[:-1] > 5.0).all()


@given(st.lists(st.floats(-0.5, 0.5), max_size=8), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.5, 0.5))
@settings(max_examples=25)  # of 401 bearings each
def test_the_density_integrates_to_the_expected_number_of_edges(before, right, back, turn):
    """Over all bearings, also beyond the image: those seen again, beside the new ones, of one edge.

    The least number of new edges, which is one, makes the integral no larger.
    """
    grid, step = np.linspace(-2.5, 2.5, 401, retstep=True)
    found = np.array([density(edges_at([b], 0.02), edges_at(before, 0.02), (right, back, turn), 1e-4)[0] for b in grid])
    again = SEEN_AGAIN * len(before)
    of_earlier = seen_again(found, CAMERA, before, (right, back, turn))
    assert (of_earlier >= -1e-12).all()
    assert float(of_earlier.sum() * step / SPAN) == pytest.approx(again, abs=0.02 * max(again, 1.0))


def test_a_lone_edge_is_expected_once() -> None:
    """The density of an edge anywhere in the image, on average: 1.1 edges where one is expected again, 1 without it."""
    anywhere = np.linspace(-0.55, 0.55, 1101)
    seen = np.array([density(edges_at([b], 0.01), edges_at([0.1], 0.01))[0] for b in anywhere])
    turned_away = np.array([density(edges_at([b], 0.01), edges_at([0.5], 0.01), (0, 0, 0.4))[0] for b in anywhere])
    width = (anywhere[-1] - anywhere[0]) / SPAN
    assert (seen.mean() - seen.min()) * width + seen.min() == pytest.approx(SEEN_AGAIN + NEW, rel=0.01)
    np.testing.assert_allclose(turned_away, 1.0)


@pytest.mark.parametrize("tilt_deg", [10.0, 30.0])
@pytest.mark.parametrize("earlier", [None, 0.0, 0.4])
def test_by_slope_the_density_is_that_of_leans(tilt_deg: float, earlier: float | None) -> None:
    """Evenly spread clutter is even in the compared angle, which for `slope` is the lean."""
    tilt = np.radians(tilt_deg)
    camera = Camera(640, 480, 500.0, 500.0, 319.5, 239.5, Mount(tilt, 1.0))

    def at(leans: ArrayLike) -> Frame:
        lean = np.array(leans, dtype=float)
        bearing, sigma = np.arctan(np.tan(lean) / np.sin(tilt)), np.full(len(lean), 0.005)
        return Frame(Edges.from_columns(bearing, sigma, lean, sigma), camera, ObservationParameters(kind="slope"))

    grid, step = np.linspace(-1.2, 1.2, 481, retstep=True)
    if earlier is not None:
        before = at([earlier])
        images = [EarlierFrame(before, np.zeros(3), 0.0)]
        found = np.array([scene_clutter(at([lean]), images)[0][0] for lean in grid])
        of_earlier = seen_again(found, camera, before.edges.bearing, (0.0, 0.0, 0.0))
        assert float(of_earlier.sum() * step / before.span_rad) == pytest.approx(SEEN_AGAIN, rel=0.01)
    else:  # of two edges, each is as dense as the other's group predicts, beside an even part
        found = np.array([scene_clutter(at([lean, 0.1]), [])[0][0] for lean in grid]) - 0.5
        assert float(found.sum() * step / at([0.1]).span_rad) == pytest.approx(0.5, rel=0.02)


@pytest.mark.parametrize("step", [(0.0, -0.3, 0.0), (0.02, -0.2, 0.2), (0.0, 0.1, -0.3)])
def test_the_density_is_that_of_points_at_unknown_distances(step: tuple[float, float, float]) -> None:
    """Points at an even 1/r, seen before and after a step: the density is as good as their histogram, to 0.1 nats."""
    points = PassedPoints.by(step, NEAREST_M)
    pairs = list(zip(points.first[:2000], points.second[:2000], strict=True))
    found = [
        density(edges_at([second], SIGMA), edges_at([first], SIGMA), step, TURN_SIGMA**2)[0] for first, second in pairs
    ]
    of_earlier = [seen_again(one, CAMERA, [first], step) for one, (first, _) in zip(found, pairs, strict=True)]
    log_density = np.log(np.array(of_earlier) / SEEN_AGAIN)
    assert log_density.mean() > points.best(SPAN) - 0.1


def spines(bottoms: ArrayLike, tops: ArrayLike, bearings: ArrayLike) -> Edges:
    columns = 319.5 + 500.0 * np.tan(np.array(bearings, dtype=float))
    lower, upper = (np.stack([columns, np.broadcast_to(v, columns.shape)], axis=-1) for v in (bottoms, tops))
    return edges_at(bearings, 0.002, np.stack([lower, upper], axis=1))


def test_an_edge_that_one_image_missed_is_expected_from_an_older_one() -> None:
    row, still = np.linspace(-0.45, -0.1, 9), (np.zeros(3), 0.0)
    whole, without = (Frame(edges_at(at, 0.001), CAMERA) for at in ([*row, 0.4], row))
    older, last = EarlierFrame(whole, *still), EarlierFrame(without, *still)
    missed, continuing = scene_clutter(whole, [last, older])
    seen, _ = scene_clutter(whole, [older])
    assert (continuing > 3.0).all()
    assert missed[-1] == pytest.approx(STILL_THERE * seen[-1], rel=0.02)
    np.testing.assert_allclose(missed[:-1], scene_clutter(whole, [last])[0][:-1], rtol=0.05)


def test_the_scene_expects_an_edge_to_end_where_it_ended() -> None:
    before = spines([300.0, 350.0], [200.0, 100.0], [-0.2, 0.2])
    same = density(before, before)
    other = density(spines([330.0, 350.0], [150.0, 100.0], [-0.2, 0.2]), before)
    assert same[0] > 3.0 * other[0] and other[1] > 3.0 * other[0]


def test_the_scene_expects_a_book_beside_books_and_not_elsewhere() -> None:
    shelf = np.linspace(-0.3, -0.2, 8)
    shown = density(spines([300.0] * 8 + [420.0], [200.0] * 8 + [60.0], [*shelf, 0.3]), None)
    assert shown[-1] == pytest.approx(1.0 / 9) and (shown[:8] > 3.5).all()


def camera_at(tilt_deg: float, height_m: float) -> Camera:
    return Camera(640, 480, 500.0, 500.0, 319.5, 239.5, Mount(np.radians(tilt_deg), height_m))


def edges_of(camera: Camera, seed: int, with_ends: bool) -> Edges:
    """Return edges all over the image, some of which its border ends, and one of which nothing is known."""
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(30, 610, 25), np.sort(rng.uniform(-20, 500, (25, 2)), axis=1).clip(0, 479)[:, ::-1]
    bearing = np.arctan((u - camera.cx) / camera.fx)
    bearing[-1] = np.nan
    lean = np.arctan(np.sin(camera.mount.tilt_rad) * np.tan(bearing))
    ends_px = np.stack([np.stack([u, v[:, 0]], axis=1), np.stack([u, v[:, 1]], axis=1)], axis=1)
    sigma = rng.uniform(0.002, 0.02, 25)
    return Edges.from_columns(bearing, sigma, lean, sigma, ends_px=ends_px if with_ends else None)


def span_at(frame: Frame, bearing: Array) -> Array:
    """Return the angle (E,) at which a density per rad of bearing is that of clutter, even in the compared angle."""
    return frame.span_rad / frame.predicted(np.tan(bearing))[1]


def normal(error: Array, variance: Array | float) -> Array:
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(np.exp(-0.5 * error**2 / variance) / np.sqrt(2 * np.pi * variance))


def ends_alike(edges: Frame, others: Frame, approach: Array, sigma_px: float) -> Array:
    """Return how much likelier the ends of edges (E) are if they are those of others (B), (E, B)."""
    (now, ends), (then, earlier) = (edges.camera, edges.ends), (others.camera, others.ends)
    s, c = np.sin(then.mount.tilt_rad), np.cos(then.mount.tilt_rad)
    slope = (earlier.e * c - s) / (c + earlier.e * s)
    s, c = np.sin(now.mount.tilt_rad), np.cos(now.mount.tilt_rad)
    rise = (then.mount.height_m - now.mount.height_m) / NEAREST_M
    shift = (slope * approach[:, None] + rise) / (c - slope * s) ** 2
    variance = shift**2 / 12 + (sigma_px / now.focal_px) ** 2
    at = normal(ends.e[:, None] - (slope * c + s) / (c - slope * s) - shift / 2, variance)
    room = ends.room[:, None]
    alike = SHORT * np.minimum(room * earlier.per_length[:, None], 1.0) + (1.0 - SHORT) * room * at
    cut = np.where(earlier.cut, 1.0, SHORT)
    return np.asarray(np.where(ends.cut[:, None], cut, alike).prod(axis=2))


@pytest.mark.parametrize("kind", ["line", "slope"])
@pytest.mark.parametrize("with_ends", [True, False], ids=["ends", "no ends"])
@pytest.mark.parametrize("mount", [(15.0, 1.0), (17.0, 1.1)], ids=["same mount", "another mount"])
def test_edges_continue_those_of_an_earlier_image(kind, with_ends, mount):
    now, then = camera_at(15.0, 1.0), camera_at(*mount)
    edges, others = (
        Frame(edges_of(camera, seed, with_ends), camera, ObservationParameters(kind=kind))
        for seed, camera in ((1, now), (2, then))
    )
    image = EarlierFrame(others, np.array([0.1, -0.3, 0.05]), 1e-4)
    (bearing, sigma), (earlier, earlier_sigma), (right, back, turn) = edges.bearings, others.bearings, image.motion
    across = (right * np.cos(earlier) + back * np.sin(earlier)) / NEAREST_M
    error = wrap_angle(bearing[:, None] - (earlier + turn - across / 2))
    variance = earlier_sigma**2 + image.turn_var + across**2 / 12 + sigma[:, None] ** 2
    expected = normal(error, variance) * span_at(edges, bearing)[:, None]
    if with_ends:
        ahead = image.motion[0] * np.sin(earlier) - image.motion[1] * np.cos(earlier)
        expected *= ends_alike(edges, others, ahead / NEAREST_M, SIGMA_PX)
    expected = np.nan_to_num(expected)
    assert (expected > 1.0).sum() > 10 and not expected[-1].any()
    found, moved = continued_density(edges, image)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(moved, earlier + turn - across / 2, rtol=1e-12)


@pytest.mark.parametrize("with_ends", [True, False], ids=["ends", "no ends"])
def test_edges_of_one_image_stand_in_groups(with_ends):
    camera = camera_at(15.0, 1.0)
    edges = Frame(edges_of(camera, 3, with_ends), camera)
    bearing, sigma = edges.bearings
    density = normal(bearing[:, None] - bearing, GROUP_RAD**2 + sigma[:, None] ** 2) * span_at(edges, bearing)[:, None]
    if with_ends:
        density *= ends_alike(edges, edges, np.zeros(len(bearing)), ROW_PX)
    density = np.nan_to_num(density)
    np.fill_diagonal(density, 0.0)
    np.testing.assert_allclose(grouped_density(edges), (1.0 + density.sum(axis=1)) / len(bearing), rtol=1e-9)
