"""The configuration of a run: a TOML table per stage, checked before anything starts."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from lfflow.errors import LfflowError
from lfflow.run.chain import Chain, Parameters

WHITES = "whites"
CLUSTER = "cluster"
_OTHERS = {WHITES: ("max_steps",), CLUSTER: ("tls_ca_file", "tls_client_cert", "tls_client_key", "patience")}
"""Tables that belong to no stage: nothing depends on them, so that a change redoes nothing."""


class ConfigError(LfflowError):
    """The configuration names something that does not exist."""


def load_config(path: Path | None, chain: Chain) -> Parameters:
    """Tables of a TOML file; raises ConfigError that names the valid tables and keys for an unknown one."""
    if path is None:
        return {}
    try:
        tables = tomllib.loads(path.read_text())
    except OSError as error:
        raise ConfigError(f"cannot read {path}: {error.strerror}") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path} is no TOML: {error}") from error
    return check_config(tables, chain, str(path))


def check_config(tables: Mapping[str, Any], chain: Chain, where: str = "configuration") -> Parameters:
    """Return the tables, or raise ConfigError."""
    owners = {table: stage for stage in chain.stages for table in stage.tables}
    for name, content in tables.items():
        if name not in owners and name not in _OTHERS:
            raise ConfigError(f"{where}: no table [{name}]; there are {_listed([*owners, *_OTHERS])}")
        if not isinstance(content, Mapping):
            raise ConfigError(f"{where}: {name} is no table; write [{name}] and keys below it")
        valid = _OTHERS[name] if name in _OTHERS else owners[name].keywords(name)
        for key in content:
            if key not in valid:
                raise ConfigError(f"{where}: [{name}] has no key {key!r}; there are {_listed(valid)}")
    return {name: dict(content) for name, content in tables.items()}


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"
