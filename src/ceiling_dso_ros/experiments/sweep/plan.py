# SPDX-License-Identifier: BSD-3-Clause
"""The plan of a study: recordings, and the values of every dimension."""

import dataclasses
import itertools
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Sequence, Tuple

import yaml

from ceiling_dso_ros.dso.config import ConfigError, OdometryConfig, require
from ceiling_dso_ros.experiments.sweep.conditions import Conditions
from ceiling_dso_ros.experiments.sweep.run_spec import Opening, RunSpec
from ceiling_dso_ros.fusion.config import FusionConfig
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.known_names import require_known
from ceiling_dso_ros.io.opening import open_recording
from ceiling_dso_ros.io.recording import TopicNames
from ceiling_dso_ros.io.reference_files import reference_of_base, reference_of_camera
from ceiling_dso_ros.io.yaml_files import read_yaml
from ceiling_dso_ros.settings import load_settings, split_overrides

MOST_RUNS = 100_000
OF_CONDITIONS = tuple(each.name for each in dataclasses.fields(Conditions))


@dataclass(frozen=True)
class Plan:
    """A study.

    Attributes:
        inputs: name of a sequence -> the recordings of it.
        grid: dimension -> its values, texts as `run --set` takes them.
        constant: dimension -> the value that all runs have.
        seeds: each combination is run with the seeds 0 to seeds - 1.
        references: recording -> its reference, where that is not beside it.
        baseline: dimension -> the value that the report compares with; the first one where it is not named.
        opening: how all recordings are opened.
    """

    inputs: Mapping[str, Sequence[str]]
    grid: Mapping[str, Sequence[str]] = field(default_factory=dict)
    constant: Mapping[str, str] = field(default_factory=dict)
    seeds: int = 1
    references: Mapping[str, str] = field(default_factory=dict)
    baseline: Mapping[str, str] = field(default_factory=dict)
    opening: Opening = Opening()

    def check(self) -> None:
        """Raise ConfigError if it is not a plan."""
        require(any(self.inputs.values()), "inputs: there is no recording")
        require(self.seeds >= 1, f"seeds {self.seeds}: at least 1")
        for name, values in self.grid.items():
            require(len(values) > 0, f"grid {name}: there are no values")
            require(len({*values}) == len(values), f"grid {name}={','.join(values)}: a value is there twice")
            require(name not in self.constant, f"{name}: is in the grid and set for all runs; one of them")
        for name, value in self.baseline.items():
            require(value in self.grid.get(name, ()), f"baseline {name}={value}: is not in the grid")
        count = self.seeds * sum(map(len, self.inputs.values()))
        for values in self.grid.values():
            count *= len(values)
        require(count <= MOST_RUNS, f"{count} runs: at most {MOST_RUNS}")

    def runs(self) -> Iterator[RunSpec]:
        """All runs: by recording, then by the values of the dimensions as the plan has them, then by seed.

        Raises:
            InputError: a recording cannot be used, or a value is wrong.
        """
        combinations = [self._combination(values) for values in itertools.product(*self.grid.values())]
        for sequence, paths in self.inputs.items():
            for path in paths:
                references = self._references(path)
                for varied, (conditions, odometry, fusion) in combinations:
                    for seed in range(self.seeds):
                        yield RunSpec(
                            sequence, str(Path(path).absolute()), *references, self.opening,
                            varied, conditions, odometry, fusion, seed,
                        )  # fmt: skip

    def as_yaml(self) -> bytes:
        """As `read_plan` reads it, with absolute paths."""
        values: Dict[str, Any] = {
            "inputs": {name: [str(Path(path).absolute()) for path in paths] for name, paths in self.inputs.items()},
            "grid": {name: [*map(str, values)] for name, values in self.grid.items()},
            "set": {**self.constant},
            "seeds": self.seeds,
            "references": {str(Path(key).absolute()): str(Path(v).absolute()) for key, v in self.references.items()},
            "baseline": {**self.baseline},
        }
        return yaml.safe_dump(values, sort_keys=False).encode()

    def _combination(
        self, values: Tuple[str, ...]
    ) -> Tuple[Dict[str, str], Tuple[Conditions, OdometryConfig, FusionConfig]]:
        varied = dict(zip(self.grid, values))
        every = {**self.constant, **varied}
        of_conditions = [f"{name}={value}" for name, value in every.items() if name in OF_CONDITIONS]
        others = [f"{name}={value}" for name, value in every.items() if name not in OF_CONDITIONS]
        of_odometry, of_fusion = split_overrides(others)
        return varied, (
            load_settings(None, of_conditions, Conditions),
            load_settings(None, of_odometry, OdometryConfig),
            load_settings(None, of_fusion, FusionConfig),
        )

    def _references(self, path: str) -> Tuple[Any, Any]:
        """True poses of the camera and of base_link."""
        topics = TopicNames(**self.opening.topics)
        recording = open_recording(path, topics, self.opening.camera, self.opening.robot, self.opening.rectified)
        named = {str(Path(key).absolute()): value for key, value in self.references.items()}
        reference = named.get(str(Path(path).absolute()), recording.ground_truth_path)
        if reference is None:
            return None, None
        found = Path(reference).absolute()
        if not found.is_file():
            raise InputError(f"{found}: there is no such reference")
        return str(reference_of_camera(found)), str(reference_of_base(found))


