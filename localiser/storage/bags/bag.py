"""Open a bag of any kind: its messages in the order of recording, which topics it has, and which of them is what.

Messages are decoded by the definitions that ROS ships, never by those that a bag carries: a bag could define anything.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any

from localiser.documents import nearest, open_regular, parse, read_text, require_regular
from localiser.errors import InputError, LocaliserError
from localiser.storage.bags.database import BESIDE, MAGIC, Database, beside, restored_copy
from localiser.storage.bags.messages import typestore
from localiser.storage.bags.records import (
    Allowance,
    BrokenOffError,
    Packed,
    Records,
    RosType,
    check_topics,
    records_of,
    zstd,
)
from localiser.storage.bags.transforms import stamp_of
from localiser.storage.files import inside

METADATA_FILE = "metadata.yaml"
MAX_METADATA_BYTES = 4 * 2**20
SUFFIXES = (".bag", ".mcap", ".db3", ".active")  # the last one of a recorder of ROS 1 that did not end
MOST_TRANSFORMS_BYTES = 2**20  # of a message; thousands of transforms, each of which takes 2 kB once it is read
_NUMBERED = re.compile(r"(?:.*_)?(\d+)\.(?:mcap|db3)")  # files of a bag as ROS 2 names them


@dataclass(frozen=True, slots=True, eq=False)
class Topic:
    """A topic of a bag: name, type of its messages, and how many there are."""

    name: str
    msgtype: str
    count: int


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """A message as recorded. t_ns: when it was recorded, which is not when it was measured. content: its fields.

    place: where it stands in the bag, for `Bag.messages`.
    """

    topic: str
    msgtype: str
    t_ns: int
    content: Any
    place: tuple[int, int, int]

    @property
    def stamp_ns(self) -> int:
        """When it was measured, by its header."""
        return stamp_of(self.content)


class Bag:
    """A bag that is open for reading, one pass at a time; to be used as a context manager, or closed.

    broken: why the last pass ended before the bag's end; empty where it did not.
    """

    def __init__(self, path: Path) -> None:
        """Open a bag and read which topics it has. Raises InputError."""
        self.path, self.broken = path, ""
        self._files, self._mode = _files_of(path)
        sizes: dict[tuple[int, int], int] = {}
        for each in (beside(file, end) for file in self._files for end in ("", *BESIDE)):
            with suppress(OSError):  # a bag that is being recorded may lose its journal at any time
                found = each.stat()
                sizes[found.st_dev, found.st_ino] = found.st_size
        self._size = sum(sizes.values())
        self._reader: tuple[int, Records | Database] | None = None
        self._closing = ExitStack()
        try:
            with bag_errors(path):
                counts: Counter[tuple[str, str]] = Counter()
                for number in range(len(self._files)):
                    counts.update(self._open(number, Allowance(self._size)).topics())
                check_topics(len(counts))
        except BaseException:
            self.close()
            raise
        self.topics = [Topic(*key, count) for key, count in sorted(counts.items())]
        """The topics, by name; a topic that several nodes published on is one."""

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the bag."""
        self._closing.close()

    def messages(self, topics: Collection[Topic], first: tuple[int, int, int] = (0, 0, 0)) -> Iterator[Message]:
        """Yield the messages of some topics in the order of recording, from a place on.

        Where a file cannot be read on, `broken` says why. Raises InputError for a message that its type cannot be read
        from, and for a bag that asks for too much.
        """
        wanted = {(topic.name, topic.msgtype) for topic in topics}
        allowance, self.broken = Allowance(self._size), ""
        for number in range(first[0], len(self._files) if wanted else 0):
            with bag_errors(self.path):
                try:
                    records = self._open(number, allowance)
                    for found in records.messages(first[1:] if number == first[0] else (0, 0)):
                        channel = found.channel
                        if (channel.topic, channel.msgtype) in wanted:
                            content = self._decoded(found, allowance)
                            place = number, *found.place
                            yield Message(channel.topic, channel.msgtype, found.t_ns, content, place)
                except BrokenOffError as error:
                    where = f"{self._files[number].name}: " if len(self._files) > 1 else ""
                    self.broken = self.broken or f"{where}{error}"

    def _open(self, number: int, allowance: Allowance) -> Records | Database:
        """Return the reader of one of the files; the one before is closed."""
        if self._reader is None or self._reader[0] != number:
            self._closing.close()
            path = self._files[number] if self._mode != "file" else self._unpacked(self._files[number], allowance)
            file = self._closing.enter_context(open_regular(path, "bag"))
            reader: Records | Database
            if file.read(len(MAGIC)) == MAGIC:
                reader = Database(self._closing.enter_context(restored_copy(path)), allowance)
                self._closing.callback(reader.close)
            else:
                file.seek(0)
                reader = records_of(file, allowance)
            self._reader = number, reader
        self._reader[1].allowance = allowance
        return self._reader[1]

    def _unpacked(self, path: Path, allowance: Allowance) -> Path:
        """Return a copy of a file that is compressed as a whole, which lasts until the file is closed."""
        whole = Path(self._closing.enter_context(TemporaryDirectory(prefix="localiser-")), path.stem)
        with path.open("rb") as packed, zstd().ZstdFile(packed) as source, whole.open("wb") as copy:
            while piece := source.read(2**20):
                allowance.spend(len(piece))
                copy.write(piece)
        return whole

    def _decoded(self, found: Packed, allowance: Allowance) -> Any:
        data, is_whole, channel = bytes(found.data), True, found.channel
        where = f"{channel.topic} at {found.t_ns} ns"
        with bag_errors(self.path, where):
            if self._mode == "message":
                data, is_whole = allowance.unpacked(zstd().ZstdDecompressor(), data)
            if channel.msgtype == RosType.TRANSFORMS and len(data) > MOST_TRANSFORMS_BYTES:
                raise ValueError(f"expected at most {MOST_TRANSFORMS_BYTES} bytes, found {len(data)}")
            if channel.encoding not in ("cdr", "ros1"):
                raise ValueError(f"expected messages as ROS packs them, cdr or ros1, found {channel.encoding!r:.40}")
            store = typestore(ros1=channel.encoding == "ros1")
        try:
            decode = store.deserialize_cdr if channel.encoding == "cdr" else store.deserialize_ros1
            return decode(data, channel.msgtype)
        except Exception as error:  # whatever bytes that are no message make of a decoder
            reason = "it is cut off" if not is_whole else " ".join(str(error).split())[:200] or type(error).__name__
            raise BrokenOffError(f"{where}: expected a message that can be read: {reason}") from error


