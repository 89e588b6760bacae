"""The page that documents all stores, made from their declarations.

``python -m lfflow.schema.document > data/README.md`` writes it anew.
"""

from __future__ import annotations

import sys

from lfflow.schema.declarations import SCHEMAS

_HEAD = """# The datasets of lfflow

Made by `python -m lfflow.schema.document > data/README.md` from the declarations in `lfflow/schema/declarations.py`;
a test holds the two equal. Axes, signs and units: `lfflow/conventions.py`.

In a collection every variable has a leading `capture` dim, but for the axes of its grid. There is one zarr store a kind
and one group a camera model; a chunk is one view of one capture (for the sensor: one frame). float32 values keep the
mantissa bits that their noise deserves. A variable with * may be absent. Files in this folder are never data: real
captures stay where they are.
"""


def page() -> str:
    """Markdown of data/README.md."""
    sections = (
        f"\n## {schema.name} (schema version {schema.version})\n\n{schema.description}\n\n{schema.table()}\n"
        for schema in SCHEMAS.values()
    )
    return _HEAD + "".join(sections)


if __name__ == "__main__":
    sys.stdout.write(page())
