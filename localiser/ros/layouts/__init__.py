"""Layouts that show the topics of this program: `localiser.rviz` for RViz 2, `foxglove.json` for Foxglove."""

from pathlib import Path

FOLDER = Path(__file__).parent