def read_plan(path: Path) -> Plan:
    """Read a plan; its paths begin in its folder.

    Raises:
        InputError: the file cannot be read, or is no plan.
    """
    values = read_yaml(path)
    example = {"inputs": [], "grid": {}, "set": {}, "seeds": 1, "references": {}, "baseline": {}}
    if not isinstance(values, dict):
        raise InputError(f"{path}: expected the names {', '.join(example)}")
    require_known(dict.fromkeys(values), dict.fromkeys(example), str(path))
    folder = path.parent
    inputs, seeds = values.get("inputs", []), values.get("seeds", 1)
    if isinstance(inputs, dict):
        sequences = {str(name): _list(paths, path, f"inputs.{name}") for name, paths in inputs.items()}
    else:
        sequences = by_sequence(_list(inputs, path, "inputs"))
    if isinstance(seeds, bool) or not isinstance(seeds, int):
        raise InputError(f"{path}: seeds={seeds}: a whole number")
    grid = _mapping(values, "grid", path)
    plan = Plan(
        {name: [str(folder / each) for each in paths] for name, paths in sequences.items()},
        {name: _list(each, path, f"grid.{name}") for name, each in grid.items()},
        {name: _text(value) for name, value in _mapping(values, "set", path).items()},
        seeds,
        {str(folder / key): str(folder / str(v)) for key, v in _mapping(values, "references", path).items()},
        {name: _text(value) for name, value in _mapping(values, "baseline", path).items()},
    )
    check_plan(plan, str(path))
    return plan


def check_plan(plan: Plan, source: str) -> None:
    """Raise InputError if it is not a plan."""
    try:
        plan.check()
    except ConfigError as error:
        raise InputError(f"{source}: {error}") from error


def by_sequence(paths: Sequence[str]) -> Dict[str, List[str]]:
    """Each recording is a sequence of its own, by its name; two of one name are numbered."""
    sequences: Dict[str, List[str]] = {}
    for path in dict.fromkeys(paths):
        name = Path(path).name if Path(path).is_dir() else Path(path).stem
        same = sum(name == each.partition("#")[0] for each in sequences)
        sequences[f"{name}#{same + 1}" if same else name] = [path]
    return sequences


def parse_grid(text: str) -> Tuple[str, List[str]]:
    """Dimension and values of `key=v1,v2`; a comma inside brackets belongs to the value.

    Raises:
        InputError: it is something else.
    """
    name, equals, values = text.partition("=")
    parts: List[str] = [""]
    depth = 0
    for character in values:
        depth += (character in "[({") - (character in "])}")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    if not (name and equals and all(parts)):
        raise InputError(f"--grid {text}: expected key=value,value,... as in fps=3,6,15,30")
    return name, parts


def _mapping(values: Mapping[str, Any], name: str, path: Path) -> Dict[str, Any]:
    found = values.get(name) or {}
    if not isinstance(found, dict):
        raise InputError(f"{path}: {name}: expected names with values")
    return {str(key): value for key, value in found.items()}


def _list(values: Any, path: Path, name: str) -> List[str]:  # noqa: ANN401
    if isinstance(values, (dict, type(None))):
        raise InputError(f"{path}: {name}: expected a list")
    return [_text(value) for value in (values if isinstance(values, list) else [values])]


def _text(value: Any) -> str:  # noqa: ANN401
    """As it is written after `--set key=`."""
    return {True: "true", False: "false"}[value] if isinstance(value, bool) else str(value)
