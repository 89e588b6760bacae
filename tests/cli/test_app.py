"""The command line as a whole: exit codes, where output goes, and that asking for help costs nothing."""

from __future__ import annotations

import subprocess
import sys

import pytest

from lfflow import cli

HEAVY = ("numba", "scipy", "cv2", "matplotlib", "distributed", "xarray", "zarr")


def lfflow(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "lfflow", *arguments], capture_output=True, text=True, check=False)


def test_help_imports_no_heavy_package() -> None:
    code = (
        "import sys; from lfflow.cli import app; app(['--help'], result_action='return_value');"
        f"print([name for name in {HEAVY} if name in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"
    assert "Find the microlens lattice" in done.stdout


def test_wrong_usage_ends_with_1_and_says_so_on_standard_error() -> None:
    done = lfflow("run", "--no-such-option")
    assert done.returncode == 1
    assert done.stdout == ""
    assert "no-such-option" in done.stderr


def test_a_missing_file_is_named_without_a_traceback() -> None:
    done = lfflow("info", "nowhere/IMG_0001.lfp")
    assert done.returncode == 1
    assert "IMG_0001.lfp" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("command", sorted(cli._COMMANDS))
def test_every_command_explains_itself(command: str) -> None:
    done = lfflow(command, "--help")
    assert done.returncode == 0
    assert command in done.stdout
