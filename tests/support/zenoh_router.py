"""A router of zenoh as a process, so that it can be killed.

python zenoh_router.py ENDPOINT
"""

import sys

from live_networks import router

if __name__ == "__main__":
    with router(sys.argv[1]):
        sys.stdout.write("{}\n")
        sys.stdout.flush()
        sys.stdin.read()
