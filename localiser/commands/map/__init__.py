"""`localiser map`: build maps, show, check and merge them. Each command is one file with its arguments and steps."""

import typer

from localiser.commands.map.build import EXAMPLES, build
from localiser.commands.map.check import check
from localiser.commands.map.merge import align, merge
from localiser.commands.map.plan import plan
from localiser.commands.map.show import show
from localiser.commands.map.update import update

map_app = typer.Typer(
    no_args_is_help=True, rich_markup_mode="markdown", help="Build landmark maps, check and merge them."
)
map_app.command(epilog=EXAMPLES)(build)
for _command, _example in (
    (show, "show maps/corridor.yaml -o corridor.png"),
    (plan, "plan building.yaml -o maps/building.yaml"),
    (check, "check maps/corridor.yaml --log logs/corridor -o coverage.png"),
    (align, "align plan.yaml mine.yaml -o mine_in_plan.yaml"),
    (merge, "merge plan.yaml mine.yaml --align -o whole.yaml"),
    (update, "update mine.yaml logs/corridor -o newer.yaml"),
):
    map_app.command(epilog=f"Example: `localiser map {_example}`")(_command)
