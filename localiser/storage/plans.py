"""Read and write floor plans of ROS `map_server`: a YAML file and a picture (PGM, PNG) seen from above."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from localiser.documents import load, read_bytes, validate
from localiser.errors import InputError, warn
from localiser.image_files import PNG_SIGNATURE, decode, measure
from localiser.mapping import MOST_CELLS, FloorPlan, Mask
from localiser.storage.files import CAMERA, MAP, PLAN, kind_of, refuse_other

UNKNOWN_GREY = 205  # as map_saver writes it
_MAX_BYTES = 4 * MOST_CELLS + 2**16  # four characters a cell in a PGM of text
_PGM_HEAD = re.compile(rb"(P[25])" + 3 * rb"(?:\s|#[^\n]*\n)+(\d{1,99})" + rb"(?:[ \t]*#[^\n]*)?\s")
Picture = NDArray[Any]
_PNG_COLOUR_TYPE, _GREY_AND_ALPHA = 25, 4  # where a PNG says how it is coloured


class PlanFile(BaseModel):
    """The YAML file of a map_server map; other keys are ignored, as ROS does."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)

    image: Annotated[str, Field(min_length=1)]
    resolution: Annotated[float, Field(ge=1e-3, le=10.0)]
    origin: Annotated[list[Annotated[float, Field(ge=-1e8, le=1e8)]], Field(min_length=3, max_length=3)]
    negate: Annotated[int, Field(ge=0, le=1)]
    occupied_thresh: Annotated[float, Field(ge=0, le=1)]
    free_thresh: Annotated[float, Field(ge=0, le=1)]
    mode: Literal["trinary", "scale", "raw"] = "trinary"

    @model_validator(mode="after")
    def _thresholds_apart(self) -> PlanFile:
        if self.free_thresh >= self.occupied_thresh:
            raise ValueError(
                f"expected free_thresh below occupied_thresh, found {self.free_thresh:g} and {self.occupied_thresh:g}"
            )
        return self


def is_plan(path: Path) -> bool:
    """Whether a YAML file describes a floor plan, and not a landmark map. Raises InputError."""
    if kind_of(path) in (MAP, CAMERA):
        return False
    content = load(path).value
    return isinstance(content, dict) and "image" in content and "format" not in content


def read_plan(path: Path) -> FloorPlan:
    """Return the floor plan that a map_server YAML file describes; its image may lie anywhere. Raises InputError."""
    refuse_other(path, PLAN, ", the YAML file beside its picture")
    document = load(path)
    file = validate(document, PlanFile)
    image = path.parent / file.image
    data = read_bytes(image, _MAX_BYTES)
    try:
        picture = _read_pgm(data) if data.startswith((b"P2", b"P5")) else _read_png(data)
    except ValueError as error:
        raise InputError(str(error), path=image) from None
    occupied, free = classify(picture, file)
    unknown = np.count_nonzero(picture.mean(axis=2) == (255 - UNKNOWN_GREY if file.negate else UNKNOWN_GREY))
    if file.mode == "trinary" and unknown and file.free_thresh > (255 - UNKNOWN_GREY) / 255:
        taken = f"{unknown} pixels of grey {UNKNOWN_GREY} are unknown, as map_saver writes them"
        warn(f"{taken}, though free_thresh says that they are free", path=path)
    # Row 0 of the picture is the farthest along y.
    return FloorPlan(occupied[::-1], free[::-1], file.resolution, np.array(file.origin))


