"""Make the pictures that README and the docs show of runs: report, view in a browser without a screen, floors, markers.

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
sys.path += [str(ROOT / "tests" / "support"), str(ROOT / "benchmarks")]
IMAGES = ROOT / "docs" / "images"
MADE_BY = {
    "recording.png": [ROOT / "localiser" / "view" / name for name in ("layout.py", "palette.py", "draw.py")],
    "report.png": [ROOT / "localiser" / "evaluate" / "report.py"],
} | {name: [ROOT / "benchmarks" / "board" / "shown.py"] for name in ("floors.png", "markers.png")}


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
    """Replay the log that ships, and take its report and its view; draw the others."""
    from board import shown
    from browser import page

    with TemporaryDirectory() as folder:
        for name, draw in (("floors.png", shown.lift), ("markers.png", shown.markers)):
            draw(Path(folder) / name)
            keep(Path(folder) / name, name)
        run = Path(folder) / "corridor" / "1"
        program = [sys.executable, "-m", "localiser"]
        subprocess.run([*program, "replay", ROOT / "logs" / "corridor", "--out", folder], check=True, cwd=ROOT)
        keep(run / "report.png", "report.png")
        served = subprocess.Popen([*program, "view", run, "--web"], stdout=subprocess.PIPE, text=True, cwd=ROOT)
        try:
            assert served.stdout is not None
            address = served.stdout.readline().split()[2].rstrip(",")
            with page(address, Path(folder) / "profile", (1440, 713)) as open_page:
                open_page.watch(45.0)  # by which the viewer is drawn, without a graphics card
                cv2.imwrite(str(Path(folder) / "view.png"), open_page.screenshot())
            keep(Path(folder) / "view.png", "recording.png")
        finally:
            served.kill()


if __name__ == "__main__":
    main()
