"""Bytes per sample of a stored light field, by dtype, kept bits and codec.

    python benchmarks/storage.py [RAW.lfp]

A simulated capture, or one that is given. The raw frame at 12 bits is the yardstick.
"""

from __future__ import annotations

import sys

import numpy as np
import numpy.typing as npt
import xarray as xr
from numcodecs import BitRound, Blosc


def field(path: str | None) -> tuple[xr.Dataset, xr.Dataset]:
    from lfflow.stages.demultiplex import demultiplex

    if path is not None:
        from lfflow.stages.calibrate import calibrate

        raw = xr.open_dataset(path, engine="lfp")
        return raw, demultiplex(raw, calibrate(raw)).compute()
    from lfflow.simulate import simulate_capture, simulate_white

    raw, _ = simulate_capture(height=1200, width=1200, views=[0])
    _, white = simulate_white(height=1200, width=1200)
    return raw, demultiplex(raw, white.rename(defects="pixel_flags"))


def stored(array: npt.NDArray[np.generic], codec: Blosc) -> int:
    """Bytes of an array (v, u, t, s), a chunk a view."""
    return sum(len(codec.encode(np.ascontiguousarray(view))) for row in array for view in row)


def rounded(array: npt.NDArray[np.float32], bits: int) -> npt.NDArray[np.float32]:
    return BitRound(bits).encode(array.copy()).view(np.float32).reshape(array.shape)


def main() -> None:
    raw, lf = field(sys.argv[1] if len(sys.argv) > 1 else None)
    samples = int((lf.cfa != 255).sum())
    print(f"{samples} samples; raw at 12 bits: {raw.raw.size * 1.5 / samples:.2f} bytes a sample")
    codecs = {
        f"{name}-{level} {shuffle}": Blosc(name, level, mode)
        for name, level in (("zstd", 1), ("zstd", 5), ("lz4", 5))
        for shuffle, mode in (("shuffle", Blosc.SHUFFLE), ("bitshuffle", Blosc.BITSHUFFLE))
    }
    undone = (lf.mosaic * lf.weight).values.astype(np.float32)
    candidates = {
        **{f"mosaic float32, {b} bits": rounded(lf.mosaic.values, b) for b in (23, 14, 12, 10, 8)},
        "mosaic float16": lf.mosaic.values.astype(np.float16),
        "mosaic × weight, 12 bits": rounded(undone, 12),
        **{f"weight float32, {b} bits": rounded(lf.weight.values, b) for b in (23, 7, 5)},
        "weight uint8 (1/255)": np.rint(lf.weight.values * 255).astype(np.uint8),
        "cfa uint8": lf.cfa.values,
    }
    print(f"{'bytes a sample':26}" + "".join(f"{name:>19}" for name in codecs))
    for name, array in candidates.items():
        print(f"{name:26}" + "".join(f"{stored(array, codec) / samples:19.3f}" for codec in codecs.values()))


if __name__ == "__main__":
    main()
