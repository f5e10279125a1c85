"""`localiser map`: build maps, show, check and edit them. Each command is one file with its arguments and steps."""

import typer

from localiser.commands.map.align import align
from localiser.commands.map.build import EXAMPLES, build
from localiser.commands.map.check import check
from localiser.commands.map.deduplicate import deduplicate
from localiser.commands.map.draw import draw
from localiser.commands.map.edit import add, move, remove
from localiser.commands.map.export import export
from localiser.commands.map.merge import merge
from localiser.commands.map.plan import plan
from localiser.commands.map.show import show
from localiser.commands.map.update import update

map_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode="markdown", help="Build landmark maps, check and edit them."
)
map_app.command(epilog=EXAMPLES)(build)
for _command, _example in (
    (show, "show maps/corridor.yaml -o corridor.png --rrd corridor.rrd"),
    (plan, "plan building.yaml -o maps/building.yaml"),
    (draw, "draw configs/worlds/office.yaml -o office_plan.yaml"),
    (check, "check maps/corridor.yaml --log logs/corridor -o coverage.png"),
    (add, "add mine.yaml --at 1.2,-3.4 --bottom 0 --top 2.05 -o better.yaml"),
    (remove, "remove mine.yaml 12 13 -o better.yaml"),
    (deduplicate, "deduplicate mine.yaml -o better.yaml"),
    (move, "move mine.yaml 12 --to 1.2,-3.4 -o better.yaml"),
    (export, "export mine.yaml --csv mine.csv"),
    (align, "align plan.yaml mine.yaml -o mine_in_plan.yaml"),
    (merge, "merge plan.yaml mine.yaml --align -o whole.yaml"),
    (update, "update mine.yaml logs/corridor -o newer.yaml"),
):
    map_app.command(epilog=f"Example: `localiser map {_example}`")(_command)
