"""Convert images of ROS messages to image files: compressed ones as they are, raw ones to PNG without loss."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from localiser.image_files import eight_bits, measure
from localiser.storage.images import MAX_IMAGE_BYTES, Image, encode_image

# What a raw image becomes, and the bytes of a pixel. Bayer and YUV become colour.
_BYTES = {"mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4, "mono16": 2, "16UC1": 2}
_TO_BGR = {"rgb8": cv2.COLOR_RGB2BGR, "rgba8": cv2.COLOR_RGBA2BGR, "bgra8": cv2.COLOR_BGRA2BGR}
_BAYER = ("RGGB", "BGGR", "GBRG", "GRBG")
_BYTES |= {f"bayer_{pattern.lower()}8": 1 for pattern in _BAYER}
_TO_BGR |= {f"bayer_{pattern.lower()}8": getattr(cv2, f"COLOR_Bayer{pattern}2BGR") for pattern in _BAYER}
_YUV = {"yuv422": "UYVY", "uyvy": "UYVY", "yuv422_yuy2": "YUY2", "yuyv": "YUY2", "nv12": "NV12", "nv21": "NV21"}
_BYTES |= {name: 2 for name, layout in _YUV.items() if not layout.startswith("NV")}
_TO_BGR |= {name: getattr(cv2, f"COLOR_YUV2BGR_{layout}") for name, layout in _YUV.items()}
_DEEP = ("mono16", "16UC1")  # whole numbers, become grey values of 8 bits by the range that they use
ENCODINGS = (*_BYTES, "nv12", "nv21")


def shows_light(message: Any, *, is_deep: bool) -> bool:
    """Whether a message shows light, not depth. is_deep: whether whole numbers of 16 bits are distances."""
    if not hasattr(message, "encoding"):
        return "compressedDepth" not in message.format
    return "FC" not in message.encoding and not (is_deep and message.encoding in _DEEP)


def stated_size(message: Any) -> tuple[int, int]:
    """Return the size (width, height) that a message says its image has. Raises ValueError when it cannot be one."""
    if not hasattr(message, "encoding"):
        return measure(message.data.tobytes())[0]
    _check_raw(message)
    return int(message.width), int(message.height)


def image_file(message: Any) -> bytes:
    """Return the image of a sensor_msgs Image or CompressedImage as a JPEG or PNG file. Raises ValueError."""
    if not hasattr(message, "encoding"):
        return bytes(message.data)
    return encode_image(_pixels(message), ".png", 100)


def grey_image(message: Any) -> Image | None:
    """Return a raw image as (H, W) uint8 grey values, the same as those of its file; None for a compressed one.

    Raises ValueError.
    """
    if not hasattr(message, "encoding"):
        return None
    pixels = _pixels(message)
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY) if pixels.ndim == 3 else pixels, dtype=np.uint8)


def _check_raw(message: Any) -> None:
    """Raise ValueError unless an Image has as many bytes as its size and encoding ask for."""
    encoding, width, height, step = message.encoding, message.width, message.height, message.step
    if encoding not in ENCODINGS:
        raise ValueError(f"expected an encoding of {', '.join(ENCODINGS)}, found {encoding[:40]!r}")
    planar = encoding not in _BYTES
    if min(width, height) < 1 or (encoding in _YUV and width % 2) or (planar and height % 2):
        raise ValueError(f"expected an image that {encoding} can hold, found {width}×{height} pixels")
    least = width * _BYTES.get(encoding, 1)
    rows = height * 3 // 2 if planar else height
    if step < least:
        raise ValueError(f"expected rows of at least {least} bytes for {width} pixels of {encoding}, found {step}")
    if len(message.data) != step * rows:
        raise ValueError(f"expected {rows} rows of {step} bytes, found {len(message.data)} bytes")
    if len(message.data) > MAX_IMAGE_BYTES:
        raise ValueError(f"expected at most {MAX_IMAGE_BYTES} bytes, found {len(message.data)}")


def _pixels(message: Any) -> Image:
    """Return an Image as (H, W) grey or (H, W, 3) BGR uint8, the rows' padding cut off."""
    _check_raw(message)
    encoding = message.encoding
    channels = _BYTES.get(encoding, 1)
    rows = message.data.reshape(-1, message.step)[:, : message.width * channels]
    if encoding in _DEEP:
        kind = ">u2" if message.is_bigendian else "<u2"
        return eight_bits(np.ascontiguousarray(rows).view(kind))
    pixels = np.ascontiguousarray(rows.reshape(len(rows), message.width, channels) if channels > 1 else rows)
    code = _TO_BGR.get(encoding)
    return np.asarray(pixels if code is None else cv2.cvtColor(pixels, code), dtype=np.uint8)
