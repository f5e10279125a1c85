"""Compile, or load, the loops that most tests need: once, before workers begin that would all compile the same."""

from itertools import takewhile

from folders import ROOT

from localiser.config import read_config
from localiser.filter import Odometry
from localiser.localiser import Localiser
from localiser.storage import ImageEvent, open_log

IMAGES = 3


def main() -> None:
    """Localise along the first images of the log that ships, in all the ways that have loops of their own."""
    log = open_log(ROOT / "logs" / "corridor")
    assert log.landmark_map is not None
    few = ["mcl.particles=100", "mcl.start_particles=100"]
    for kind in ("line", "slope"):
        config = read_config(None, [*few, f"observation.kind={kind}"], log.settings)
        localiser = Localiser(log.landmark_map, log.camera, config)
        localiser.warm_up()
        localiser.start(log.start.mean, log.start.cov)
        for event in takewhile(lambda event: event.t_ns <= log.frames[IMAGES].t_ns, log.events()):
            if isinstance(event, Odometry):
                localiser.odometry(event.t_ns, event.pose)
            elif isinstance(event, ImageEvent):
                localiser.image(event.t_ns, event.encoded())
        localiser.finish()


if __name__ == "__main__":
    main()
