"""Read and write every file format: logs, cameras, maps, trajectories, results."""

from localiser.documents import output_errors, write_bytes, write_text
from localiser.storage.bags import check_start, motion_settings, write_bag
from localiser.storage.cameras import camera_error, lens_problem, read_camera, write_camera
from localiser.storage.checkpoint import checkpoint_bytes, checkpoint_of, identity_of
from localiser.storage.files import is_video, require_new, require_new_file
from localiser.storage.folder import FolderReader, write_log
from localiser.storage.images import MAX_IMAGE_BYTES, Image, ImageEvent, check_whole, decoded, encode_image, read_image
from localiser.storage.log import Event, Log, LogReader, ReadOptions, jump_text, require_odometry, thinned
from localiser.storage.maps import Site, map_text, read_map, read_maps, write_map
from localiser.storage.open import FORMATS, open_log, read_world, simulate_log
from localiser.storage.plans import is_plan, read_plan
from localiser.storage.runs import (
    CHOICE,
    LATEST,
    RunFolder,
    csv_text,
    find_run,
    json_text,
    read_figures,
    read_json,
    read_runs,
    safe_name,
)
from localiser.storage.tables import csv_of
from localiser.storage.trajectories import TrackWriter, read_poses, read_track, write_poses, write_tum
from localiser.storage.video import open_stream, read_video
