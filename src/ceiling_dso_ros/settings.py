"""Reads and writes settings: defaults, then a yaml file, then `key=value`; for the command line and the nodes."""

import dataclasses
from pathlib import Path
from typing import Any, Optional, Sequence, Type, TypeVar

import yaml
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import ConfigKeyError, OmegaConfBaseException

from ceiling_dso_ros.dso.config import ConfigError, OdometryConfig
from ceiling_dso_ros.io.errors import InputError

Config = TypeVar("Config")


def load_settings(path: Optional[Path], overrides: Sequence[str] = (), kind: Type[Config] = OdometryConfig) -> Config:
    """Merge the settings.

    Args:
        path: a yaml file with the nested names of the dataclass, all optional.
        overrides: `key=value` with dots between the names, as in `window.max_keyframes=5`; the last one counts.
        kind: the dataclass, OdometryConfig or FusionConfig.

    Raises:
        InputError: unreadable file, unknown name, value of another type or out of range.
    """
    settings = OmegaConf.structured(kind)
    _make_writable(settings)
    if path is not None:
        _merge(settings, _read_yaml(path), str(path))
    for override in overrides:
        source = f"--set {override}"
        if override.find("=") < 1:
            raise InputError(f"{source}: expected key=value")
        try:
            values = OmegaConf.from_dotlist([override])
        except (OmegaConfBaseException, yaml.YAMLError) as error:
            raise InputError(f"{source}: {_describe(error)}") from error
        _merge(settings, values, source)
    try:
        config = _with_tuples(OmegaConf.to_object(settings))
        config.check()
    except (OmegaConfBaseException, ConfigError) as error:
        raise InputError(f"settings: {_describe(error)}") from error
    return config


def write_settings(path: Path, config: object) -> None:
    """Write all values as yaml that `load_settings` reads.

    Raises:
        OSError: the file cannot be written.
    """
    path.write_text(OmegaConf.to_yaml(OmegaConf.structured(config)))


def _read_yaml(path: Path) -> DictConfig:
    try:
        values = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot read the settings: {getattr(error, 'strerror', 'not a text')}") from error
    except yaml.YAMLError as error:
        raise InputError(f"{path}: not valid yaml: {' '.join(str(error).split())}") from error
    if not isinstance(values, (dict, type(None))):
        raise InputError(f"{path}: expected names and values, such as 'window: {{max_keyframes: 5}}'")
    try:
        return OmegaConf.create(values or {})
    except OmegaConfBaseException as error:
        raise InputError(f"{path}: {_describe(error)}") from error


def _merge(settings: DictConfig, values: DictConfig, source: str) -> None:
    try:
        settings.merge_with(values)
    except ConfigKeyError as error:
        parent, _, _ = error.full_key.rpartition(".")
        known = ", ".join(OmegaConf.select(settings, parent) if parent else settings)
        raise InputError(f"{source}: unknown setting {error.full_key}; there are {known}") from error
    except OmegaConfBaseException as error:
        raise InputError(f"{source}: {_describe(error)}") from error


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
    """The first line says what is wrong, OmegaConf's further ones are for its developers."""
    key = getattr(error, "full_key", None)
    return (f"{key}: " if key else "") + str(error).splitlines()[0]
