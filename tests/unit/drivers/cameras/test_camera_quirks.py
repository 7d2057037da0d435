from __future__ import annotations

import pytest

from drivers.cameras.camera_quirks import CameraMatch, load_preset, quirks_for
from radiometer.data.config_files import shipped_config
from radiometer.errors import ConfigurationError


@pytest.mark.parametrize(
    ("vendor", "model", "info", "discarded"),
    [
        ("FLIR", "Blackfly S BFS-U3-19S4M", "", 2),
        ("Point Grey Research", "BFS-PGE-19S4M", "", 2),
        ("FLIR", "BFS-U3-19S4M", "simulated by radiometer", 0),
        ("Aravis", "Fake", "none", 0),
        ("Basler", "acA1920-40gm", "", 2),
    ],
)
def test_a_family_is_known_by_vendor_model_and_info(vendor, model, info, discarded):
    """Each family gets its own file, an unknown one the cautious default."""
    assert quirks_for(vendor, model, info).discard_after_change == discarded


@pytest.mark.parametrize(
    "model", ["BFS-U3-19S4M", "Blackfly S BFS-U3-19S4M", "BFS-PGE-19S4M", "Blackfly S BFS-PGE-19S4M-C"]
)
def test_the_target_and_its_twin_find_their_preset(model):
    """USB3 and GigE model share a sensor and therefore a preset."""
    preset = quirks_for("FLIR", model).preset_of(model)
    assert preset is not None
    assert preset.model == "BFS-U3-19S4M"


def test_a_model_without_a_preset_has_none():
    """A Blackfly S of another sensor does not get the target's figures."""
    assert quirks_for("FLIR", "BFS-U3-51S5M").preset_of("BFS-U3-51S5M") is None


def test_every_figure_of_a_quirk_file_has_a_source():
    """What a quirk file sets beyond the default is explained."""
    for path in shipped_config("cameras/quirks/generic.yaml").parent.glob("*.yaml"):
        text = path.read_text(encoding="utf-8")
        assert "sources:" in text, path
        assert "  discard_after_change:" in text, path


def test_an_unknown_preset_is_refused_with_those_that_there_are():
    """The message lists the presets."""
    with pytest.raises(ConfigurationError, match=r"BFS-U3-19S4M\.yaml"):
        load_preset("BFS-U3-99")


def test_a_pattern_must_fit_the_whole_name():
    """A pattern does not fit a name that merely begins alike."""
    assert not CameraMatch(vendor="FLIR", model="BFS-U3-19S4M").fits("FLIR", "BFS-U3-19S4M-SPECIAL")
