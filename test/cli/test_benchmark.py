# SPDX-License-Identifier: BSD-3-Clause
"""`benchmark` prints tables and writes benchmark.json; what is wrong takes one line."""

import json

import pytest

from ceiling_dso_ros.cli.main import main


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A TUM-mono folder of a few frames."""
    import cv2
    import numpy as np

    path = tmp_path_factory.mktemp("recording")
    (path / "images").mkdir()
    rng = np.random.default_rng(0)
    for k in range(4):
        cv2.imwrite(str(path / "images" / f"{k:05d}.png"), rng.integers(0, 255, (240, 320), np.uint8))
    (path / "times.txt").write_text("".join(f"{k:05d} {k / 20:.3f} 0\n" for k in range(4)))
    (path / "camera.txt").write_text("Pinhole 200 200 160 120 0\n320 240\nnone\n320 240\n")
    return path


@pytest.mark.long
def test_results(folder, tmp_path, capsys):
    assert main(["benchmark", str(folder), "--repeats", "2", "--out", str(tmp_path / "out")]) == 0
    result = json.loads((tmp_path / "out" / "benchmark.json").read_text())
    assert result["frames"] == 4
    assert result["runs"] == 2
    assert result["frame_rate_hz"] == pytest.approx(20.0)
    assert result["frame_ms"]["all"] > 0
    assert main(["benchmark", str(folder), "--repeats", "1", "--vs", str(tmp_path / "out")]) == 0
    assert "reference units" in capsys.readouterr().out


def test_live(folder, tmp_path, capsys):
    assert main(["benchmark", str(folder), "--live", "1", "--out", str(tmp_path / "out")]) == 0
    result = json.loads((tmp_path / "out" / "benchmark.json").read_text())
    assert 1 <= result["images"] <= 4
    assert "speed factor" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--repeats", "0"], "--repeats 0"),
        (["--live", "0"], "--live 0"),
        (["--live", "1e-300"], "--live 1e-300: 0.01 to 100"),
        (["--vs", "nowhere"], "nowhere"),
        (["--set", "window.max_keyframes=2"], "window.max_keyframes"),
        (["--out", "/dev/null/there"], "/dev/null/there"),
    ],
)
def test_wrong_usage(folder, arguments, words, capsys):
    assert main(["benchmark", str(folder), *arguments]) == 2
    assert words in capsys.readouterr().err


def test_live_compares_with_nothing(folder, capsys):
    with pytest.raises(SystemExit) as end:
        main(["benchmark", str(folder), "--live", "1", "--vs", "."])
    assert end.value.code == 2
    assert "--live" in capsys.readouterr().err


def test_live_tells_of_what_it_skips(folder, capfd):
    """A broken image costs itself, no more."""
    (folder / "images" / "00002.png").write_bytes(b"")
    assert main(["benchmark", str(folder), "--live", "1"]) == 0
    assert "00002.png" in "".join(capfd.readouterr())
