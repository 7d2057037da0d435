"""Reports to systemd how the daemon is doing (sd_notify protocol, Type=notify, watchdog)."""

from __future__ import annotations

import os
import socket
import time


class Notifier:
    """Sends state to the socket that systemd names; does nothing where it names none.

    Source: sd_notify(3), systemd's manual: datagrams of KEY=VALUE lines to $NOTIFY_SOCKET, "@" for an abstract name.

    Args:
        address: The socket; "" for none.
        watchdog_us: Time in µs after which systemd takes a silent daemon for hung; 0 for no watchdog.
    """

    def __init__(self, address: str, watchdog_us: int = 0) -> None:
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._watchdog_us = watchdog_us

    @classmethod
    def from_environment(cls) -> Notifier:
        """Return a notifier for what systemd put into the environment."""
        watchdog_us = os.environ.get("WATCHDOG_USEC", "0")
        for_us = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        return cls(os.environ.get("NOTIFY_SOCKET", ""), int(watchdog_us) if for_us and watchdog_us.isdigit() else 0)

    @property
    def watchdog_period_s(self) -> float | None:
        """Return how often `alive` must be sent, half the time systemd allows; None without a watchdog."""
        return self._watchdog_us / 2e6 if self._watchdog_us else None

    def ready(self, status: str) -> None:
        """Tell that start-up is over."""
        self._send(f"READY=1\nSTATUS={status}")

    def reloading(self) -> None:
        """Tell that a reload begins; `ready` must follow."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """Tell that the end has begun."""
        self._send("STOPPING=1\nSTATUS=stopping")

    def alive(self) -> None:
        """Feed the watchdog."""
        self._send("WATCHDOG=1")

    def status(self, text: str) -> None:
        """Set the line that `systemctl status` shows."""
        self._send("STATUS=" + text.replace("\n", " "))

    def _send(self, message: str) -> None:
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
            channel.settimeout(1.0)
            try:
                channel.sendto(message.encode(), self._address)
            except OSError:
                return  # systemd is restarting; its watchdog decides
