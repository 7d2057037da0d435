from __future__ import annotations

import re

import pytest

from drivers.cameras.feature_access import FeatureAccess, translated
from drivers.cameras.feature_hygiene import FALSIFYING_FEATURES, switch_off_falsifiers
from radiometer.errors import DeviceError, DeviceInUse, DeviceLost

HARMFUL = {bool: True, str: "Continuous", float: 0.8}


@pytest.mark.parametrize("feature", FALSIFYING_FEATURES, ids=lambda feature: feature.name)
def test_what_falsifies_is_switched_off_and_read_back(wooden_camera, feature):
    """Each falsifying feature that is on is switched off, and the finding says what it was."""
    camera, features = wooden_camera({feature.name: HARMFUL[type(feature.harmless)]})
    (finding,) = switch_off_falsifiers(features)
    assert finding.state == "switched_off"
    assert camera.features[feature.name] == feature.harmless
    assert finding.now == feature.harmless


class SelectedPatterns(dict):
    """Two test patterns behind one name, as a selector chooses them."""

    def __init__(self, **patterns: str) -> None:
        super().__init__(TestPatternGeneratorSelector="Sensor")
        self.patterns = patterns

    def __contains__(self, name: object) -> bool:
        return name in ("TestPattern", "TestPatternGeneratorSelector")

    def __getitem__(self, name: str) -> str:
        if name == "TestPattern":
            return self.patterns[super().__getitem__("TestPatternGeneratorSelector")]
        return str(super().__getitem__(name))

    def __setitem__(self, name: str, value: str) -> None:
        if name == "TestPattern":
            self.patterns[super().__getitem__("TestPatternGeneratorSelector")] = value
        else:
            super().__setitem__(name, value)


def test_every_test_pattern_generator_is_switched_off(wooden_camera):
    """A pattern drawn behind the second selector entry is found and ended, as the one behind the first."""
    camera, features = wooden_camera({})
    camera.features = SelectedPatterns(Sensor="Off", PipelineStart="Increment")
    assert [found.state for found in switch_off_falsifiers(features)] == ["off", "switched_off"]
    assert camera.features.patterns == {"Sensor": "Off", "PipelineStart": "Off"}


def test_what_is_off_is_not_written(wooden_camera):
    """A feature that is harmless already is left alone."""
    camera, features = wooden_camera({"GammaEnable": False, "Gamma": 1.0, "ExposureAuto": "Off"})
    assert {finding.state for finding in switch_off_falsifiers(features)} == {"off"}
    assert camera.written == []


def test_a_feature_that_keeps_its_value_is_reported(wooden_camera):
    """What takes the write but stays on is reported with what it does to the measurement."""
    _, features = wooden_camera({"GammaEnable": True}, stuck=("GammaEnable",))
    (finding,) = switch_off_falsifiers(features)
    assert finding.state == "still_on"
    assert "no longer proportional to light" in str(finding)


def test_a_feature_that_refuses_the_write_is_reported(wooden_camera):
    """What refuses to be written is reported with the camera's reason, and the others are still treated."""
    camera, features = wooden_camera({"GainAuto": "Continuous", "LUTEnable": True}, refused=("GainAuto",))
    states = {finding.feature.name: finding.state for finding in switch_off_falsifiers(features)}
    assert states == {"GainAuto": "still_on", "LUTEnable": "switched_off"}
    assert camera.features["LUTEnable"] is False


def test_a_lost_camera_is_not_taken_for_a_stubborn_one(wooden_camera, library_error):
    """A camera that stops answering while it is being cleaned raises DeviceLost."""
    camera, _ = wooden_camera({"GammaEnable": True})

    def vanish(name: str, value: bool) -> None:
        raise library_error("read_register timeout", code=5)

    camera.set_boolean = vanish
    with pytest.raises(DeviceLost):
        switch_off_falsifiers(FeatureAccess(camera, "camera W1", library_error))


@pytest.mark.parametrize(
    ("code", "kind"), [(5, DeviceLost), (4, DeviceLost), (2, DeviceLost), (10, DeviceInUse), (1, DeviceError)]
)
def test_errors_of_the_library_become_the_projects_own(library_error, code, kind):
    """Each code of the library becomes the error that says what to do, with the camera's name."""
    error = translated(library_error("text of the library", code), "camera W1")
    assert type(error) is kind
    assert "camera W1" in str(error)


def test_the_target_has_most_of_the_listed_features(shared_data):
    """The names are not invented: FLIR's description of the target's twin knows the greater part of them."""
    text = (shared_data / "genicam" / "FLIR_BFS_PGE_19S4M.xml").read_text(encoding="utf-8", errors="replace")
    known = [f.name for f in FALSIFYING_FEATURES if re.search(rf'<(Boolean|Enumeration|Float) Name="{f.name}"', text)]
    assert len(known) >= 10
    assert {"ExposureAuto", "GainAuto", "Gamma", "GammaEnable", "SharpeningEnable", "LUTEnable"} <= set(known)
    assert {"DefectCorrectStaticEnable", "BlackLevelClampingEnable"} <= set(known)
