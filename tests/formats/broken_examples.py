"""One broken file of every kind, each with the parts its message must have: section, found, expected."""

# ruff: noqa: E501 - a broken file a line
from __future__ import annotations

import hashlib
import io
import struct
import tarfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from format_examples import PRIVATE, metadata_of
from format_mutations import HEAD, Container
from scipy.io import savemat

from lfflow.formats.archives import write_storage
from lfflow.formats.bounded_json import MAX_JSON_BYTES, write_json
from lfflow.formats.container import chunk_id, write_container
from lfflow.formats.lfp import write_lfp
from lfflow.formats.png import write_png
from lfflow.formats.raw_pair import write_pair

HEIGHT, WIDTH = 4, 6
SIZE = HEIGHT * WIDTH * 3 // 2
Metadata = dict[str, Any]


def picture(path: Path) -> bytes:
    raw = np.arange(HEIGHT * WIDTH, dtype=np.uint16).reshape(HEIGHT, WIDTH)
    write_lfp(path, raw, metadata_of("f01", HEIGHT, WIDTH), PRIVATE)
    return path.read_bytes()


def cut(at: int) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / "a.lfp"
        path.write_bytes(picture(path)[:at])
        return path

    return make


def patched(change: Callable[[bytearray], None]) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        path = folder / "a.lfp"
        data = bytearray(picture(path))
        change(data)
        path.write_bytes(data)
        return path

    return make


def described(change: Callable[[Metadata], None], image: bytes = bytes(SIZE)) -> Callable[[Path], Path]:
    """A picture whose metadata are changed, under right hashes."""

    def make(folder: Path) -> Path:
        metadata = metadata_of("f01", HEIGHT, WIDTH)
        change(metadata)
        chunks = [write_json(metadata), image]
        frame = {"metadataRef": chunk_id(chunks[0]), "imageRef": chunk_id(image)}
        write_container(folder / "a.lfp", {"frames": [{"frame": frame}]}, chunks)
        return folder / "a.lfp"

    return make


def listed(frame: Metadata, chunks: list[bytes] | None = None) -> Callable[[Path], Path]:
    """A container with a frame as told and the chunks as told."""

    def make(folder: Path) -> Path:
        write_container(folder / "a.lfp", {"frames": [{"frame": frame}]}, chunks or [])
        return folder / "a.lfp"

    return make


def contents(text: bytes, times: int = 1) -> Callable[[Path], Path]:
    """A container whose table of contents is a text as told, `times` times."""

    def make(folder: Path) -> Path:
        out = HEAD.pack(b"\x89LFP\r\n\x1a\n", 1, 0)
        sha1 = f"sha1-{hashlib.sha1(text, usedforsecurity=False).hexdigest()}".encode().ljust(80, b"\0")
        section = HEAD.pack(b"\x89LFM\r\n\x1a\n", 0, len(text)) + sha1 + text + bytes(-len(text) % 16)
        (folder / "a.lfp").write_bytes(out + section * times)
        return folder / "a.lfp"

    return make