def _files_of(path: Path) -> tuple[list[Path], str]:
    """Return the files of a bag in their order, and what of it is compressed one by one: file, message or nothing.

    Aliases in its metadata are refused: a few lines of them can stand for gigabytes. Raises InputError.
    """
    if not path.exists():
        raise InputError("no such bag", path=path)
    if not path.is_dir():
        require_regular(path, "bag")
        return [path], ""
    if not (path / METADATA_FILE).exists():
        return files_by_number(path), ""
    metadata = parse(read_text(path / METADATA_FILE, MAX_METADATA_BYTES), str(path / METADATA_FILE))
    key = ("rosbag2_bagfile_information", "relative_file_paths")
    found = metadata.value.get(key[0]) if isinstance(metadata.value, dict) else None
    about = found if isinstance(found, dict) else {}
    names = about.get(key[1])
    if not isinstance(names, list) or not names:
        raise metadata.error(key, "expected the names of a bag's files")
    files, seen = [], set()
    for place, name in enumerate(names):
        try:
            file = inside(path, PurePath(str(name)).name)
        except ValueError as error:
            raise metadata.error((*key, place), str(error)) from None
        if (real := os.path.realpath(file)) in seen:
            raise metadata.error((*key, place), "expected each file once, found one twice")
        if not file.exists():
            raise metadata.error((*key, place), f"expected a file of the bag's folder, found none named {file.name!r}")
        require_regular(file)
        seen.add(real)
        files.append(file)
    mode, squeeze = (str(about.get(f"compression_{name}") or "").lower() for name in ("mode", "format"))
    if mode in ("file", "message") and squeeze != "zstd":
        raise metadata.error(key[:1], f"expected a bag that is compressed by zstd, found {squeeze!r:.40}")
    return files, mode


