# SPDX-License-Identifier: BSD-3-Clause
"""Emitter, exposure and metering of a RealSense."""

from typing import List, Tuple

import pyrealsense2 as rs

from ceiling_dso_ros.drivers.settings import ExposureSettings, Mode


def prepare(device: rs.device) -> List[str]:
    """Switch the emitter and the library's own time off; returns complaints."""
    complaints = []
    for sensor in device.query_sensors():
        # The library's own fit of the device's time has jumps, and would take the place of the device's time.
        if sensor.supports(rs.option.global_time_enabled):
            complaints += _set(sensor, rs.option.global_time_enabled, 0.0)
        if sensor.supports(rs.option.emitter_enabled):  # its dots move with the robot
            complaints += _set(sensor, rs.option.emitter_enabled, 0.0)
    return complaints


def expose(sensor: rs.sensor, exposure: ExposureSettings) -> List[str]:
    """Set how the sensor exposes; the limits count from its next start on. Returns complaints."""
    if exposure.fixed_ms > 0.0:
        wanted: List[Tuple[rs.option, float]] = [
            (rs.option.enable_auto_exposure, 0.0),
            (rs.option.exposure, 1e3 * exposure.fixed_ms),
            (rs.option.gain, float(exposure.fixed_gain)),
        ]
    else:
        wanted = [
            *_limit(sensor, "auto_exposure_limit", 1e3 * exposure.limit_ms),
            *_limit(sensor, "auto_gain_limit", float(exposure.gain_limit)),
            (rs.option.enable_auto_exposure, 1.0),
        ]
    return [complaint for option, value in wanted for complaint in _set(sensor, option, value)]


def _limit(sensor: rs.sensor, name: str, value: float) -> List[Tuple[rs.option, float]]:
    """A limit of automatic exposure, 0 for the camera's own; newer cameras have a switch for it."""
    option, switch = getattr(rs.option, name), getattr(rs.option, f"{name}_toggle", None)
    has_switch = switch is not None and sensor.supports(switch)
    if value > 0.0:
        return [(option, value), *([(switch, 1.0)] if has_switch else [])]
    if has_switch:
        return [(switch, 0.0)]
    return [(option, sensor.get_option_range(option).max)] if sensor.supports(option) else []


def meter(sensor: rs.sensor, exposure: ExposureSettings, mode: Mode) -> List[str]:
    """Set the square of the image that automatic exposure looks at, while the sensor streams; returns complaints."""
    if exposure.fixed_ms > 0.0:
        return []
    if not sensor.is_roi_sensor():
        return ["the camera has no region of metering"]
    half_height = mode.height / 2 * (exposure.metering or 1.0)
    half_width = half_height if exposure.metering else mode.width / 2
    region = rs.region_of_interest()
    region.min_x, region.max_x = _span(mode.width, half_width)
    region.min_y, region.max_y = _span(mode.height, half_height)
    try:
        sensor.as_roi_sensor().set_region_of_interest(region)
    except RuntimeError as error:
        return [f"the region of metering cannot be set: {error}"]
    return []


def _span(length: int, half: float) -> Tuple[int, int]:
    """First and last pixel of the middle of a line of pixels."""
    return max(0, round(length / 2 - half)), min(length - 1, round(length / 2 + half))


def _set(sensor: rs.sensor, option: rs.option, value: float) -> List[str]:
    """Set an option, as far as its range allows; returns complaints."""
    if not sensor.supports(option):
        return [f"the camera has no option {option.name}"]
    try:
        limits = sensor.get_option_range(option)
        possible = min(max(value, limits.min), limits.max)
        sensor.set_option(option, possible)
    except RuntimeError as error:
        return [f"{option.name} cannot be set to {value:g}: {error}"]
    return [] if possible == value else [f"{option.name} is {possible:g} instead of {value:g}"]
