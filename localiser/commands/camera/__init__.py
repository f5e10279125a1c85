"""`localiser camera`: find tilt and roll, the offset of clocks, and the lens. Each command is one file."""

import typer

from localiser.commands.camera import calibrate, sync, tilt

camera_app = typer.Typer(
    no_args_is_help=True, help="Find out where the camera looks, and what its lens does.", rich_markup_mode="markdown"
)
for _module, _command in ((tilt, tilt.tilt), (sync, sync.sync), (calibrate, calibrate.calibrate)):
    camera_app.command(epilog=_module.EPILOG)(_command)
