"""Replay logs whose images are taken anew in other light, from the true start: RMSE, and how sure the filter was.

python benchmarks/light_replays.py                                  the rendered logs in LOCALISER_DATA
python benchmarks/light_replays.py --logs bookstore --lights plain "gain 2.5" --seeds 0 1 2
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from edge_light import LIGHTS, Light
from figures.program import run
from rich.console import Console
from rich.table import Table

KINDS = ("plain", "gain 0.15", "gain 2.5", "noise 20", "blur 3 px")


def log_in_light(source: Path, folder: Path, light: Light) -> Path:
    """Write a log folder with all its images changed to `folder`, which is returned; nothing is lost by packing."""
    folder.mkdir()
    for file in source.iterdir():
        if file.is_file():
            shutil.copy(file, folder)
    names, *rows = (source / "images.csv").read_text(encoding="utf-8").splitlines()
    at = names.split(",").index("file")
    written = [names]
    for index, row in enumerate(rows):
        cells = row.split(",")
        image = cv2.imread(str(source / cells[at]), cv2.IMREAD_GRAYSCALE)
        cells[at] = f"{index:06d}.png"
        cv2.imwrite(str(folder / cells[at]), light.taken(image, np.random.default_rng([0, index])))
        written.append(",".join(cells))
    (folder / "images.csv").write_text("\n".join(written) + "\n", encoding="utf-8")
    return folder


def replayed(log: Path, seed: int, observation: str) -> dict[str, float]:
    """Return the RMSE (m), the fraction of images that are sure, and that of those that are sure and wrong."""
    with TemporaryDirectory() as name:
        out = Path(name) / "out"
        asked = ("--start", "truth", "--observation", observation, "--seed", seed, "--out", out, "--quiet", "--no-rrd")
        run("replay", log, *asked, cache=Path(name) / "cache")
        (file,) = out.glob("*/1/metrics.json")
        metrics = json.loads(file.read_text(encoding="utf-8"))
    sure = metrics["confidence"]
    return {"rmse_m": metrics["position_rmse_m"], "sure": sure["sure"], "wrong": sure["sure_and_wrong"]}


def main() -> None:
    options = arguments()
    table = Table("log", "light", "seed", "RMSE m", "sure", "sure and wrong", title=f"Replays, {options.observation}")
    for name in options.logs:
        for kind in options.lights:
            with TemporaryDirectory() as place:
                log = log_in_light(options.data / name, Path(place) / "log", LIGHTS[kind])
                for seed in options.seeds:
                    told = replayed(log, seed, options.observation)
                    cells = (f"{told['rmse_m']:.4f}", f"{told['sure']:.2f}", f"{told['wrong']:.3f}")
                    table.add_row(name, kind, str(seed), *cells)
    Console(width=100).print(table)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", nargs="+", default=["house", "bookstore"], help="folders of LOCALISER_DATA")
    parser.add_argument("--lights", nargs="+", default=list(KINDS), choices=list(LIGHTS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--observation", default="line", choices=["line", "slope"])
    default_data = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("LOCALISER_DATA", default_data)))
    return parser.parse_args()


if __name__ == "__main__":
    main()
