"""Read and write every file format: logs, cameras, maps, trajectories, results."""

from localiser.documents import output_errors, write_bytes, write_text
from localiser.storage.bags import KINDS, check_start, write_bag
from localiser.storage.bags.recorded import motion_settings
from localiser.storage.cameras import camera_error, read_camera, write_camera
from localiser.storage.checkpoint import checkpoint_bytes, checkpoint_of, identity_of
from localiser.storage.files import require_new, require_new_file
from localiser.storage.folder import FolderReader, write_log
from localiser.storage.images import (
    MAX_IMAGE_BYTES,
    Image,
    ImageEvent,
    check_whole,
    decoded,
    encode_image,
    read_image,
)
from localiser.storage.kinds import is_video
from localiser.storage.log import Event, Log, LogReader, ReadOptions, jump_text, require_odometry, thinned
from localiser.storage.maps import map_text, read_map, write_map
from localiser.storage.open import FORMATS, open_log
from localiser.storage.packing import decode, encode, fingerprint
from localiser.storage.plans import is_plan, read_plan
from localiser.storage.run_tables import CHOICE, csv_text, read_figures, read_runs, write_runs_csv
from localiser.storage.runs import LATEST, RunFolder, find_run, json_text, read_json, safe_name
from localiser.storage.tables import csv_of
from localiser.storage.tracks import TrackWriter, read_track
from localiser.storage.trajectories import read_poses, write_poses, write_tum
from localiser.storage.video import open_stream, read_video
from localiser.storage.worlds import read_world, simulate_log
