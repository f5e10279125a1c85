"""What looks for line segments in an image: the protocol of a detector, and the list of those that are known by name.

`find_edges` takes any detector. To choose one by its name in a configuration (`edges.detector`), register it:

    def mine(image, camera):
        return lines  # (S, 4): u, v of one end, u, v of the other, in pixels of the image

    edges = find_edges(image, camera, detector=mine)
    register("mine", mine)
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

from numpy.typing import ArrayLike

from localiser.camera import Camera
from localiser.edges.segments import Segments
from localiser.edges.undistort import Image
from localiser.errors import InputError

if TYPE_CHECKING:
    from localiser.edges.parameters import EdgeParameters


class Detector(Protocol):
    """A function, or an object that is called, that finds straight line segments in a grey image."""

    def __call__(self, image: Image, camera: Camera, /) -> Segments | ArrayLike:
        """Return the segments of a grey image (H, W), uint8, that `camera` took; those that are not vertical too.

        Either lines (S, 4), S of them: the ends u1, v1, u2, v2 in pixels of the image as it was taken, in any order,
        taken to err by `END_SIGMA_PX` across the line. Or `Segments`, which state their errors, in undistorted pixels.
        """


@runtime_checkable
class Configurable(Protocol):
    """The optional ability of a registered detector to take settings from a configuration."""

    def configured(self, parameters: EdgeParameters) -> Detector:
        """Return the detector with these settings."""


DETECTORS: dict[str, Detector] = {}
"""All detectors that a configuration can name, by their names."""


def register(name: str, detector: Detector) -> None:
    """Make a detector known by a name for `edges.detector`. Raises ValueError when the name is taken."""
    if name in DETECTORS:
        raise ValueError(f"expected a new name of a detector, found {name!r}, which is taken")
    DETECTORS[name] = detector


def registered(name: str) -> str:
    """Return the name of a detector. Raises ValueError when there is none of that name."""
    if name not in DETECTORS:
        *others, last = (repr(known) for known in DETECTORS)
        raise ValueError(f"expected {', '.join(others)} or {last}")
    return name


def detector_of(parameters: EdgeParameters) -> Detector:
    """Return the registered detector that the parameters name, with their settings. Raises InputError."""
    try:
        detector = DETECTORS[registered(parameters.detector)]
    except ValueError as error:
        raise InputError(f"{error}, found {parameters.detector!r}", field="detector") from None
    return detector.configured(parameters) if isinstance(detector, Configurable) else detector
