"""The features of a Blackfly S as awkward as the real one, after its description and public reports.

Source: FLIR's descriptions of BFS-PGE-19S4 and BFS-U3-161S7; AravisProject/aravis issues 312, 492, 1045.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from radiometer.devices import CameraCapabilities
from simulators.cameras.blackfly_features import blackfly_features
from simulators.cameras.genicam_document import Feature
from simulators.cameras.pixel_packing import WIRE_FORMATS

FORMATS: Final = ("Mono8", "Mono16", "Mono10p", "Mono12Packed", "Mono12p")  # no plain Mono10, Mono12
_FAMILY_FORMATS: Final = {"BayerRG8": 0x01080009, "RGB8Packed": 0x02180014}  # described, but not of this model
EXPOSURE_WHOLE_US, TEST_PATTERN, TEST_PATTERN_SELECTOR = 0x5000, 0x5008, 0x5018
CHUNK_MODE, CHUNK_SELECTOR, CHUNK_ENABLE = 0x5020, 0x5024, 0x5040
LINK_SPEED, THROUGHPUT_LIMIT = 0x5030, 0x5034
USER_SET_SELECTOR, USER_SET_LOAD, ADC_BITS = 0x5100, 0x5104, 0x5108
# GigE Vision's bootstrap registers of the first stream channel.
STREAM_PORT, STREAM_PACKET, STREAM_ADDRESS = 0x0D00, 0x0D04, 0x0D18

CHUNK_ENTRIES: Final = {"Image": 0, "CRC": 1, "FrameID": 2, "ExposureTime": 7, "Gain": 8, "BlackLevel": 9}
CHUNK_IDS: Final = {"ExposureTime": 0x05040008, "Gain": 0x05200009, "BlackLevel": 0x0504000B}
GAIN_DB_PER_RAW: Final = 6.020599913 / 2**14
BLACK_PERCENT_PER_RAW: Final = 100 / 2**24
_CHUNK_FORMULAS: Final = {
    "ExposureTime": ("RAW*1", "us"),
    "Gain": ("RAW*6.020599913/(2**14)", "dB"),
    "BlackLevel": ("RAW/(2**24)*100", "%"),
}
GIGABIT_BYTES_S: Final = 125_000_000  # 1 Gbit/s in bytes


def awkward_features(limits: CameraCapabilities, native_bit_depth: int, temperature_c: float) -> list[Feature]:
    """Return the features of the awkward camera; arguments as of `blackfly_features`."""
    plain = blackfly_features(replace(limits, pixel_formats=FORMATS), native_bit_depth, temperature_c)
    return [*(_made_awkward(feature) for feature in plain), *_further(), *_chunks()]


def _made_awkward(feature: Feature) -> Feature:
    if feature.name == "ExposureTime":  # a register of whole µs
        low, high = round(float(feature.minimum or 0)), round(float(feature.maximum or 0))
        return replace(feature, address=EXPOSURE_WHOLE_US, whole=True, minimum=low, maximum=high, initial=10_000)
    if feature.name == "AcquisitionFrameRateEnable":  # on, and refused by whoever wants it off
        return replace(feature, initial=1, access="RO")
    if feature.name == "AcquisitionFrameRate":
        return replace(feature, initial=131.0)
    if feature.name == "PixelFormat":
        codes = {name: WIRE_FORMATS[name].code for name in FORMATS} | _FAMILY_FORMATS
        return replace(feature, entries=codes, absent=frozenset(_FAMILY_FORMATS))
    if feature.name == "PayloadSize":
        chunks = {f"C{number}": f"{name}ChunkOn" for number, name in enumerate(CHUNK_IDS)}
        size = f"{feature.formula} + A * (8 + 12 * ({' + '.join(chunks)}))"
        return replace(feature, formula=size, variables={**feature.variables, "A": "ChunkModeActiveWord", **chunks})
    return feature


def _further() -> list[Feature]:
    sets, bits = {"Default": 0, "UserSet0": 31, "UserSet1": 30}, {"Bit10": 1, "Bit12": 2}
    patterns = {"Off": 0, "Increment": 1, "SensorTestPattern": 3}
    return [
        Feature("UserSetSelector", "UserSetControl", "enumeration", USER_SET_SELECTOR, entries=sets, initial=0),
        Feature("UserSetLoad", "UserSetControl", "command", USER_SET_LOAD),
        Feature("AdcBitDepth", "ImageFormatControl", "enumeration", ADC_BITS, entries=bits, initial=1),
        Feature("TestPatternGeneratorSelector", "ImageFormatControl", "enumeration", TEST_PATTERN_SELECTOR,
                entries={"Sensor": 0, "PipelineStart": 1}, initial=0),
        Feature("TestPattern", "ImageFormatControl", "enumeration", TEST_PATTERN, entries=patterns,
                selected_by="TestPatternGeneratorSelectorRegister"),
        Feature("PipelinePattern", "", "integer", TEST_PATTERN + 4, initial=1),
        Feature("DeviceLinkSpeed", "DeviceControl", "integer", LINK_SPEED, access="RO", initial=GIGABIT_BYTES_S),
        Feature("DeviceLinkThroughputLimit", "DeviceControl", "integer", THROUGHPUT_LIMIT, minimum=1_000_000,
                maximum=GIGABIT_BYTES_S, initial=GIGABIT_BYTES_S),
    ]  # fmt: skip


def _chunks() -> list[Feature]:
    category = "ChunkDataControl"
    words = [
        Feature(f"{name}ChunkOn", "", "integer", CHUNK_ENABLE + 4 * CHUNK_ENTRIES[name], initial=0)
        for name in CHUNK_IDS
    ]
    locks = {"SEL": "ChunkSelectorRegister"}
    return [
        Feature("ChunkModeActive", category, "boolean", CHUNK_MODE, initial=0),
        Feature("ChunkModeActiveWord", "", "integer", CHUNK_MODE),
        Feature("ChunkSelector", category, "enumeration", CHUNK_SELECTOR, entries=CHUNK_ENTRIES, initial=0),
        Feature("ChunkEnableLocked", "", "formula", 0, formula="SEL < 2 ? 1 : 0", variables=locks),
        Feature("ChunkEnable", category, "boolean", CHUNK_ENABLE, selected_by="ChunkSelectorRegister",
                locked_by="ChunkEnableLocked"),
        *words,
        *(
            Feature(
                f"Chunk{name}",
                category,
                "chunk",
                0,
                unit=_CHUNK_FORMULAS[name][1],
                formula=_CHUNK_FORMULAS[name][0],
                chunk_id=f"{number:08X}",
            )
            for name, number in CHUNK_IDS.items()
        ),
    ]  # fmt: skip
