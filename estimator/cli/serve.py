"""`coilcal serve`: the service over HTTP, and its tokens."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from estimator.cli.interruption import interrupted_by
from estimator.cli.options import MOST_PROCESSES, PATH, flag, json_option, option
from estimator.cli.output import CoilcalCommand, CoilcalGroup, explained_errors, needing, show, use_threads
from estimator.errors import InvalidInput

if TYPE_CHECKING:
    from estimator.service.database import Database
    from estimator.service.settings import Settings

SHARED = ("config", "data")  # options of the group that its subcommands have too


def _of_group(ctx: click.Context, param: click.Parameter, value: Path | None) -> Path | None:
    """The value of an option, or that of the group in front of the subcommand; given in both places, one would be ignored."""
    outer = ctx.parent
    while outer is not None and outer.command is not serve_group:
        outer = outer.parent
    given = None if outer is None else outer.params.get(str(param.name))
    if value is not None and given is not None and value != given:
        raise click.UsageError(f"--{param.name} must be given once; received {given} and {value}", ctx)
    return given if value is None else value


config_option = option(
    "--config", "YAML file of settings; every key has a default.", PATH, callback=_of_group
)
data_option = option(
    "--data", "Folder of everything that is kept; ./coilcal-data by default.", PATH, callback=_of_group
)


def shared_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options of every subcommand."""
    return config_option(data_option(json_option(command)))


class ServeGroup(CoilcalGroup):
    """A group whose own call explains its faults as commands do."""

    def invoke(self, ctx: click.Context) -> Any:
        """Serve, or run a subcommand, which explains its own faults."""
        with explained_errors(as_json=bool(ctx.params.get("as_json"))):
            return super().invoke(ctx)


