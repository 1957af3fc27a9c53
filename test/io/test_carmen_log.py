# SPDX-License-Identifier: BSD-3-Clause
import gzip

import numpy as np
import pytest

from ceiling_dso_ros.io.carmen_log import is_carmen_log, read_carmen_log
from ceiling_dso_ros.io.errors import InputError


def flaser(stamp, ranges, x=1.0):
    numbers = " ".join(map(str, ranges))
    return f"FLASER {len(ranges)} {numbers} {x} 2.0 0.5 {x + 0.1} 2.1 0.6 {stamp} host {stamp}\n"


def write(path, text):
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())
    return path


def read(path):
    said = []
    return read_carmen_log(path, said.append), said


@pytest.mark.parametrize("name", ["a.log", "a.clf", "a.log.gz", "a.CLF.GZ"])
def test_scans_and_poses_are_read(tmp_path, name):
    assert is_carmen_log(tmp_path / name)
    text = "# comment\nPARAM robot_front_laser_max 20.0\nODOM 0 0 0 0 0 0 1.0 host 1.0\n"
    text += flaser(1.5, [1.0, 30.0, 3.0, 81.91]) + flaser(2.25, [4.0, 5.0, 6.0, 7.0], x=3.0)
    path = write(tmp_path / name.replace("GZ", "gz"), text)
    log, said = read(path)
    assert log.scans.stamps_ns.tolist() == [1_500_000_000, 2_250_000_000]
    np.testing.assert_allclose(log.scans.ranges_m[0], [1.0, np.nan, 3.0, np.nan])
    np.testing.assert_allclose(log.corrected, [[1.0, 2.0, 0.5], [3.0, 2.0, 0.5]])
    np.testing.assert_allclose(log.odometry.readings, [[1.1, 2.1, 0.6], [3.1, 2.1, 0.6]])
    np.testing.assert_allclose(log.scans.geometry[0], [-np.pi / 2, np.pi / 4, 0.0])
    assert said == []


def test_an_odd_number_of_rays_has_one_at_each_end(tmp_path):
    log, _ = read(write(tmp_path / "a.log", flaser(1.0, [1.0, 2.0, 3.0])))
    np.testing.assert_allclose(log.scans.geometry[0, :2], [-np.pi / 2, np.pi / 2])


def test_the_newer_kind_of_line(tmp_path):
    line = "ROBOTLASER1 0 -1.5 3.0 1.5 40.0 0.01 0 3 1.0 2.0 50.0 1 7.0 1.0 2.0 0.3 1.1 2.1 0.4 0 0 0 0 0 12.5 host 1\n"
    log, _ = read(write(tmp_path / "a.log", line))
    assert log.scans.stamps_ns.tolist() == [12_500_000_000]
    np.testing.assert_allclose(log.scans.geometry[0], [-1.5, 1.5, 0.0])
    np.testing.assert_allclose(log.corrected, [[1.0, 2.0, 0.3]])
    np.testing.assert_allclose(log.odometry.readings, [[1.1, 2.1, 0.4]])


@pytest.mark.parametrize(
    "bad",
    ["FLASER\n", "FLASER 3 1 2\n", "FLASER x\n", "FLASER 99999999 1\n", flaser("soon", [1.0, 2.0]),
     flaser(1.0, [1.0, 2.0]).replace("2.1", "nan"), "FLASER -5 1 2 3\n", "ROBOTLASER1 0 1 2\n"],
)  # fmt: skip
def test_lines_that_are_none_are_counted(tmp_path, bad):
    log, said = read(write(tmp_path / "a.log", bad + flaser(5.0, [1.0, 2.0])))
    assert len(log.scans) == 1
    assert len(said) == 1 and "1 of " in said[0]


def test_files_that_are_no_logs(tmp_path):
    with pytest.raises(InputError, match="cannot read the log"):
        read(tmp_path / "missing.log")
    (tmp_path / "a.log.gz").write_bytes(b"no gzip")
    with pytest.raises(InputError, match="cannot read the log"):
        read(tmp_path / "a.log.gz")
    (tmp_path / "b.log.gz").write_bytes(gzip.compress(flaser(1.0, [1.0, 2.0]).encode())[:-12])
    with pytest.raises(InputError, match="cannot read the log"):
        read(tmp_path / "b.log.gz")
    with pytest.raises(InputError, match="there are none"):
        read(write(tmp_path / "c.log", "PARAM a b\n"))
    with pytest.raises(InputError, match="no log of CARMEN"):
        read(write(tmp_path / "d.log", "x" * 600_000))
    assert not is_carmen_log(tmp_path / "a.bag")
