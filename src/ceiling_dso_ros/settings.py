# SPDX-License-Identifier: BSD-3-Clause
"""Reads and writes settings: defaults, then a yaml file or ROS parameters, then `key=value`; one way for all."""

import dataclasses
import math
import re
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple, Type, TypeVar, cast

import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from ceiling_dso_ros.dso.config import ConfigError, OdometryConfig, require
from ceiling_dso_ros.io.errors import InputError
from ceiling_dso_ros.io.known_names import require_known
from ceiling_dso_ros.io.replacing import replace_file
from ceiling_dso_ros.io.yaml_files import read_yaml

Config = TypeVar("Config")
LARGEST_INTEGER = 2**63
FUSION_PREFIX = "fusion."  # of the fusion's settings among all
ANGLE = re.compile(r"(deg|rad)\(([^()]*)\)")  # as rosparam writes angles


def load_settings(
    path: Optional[Path],
    overrides: Sequence[str] = (),
    kind: Type[Config] = OdometryConfig,  # type: ignore[assignment]  # a default has to suit every Config
) -> Config:
    """Merge the settings of the command line.

    Args:
        path: a yaml file with the nested names of the dataclass, all optional.
        overrides: `key=value` with dots between the names, as in `window.max_keyframes=5`; the last one counts.
        kind: the dataclass, OdometryConfig or FusionConfig.

    Raises:
        InputError: unreadable file, unknown name, value of another type or out of range.
    """
    layers = [] if path is None else [(str(path), _read_yaml(path))]
    layers += [(f"--set {override}", _read_override(override)) for override in overrides]
    return merge_settings(kind, layers, "settings")


def split_overrides(overrides: Sequence[str]) -> Tuple[List[str], List[str]]:
    """Settings of the odometry, and settings of the fusion without their prefix, among texts `key=value`."""
    of_fusion = [text for text in overrides if text.startswith(FUSION_PREFIX)]
    of_odometry = [text for text in overrides if text not in of_fusion]
    return of_odometry, [text[len(FUSION_PREFIX) :] for text in of_fusion]


def merge_settings(kind: Type[Config], layers: Sequence[Tuple[str, Mapping]], whole: str) -> Config:
    """Merge values into the defaults of a dataclass.

    Integers are accepted for floats, lists for tuples, and for numbers also texts with a number (yaml reads 1e-5 as a
    text) or an angle such as deg(90). An empty text is None where None is the default.

    Args:
        kind: a dataclass, with dataclasses as its groups, that can be made without arguments and has `check()`.
        layers: (source, nested values); later layers override earlier ones.
        whole: name of all layers together, for messages about values out of range.

    Raises:
        InputError: unknown name, value of another type or out of range, in one line.
    """
    settings = OmegaConf.structured(kind)
    _make_writable(settings)
    defaults = default_values(kind)
    for source, values in layers:
        require_known(values, defaults, source)
        try:
            _require_plain(values, defaults, "")
            settings.merge_with(OmegaConf.create(_understood(values, defaults)))
        except (OmegaConfBaseException, ConfigError) as error:
            raise InputError(f"{source}: {_describe(error)}") from error
    try:
        config = _with_tuples(OmegaConf.to_object(settings))
        _require_finite(plain_values(config), "")
        config.check()
    except (OmegaConfBaseException, ConfigError) as error:
        raise InputError(f"{whole}: {_describe(error)}") from error
    return config


def default_values(kind: type) -> Dict[str, Any]:
    """The nested names of a dataclass with their defaults."""
    return dataclasses.asdict(kind())


def plain_values(config: Any) -> Dict[str, Any]:  # noqa: ANN401
    """All values of a dataclass as `merge_settings` takes them, of types that the parameter server knows."""
    return _plain(dataclasses.asdict(config))


def write_settings(path: Path, config: object) -> None:
    """Write all values as yaml that `load_settings` and roslaunch read.

    Raises:
        OutputError: the file cannot be written.
    """
    replace_file(path, yaml.safe_dump(plain_values(config), sort_keys=False).encode(), "the settings")


