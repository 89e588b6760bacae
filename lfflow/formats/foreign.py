"""What a file is that lfflow does not read: said in words, with the way to a file that it does read."""

from __future__ import annotations

from lfflow.formats.errors import FileFormatError, UnknownFormatError, UnsupportedError

HDF5 = b"\x89HDF\r\n\x1a\n"
_CONVERT = "a file of version 5 to 7.2: load it in MATLAB or Octave and save('new.mat', 'LF', '-v6')"
_UNPACK = "the archive itself: unpack it with {}"
_CONVERTIBLE = (
    (HDF5, "HDF5", _CONVERT),
    (b"MATLAB 7.3", "HDF5 (saved with -v7.3)", _CONVERT),
    (b"\x1f\x8b", "gzip data", _UNPACK.format("gunzip")),
    (b"BZh", "bzip2 data", _UNPACK.format("bunzip2")),
    (b"\xfd7zXZ\0", "xz data", _UNPACK.format("unxz")),
    (b"PK\x03\x04", "a zip archive", _UNPACK.format("unzip")),
)
_NAMES = (
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"GIF8", "a GIF picture"),
    (b"II*\0", "a TIFF picture"),
    (b"MM\0*", "a TIFF picture"),
    (b"%PDF", "a PDF document"),
    (b"\x89PNG\r\n\x1a\n", "a PNG picture"),
    (b"\x89LFP\r\n\x1a\n", "an LFP container"),
    (b"PF", "a float map"),
    (b"Pf", "a float map"),
)


def foreign(path: str, head: bytes, expected: str) -> FileFormatError:
    """Error for a file that begins with `head` where `expected` was wanted."""
    for magic, name, instead in _CONVERTIBLE:
        if head.startswith(magic):
            return UnsupportedError(path, "header", name, instead)
    if not head:
        return UnknownFormatError(path, "header", "an empty file", expected)
    shown = next((name for magic, name in _NAMES if head.startswith(magic)), "")
    found = f"{shown} (bytes {head[:8].hex(' ')})" if shown else f"bytes {head[:8].hex(' ')}"
    return UnknownFormatError(path, "header", found, expected)
