"""Every file format: logs, cameras, maps, trajectories, results."""

from localiser.storage.bags import KINDS, write_bag
from localiser.storage.bags.label import motion_settings
from localiser.storage.cameras import camera_error, camera_file, load_camera, save_camera, update_mount
from localiser.storage.folder import write_log
from localiser.storage.images import Image, ImageEvent
from localiser.storage.log import Event, Frame, Log, LogReader
from localiser.storage.maps import load_map, save_map
from localiser.storage.open import FORMATS, open_log
from localiser.storage.runs import LATEST, RunFolder, find_run, json_text, load_json
from localiser.storage.tracks import TrackWriter, load_track
from localiser.storage.trajectories import load_poses, load_tum, save_poses, save_tum

__all__ = [
    "FORMATS",
    "KINDS",
    "LATEST",
    "Event",
    "Frame",
    "Image",
    "ImageEvent",
    "Log",
    "LogReader",
    "RunFolder",
    "TrackWriter",
    "camera_error",
    "camera_file",
    "find_run",
    "json_text",
    "load_camera",
    "load_json",
    "load_map",
    "load_poses",
    "load_track",
    "load_tum",
    "motion_settings",
    "open_log",
    "save_camera",
    "save_map",
    "save_poses",
    "save_tum",
    "update_mount",
    "write_bag",
    "write_log",
]
