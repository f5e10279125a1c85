"""Show a run in Rerun's viewer, as it happens or as it was recorded: a window, the browser, or other machines.

The viewer is a process of its own that reads the recording from its standard input, fed by a worker thread from a
bounded queue. Nothing else keeps a viewer that hangs from holding up the robot: a network sink of Rerun blocks in
`log` once its buffers are full, and blocks again when the process wants to exit.
"""

from __future__ import annotations

import atexit
import os
import re
import secrets
import signal
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from threading import Condition, Thread
from typing import TYPE_CHECKING, Any

from localiser.documents import write_all
from localiser.errors import InputError
from localiser.filter import LocatedFrame
from localiser.view.paths import Context

if TYPE_CHECKING:
    from localiser.view.recorder import Recorder

Kind = str
"""`native`, `web`, or IP:PORT of this machine, to which viewers on others connect."""

QUEUE_FRAMES = 50
"""What a viewer may lag behind: ten seconds at 5 Hz, long enough for it to start; 45 MB of 640×480 colour images."""

CLOSE_WAIT_S = 5.0
"""What a viewer that is behind gets to catch up at the end of a run."""

VIEWER_MEMORY, SERVER_MEMORY = "2GB", "512MB"
"""What viewer and server may keep; then the oldest frames go."""

_LOCALHOST = "127.0.0.1"
_WATCHED = """
import os, signal, sys, threading, time
def watch(owner):
    while os.getppid() == owner:
        time.sleep(0.5)
    os.killpg(0, signal.SIGTERM)
owner = int(sys.argv.pop(1))
if owner:
    threading.Thread(target=watch, args=(owner,), daemon=True).start()
"""
_VIEWER = "from rerun_cli.__main__ import main; sys.exit(main())"  # `-m rerun_cli` always ends with 0
_REMOTE = re.compile(r"(\[[0-9a-fA-F:]+\]|[0-9.]+|localhost):([1-9][0-9]{0,4})")


class LiveView:
    """Shows every frame of a run in a viewer, and never waits: what is too much is dropped, oldest first.

    Everything is drawn on a worker thread: the arrays handed over must not change afterwards. A viewer that is missing
    or closed ends the view, not the run.
    kind: "native" leaves its window open after the run; "web" serves a page, on this machine alone, until the process
    ends; IP:PORT serves what viewers on other machines show, which connect to `address`. command: what to run instead;
    it gets the recording on its standard input. Raises InputError for another kind.
    """

    def __init__(
        self, kind: Kind, context: Context, *, command: Sequence[str] | None = None, queue_frames: int = QUEUE_FRAMES
    ) -> None:
        self.address: str | None = None
        if command is None:
            command, self.address = viewer_command(kind)
        self._context, self._frames = context, 0
        self._queue: deque[Callable[[Recorder], None] | None] = deque(maxlen=queue_frames)
        self._changed = Condition()
        self._viewer = _start(command)
        if kind != "native" and self._viewer is not None:
            atexit.register(stop_viewer, self._viewer)
        self._worker = Thread(target=self._work, name="live view", daemon=True)
        self._worker.start()

    def frame(self, frame: LocatedFrame) -> None:
        """Show what the filter knows after one image; see `Recorder.frame`."""
        number = self._frames
        self._frames += 1
        self._draw(lambda recorder: recorder.frame(number, frame))

    def message(self, t_ns: int, text: str, level: str = "INFO") -> None:
        """Show a line in the text log."""
        self._draw(lambda recorder: recorder.message(t_ns, text, level))

    def close(self, complete: bool) -> None:
        """End the stream; waits a moment for a viewer that is behind, and leaves it running."""
        self._draw(lambda recorder: recorder.end(complete))
        self._draw(None)
        self._worker.join(CLOSE_WAIT_S)

    def wait(self) -> None:
        """Wait until the viewer is closed, which for the web is until the user interrupts."""
        if self._viewer is not None:
            self._viewer.wait()

    @property
    def is_running(self) -> bool:
        """Whether there is a viewer; one that cannot start (no display, say) ends at once."""
        return self._viewer is not None and self._viewer.poll() is None

    def _draw(self, item: Callable[[Recorder], None] | None) -> None:
        """Have something drawn, when its turn comes; None ends the stream."""
        with self._changed:
            self._queue.append(item)
            self._changed.notify()

    def _next(self) -> Callable[[Recorder], None] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._queue)
            return self._queue.popleft()

    def _work(self) -> None:
        if self._viewer is None or self._viewer.stdin is None:
            return
        import rerun as rr

        from localiser.view.layout import blueprint
        from localiser.view.recorder import Recorder, new_stream

        stream = new_stream(self._context)
        encoded = rr.binary_stream(stream)
        stream.send_blueprint(blueprint(self._context.of_first_map))
        recorder = Recorder(stream, self._context)
        try:
            while log := self._next():
                log(recorder)
                write_all(partial(os.write, self._viewer.stdin.fileno()), encoded.read() or b"")
            self._viewer.stdin.close()
        except OSError:
            # The viewer was closed: nobody looks any more, and the queue drops what comes.
            return


