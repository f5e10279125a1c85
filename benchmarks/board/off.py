"""Mechanisms of the filter that `--off` switches off, while it is decided which of them pay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from typing import Any

import numpy as np

Patch = Callable[[], None]


def _set(path: str, value: Any) -> Patch:
    """Return what replaces an attribute, written `package.module:name` or `package.module:Class.name`."""

    def patch() -> None:
        module, _, name = path.partition(":")
        owner: Any = import_module(f"localiser.{module}")
        *classes, attribute = name.split(".")
        for one in classes:
            owner = getattr(owner, one)
        if not hasattr(owner, attribute):
            raise AttributeError(f"localiser.{path} is gone: mend board/off.py")
        setattr(owner, attribute, value)

    return patch


def _all(*patches: Patch) -> Patch:
    def patch() -> None:
        for one in patches:
            one()

    return patch


def _never_carried() -> None:
    from localiser.filter.scene import Scene

    followed = Scene.followed

    def without(self: Any, *arguments: Any) -> Any:
        scene, density, jump = followed(self, *arguments)
        return scene, density, replace(jump, log_ratio=0.0)

    Scene.followed = without  # type: ignore[method-assign]


MECHANISMS: dict[str, Patch] = {
    "map-error": _set("filter.mcl:_map_error", lambda mcl, state, *_: state.map_error),
    "map-decorrelation": _set("filter.map_error:MapError.decorrelation", 1.0),
    "height": _all(
        _set("filter.mcl:_height_with_poses", lambda mcl, state, *_: state.height),
        _set("filter.mcl:_height", lambda mcl, state, *_: state.height),
    ),
    "height-with-poses": _set("filter.mcl:_height_with_poses", lambda mcl, state, *_: state.height),
    "near-landmarks": _set("observation.place_landmarks:PlaceLandmarks.log_odds", 0.0),
    "visibility": _set("observation.place_landmarks:PlaceLandmarks.shown", lambda self, landmarks: np.ones(landmarks)),
    "wheels-check": _set("filter.mcl:_contradicted", lambda *_: None),
    "jump": _never_carried,
    "persistent-clutter": _set("filter.mcl:persistent_clutter", lambda *_: None),
    "scene-clutter": _set("filter.scene:scene_clutter", lambda now, _: np.ones((2, len(now.edges)))),
    "polarity": _set("observation.frame:MEAN_POLARITY", 0.0),
    "history": _set("relocalisation.candidates:SCENES", 1),
    "fourth-root": _set("relocalisation.candidates:EVENNESS", 1.0),
    "limits": _set("filter.belief:SUPPORTED", np.inf),
    "omega": _set("relocalisation.global_localisation:PLACE_POWER", 1.0),
    "attitude": _set("filter.attitude:Level.levelled", lambda self, attitude, edges, *_: (edges, attitude)),
    "optimal-proposal": _set(
        "filter.optimal_proposal:OptimalProposal.moved",
        lambda self, cloud, step, increment, motion, rng: motion.predict(cloud, increment, rng),
    ),
    "tempering-stages": _all(_set("filter.tempering:MOST_STAGES", 1), _set("filter.optimal_proposal:MOST_STAGES", 0)),
}


def switch_off(names: str) -> None:
    """Switch off mechanisms, whose names are separated by commas, in this process. Raises KeyError."""
    for name in filter(None, names.split(",")):
        MECHANISMS[name]()
