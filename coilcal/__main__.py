"""The command `coilcal`, also as `python -m coilcal`."""

from __future__ import annotations

import sys

import click

from coilcal import check_packages


def main() -> None:
    """Run the command; where `estimator` or `drivers` is another distribution's, say so and end with exit code 2."""
    try:
        check_packages()
    except ImportError as error:
        click.echo(f"coilcal: {error}", err=True)
        sys.exit(2)
    from estimator.cli.main import main as command

    command(prog_name="coilcal")


if __name__ == "__main__":
    main()
