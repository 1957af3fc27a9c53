"""What each part of the odometry contributes: the error with it switched off or changed."""

from typing import Dict, Iterator, Tuple

from support.drives import OdometryRun, is_missing
from support.table import Row
from support.tracked_drives import DATA, TrackedDrives

from ceiling_dso_ros.settings import load_settings
from ceiling_dso_ros.simulation.config import SimulationConfig

FIXED = 1e12  # information beside which the images' is nothing
AFFINE = ("affine_a_information", "affine_b_information")

# As `run --set` takes them.
VARIANTS: Dict[str, Tuple[str, ...]] = {
    "as it is": (),
    "no prior from marginalisation": ("optimization.marginalization_weight=1e-9",),
    "its full weight, 1": ("optimization.marginalization_weight=1",),
    "affine parameters fixed": tuple(
        f"{part}.{name}={FIXED}" for part in ("tracking", "optimization") for name in AFFINE
    ),
    "intrinsics fixed": (f"optimization.intrinsics_information={FIXED}",),
    "intrinsics free": ("optimization.intrinsics_information=0",),
    "500 points, 750 candidates": ("window.active_points=500", "window.candidate_points=750"),
    "2000 points, 3000 candidates": ("window.active_points=2000", "window.candidate_points=3000"),
    "5 keyframes": ("window.max_keyframes=5",),
    "15 keyframes": ("window.max_keyframes=15",),
    "7 keyframes, 2000 points, as published": ("window.max_keyframes=7", "window.active_points=2000"),
    "2 iterations": ("optimization.iterations=2",),
    "keyframes half as far apart": ("keyframe.translation_weight=89.6", "keyframe.motion_weight=44.8"),
    "keyframes twice as far apart": ("keyframe.translation_weight=22.4", "keyframe.motion_weight=11.2"),
    "candidates search all depths": ("tracing.depth_margin=1000",),
    "matches half as distinct, 2": ("activation.min_quality=2",),
    "initialiser: depths free from the start": ("initialization.flat_coupling=1",),
    "initialiser: ends at once after the snap": ("initialization.frames_after_snap=0",),
}
RECORDINGS = ("ceiling_loops", "tum_fr1_xyz")
DRIVES = (("square", "factory"),)


def ablation(tracked: TrackedDrives, seeds: int) -> Iterator[Row]:
    """Two recordings and a simulated drive, with one thing changed at a time."""
    recordings = [name for name in RECORDINGS if not is_missing(DATA / name)]
    for title, settings in VARIANTS.items():
        run = OdometryRun(load_settings(None, settings))
        variant = "".join(f" {setting}" for setting in settings)
        for name in recordings:
            result = tracked.shared(name, run, variant)
            yield Row(title, f"final ATE on {name}, mm; times lost", [1e3 * result.final_ate_m, result.lost])
        for sequence, ceiling in DRIVES:
            results = [tracked.drive(SimulationConfig(sequence, ceiling, seed), run, variant) for seed in range(seeds)]
            values = [value for result in results for value in (1e3 * result.final_ate_m, result.lost)]
            yield Row(title, f"final ATE on {sequence}, {ceiling}, mm; times lost", values)
