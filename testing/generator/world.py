"""The world as it really is: from the screen's pixels to digital numbers, with hooks where effects are hidden."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from testing.generator.plan import Shot
from testing.generator.rig import Rig
from testing.generator.scene import Chart

Image = np.ndarray
Random = np.random.Generator


@dataclass
class World:
    """A rig, a chart and lists of hooks, called in order at their place in the chain.

    Attributes:
        exposure: Real exposure in s from the labelled: (seconds, shot).
        stop: Real f-number from the labelled: (f-number, shot).
        drive: Real relative output of the source from the labelled level: (level, shot).
        lamp: Factor on the light of one frame, a number or a column of one per row: (shot, real exposure, rng).
        screen: Picture on the screen in codes 0..1: (picture, shot).
        optics: Picture on the sensor: (picture, shot).
        ambient: Light that does not come from the screen, in codes, added on the sensor: (picture, shot).
        electrons: Expected photo-electrons: (expected, rate per second, shot, previous frame's charge).
        dark: Expected dark electrons per pixel: (expected, shot, real exposure).
        charge: Collected charge of a frame, after the dice: (charge, shot, previous charge).
        voltage: The same read out, in electrons: (signal, shot, rng).
        gain: Amplification from electrons to DN: (gain, shot).
        read_noise: Read noise in electrons: (sigma, shot).
        digital: Digital value before rounding: (value, shot).
        code: Integer codes: (codes, shot).
    """

    rig: Rig
    chart: Chart
    exposure: list[Callable[[float, Shot], float]] = field(default_factory=list)
    stop: list[Callable[[float, Shot], float]] = field(default_factory=list)
    drive: list[Callable[[float, Shot], float]] = field(default_factory=list)
    lamp: list[Callable[[Shot, float, Random], float | Image]] = field(default_factory=list)
    screen: list[Callable[[Image, Shot], Image]] = field(default_factory=list)
    optics: list[Callable[[Image, Shot], Image]] = field(default_factory=list)
    ambient: list[Callable[[Image, Shot], Image]] = field(default_factory=list)
    electrons: list[Callable[[Image, Image, Shot, Image], Image]] = field(default_factory=list)
    dark: list[Callable[[Image, Shot, float], Image]] = field(default_factory=list)
    charge: list[Callable[[Image, Shot, Image], Image]] = field(default_factory=list)
    voltage: list[Callable[[Image, Shot, Random], Image]] = field(default_factory=list)
    gain: list[Callable[[float, Shot], float]] = field(default_factory=list)
    read_noise: list[Callable[[float, Shot], float]] = field(default_factory=list)
    digital: list[Callable[[Image, Shot], Image]] = field(default_factory=list)
    code: list[Callable[[Image, Shot], Image]] = field(default_factory=list)

    @property
    def shape(self) -> tuple[int, int]:
        """Return (rows, columns)."""
        return self.rig.rows, self.rig.columns


def develop(world: World, shots: Iterator[Shot], responsivity: float, rng: Random) -> Iterator[Image]:
    """Yield the digital numbers of each shot, one after the other."""
    before = np.zeros(world.shape)
    light, other, of_capture = before, before, -1
    for shot in shots:
        if shot.capture != of_capture:
            light, other, of_capture = *_pictures(world, shot), shot.capture
        charge = _collect(world, shot, light * responsivity, other * responsivity, before, rng)
        before = charge
        yield _read_out(world, shot, charge, rng)


def _pictures(world: World, shot: Shot) -> tuple[Image, Image]:
    """Return the electrons per second from the screen at the capture's real drive, and from elsewhere."""
    dark_room = np.zeros(world.shape)
    if shot.setting.closed:
        return dark_room, dark_room
    number = shot.setting.f_number
    for hook in world.stop:
        number = hook(number, shot)
    scale = world.rig.electrons_per_radiance_second * world.rig.peak_radiance / number**2
    elsewhere = dark_room
    for add in world.ambient:
        elsewhere = add(elsewhere, shot)
    if shot.setting.level == 0:
        return dark_room, elsewhere * scale
    picture = world.chart.image(shot.setting.pattern)
    for on_screen in world.screen:
        picture = on_screen(picture, shot)
    for through_lens in world.optics:
        picture = through_lens(picture, shot)
    level = shot.setting.level
    for turn in world.drive:
        level = turn(level, shot)
    return picture * scale * level, elsewhere * scale


def _collect(world: World, shot: Shot, light: Image, other: Image, before: Image, rng: Random) -> Image:
    """Return the charge of one frame in electrons."""
    seconds = shot.setting.exposure_s
    for clock in world.exposure:
        seconds = clock(seconds, shot)
    factor: float | Image = 1 + shot.jitter
    for flicker in world.lamp:
        factor = factor * flicker(shot, seconds, rng)
    rate = light * factor + other
    expected = rate * seconds
    for hook in world.electrons:
        expected = hook(expected, rate, shot, before)
    rig = world.rig
    warmer = shot.temperature_c - rig.dark_reference_c
    dark = np.full(world.shape, rig.dark_e_per_s * 2 ** (warmer / rig.dark_doubling_k) * seconds)
    for add in world.dark:
        dark = add(dark, shot, seconds)
    charge = rng.poisson(np.maximum(expected + dark, 0)).astype(float)
    for move in world.charge:
        charge = move(charge, shot, before)
    return np.minimum(charge, rig.full_well_e)


def _read_out(world: World, shot: Shot, charge: Image, rng: Random) -> Image:
    """Return the digital numbers of one frame."""
    signal = charge
    for convert in world.voltage:
        signal = convert(signal, shot, rng)
    sigma = world.rig.read_noise_e
    for worsen in world.read_noise:
        sigma = worsen(sigma, shot)
    signal = signal + sigma * rng.standard_normal(world.shape)
    gain = 10 ** (shot.setting.gain_db / 20) / world.rig.e_per_dn
    for amplify in world.gain:
        gain = amplify(gain, shot)
    value = signal * gain + world.rig.black_dn
    for change in world.digital:
        value = change(value, shot)
    codes = np.clip(np.rint(value), 0, world.rig.top_dn)
    for spoil in world.code:
        codes = spoil(codes, shot)
    return codes.astype(np.uint16)
