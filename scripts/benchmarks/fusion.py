# SPDX-License-Identifier: BSD-3-Clause
"""The fusion against its limits, on drives under the simulator's factory roof and on the shared recordings.

The wheels' mean radius is exact, their ratio and the wheel base are 1 % wrong, each wheel errs by 2 mm after 1 m. For
the calibration the noise is that of the simulator's defaults, because with noisier wheels one minute does not determine
the wheel base well. Tracking the images takes most of an hour the first time; the results are kept in the folder.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Callable, Dict, Iterator, List

import numpy as np
from scipy.spatial.transform import Rotation
from support import fusion_simulated
from support.checkout import DATA
from support.table import Row, report

from ceiling_dso_ros.dso.durations import nanoseconds, seconds
from ceiling_dso_ros.evaluation.alignment import AlignmentKind
from ceiling_dso_ros.experiments.fused_run import FusedRun
from ceiling_dso_ros.experiments.kept_runs import Kept, Statuses, is_missing
from ceiling_dso_ros.fusion.calibration import Calibration, calibrate
from ceiling_dso_ros.fusion.calibration_data import camera_poses
from ceiling_dso_ros.fusion.config import RobotModel, WheelConfig
from ceiling_dso_ros.fusion.slip import SlipReport
from ceiling_dso_ros.fusion.state import FusionState
from ceiling_dso_ros.fusion.wheel import WheelOdometry
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.playback.fusion_playback import robot_model
from ceiling_dso_ros.playback.wheel_playback import wheel_steps
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.events import Event
from ceiling_dso_ros.simulation.recording import SimulatedRecording
from ceiling_dso_ros.simulation.robot import WheelErrors
from ceiling_dso_ros.simulation.sensors.measurements import START_NS, stamp_ns
from ceiling_dso_ros.simulation.simulation import Simulation

WHEELS = WheelErrors(radius=0.0, ratio=0.01, wheel_base=0.01, travel_noise_m=0.002)
REPORT_MARGIN_S = 0.5  # a report within this time of a slip belongs to that slip
NOTICED_S = 0.2  # a covered lens must be reported within this time
LATE_S = 0.02  # offset of the camera's stamps in the calibration drive
MISMOUNTED_DEG, MISPLACED_M = (1.0, -1.0, 4.0), (0.03, -0.03, 0.05)  # errors of the assumed mounting before calibration
NEEDS_TURNS = ("camera x", "camera y", "wheel base")


def drive(kept: Kept, sequence: str, seed: int, *events: str) -> FusedRun:
    """Run the fusion on a simulated drive."""
    recording, statuses = kept.drive(SimulationConfig(sequence, seed=seed, events=events, wheels=WHEELS))
    return FusedRun(recording, statuses, recording.camera_truth, recording.base_truth)


def drives(kept: Kept, seeds: int) -> Iterator[Row]:
    """Square and loops, undisturbed."""
    reports, driven_s = 0, 0.0
    for name in ("square", "loops"):
        runs = [drive(kept, name, seed) for seed in range(seeds)]
        fused = [run.ate_percent(run.playback.fused()) for run in runs]
        wheel = [run.ate_percent(run.playback.wheel()) for run in runs]
        smoothed = [run.ate_percent(run.playback.smoothed()) for run in runs]
        yield Row(name, "scale error after 5 m, %", [run.scale_error_percent(5.0) for run in runs], 0.5)
        yield Row(name, "scale error at the end, %", [run.scale_error_percent(run.path_m) for run in runs], 0.2)
        yield Row(name, "ATE fused, % of path", fused, 0.3)
        yield Row(name, "ATE wheels / fused", np.divide(wheel, fused), low=5.0)
        yield Row(name, "ATE smoothed, % of path", smoothed, 0.2)
        reports += sum(len(run.playback.estimator.slips) for run in runs)
        driven_s += sum(seconds(run.playback.states[-1].stamp_ns - START_NS) for run in runs)
    yield Row(f"all {driven_s / 60:.0f} min", "false slip reports in 10 min", [reports * 600.0 / driven_s], 1.0)


def _simulation(run: FusedRun) -> Simulation:
    if not isinstance(run.recording, SimulatedRecording):
        raise TypeError(f"{run.recording.path} is not simulated")
    return run.recording.simulation


def slip(kept: Kept, seeds: int) -> Iterator[Row]:
    """Loops with three bursts of slip."""
    runs = [drive(kept, "loops", seed, "slip") for seed in range(seeds)]
    fused = [run.ate_percent(run.playback.fused()) for run in runs]
    wheel = [run.ate_percent(run.playback.wheel()) for run in runs]
    missed, false = [], []
    for run in runs:
        bursts, reports = _simulation(run).events, run.playback.estimator.slips
        missed.append(sum(not any(_is_of(report, burst) for report in reports) for burst in bursts))
        false.append(sum(not any(_is_of(report, burst) for burst in bursts) for report in reports))
    yield Row("loops, slip", "ATE fused, % of path", fused, 0.5)
    yield Row("loops, slip", "ATE wheels / fused", np.divide(wheel, fused), low=10.0)
    yield Row("loops, slip", "slips of 3 not reported", missed, 0)
    yield Row("loops, slip", "reports of no slip", false, 0)


def _is_of(report: SlipReport, burst: Event) -> bool:
    start_ns, end_ns = stamp_ns(burst.start_s - REPORT_MARGIN_S), stamp_ns(burst.end_s + REPORT_MARGIN_S)
    return report.start_ns < end_ns and report.end_ns > start_ns


def cover(kept: Kept, seeds: int) -> Iterator[Row]:
    """Loops with the lens covered for 5 s."""
    pairs = [(drive(kept, "loops", seed), drive(kept, "loops", seed, "cover")) for seed in range(seeds)]
    covered = [run for _, run in pairs]
    (burst,) = _simulation(covered[0]).events
    start_ns, end_ns = stamp_ns(burst.start_s), stamp_ns(burst.end_s)
    gaps = [seconds(np.diff(run.published()[0]).max()) for run in covered]
    told = [_share_told(run, start_ns + nanoseconds(NOTICED_S), end_ns) for run in covered]
    added = [run.end_apart_m(clear) for clear, run in pairs]
    yield Row("loops, cover", "longest time between outputs, s", gaps, 0.021)
    yield Row("loops, cover", "largest jump beyond the motion, mm", [1e3 * run.largest_jump_m() for run in covered], 20)
    yield Row("loops, cover", "outputs that tell of it, %", told, low=100.0)
    drift = [run.wheel_drift_m(start_ns, end_ns) for run in covered]
    yield Row("loops, cover", "error added at the end / wheels' drift of 5 s", np.divide(added, drift), 1.0)


def _share_told(run: FusedRun, start_ns: int, end_ns: int) -> float:
    within = [state for state in run.playback.states if start_ns <= state.stamp_ns <= end_ns]
    told = [s.state is FusionState.DEGRADED and any(r.startswith("camera:") for r in s.reasons) for s in within]
    return 100.0 * float(np.mean(told))


def ceiling_loops(kept: Kept, _: int) -> Iterator[Row]:
    """The shared rendered recording, whose true radii are larger than the nominal ones."""
    folder = DATA / "ceiling_loops"
    if is_missing(folder):
        return
    recording = open_recording(folder)
    camera, base = read_tum(folder / "groundtruth.tum"), read_tum(folder / "groundtruth_base.tum")
    run = FusedRun(recording, kept.statuses(recording, folder.name), camera, base)
    error = run.scale_error_percent(run.path_m, run.wheels_per_true())
    smoothed = run.ate_m(run.playback.smoothed(), AlignmentKind.SIM2)
    yield Row(folder.name, "scale error, % of what the nominal radii imply", [error], 0.3)
    yield Row(folder.name, "ATE smoothed, Sim(2), mm", [1e3 * smoothed], 10.0)


def calibration(kept: Kept, seeds: int) -> Iterator[Row]:
    """Calibrate on loops for the errors, and on straight for the values that it must report as not determined."""
    errors = []
    for seed in range(seeds):
        recording, statuses = kept.drive(SimulationConfig("loops", seed=seed, time_offset_s=LATE_S))
        errors.append(_calibration_errors(recording, _calibrated(recording, statuses)))
    limits = (0.2, 0.2, 0.1, 10.0, 10.0, 2.0, 0.2, 0.2)
    names = ("roll, deg", "pitch, deg", "yaw, deg", "x, mm", "y, mm", "time offset, ms", "wheel ratio, %", "base, %")
    for name, limit, values in zip(names, limits, np.transpose(errors)):
        yield Row("calibrate loops", f"error of {name}", values, limit)
    recording, statuses = kept.drive(SimulationConfig("straight"))
    unexcited = [value.name for value in _calibrated(recording, statuses).values if not value.excited]
    told = [name in unexcited for name in NEEDS_TURNS]
    yield Row("calibrate straight", f"of {', '.join(NEEDS_TURNS)}: said not to be excited", [sum(told)], low=len(told))


def _calibrated(recording: SimulatedRecording, statuses: Statuses) -> Calibration:
    true = robot_model(recording.robot)
    T = true.T_base_camera.copy()
    T[:3, :3] = Rotation.from_euler("XYZ", MISMOUNTED_DEG, degrees=True).as_matrix() @ T[:3, :3]
    T[:3, 3] += MISPLACED_M
    robot: RobotModel = replace(true, T_base_camera=T)
    steps = list(wheel_steps(recording.wheels, WheelOdometry(robot, WheelConfig())))
    return calibrate(steps, camera_poses(statuses), robot)


def _calibration_errors(recording: SimulatedRecording, found: Calibration) -> List[float]:
    """Errors in the units of the limits; inf for values that are reported as not determined."""
    true = recording.simulation.robot.true
    yaw, pitch, roll = Rotation.from_matrix(true.T_base_camera[:3, :3]).as_euler("ZYX", degrees=True)
    ratio, base = true.wheel_radius_m[1] / true.wheel_radius_m[0], true.wheel_base_m
    expected = (roll, pitch, yaw, *true.T_base_camera[:2, 3], -LATE_S, ratio, base)
    units = (1.0, 1.0, 1.0, 1e3, 1e3, 1e3, 100.0 / ratio, 100.0 / base)
    return [
        abs(value.value - truth) * unit if value.excited else np.inf
        for value, truth, unit in zip(found.values, expected, units)
    ]


def main() -> int:
    """Print one table; 1 when a limit does not hold."""
    parts: Dict[str, Callable[[Kept, int], Iterator[Row]]] = {
        part.__name__: part for part in (drives, slip, cover, ceiling_loops, calibration, *fusion_simulated.PARTS)
    }
    parser = argparse.ArgumentParser(prog="scripts/bench fusion", description=__doc__)
    parser.add_argument("--out", metavar="DIR", type=Path, default=Path("out/bench"), help="default %(default)s")
    parser.add_argument("--seeds", metavar="N", type=int, default=5, help="default %(default)s")
    parser.add_argument("--only", nargs="+", choices=parts, default=list(parts), metavar="PART", help=", ".join(parts))
    parser.add_argument("--fresh", action="store_true", help="track what has been tracked before, too")
    options = parser.parse_args()
    kept = Kept(options.out, options.fresh)
    rows = [row for name in options.only for row in parts[name](kept, options.seeds)]
    print(report(rows))
    return 0 if all(row.holds for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
