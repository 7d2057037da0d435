"""A camera before a scene whose world may leave the budget's model, simulated apart from forward model and analysis."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from radiometer.analysis.photometry.photometry import spectrum
from radiometer.data import CameraDescription, Frame, FrameSettings, LensDescription
from radiometer.devices import AcquisitionCounts, CameraCapabilities, CameraIdentity, CameraSettings

PHOTON_J = 6.62607015e-34 * 299_792_458.0 / 550e-9
FULL_SCALE, SIZE = 4095, (64, 96)
GAIN_E_PER_DN, READ_E, FULL_WELL_E, DARK_E_PER_S, BLACK_DN = 5.95, 5.4, 26_000.0, 4.4, 64.0
QUANTUM_EFFICIENCY, PITCH_M, SPACING_UM = 0.62, 4.5e-6, 75.0
_READOUT_S = 1.0 / 131.0


@dataclass(frozen=True)
class World:
    """What is true of camera, lens, light and scene; the defaults are what the budget's own model takes for true.

    Attributes:
        radiance: Of the patch in W·sr⁻¹·m⁻².
        surround: Radiance around the patch over that of the patch.
        patch: (x, y, width, height) of it.
        responsivity: Relative responsivity of the camera.
        temperature_c: Of the sensor.
        thermometer: Whether the camera states that temperature.
        temperature_slope: Relative change of the responsivity per K from 40 °C.
        exposure_offset_s: Real exposure times beyond the stated ones.
        gain_error: Relative error of any gain but 0 dB.
        black_offset_dn: Real black level beyond the stated one.
        dark_factor: Real dark current over the data sheet's.
        glare: Part of the picture's mean that the lens spreads evenly.
        falloff: Power of cos α of the fall-off; 0 for none.
        falloff_mm: Focal length that the fall-off follows.
        bend: Relative loss of signal at full scale.
        prnu: Relative spread of the pixels' responsivity.
        transmittance: Of lens and filter.
        stop_error: Relative error of the f-number.
        magnification: Of the focus.
        light: Name of the light's spectrum.
        response: Relative response of the camera per watt at `GRID_NM`; None for a camera that sees all light alike.
        ripple: (modulation, frequency in Hz, "sine" or "pwm").
    """

    radiance: float = 1.0
    surround: float = 1.0
    patch: tuple[int, int, int, int] = (38, 22, 20, 20)
    responsivity: float = 1.0
    temperature_c: float = 40.0
    thermometer: bool = True
    temperature_slope: float = 0.0
    exposure_offset_s: float = 0.0
    gain_error: float = 0.0
    black_offset_dn: float = 0.0
    dark_factor: float = 1.0
    glare: float = 0.0
    falloff: float = 4.0
    falloff_mm: float = 16.0
    bend: float = 0.0
    prnu: float = 0.003
    transmittance: float = 0.9
    stop_error: float = 0.0
    magnification: float = 0.0
    light: str = "white_led"
    response: NDArray[np.float64] | None = None
    ripple: tuple[float, float, str] | None = None

    @property
    def seen(self) -> float:
        """Return the camera's response to the light over that to a white LED, per W·sr⁻¹·m⁻² from 380 to 780 nm."""
        if self.response is None:
            return 1.0
        of_light, of_white = (_mean_response(name, self.response) for name in (self.light, "white_led"))
        return of_light / of_white


GRID_NM = np.arange(380.0, 781.0)


def _mean_response(name: str, response: NDArray[np.float64]) -> float:
    known = spectrum(name)
    power = np.interp(GRID_NM, known.wavelength_nm, known.power, left=0.0, right=0.0)
    return float(power @ response / power.sum())


