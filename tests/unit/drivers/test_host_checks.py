from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from drivers import host_checks
from radiometer.devices import Health
from radiometer.errors import MissingLibrary


@pytest.fixture
def write(tmp_path):
    """Return a function that writes a file below a root of one's own, and that root."""

    def make(path: str, text: str) -> Path:
        file = tmp_path / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
        return tmp_path

    return make


def test_a_missing_library_is_a_fault_with_its_packages():
    """Without the library nothing can be measured; the cure names the packages."""

    def absent() -> object:
        raise MissingLibrary("apt install gir1.2-aravis-0.8")

    finding = host_checks.check_library(absent)
    assert finding.health is Health.FAULT
    assert "gir1.2-aravis-0.8" in finding.cure


def test_the_version_of_the_library_is_told():
    """A library that loads is named with its version."""
    assert host_checks.check_library(lambda: SimpleNamespace(version="0.8")).message == "Aravis 0.8"


@pytest.mark.parametrize(("user", "health"), [(1000, Health.WARNING), (0, Health.NOTE)])
def test_without_a_udev_rule_the_rule_is_given(tmp_path, monkeypatch, user, health):
    """A user is warned, root is told, and the cure is the rule itself."""
    monkeypatch.setattr(host_checks.os, "geteuid", lambda: user)
    finding = host_checks.check_usb_permissions(tmp_path)
    assert finding.health is health
    assert 'ATTRS{idVendor}=="1e10"' in finding.cure


def test_a_udev_rule_is_found(write):
    """A rule with FLIR's vendor number is enough."""
    root = write("etc/udev/rules.d/40-flir.rules", 'SUBSYSTEM=="usb", ATTRS{idVendor}=="1E10", MODE="0666"\n')
    assert host_checks.check_usb_permissions(root).health is Health.OK


@pytest.mark.parametrize(("text", "health"), [("16\n", Health.WARNING), ("1000\n", Health.OK), ("0\n", Health.OK)])
def test_usb_memory_is_judged(write, text, health):
    """Sixteen megabytes are too few for a USB3 camera; none means no limit."""
    root = write("sys/module/usbcore/parameters/usbfs_memory_mb", text)
    assert host_checks.check_usb_memory(root).health is health


@pytest.mark.parametrize(("text", "health"), [("212992\n", Health.WARNING), ("33554432\n", Health.OK)])
def test_socket_buffers_are_judged_by_a_full_frame(write, text, health):
    """The kernel's default cannot hold a frame; the cure is the very command."""
    finding = host_checks.check_socket_buffers(write("proc/sys/net/core/rmem_max", text))
    assert finding.health is health
    assert finding.cure == "" or "sysctl -w net.core.rmem_max=33554432" in finding.cure


@pytest.mark.parametrize(("mtu", "health"), [("1500", Health.NOTE), ("9000", Health.OK)])
def test_interfaces_that_are_up_are_judged_by_their_mtu(write, mtu, health):
    """Jumbo frames are recommended on interfaces that are up; the others are left out."""
    for name, state in (("eth0", "up"), ("eth1", "down")):
        write(f"sys/class/net/{name}/type", "1\n")
        write(f"sys/class/net/{name}/operstate", state)
        root = write(f"sys/class/net/{name}/mtu", mtu)
    (finding,) = host_checks.check_network(root)
    assert finding.check == "network eth0"
    assert finding.health is health
