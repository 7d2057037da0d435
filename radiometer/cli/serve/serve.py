"""`radiometer serve`: the daemon."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from radiometer.cli.arguments import parse_patch
from radiometer.cli.console import note
from radiometer.errors import ConfigurationError

if TYPE_CHECKING:
    from radiometer.daemon.service import ServiceOptions
    from radiometer.daemon.station import Station

_TOKEN_VARIABLE = "RADIOMETER_TOKEN"
_MQTT_PASSWORD_VARIABLE = "RADIOMETER_MQTT_PASSWORD"
# The event loop gives the interpreter away at each write to a socket, and a measurement that computes keeps it for this
# time: with Python's own 5 ms, 50 clients waited for 105 ms on a busy machine (median), with this figure for 18 ms.
_SWITCH_INTERVAL_S = 0.0005


def command(
    bench: Annotated[Path | None, typer.Option(help="Bench file; the simulated bench by default.")] = None,
    camera: Annotated[str | None, typer.Option(help="sim, or a GenICam id, serial number or address.")] = None,
    calibration: Annotated[Path | None, typer.Option(help="Calibration file; the bench's by default.")] = None,
    uncalibrated: Annotated[bool, typer.Option("--uncalibrated", help="Use no calibration: relative values.")] = False,
    box: Annotated[str | None, typer.Option(help="Light box: sim, a serial number or a port; none by default.")] = None,
    box_preset: Annotated[Path | None, typer.Option(help="Light-box preset; the reference box's by default.")] = None,
    patch: Annotated[str | None, typer.Option(help="Region X,Y,W,H in pixels; the bench's by default.")] = None,
    every: Annotated[
        float, typer.Option(min=0.0, max=86400.0, help="Seconds from one reading's start to the next's.")
    ] = 1.0,
    on_demand: Annotated[bool, typer.Option("--on-demand", help="Measure only when a client asks.")] = False,
    journal: Annotated[Path | None, typer.Option(help="Journal file; by default in the user's state folder.")] = None,
    keep_days: Annotated[
        float | None, typer.Option(min=0.01, help="Delete readings older than this; by default none is deleted.")
    ] = None,
    journal_max_mb: Annotated[
        float | None, typer.Option(min=0.1, help="Let the journal grow no larger; measuring pauses at the limit.")
    ] = None,
    scpi_address: Annotated[str, typer.Option(help="Address for SCPI.")] = "127.0.0.1",
    scpi_port: Annotated[int, typer.Option(min=0, max=65535, help="Port for SCPI; 0 chooses one.")] = 5025,
    scpi_socket: Annotated[Path | None, typer.Option(help="Unix socket for SCPI, beside the port.")] = None,
    scpi_allow: Annotated[
        list[str] | None, typer.Option(help="Address or network that may use SCPI; may be repeated.")
    ] = None,
    http_address: Annotated[str, typer.Option(help="Address for HTTP.")] = "127.0.0.1",
    http_port: Annotated[int, typer.Option(min=0, max=65535, help="Port for HTTP; 0 chooses one.")] = 8080,
    token_file: Annotated[
        Path | None, typer.Option(help=f"File with the token for HTTP (else ${_TOKEN_VARIABLE}).")
    ] = None,
    http_rate: Annotated[float, typer.Option(min=1.0, help="Requests per second that one address may make.")] = 100.0,
    no_scpi: Annotated[bool, typer.Option("--no-scpi", help="No SCPI port.")] = False,
    no_http: Annotated[bool, typer.Option("--no-http", help="No HTTP.")] = False,
    mqtt: Annotated[str | None, typer.Option(help="MQTT broker HOST[:PORT] to publish to.")] = None,
    mqtt_prefix: Annotated[str, typer.Option(help="First level of the MQTT topics.")] = "radiometer",
    mqtt_user: Annotated[
        str | None, typer.Option(help=f"User at the broker; the password is ${_MQTT_PASSWORD_VARIABLE}.")
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
    import asyncio

    from radiometer.daemon.epics import PvaOptions
    from radiometer.daemon.limits import Limits, parse_networks
    from radiometer.daemon.mqtt import parse_target
    from radiometer.daemon.service import ServiceOptions

    _log_to_standard_error()
    options = ServiceOptions(
        every_s=None if on_demand else every,
        scpi_address=None if no_scpi else scpi_address,
        scpi_port=scpi_port,
        scpi_socket=scpi_socket,
        scpi_allow=parse_networks(scpi_allow or ()),
        http_address=None if no_http else http_address,
        http_port=http_port,
        token=_token(token_file),
        limits=Limits(http_requests_per_s=http_rate),
        mqtt=parse_target(mqtt, mqtt_prefix, mqtt_user, os.environ.get(_MQTT_PASSWORD_VARIABLE), tls=mqtt_tls)
        if mqtt
        else None,
        pva=PvaOptions(pva_prefix) if pva else None,
    )

    def make_station() -> Station:
        from radiometer.daemon.bench_instrument import BenchInstrument
        from radiometer.daemon.bench_light import bench_light
        from radiometer.daemon.instrument import MeasurementSettings
        from radiometer.daemon.journal import Journal, default_journal_path
        from radiometer.daemon.station import Station

        instrument = BenchInstrument(bench, camera, calibration, uncalibrated=uncalibrated)
        where = parse_patch(patch) if patch else instrument.default_patch()
        limit = int(journal_max_mb * 1e6) if journal_max_mb else None
        return Station(
            instrument,
            Journal(journal or default_journal_path(), max_bytes=limit),
            box=bench_light(box, preset=box_preset) if box else None,
            keep_days=keep_days,
            settings=MeasurementSettings(patch=where, gain_db=instrument.config.camera.gain_db),
        )

    asyncio.run(_serve(make_station(), options))


async def _serve(station: Station, options: ServiceOptions) -> None:
    from radiometer.daemon.descriptors import raise_limit
    from radiometer.daemon.log_throttle import LogThrottle
    from radiometer.daemon.memory import limit_arenas
    from radiometer.daemon.service import Service

    limit_arenas()
    raise_limit()
    LogThrottle().install()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    await Service(station, options, announce=note).run()


def _token(token_file: Path | None) -> str | None:
    if token_file is None:
        return os.environ.get(_TOKEN_VARIABLE) or None
    try:
        token = token_file.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"cannot read the token file {token_file}: {error}") from error
    return token


def _log_to_standard_error() -> None:
    """Log from INFO on; a daemon's log is read when something went wrong, so it is never silent."""
    import structlog

    from radiometer.cli.logging_setup import configure_logging

    if not structlog.is_configured():
        configure_logging(1)
