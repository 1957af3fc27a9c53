"""Simulated drives as bags in a folder: rendering an image takes several times as long as tracking it."""

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
        simulated: for the truth; its images would have to be rendered.
        recording: the bag, in which they are.
    """

    bag: Path
    simulated: SimulatedRecording
    recording: Recording

    @property
    def name(self) -> str:
        """The bag's, without its ending."""
        return self.bag.stem


@dataclass(frozen=True)
class RenderedDrives:
    """A folder of such bags, 0.4 MB an image at 848x480; what is there is not rendered again."""

    folder: Path

    def drive(self, config: SimulationConfig) -> RenderedDrive:
        """One with the usual wheels and vibration; of the camera only the image's size may differ."""
        simulated = SimulatedRecording(config)
        length = [f"{config.duration_s:g}s"] if config.duration_s else []
        camera = config.camera
        usual = (camera.width, camera.height) == (CameraModel.width, CameraModel.height)
        size = [] if usual else [f"{camera.width}x{camera.height}"]
        name = "_".join([config.sequence, config.ceiling, str(config.seed), *size, *length, *config.events])
        bag = self.folder / f"{name}.bag"
        if not bag.exists():
            self.folder.mkdir(parents=True, exist_ok=True)
            _render(simulated, bag)
        return RenderedDrive(bag, simulated, open_recording(bag, robot_file=files_beside(bag)["robot"]))


def _render(simulated: SimulatedRecording, bag: Path) -> None:
    """Write a bag that bears its name only when it is complete."""
    unfinished = bag.with_suffix(".part.bag")
    unfinished.unlink(missing_ok=True)
    write_files_beside(bag, simulated)
    measurements = tqdm(simulated.simulation.measurements(), desc=f"rendering {bag.stem}", disable=None)
    with BagWriter(unfinished) as writer:
        write_measurements(writer, simulated, measurements)
    unfinished.replace(bag)
