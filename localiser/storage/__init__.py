"""Every file format: logs, cameras, maps, trajectories, results."""

from localiser.storage.bags import KINDS, write_bag
from localiser.storage.bags.label import motion_settings
from localiser.storage.cameras import camera_error, camera_file, load_camera, save_camera, update_mount
from localiser.storage.checkpoint import checkpoint_bytes, checkpoint_of, identity_of
from localiser.storage.files import output_errors, require_new, require_new_file, write_bytes, write_text
from localiser.storage.folder import FolderReader, write_log
from localiser.storage.images import (
    MAX_IMAGE_BYTES,
    Image,
    ImageEvent,
    check_whole,
    decoded,
    encode_image,
    load_image,
    measure,
)
from localiser.storage.log import Event, Frame, Log, LogReader, ReadOptions
from localiser.storage.maps import load_map, save_map
from localiser.storage.open import FORMATS, open_log
from localiser.storage.packing import fingerprint
from localiser.storage.plans import is_plan, load_plan, plan_picture, save_plan
from localiser.storage.runs import LATEST, RunFolder, find_run, json_text, load_json, safe_name
from localiser.storage.tracks import TrackWriter, load_track
from localiser.storage.trajectories import load_poses, load_tum, save_poses, save_tum
from localiser.storage.video import read_video

__all__ = [
    "FORMATS",
    "KINDS",
    "LATEST",
    "MAX_IMAGE_BYTES",
    "Event",
    "FolderReader",
    "Frame",
    "Image",
    "ImageEvent",
    "Log",
    "LogReader",
    "ReadOptions",
    "RunFolder",
    "TrackWriter",
    "camera_error",
    "camera_file",
    "check_whole",
    "checkpoint_bytes",
    "checkpoint_of",
    "decoded",
    "encode_image",
    "find_run",
    "fingerprint",
    "identity_of",
    "is_plan",
    "json_text",
    "load_camera",
    "load_image",
    "load_json",
    "load_map",
    "load_plan",
    "load_poses",
    "load_track",
    "load_tum",
    "measure",
    "motion_settings",
    "open_log",
    "output_errors",
    "plan_picture",
    "read_video",
    "require_new",
    "require_new_file",
    "safe_name",
    "save_camera",
    "save_map",
    "save_plan",
    "save_poses",
    "save_tum",
    "update_mount",
    "write_bag",
    "write_bytes",
    "write_log",
    "write_text",
]
