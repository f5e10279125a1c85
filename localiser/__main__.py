"""`python -m localiser` and the command `localiser`."""

import gc
import signal
import sys

from localiser import commands as cli


def main() -> None:
    """Run the command line; SIGTERM and SIGHUP end it as an error would, so that nothing half-written stays behind."""
    gc.set_threshold(10_000)  # the default, 700, costs a quarter of a second of imports before the first image
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:  # as `nohup` has it
            signal.signal(number, lambda number, _: sys.exit(128 + number))
    cli.main()


if __name__ == "__main__":
    main()
