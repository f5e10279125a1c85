"""Coverage-guided fuzzing of readers with atheris: inputs that reach new code are kept and changed further.

    pip install atheris                                  # wheels for Linux; not a dependency of the project
    python benchmarks/fuzz.py csv -max_total_time=300    # and yaml, bag, message; options of libFuzzer follow
    python benchmarks/fuzz.py bag results/fuzz/bag -seed=1 -max_total_time=300   # a folder keeps what was found

Readers end with a value or with an error of this program; anything else stops with the input in a file `crash-…`. In
Python, only modules of `localiser` and `rosbags` count as code that is reached.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import atheris

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]

with atheris.instrument_imports(include=["localiser.documents", "localiser.storage", "rosbags"]):
    from localiser.documents import parse
    from localiser.errors import LocaliserError
    from localiser.storage import open_log, read_poses
    from localiser.storage.bags.bag import CAMERA_INFO, COMPRESSED, ODOMETRY, TRANSFORMS, bag_errors, typestore
    from localiser.storage.cameras import camera_from_document
    from localiser.storage.maps import map_from_document

FOLDER = Path(tempfile.mkdtemp())
TYPES = (COMPRESSED, ODOMETRY, TRANSFORMS, CAMERA_INFO)
STORE = typestore(ros1=False)
for _type in (*TYPES, "std_msgs/msg/Header", "geometry_msgs/msg/TransformStamped", "geometry_msgs/msg/Pose"):
    for _name in ("deserialize_cdr_le", "deserialize_cdr_be"):  # code that rosbags writes for each type
        atheris.instrument_func(getattr(STORE.get_msgdef(_type), _name))


def csv(data: bytes) -> None:
    """Read a table of poses."""
    path = FOLDER / "poses.csv"
    path.write_bytes(data)
    read_poses(path)


def yaml(data: bytes) -> None:
    """Read a map or a camera."""
    document = parse(data[1:].decode(errors="replace"), "input")
    (map_from_document if data[:1] < b"\x80" else camera_from_document)(document)


def bag(data: bytes) -> None:
    """Read a bag in MCAP with all its images."""
    path = FOLDER / "bag.mcap"
    path.write_bytes(data)
    for event in open_log(path).frames:
        event.load()  # type: ignore[union-attr]


def message(data: bytes) -> None:
    """Decode a message, whose first byte says of which type."""
    with bag_errors(Path("input")):
        STORE.deserialize_cdr(data[1:], TYPES[data[0] % len(TYPES)] if data else ODOMETRY)


def seeds(name: str, folder: Path) -> None:
    """Write good inputs into a folder, from which the first changes are made."""
    import live_feed
    from small_bag import Recorder
    from small_bag import bag as written

    folder.mkdir(parents=True, exist_ok=True)
    corridor = ROOT / "logs" / "corridor"
    if name == "csv":
        lines = (corridor / "odometry.csv").read_bytes().splitlines(keepends=True)
        (folder / "odometry").write_bytes(b"".join(lines[:5]))
    if name == "yaml":
        (folder / "map").write_bytes(b"\0" + (ROOT / "maps" / "corridor.yaml").read_bytes()[:600])
        (folder / "camera").write_bytes(b"\xff" + (corridor / "camera.yaml").read_bytes())
    if name == "message":
        for place, content in enumerate(live_feed.camera()):
            (folder / f"camera{place}").write_bytes(bytes([3 - place]) + content.content)
        (folder / "odometry").write_bytes(b"\1" + live_feed.odometry(0).content)
    if name == "bag":
        made = written(FOLDER / "seed", lambda recorder: Recorder.image(recorder, 10**8), "mcap")
        (folder / "bag").write_bytes(next(made.glob("*.mcap")).read_bytes())


def attempted(reader: Callable[[bytes], None]) -> Callable[[bytes], None]:
    """Return what reads an input, and is silent about an error that is told."""

    def attempt(data: bytes) -> None:
        with suppress(LocaliserError):
            reader(data)

    return attempt


def main() -> None:
    name, *options = sys.argv[1:] or ["--help"]
    readers = {"csv": csv, "yaml": yaml, "bag": bag, "message": message}
    if name not in readers:
        raise SystemExit(__doc__)
    found = next((Path(option) for option in options if not option.startswith("-")), FOLDER / "found")
    seeds(name, found)
    rest = [option for option in options if option.startswith("-")]
    atheris.Setup([sys.argv[0], *rest, str(found)], attempted(readers[name]))
    atheris.Fuzz()


if __name__ == "__main__":
    main()
