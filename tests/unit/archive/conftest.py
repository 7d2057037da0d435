"""Small archives of capture sets."""

import datetime as dt

import numpy as np
import pytest

from radiometer.data import CameraDescription, CaptureSetWriter, Frame, FrameSettings, LensDescription, PatchDescription

CAMERA = CameraDescription(
    bit_depth=12, conversion_gain_e_per_dn=2.6, read_noise_e=2.4, full_well_e=10500, black_level_dn=64
)
START = dt.datetime(2026, 1, 1, tzinfo=dt.UTC)


@pytest.fixture
def make_archive(tmp_path):
    """Return what writes `count` capture sets of two exposures, one a day, with a drift and an outlier."""

    def make(count, *, per_month=0.0, scatter=0.0, outlier=None, seed=1, size=16):
        rng = np.random.default_rng(seed)
        root = tmp_path / "archive"
        patch = PatchDescription(name="white", x=2, y=2, width=size - 4, height=size - 4)
        for day in range(count):
            level = 1.0 + per_month * day / 30.436875 + scatter * rng.standard_normal()
            level *= 1.05 if day == outlier else 1.0
            created = (START + dt.timedelta(days=day)).isoformat()
            about = {"patches": (patch,), "extra": {"created": created}}
            with CaptureSetWriter(root / f"day-{day:04d}", CAMERA, LensDescription(f_number=4.0), **about) as writer:
                for exposure_s in (0.01, 0.02):
                    light_e = rng.poisson(200_000 * level * exposure_s, (size, size))
                    dn = np.rint((light_e + rng.normal(0, 2.4, (size, size))) / 2.6 + 64).astype(np.uint16)
                    writer.add(Frame(dn, 12, FrameSettings(exposure_s, f_number=4.0, black_level_dn=64.0)))
        return root

    return make
