"""What results are made with, and whether the workers of a cluster have the same."""

from __future__ import annotations

import functools
import importlib.metadata
import logging
import platform
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from lfflow.errors import LfflowError

_log = logging.getLogger(__name__)
_PACKAGES = ("numpy", "numba", "scipy", "xarray", "zarr", "dask", "distributed")


class WorkersError(LfflowError):
    """The workers cannot be had as asked."""


@functools.cache
def versions() -> dict[str, str]:
    """Versions of lfflow, of what computes and stores its results, and of Python."""
    from lfflow import __version__

    found = {name: importlib.metadata.version(name) for name in _PACKAGES}
    return {"lfflow": __version__, **found, "python": platform.python_version()}


def check_scheduler(client: Any) -> None:
    """Compare the scheduler with this process, as `check_workers`: it unpacks what it passes on."""
    _compare(f"the scheduler at {client.scheduler.address}", client.run_on_scheduler(version_question()))


def check_workers(client: Any, addresses: Iterable[str]) -> list[str]:
    """Compare workers with this process; returns the addresses of those that answered.

    Another numpy is worth a warning: results may differ in their last bits.

    Raises
    ------
    WorkersError
        If a worker has another lfflow, or none.
    """
    answers = client.run(version_question(), workers=list(addresses), on_error="return")
    answered = {address: answer for address, answer in answers.items() if not isinstance(answer, Exception)}
    for address, theirs in answered.items():
        _compare(f"the worker at {address}", theirs)
    return list(answered)


def _compare(who: str, theirs: Mapping[str, str]) -> None:
    mine = versions()
    if theirs["lfflow"] != mine["lfflow"]:
        raise WorkersError(
            f"{who} runs lfflow {theirs['lfflow']}, this is lfflow {mine['lfflow']}: install the same on both; what is "
            "finished is kept"
        )
    others = [f"{name} {theirs[name]} (here {mine[name]})" for name in mine if theirs[name] != mine[name]]
    if others:
        _log.warning("%s has %s", who, ", ".join(others))


def version_question() -> Callable[[], dict[str, str]]:
    """`versions` as a function that is sent whole, so that a process without this module can run it too."""
    names = tuple(versions())

    def versions_there() -> dict[str, str]:
        import contextlib
        import importlib.metadata
        import platform

        found = dict.fromkeys(names, "none")
        for name in names:
            with contextlib.suppress(importlib.metadata.PackageNotFoundError):
                found[name] = importlib.metadata.version(name)
        found["lfflow"] = "none"
        with contextlib.suppress(ImportError):
            import lfflow

            found["lfflow"] = lfflow.__version__
        return {**found, "python": platform.python_version()}

    return versions_there
