"""Figures for Prometheus."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    PlatformCollector,
    ProcessCollector,
    generate_latest,
)

from radiometer.daemon.keeper import DeviceKeeper, DeviceState
from radiometer.data import Reading

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
_LATENCY_BUCKETS_S: Final = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 30, 60, 120)
_COUNTER_FIELDS: Final = {
    "missing_packets": ("radiometer_lost_packets", "Packets of the camera that never came."),
    "resent_packets": ("radiometer_resent_packets", "Packets of the camera that came on request only."),
    "retried": ("radiometer_retries", "Frames taken again because they were incomplete or late."),
    "incomplete": ("radiometer_incomplete_frames", "Frames thrown away because a part was missing."),
    "timeouts": ("radiometer_timeouts", "Waits for the camera that ended at their deadline."),
    "underruns": ("radiometer_underruns", "Frames lost because no buffer was free."),
    "frames": ("radiometer_frames", "Complete frames taken."),
}


class Metrics:
    """All figures of one daemon, in a separate registry."""

    def __init__(self) -> None:
        self.registry = registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        PlatformCollector(registry=registry)
        self.readings = Counter("radiometer_readings", "Readings committed to the journal.", registry=registry)
        self.failures = Counter("radiometer_measurement_failures", "Measurements that failed.", registry=registry)
        self.flagged = Counter("radiometer_flagged_readings", "Readings with a flag.", ["flag"], registry=registry)
        self.measuring_s = Histogram(
            "radiometer_measurement_seconds",
            "Time from the start of a measurement to its reading.",
            buckets=_LATENCY_BUCKETS_S,
            registry=registry,
        )
        self.committing_s = Histogram(
            "radiometer_commit_seconds",
            "Time to commit a batch of readings to the journal.",
            buckets=_LATENCY_BUCKETS_S,
            registry=registry,
        )
        self.radiance = Gauge(
            "radiometer_radiance", "Latest radiance, in the unit of the label.", ["unit"], registry=registry
        )
        self.u_radiance = Gauge(
            "radiometer_radiance_standard_uncertainty", "Its standard uncertainty (k=1).", ["unit"], registry=registry
        )
        self.patch_radiance = Gauge(
            "radiometer_patch_radiance", "Latest radiance of a patch with a name.", ["patch", "unit"], registry=registry
        )
        self.patch_u_radiance = Gauge(
            "radiometer_patch_radiance_standard_uncertainty", "Its standard uncertainty (k=1).", ["patch", "unit"],
            registry=registry,
        )  # fmt: skip
        self.limit_alarm = Gauge(
            "radiometer_limit_alarm", "1 while a patch is beyond a limit of it.", ["patch"], registry=registry
        )
        self.exposure_s = Gauge(
            "radiometer_exposure_seconds", "Longest exposure of the latest reading.", registry=registry
        )
        self.temperature_c = Gauge(
            "radiometer_temperature_celsius", "Temperature of a device.", ["device"], registry=registry
        )
        self.device_up = Gauge("radiometer_device_up", "1 while the device answers.", ["device"], registry=registry)
        self.device_losses = Gauge(
            "radiometer_device_losses", "Times the device was lost.", ["device"], registry=registry
        )
        self.queue_depth = Gauge(
            "radiometer_queue_depth", "What waits: measurements asked for, readings to be committed.", ["queue"],
            registry=registry,
        )  # fmt: skip
        self.alarms = Gauge("radiometer_alarms", "Alarms that are up.", registry=registry)
        self.connections = Gauge("radiometer_connections", "Open connections.", ["interface"], registry=registry)
        self.requests = Counter("radiometer_requests", "Commands or requests served.", ["interface"], registry=registry)
        self.refused = Counter(
            "radiometer_refused", "Connections or requests refused.", ["interface", "reason"], registry=registry
        )
        self._device_counters = {
            field: Counter(name, text, registry=registry) for field, (name, text) in _COUNTER_FIELDS.items()
        }
        self._seen: dict[str, int] = {}
        self._failed = 0

    def take_reading(self, reading: Reading) -> None:
        """Show a reading of the patch for all."""
        unit = reading.radiance.unit
        self.radiance.labels(unit).set(reading.radiance.value)
        self.u_radiance.labels(unit).set(reading.radiance.u)
        self.exposure_s.set(max(reading.exposures_s, default=0.0))
        for flag in reading.flags:
            self.flagged.labels(str(flag)).inc()

    def take_patch_reading(self, reading: Reading) -> None:
        """Show a reading of a patch with a name."""
        labels = (reading.name, reading.radiance.unit)
        self.patch_radiance.labels(*labels).set(reading.radiance.value)
        self.patch_u_radiance.labels(*labels).set(reading.radiance.u)

    def drop_patch(self, name: str) -> None:
        """Show a patch no longer: it was moved or deleted."""
        for gauge in (self.patch_radiance, self.patch_u_radiance):
            for labels in [key for key in list(gauge._metrics) if key[0] == name]:
                gauge.remove(*labels)

    def take_devices(self, keepers: Iterable[DeviceKeeper]) -> None:
        """Show how the devices are doing."""
        for keeper in keepers:
            self.device_up.labels(keeper.name).set(keeper.state is DeviceState.READY)
            self.device_losses.labels(keeper.name).set(keeper.losses)
            if keeper.report.temperature_c is not None:
                self.temperature_c.labels(keeper.name).set(keeper.report.temperature_c)

    def take_failures(self, count: int) -> None:
        """Add the measurements that have failed since last time; `count` is of all."""
        self.failures.inc(count - self._failed)
        self._failed = count

    def take_device_counts(self, counts: Mapping[str, int]) -> None:
        """Add what a camera counted since last time; its counts begin again at 0 when it is reopened."""
        for name, counter in self._device_counters.items():
            count = counts.get(name, 0)
            before = self._seen.get(name, 0)
            counter.inc(count - before if count >= before else count)
            self._seen[name] = count

    def render(self) -> bytes:
        """Return the figures in Prometheus's text form."""
        return bytes(generate_latest(self.registry))