def classify(picture: Picture, file: PlanFile) -> tuple[Mask, Mask]:
    """Return which pixels (H, W) are walls, and which are free floor, by map_server's rules.

    picture: (H, W, C) values 0 to 255 of grey, grey and alpha, colour, or colour and alpha. p = (255 - mean) / 255 is
    how surely a pixel is a wall. In `scale` what lies between the thresholds is a wall when nearer to it; where it is
    transparent, it is unknown. In `raw` the values are percentages, and those over 100 are unknown. In `trinary` grey
    205 is unknown whatever the thresholds: map_saver writes it, and many maps have a free_thresh above it.
    """
    channels = picture.shape[2]
    has_alpha = channels in (2, 4)
    # ROS takes alpha for one more colour in trinary mode.
    colours = channels - 1 if has_alpha and file.mode != "trinary" else channels
    mean = picture[..., :colours].mean(axis=2, dtype=np.float32)
    mean = 255.0 - mean if file.negate else mean
    percent = np.round(mean)
    if file.mode == "raw":
        known, wall = percent <= 100, percent / 100
        return known & (wall >= file.occupied_thresh), known & (wall <= file.free_thresh)
    wall = (255.0 - mean) / 255.0
    occupied, free = wall > file.occupied_thresh, wall < file.free_thresh
    if file.mode == "trinary":
        free &= mean != UNKNOWN_GREY
    if file.mode == "scale":
        between = ~occupied & ~free & ((picture[..., -1] == 255) | (not has_alpha))
        likely = wall >= (file.occupied_thresh + file.free_thresh) / 2
        occupied, free = occupied | (between & likely), free | (between & ~likely)
    return occupied, free


# -- the picture, as (H, W, C) values 0 to 255; what is wrong is found before memory is taken for it ------------------


def _read_pgm(data: bytes) -> Picture:
    head = _PGM_HEAD.match(data)
    if head is None:
        raise ValueError("expected the head of a PGM picture (P5, width, height, largest value), found another")
    columns, rows, largest = (int(head[k]) for k in (2, 3, 4))
    _check_cells(columns, rows)
    if not 1 <= largest <= 65535:
        raise ValueError(f"expected a PGM picture with a largest value of 1 to 65535, found {largest}")
    body = data[head.end() :]
    dtype = np.dtype(np.uint8 if largest < 256 else ">u2")
    whole = len(body) // dtype.itemsize
    values: Picture = _text_values(body) if head[1] == b"P2" else np.frombuffer(body, dtype, count=whole)
    if len(values) < rows * columns:
        raise ValueError(f"expected {columns}×{rows} pixels, as its head says, found {len(values)}: it is cut off")
    values = values[: rows * columns].reshape(rows, columns, 1)
    if values.max() > largest:
        raise ValueError(f"expected values up to {largest}, as its head says, found {values.max()}")
    return values if largest == 255 else values * np.float32(255.0 / largest)


def _text_values(body: bytes) -> Picture:
    words = re.sub(rb"#[^\n]*", b"", body).split()
    if not all(word.isdigit() and len(word) < 6 for word in words):
        raise ValueError("expected numbers in a PGM picture of text, found something else")
    return np.array(words, dtype=np.int32)


def _read_png(data: bytes) -> Picture:
    if not data.startswith(PNG_SIGNATURE):
        raise ValueError("expected a PGM or PNG picture, found " + ("an empty file" if not data else "something else"))
    (columns, rows), complete = measure(data)
    _check_cells(columns, rows)
    if not complete:
        raise ValueError("expected a whole picture, found one that is cut off or damaged")
    picture = decode(data, cv2.IMREAD_UNCHANGED)
    if picture is None or picture.shape[:2] != (rows, columns):
        raise ValueError("expected a picture that can be decoded")
    picture = picture.reshape(rows, columns, -1)
    if data[_PNG_COLOUR_TYPE] == _GREY_AND_ALPHA and picture.shape[2] == 4:
        picture = picture[..., [0, 3]]
    return picture if picture.dtype == np.uint8 else picture * np.float32(255.0 / 65535.0)


def _check_cells(columns: int, rows: int) -> None:
    if not 1 <= columns * rows <= MOST_CELLS:
        raise ValueError(f"expected a picture of 1 to {MOST_CELLS} pixels, found {columns}×{rows}")
