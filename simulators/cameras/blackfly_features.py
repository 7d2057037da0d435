"""The features of a simulated Blackfly S: SFNC names, registers, limits, values as shipped.

Registers below 0x400 are those that Aravis's fake device itself acts upon (arvfakecamera.c); ours start at 0x4000.
"""

from __future__ import annotations

from typing import Final

from radiometer.devices import CameraCapabilities
from simulators.cameras.genicam_document import Feature
from simulators.cameras.pixel_packing import WIRE_FORMATS

# Where Aravis's fake device looks (arvfakecamera.h of Aravis 0.8).
VENDOR, MODEL, VERSION, INFO, SERIAL = 0x48, 0x68, 0x88, 0xA8, 0xD8
WIDTH, HEIGHT, BINNING = 0x100, 0x104, 0x108
SENSOR_HEIGHT, SENSOR_WIDTH = 0x118, 0x11C
ACQUISITION, PIXEL_FORMAT, ACQUISITION_MODE = 0x124, 0x128, 0x12C
OFFSET_X, OFFSET_Y = 0x130, 0x134
CONTROL_PRIVILEGE = 0x0A00  # GigE Vision's bootstrap register: 0 where no program controls the camera
# The device itself always runs on its software trigger, pulled when a picture is ready: its one thread then never
# waits for a picture to be made and answers at once. What users see as triggers lies on registers of ours.
INNER_TRIGGER_MODE, INNER_TRIGGER_SOURCE, INNER_TRIGGER = 0x300, 0x304, 0x30C
SOFTWARE_SOURCE: Final = 1  # what both the device and our users take for a software trigger

# Ours.
EXPOSURE_US, GAIN_DB, BLACK_LEVEL_PERCENT, GAMMA, TEMPERATURE_C = 0x4000, 0x4008, 0x4010, 0x4018, 0x4020
FRAME_RATE_HZ, SOURCE_LEVEL, ANSWER_DELAY_MS = 0x4028, 0x4030, 0x4038
EXPOSURE_AUTO, GAIN_AUTO, GAMMA_ENABLE, SHARPENING_ENABLE = 0x4100, 0x4104, 0x4108, 0x410C
LUT_ENABLE, DEFECT_CORRECT, BLACK_CLAMP, FRAME_RATE_ENABLE = 0x4110, 0x4114, 0x4118, 0x411C
SHUTTER_CLOSED, LOSS_PER_MILLE, STALL, DISCONNECT = 0x4120, 0x4124, 0x4128, 0x412C
TRIGGER_SELECTOR, EXPOSURE_MODE, PARAMETERS_LOCKED = 0x4130, 0x4134, 0x4138
TRIGGER_MODE, TRIGGER_SOURCE, TRIGGER_ACTIVATION, TRIGGER_SOFTWARE = 0x4140, 0x4144, 0x4148, 0x414C

AUTO: Final = {"Off": 0, "Once": 1, "Continuous": 2}


def blackfly_features(limits: CameraCapabilities, native_bit_depth: int, temperature_c: float) -> list[Feature]:
    """Return the features of a camera with given limits.

    Args:
        limits: Bounds of exposure, gain and black level (in DN of the native bit depth), formats, sensor size.
        native_bit_depth: Bits of the sensor's digital numbers.
    """
    return [
        *_device_control(temperature_c),
        *_image_format_control(limits),
        *_acquisition_control(limits),
        *_analog_control(limits, native_bit_depth),
        *_processing_control(),
        *_transport_control(),
        *_simulator_control(),
    ]


def _device_control(temperature_c: float) -> list[Feature]:
    category = "DeviceControl"
    return [
        Feature("DeviceVendorName", category, "string", VENDOR),
        Feature("DeviceModelName", category, "string", MODEL),
        Feature("DeviceManufacturerInfo", category, "string", INFO, length=48),
        Feature("DeviceFirmwareVersion", category, "string", VERSION),
        Feature("DeviceSerialNumber", category, "string", SERIAL, length=16),
        Feature("DeviceID", category, "string", SERIAL, length=16),
        Feature("DeviceTemperature", category, "float", TEMPERATURE_C, access="RO", unit="C", initial=temperature_c),
    ]


def _image_format_control(limits: CameraCapabilities) -> list[Feature]:
    category, codes = "ImageFormatControl", {name: WIRE_FORMATS[name].code for name in limits.pixel_formats}
    binned = {"S": "SensorWidth", "B": "BinningHorizontal"}, {"S": "SensorHeight", "B": "BinningHorizontal"}
    return [
        Feature("SensorWidth", category, "integer", SENSOR_WIDTH, access="RO", initial=limits.width),
        Feature("SensorHeight", category, "integer", SENSOR_HEIGHT, access="RO", initial=limits.height),
        Feature("WidthMax", category, "formula", 0, formula="S / B", variables=binned[0]),
        Feature("HeightMax", category, "formula", 0, formula="S / B", variables=binned[1]),
        _extent("Width", WIDTH, 4, lowest=4, initial=limits.width),
        _extent("Height", HEIGHT, 2, lowest=2, initial=limits.height),
        _extent("OffsetX", OFFSET_X, 4, lowest=0, initial=0),
        _extent("OffsetY", OFFSET_Y, 2, lowest=0, initial=0),
        *(
            Feature(f"{own}Room", "", "formula", 0, formula="M - O", variables={"M": f"{side}Max", "O": other})
            for own, side, other in (
                ("Width", "Width", "OffsetX"),
                ("Height", "Height", "OffsetY"),
                ("OffsetX", "Width", "Width"),
                ("OffsetY", "Height", "Height"),
            )
        ),
        Feature("BinningHorizontal", category, "integer", BINNING, minimum=1, maximum=4, initial=1),
        Feature("BinningVertical", category, "integer", BINNING, minimum=1, maximum=4, initial=1),
        Feature("PixelFormat", category, "enumeration", PIXEL_FORMAT, entries=codes, initial=min(codes.values())),
    ]


