"""How well the colour of lights outside the training set is found: spectra, cameras and charts of colour-science.

python -m benchmarks colour

Real displays need ../shared/data and are left out where that is absent.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import colour as peer
import numpy as np

from benchmarks._sections import write_section
from radiometer.analysis.colour.calibration import SURFACES, ColourCalibration, ColourCamera, Training, train_on_lights
from radiometer.analysis.colour.chromaticity import coordinates
from radiometer.analysis.photometry.displays import GRID_NM, tristimulus_of
from radiometer.data.mosaic import COLOURS
from radiometer.typing import Array
from simulators.cameras.simulated_camera import ColourFilters

SEED, DRAWS = 2_300_001, 20
NOISE_REL = 0.002
NOISES_REL = (NOISE_REL, 0.0005, 0.0)  # of readings that give CCT and Duv: without noise the matrix alone is left
_DISPLAYS = Path(__file__).resolve().parents[2] / "shared" / "data" / "displays" / "isetbio"
_LEDS = ("3-LED", "4-LED", "Luxeon", "PHOS", "Phosphor")
_HELD = {"FL2", "FL4", "FL7", "FL8", "FL10", "FL11", "FL12"}  # that tables of the product hold
_FLUORESCENT = ("FL", "Triphosphor", "Fluor", "TL-84", "Polylux", "Luxline")


@dataclass(frozen=True)
class Lights:
    """Lights of one kind that no table of the product holds."""

    name: str
    kind: str | None
    powers: Array


def spectra(table: Any, names: list[str]) -> Array:
    """Return spectra of a table by name, over the grid, shape (lights, wavelengths)."""
    return np.stack([np.interp(GRID_NM, table[n].wavelengths, table[n].values, left=0, right=0) for n in names])


def measured_displays() -> list[tuple[str, str, Array]]:
    """Return name, type and primaries of measured displays, shape (3, wavelengths) each."""
    apple = peer.MSDS_DISPLAY_PRIMARIES["Apple Studio Display"]
    primaries = np.stack([np.interp(GRID_NM, apple.wavelengths, v, left=0, right=0) for v in apple.values.T])
    found = [("Apple Studio Display", "ccfl_lcd", primaries)]
    for name, kind in (("LCD-Dell", "ccfl_lcd"), ("OLED-Sony", "oled")):
        file = _DISPLAYS / f"{name}_spd_W_sr_m2_nm.csv"
        if file.exists():
            table = np.loadtxt(file, delimiter=",", skiprows=1)
            found.append((name, kind, np.stack([np.interp(GRID_NM, table[:, 0], table[:, n]) for n in (1, 2, 3)])))
    return found


def displays(rng: np.random.Generator) -> list[Lights]:
    """Return mixtures of the primaries of measured displays."""
    return [
        Lights(name, kind, rng.uniform(0.0, 1.0, (24, 3)) @ primaries) for name, kind, primaries in measured_displays()
    ]


def outside(chart: Array, rng: np.random.Generator) -> list[Lights]:
    """Return the lights that the training does not hold."""
    lamps, illuminants = peer.SDS_LIGHT_SOURCES, peer.SDS_ILLUMINANTS
    fluorescent = np.vstack([
        spectra(lamps, [n for n in lamps if any(word in n for word in _FLUORESCENT)]),
        spectra(illuminants, [n for n in illuminants if n.startswith("FL") and n not in _HELD]),
    ])  # fmt: skip
    under = spectra(illuminants, ["FL1", "FL3.8", "FL3.13", "LED-V2", "LED-BH1", "D50"])
    return [
        Lights("white LEDs", "white_leds", spectra(lamps, [n for n in lamps if n.startswith(_LEDS)])),
        Lights("fluorescent lamps", "fluorescent_lamps", fluorescent),
        Lights("incandescent lamps", "incandescent_lamps", spectra(lamps, ["Incandescent", "60 A/W (Soft White)"])),
        Lights("daylight", "daylight", spectra(illuminants, ["D50", "D55", "D60", "D75", "ID50", "ID65"])),
        Lights("chart under other lamps", SURFACES, (under[:, None] * chart).reshape(-1, GRID_NM.size)),
        *displays(rng),
    ]


def read(powers: Array, kind: str, camera: Array, rng: np.random.Generator, noise_rel: float = NOISE_REL) -> Training:
    """Return lights as a camera reads them, with noise, and their true X, Y, Z."""
    exact = powers @ camera.T
    u_signal = noise_rel * exact
    signal = exact + u_signal * rng.standard_normal(exact.shape)
    names = tuple(f"light {n}" for n in range(len(powers)))
    return Training(names, (kind,) * len(powers), signal, u_signal, tristimulus_of(powers), np.full(len(powers), 1e-3))


def deviations(known: ColourCalibration, lights: Training, kind: str | None) -> tuple[Array, Array]:
    """Return (measured − true)/u of X, Y, Z, shape (lights, 3), and the relative expanded uncertainty of Y."""
    xyz, spread = known.convert(lights.signal, np.eye(3) * lights.u_signal[:, None, :] ** 2, kind)
    u = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
    return (xyz - lights.xyz) / u, 2.0 * u[:, 1] / lights.xyz[:, 1]


def cameras() -> dict[str, Array]:
    """Return responsivities per watt of cameras over the grid, shape (3, wavelengths) each.

    The last has its colours in layers of silicon: no camera with filters is like it.
    """
    found = {"simulated": np.stack([ColourFilters().responsivity(one, GRID_NM) for one in COLOURS])}
    for name in peer.MSDS_CAMERA_SENSITIVITIES:
        one = peer.MSDS_CAMERA_SENSITIVITIES[name]
        found[name] = np.stack([np.interp(GRID_NM, one.wavelengths, v, left=0, right=0) for v in one.values.T])
    return found


def trained(
    powers: Array,
    kind: str,
    camera: Array,
    rng: np.random.Generator,
    *,
    stated: bool,
    noise_rel: float = NOISE_REL,
    white: str | None = None,
) -> ColourCalibration:
    """Return the calibration by lights that a camera reads, its responsivities stated or not; `white` is exact."""
    own = ColourCamera(COLOURS, responsivities=camera if stated else None)
    return train_on_lights(
        own, read(powers, kind, camera, rng, noise_rel), powers=None, per_kind=False, u_rel=0.0, white=white
    )


def coverage(training: Lights, light: Lights, rng: np.random.Generator, *, stated: bool) -> tuple[float, float]:
    """Return the share of X, Y, Z within k = 2, and the median relative expanded uncertainty of Y."""
    off, wide = list[Array](), list[Array]()
    for camera in list(cameras().values())[: None if stated else -1]:
        for _ in range(DRAWS):
            known = trained(training.powers, training.kind or "", camera, rng, stated=stated)
            z, u = deviations(known, read(light.powers, "", camera, rng), light.kind)
            off.append(np.abs(z))
            wide.append(u)
    return float(np.mean(np.concatenate(off) <= 2.0)), float(np.median(np.concatenate(wide)))


def inside(chart: Array, five: Array, rng: np.random.Generator) -> str:
    """Return the sentences on lights of the training set: 24 patches under five lamps, and whites."""
    rows, powers = list[Array](), (five[:, None] * chart).reshape(-1, GRID_NM.size)
    for camera in cameras().values():
        for _ in range(DRAWS):
            known = trained(powers, SURFACES, camera, rng, stated=True)
            rows.append(np.abs(deviations(known, read(powers, SURFACES, camera, rng), SURFACES)[0]))
    of_displays = [
        (
            np.vstack([primaries, primaries.sum(axis=0), 0.5 * primaries.sum(axis=0)]),
            rng.uniform(0.6, 1.0, (24, 3)) @ primaries,
        )
        for _, _, primaries in measured_displays()
    ]
    of_lamps = [(chart * lamp, chart[18:22] * lamp) for lamp in five]
    share = 100 * np.mean(np.concatenate(rows) <= 1.5)
    return (
        f"24 patches of a chart under five lamps, one matrix: {share:.1f} % of X, Y, Z are within "
        f"1.5 u. {whites('Whites of a display by its own matrix', of_displays, rng)} "
        f"{whites('Greys under a lamp by the matrix of a chart under it', of_lamps, rng)} "
        f"{whites('The same greys with --white', of_lamps, rng, 'light 18')} "
        "Noise limits the matrix of a display, for three primaries have an exact one. The matrix itself limits greys: "
        "it is the best for 24 colours, and no camera's three channels suit all of them (Luther). A matrix that gives "
        "the white exactly suits greys."
    )


def whites(title: str, pairs: list[tuple[Array, Array]], rng: np.random.Generator, white: str | None = None) -> str:
    """Return the sentences on CCT and Duv of lights, each by the matrix of its training, of cameras with filters."""
    sentences, none = list[str](), np.zeros((3, 3))
    for noise_rel in NOISES_REL:
        cct, duv, held = list[Array](), list[Array](), list[Array]()
        for camera in list(cameras().values())[:-1]:
            for lights, measured in pairs * DRAWS:
                known = trained(lights, "mine", camera, rng, stated=True, noise_rel=noise_rel, white=white)
                again = read(measured, "mine", camera, rng, noise_rel)
                xyz, spread = known.convert(again.signal, np.eye(3) * again.u_signal[:, None, :] ** 2, "mine")
                found, true = coordinates(xyz, spread), coordinates(again.xyz, none)
                held.append(np.abs(found.cct_k - true.cct_k) <= 2.0 * found.u_cct_k)
                cct.append(np.abs(found.cct_k / true.cct_k - 1.0))
                duv.append(np.abs(found.duv - true.duv))
        shares = [100 * np.mean(np.concatenate(one) < limit) for one, limit in ((cct, 0.01), (duv, 0.001))]
        rms = [np.sqrt(np.mean(np.concatenate(one) ** 2)) for one in (cct, duv)]
        sentences.append(
            f"With {100 * noise_rel:g} % noise CCT is within 1 % in {shares[0]:.0f} % (rms {100 * rms[0]:.2f} %), Duv "
            f"within 0.001 in {shares[1]:.0f} % (rms {rms[1]:.4f}); CCT is within k = 2 in "
            f"{100 * np.mean(np.concatenate(held)):.0f} %."
        )
    return f"{title}. {' '.join(sentences)}"


def main() -> None:
    """Train on a chart and on displays, measure the lights outside, and write the section."""
    sds, rng = peer.SDS_COLOURCHECKERS["BabelColor Average"], np.random.default_rng(SEED)
    chart = spectra(sds, list(sds))
    five = spectra(peer.SDS_ILLUMINANTS, ["D65", "A", "LED-B3", "LED-B5", "FL11"])
    lights = outside(chart, rng)
    rows, shares = list[str](), list[float]()
    for training in (Lights("chart under D65", SURFACES, chart * five[0]), *displays(rng)):
        for light in lights:
            if light.name == training.name:
                continue
            cells = []
            for stated in (True, False):
                share, wide = coverage(training, light, rng, stated=stated)
                shares.append(share)
                cells += [f"{100 * share:.0f} %", f"{100 * wide:.2g} %"]
            rows.append(f"| {training.name} | {light.name} | {' | '.join(cells)} |")
            print(rows[-1], flush=True)
    head = (
        f"Three cameras, {DRAWS} draws each, readings with {100 * NOISE_REL:g} % noise, seed {SEED}. One has its "
        "colours in layers: it takes part where responsivities are known.\n\n"
        f"{inside(chart, five, rng)}\n\nLights outside the training set, by a matrix of a chart or of a display: in "
        f"all, {100 * np.mean(shares):.0f} % are within k = 2.\n\n"
        "| training | measured | responsivities known: within k = 2 | median U of Y | unknown: within k = 2 | "
        "median U of Y |\n|---|---|---|---|---|---|\n"
    )
    print(head)
    write_section("colour", "Colour", "python -m benchmarks colour", head + "\n".join(rows))


if __name__ == "__main__":
    main()