def _read_yaml(path: Path) -> Mapping:
    values = read_yaml(path)
    if not isinstance(values, (dict, type(None))):
        raise InputError(f"{path}: expected names and values, such as 'window: {{max_keyframes: 5}}'")
    return values or {}


def _read_override(override: str) -> Mapping:
    if override.find("=") < 1:
        raise InputError(f"--set {override}: expected key=value")
    try:
        values = OmegaConf.to_container(OmegaConf.from_dotlist([override]))
    except RecursionError:
        raise InputError(f"--set {override}: too deeply nested") from None
    except (OmegaConfBaseException, yaml.YAMLError, ValueError) as error:  # ValueError: Python reads no endless integer
        raise InputError(f"--set {override}: {_describe(error)}") from error
    return cast(Dict[str, Any], values)  # of a DictConfig


def _require_plain(value: Any, default: Any, name: str) -> None:  # noqa: ANN401
    """Refuse what only OmegaConf understands, references and ???, and numbers that it takes for true or false."""
    if isinstance(value, Mapping):
        for key, member in value.items():
            _require_plain(member, default.get(key), f"{name}.{key}" if name else str(key))
    for text in value if isinstance(value, list) else [value]:
        require(text != "???", f"{name}={text}: ??? is not a value")
        _require_in_range(text, f"{name}={value}")
        in_list = isinstance(value, list) and isinstance(text, (list, Mapping))
        require(not in_list, f"{name}={value}: a list of values, not of further lists")
        require(text is not None or not isinstance(value, list), f"{name}={value}: a value of the list is empty")
        require(not isinstance(text, str) or "${" not in text, f"{name}={text}: ${{ is not allowed in a value")
    if isinstance(default, bool):
        require(isinstance(value, (bool, str)), f"{name}={value}: true or false")


def _understood(value: Any, default: Any) -> Any:  # noqa: ANN401
    """Convert a value that yaml or rosparam cannot express in its type."""
    if isinstance(value, Mapping):
        members = default if isinstance(default, Mapping) else {}
        return {key: _understood(member, members.get(key)) for key, member in value.items()}
    if value == "" and default is None:
        return None
    angle = ANGLE.fullmatch(value) if isinstance(value, str) else None
    if angle is None:
        return value
    try:
        number = float(angle[2])
    except ValueError as error:
        raise ConfigError(f"{value}: expected a number in the parentheses") from error
    return math.radians(number) if angle[1] == "deg" else number


def _plain(value: Any) -> Any:  # noqa: ANN401
    if isinstance(value, dict):
        return {name: _plain(member) for name, member in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(member) for member in value]
    return "" if value is None else value


def _require_finite(values: Any, name: str) -> None:  # noqa: ANN401
    if isinstance(values, dict):
        for member, value in values.items():
            _require_finite(value, f"{name}.{member}" if name else member)
    for value in values if isinstance(values, list) else [values]:
        require(not isinstance(value, float) or math.isfinite(value), f"{name}={values}: not a finite number")
        _require_in_range(value, f"{name}={values}")


def _require_in_range(value: Any, shown: str) -> None:  # noqa: ANN401
    """Refuse an integer that no int64 holds: what computes with it would fail, or see another number."""
    require(not isinstance(value, int) or abs(value) < LARGEST_INTEGER, f"{shown}: too large a number")


def _make_writable(settings: DictConfig) -> None:
    """Frozen dataclasses become read-only nodes, at every depth."""
    OmegaConf.set_readonly(settings, False)
    for name in settings:
        node = settings._get_node(name)
        if isinstance(node, DictConfig):
            _make_writable(node)


def _with_tuples(config: Any) -> Any:  # noqa: ANN401
    """OmegaConf turns the tuples of a dataclass into lists."""
    values = {field.name: getattr(config, field.name) for field in dataclasses.fields(config)}
    for name, value in values.items():
        if dataclasses.is_dataclass(value):
            values[name] = _with_tuples(value)
        elif isinstance(value, list):
            values[name] = tuple(value)
    return type(config)(**values)


def _describe(error: Exception) -> str:
    """The first line of OmegaConf's message, which says what is wrong; the others are internal."""
    key = getattr(error, "full_key", None)
    return (f"{key}: " if key else "") + str(error).splitlines()[0]
