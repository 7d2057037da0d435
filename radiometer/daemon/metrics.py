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
    "missing_packets": ("lost_packets", "Packets of the camera that never came."),
    "resent_packets": ("resent_packets", "Packets of the camera that came on request only."),
    "retried": ("retries", "Frames taken again because they were incomplete or late."),
    "incomplete": ("incomplete_frames", "Frames thrown away because a part was missing."),
    "timeouts": ("timeouts", "Waits for the camera that ended at their deadline."),
    "underruns": ("underruns", "Frames lost because no buffer was free."),
    "frames": ("frames", "Complete frames taken."),
}


class Metrics:
    """All figures of one daemon, in a separate registry."""

    def __init__(self) -> None:
        self.registry = registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        PlatformCollector(registry=registry)

        def gauge(name: str, text: str, *labels: str) -> Gauge:
            return Gauge(f"radiometer_{name}", text, labels, registry=registry)

        def counter(name: str, text: str, *labels: str) -> Counter:
            return Counter(f"radiometer_{name}", text, labels, registry=registry)

        def histogram(name: str, text: str) -> Histogram:
            return Histogram(f"radiometer_{name}", text, buckets=_LATENCY_BUCKETS_S, registry=registry)

        self.readings = counter("readings", "Readings committed to the journal.")
        self.failures = counter("measurement_failures", "Measurements that failed.")
        self.flagged = counter("flagged_readings", "Readings with a flag.", "flag")
        self.measuring_s = histogram("measurement_seconds", "Time from the start of a measurement to its reading.")
        self.committing_s = histogram("commit_seconds", "Time to commit a batch of readings to the journal.")
        self.radiance = gauge("radiance", "Latest radiance, in the unit of the label.", "unit")
        self.u_radiance = gauge("radiance_standard_uncertainty", "Its standard uncertainty (k=1).", "unit")
        self.patch_radiance = gauge("patch_radiance", "Latest radiance of a patch with a name.", "patch", "unit")
        self.patch_u_radiance = gauge(
            "patch_radiance_standard_uncertainty", "Its standard uncertainty (k=1).", "patch", "unit"
        )
        self.limit_alarm = gauge("limit_alarm", "1 while a patch is beyond a limit of it.", "patch")
        self.exposure_s = gauge("exposure_seconds", "Longest exposure of the latest reading.")
        self.temperature_c = gauge("temperature_celsius", "Temperature of a device.", "device")
        self.device_up = gauge("device_up", "1 while the device answers.", "device")
        self.device_losses = gauge("device_losses", "Times the device was lost.", "device")
        self.queue_depth = gauge(
            "queue_depth", "What waits: measurements asked for, readings to be committed.", "queue"
        )
        self.alarms = gauge("alarms", "Alarms that are up.")
        self.connections = gauge("connections", "Open connections.", "interface")
        self.requests = counter("requests", "Commands or requests served.", "interface")
        self.refused = counter("refused", "Connections or requests refused.", "interface", "reason")
        self._device_counters = {field: counter(*named) for field, named in _COUNTER_FIELDS.items()}
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

    def drop_reading(self) -> None:
        """Show the reading of the patch for all no longer: another place is set, or another wavelength."""
        for gauge in (self.radiance, self.u_radiance):
            gauge.clear()

    def take_patch_reading(self, reading: Reading) -> None:
        """Show a reading of a patch with a name."""
        labels = (reading.name, reading.radiance.unit)
        self.patch_radiance.labels(*labels).set(reading.radiance.value)
        self.patch_u_radiance.labels(*labels).set(reading.radiance.u)

    def drop_patch(self, name: str) -> None:
        """Show a patch no longer: it was moved or deleted."""
        for gauge in (self.patch_radiance, self.patch_u_radiance, self.limit_alarm):
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
