# SPDX-License-Identifier: BSD-3-Clause
"""A fast part of `scripts/bench accuracy`: short drives and half the image size, so wider limits."""

import json

import accuracy
import numpy as np
import pytest
from support import first_maps, uncovered
from support.table import Row

from ceiling_dso_ros.experiments.kept_runs import Kept, OdometryRun
from ceiling_dso_ros.experiments.rendered_drives import RenderedDrives
from ceiling_dso_ros.experiments.tracked_drives import TrackedDrives
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.events import COVER_SLIDE_S
from ceiling_dso_ros.simulation.recording import SimulatedRecording
from ceiling_dso_ros.simulation.sensors.measurements import stamp_ns

SMALL = CameraModel(width=424, height=240)


@pytest.fixture(scope="module")
def tracked(tmp_path_factory):
    folder = tmp_path_factory.mktemp("accuracy")
    return TrackedDrives(RenderedDrives(folder / "drives"), Kept(folder / "tracked"), folder)


@pytest.fixture(scope="module")
def drive(tracked):
    def track(sequence, seconds, *events, ceiling="factory", variant="", **run):
        config = SimulationConfig(sequence, ceiling, duration_s=seconds, camera=SMALL, events=events)
        return tracked.drive(config, OdometryRun(**run), variant)

    return track


@pytest.mark.long
def test_drives_are_accurate_and_never_lost(drive):
    square = drive("square", 10.0)
    assert square.lost == 0
    assert square.tracked_percent == 100.0
    assert square.motion_before_first_pose_s() < 1.0
    assert square.final_ate_percent < 0.1
    assert 0.2 < square.mean_nees / 6.0 < accuracy.NEES_FACTOR


@pytest.mark.long
def test_half_and_a_fifth_of_the_images_do(drive):
    square = drive("square", 10.0)
    for hz in (15, 6):
        fewer = drive("square", 10.0, variant=f" {hz} Hz", every=30 // hz)
        assert len(fewer.statuses) == pytest.approx(len(square.statuses) * hz / 30, abs=1)
        assert fewer.lost == 0
        assert fewer.final_ate_m < 3.0 * square.final_ate_m


@pytest.mark.long
def test_standing_still_costs_nothing(drive):
    run = drive("stop_and_go", 10.0)
    assert run.lost == 0
    assert run.final_ate_m < 0.005


@pytest.mark.long
def test_a_start_in_a_turn_gives_no_wrong_map(drive):
    run = drive("spin", 8.0)
    assert run.lost == 0
    assert run.tracked_percent == 100.0
    assert run.final_ate_m < 0.005


@pytest.mark.long
def test_no_wrong_pose_where_there_is_nothing_to_see(drive):
    run = drive("square", 10.0, ceiling="plaster")
    assert run.longest_wrong_s() < accuracy.WRONG_S
    assert all(not loss.endswith(": ") for loss in run.losses())


@pytest.mark.long
def test_lamps_that_flicker_and_go_out(drive):
    run = drive("square", 10.0, "flicker@4+2", "lights_off@7")
    assert run.motion_without_pose_s() < accuracy.RECOVERY_S
    assert run.final_ate_percent < 0.5


@pytest.mark.long
def test_a_covered_lens_is_told_and_got_over(drive):
    cover_ns = stamp_ns(4.0), stamp_ns(7.0)
    run = drive("square", 11.0, "cover@4+3")
    assert run.lost >= 1
    assert all(not loss.endswith(": ") for loss in run.losses())
    assert run.tracking_within(stamp_ns(4.0 + COVER_SLIDE_S), cover_ns[1]) == 0
    assert run.tracking_within(stamp_ns(2.0), cover_ns[0]) > 50
    assert run.motion_without_pose_s(*cover_ns) < accuracy.RECOVERY_S
    assert run.final_ate_percent < 0.5  # the second map is as good as the first


@pytest.mark.long
def test_starts_while_a_cover_slides_off(tracked):
    drive = tracked.rendered.drive(SimulationConfig("square", duration_s=10.0, camera=SMALL))
    runs = list(uncovered.starts_under_cover(drive))
    assert len(runs) == 3
    assert all(run.first_pose > uncovered.SLIDING for run in runs)
    assert [run.lost for run in runs] == [0, 0, 0]
    assert max(run.final_ate_percent for run in runs) < 1.0


def test_a_cover_slides_off_to_the_right():
    image = np.full((4, 100), 100.0)
    assert (uncovered.covered(image, 0.0) == uncovered.COVER_GREY).all()
    assert (uncovered.covered(image, uncovered.SLIDING) == 100.0).all()
    half = uncovered.covered(image, uncovered.SLIDING / 2)
    assert (half[:, :45] == 100.0).all()
    assert (half[:, 55:] == uncovered.COVER_GREY).all()


@pytest.mark.long
def test_what_was_rendered_and_tracked_is_kept(tracked):
    config = SimulationConfig("spin", duration_s=0.6, camera=SMALL)
    first = tracked.drive(config)
    bag = tracked.rendered.folder / "spin_factory_0_424x240_0.6s.bag"
    written_ns = bag.stat().st_mtime_ns
    again = tracked.drive(config)
    assert bag.stat().st_mtime_ns == written_ns
    assert [s.stamp_ns for s in again.statuses] == [s.stamp_ns for s in first.statuses]
    assert first.first_pose == len(first.statuses)  # it stands for a second


def test_a_part_leaves_its_figures(tmp_path, monkeypatch, capsys):
    def part(_, seeds):
        yield Row("square", "times lost", np.arange(seeds), 1)
        yield Row("square", "images", [7])

    monkeypatch.setattr(accuracy, "PARTS", {"part": part})
    monkeypatch.setattr("sys.argv", ["accuracy", "--out", str(tmp_path / "out"), "--seeds", "3"])
    assert accuracy.main() == 1
    assert "NO" in capsys.readouterr().out
    lost, images = json.loads((tmp_path / "out" / "part.json").read_text())
    assert (lost["values"], lost["high"], lost["low"], lost["holds"]) == ([0.0, 1.0, 2.0], 1, None, False)
    assert (images["high"], images["holds"]) == (None, True)


def test_a_cover_slides_off_the_first_images_of_a_recording_only():
    recording = SimulatedRecording(SimulationConfig("square", duration_s=0.6, camera=SMALL))
    uncovered_at = first_maps.Uncovered(recording, 0.5)
    pairs = list(zip(recording.images(), uncovered_at.images()))
    shares = [np.mean(seen.decode() == plain.decode()) for plain, seen in pairs]
    assert shares[0] < 0.3
    assert shares == sorted(shares)
    assert shares[uncovered.SLIDING + 1 :] == [1.0] * (len(pairs) - uncovered.SLIDING - 1)


def test_starts_are_of_the_kind_that_they_are_said_to_be(tracked):
    drive = tracked.rendered.drive(SimulationConfig("stop_and_go", duration_s=12.0, camera=SMALL))
    motion = drive.simulated.simulation.robot.motion
    standing = first_maps._times_s(drive, first_maps.KINDS["standing"])
    straight = first_maps._times_s(drive, first_maps.KINDS["straight"])
    assert len(standing) == len(straight) == first_maps.STARTS
    first_image_s = drive.simulated.simulation.frame_times_s[0]
    assert np.abs(motion.rates(np.array(standing) + first_image_s)).max() < 0.02
    assert motion.rates(np.array(straight) + first_image_s)[:, 0].min() > 0.25
