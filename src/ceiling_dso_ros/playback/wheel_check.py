# SPDX-License-Identifier: BSD-3-Clause
"""Whether the wheels of a recording belong to its images: on two clocks, nothing of the fusion would be right."""

from typing import Tuple

from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.io.recording import ImageTimes, Recording, WheelSamples, WheelUnit

# Exposure, transfer and driver delay an image less than this, and no camera_time_offset of a real camera is larger.
TWO_CLOCKS_S = 0.5
UNCOVERED_S = 1.0  # drivers that are started together begin and end within such a time
DAY_S = 86400.0


def why_unusable(recording: Recording, wheels: WheelSamples) -> str:
    """Why the wheels cannot be used with the images, in words; empty where they can.

    Raises:
        InputError: the robot's dimensions, or the images, cannot be read.
    """
    robot, images = recording.robot, recording.image_times()
    if robot is None:
        return f"{recording.path}: the robot's dimensions are unknown; give them with --robot"
    if images is None:
        return ""
    clocks = _clock_difference_s(images, wheels, robot.camera_time_offset_s)
    after_s, before_s = _gaps_s(images, wheels)
    remedy = ""
    if wheels.unit is WheelUnit.TICKS and wheels.delay_ns is not None:
        remedy = "; ticks have no stamps, so that the time of their recording counts: use joint_states"
    if after_s > 0.0:
        return f"{_no_overlap(wheels)} the wheels begin {_text(after_s)} after the last image{remedy}"
    if before_s > 0.0:
        return f"{_no_overlap(wheels)} the wheels end {_text(before_s)} before the first image{remedy}"
    if abs(clocks) > TWO_CLOCKS_S:
        order = "after" if clocks > 0.0 else "before"
        return (
            f"{wheels.source}: the wheels and the images are on two clocks: what was recorded at the same time is "
            f"stamped {_text(abs(clocks))} {order} the images{remedy}"
        )
    return ""


def uncovered(recording: Recording, wheels: WheelSamples) -> str:
    """How long there are images without wheels at the begin and the end, in words; empty where that is not long."""
    images = recording.image_times()
    if images is None:
        return ""
    begin_s = seconds(int(wheels.stamps_ns[0]) - images.first_ns)
    end_s = seconds(images.last_ns - int(wheels.stamps_ns[-1]))
    parts = [f"the first {begin_s:.1f} s"] * (begin_s > UNCOVERED_S) + [f"the last {end_s:.1f} s"] * (
        end_s > UNCOVERED_S
    )
    return f"{wheels.source}: no wheels for {' and '.join(parts)} of the images" if parts else ""


def _clock_difference_s(images: ImageTimes, wheels: WheelSamples, camera_offset_s: float) -> float:
    """The clock of the wheels minus that of the images, by when both were recorded; 0 where that is unknown."""
    if images.delay_ns is None or wheels.delay_ns is None:
        return 0.0
    return seconds(images.delay_ns - wheels.delay_ns) - camera_offset_s


def _gaps_s(images: ImageTimes, wheels: WheelSamples) -> Tuple[float, float]:
    """Seconds from the last image to the first sample, and from the last sample to the first image."""
    first_ns, last_ns = int(wheels.stamps_ns[0]), int(wheels.stamps_ns[-1])
    return seconds(first_ns - images.last_ns), seconds(images.first_ns - last_ns)


def _no_overlap(wheels: WheelSamples) -> str:
    return f"{wheels.source}: the wheels and the images do not overlap in time:"


def _text(duration_s: float) -> str:
    return f"{duration_s:.1f} s" + (f" ({duration_s / DAY_S:.1f} days)" if duration_s > DAY_S else "")
