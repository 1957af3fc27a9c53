# SPDX-License-Identifier: BSD-3-Clause
"""Bad images in a recording: how often the map is lost, and what they do to the error.

Every five seconds one image is white, black, noise or torn (its lower half is 0.2 s old, or of the image before). Or
the lamps go to 40 % from one image to the next, for a second. At several image rates, alone and with the motion that
the wheels predict.
"""

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Optional, Tuple

import numpy as np
from support.checkout import DATA
from support.table import Row, report
from tqdm import tqdm

from ceiling_dso_ros.dso import OdometryStatus
from ceiling_dso_ros.dso.durations import seconds
from ceiling_dso_ros.experiments.tracked_run import TrackedRun
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.recording import Frame, Recording
from ceiling_dso_ros.io.trajectory import read_tum
from ceiling_dso_ros.playback.fusion_playback import FusionPlayback
from ceiling_dso_ros.playback.visual_run import VisualRun

PERIOD_S, FIRST_S, LAMPS_S, TORN_AGE_S = 5.0, 5.0, 1.0, 0.2
NOISE = np.random.default_rng(0)
Images = List[Frame]  # the last second, the newest at the end


def white(images: Images) -> np.ndarray:
    """Saturated."""
    return np.full_like(images[-1].image, 255)


def black(images: Images) -> np.ndarray:
    """Dark, with the sensor's noise."""
    return np.abs(NOISE.normal(0.0, 1.5, images[-1].image.shape)).astype(np.uint8)


def noise(images: Images) -> np.ndarray:
    """Nothing but noise."""
    return NOISE.integers(0, 256, images[-1].image.shape).astype(np.uint8)


def torn(images: Images) -> np.ndarray:
    """The lower half of an image that is older."""
    torn_image, half = images[-1].image.copy(), images[-1].image.shape[0] // 2
    earliest = images[-1].stamp_ns - round(1e9 * TORN_AGE_S)
    older = next(frame for frame in reversed(images) if frame.stamp_ns <= earliest or frame is images[0])
    torn_image[half:] = older.image[half:]
    return torn_image


def lamps(images: Images) -> np.ndarray:
    """Less light at the same exposure."""
    return np.rint(0.4 * images[-1].image).astype(np.uint8)


KINDS: Dict[str, Callable[[Images], np.ndarray]] = {k.__name__: k for k in (white, black, noise, torn, lamps)}


@dataclass(frozen=True)
class BadImages:
    """One way to spoil a recording.

    Attributes:
        kind: one of KINDS; None for nothing.
        rate_hz: images a second; 0 for all.
        predict: with the motion by the wheels.
    """

    kind: Optional[str]
    rate_hz: float
    predict: bool

    def frames(self, recording: Recording) -> Iterator[Frame]:
        """The frames as they are tracked."""
        recent: Images = []
        start_ns, count = None, 0
        for frame in recording.frames(self.rate_hz):
            if isinstance(frame, Frame):
                start_ns = frame.stamp_ns if start_ns is None else start_ns
                recent = [*recent[-30:], frame]
                time_s = seconds(frame.stamp_ns - start_ns) - FIRST_S
                begun = time_s >= count * PERIOD_S
                lasting = self.kind == "lamps" and count > 0 and time_s < (count - 1) * PERIOD_S + LAMPS_S
                count += begun
                spoil = None if self.kind is None else KINDS[self.kind]
                yield replace(frame, image=spoil(recent)) if spoil and (begun or lasting) else frame

    def track(self, recording: Recording) -> Tuple[OdometryStatus, ...]:
        """The status of each image."""
        visual = VisualRun.of(recording)
        fusion = FusionPlayback.of(recording) if self.predict else None
        statuses: List[OdometryStatus] = []
        for frame in self.frames(recording):
            prediction = None
            if fusion is not None and visual.last is not None:
                prediction = fusion.predicted_motion(visual.last, frame.stamp_ns)
            statuses.append(visual.track(frame.image, frame.stamp_ns, frame.exposure_ms, prediction).status)
            if fusion is not None:
                fusion.add(statuses[-1])
        return tuple(statuses)


def main() -> int:
    """Print one table; 1 when a map is lost."""
    parser = argparse.ArgumentParser(prog="scripts/bench bad_images", description=__doc__)
    parser.add_argument(
        "--recording", metavar="DIR", type=Path, default=DATA / "ceiling_hard", help="default %(default)s"
    )
    parser.add_argument(
        "--rates", metavar="HZ", type=float, nargs="+", default=[30, 15, 6, 3], help="default %(default)s"
    )
    parser.add_argument("--kinds", choices=KINDS, nargs="+", default=list(KINDS), help="default: all")
    options = parser.parse_args()
    recording, truth = open_recording(options.recording), read_tum(options.recording / "groundtruth.tum")
    rows = []
    for rate_hz, predict in tqdm([(r, p) for r in options.rates for p in (False, True)], disable=None):
        for kind in (None, *options.kinds):
            run = TrackedRun(BadImages(kind, rate_hz, predict).track(recording), truth)
            subject = f"{rate_hz:g} Hz{', wheels' if predict else ''}: {kind or 'nothing'}"
            rows.append(Row(subject, f"maps lost (error {1e3 * run.live_ate_m:.1f} mm)", [run.lost], 0))
    print(report(rows))
    return 0 if all(row.holds for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