@click.group("serve", cls=ServeGroup, invoke_without_command=True)
@config_option
@data_option
@option("--host", "Address to listen at; 127.0.0.1 by default. Any other than loopback needs tokens.")
@option("--port", "Port to listen at; 8765 by default, 0 takes a free one.", click.IntRange(0, 65_535))
@option("--workers", "Processes that run jobs.", click.IntRange(1, MOST_PROCESSES))
@option("--scheduler", "Dask scheduler whose workers run the jobs instead.", metavar="ADDRESS")
@option(
    "--commands",
    "Commands of coilcal --via local: carried out beside the service, alone without it, or not at all.",
    click.Choice(["beside", "alone", "none"]),
    default="beside",
)
@flag("--open opens", "Show the page in the browser.")
@flag("--check", "Say what would be done, and end.")
@json_option
@click.pass_context
def serve_group(
    ctx: click.Context,
    /,
    config: Path | None,
    commands: str,
    opens: bool,
    check: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Serve calibrations and diagnoses over HTTP.

    Without any option the service keeps its data in ./coilcal-data and answers this computer only. It ends with Ctrl-C; what it was
    working on goes on when it is started again, also after kill -9.
    """
    if ctx.invoked_subcommand is not None:
        for name in ctx.params:
            if (
                name not in SHARED
                and ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
            ):
                option = next(param.opts[0] for param in ctx.command.params if param.name == name)
                rule = (
                    f"must stand behind {ctx.invoked_subcommand}, where that has it, and not in front of it"
                )
                raise click.UsageError(f"{option} {rule}")
        return
    if commands == "alone":
        _carry_out_commands()
        return
    with _settings(config, **options) as settings:
        from estimator.service.serve import plan_of, serve
    if check:
        plan = plan_of(settings)
        show(plan, _plan_text(plan), as_json)
        return
    use_threads(ctx.find_root().params.get("threads", 1))
    from estimator.cli.local_server import carrying_out

    with carrying_out() if commands == "beside" else nullcontext():
        serve(settings, lambda address: click.echo(f"coilcal: serving {settings.data} at {address}"), opens)


def _carry_out_commands() -> None:
    """Carry out commands until a signal comes."""
    from estimator.cli.local_server import EXIT_TAKEN, carrying_out

    interrupted_by(signal.SIGINT, signal.SIGTERM)
    with suppress(KeyboardInterrupt), carrying_out() as processes:
        click.echo("coilcal: carrying out commands of coilcal --via local")
        if processes[0].wait() == EXIT_TAKEN:
            raise InvalidInput("no other coilcal serve of yours may carry out commands; one does")


@serve_group.command("backup", cls=CoilcalCommand)
@click.argument("file", metavar="FILE", type=PATH)
@shared_options
def backup_command(file: Path, config: Path | None, data: Path | None, as_json: bool) -> None:
    """Copy everything that the service keeps into FILE, while it runs.

    Readings that were acknowledged before the start are in it. Jobs that run go on from there when the copy is served.
    """
    with _settings(config, data=data) as settings:
        from estimator.service.backup import backup

        result = backup(settings.data, file)
    show(result, f"{result['files']} files, {result['bytes'] / 1e6:.1f} MB, copied to {file}", as_json)


@serve_group.command("restore", cls=CoilcalCommand)
@click.argument("file", metavar="FILE", type=PATH)
@shared_options
def restore_command(file: Path, config: Path | None, data: Path | None, as_json: bool) -> None:
    """Make the data folder of a service from FILE; nothing may be there yet."""
    with _settings(config, data=data) as settings:
        from estimator.service.backup import restore

        result = restore(file, settings.data)
    show(result, f"{result['files']} files of {result['created']} restored to {result['data']}", as_json)


@serve_group.group("token")
def token_group() -> None:
    """Make, list and revoke the tokens of a service."""


@token_group.command("create", cls=CoilcalCommand)
@option("--user", "Whose token it is; jobs and changes go by this name.", required=True)
@option(
    "--scope",
    "What it allows; each includes those before it.",
    click.Choice(["read", "write", "admin"]),
    default="write",
)
@option("--days", "Time until it expires.", float, default=90.0)
@shared_options
def create_command(
    user: str, scope: str, days: float, config: Path | None, data: Path | None, as_json: bool
) -> None:
    """Make a token and print it, once: only its hash is kept."""
    with _database(config, data, is_made=True) as database:
        from estimator.service.tokens import Scope, create_token

        secret, token_id = create_token(database, user, Scope(scope), days)
    show({"id": token_id, "token": secret}, secret, as_json)


@token_group.command("list", cls=CoilcalCommand)
@shared_options
def list_command(config: Path | None, data: Path | None, as_json: bool) -> None:
    """List tokens, without what they are."""
    with _database(config, data) as database:
        from estimator.service.tokens import all_tokens

        keys = ("id", "user", "scope", "created", "expires", "revoked")
        rows = [{key: getattr(token, key) for key in keys} for token in all_tokens(database)]
    lines = [f"{'id':12}  {'user':20}  {'scope':5}  {'expires':24}  revoked"]
    lines += [
        f"{row['id']:12}  {row['user']:20}  {row['scope']:5}  {row['expires'][:19]:24}  {row['revoked'] or ''}"
        for row in rows
    ]
    show({"tokens": rows}, "\n".join(lines), as_json)


@token_group.command("revoke", cls=CoilcalCommand)
@click.argument("token_id", metavar="ID")
@shared_options
def revoke_command(token_id: str, config: Path | None, data: Path | None, as_json: bool) -> None:
    """End a token now; a service that runs refuses it from the next request on."""
    with _database(config, data) as database:
        from estimator.service.tokens import revoke_token

        revoke_token(database, token_id)
    show({"revoked": token_id}, f"revoked {token_id}", as_json)


@contextmanager
def _database(config: Path | None, data: Path | None, is_made: bool = False) -> Iterator[Database]:
    """The database of a service; where there is none, one is made or the folder is refused."""
    with _settings(config, data=data) as settings:
        from estimator.service.core import DATABASE
        from estimator.service.database import Database
    path = settings.data / DATABASE
    if is_made:
        settings.data.mkdir(parents=True, exist_ok=True, mode=0o700)
    elif not path.exists():
        raise InvalidInput(f"data must be the folder of a service; {settings.data} has no {DATABASE}")
    database = Database(path)
    try:
        database.migrate()
        yield database
    finally:
        database.close()


@contextmanager
def _settings(config: Path | None, **options: Any) -> Iterator[Settings]:
    """Settings of the file and of the options that were given. An import inside that fails says which extra is missing."""
    with needing("service", "coilcal serve"):
        from estimator.service.settings import load_settings

        yield load_settings(config).with_options(**options)


def _plan_text(plan: dict[str, Any]) -> str:
    lines = [
        f"would serve at {plan['address']}",
        f"tokens: {plan['tokens']}",
        f"jobs on: {plan['workers']}",
        "settings:",
    ]
    return "\n".join(lines + [f"  {key}: {value}" for key, value in plan["settings"].items()])
