"""Wide tables go on below, with the columns that tell the rows apart, and no word is broken."""

from __future__ import annotations

import pytest
from rich.console import Console
from rich.table import Table

from localiser.commands.tables import fit_width


def wide() -> Table:
    table = Table(title="Turns", caption="A note on all of them")
    for column in ("camera", "method", *(f"quantity{n}" for n in range(9))):
        table.add_column(column, justify="right")
    for camera in ("640×480", "176×144"):
        for method in ("columns", "Hough"):
            table.add_row(camera, method, *(f"{camera[:3]}.{method[0]}{n}" for n in range(9)))
    return table


@pytest.mark.parametrize("width", [80, 120, 200])
def test_wide_tables_go_on_below_and_lose_nothing(width: int) -> None:
    console = Console(width=width, color_system=None)
    pieces = fit_width(wide(), console)
    assert (len(pieces) == 1) == (width == 200)
    with console.capture() as capture:
        for piece in pieces:
            console.print(piece)
    text = capture.get()
    assert max(map(len, text.splitlines())) <= width
    assert {f"quantity{n}" for n in range(9)} <= set(text.split())
    assert {f"{camera}.{method}{n}" for camera in ("640", "176") for method in "cH" for n in range(9)} <= set(
        text.split()
    )
    assert text.count("Hough") == 2 * len(pieces), "each piece says which row is which"
    assert text.count("Turns") == text.count("A note") == 1


@pytest.mark.parametrize("width", [80, 120])
def test_a_list_of_texts_stays_one_table_and_breaks_no_word(width: int) -> None:
    table = Table(box=None, show_header=False)
    text = "no message on /odom within 5 s; does the robot publish it, and is it connected to the same router?"
    table.add_row("ok", "zenoh", "a router answers at tcp/127.0.0.1:7447")
    table.add_row("missing", "odometry", text)
    console = Console(width=width, color_system=None)
    (piece,) = fit_width(table, console)
    with console.capture() as capture:
        console.print(piece)
    printed = capture.get()
    assert max(map(len, printed.splitlines())) <= width
    assert set(text.split()) <= set(printed.split())
