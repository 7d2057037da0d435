"""The distance between codes as frames show it: padded and stretched codes, and numbers of a scene that are none."""

import numpy as np
import pytest

from radiometer.data.code_step import code_step_of


def noisy(bits: int, spread: float, pixels: int = 3000) -> np.ndarray:
    """Return codes of a converter: a ramp over its range with noise."""
    rng = np.random.default_rng(5)
    top = (1 << bits) - 1
    return np.clip(np.rint(np.linspace(0.1, 0.9, pixels) * top + rng.normal(0.0, spread, pixels)), 0, top).astype(int)


@pytest.mark.parametrize(("bits", "step_dn"), [(10, 64), (12, 16), (14, 4), (15, 2), (16, 1)])
@pytest.mark.parametrize("offset_dn", [0, 3])
def test_zeros_below_the_codes_are_a_step(bits, step_dn, offset_dn):
    """Codes times a power of two, also where the camera added an offset afterwards."""
    assert code_step_of([noisy(bits, 2.0) * step_dn + offset_dn]) == step_dn


@pytest.mark.parametrize(("bits", "step_dn"), [(8, 257), (10, 64), (12, 16), (14, 4)])
@pytest.mark.parametrize("form", ["rounded", "cut off", "repeated"])
def test_codes_stretched_to_the_full_range_have_its_step(bits, step_dn, form):
    """4095 becomes 65535 by a factor, rounded or cut off, or with the high bits repeated below."""
    codes = noisy(bits, 2.0)
    exact = codes * 65535 / ((1 << bits) - 1)
    repeated = (codes << (16 - bits)) | (codes >> (2 * bits - 16))
    stretched = {"rounded": np.rint(exact), "cut off": np.floor(exact), "repeated": repeated}[form]
    assert code_step_of([stretched.astype(np.uint16)]) == step_dn


@pytest.mark.parametrize("codes", [[], [500], [500, 516], [500, 532, 612], [500, 502, 504, 505], list(range(90, 110))])
def test_a_few_numbers_of_a_scene_are_no_step(codes):
    """One or two numbers, three far from each other, and neighbours without padding."""
    assert code_step_of([np.array(codes, np.uint16)]) == 1


def test_a_few_pixels_that_are_none_of_the_converter_hide_no_step():
    """A frame's number and time in the first pixels."""
    codes = noisy(12, 2.0, 20_000) * 16
    codes[:14] = np.arange(14) * 37 + 1
    assert code_step_of([codes]) == 16


@pytest.mark.parametrize(("step_dn", "stated", "used"), [(16, 4, 16), (1, 16, 1), (4, 16, 4), (16, 16, 16)])
def test_a_stated_step_counts_unless_the_numbers_contradict_it(step_dn, stated, used):
    """Codes on a wider lattice than stated, or off the stated one."""
    assert code_step_of([noisy(12, 2.0) * step_dn], stated) == used
    assert code_step_of([np.array([500, 500, 516])], stated) == stated  # two numbers contradict nothing


def test_numbers_of_several_frames_count_together():
    """Neither frame has three numbers; both have, 16 DN apart."""
    frames = [np.array(codes, np.uint16) for codes in ([496, 512], [528, 544])]
    assert [code_step_of([one]) for one in frames] == [1, 1]
    assert code_step_of(frames) == 16
