"""What is asked of linuxpy, and what becomes of its errors: its device replaced by one that answers as it does."""

import errno
import threading
from types import SimpleNamespace

import pytest

from drivers.cameras.v4l2_link import LinuxpyDevice, open_device
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost, DeviceNotFound, DeviceTimeout
from testing.patience import within

GREY, YUYV = (int.from_bytes(code, "little") for code in (b"GREY", b"YUYV"))


class Numeric:
    is_flagged_write_only = False
    step, default = 1, 157

    def __init__(self, config_name: str, value: int, fault: Exception | None = None) -> None:
        self.config_name, self._value, self.fault, self.minimum, self.maximum = config_name, value, fault, 1, 5000

    @property
    def value(self) -> int:
        return self._value

    @value.setter
    def value(self, value: int) -> None:
        if self.fault:
            raise self.fault
        self._value = value // 2 * 2


class Device:
    def __init__(self) -> None:
        self.controls = {"exposure_time_absolute": Numeric("exposure_time_absolute", 157)}
        self.format, self.refuses, self.closed = None, None, False
        sizes = [SimpleNamespace(info=SimpleNamespace(width=640, height=480))]
        self.info = SimpleNamespace(
            formats=[SimpleNamespace(pixel_format=YUYV)], format_frame_sizes=lambda _code: sizes
        )

    def set_format(self, _kind: str, width: int, height: int, fourcc: str) -> None:
        if self.refuses:
            raise self.refuses
        code = int.from_bytes(fourcc.encode(), "little")
        self.format = SimpleNamespace(width=width, height=height, pixel_format=code, bytes_per_line=width)

    def get_format(self, _kind: str) -> SimpleNamespace:
        return self.format

    def close(self) -> None:
        self.closed = True


class Capture:
    def __init__(self, device: Device) -> None:
        self.device, self.opened, self.closed = device, 0, 0
        self.buffer = SimpleNamespace(read=lambda: SimpleNamespace(data=memoryview(b"\x01\x02"), timestamp=12.5))
        device.capture = self

    def open(self) -> None:
        self.opened += 1

    def close(self) -> None:
        self.closed += 1


@pytest.fixture
def webcam(tmp_path):
    """Return a device of linuxpy's kind and the driver's device over it; its path exists."""
    path = tmp_path / "video0"
    path.touch()
    library = SimpleNamespace(
        BufferType=SimpleNamespace(VIDEO_CAPTURE="capture"),
        VideoCapture=Capture,
        BaseNumericControl=Numeric,
        BooleanControl=Numeric,
        MenuControl=Numeric,
    )
    device = Device()
    return device, LinuxpyDevice(library, device, str(path)), path


def test_formats_and_controls_come_by_name(webcam):
    """Four letters and a size; limits, default and value of each control; what the device makes of it is returned."""
    _, opened, _ = webcam
    assert opened.formats() == [("YUYV", 640, 480)]
    control = opened.controls()["exposure_time_absolute"]
    assert (control.minimum, control.maximum, control.default, control.value) == (1, 5000, 157, 157)
    assert opened.set_control("exposure_time_absolute", 101) == 100


@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        (AttributeError("is not writeable: inactive"), DeviceError),
        (OSError(errno.ENODEV, "No such device"), DeviceLost),
    ],
)
def test_a_control_that_cannot_be_set_is_reported(webcam, fault, kind):
    """An inactive control is a refusal, a device that is gone a loss: neither is swallowed."""
    device, opened, _ = webcam
    device.controls["exposure_time_absolute"].fault = fault
    with pytest.raises(kind):
        opened.set_control("exposure_time_absolute", 100)


def test_a_frame_is_copied_out_of_the_buffer(webcam):
    """Bytes and time of the kernel's clock; streaming ends with the stop."""
    device, opened, _ = webcam
    opened.start("GREY", 640, 480)
    frame = opened.frame(5.0)
    assert (frame.payload, frame.timestamp_s) == (b"\x01\x02", 12.5)
    assert device.format.pixel_format == GREY
    opened.close()
    assert (device.capture.closed, device.closed) == (1, True)


@pytest.mark.parametrize(
    ("width", "row", "message"),
    [(320, 320, "gives 320 × 480 GREY where 640 × 480 GREY was set"), (640, 768, "rows of 640 × 480 GREY take 768")],
)
def test_a_format_that_was_not_taken_is_refused(webcam, width, row, message):
    """A device that gives another size than was set, or rows with a margin, would be read askew."""
    device, opened, _ = webcam
    device.get_format = lambda _kind: SimpleNamespace(width=width, height=480, pixel_format=GREY, bytes_per_line=row)
    with pytest.raises(DeviceError, match=message):
        opened.start("GREY", 640, 480)


@pytest.mark.parametrize(("is_there", "kind"), [(True, DeviceTimeout), (False, DeviceLost)])
def test_a_frame_that_does_not_come_ends_with_the_deadline(webcam, is_there, kind):
    """A device that hangs is a time-out, one that was unplugged is lost."""
    device, opened, path = webcam
    let_go = threading.Event()
    opened.start("GREY", 640, 480)
    device.capture.buffer.read = lambda: let_go.wait(within(20.0))
    if not is_there:
        path.unlink()
    with pytest.raises(kind):
        opened.frame(0.2)
    let_go.set()


def test_a_device_held_elsewhere_is_in_use(webcam):
    """Setting its format is where a busy webcam says so."""
    device, opened, _ = webcam
    device.refuses = OSError(errno.EBUSY, "Device or resource busy")
    with pytest.raises(DeviceInUse, match="in use by another program"):
        opened.start("GREY", 640, 480)


def test_a_path_that_is_not_there_is_not_opened(tmp_path):
    """The message names it."""
    pytest.importorskip("linuxpy")
    with pytest.raises(DeviceNotFound, match="video9"):
        open_device(str(tmp_path / "video9"))
