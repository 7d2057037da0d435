"""Takes the camera from a model file instead of the capture header."""

from __future__ import annotations

from typing import Any

from radiometer.data import CaptureHeader
from simulators.camera_model import CameraModel
from simulators.effects.catalogue import CatalogueEffect
from simulators.ideal_chain import ideal_chain

# (effect of the ideal chain, its parameter) → key of the camera's description
_CAMERA_KEYS = {
    ("quantum_efficiency", "quantum_efficiency"): "quantum_efficiency",
    ("dark_current", "rate_e_per_s"): "dark_current_e_per_s",
    ("dark_current", "reference_C"): "dark_current_reference_C",
    ("dark_current", "doubling_K"): "dark_current_doubling_K",
    ("full_well_saturation", "full_well_e"): "full_well_e",
    ("read_noise", "read_noise_e"): "read_noise_e",
    ("conversion_gain", "conversion_gain_e_per_dn"): "conversion_gain_e_per_dn",
}


def adopted(header: CaptureHeader, model: CameraModel | None) -> tuple[CaptureHeader, tuple[CatalogueEffect, ...]]:
    """Return the header with the model's camera and lens, and the effects that the model holds beside the ideal chain.

    Args:
        header: What `capture.yaml` says; it keeps frames, patches and source.
        model: The camera as it is believed to be; None leaves the header as it is.
    """
    if model is None:
        return header, ()
    ideal = [effect.name for effect in ideal_chain(model.camera, model.lens)]
    figures: dict[str, Any] = {}
    further: list[CatalogueEffect] = []
    for effect in model.effects:
        if effect.name in ideal:
            ideal.remove(effect.name)
            figures |= {
                key: getattr(effect, parameter)
                for (name, parameter), key in _CAMERA_KEYS.items()
                if name == effect.name
            }
        elif isinstance(effect, CatalogueEffect):
            further.append(effect)
    camera = model.camera.model_copy(update=figures)
    return header.model_copy(update={"camera": camera, "lens": model.lens}), tuple(further)
