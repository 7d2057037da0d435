"""What a description leaves out: fitted figures stay within what a camera can have, declared ones are as declared."""

from __future__ import annotations

import numpy as np
import pytest

from radiometer.data import CameraDescription, LensDescription
from radiometer.errors import ConfigurationError
from simulators.chain.undeclared import Undeclared, completed, undeclared_chain


def test_fitted_figures_stay_within_what_a_camera_can_have() -> None:
    """A step of a fit by e^30 of the gain or the noise ends at the bound: 1e-4 and 1e4 e⁻/DN, 1e4 e⁻, 1e7 e⁻."""
    camera = CameraDescription(bit_depth=12)
    assert completed(camera, Undeclared(log_gain=30.0)).conversion_gain_e_per_dn == 1e-4
    far = completed(camera, Undeclared(log_gain=-30.0, log_read=60.0))
    assert (far.conversion_gain_e_per_dn, far.read_noise_e, far.full_well_e) == (1e4, 1e4, 1e7)
    near = completed(camera, Undeclared(log_gain=np.log(2.0), log_read=2.0 * np.log(3.0)))
    assert (near.conversion_gain_e_per_dn, near.read_noise_e) == pytest.approx((1.25, 15.0))
    assert near.full_well_e == pytest.approx(4.0 * 4095 * 1.25)


def test_declared_figures_are_refused_out_of_their_bounds() -> None:
    """They are not moved to the bound without a word."""
    camera = CameraDescription(bit_depth=12, conversion_gain_e_per_dn=2e4)
    with pytest.raises(ConfigurationError, match=r"conversion_gain_e_per_dn = 20000 .* is out of range"):
        undeclared_chain(camera, LensDescription(), Undeclared(), np.zeros(1, dtype=np.intp), ends_in_well=True)
