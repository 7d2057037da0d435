"""No command shows a warning of a numerical library: each has a cause, which is found or refused."""

import numpy as np
import pytest

import radiometer as rm
from radiometer.cli.main import run

# Tables at the edge of what can be calculated with: text by the name of the file.
TABLES = {
    "few-levels.csv": "drive,Y [cd/m2]\n0,0.21\n0.125,1.94\n0.25,9.12\n0.5,43.7\n0.75,108.4\n1,204.9\n",
    "dark-screen.csv": "drive,Y [cd/m2]\n0,0\n64,0\n128,0\n255,1e-300\n",
    "huge-light.csv": "channel,drive,light\n"
    + "".join(f"blue,{15 * n},{'1e308' if n == 5 else n}\n" for n in range(1, 18)),
    "dead-light.csv": "channel,drive,light\n" + "".join(f"blue,{15 * n},0\n" for n in range(1, 18)),
    "constant.csv": "time_s,light\n" + "".join(f"{n / 2000:.6f},5\n" for n in range(4000)),
    "zero.csv": "time_s,light\n" + "".join(f"{n / 2000:.6f},0\n" for n in range(4000)),
    "two.csv": "time_s,light\n0,1\n0.001,2\n",
    "line.csv": "wavelength_nm,power\n500,0\n501,1\n502,0\n",
    "empty-light.csv": "wavelength_nm,power\n500,0\n501,0\n502,0\n",
    "alike.csv": "captured,quantity,patch,value,u,unit,status\n"
    + "".join(f"{1.7e9 + 86400.0 * n},radiance,lamp,1,0,W sr-1 m-2,ok\n" for n in range(12)),
    "flat.csv": "time_min,log10_threshold\n" + "".join(f"{n},-2\n" for n in range(12)),
}
COMMANDS = [
    ["analyse", "map.tiff", "--region", "a:0,0,1,1"],
    ["analyse", "map.tiff", "--region", "a:0,0,2,2", "--region", "b:3,3,1,1", "--contrast", "a,b", "--line", "1,1,9,3"],
    *(
        ["screen", "import", name, "-o", "screen.yaml", "--force", "--map", f"level=drive:{unit}"]
        for name in ("few-levels.csv", "dark-screen.csv")
        for unit in ("%", "8bit", "10bit")
    ),
    ["light", "law", "huge-light.csv"],
    ["light", "law", "dead-light.csv"],
    *(
        ["flicker", name, "--dark", "0", "--exposure", time]
        for name in ("constant.csv", "zero.csv", "two.csv")
        for time in ("1us", "9ms")
    ),
    *(["alpha-opic", "100", "--spectrum", name, "--spectrum-u-rel", "5%"] for name in ("line.csv", "empty-light.csv")),
    ["trend", "alike.csv"],
    ["adapt", "fit", "flat.csv", "--bootstrap", "5"],
]  # fmt: skip


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_no_command_warns_in_the_words_of_a_library(words, desk, tmp_path, monkeypatch, capsys):
    """One pixel, four levels, no light, light of 10³⁰⁸: a result, or a line that says what is wrong."""
    for name, text in TABLES.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "map.tiff").write_bytes((desk / "map.tiff").read_bytes())
    monkeypatch.chdir(tmp_path)
    code = run(words)
    printed = capsys.readouterr().err
    assert code in (0, 1)
    assert "Warning" not in printed
    assert "defect" not in printed


def test_a_region_of_one_pixel_has_its_value_and_no_spread(desk, monkeypatch):
    """Its mean is the pixel's; how far pixels of it differ is not known, and so not 0."""
    monkeypatch.chdir(desk)
    found = rm.analyse("map.tiff", regions={"a": (4, 4, 1, 1), "b": (4, 4, 2, 2)}).regions
    assert np.isnan(found[0].deviation.value)
    assert np.isfinite(found[1].deviation.value)
    assert found[0].mean.u > 0.0