def files_by_number(path: Path) -> list[Path]:
    """Return the files of a folder that by their names are one bag, which its recorder did not come to describe."""
    found = [(int(match[1]), file) for file in path.iterdir() if (match := _NUMBERED.fullmatch(file.name))]
    return [file for _, file in sorted(found)]


@contextmanager
def bag_errors(path: Path, field: str | None = None) -> Iterator[None]:
    """Turn whatever a damaged bag makes libraries raise into an InputError.

    They promise no list of exceptions: bytes that were changed show up as errors of struct, sqlite, numpy or YAML.
    """
    try:
        yield
    except (LocaliserError, GeneratorExit):
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        what = "message" if field else "ROS bag"
        raise InputError(f"expected a {what} that can be read: {reason}", path=path, field=field) from None


LOG_TOPIC, MAP_TOPIC = "/localiser/log", "/localiser/map"
CAMERA_TOPIC, DECISIONS_TOPIC = "/localiser/camera", "/localiser/decisions"
STATE_TOPIC, IMU_TOPIC = "/localiser/state", "/localiser/imu"
OUR_NAMES = "/localiser/"
"""What is in the names of this program's own topics, in any namespace: no source of images, unless asked for."""
LABEL_TOPICS = (LOG_TOPIC, MAP_TOPIC, CAMERA_TOPIC, DECISIONS_TOPIC, STATE_TOPIC)
_POSES = (RosType.ODOMETRY, RosType.POSE, "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped")
TYPES = {
    "image": (RosType.IMAGE, RosType.COMPRESSED),
    "camera_info": (RosType.CAMERA_INFO,),
    "odometry": _POSES,
    "groundtruth": _POSES,
    "imu": (RosType.IMU,),
}
IMAGE_KINDS = ("image_raw", "image_rect")
"""Images by what was done to them: their lens distortion is as the camera took them, or undone."""
TIMES = "times"
"""A choice that is no topic: `times=recorded` takes when messages were recorded, not the stamps in their headers."""
_TRUTH = re.compile(r"ground_?truth|(?:^|[/_])(?:gt|truth|mocap|vicon|optitrack|qualisys)(?:[/_]|$)", re.IGNORECASE)
_MOST_LISTED = 12


