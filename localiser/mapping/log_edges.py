"""The edges of a whole log, kept in a cache, because finding them takes most of the time of building a map."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from localiser import camera as camera_module
from localiser import edges as edges_package
from localiser import geometry as geometry_package
from localiser.camera import Camera
from localiser.documents import drafted
from localiser.edges import CommonError, EdgeParameters, Edges, find_edges
from localiser.errors import OutputError
from localiser.filter import Sighting
from localiser.geometry import Twist
from localiser.mapping.recorded import RecordedImage, RecordedLog

# What was rejected is only looked at; a map is not built from it.
_WHOLE = ("common", "rejected_px", "mount", "height_sigma_m")  # of an image, not of each edge
_COLUMNS = tuple(field.name for field in fields(Edges) if field.name not in _WHOLE)
_SHARED = ("bearing_from_lean", "bearing_from_line")
_PACKED = (*_COLUMNS, *_SHARED)
_OUR_NAME = re.compile(r"edges-[0-9a-f]{32}\.npz")
_KEPT_FILES = 50  # that the cache holds; the oldest go


def edges_of_log(
    log: RecordedLog,
    parameters: EdgeParameters,
    progress: Callable[[int, Edges], None] | None = None,
    cache: Path | None = None,
) -> list[Edges]:
    """Return the edges of every frame of a log. Raises InputError for a bad image.

    progress: gets the time and the edges of each frame as soon as they are known. cache: a folder, such as
    `cache_folder()`, in which edges are kept and looked up by the images' bytes, the camera, the parameters and the
    program that finds edges; None: nothing is kept.
    """
    found = []
    for t_ns, edges in _found(log, parameters, cache):
        found.append(edges)
        if progress is not None:
            progress(t_ns, edges)
    return found


def _found(log: RecordedLog, parameters: EdgeParameters, cache: Path | None) -> Iterator[tuple[int, Edges]]:
    """Yield time and edges of every frame; those of images are kept when all are found."""
    images: list[RecordedImage] = []
    for frame in log.frames:
        if isinstance(frame, Sighting):
            yield frame.t_ns, frame.edges
        else:
            images.append(frame)
    twists = [log.twist_at(image.t_ns) for image in images]
    path = cache / f"edges-{_key(images, twists, log.camera, parameters)}.npz" if cache and images else None
    known = _load(path, len(images)) if path else None
    if known is not None:
        for image, edges in zip(images, known, strict=True):
            yield image.t_ns, replace(edges, mount=image.mount)
        return
    found = []
    for image, twist in zip(images, twists, strict=True):
        edges = find_edges(image.load(), log.camera, parameters, mount=image.mount, twist=twist)
        found.append(Edges(**{name: getattr(edges, name) for name in _COLUMNS}, common=edges.common, mount=image.mount))
        yield image.t_ns, found[-1]
    if path and len({edges.common.names for edges in found if len(edges)}) <= 1:
        _save(path, found)


def cache_folder() -> Path:
    """Return where edges are kept: `$LOCALISER_CACHE/edges`, else `localiser/edges` in the user's cache folder."""
    if stated := os.environ.get("LOCALISER_CACHE"):
        return Path(stated) / "edges"
    user = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(user) / "localiser" / "edges"


def _key(
    images: Sequence[RecordedImage], twists: Sequence[Twist | None], camera: Camera, parameters: EdgeParameters
) -> str:
    """Return a digest of all that the edges depend on."""
    digest = hashlib.sha256()
    for source in _sources():
        digest.update(source.read_bytes())
    values = {field.name: getattr(camera, field.name) for field in fields(camera)}
    digest.update(repr((sorted(values.items(), key=lambda item: item[0]), parameters)).encode())
    for image, twist in zip(images, twists, strict=True):
        for part in (image.mount, twist):
            if part is not None:
                digest.update(repr(part).encode())
        digest.update(hashlib.sha256(image.encoded()).digest())
    return digest.hexdigest()[:32]


def _sources() -> list[Path]:
    """Return the files of the program that decide what is found: a change to one makes the cache old."""
    package = Path(str(edges_package.__file__)).parent
    return [
        *sorted(package.rglob("*.py")),
        Path(camera_module.__file__),
        *sorted(Path(str(geometry_package.__file__)).parent.rglob("*.py")),
    ]


def _save(path: Path, frames: Sequence[Edges]) -> None:
    """Write the edges whole or not at all. A cache that cannot be written is no reason to fail."""
    filled = [edges for edges in frames if len(edges)] or [Edges.none()]
    content = {name: np.concatenate([getattr(edges, name) for edges in filled]) for name in _COLUMNS}
    content |= {name: np.concatenate([getattr(edges.common, name) for edges in filled]) for name in _SHARED}
    content["cov"] = np.array([edges.common.cov for edges in filled])
    content["names"] = np.array(filled[0].common.names, dtype=str)
    content["count"] = np.array([len(edges) for edges in frames])
    with suppress(OutputError, OSError):
        with drafted(path) as draft, draft.open("xb") as file:
            np.savez(file, allow_pickle=False, **content)
        ours = [kept for kept in path.parent.glob("*.npz") if _OUR_NAME.fullmatch(kept.name)]
        for kept in sorted(ours, key=lambda kept: kept.stat().st_mtime)[:-_KEPT_FILES]:
            kept.unlink(missing_ok=True)


def _load(path: Path, frames: int) -> list[Edges] | None:
    """Return the edges of all frames; None when the file is missing or not what was written."""
    try:
        with np.load(path, allow_pickle=False) as content:
            columns: dict[str, Any] = {name: content[name] for name in content.files}
        count = columns["count"]
        whole = count.dtype.kind == "i" and len(count) == frames and (count >= 0).all()
        rows = max(int(count.sum()), 0) if whole else -1
        right = whole and all(len(columns[name]) == rows and columns[name].dtype.kind in "fiub" for name in _PACKED)
        return _unpacked(columns, count) if right or rows == 0 else None
    except Exception:  # whatever a damaged file makes of the readers of numpy and zip
        return None


def _unpacked(columns: dict[str, Any], count: np.ndarray) -> list[Edges]:
    names, first = tuple(map(str, columns["names"])), np.concatenate([[0], np.cumsum(count)])
    cov = iter(columns["cov"])
    result = []
    for begin, end in pairwise(first):
        if begin == end:
            result.append(Edges.none())
            continue
        common = CommonError(names, next(cov), *(columns[name][begin:end] for name in _SHARED))
        result.append(Edges(**{name: columns[name][begin:end] for name in _COLUMNS}, common=common))
    return result
