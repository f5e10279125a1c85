"""Make the pictures of a run that README and the docs show: the report, and the view in a browser without a screen.

    python docs/make_pictures.py             # needs chromium; takes some minutes

Each picture tells by which code it was made; a test holds that it is this version's.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
from PIL import Image
from PIL.PngImagePlugin import PngInfo

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))
IMAGES = ROOT / "docs" / "images"
MADE_BY = {
    "recording.png": [ROOT / "localiser" / "view" / name for name in ("layout.py", "palette.py", "draw.py")],
    "report.png": [ROOT / "localiser" / "evaluate" / "report.py"],
}
SIZE = (1440, 713)
SECONDS = 45.0  # by which the viewer is drawn, without a graphics card


def version_of(name: str) -> str:
    """Return the digest of the code that a picture is made by, but for its imports."""
    nodes = [node for path in MADE_BY[name] for node in ast.parse(path.read_bytes()).body]
    kept = [ast.unparse(node) for node in nodes if not isinstance(node, ast.Import | ast.ImportFrom)]
    return sha256("\n".join(kept).encode()).hexdigest()[:16]


def keep(picture: Path, name: str) -> None:
    """Write a picture to the docs with its version in it."""
    about = PngInfo()
    about.add_text("localiser", version_of(name))
    image = Image.open(picture).convert("RGB").quantize(256, dither=Image.Dither.NONE)
    image.save(IMAGES / name, pnginfo=about, optimize=True)


def main() -> None:
    """Replay the log that ships, and take its report and its view."""
    from browser import page

    with TemporaryDirectory() as folder:
        run = Path(folder) / "corridor" / "1"
        command = [sys.executable, "-m", "localiser", "replay", ROOT / "logs" / "corridor", "--out", folder]
        subprocess.run(command, check=True, cwd=ROOT)
        keep(run / "report.png", "report.png")
        served = subprocess.Popen(
            [sys.executable, "-m", "localiser", "view", run, "--web"], stdout=subprocess.PIPE, text=True, cwd=ROOT
        )
        try:
            assert served.stdout is not None
            address = served.stdout.readline().split()[2].rstrip(",")
            with page(address, Path(folder) / "profile", SIZE) as open_page:
                open_page.watch(SECONDS)
                cv2.imwrite(str(Path(folder) / "view.png"), open_page.screenshot())
            keep(Path(folder) / "view.png", "recording.png")
        finally:
            served.kill()


if __name__ == "__main__":
    main()
