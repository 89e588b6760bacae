"""How a file can be wrong: each error says which file, where in it, what was found and what was expected."""

from __future__ import annotations

from lfflow.errors import FormatError


class FileFormatError(FormatError):
    """A file is not what it claims to be.

    Parameters
    ----------
    path
        The file (``archive::member`` for a member of an archive).
    where
        The section, key or field.
    found, expected
        What is there, and what should be.
    """

    def __init__(self, path: str, where: str, found: object, expected: object) -> None:
        # All four stay in `args`, so that the error survives the way back from a worker process.
        super().__init__(path, where, found, expected)
        self.path, self.where, self.found, self.expected = path, where, found, expected

    def __str__(self) -> str:
        text = f"{self.path}: {self.where}: found {self.found}, expected {self.expected}"
        # Names and values come from the file: what would move the cursor or end the line is spelt out.
        return "".join(char if char.isprintable() else repr(char)[1:-1] for char in text)


class UnreadableError(FileFormatError):
    """The file is not there, or the system refuses to read it."""


class UnknownFormatError(FileFormatError):
    """The file is something else altogether."""


class TruncatedError(FileFormatError):
    """Fewer bytes than the file's own headers declare."""


class StructureError(FileFormatError):
    """Sections, references or members contradict each other."""


class ChecksumError(FileFormatError):
    """The bytes are not those whose SHA-1 the file carries."""


class MetadataError(FileFormatError):
    """JSON that cannot be parsed, or a value that is missing, of the wrong type or impossible."""


class UnsupportedError(FileFormatError):
    """A valid file that says what lfflow does not know how to read."""


class LimitError(FileFormatError):
    """A file that asks for more than any real file needs."""