def file(name: str, data: bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(data)
        return folder / name

    return make


def twice_the_same_id(folder: Path) -> Path:
    frame = {"metadata": metadata_of("f01", HEIGHT, WIDTH), "imageRef": chunk_id(b"x" * 16)}
    write_container(folder / "a.lfp", {"frames": [{"frame": frame}]}, [b"x" * 16, b"y" * 32])
    data = (folder / "a.lfp").read_bytes()
    (folder / "a.lfp").write_bytes(data.replace(chunk_id(b"y" * 32).encode(), chunk_id(b"x" * 16).encode()))
    return folder / "a.lfp"


def stack(change: Callable[[Metadata], None], jpeg: bytes = b"no jpeg") -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        item: Metadata = {
            "vendorContent": {
                "depthLut": {"width": 2, "height": 2, "imageRef": "@lut"},
                "imageArray": [{"width": 7, "height": 5, "lambda": n, "imageRef": "@jpeg"} for n in range(2)],
            }
        }
        change(item["vendorContent"])
        made = Container({"picture": {"accelerationArray": [item]}}, {"lut": bytes(16), "jpeg": jpeg})
        from random import Random

        (folder / "a-stk.lfp").write_bytes(made.to_bytes(Random(0), wild=False))  # noqa: S311
        return folder / "a-stk.lfp"

    return make


def pair(text: Callable[[Path], None], size: int = SIZE) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        raw = np.zeros((HEIGHT, WIDTH), np.uint16)
        write_pair(folder / "MOD_0001.RAW", raw, metadata_of("f01", HEIGHT, WIDTH), PRIVATE)
        (folder / "MOD_0001.RAW").write_bytes(bytes(size))
        text(folder / "MOD_0001.TXT")
        return folder / "MOD_0001.RAW"

    return make


def tar(cut_at: int | None = None, **changes: Any) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        buffer = io.BytesIO()
        with tarfile.open(fileobj=buffer, mode="w", format=tarfile.GNU_FORMAT) as archive:
            info = tarfile.TarInfo("MOD_0001.RAW")
            info.size = 2000
            for key, value in changes.items():
                setattr(info, key, value)
            archive.addfile(info, io.BytesIO(bytes(2000)))
        (folder / "caldata.tar").write_bytes(buffer.getvalue()[:cut_at])
        return folder / "caldata.tar"

    return make


def storage(listed_files: Any) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        write_container(folder / "data.C.0", {"files": listed_files}, [b"text"])
        return folder / "data.C.0"

    return make


def storage_cut(folder: Path) -> Path:
    write_storage(folder / "data.C.0", {"C:\\A.TXT": bytes(500)})
    (folder / "data.C.0").write_bytes((folder / "data.C.0").read_bytes()[:-100])
    return folder / "data.C.0"


def views(number: int, data: bytes | None = None, parameters: str = "") -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        scene = folder / "scene"
        scene.mkdir()
        for view in range(9):
            write_png(scene / f"input_Cam{view:03d}.png", np.full((4, 5, 3), view, np.uint8))
        target = scene / f"input_Cam{number:03d}.png"
        if data is not None:
            target.write_bytes(data)
        if parameters:
            (scene / "parameters.cfg").write_text(parameters)
        return scene

    return make


def png(width: int, height: int, rows: bytes, *, bits: int = 8, color: int = 2, interlace: int = 0) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, bits, color, 0, 0, interlace)
    parts = (chunk(b"IHDR", head), chunk(b"IDAT", zlib.compress(rows)), chunk(b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def flipped(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


def mat(name: str, values: Any, at: int | None = None, *, packed: bool = False) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        savemat(folder / "LF.mat", {name: values}, do_compression=packed)
        data = (folder / "LF.mat").read_bytes()
        if at is not None:
            data = flipped(data, at) if packed else data[:at]
        (folder / "LF.mat").write_bytes(data)
        return folder / "LF.mat"

    return make


def at_key(*keys: str, value: Any = None) -> Callable[[Metadata], None]:
    """Change of metadata: the value at a path of keys, or without it the key is taken out."""

    def change(metadata: Metadata) -> None:
        for key in keys[:-1]:
            metadata = metadata[key]
        if value is None:
            del metadata[keys[-1]]
        else:
            metadata[keys[-1]] = value

    return change


ROWS = b"".join(b"\0" + bytes(15) for _ in range(4))
LF = np.zeros((3, 3, 4, 5, 3), np.uint16)
DEEP: Any = 1
for _ in range(90):
    DEEP = [DEEP]

# name: (what makes the file, name of the error, parts of its message)
BROKEN: dict[str, tuple[Callable[[Path], Path], str, tuple[str, ...]]] = {
    "empty": (file("a.lfp", b""), "UnknownFormatError", ("header", "found an empty file", "expected")),
    "something else": (file("a.lfp", b"hello, world"), "UnknownFormatError", ("header", "bytes 68 65 6c", "expected a format")),
    "a JPEG": (file("a.lfp", b"\xff\xd8\xff\xe0 and so on"), "UnknownFormatError", ("a JPEG picture",)),
    "a zip": (file("a.lfp", b"PK\x03\x04rest"), "UnsupportedError", ("found a zip archive", "unzip")),
    "a compressed tar": (file("caldata.tar.gz", b"\x1f\x8b\x08\0rest"), "UnsupportedError", ("gzip data", "gunzip")),
    "HDF5": (file("a.mat", b"MATLAB 7.3 MAT-file".ljust(128) + b"\x89HDF"), "UnsupportedError", ("HDF5 (saved with -v7.3)", "'-v6'")),
    "cut in the header": (cut(12), "TruncatedError", ("header: found 12 bytes, expected 16 bytes",)),
    "nothing but the header": (cut(16), "StructureError", ("sections: found 0 tables of contents (LFM), expected one",)),
    "cut in a section's head": (cut(60), "TruncatedError", ("section at byte 16", "bytes of its head, expected 96 bytes")),
    "cut in the contents": (cut(300), "TruncatedError", ("section at byte 16", "found 188 bytes of data before the file ends")),
    "cut in the image": (cut(-20), "TruncatedError", ("section at byte", "of data before the file ends, expected 36 bytes")),
    "another version": (patched(lambda d: d.__setitem__(11, 2)), "UnsupportedError", ("header: found version 2, length 0",)),
    "a section of another kind": (patched(lambda d: d.__setitem__(19, 88)), "StructureError", ("section at byte 16", "expected a section (LFM or LFC)")),
    "an id that is none": (patched(lambda d: d.__setitem__(40, 0)), "StructureError", ("section at byte 16: found id", "sha1- and 40 digits")),
    "a length beyond the file": (patched(lambda d: d.__setitem__(slice(28, 32), b"\x7f\xff\xff\xff")), "TruncatedError", ("expected 2147483647 bytes",)),
    "a flipped bit in the contents": (patched(lambda d: d.__setitem__(120, d[120] ^ 1)), "ChecksumError", ("section at byte 16: found SHA-1", "expected SHA-1")),
    "a flipped bit in the metadata": (patched(lambda d: d.__setitem__(d.index(b'"iso"') + 8, 51)), "ChecksumError", ("section at byte", "found SHA-1")),
    "garbage behind the sections": (patched(lambda d: d.extend(b"garbage!" * 4)), "StructureError", ("found bytes 67 61 72 62", "expected a section")),
    "contents that are no JSON": (contents(b"{oops"), "MetadataError", ("table of contents: found", "a JSON object")),
    "contents that are a list": (contents(b"[1, 2]"), "MetadataError", ("table of contents: found a JSON list",)),
    "contents twice": (contents(b"{}", 2), "StructureError", ("sections: found 2 tables of contents",)),
    "contents without a frame": (contents(b"{}"), "StructureError", ("table of contents: found no frame", "frameArray or frames")),
    "deep JSON": (contents(b'{"a":' * 3000 + b"1" + b"}" * 3000), "LimitError", ("table of contents: found JSON nested too deep",)),
    "deep metadata": (described(at_key("a", value=DEEP)), "LimitError", ("JSON nested too deep", "at most 64 levels")),
    "huge JSON": (contents(b'{"a": "' + b"x" * MAX_JSON_BYTES + b'"}'), "LimitError", ("bytes of JSON", f"at most {MAX_JSON_BYTES}")),
    "no metadata": (listed({"imageRef": chunk_id(b"x")}, [b"x"]), "StructureError", ("frames[0].frame: found neither metadata nor metadataRef",)),
    "a missing reference": (listed({"metadata": metadata_of("f01", HEIGHT, WIDTH)}), "StructureError", ("frames[0].frame.imageRef: found no section with id None",)),
    "a reference to nothing": (listed({"metadataRef": "sha1-" + "0" * 40}), "StructureError", ("frames[0].frame.metadataRef: found no section with id sha1-0000",)),
    "sections of one id": (twice_the_same_id, "StructureError", ("id sha1-", "sections of different lengths")),
    "an image of the wrong size": (described(lambda _: None, bytes(SIZE + 1)), "StructureError", ("raw image", f"found {SIZE + 1} bytes, expected {SIZE} bytes by the metadata")),
    "no width": (described(at_key("image", "width")), "MetadataError", ("image.width: found nothing, expected a number of pixels",)),
    "a width of text": (described(at_key("image", "width", value="6")), "MetadataError", ("image.width: found '6'",)),
    "a negative height": (described(at_key("image", "height", value=-4)), "MetadataError", ("image.height: found -4",)),
    "a huge picture": (described(at_key("image", "width", value=10**8)), "LimitError", ("image size: found 100000000 × 4 pixels",)),
    "a wrong bit depth": (described(at_key("image", "rawDetails", "pixelPacking", "bitsPerPixel", value=11)), "UnsupportedError", ("pixelPacking: found 11 bits 'big'", "12 big")),
    "a wrong byte order": (described(at_key("image", "rawDetails", "pixelPacking", "endianness", value="middle")), "UnsupportedError", ("pixelPacking: found 12 bits 'middle'",)),
    "no packing": (described(at_key("image", "rawDetails", "pixelPacking")), "MetadataError", ("pixelPacking: found nothing", "bitsPerPixel and endianness")),
    "another mosaic": (described(at_key("image", "rawDetails", "mosaic", "upperLeftPixel", value="w")), "UnsupportedError", ("mosaic: found", "r,gr:gb,b")),
    "black above white": (described(at_key("image", "rawDetails", "pixelFormat", "white", "r", value=100)), "MetadataError", ("pixelFormat: found", "0 ≤ black < white")),
    "a shift beyond the bits": (described(at_key("image", "rawDetails", "pixelFormat", "rightShift", value=12)), "MetadataError", ("rightShift: found 12, expected a number of bits",)),
    "levels above the shift": (described(at_key("image", "rawDetails", "pixelFormat", "rightShift", value=4)), "MetadataError", ("pixelFormat: found", "white < 256")),
    "a stack of no pictures": (stack(lambda c: c.clear()), "StructureError", ("no refocus stack or depth map",)),
    "a depth table of another size": (stack(lambda c: c["depthLut"].update(width=9)), "StructureError", ("depthLut: found 16 bytes, expected 72 bytes (9 × 2 float32)",)),
    "pictures of two sizes": (stack(lambda c: c["imageArray"][0].update(width=9)), "StructureError", ("refocus stack: found pictures of 2 sizes",)),
    "a stack of thousands": (stack(lambda c: c.update(imageArray=c["imageArray"] * 999)), "LimitError", ("refocus stack: found 1998 pictures",)),
    "a RAW of the wrong size": (pair(lambda _: None, SIZE - 1), "StructureError", ("image", f"found {SIZE - 1} bytes, expected {SIZE} bytes by the metadata")),
    "a TXT that is no JSON": (pair(lambda path: path.write_bytes(b"zoom=3") and None), "MetadataError", ("metadata of image: found", "a JSON object")),
    "a tar that is cut": (tar(1500), "TruncatedError", ("member at byte 0: found 988 bytes before the file ends, expected 2000 bytes",)),
    "a sparse tar": (tar(type=tarfile.GNUTYPE_SPARSE), "UnsupportedError", ("member at byte 0: found a sparse file",)),
    "a storage container that is cut": (storage_cut, "TruncatedError", ("section at byte", "expected 500 bytes")),
    "a storage file without a name": (storage([{"dataRef": chunk_id(b"text")}]), "StructureError", ("files[0]: found name None, expected a file name",)),
    "a storage file of nothing": (storage([{"name": "A.TXT", "dataRef": "sha1-"}]), "StructureError", ("files[0].dataRef: found no section",)),
    "a view that is cut": (views(4, png(5, 4, ROWS)[:-20]), "TruncatedError", ("input_Cam004.png: chunk",)),
    "a view with a flipped bit": (views(4, flipped(png(5, 4, ROWS), 44)), "ChecksumError", ("input_Cam004.png: chunk b'IDAT'", "CRC-32")),
    "a view of another size": (views(4, png(5, 5, ROWS)), "StructureError", ("views: found pictures of 2 sizes, expected one size",)),
    "a view that is none": (views(4, b"text"), "UnknownFormatError", ("input_Cam004.png: header",)),
    "a grid that cannot be": (views(4, None, "[extrinsics]\nnum_cams_x = -3\nnum_cams_y = -3\n"), "MetadataError", ("parameters.cfg: found grid",)),
    "a PNG of no such kind": (file("a.png", png(5, 4, ROWS, bits=3)), "UnsupportedError", ("header: found 3 bits of colour type 2",)),
    "a PNG bomb": (file("a.png", png(16000, 16000, bytes(9))), "LimitError", ("size: found 16000 × 16000 from", "what deflate can pack")),
    "a float map that is cut": (file("a.pfm", b"Pf\n3 2\n-1\n" + bytes(23)), "StructureError", ("data: found 23 bytes, expected 24 bytes (3 × 2 × 1)",)),
    "a float map without a size": (file("a.pfm", b"Pf\nx y\n-1\n"), "StructureError", ("header: found b'Pf", "width, height, scale")),
    "a float map of scale 0": (file("a.pfm", b"Pf\n1 1\n0\n" + bytes(4)), "MetadataError", ("scale: found b'0', expected a number other than 0",)),
    "a huge float map": (file("a.pfm", b"Pf\n999999999 9\n-1\n"), "LimitError", ("size: found 999999999 × 9",)),
    "a .mat without LF": (mat("LG", LF), "StructureError", ("variables: found no numeric array LF",)),
    "a .mat of another shape": (mat("LF", LF[0]), "UnsupportedError", ("LF: found shape (3, 4, 5, 3)",)),
    "a .mat that is cut": (mat("LF", LF, 600), "TruncatedError", ("element at byte 128",)),
}  # fmt: skip

# Broken only where samples are read: opening and `lfflow info` see headers, checksums and sizes.
BROKEN_SAMPLES: dict[str, tuple[Callable[[Path], Path], str, tuple[str, ...]]] = {
    "a stack of no JPEGs": (stack(lambda _: None), "StructureError", ("found a JPEG of (height, width) None, expected (5, 7)",)),
    "a JPEG bomb": (stack(lambda c: [item.update(width=9999, height=9999) for item in c["imageArray"]]), "LimitError", ("9999 × 9999 pixels from 7 bytes",)),
    "a PNG of too few rows": (views(4, png(5, 4, ROWS[:-3])), "StructureError", ("picture data: found 61 bytes, expected 64 bytes",)),
    "a PNG of an unknown filter": (views(4, png(5, 4, b"\x09" + ROWS[1:])), "StructureError", ("an unknown row filter",)),
    "a packed .mat with a flipped bit": (mat("LF", LF + np.arange(5, dtype=np.uint16)[:, None], -3, packed=True), "ChecksumError", ("LF: found", "zlib data that fit their checksum")),
}  # fmt: skip
