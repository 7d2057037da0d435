"""The tree of tests mirrors the packages, so that a subject's tests are found and run by its folder."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
UNIT = ROOT / "tests" / "unit"
# Firmware is no package; reports are of all readers together.
OTHERS = {"firmware", "reports"}
# Folders of files that a test compiles or reads.
WITHOUT_TESTS = {"host", "recorded"}


def folders(root: Path) -> set[str]:
    """Return the folders below one that hold Python files of their own, by their path."""
    return {
        path.parent.relative_to(root).as_posix()
        for path in root.rglob("*.py")
        if not {"__pycache__", *WITHOUT_TESTS} & set(path.parts)
    } - {"."}


def test_every_folder_of_tests_is_one_of_the_source():
    """A folder of tests/unit has the name of a part of radiometer, or of the drivers or simulators."""
    sources = folders(ROOT / "radiometer") | {
        f"{package}{'/' if name else ''}{name}"
        for package in ("drivers", "simulators")
        for name in {*folders(ROOT / package), ""}
    }
    assert folders(UNIT) - OTHERS - sources == set()


def test_every_part_of_the_package_has_its_tests():
    """Each folder right below radiometer, and the drivers and simulators, have a folder of tests."""
    parts = {name for name in folders(ROOT / "radiometer") if "/" not in name} | {"drivers", "simulators"}
    assert parts - folders(UNIT) == set()
