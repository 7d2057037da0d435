"""How well the colour of lights outside the training set is found: spectra, cameras and charts of colour-science.

python -m benchmarks colour

Real displays need ../shared/data and are left out where that is absent.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import colour as peer
import numpy as np

from benchmarks._sections import write_section
from radiometer.analysis.colour.calibration import ColourCalibration
from radiometer.analysis.colour.chromaticity import coordinates
from radiometer.analysis.colour.matrix import Training
from radiometer.analysis.colour.plausible import COLOURS, GRID_NM, SURFACES, tristimulus_of
from radiometer.analysis.colour.train import ColourCamera, train_on_lights
from radiometer.typing import Array
from simulators.cameras.colour_filters import ColourFilters

SEED, DRAWS = 880_001, 20
NOISE_REL = 0.002
_DISPLAYS = Path(__file__).resolve().parents[2] / "shared" / "data" / "displays" / "isetbio"
_LEDS = ("3-LED", "4-LED", "Luxeon", "PHOS", "Phosphor")
_FLUORESCENT = ("FL", "Triphosphor", "Fluor", "TL-84", "Polylux", "Luxline")


@dataclass(frozen=True)
class Lights:
    """Lights of one kind that no table of the product holds."""

    name: str
    kind: str | None
    powers: Array


def spectra(table: object, names: list[str]) -> Array:
    """Return spectra of a table by name, over the grid, shape (lights, wavelengths)."""
    return np.stack([np.interp(GRID_NM, table[n].wavelengths, table[n].values, left=0, right=0) for n in names])  # type: ignore[index]


def displays(rng: np.random.Generator) -> list[Lights]:
    """Return mixtures of the primaries of measured displays."""
    apple = peer.MSDS_DISPLAY_PRIMARIES["Apple Studio Display"]
    known = [("Apple Studio Display", "ccfl_lcd", np.stack([np.interp(GRID_NM, apple.wavelengths, v, left=0, right=0)
                                                           for v in apple.values.T]))]  # fmt: skip
    for name, kind in (("LCD-Dell", "ccfl_lcd"), ("OLED-Sony", "oled")):
        file = _DISPLAYS / f"{name}_spd_W_sr_m2_nm.csv"
        if file.exists():
            table = np.loadtxt(file, delimiter=",", skiprows=1)
            known.append((name, kind, np.stack([np.interp(GRID_NM, table[:, 0], table[:, n]) for n in (1, 2, 3)])))
    return [Lights(name, kind, rng.uniform(0.0, 1.0, (24, 3)) @ primaries) for name, kind, primaries in known]


def outside(chart: Array, rng: np.random.Generator) -> list[Lights]:
    """Return the lights that the training does not hold."""
    lamps, illuminants = peer.SDS_LIGHT_SOURCES, peer.SDS_ILLUMINANTS
    fluorescent = np.vstack([
        spectra(lamps, [n for n in lamps if any(word in n for word in _FLUORESCENT)]),
        spectra(illuminants, [n for n in illuminants if n.startswith("FL") and n not in {"FL2", "FL11"}]),
    ])  # fmt: skip
    under = spectra(illuminants, ["FL4", "FL7", "LED-V2", "LED-RGB1", "D50"])
    return [
        Lights("white LEDs", "white_leds", spectra(lamps, [n for n in lamps if n.startswith(_LEDS)])),
        Lights("fluorescent lamps", "fluorescent_lamps", fluorescent),
        Lights("incandescent lamps", "incandescent_lamps", spectra(lamps, ["Incandescent", "60 A/W (Soft White)"])),
        Lights("daylight", "daylight", spectra(illuminants, ["D50", "D55", "D60", "D75", "ID50", "ID65"])),
        Lights("chart under other lamps", SURFACES, (under[:, None] * chart).reshape(-1, GRID_NM.size)),
        *displays(rng),
    ]


def read(powers: Array, kind: str, camera: Array, rng: np.random.Generator) -> Training:
    """Return lights as a camera reads them, with noise, and their true X, Y, Z."""
    exact = powers @ camera.T
    u_signal = NOISE_REL * exact
    signal = exact + u_signal * rng.standard_normal(exact.shape)
    names = tuple(f"light {n}" for n in range(len(powers)))
    return Training(names, (kind,) * len(powers), signal, u_signal, tristimulus_of(powers), np.full(len(powers), 1e-3))


def deviations(known: ColourCalibration, lights: Training, kind: str | None) -> tuple[Array, Array]:
    """Return (measured − true)/u of X, Y, Z, shape (lights, 3), and the relative expanded uncertainty of Y."""
    xyz, spread = known.convert(lights.signal, np.eye(3) * lights.u_signal[:, None, :] ** 2, kind)
    u = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
    return (xyz - lights.xyz) / u, 2.0 * u[:, 1] / lights.xyz[:, 1]


def cameras() -> dict[str, Array]:
    """Return responsivities per watt of cameras over the grid, shape (3, wavelengths) each."""
    found = {"simulated": np.stack([ColourFilters().responsivity(one, GRID_NM) for one in COLOURS])}
    for name in peer.MSDS_CAMERA_SENSITIVITIES:
        one = peer.MSDS_CAMERA_SENSITIVITIES[name]
        found[name] = np.stack([np.interp(GRID_NM, one.wavelengths, v, left=0, right=0) for v in one.values.T])
    return found


def trained(powers: Array, kind: str, camera: Array, rng: np.random.Generator, *, stated: bool) -> ColourCalibration:
    """Return the calibration by lights that a camera reads, its responsivities stated or not."""
    own = ColourCamera(COLOURS, responsivities=camera if stated else None)
    return train_on_lights(own, read(powers, kind, camera, rng), powers=None, per_kind=False, u_rel=0.0)


def coverage(training: Lights, light: Lights, rng: np.random.Generator, *, stated: bool) -> tuple[float, float]:
    """Return the share of X, Y, Z within k = 2, and the median relative expanded uncertainty of Y."""
    off, wide = list[Array](), list[Array]()
    for camera in cameras().values():
        for _ in range(DRAWS):
            known = trained(training.powers, training.kind or "", camera, rng, stated=stated)
            z, u = deviations(known, read(light.powers, "", camera, rng), light.kind)
            off.append(np.abs(z))
            wide.append(u)
    return float(np.mean(np.concatenate(off) <= 2.0)), float(np.median(np.concatenate(wide)))


def inside(chart: Array, five: Array, rng: np.random.Generator) -> str:
    """Return the sentences on lights of the training set: 24 patches under five lamps, and greys under one."""
    rows, cct, duv = list[Array](), list[Array](), list[Array]()
    powers, greys = (five[:, None] * chart).reshape(-1, GRID_NM.size), chart[18:22]
    for camera in cameras().values():
        for _ in range(DRAWS):
            known = trained(powers, SURFACES, camera, rng, stated=True)
            rows.append(np.abs(deviations(known, read(powers, SURFACES, camera, rng), SURFACES)[0]))
            for lamp in five:
                best = trained(chart * lamp, SURFACES, camera, rng, stated=True)
                again, none = read(greys * lamp, SURFACES, camera, rng), np.zeros((3, 3))
                found, true = (
                    coordinates(one, none) for one in (best.convert(again.signal, none, SURFACES)[0], again.xyz)
                )
                cct.append(np.abs(found.cct_k / true.cct_k - 1.0))
                duv.append(np.abs(found.duv - true.duv))
    off, cct_off, duv_off = (np.concatenate(one) for one in (rows, cct, duv))
    cct_share, cct_median = 100 * np.mean(cct_off < 0.01), 100 * np.median(cct_off)
    duv_share, duv_median = 100 * np.mean(duv_off < 0.001), np.median(duv_off)
    return (
        f"24 patches of a chart under five lamps, one matrix: {100 * np.mean(off <= 1.5):.1f} % of X, Y, Z are within "
        f"1.5 u. Greys under a lamp by the matrix of that lamp: CCT is within 1 % in {cct_share:.0f} % (median "
        f"{cct_median:.2g} %), Duv within 0.001 in {duv_share:.0f} % (median {duv_median:.1g})."
    )


def main() -> None:
    """Train on a chart and on displays, measure the lights outside, and write the section."""
    sds, rng = peer.SDS_COLOURCHECKERS["BabelColor Average"], np.random.default_rng(SEED)
    chart = spectra(sds, list(sds))
    five = spectra(peer.SDS_ILLUMINANTS, ["D65", "A", "LED-B3", "LED-B5", "FL11"])
    lights = outside(chart, rng)
    rows, shares = list[str](), list[float]()
    for training in (Lights("chart under D65", SURFACES, chart * five[0]), *displays(rng)):
        for stated in (True, False):
            for light in lights:
                if light.name == training.name:
                    continue
                share, wide = coverage(training, light, rng, stated=stated)
                shares.append(share)
                known = "known" if stated else "unknown"
                rows.append(f"| {training.name} | {light.name} | {known} | {100 * share:.0f} % | {100 * wide:.2g} % |")
                print(rows[-1], flush=True)
    head = (
        f"Three cameras, {DRAWS} draws each, readings with {100 * NOISE_REL:g} % noise, seed {SEED}.\n\n"
        f"{inside(chart, five, rng)}\n\nLights outside the training set, by a matrix of a chart or of a display: in "
        f"all, {100 * np.mean(shares):.0f} % are within k = 2.\n\n"
        "| training | measured | responsivities | within k = 2 | median U of Y |\n|---|---|---|---|---|\n"
    )
    print(head)
    write_section("colour", "Colour", "python -m benchmarks colour", head + "\n".join(rows))


if __name__ == "__main__":
    main()
