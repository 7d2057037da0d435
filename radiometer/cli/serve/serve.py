"""`radiometer serve`: the daemon."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import radiometer as rm
from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import note
from radiometer.cli.options import BenchOption, CalibrationOption, CameraOption, PatchOption, UncalibratedOption
from radiometer.plausible import Days, Megabytes, Period, Port, RequestRate


def command(
    bench: BenchOption = None,
    camera: CameraOption = None,
    calibration: CalibrationOption = None,
    uncalibrated: UncalibratedOption = False,
    box: Annotated[str | None, typer.Option(help="Light box: sim, a serial number or a port; none by default.")] = None,
    box_preset: Annotated[Path | None, typer.Option(help="Light-box preset; the reference box's by default.")] = None,
    patch: PatchOption = None,
    every: Annotated[Period, typer.Option(help="Seconds from one reading's start to the next's.")] = 1.0,
    on_demand: Annotated[bool, typer.Option("--on-demand", help="Measure only when a client asks.")] = False,
    journal: Annotated[Path | None, typer.Option(help="Journal file; by default in the user's state folder.")] = None,
    keep_days: Annotated[
        Days | None, typer.Option(help="Delete readings and alarms older than this, once an hour; by default none.")
    ] = None,
    journal_max_mb: Annotated[
        Megabytes | None, typer.Option(help="Let the journal and its log grow no larger; measuring pauses then.")
    ] = None,
    scpi_address: Annotated[str, typer.Option(help="Address for SCPI.")] = "127.0.0.1",
    scpi_port: Annotated[Port, typer.Option(help="Port for SCPI; 0 chooses one.")] = 5025,
    scpi_socket: Annotated[Path | None, typer.Option(help="Unix socket for SCPI, in addition to the port.")] = None,
    scpi_allow: Annotated[
        list[str] | None, typer.Option(help="Address or network that may use SCPI; may be repeated.")
    ] = None,
    http_address: Annotated[str, typer.Option(help="Address for HTTP.")] = "127.0.0.1",
    http_port: Annotated[Port, typer.Option(help="Port for HTTP; 0 chooses one.")] = 8080,
    token_file: Annotated[
        Path | None, typer.Option(help="File with the token for HTTP (else $RADIOMETER_TOKEN).")
    ] = None,
    http_rate: Annotated[RequestRate, typer.Option(help="Requests per second that one address may make.")] = 100.0,
    no_scpi: Annotated[bool, typer.Option("--no-scpi", help="No SCPI port.")] = False,
    no_http: Annotated[bool, typer.Option("--no-http", help="No HTTP.")] = False,
    mqtt: Annotated[str | None, typer.Option(help="MQTT broker HOST[:PORT] to publish to.")] = None,
    mqtt_prefix: Annotated[str, typer.Option(help="First level of the MQTT topics.")] = "radiometer",
    mqtt_user: Annotated[
        str | None, typer.Option(help="User at the broker; the password is $RADIOMETER_MQTT_PASSWORD.")
    ] = None,
    mqtt_tls: Annotated[bool, typer.Option("--mqtt-tls", help="Use TLS to the broker.")] = False,
    pva: Annotated[bool, typer.Option("--pva", help="Serve readings over EPICS pvAccess (needs p4p).")] = False,
    pva_prefix: Annotated[str, typer.Option(help="First part of the names of process variables.")] = "radiometer",
) -> None:
    """Measure for weeks and serve the readings over SCPI, HTTP (with a web page), MQTT and EPICS pvAccess.

    SIGTERM or Ctrl-C ends it, SIGHUP reloads the calibration. A camera that is lost is reported and reopened.
    SCPI has no authentication: it listens on this machine only, or on another address for those listed with
    --scpi-allow. HTTP on another address needs a token.
    """
    _log_to_standard_error()
    rm.serve(
        bench, camera, calibration=calibration, uncalibrated=uncalibrated, box=box, box_preset=box_preset,
        patch=parse_patch(patch), every_s=every, on_demand=on_demand, journal=journal, keep_days=keep_days,
        journal_max_mb=journal_max_mb, scpi_address=scpi_address, scpi_port=scpi_port, scpi_socket=scpi_socket,
        scpi_allow=scpi_allow or (), http_address=http_address, http_port=http_port, token_file=token_file,
        http_rate=http_rate, scpi=not no_scpi, http=not no_http, mqtt=mqtt, mqtt_prefix=mqtt_prefix,
        mqtt_user=mqtt_user, mqtt_tls=mqtt_tls, pva=pva, pva_prefix=pva_prefix, announce=note,
    )  # fmt: skip


def _log_to_standard_error() -> None:
    """Log from INFO on; a daemon's log is read when something went wrong, so it is never silent."""
    import structlog

    from radiometer.cli.logging_setup import configure_logging

    if not structlog.is_configured():
        configure_logging(1)
