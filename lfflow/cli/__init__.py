"""The command line: one module a command, imported when it is called."""

from __future__ import annotations

import sys

from cyclopts import App, CycloptsError
from rich.console import Console

from lfflow.errors import CollectionError, LfflowError, SchemaError

_COMMANDS = {
    "simulate": "Make a white image and captures of a simulated camera, with the truth beside them.",
    "run": "Turn captures into a collection of light fields and disparity maps.",
    "plan": "Say what a run would do, and what it would need.",
    "scan": "Read captures into the catalogue of a collection, and nothing more.",
    "status": "Say what is done, what failed, and why.",
    "query": "List the captures of a collection for which an expression holds.",
    "validate": "Check a collection against its ledger, checksums and schema.",
    "migrate": "Bring the stores of a collection to the present schema.",
    "quicklook": "Draw each capture's views, EPI, disparity and error map as a PNG.",
    "report": "Write a page that shows the whole collection.",
    "export": "Write views, disparities and pictures in formats of other programs.",
    "info": "Say what a file is.",
    "calibrate": "Find the microlens lattice of one picture.",
    "disparity": "Estimate the disparity of the central view of a folder of views.",
    "benchmark": "Score the disparity of a folder of views against ground truth.",
}

app = App(
    name="lfflow",
    help="Raw plenoptic captures to labelled 4D light fields and disparity maps.",
    error_console=Console(stderr=True),
    exit_on_error=False,
    result_action="return_value",
)
for _command, _help in _COMMANDS.items():
    app.command(f"lfflow.cli.{_command}:{_command}", name=_command, help=_help)


def main() -> None:
    """Run the command line and leave with its exit code.

    0 done, 1 wrong usage or unreadable input, 2 some captures failed, 3 store or schema error.
    """
    try:
        code = app(sys.argv[1:])
    except CycloptsError:
        sys.exit(1)
    except LfflowError as error:
        sys.stderr.write(f"lfflow: {error}\n")
        sys.exit(3 if isinstance(error, CollectionError | SchemaError) else 1)
    sys.exit(code if isinstance(code, int) else 0)