def choose(
    path: Path,
    topics: Sequence[Topic],
    asked: Mapping[str, str],
    stated: Mapping[str, str],
    is_picture: Callable[[Topic], bool] = lambda topic: True,
) -> dict[Topic, str]:
    """Return the topics of a log and what each is for; one that this program adds to a bag stands for itself.

    asked: names by what they are for, which come before any guess; of images also by IMAGE_KINDS. stated: the same,
    as the bag says. is_picture: whether the images of a topic show light, not depth.

    Poses whose name says ground truth are the truth, if they are the only ones; a frame of /tf can be asked for in
    place of a topic. Of several camera_info the one nearest to the image is taken, as ROS names them. An inertial
    sensor is taken only where it was asked for. Raises InputError that lists the choices when several fit or none does.
    """
    asked = {"image" if role in IMAGE_KINDS else role: name for role, name in asked.items() if role != TIMES}
    for role in asked:
        if role not in TYPES:
            raise InputError(f"unknown kind of topic; {nearest(role, [*TYPES, TIMES])}", field="--topic")
    of_type = {
        role: [topic for topic in topics if topic.msgtype in types and topic.count] for role, types in TYPES.items()
    }
    names = {role: {topic.name for topic in found} for role, found in of_type.items()}
    stated = {role: name for role, name in stated.items() if name not in asked.values()}
    asked = {role: name for role, name in stated.items() if name in names.get(role, ())} | asked
    transforms = {
        role: [
            topic
            for topic in topics
            if topic.msgtype == RosType.TRANSFORMS
            and (topic.name.rsplit("/", 1)[-1] == ending or topic.name == stated.get(role))
        ]
        for role, ending in (("moving_transforms", "tf"), ("transforms", "tf_static"))
    }

    def one(role: str, fitting: Sequence[Topic]) -> Topic | None:
        """Return the topic that was asked for, else the only one that fits, None where none does."""
        if role in asked:
            fitting = [topic for topic in of_type[role] if topic.name == asked[role]][:1]
            if not fitting and not (role == "groundtruth" and transforms["moving_transforms"]):
                found = _listed(of_type[role]) or "none of that type"
                raise InputError(f"expected one of the topics {found}, found {asked[role]!r}", path=path, field=role)
        if len(fitting) > 1:
            advice = f"choose with --topic {role}={fitting[0].name}"
            raise InputError(f"several topics fit: {_listed(fitting)}; {advice}", path=path)
        return fitting[0] if fitting else None

    def required(role: str, fitting: Sequence[Topic]) -> Topic:
        if topic := one(role, fitting):
            return topic
        found = _listed(topics) or "no topic at all"
        raise InputError(f"expected a topic of {' or '.join(TYPES[role][:2])}, found {found}", path=path, field=role)

    image = required("image", [] if "image" in asked else _pictures(of_type["image"], is_picture))
    wheels = [topic for topic in of_type["odometry"] if topic.name != asked.get("groundtruth")]
    truths = [topic for topic in wheels if _TRUTH.search(topic.name) and topic.name != asked.get("odometry")]
    wheels = [topic for topic in wheels if topic.msgtype == RosType.ODOMETRY and topic not in truths]
    single = {
        "image": image,
        "odometry": required("odometry", wheels),
        "camera_info": one("camera_info", _nearest_to(image.name, of_type["camera_info"])),
        "groundtruth": one("groundtruth", truths if len(truths) == 1 else []),
        "imu": one("imu", [topic for topic in of_type["imu"] if topic.name == IMU_TOPIC]),
    }
    roles = {topic: role for role, topic in single.items() if topic is not None}
    roles |= {topic: role for role, found in transforms.items() for topic in found}
    return roles | {
        topic: topic.name for topic in topics if topic.msgtype == RosType.TEXT and topic.name in LABEL_TOPICS
    }


def choice_text(roles: Mapping[Topic, str], topics: Sequence[Topic]) -> str:
    """Return in one line what was chosen, and which topics say by their name that they are a truth and are not used."""
    chosen = [f"{role} {topic.name}" for topic, role in roles.items() if role in TYPES or role.endswith("transforms")]
    spare = [one for one in topics if one.msgtype in _POSES and _TRUTH.search(one.name) and one not in roles]
    more = f"; not used: {_listed(spare)}, see --topic groundtruth={spare[0].name}" if spare else ""
    return f"taken: {', '.join(chosen)}{more}"


def _pictures(images: Sequence[Topic], is_picture: Callable[[Topic], bool]) -> list[Topic]:
    """Return the topics that may be the camera's: pictures, which are not our own, without copies of one that is there.

    Where there are others, names that speak of depth are not proposed.
    """
    found = [topic for topic in images if OUR_NAMES not in topic.name and is_picture(topic)]
    names = {topic.name for topic in found}
    found = [topic for topic in found if topic.name.removesuffix("/compressed") not in names - {topic.name}]
    return [topic for topic in found if not speaks_of_depth(topic.name)] or found


def speaks_of_depth(name: str) -> bool:
    """Whether the name of a topic has a word for images of distances."""
    return bool({"depth", "disparity", "compresseddepth"} & set(re.split(r"[/_]", name.lower())))


def _nearest_to(image: str, infos: Sequence[Topic]) -> Sequence[Topic]:
    """Return the camera_info beside the image, or beside what was compressed; all where none is near."""
    parent = image.rsplit("/", 1)[0]
    for place in (parent, parent.rsplit("/", 1)[0]):
        if beside := [topic for topic in infos if topic.name == f"{place}/camera_info"]:
            return beside
    return infos


def _listed(topics: Sequence[Topic]) -> str:
    """Return names and types for a message, not more than can be read."""
    shown = [f"{topic.name} ({topic.msgtype.rsplit('/', 1)[-1]}, {topic.count})" for topic in topics[:_MOST_LISTED]]
    more = [f"and {len(topics) - _MOST_LISTED} more"] if len(topics) > _MOST_LISTED else []
    return ", ".join([*shown, *more])
