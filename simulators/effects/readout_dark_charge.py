"""Dark charge that gathers while rows wait to be read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simulators.effects.base import ELECTRONS, Stage, parameter
from simulators.effects.catalogue import Offset
from simulators.effects.context import ExposureContext


@dataclass(frozen=True)
class ReadoutDarkCharge(Offset):
    """Adds thermal electrons that grow down the rows: S' = S + q·2^((T − T_ref)/ΔT₂)·(y + w), y the share of rows read.

    It scales with the dark current but not with the exposure: a frame of no exposure shows it too. Between the last
    clearing and the first row all pixels wait for w of the time that reading takes; 0 where reading begins at once.

    Source: Janesick (2001), Scientific Charge-Coupled Devices, ch. 7: dark charge during readout; a KAF-1001E gathers
    9 DN down its 1024 rows at 10 °C and 3 DN at 0 °C.
    """

    name = "readout_dark_charge"
    stage = Stage.ELECTRONS
    unit_in = unit_out = ELECTRONS
    before = "shot_noise"
    where = "image_y"
    block = "mean"
    also = ("slope",)
    trials = tuple({"charge_e": charge, "from_below": below} for below in (0.0, 1.0) for charge in (3.0, 30.0))
    fitted = ("charge_e", "doubling_K")
    further = ({"wait_share": 0.5},)
    heated = "charge_e"
    settles = "dark frames of the shortest exposure at two temperatures"
    charge_e: float = parameter(0.0, "e-", 0.0, 1e6, source="dark current times the seconds that reading takes")
    reference_C: float = parameter(25.0, "°C", -100.0, 150.0, source="temperature that the charge holds at")  # noqa: N815
    doubling_K: float = parameter(7.0, "K", 2.0, 30.0, source="silicon: 4.5 to 8 K")  # noqa: N815
    from_below: float = parameter(0.0, "1", 0.0, 1.0, source="1 where the last row is read first")
    wait_share: float = parameter(
        0.0, "1", 0.0, 100.0, source="shutter and clearing take up to seconds; 3 to 4 in a KAF-1001E's camera"
    )

    def offset(self, context: ExposureContext) -> Any:
        """Return the thermal electrons that gather in a row until it is read."""
        down = context.geometry.row_fraction()
        waited = 1.0 - down if self.from_below else down
        return self.charge_e * self.warmed(context) * (waited + self.wait_share)

    @property
    def drifts(self) -> bool:
        return True
