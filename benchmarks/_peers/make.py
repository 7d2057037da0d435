"""Sessions developed by other people's simulators: Pyxel (ESA) and GalSim; nothing of this project stands behind them.

    python make.py CASE SEED FOLDER

Run by an interpreter that has pyxel-sim, galsim, opencv-python-headless and pyyaml, which this project does not need.
Writes a capture set (docs/formats.md) and `FOLDER.truth.yaml`. The camera, its plan and its chart are drawn here; light
to charge, charge to volts and volts to codes are the peers' functions with the peers' parameters.
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import galsim
import numpy as np
import yaml
from pyxel.detectors import CMOS, Characteristics, CMOSGeometry, Environment
from pyxel.detectors.charge_to_volt_settings import ChargeToVoltSettings
from pyxel.models import (
    charge_collection,
    charge_generation,
    charge_measurement,
    photon_collection,
    readout_electronics,
)

PLANCK_C = 6.62607015e-34 * 299792458.0
ROWS, COLUMNS = 4, 5
FRAMES = 4
Act = Callable[["Rig", "Shot"], None]


@dataclass(frozen=True)
class Shot:
    """One frame: exposure, gain, temperature, level of the source, open or closed; time and rest before it."""

    seconds: float
    gain_db: float = 0.0
    celsius: float = 25.0
    level: float = 1.0
    lit: bool = True
    time_s: float = 0.0
    idle_s: float = 1.0


@dataclass
class Rig:
    """A drawn camera with the peers' detector in it, and what is hidden, by the place in the chain where it acts."""

    seed: int
    height: int
    width: int
    e_per_dn: float
    noise_e: float
    well_e: float
    black_dn: float
    quantum: float
    pitch_um: float
    stop: float
    volts_per_e: float = 5e-6
    stated: dict[str, Any] = field(default_factory=dict)
    charge: list[Act] = field(default_factory=list)
    pixel: list[Act] = field(default_factory=list)
    node: list[Act] = field(default_factory=list)
    signal: list[Act] = field(default_factory=list)
    convert: Act | None = None
    scene: Callable[[np.ndarray], np.ndarray] = lambda picture: picture
    amplifier_off: float = 1.0
    truncated: bool = False
    longest_s: float = 0.02
    detector: Any = None

    @property
    def e_per_radiance_second(self) -> float:
        """Electrons per pixel for 1 W/(sr m2) and 1 s of 550 nm."""
        return np.pi * 0.9 / (4 * self.stop**2) * (self.pitch_um * 1e-6) ** 2 * self.quantum * 550e-9 / PLANCK_C

    def assembled(self) -> Rig:
        """Put the detector together; its converter has 12 bits over so many volts as the conversion gain asks for."""
        self.detector = CMOS(
            geometry=CMOSGeometry(row=self.height, col=self.width, total_thickness=10.0,
                                  pixel_vert_size=self.pitch_um, pixel_horz_size=self.pitch_um),
            environment=Environment(temperature=298.15),
            characteristics=Characteristics(
                quantum_efficiency=self.quantum, charge_to_volt=ChargeToVoltSettings(value=self.volts_per_e),
                pre_amplification=1.0, full_well_capacity=self.well_e, adc_bit_resolution=12,
                adc_voltage_range=(0.0, 4095 * self.volts_per_e * self.e_per_dn),
            ),
        )  # fmt: skip
        return self

    def expose(self, radiance: np.ndarray, shot: Shot) -> np.ndarray:
        """Return the codes of one frame."""
        it = self.detector
        it.environment.temperature = shot.celsius + 273.15
        gain = 10 ** (shot.gain_db / 20)
        it.characteristics.pre_amplification = gain * self.amplifier_off
        it.set_readout(times=[shot.seconds])
        it.readout_properties.time_step = shot.seconds
        it.empty()
        light = self.scene(radiance) * (shot.level if shot.lit else 0.0)
        it.photon.array_2d = light * self.e_per_radiance_second / self.quantum * shot.seconds
        photon_collection.shot_noise(it)
        charge_generation.simple_conversion(it)
        for act in self.charge:
            act(self, shot)
        charge_collection.simple_collection(it)
        for act in self.pixel:
            act(self, shot)
        charge_collection.simple_full_well(it)
        charge_measurement.simple_measurement(it)
        for act in self.node:
            act(self, shot)
        charge_measurement.output_node_noise(it, std_deviation=self.noise_e * self.volts_per_e)
        for act in self.signal:
            act(self, shot)
        readout_electronics.simple_amplifier(it)
        lsb = self.volts_per_e * self.e_per_dn
        charge_measurement.dc_offset(it, offset=(self.black_dn + (0.0 if self.truncated else 0.5)) * lsb)
        if self.convert is None:
            readout_electronics.simple_adc(it)  # cuts off, does not round: half a code is in the offset above
        else:
            self.convert(self, shot)
        return np.asarray(it.image.array).astype(np.uint16)


