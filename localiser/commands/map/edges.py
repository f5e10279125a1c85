"""The edges of a whole log, kept in a cache, because finding them takes most of the time of building a map."""

from __future__ import annotations

import hashlib
import io
import os
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from localiser import camera as camera_module
from localiser import edges as edges_package
from localiser import geometry as geometry_module
from localiser.camera import Camera
from localiser.edges import CommonError, EdgeParameters, Edges, find_edges
from localiser.errors import OutputError
from localiser.filter import Sighting
from localiser.storage import ImageEvent, Log, write_bytes

_COLUMNS = tuple(field.name for field in fields(Edges) if field.name not in ("common", "rejected_px"))
_KEPT_MAPS = 50  # files that the cache holds; the oldest go


def edges_of_log(
    log: Log,
    parameters: EdgeParameters,
    progress: Callable[[], None],
    cache: Path | None = None,
    watch: Callable[[int, Edges], None] | None = None,
) -> list[Edges]:
    """Return the edges of every frame of a log, from the cache where they were found before.

    The cache is keyed by the images' bytes, the camera, the parameters and the program that finds edges; it is never
    in the log's folder. cache: its folder, by default `cache_folder()`. watch: gets the edges of each frame, with its
    time, as soon as they are known. Raises InputError for a bad image.
    """
    found = []
    for t_ns, edges in _found(log, parameters, cache or cache_folder()):
        found.append(edges)
        if watch is not None:
            watch(t_ns, edges)
        progress()
    return found


def _found(log: Log, parameters: EdgeParameters, cache: Path) -> Iterator[tuple[int, Edges]]:
    """Yield time and edges of every frame; those of images are kept when all are found."""
    if not log.has_images:
        for frame in log.frames:
            assert isinstance(frame, Sighting)
            yield frame.t_ns, frame.edges
        return
    images = [frame for frame in log.frames if isinstance(frame, ImageEvent)]
    path = cache / f"{_key(images, log.camera, parameters)}.npz"
    known = _load(path, len(images))
    if known is not None:
        yield from zip((image.t_ns for image in images), known, strict=True)
        return
    found = []
    for image in images:
        # What was rejected is only looked at; the profile of a map is what it is built from.
        found.append(_without_rejected(find_edges(image.load(), log.camera, parameters)))
        yield image.t_ns, found[-1]
    _save(path, found)


def cache_folder() -> Path:
    """Return where edges are kept: `$LOCALISER_CACHE`, else `localiser/edges` in the user's cache folder."""
    if stated := os.environ.get("LOCALISER_CACHE"):
        return Path(stated)
    user = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(user) / "localiser" / "edges"


def _key(images: Sequence[ImageEvent], camera: Camera, parameters: EdgeParameters) -> str:
    """Return a digest of all that the edges depend on."""
    digest = hashlib.sha256()
    for source in _sources():
        digest.update(source.read_bytes())
    values = {field.name: getattr(camera, field.name) for field in fields(camera)}
    digest.update(repr((sorted(values.items(), key=lambda item: item[0]), parameters)).encode())
    for image in images:
        digest.update(hashlib.sha256(image.encoded()).digest())
    return digest.hexdigest()[:32]


def _sources() -> list[Path]:
    """Return the files of the program that decide what is found: a change to one makes the cache old."""
    package = Path(str(edges_package.__file__)).parent
    return [*sorted(package.rglob("*.py")), Path(camera_module.__file__), Path(geometry_module.__file__)]


def _without_rejected(edges: Edges) -> Edges:
    return Edges(**{name: getattr(edges, name) for name in _COLUMNS}, common=edges.common)


def _save(path: Path, frames: Sequence[Edges]) -> None:
    """Write the edges whole or not at all. A cache that cannot be written is no reason to fail."""
    filled = [edges for edges in frames if len(edges)]
    content = {"count": np.array([len(edges) for edges in frames])}
    for name in _COLUMNS:
        content[name] = np.concatenate([getattr(edges, name) for edges in filled]) if filled else np.zeros(0)
    for name in ("bearing_from_lean", "bearing_from_line"):
        parts = [getattr(edges.common, name) for edges in filled]
        content[name] = np.concatenate(parts) if parts else np.zeros(0)
    content["common_cov"] = np.array([edges.common.cov for edges in filled])
    content["common_names"] = np.array(filled[0].common.names if filled else ())
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **content)
    try:
        write_bytes(path, buffer.getvalue())
        _forget_oldest(path.parent)
    except OutputError:
        return


def _forget_oldest(folder: Path) -> None:
    files = sorted(folder.glob("*.npz"), key=lambda file: file.stat().st_mtime)
    for file in files[:-_KEPT_MAPS]:
        file.unlink(missing_ok=True)


def _load(path: Path, frames: int) -> list[Edges] | None:
    """Return the edges of all frames; None when the file is missing or not what was written."""
    try:
        with np.load(path, allow_pickle=False) as content:
            return _unpacked({name: content[name] for name in content.files}, frames)
    except (OSError, EOFError, ValueError, KeyError, IndexError, zipfile.BadZipFile):
        return None


def _unpacked(content: dict[str, np.ndarray], frames: int) -> list[Edges] | None:
    count = content["count"]
    if len(count) != frames:
        return None
    names = tuple(str(name) for name in content["common_names"])
    first = np.concatenate([[0], np.cumsum(count)])
    result, filled = [], 0
    for frame in range(frames):
        if count[frame] == 0:
            result.append(Edges.none())
            continue
        rows = slice(int(first[frame]), int(first[frame + 1]))
        common = CommonError(
            names,
            content["common_cov"][filled],
            content["bearing_from_lean"][rows],
            content["bearing_from_line"][rows],
        )
        result.append(Edges(**{name: content[name][rows] for name in _COLUMNS}, common=common))
        filled += 1
    return result
