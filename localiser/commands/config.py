"""`localiser config`: show what can be set."""

from __future__ import annotations

import typer

from localiser.commands.options import ConfigFile, Overrides

config_app = typer.Typer(no_args_is_help=True, help="Show what can be set.")


@config_app.command("show", epilog="Example: `localiser config show --config mine.yaml --set mcl.particles=500`")
def config_show(config: ConfigFile = None, overrides: Overrides = None) -> None:
    """Print the configuration in force as YAML, with the meaning, unit and range of every value."""
    from localiser.config import read_config, to_yaml

    typer.echo(to_yaml(read_config(config, overrides or [])), nl=False)