def drawn_rig(seed: int, dice: np.random.Generator) -> Rig:
    """Return a camera of its own."""
    e_per_dn = round(dice.uniform(1.8, 3.6), 3)
    return Rig(
        seed=seed,
        height=int(dice.integers(14, 18)) * 8,
        width=int(dice.integers(18, 23)) * 8,
        e_per_dn=e_per_dn,
        noise_e=round(dice.uniform(3.0, 7.0), 2),
        well_e=round(e_per_dn * dice.uniform(3200, 3650), -1),
        black_dn=float(dice.integers(60, 240)),
        quantum=round(dice.uniform(0.45, 0.7), 2),
        pitch_um=float(dice.choice([3.45, 4.8, 5.5])),
        stop=float(dice.choice([2.8, 4.0, 5.6])),
    )


# ---- what is hidden: each returns what it drew ---------------------------------------------------------------


def nothing(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    return {}


def truncating(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    """Pyxel's simple_adc cuts off; who states the offset voltage over the step is half a code too high."""
    rig.truncated = True
    return {"offset_dn": -0.5}


def dark_silicon(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    figure = float(dice.uniform(0.05, 0.3))  # nA/cm2 at 300 K
    rig.charge.append(lambda r, s: charge_generation.dark_current(r.detector, figure_of_merit=figure))
    return {"figure_of_merit_nA_per_cm2": figure}


def irradiated(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    dose, seed = float(dice.uniform(30.0, 120.0)), int(dice.integers(1 << 30))

    def leak(r: Rig, s: Shot) -> None:  # the pattern stays by its seed; the shot noise of the leak is drawn after it
        before = r.detector.charge.array.copy()
        charge_generation.radiation_induced_dark_current(
            r.detector, depletion_volume=64.0, annealing_time=0.1, displacement_dose=dose, shot_noise=False, seed=seed
        )
        own = r.detector.charge.array - before
        r.detector.charge.add_charge_array(np.random.poisson(np.maximum(own, 0.0)) - own)  # noqa: NPY002  (the peers' source)

    rig.charge.append(leak)
    return {"displacement_dose_TeV_per_g": dose}


def dark_simple(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    rate = float(dice.uniform(4.0, 40.0))
    rig.charge.append(lambda r, s: charge_generation.simple_dark_current(r.detector, dark_rate=rate))
    return {"rate_e_per_s": rate}


def prnu(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    sigma = float(dice.uniform(0.004, 0.015))
    table = Path(tempfile.mkdtemp()) / "prnu.npy"  # a factor of its own would double the charge behind the shot noise
    np.save(table, 1 + sigma * dice.standard_normal((rig.height, rig.width)))
    rig.pixel.append(lambda r, s: charge_collection.fixed_pattern_noise(r.detector, filename=table))
    return {"sigma_rel": sigma}


def low_well(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    share = float(dice.uniform(0.55, 0.75))
    fwc = int(rig.well_e * share)
    rig.pixel.append(lambda r, s: charge_collection.simple_full_well(r.detector, fwc=fwc))
    return {"full_well_e": fwc}


def persistence(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    density, tau = float(dice.uniform(0.01, 0.05)), float(dice.uniform(1.0, 5.0))
    rig.longest_s = 4.0  # charge is trapped and let go in seconds

    def trap(r: Rig, s: Shot) -> None:
        if r.detector.has_persistence():  # what is released while nothing is read is swept away by the reset
            now = r.detector.pixel.array.copy()
            r.detector.pixel.array = np.zeros_like(now)
            r.detector.readout_properties.time_step = s.idle_s
            charge_collection.simple_persistence(r.detector, [tau], [density])
            r.detector.pixel.array = now
            r.detector.readout_properties.time_step = s.seconds
        charge_collection.simple_persistence(r.detector, [tau], [density])

    rig.pixel.append(trap)
    return {"density": density, "time_constant_s": tau}


def ipc(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    coupling = float(dice.uniform(0.004, 0.02))
    rig.node.append(lambda r, s: charge_measurement.simple_ipc(r.detector, coupling=coupling))
    return {"coupling": coupling}


def bent(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    bend = float(dice.uniform(0.01, 0.04))
    top_v = rig.well_e * rig.volts_per_e
    lifted_v = 0.02 * top_v  # the model cuts off below zero, where noise is; taken off again behind it, as clamps do

    def bow(r: Rig, s: Shot) -> None:
        r.detector.signal.array = r.detector.signal.array + lifted_v
        charge_measurement.output_node_linearity_poly(r.detector, coefficients=[0.0, 1.0, -bend / top_v])
        r.detector.signal.array = r.detector.signal.array - lifted_v * (1 - bend * lifted_v / top_v)

    rig.signal.append(bow)
    return {"bend_at_full_well": bend}


def ktc(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    farad = 1.380649e-23 * 298.15 / (rig.volts_per_e * rig.noise_e * float(dice.uniform(0.6, 1.2))) ** 2
    rig.signal.append(lambda r, s: charge_measurement.ktc_noise(r.detector, node_capacitance=farad))
    return {"capacitance_fF": farad * 1e15}


def amplifier(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    rig.amplifier_off = 1 + float(dice.choice([-1, 1]) * dice.uniform(0.03, 0.08))
    return {"gain_over_stated": rig.amplifier_off}


def alternating(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    std = rig.noise_e * float(dice.uniform(0.5, 0.9))
    rig.signal.append(lambda r, s: charge_measurement.alternating_column_noise_cmos(r.detector, std=std))
    return {"std_e": std}


def pink(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    std = rig.noise_e * float(dice.uniform(0.5, 0.9))
    rig.signal.append(lambda r, s: charge_measurement.uncorrelated_pink_noise_cmos(r.detector, std=std))
    return {"std_e": std}


def self_glow(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    mean = float(dice.uniform(4.0, 12.0))
    rig.pixel.append(lambda r, s: charge_collection.glow(r.detector, glow_per_frame=mean, std_deviation=np.sqrt(mean)))
    return {"glow_e": mean}


def sar_noise(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    lsb = rig.volts_per_e * rig.e_per_dn
    off = tuple(float(v) for v in lsb * dice.uniform(-1.5, 1.5, 12) * (np.arange(12) < 3))

    def convert(r: Rig, s: Shot) -> None:
        readout_electronics.sar_adc_with_noise(r.detector, strengths=off, noises=(0.0,) * 12)

    rig.convert = convert
    return {"first_three_bits_off_dn": [v / lsb for v in off[:3]]}


def _in_galsim(rig: Rig, act: Callable[[galsim.Image, Shot], None]) -> None:
    def on_pixels(r: Rig, s: Shot) -> None:
        image = galsim.Image(np.asarray(r.detector.pixel.array, dtype=float).copy())
        act(image, s)
        r.detector.pixel.array = image.array.copy()

    rig.pixel.append(on_pixels)


def reciprocity(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    alpha = float(dice.uniform(0.004, 0.015))

    def fail(image: galsim.Image, shot: Shot) -> None:
        if shot.lit:
            image.addReciprocityFailure(shot.seconds, alpha, 0.5 * rig.well_e / 0.01)

    _in_galsim(rig, fail)
    return {"alpha_per_decade": alpha}


def galsim_bent(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    beta = float(dice.uniform(0.01, 0.04)) / rig.well_e
    _in_galsim(rig, lambda image, shot: image.applyNonlinearity(lambda e, b: e - b * e**2, beta))
    return {"beta_per_e": beta}


def galsim_ipc(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    a = float(dice.uniform(0.005, 0.02))
    kernel = galsim.Image(np.array([[a / 10, a, a / 10], [a, 1 - 4.4 * a, a], [a / 10, a, a / 10]]))
    _in_galsim(rig, lambda image, shot: image.applyIPC(kernel, edge_treatment="extend"))
    return {"a": a}


def galsim_lag(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    share, kept = float(dice.uniform(0.002, 0.008)), []

    def lag(image: galsim.Image, shot: Shot) -> None:
        own = image.copy()
        if kept:
            image.applyPersistence([kept[-1]], [share])
        kept[:] = [own]

    _in_galsim(rig, lag)
    return {"share": share}


def blurred(rig: Rig, dice: np.random.Generator) -> dict[str, Any]:
    half = float(dice.uniform(0.6, 1.3))
    psf = galsim.Moffat(beta=3.5, half_light_radius=half)

    def through(picture: np.ndarray) -> np.ndarray:
        stamp = psf.drawImage(nx=21, ny=21, scale=1.0, method="no_pixel").array
        return cv2.filter2D(picture, -1, stamp / stamp.sum(), borderType=cv2.BORDER_REPLICATE)

    rig.scene = through
    return {"half_light_radius_px": half}


_BENT = ("response_nonlinearity", "soft_saturation")
_LAG = ("image_lag",)
_LINES = ("correlated_read_noise", "excess_read_noise", "row_temporal_noise")
CASES: dict[str, tuple[Callable[[Rig, np.random.Generator], dict[str, Any]], str, tuple[str, ...]]] = {
    "null": (nothing, "null", ()),
    "truncating_adc": (truncating, "single", ("black_level_offset",)),
    "dark_silicon": (dark_silicon, "single", ("dark_current",)),
    "dark_simple": (dark_simple, "single", ("dark_current", "dark_current_clamped")),
    "irradiated": (irradiated, "single", ("hot_pixels", "dark_current", "dark_current_nonuniformity")),
    "prnu": (prnu, "single", ("prnu",)),
    "low_well": (low_well, "single", ("full_well_saturation",)),
    "persistence": (persistence, "single", _LAG),
    "ipc": (ipc, "single", ("crosstalk",)),
    "output_node_poly": (bent, "single", _BENT),
    "ktc_noise": (ktc, "single", ("excess_read_noise",)),
    "amplifier": (amplifier, "single", ("conversion_gain_error",)),
    "alternating_columns": (
        alternating,
        "outsider",
        ("correlated_read_noise", "excess_read_noise", "row_temporal_noise"),
    ),
    "pink_noise": (pink, "outsider", _LINES),
    "self_glow": (self_glow, "outsider", ("black_level_offset", "black_level_gain_slope", "excess_read_noise")),
    "sar_adc": (sar_noise, "outsider", ("missing_codes",)),
    "galsim_reciprocity": (reciprocity, "outsider", ("reciprocity_failure",)),  # of the rate of light, not of the time
    "galsim_nonlinearity": (galsim_bent, "single", _BENT),
    "galsim_ipc": (galsim_ipc, "single", ("crosstalk",)),
    "galsim_persistence": (galsim_lag, "single", _LAG),
    "galsim_moffat": (blurred, "single", ("psf_blur", "defocus", "stray_light_kernel")),
}


def plan_of(dice: np.random.Generator, longest_s: float) -> list[Shot]:
    """Return one shot for each setting: a ladder, levels of the source, gains, and darks at two temperatures."""
    longest = longest_s * dice.uniform(0.6, 1.6)
    ladder = [float(f"{longest / 2**k:.4g}") for k in range(8)]
    shots = [Shot(t) for t in ladder] * 2
    shots += [Shot(t, level=level) for t in ladder[:5:2] for level in (0.1, 0.3, 0.6)]
    shots += [Shot(ladder[1], gain_db=g, level=10 ** (-g / 20)) for g in (6.0, 12.0)] * 2
    shots = [shots[i] for i in dice.permutation(len(shots))]
    darks = [Shot(t, celsius=c, lit=False) for t in (ladder[0], 0.5, 4.0) for c in (25.0, 35.0)]
    darks += [Shot(ladder[0], gain_db=12.0, lit=False)]
    return shots + sorted(darks, key=lambda s: s.celsius)


def main() -> None:
    if sys.argv[1:] == ["--cases"]:
        print(*CASES)
        return
    case, seed, folder = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
    warnings.simplefilter("ignore")
    hide, kind, right = CASES[case]
    dice = np.random.default_rng([seed, sum(map(ord, case))])
    np.random.seed(int(dice.integers(1 << 31)))  # noqa: NPY002  (the peers draw from it)
    rig = drawn_rig(seed, dice)
    drawn = hide(rig, dice)
    rig.assembled()
    shots = plan_of(dice, rig.longest_s)
    peak = 0.8 * min(rig.well_e, (4095 - rig.black_dn) * rig.e_per_dn)
    peak /= rig.e_per_radiance_second * max(s.seconds for s in shots if s.lit)
    picture, patches = chart(rig, dice, peak)
    (folder / "frames").mkdir(parents=True)
    entries, time_s = [], 0.0
    for shot in shots:
        idle, warm = dice.uniform(1.0, 12.0), shot.celsius + 0.1 * dice.standard_normal()
        wander = 1 + 0.001 * dice.standard_normal()
        for _ in range(FRAMES):
            time_s += idle
            now = replace(shot, celsius=warm, time_s=time_s, idle_s=idle)
            codes = rig.expose(picture * wander, now)
            name = f"frames/{len(entries):04d}.png"
            cv2.imwrite(str(folder / name), codes)
            entries.append({
                "file": name, "exposure_s": shot.seconds, "gain_db": shot.gain_db, "f_number": rig.stop,
                "black_level_dn": rig.black_dn, "temperature_C": round(warm, 1), "timestamp_s": round(time_s, 4),
                "source_level": shot.level, "pattern": "chart", "shutter": "open" if shot.lit else "closed",
            })  # fmt: skip
            time_s, idle = time_s + shot.seconds, 0.1
    header = {
        "format": "radiometer-capture/1",
        "camera": {
            "vendor": "ESA Pyxel", "model": "CMOS", "bit_depth": 12, "pixel_pitch_um": rig.pitch_um,
            "conversion_gain_e_per_dn": rig.e_per_dn, "read_noise_e": rig.noise_e, "full_well_e": rig.well_e,
            "dark_current_e_per_s": 0.0, "dark_current_reference_C": 25.0, "dark_current_doubling_K": 7.0,
            "black_level_dn": rig.black_dn, "quantum_efficiency": rig.quantum,
        },
        "lens": {"focal_length_mm": 16.0, "f_number": rig.stop, "transmittance": 0.9, "transmittance_u_rel": 0.03,
                 "vignetting": "none"},
        "source": {"kind": "screen", "wavelength_nm": 550.0, "reproducibility_u_rel": 0.001},
        "patterns": ["chart"], "patches": patches, "frames": entries,
    }  # fmt: skip
    (folder / "capture.yaml").write_text(yaml.safe_dump(header, sort_keys=False), encoding="utf-8")
    truth = {"case": case, "kind": kind, "right": list(right), "drawn": drawn}
    folder.with_name(folder.name + ".truth.yaml").write_text(yaml.safe_dump(truth), encoding="utf-8")


def chart(rig: Rig, dice: np.random.Generator, peak: float) -> tuple[np.ndarray, list[dict[str, Any]]]:
    """Return the scene in W/(sr m2) and its patches as they are stated, to half a percent."""
    step_y, step_x = rig.height // ROWS, rig.width // COLUMNS
    tall, wide = int(step_y * 0.7), int(step_x * 0.7)
    levels = peak * np.geomspace(1.0, 1 / 60, ROWS * COLUMNS)[dice.permutation(ROWS * COLUMNS)]
    picture, stated = np.full((rig.height, rig.width), peak * 0.2), []
    for number, level in enumerate(levels):
        y = number // COLUMNS * step_y + (step_y - tall) // 2
        x = number % COLUMNS * step_x + (step_x - wide) // 2
        picture[y : y + tall, x : x + wide] = level
        text = float(f"{level * (1 + 0.005 * dice.standard_normal()):.6g}")
        stated.append({"name": f"p{number:02d}", "x": x + 3, "y": y + 3, "width": wide - 6, "height": tall - 6,
                       "radiance_W_per_sr_m2": text, "u_rel": 0.005})  # fmt: skip
    return picture, stated


if __name__ == "__main__":
    main()