def check_kind(kind: Kind) -> None:
    """Raise InputError unless `kind` is one of those, or none."""
    if kind not in ("native", "web", "none"):
        _remote(kind)


def _remote(kind: Kind) -> tuple[str, str]:
    """Return IP and port."""
    remote = _REMOTE.fullmatch(kind)
    if remote is None or int(remote[2]) > 65535:
        raise InputError(f"expected native, web, none or IP:PORT, such as 0.0.0.0:9876, found {kind!r}", field="--view")
    return remote[1], remote[2]


def viewer_command(kind: Kind, recording: str = "-") -> tuple[list[str], str | None]:
    """Return the command of Rerun's viewer, and the address to watch it at.

    recording: a file; by default the viewer reads its standard input. Then a window stays when this process ends.
    """
    limits = ["--memory-limit", VIEWER_MEMORY, "--server-memory-limit", SERVER_MEMORY]
    command = [*owned_python(_VIEWER, stays=(kind, recording) == ("native", "-")), *limits]
    if kind == "native":
        return [*command, "--bind", _LOCALHOST, "--port", "auto", "--hide-welcome-screen", recording], None
    if kind == "web":
        host = _secret_host()
        port, page = _free_port(host), _free_port(host)
        address = f"http://{host}:{page}?url=rerun%2Bhttp%3A%2F%2F{host}%3A{port}%2Fproxy"
        bound = ["--bind", host, "--web-viewer", "--port", str(port), "--web-viewer-port", str(page)]
        bound += ["--cors-allow-origin", f"http://{host}:{page}"]
        return [*command, *bound, recording], address
    host, number = _remote(kind)
    host = _LOCALHOST if host == "localhost" else host
    served = ["--bind", host.strip("[]"), "--serve-grpc", "--port", number]
    return [*command, *served, recording], f"rerun+http://{host}:{number}/proxy"


def owned_python(code: str, *, stays: bool = False) -> list[str]:
    """Return the begin of a command that runs Python code, which has `sys`; its arguments follow.

    Started in a session of its own, it ends with this process, however that is ended, unless it stays.
    """
    return [sys.executable, "-c", f"{_WATCHED}{code}", str(0 if stays else os.getpid())]


def _secret_host() -> str:
    """Return an address of this machine alone that nobody can guess; the usual one where there is no other.

    Rerun serves whoever reaches it, whatever name was asked for. A page elsewhere could give its own name the address
    127.0.0.1 (DNS rebinding) and read what is shown, as if it came from there; among 16 million addresses it cannot
    find the one.
    """
    host = f"127.{secrets.randbelow(254) + 1}.{secrets.randbelow(256)}.{secrets.randbelow(254) + 1}"
    try:
        _free_port(host)
    except OSError:  # a system on which 127.0.0.1 is the only one
        return _LOCALHOST
    return host


def _free_port(host: str) -> int:
    with socket.socket() as probe:
        probe.bind((host, 0))
        return int(probe.getsockname()[1])


def _start(command: Sequence[str]) -> subprocess.Popen[bytes] | None:
    """Return the viewer's process, in a session of its own so that Ctrl-C ends the run and not the view, or None."""
    # Its output is not ours: a viewer that outlives the run would keep the shell's pipes open.
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    try:
        return subprocess.Popen(command, bufsize=0, start_new_session=True, **pipes)
    except OSError:
        return None


def stop_viewer(viewer: subprocess.Popen[bytes]) -> None:
    """End a viewer that was started in a session of its own, if it still runs."""
    # The group: Rerun's command starts the viewer as a child of its own.
    if viewer.poll() is None:
        os.killpg(viewer.pid, signal.SIGTERM)


class RecordingViewer:
    """The viewer of a recording (.rrd), a process of its own.

    kind: "native" or "web", see `LiveView`. address: of the page, for the web. Raises OSError when it cannot start.
    """

    def __init__(self, recording: Path, kind: Kind) -> None:
        command, self.address = viewer_command(kind, str(recording.resolve()))
        environment = {"RUST_LOG": "error", **os.environ}  # else it reports every port that it opens
        self._process = subprocess.Popen(command, start_new_session=True, env=environment)

    def wait(self) -> bool:
        """Wait until the viewer is closed, or the user interrupts, which closes it; return whether it could start."""
        try:
            return self._process.wait() == 0
        except KeyboardInterrupt:
            return True
        finally:
            stop_viewer(self._process)
