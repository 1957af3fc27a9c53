# SPDX-License-Identifier: BSD-3-Clause
import pytest

from ceiling_dso_ros.drivers.settings import CameraSettings, ExposureSettings, Mode, nearest_mode
from ceiling_dso_ros.io.errors import InputError

OFFERED = [Mode(848, 480, 30), Mode(848, 480, 15), Mode(424, 240, 30), Mode(424, 240, 90), Mode(1280, 800, 25)]


@pytest.mark.parametrize(
    ("wanted", "found"),
    [
        (Mode(848, 480, 30), Mode(848, 480, 30)),
        (Mode(424, 240, 90), Mode(424, 240, 90)),
        (Mode(848, 480, 90), Mode(424, 240, 90)),  # the rate counts first
        (Mode(640, 360, 30), Mode(848, 480, 30)),
        (Mode(480, 270, 30), Mode(424, 240, 30)),
        (Mode(848, 480, 16), Mode(848, 480, 15)),
    ],
)
def test_nearest_mode(wanted, found):
    assert nearest_mode(OFFERED, wanted) == found


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (CameraSettings(mode=Mode(848, 480, 100)), "100 images a second: 6 to 90"),
        (CameraSettings(mode=Mode(20, 20, 30)), "images of 20x20: 100x100 to 1280x800"),
        (CameraSettings(exposure=ExposureSettings(fixed_ms=0.001)), "exposure of 0.001 ms: 0.02 to 165, or 0"),
        (CameraSettings(exposure=ExposureSettings(limit_ms=float("nan"))), "exposure of nan ms: 0.02 to 165, or 0"),
        (CameraSettings(exposure=ExposureSettings(fixed_gain=300)), "gain 300: 16 to 248"),
        (CameraSettings(exposure=ExposureSettings(gain_limit=3)), "limit 3 of the gain: 16 to 248, or 0"),
        (CameraSettings(exposure=ExposureSettings(metering=2.0)), "metering 2: 0.05 to 1, or 0"),
    ],
)
def test_values_out_of_range_are_refused_in_one_line(settings, message):
    with pytest.raises(InputError) as caught:
        settings.check()
    assert str(caught.value) == message


def test_defaults_are_in_range():
    CameraSettings().check()