@dataclass
class WorldCamera:
    """A Camera in a world; what it says of itself is what its data sheet, bench and settings say."""

    world: World
    lens: LensDescription
    rng: np.random.Generator
    pattern: NDArray[np.float64]
    phase: float = 0.0
    gain_db: float = 0.0
    clock_s: float = 0.0
    _settings: CameraSettings = field(default_factory=lambda: CameraSettings(0.01, 0.0, BLACK_DN))

    def __post_init__(self) -> None:
        self._settings = replace(self._settings, gain_db=self.gain_db)
        self._light = self._irradiance()

    identity = CameraIdentity("radiometer", "world", "1", "world")
    capabilities = CameraCapabilities(
        (11e-6, 30.0), (0.0, 48.0), (0.0, 511.0), ("Mono12",), SIZE[1], SIZE[0], has_temperature=True
    )
    counts = AcquisitionCounts()

    @property
    def settings(self) -> CameraSettings:
        return self._settings

    @property
    def description(self) -> CameraDescription:
        return DESCRIPTION

    def _irradiance(self) -> NDArray[np.float64]:
        """Return electrons per s at every pixel."""
        w, (height, width) = self.world, SIZE
        scene = np.full(SIZE, w.surround * w.radiance)
        x, y, across, down = w.patch
        scene[y : y + down, x : x + across] = w.radiance
        rows, columns = np.mgrid[:height, :width]
        r2_mm2 = ((columns - (width - 1) / 2) ** 2 + (rows - (height - 1) / 2) ** 2) * (SPACING_UM * 1e-3) ** 2
        scene = scene * (1.0 + r2_mm2 / w.falloff_mm**2) ** (-w.falloff / 2.0)
        scene = (1.0 - w.glare) * scene + w.glare * scene.mean()
        stop = (self.lens.f_number or 4.0) * (1.0 + w.stop_error)
        lens = math.pi * w.transmittance / (4.0 * stop**2 * (1.0 + w.magnification) ** 2)
        warm = 1.0 + w.temperature_slope * (w.temperature_c - 40.0)
        per_s = lens * PITCH_M**2 / PHOTON_J * QUANTUM_EFFICIENCY * w.responsivity * warm * w.seen
        return scene * per_s * (1.0 + w.prnu * self.pattern)

    def open(self) -> None: ...

    def close(self) -> None: ...

    def configure(self, settings: CameraSettings) -> CameraSettings:
        self._settings = replace(settings, exposure_s=round(settings.exposure_s * 1e6) * 1e-6)
        return self._settings

    def capture(self, count: int = 1) -> list[Frame]:
        return [self._expose() for _ in range(count)]

    def stream(self) -> Iterator[Frame]:
        while True:
            yield self._expose()

    def set_shutter(self, *, closed: bool) -> None:
        raise NotImplementedError

    def _expose(self) -> Frame:
        w, set_to = self.world, self._settings
        real_s = max(set_to.exposure_s + w.exposure_offset_s, 1e-7)
        light = self._light * real_s * self._ripple(real_s)
        light = light * (1.0 - w.bend * light / (FULL_SCALE * GAIN_E_PER_DN))
        dark = DARK_E_PER_S * w.dark_factor * real_s
        electrons = np.minimum(self.rng.poisson(light + dark).astype(float), FULL_WELL_E)
        electrons += self.rng.normal(0.0, READ_E, SIZE)
        gain = 10.0 ** (set_to.gain_db / 20.0) * (1.0 + w.gain_error * (set_to.gain_db > 0.0))
        dn = electrons * gain / GAIN_E_PER_DN + BLACK_DN + w.black_offset_dn
        self.clock_s += set_to.exposure_s + _READOUT_S * (1.0 + 0.2 * self.rng.random())
        stated_c = w.temperature_c if w.thermometer else None
        stated = FrameSettings(set_to.exposure_s, set_to.gain_db, self.lens.f_number, BLACK_DN, stated_c, self.clock_s)
        return Frame(np.clip(np.rint(dn), 0, FULL_SCALE).astype(np.uint16), 12, stated)

    def _ripple(self, exposure_s: float) -> float:
        """Return the mean light of one exposure over the mean of a whole period."""
        if self.world.ripple is None:
            return 1.0
        depth, hertz, kind = self.world.ripple
        start, turns = self.clock_s * hertz + self.phase, exposure_s * hertz
        if kind == "sine":
            mean = (math.cos(2 * math.pi * start) - math.cos(2 * math.pi * (start + turns))) / (2 * math.pi * turns)
            return 1.0 + depth * mean
        grid = (start + turns * (np.arange(2048) + 0.5) / 2048) % 1.0
        return float(np.mean(grid < 1.0 - depth)) / (1.0 - depth)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


DESCRIPTION = CameraDescription(
    bit_depth=12,
    model="world",
    serial="1",
    pixel_pitch_um=PITCH_M * 1e6,
    pixel_spacing_um=SPACING_UM,
    conversion_gain_e_per_dn=GAIN_E_PER_DN,
    read_noise_e=READ_E,
    full_well_e=FULL_WELL_E,
    dark_current_e_per_s=DARK_E_PER_S,
    dark_current_reference_C=40.0,
    black_level_dn=BLACK_DN,
)
