# SPDX-License-Identifier: BSD-3-Clause
"""What limits the kernels: the work of each, compared with the highest rates of the core, measured in the same process.

A kernel interpolates pixels, so it may be limited by loads of single numbers in random order, by arithmetic, or by
moving bytes in order. The work is counted in the source, for a window in the middle of a drive.

Run as `bounds.py BAG` on the core that is to be measured.
"""

import sys
import time
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Callable, Dict, List, Tuple

import numba
import numpy as np
from tabulate import tabulate

from ceiling_dso_ros.dso import DirectOdometry, OdometryConfig
from ceiling_dso_ros.dso.adjustment.linearization import Linearization
from ceiling_dso_ros.dso.images.pattern import PATTERN_SIZE
from ceiling_dso_ros.dso.images.pyramid import PyramidPool
from ceiling_dso_ros.dso.tracking.tracking_kernels import accumulate
from ceiling_dso_ros.dso.tracking.tracking_reference import TrackingReference
from ceiling_dso_ros.dso.window.keyframe_window import INTRINSICS, KeyframeWindow
from ceiling_dso_ros.dso.window.points import RELATIVE_PARAMETERS
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.preprocessing import ImagePreprocessor
from ceiling_dso_ros.io.recording import Frame

IMAGES = 300  # of the drive, before the window is looked at
REPEATS = 60
SAMPLE_LOADS = 12  # pixels of a cubic sample with its gradient
SAMPLE_FLOPS = 73
RESIDUAL_FLOPS = 73  # of one pixel of a residual: projection, weights and sums
TRACKING_FLOPS = 163  # of one point: projection, derivatives and 45 sums
PAIR_FLOPS = 546  # of one point and target: Jacobian, weighting, 85 dot products along two axes
HALVING_FLOPS = 4  # of one pixel of a coarser level
FLOATS = 848 * 480  # of an image


@dataclass(frozen=True)
class Rates:
    """Highest rates of the core, per nanosecond.

    Attributes:
        loads: single float32 in random order from 256 kB, about the pixels around a host's points in an image.
        flops: fused multiplications and additions of float32, two each.
        bytes: copied in order between arrays of the size of an image, read and written.
    """

    loads: float
    flops: float
    bytes: float


@dataclass(frozen=True)
class KernelCost:
    """One call of a kernel: its work and the time it takes."""

    kernel: str
    milliseconds: float
    loads: float = 0.0
    flops: float = 0.0
    bytes: float = 0.0

    def bounds_ms(self, rates: Rates) -> Dict[str, float]:
        """The least time for each kind of work."""
        return {
            "loads": 1e-6 * self.loads / rates.loads,
            "arithmetic": 1e-6 * self.flops / rates.flops,
            "memory": 1e-6 * self.bytes / rates.bytes,
        }


@numba.njit(fastmath=True)  # type: ignore[misc]  # numba has no types
def _gather(source: np.ndarray, indices: np.ndarray) -> np.float32:
    total = np.float32(0)
    for i in range(indices.size):
        total += source[indices[i]]
    return total


@numba.njit(fastmath={"contract", "reassoc", "nsz"})  # type: ignore[misc]  # numba has no types
def _multiply_add(x: np.ndarray, rounds: int) -> np.float32:
    a = b = c = d = np.float32(0)
    for _ in range(rounds):
        for i in range(x.size):
            a += x[i] * x[i]
            b += x[i] * np.float32(3)
            c += x[i] * np.float32(5)
            d += x[i] * np.float32(7)
    return a + b + c + d


def best_ms(call: Callable[[], object]) -> float:
    """Shortest of several calls, after a first one."""
    call()
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return 1e3 * min(times)


def measure_rates() -> Rates:
    """Measure the rates of the core that this runs on."""
    rng = np.random.default_rng(0)
    source, indices = np.ones(1 << 16, np.float32), rng.integers(0, 1 << 16, 1 << 16).astype(np.uint32)
    x, rounds = np.ones(2048, np.float32), 64
    large, other = np.ones(FLOATS, np.float32), np.ones(FLOATS, np.float32)
    return Rates(
        loads=1e-6 * indices.size / best_ms(lambda: _gather(source, indices)),
        flops=1e-6 * 8 * x.size * rounds / best_ms(lambda: _multiply_add(x, rounds)),
        bytes=1e-6 * 2 * large.nbytes / best_ms(lambda: np.copyto(other, large)),
    )