def _extent(name: str, address: int, step: int, *, lowest: int, initial: int) -> Feature:
    return Feature(
        name,
        "ImageFormatControl",
        "integer",
        address,
        minimum=lowest,
        maximum=f"{name}Room",
        increment=step,
        initial=initial,
    )


def _acquisition_control(limits: CameraCapabilities) -> list[Feature]:
    category = "AcquisitionControl"
    shortest_us, longest_us = (value * 1e6 for value in limits.exposure_s)
    return [
        Feature("AcquisitionMode", category, "enumeration", ACQUISITION_MODE,
                entries={"Continuous": 1, "SingleFrame": 2}),
        Feature("AcquisitionStart", category, "command", ACQUISITION, access="WO"),
        Feature("AcquisitionStop", category, "command", ACQUISITION, access="WO", maximum=0),
        Feature("ExposureMode", category, "enumeration", EXPOSURE_MODE, entries={"Timed": 1}, initial=1),
        Feature("ExposureAuto", category, "enumeration", EXPOSURE_AUTO, entries=AUTO, initial=AUTO["Continuous"]),
        Feature("ExposureTime", category, "float", EXPOSURE_US, unit="us", minimum=shortest_us, maximum=longest_us,
                initial=min(max(10_000.0, shortest_us), longest_us)),
        Feature("AcquisitionFrameRateEnable", category, "boolean", FRAME_RATE_ENABLE, initial=0),
        Feature("AcquisitionFrameRate", category, "float", FRAME_RATE_HZ, unit="Hz", minimum=1.0, maximum=131.0,
                initial=30.0),
        Feature("TriggerSelector", category, "enumeration", TRIGGER_SELECTOR, entries={"FrameStart": 0}, initial=0),
        Feature("TriggerMode", category, "enumeration", TRIGGER_MODE, entries={"Off": 0, "On": 1}, initial=0),
        Feature("TriggerSource", category, "enumeration", TRIGGER_SOURCE, entries={"Line0": 0, "Software": 1},
                initial=0),
        Feature("TriggerActivation", category, "enumeration", TRIGGER_ACTIVATION, entries={"RisingEdge": 0},
                initial=0),
        Feature("TriggerSoftware", category, "command", TRIGGER_SOFTWARE, access="WO"),
    ]  # fmt: skip


def _analog_control(limits: CameraCapabilities, native_bit_depth: int) -> list[Feature]:
    category, percent_per_dn = "AnalogControl", 100.0 / ((1 << native_bit_depth) - 1)
    low, high = (value * percent_per_dn for value in limits.black_level_dn)
    return [
        Feature("GainAuto", category, "enumeration", GAIN_AUTO, entries=AUTO, initial=AUTO["Continuous"]),
        Feature(
            "Gain",
            category,
            "float",
            GAIN_DB,
            unit="dB",
            minimum=limits.gain_db[0],
            maximum=limits.gain_db[1],
            initial=max(0.0, limits.gain_db[0]),
        ),
        Feature("BlackLevel", category, "float", BLACK_LEVEL_PERCENT, unit="%", minimum=low, maximum=high, initial=low),
        Feature("BlackLevelClampingEnable", category, "boolean", BLACK_CLAMP, initial=1),
        Feature("GammaEnable", category, "boolean", GAMMA_ENABLE, initial=1),
        Feature("Gamma", category, "float", GAMMA, minimum=0.25, maximum=4.0, initial=0.8),
    ]


def _processing_control() -> list[Feature]:
    category = "ImageProcessingControl"
    return [
        Feature("SharpeningEnable", category, "boolean", SHARPENING_ENABLE, initial=1),
        Feature("LUTEnable", category, "boolean", LUT_ENABLE, initial=0),
        Feature("DefectCorrectStaticEnable", category, "boolean", DEFECT_CORRECT, initial=1),
    ]


def _transport_control() -> list[Feature]:
    formula = "W * H * ((P >> 16) & 0xFF) / 8"
    variables = {"W": "Width", "H": "Height", "P": "PixelFormat"}
    return [
        Feature("PayloadSize", "TransportLayerControl", "formula", 0, formula=formula, variables=variables),
        Feature("TLParamsLocked", "", "integer", PARAMETERS_LOCKED, minimum=0, maximum=1, initial=0),
    ]


def _simulator_control() -> list[Feature]:
    category = "SimulatorControl"
    return [
        Feature("SimSourceLevel", category, "float", SOURCE_LEVEL, "Relative drive of the light source", minimum=0.0,
                maximum=1.0, initial=1.0),
        Feature("SimShutterClosed", category, "boolean", SHUTTER_CLOSED, "Cap on the lens", initial=0),
        Feature("SimPacketLossPerMille", category, "integer", LOSS_PER_MILLE, "Packets lost of a thousand", minimum=0,
                maximum=1000, initial=0),
        Feature("SimStall", category, "boolean", STALL, "Answers, but sends no pictures", initial=0),
        Feature("SimAnswerDelay", category, "float", ANSWER_DELAY_MS,
                "Holds every frame, and what is asked meanwhile, back", unit="ms", minimum=0.0, maximum=10_000.0,
                initial=0.0),
        Feature("SimDisconnect", category, "boolean", DISCONNECT, "Falls silent for good", initial=0),
    ]  # fmt: skip
