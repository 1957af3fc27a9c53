# SPDX-License-Identifier: BSD-3-Clause
import os
import subprocess
import sys
import threading

import pytest

from ceiling_dso_ros.playback.spool import Spool, SpoolFolder

LIMITS = {"camera.tum": 1000, "frames.bin": 1000}


def left_over(base, name="dso_node", when="20260101-000000", content="1 0 0 0 0 0 0 1\n"):
    """A folder as a run leaves it that was killed."""
    folder = base / f"{name}.{when}.12345.spool"
    folder.mkdir(parents=True)
    (folder / "lock").touch()
    (folder / "camera.tum").write_text(content)
    return folder


def test_a_run_has_a_folder_of_its_own_which_goes_with_it(tmp_path):
    folder = SpoolFolder(tmp_path / "new", "dso_node")
    spool = Spool(folder, LIMITS)
    spool._files["camera.tum"].append(b"a line\n")
    spool.flush()
    assert (folder.path / "camera.tum").read_bytes() == b"a line\n"
    assert folder.path.suffix == ".spool"
    spool.remove()
    assert list((tmp_path / "new").iterdir()) == []


@pytest.mark.parametrize(("limit", "kept"), [(10**6, 3), (40, 2), (30, 1), (0, 1)])
def test_of_runs_that_were_killed_the_newest_are_kept_as_far_as_they_fit(tmp_path, limit, kept):
    folders = [left_over(tmp_path, when=f"2026010{day}-000000") for day in (3, 2, 1)]
    assert sum(path.stat().st_size for path in folders[0].iterdir()) == 16
    empty = left_over(tmp_path, when="20260104-000000", content="")
    for age, folder in enumerate(folders):
        os.utime(folder / "camera.tum", (10 - age, 10 - age))
    other = left_over(tmp_path, name="robot-dso_node")
    run = SpoolFolder(tmp_path, "dso_node", limit)
    assert run.left_over == folders[:kept]
    assert run.given_up == folders[kept:]
    assert set(tmp_path.iterdir()) == {*folders[:kept], other, run.path}
    assert not empty.exists()


def test_a_run_that_goes_on_in_another_process_is_left_alone(tmp_path):
    code = (
        "import sys, pathlib; from ceiling_dso_ros.playback.spool import SpoolFolder;"
        "folder = SpoolFolder(pathlib.Path(sys.argv[1]), 'dso_node');"
        "(folder.path / 'camera.tum').write_text('x'); print(folder.path, flush=True); sys.stdin.read()"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    command = [sys.executable, "-c", code, str(tmp_path)]
    with subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        other_path = other.stdout.readline().strip()
        run = SpoolFolder(tmp_path, "dso_node")
        assert run.left_over == []
        assert {str(path) for path in tmp_path.iterdir()} == {other_path, str(run.path)}
        other.kill()
    run.remove()
    assert [str(path) for path in SpoolFolder(tmp_path, "dso_node").left_over] == [other_path]


def test_a_full_disk_is_a_complaint_that_ends_with_it(tmp_path, monkeypatch):
    spool = Spool(SpoolFolder(tmp_path, "dso_node"), LIMITS)

    def full():
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(spool._files["camera.tum"], "flush", full)
        spool._files["frames.bin"].append(b"kept")
        spool.flush()
    assert spool.complaint == f"{spool.path}: cannot write: No space left on device"
    assert (spool.path / "frames.bin").read_bytes() == b"kept"
    spool.flush()
    assert spool.complaint == ""


def test_results_given_up_are_counted_and_a_complaint_of_one_flush(tmp_path, monkeypatch):
    """The disk does not answer, as while files are at rest."""
    monkeypatch.setattr("ceiling_dso_ros.io.rolling_file.MOST_PENDING", 100)
    spool = Spool(SpoolFolder(tmp_path, "dso_node"), LIMITS)
    for _ in range(30):
        spool._files["frames.bin"].append(bytes(10))
    assert spool.lost == 20
    spool.flush()
    assert spool.complaint == f"{spool.path}: the disk did not answer for too long: results were given up"
    spool.flush()
    assert (spool.complaint, spool.lost) == ("", 20)


def test_results_are_added_while_the_files_are_at_rest(tmp_path):
    spool = Spool(SpoolFolder(tmp_path, "dso_node"), LIMITS)
    spool._files["camera.tum"].append(b"one\n")
    flushing = threading.Thread(target=spool.flush)
    with spool.at_rest():
        spool._files["camera.tum"].append(b"two\n")
        flushing.start()
        assert (spool.path / "camera.tum").read_bytes() == b"one\n"
    flushing.join()
    assert (spool.path / "camera.tum").read_bytes() == b"one\ntwo\n"


def test_newest_results_are_beside_for_a_while(tmp_path):
    spool = Spool(SpoolFolder(tmp_path, "dso_node"), LIMITS)
    with pytest.raises(KeyError), spool.beside({"newest.bin": b"123"}):
        assert (spool.path / "newest.bin").read_bytes() == b"123"
        raise KeyError
    assert not (spool.path / "newest.bin").exists()


def test_a_base_that_cannot_be_written_is_an_error(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="directory"):
        SpoolFolder(tmp_path / "file" / "base", "dso_node")


def test_the_results_of_a_run_stay_when_another_one_begins(tmp_path):
    """As when a bag is played again while the node runs."""
    folder = SpoolFolder(tmp_path, "dso_node")
    spool = Spool(folder, LIMITS)
    (spool.path / "dso.yaml").write_text("settings")
    spool.clear()  # before the first one
    spool.flush()
    assert spool.left is None
    spool._files["camera.tum"].append(b"first\n")
    spool._files["frames.bin"].append(b"images")
    spool.flush()
    assert spool.left is None
    spool.clear()
    spool._files["camera.tum"].append(b"next\n")
    spool.flush()
    left = spool.left
    assert (left / "camera.tum").read_bytes() == b"first\n"
    assert (left / "frames.bin").read_bytes() == b"images"
    assert (spool.path / "camera.tum").read_bytes() == b"next\n"
    assert not (spool.path / "frames.bin").exists()
    assert (left / "dso.yaml").read_text() == (spool.path / "dso.yaml").read_text() == "settings"
    spool.flush()
    assert spool.left is None
    spool.remove()
    assert SpoolFolder(tmp_path, "dso_node").left_over == [left]


def test_what_runs_leave_does_not_fill_the_disk(tmp_path):
    spool = Spool(SpoolFolder(tmp_path, "dso_node", left_over_limit=50), LIMITS)
    for _ in range(10):
        spool._files["camera.tum"].append(b"1 0 0 0 0 0 0 1\n")
        spool.flush()
        spool.clear()
        spool.flush()
    assert len(list(tmp_path.iterdir())) == 1 + 3
    (given_up,) = spool.folder.given_up  # with the last run that was left
    assert not given_up.exists()
