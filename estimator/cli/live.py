"""`coilcal live`: estimate and watch a session while it is measured."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import click

from estimator.cli.options import PATH, json_option, option, seed_option
from estimator.cli.output import CoilcalCommand, show


@click.command("live", cls=CoilcalCommand)
@click.argument("session_path", metavar="SESSION", type=PATH)
@option(
    "--wait wait_s",
    "Seconds to wait for a session that does not exist yet; Ctrl-C ends the wait.",
    click.FloatRange(min=0.0),
    default=3600.0,
)
@option(
    "--refresh/--no-refresh has_refresh",
    "Sample the posterior and diagnose the session in the background.",
    default=True,
)
@seed_option
@json_option
def live_command(session_path: Path, wait_s: float, has_refresh: bool, seed: int, as_json: bool) -> None:
    """Estimate and watch SESSION while it is measured.

    It follows what coilcal acquire writes, from another terminal or another computer that sees the folder. Each stop updates the estimate
    and its credible intervals within milliseconds. Readings that noise does not explain raise alarms. Posterior and diagnosis follow in
    the background. The command ends with the session, or with Ctrl-C, which leaves the measurement alone.
    """
    from estimator.cli.live_session import LiveSession, wait_for
    from estimator.cli.live_view import LiveView

    wait_for(session_path, wait_s)
    session = LiveSession(session_path)
    with LiveView() as view, ExitStack() as stack:
        background = None
        if has_refresh:
            from estimator.live.refresh import Background  # samplers and diagnosis

            background = stack.enter_context(Background(seed))
        try:
            while session.step(background):
                view(session.state(background))
            session.finish(background)
            view(session.state(None))
        except KeyboardInterrupt:
            click.echo("coilcal: the measurement goes on without being watched", err=True)
    show(session.result(), session.text(), as_json)