def measure_kernels(bag: Path) -> List[KernelCost]:
    """Measure the kernels on a window of a drive with default settings."""
    recording = open_recording(bag)
    prepare = ImagePreprocessor(recording.calibration, recording.photometric)
    odometry = DirectOdometry(recording.calibration.camera, OdometryConfig())
    for frame in islice((frame for frame in recording.frames() if isinstance(frame, Frame)), IMAGES):
        image = prepare(frame.image)
        odometry.track(image, frame.stamp_ns, frame.exposure_ms)
    if odometry.map is None:
        raise SystemExit(f"{bag}: no map after {IMAGES} images")
    window = odometry._segment.mapping._mapper.window  # only this benchmark needs access to the mapping
    return [_pyramid(odometry, image), _tracking(odometry.map.reference, window), *_linearization(window)]


def _pyramid(odometry: DirectOdometry, image: np.ndarray) -> KernelCost:
    pool = PyramidPool(odometry.camera, 2)

    def build() -> None:
        pool.release(pool.build(image))

    sizes = [width * height for width, height in pool.shape.sizes]
    read, written = image.size + sum(sizes[:-1]), sum(sizes)
    return KernelCost("pyramid", best_ms(build), flops=HALVING_FLOPS * sum(sizes[1:]), bytes=4 * (read + written))


def _tracking(reference: TrackingReference, window: KeyframeWindow) -> KernelCost:
    points, system = reference.levels[0], np.zeros((9, 9))
    arguments = (points.u, points.v, points.idepth, points.grey, window.image(window.newest), window.width)
    T = np.eye(4)

    def evaluate() -> None:
        accumulate(*arguments, window.height, reference.intrinsics, T, 1.0, 0.0, 0.0, 20.0, system)

    n = points.u.size
    return KernelCost(
        "track, one look at the finest level", best_ms(evaluate), SAMPLE_LOADS * n, (SAMPLE_FLOPS + TRACKING_FLOPS) * n
    )


def _linearization(window: KeyframeWindow) -> Tuple[KernelCost, KernelCost]:
    linearization = Linearization(window.count, window.points.capacity)
    assess_ms = best_ms(lambda: linearization.assess(window, window.points))
    update_ms = best_ms(lambda: linearization.update(window, window.points))
    points, targets = window.points.count, window.count - 1
    pixels = PATTERN_SIZE * int(window.points.residuals.live[: window.count, :points].sum())
    columns = INTRINSICS + RELATIVE_PARAMETERS * targets + 1
    rest = PAIR_FLOPS * points * targets + columns * (columns + 1) * points
    return (
        KernelCost("optimise, residuals", assess_ms, SAMPLE_LOADS * pixels, (SAMPLE_FLOPS + RESIDUAL_FLOPS) * pixels),
        KernelCost("optimise, normal equations", update_ms - assess_ms, flops=rest),
    )


def describe(rates: Rates, costs: List[KernelCost]) -> str:
    """A table in Markdown: each kernel's time, its bounds, which of them is the tightest, and how far it is."""
    rows = []
    for cost in costs:
        bounds = cost.bounds_ms(rates)
        tightest = max(bounds, key=lambda kind: bounds[kind])
        rows.append(
            {
                "kernel": cost.kernel,
                "ms": cost.milliseconds,
                **{f"{kind}, ms": bound for kind, bound in bounds.items()},
                "bound by": tightest,
                "times that": cost.milliseconds / bounds[tightest],
            }
        )
    core = f"{rates.loads:.2f} loads, {rates.flops:.0f} operations and {rates.bytes:.0f} bytes in a nanosecond"
    return tabulate(rows, headers="keys", tablefmt="github", floatfmt=".3f") + f"\n\nThe core does {core}."


if __name__ == "__main__":
    print(describe(measure_rates(), measure_kernels(Path(sys.argv[1]))))
