# SPDX-License-Identifier: BSD-3-Clause
"""Simulated drives, kept as bags because rendering an image takes several times as long as tracking it."""

from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from ceiling_dso_ros.io.bag_writer import BagWriter
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.recording import Recording
from ceiling_dso_ros.simulation.bag import files_beside, write_files_beside, write_measurements
from ceiling_dso_ros.simulation.camera import CameraModel
from ceiling_dso_ros.simulation.config import SimulationConfig
from ceiling_dso_ros.simulation.recording import SimulatedRecording


@dataclass(frozen=True)
class RenderedDrive:
    """A simulated drive and the bag that holds it.

    Attributes:
        bag: where it is.
        simulated: gives the ground truth; its images would have to be rendered again.
        recording: gives the images from the bag.
    """

    bag: Path
    simulated: SimulatedRecording
    recording: Recording

    @property
    def name(self) -> str:
        """Name of the bag without its extension."""
        return self.bag.stem


@dataclass(frozen=True)
class RenderedDrives:
    """A folder of rendered drives, 0.4 MB per image at 848x480; existing bags are not rendered again."""

    folder: Path

    def drive(self, config: SimulationConfig) -> RenderedDrive:
        """A drive with the default wheels and vibration; of the camera only the image size may differ."""
        simulated = SimulatedRecording(config)
        length = [f"{config.duration_s:g}s"] if config.duration_s else []
        camera = config.camera
        usual = (camera.width, camera.height) == (CameraModel.width, CameraModel.height)
        size = [] if usual else [f"{camera.width}x{camera.height}"]
        session = [f"session{config.session}"] if config.session else []
        name = "_".join([config.sequence, config.ceiling, str(config.seed), *session, *size, *length, *config.events])
        bag = self.folder / f"{name}.bag"
        if not bag.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            _render(simulated, bag)
        return RenderedDrive(bag, simulated, open_recording(bag, robot_file=files_beside(bag)["robot"]))


def _render(simulated: SimulatedRecording, bag: Path) -> None:
    """Write a bag; it gets its final name only when it is complete."""
    unfinished = bag.with_suffix(".part.bag")
    unfinished.unlink(missing_ok=True)
    write_files_beside(bag, simulated)
    measurements = tqdm(simulated.simulation.measurements(), desc=f"rendering {bag.stem}", disable=None)
    with BagWriter(unfinished) as writer:
        write_measurements(writer, simulated, measurements)
    unfinished.replace(bag)
