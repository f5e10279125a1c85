"""`python -m localiser` and the command `localiser`."""

import gc
import os
import signal
import sys

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy is imported: several threads add up in another order

from localiser import commands as cli


def main() -> None:
    """Run the command line; SIGTERM and SIGHUP end it as an error would, so that nothing half-written stays behind."""
    gc.set_threshold(10_000)  # the default, 700, costs a quarter of a second of imports before the first image
    numbers = [
        getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)
    ]  # Windows has no SIGHUP
    ends = [number for number in numbers if signal.getsignal(number) is not signal.SIG_IGN]  # as `nohup` has it

    def end(number: int, _: object) -> None:
        for each in ends:
            signal.signal(each, signal.SIG_IGN)  # a second one would leave half of what the first has removed
        sys.exit(128 + number)

    for number in ends:
        signal.signal(number, end)
    cli.main()


if __name__ == "__main__":
    main()
