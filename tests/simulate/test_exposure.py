"""Automatic exposure, windows that shine, and lenses that scatter light."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from plain_room import camera_data, plain_room
from pydantic import ValidationError

from localiser.geometry import Trajectory
from localiser.simulate import world_of
from localiser.simulate.exposure import Exposures
from localiser.simulate.render import Scene, expose, radiance, scene_of

T_NS = np.arange(0, 6_000_000_001, 100_000_000)
AWAY, TOWARDS = np.array([0.0, 0.0, np.pi]), np.array([0.0, 0.0, 0.0])


def world_data(glow: float = 0.0, **image: Any) -> dict[str, Any]:
    """Return the room without its post and with a pane on one wall, which is a window where it glows."""
    plain = {"texture": "plain", "contrast": 0.0}
    room = plain_room(posts=[], camera=camera_data({"tilt_deg": 5.0, "height_m": 0.9}))
    pane = {"at_m": 4.0, "width_m": 3.2, "bottom_m": 0.6, "top_m": 1.8, "side": "right", "material": "pane"}
    room["walls"][2]["posters"] = [pane]
    room["materials"] = {
        "dark": {**plain, "colour": [60, 60, 60]},
        "pane": {**plain, "colour": [200, 200, 200], "glow": glow},
    }
    room["image"] |= {"exposure_s": 0.005, **image}
    return room


def scene(**changes: Any) -> Scene:
    return scene_of(world_of(world_data(**changes)))


def looking(first: np.ndarray, then: np.ndarray) -> Trajectory:
    """Return the path of a robot that turns round at once after 2 s."""
    return Trajectory(T_NS, np.where((T_NS < 2_000_000_000)[:, None], first, then))


def test_a_pane_that_glows_is_brighter_by_that_and_nothing_else_changes() -> None:
    plain, glowing = (radiance(scene(glow=glow), TOWARDS)[..., 0] for glow in (0.0, 3.0))
    pane = plain > 1.5 * np.median(plain)
    assert 200 < pane.sum() < pane.size / 2
    np.testing.assert_allclose((glowing - plain)[35, 80], 3.0 * 200.0, rtol=1e-5)
    np.testing.assert_array_equal(glowing[:, :10], plain[:, :10])


@pytest.mark.parametrize("delay_s", [0.3, 1.0])
def test_exposure_follows_the_light_with_a_delay(delay_s: float) -> None:
    dark = scene(glow=4.0, auto_exposure={"mean_grey": 110.0, "delay_s": delay_s, "exposure_max_s": 0.02})
    exposures = Exposures(dark, looking(AWAY, TOWARDS), T_NS)
    amount = np.array([exposures.of(k).amount for k in range(len(T_NS))])
    before, settled = amount[19], amount[-1]
    assert before == pytest.approx(amount[0]) and settled < 0.8 * before
    done = np.log(amount / before) / np.log(settled / before)
    assert done[20] == pytest.approx(0.0, abs=1e-9), "the image that shows the window first is exposed for the dark"
    assert (np.diff(done[20:]) >= -1e-9).all()
    after_delay = 20 + round(delay_s / 0.1)
    assert 0.3 < done[after_delay] < 0.9
    means = [
        float(expose(dark, exposures.truth, int(T_NS[k]), np.random.default_rng(0), exposures.of(k)).mean())
        for k in (19, 20, len(T_NS) - 1)
    ]
    assert means[0] == pytest.approx(110.0, abs=6.0) == means[2]
    assert means[1] > means[0] + 15.0


def test_a_dark_room_is_exposed_longer_as_far_as_that_goes_and_then_amplified() -> None:
    spec = {"mean_grey": 200.0, "delay_s": 0.5, "exposure_max_s": 0.01}
    exposure = Exposures(scene(auto_exposure=spec), looking(AWAY, AWAY), T_NS).of(0)
    assert exposure.exposure_s == pytest.approx(0.01)
    assert exposure.amount > 3.0 and exposure.gain == pytest.approx(exposure.amount / 2.0)
    steady = Trajectory(T_NS, np.tile(AWAY, (len(T_NS), 1)))
    spread = []
    for gain in (1.0, exposure.gain):
        noisy = scene(noise_sigma=2.0)
        image = expose(noisy, steady, 10**9, np.random.default_rng(1), type(exposure)(0.005, 1.0, gain))
        spread.append(float(np.std(image[:20, :20])))
    assert spread[1] == pytest.approx(spread[0] * exposure.gain, rel=0.1)


def test_without_it_every_image_is_exposed_as_the_world_says() -> None:
    exposure = Exposures(scene(), looking(AWAY, TOWARDS), T_NS).of(30)
    assert (exposure.exposure_s, exposure.amount, exposure.gain) == (0.005, 1.0, 1.0)


def test_glare_veils_what_is_near_a_window_and_keeps_the_light_together() -> None:
    still = looking(TOWARDS, TOWARDS)
    clear, veiled = (
        expose(scene(glow=0.5, glare=glare), still, 10**9, np.random.default_rng(0)).astype(float)
        for glare in (0.0, 0.2)
    )
    pane = clear > 1.5 * np.median(clear)
    assert veiled[pane].mean() < clear[pane].mean() - 5.0
    assert veiled[~pane].mean() > clear[~pane].mean() + 5.0
    assert veiled.mean() == pytest.approx(clear.mean(), rel=0.05)


def test_a_ghost_lies_opposite_to_the_window() -> None:
    aside = np.array([0.0, 0.0, 0.3])
    still = looking(aside, aside)
    clear, ghosted = (
        expose(scene(glow=3.0, ghost=ghost), still, 10**9, np.random.default_rng(0)).astype(float)
        for ghost in (0.0, 0.05)
    )
    light = radiance(scene(glow=3.0), aside)[..., 0]
    rows, columns = np.nonzero(light > 300.0)
    added = ghosted - clear
    added[light > 300.0] = 0.0  # overexposed
    ghost_rows, ghost_columns = np.nonzero(added > 0.5 * added.max())
    opposite = np.array([119 - rows.mean(), 159 - columns.mean()])
    np.testing.assert_allclose([ghost_rows.mean(), ghost_columns.mean()], opposite, atol=10.0)
    assert added.max() > 10.0


def test_auto_exposure_needs_an_exposure_to_change() -> None:
    with pytest.raises(ValidationError, match="expected it above 0"):
        world_of(world_data(exposure_s=0.0, auto_exposure={}))
