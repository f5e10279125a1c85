"""EdgeDrawing of opencv-contrib as an outside reference: it runs in an environment of its own, never a dependency.

As a script, run by that environment, it answers on standard output what it reads on standard input. A request is an
image: threads, height, width (int32) and the pixels. An answer is the seconds that the search took, the number of
lines (float64 each) and the lines (x1, y1, x2, y2).
"""

from __future__ import annotations

import subprocess
import sys
import time
import venv
from pathlib import Path

import numpy as np

PACKAGE = "opencv-contrib-python-headless"


class EdgeDrawing:
    """The other side of the script. overhead_s: how much longer than the search itself all requests took so far."""

    def __init__(self, folder: Path, threads: int = 1) -> None:
        """Start the script in the environment at `folder`, which is made when there is none."""
        python = folder / "bin" / "python"
        if not python.exists():
            venv.create(folder, with_pip=True)
            subprocess.run([python, "-m", "pip", "install", "--quiet", PACKAGE], check=True)
        self.threads, self.overhead_s = threads, 0.0
        self._process = subprocess.Popen([python, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def lines(self, image: np.ndarray) -> np.ndarray:
        """Return the lines (S, 4) of a grey image (H, W)."""
        start = time.perf_counter()
        assert self._process.stdin and self._process.stdout
        self._process.stdin.write(np.array([self.threads, *image.shape], dtype=np.int32).tobytes() + image.tobytes())
        self._process.stdin.flush()
        seconds, count = np.frombuffer(self._process.stdout.read(16))
        lines = np.frombuffer(self._process.stdout.read(32 * int(count))).reshape(-1, 4)
        self.overhead_s += time.perf_counter() - start - seconds
        return lines


def main() -> None:
    import cv2

    drawing = cv2.ximgproc.createEdgeDrawing()
    while head := sys.stdin.buffer.read(12):
        threads, height, width = (int(value) for value in np.frombuffer(head, dtype=np.int32))
        image = np.frombuffer(sys.stdin.buffer.read(height * width), dtype=np.uint8).reshape(height, width)
        cv2.setNumThreads(threads)
        start = time.perf_counter()
        drawing.detectEdges(image)
        found = drawing.detectLines()
        seconds = time.perf_counter() - start
        lines = np.zeros((0, 4)) if found is None else np.asarray(found, dtype=np.float64).reshape(-1, 4)
        sys.stdout.buffer.write(np.array([seconds, len(lines)]).tobytes() + lines.tobytes())
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()
