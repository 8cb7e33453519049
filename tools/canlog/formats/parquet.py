"""Frames as a Parquet table: exact, small, and readable with pandas, polars and DuckDB."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from canlog.arrow_columns import arrow_column, arrow_names, numpy_column
from canlog.damage import Damages, LogError
from canlog.formats.identifiers import possible
from canlog.frames import CLASSIC_BYTES, FD_BYTES, Bytes, Frames
from canlog.options import ReadOptions

KIND: Final = b"canlog.frames"
VERSION: Final = b"1"
BUFFER_BYTES: Final = 1 << 16
ROWS_TOGETHER: Final = 1 << 16
"""Rows that are decoded at once."""
COLUMNS: Final = ("at_ns", "channel", "identifier", "flags", "length", "data")


def write(path: Path, blocks: Iterable[Frames], losses: Damages) -> None:
    """Write every frame without loss."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    del losses
    schema = pa.schema(
        [
            pa.field("at_ns", pa.int64()),
            pa.field("channel", pa.dictionary(pa.int32(), pa.string())),
            pa.field("identifier", pa.uint32()),
            pa.field("flags", pa.uint8()),
            pa.field("length", pa.uint8()),
            pa.field("data", pa.binary()),
        ],
        metadata={b"kind": KIND, b"version": VERSION},
    )
    with pq.ParquetWriter(str(path), schema, compression="zstd") as out:
        for frames in blocks:
            out.write_table(_table(frames, schema))


def _table(frames: Frames, schema: Any) -> Any:
    import pyarrow as pa

    shown = np.minimum(frames.length, frames.data.shape[1]).astype(np.int32)
    offsets = np.concatenate([[0], np.cumsum(shown)]).astype(np.int32)
    packed = frames.data[np.arange(frames.data.shape[1]) < shown[:, None]]
    buffers = [None, pa.py_buffer(offsets.tobytes()), pa.py_buffer(packed.tobytes())]
    columns = [
        arrow_column(frames.at_ns),
        arrow_names(frames.channel, frames.channels or ("",)),
        arrow_column(frames.identifier),
        arrow_column(frames.flags),
        arrow_column(frames.length),
        pa.Array.from_buffers(pa.binary(), len(frames), buffers),
    ]
    return pa.Table.from_arrays(columns, schema=schema)


def read(path: Path, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    """Yield the frames of a table that `write` has written, row group by row group.

    Raises:
        LogError: for a file that is no Parquet file or holds other content.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(str(path), buffer_size=BUFFER_BYTES, pre_buffer=False) as file:
            metadata = file.schema_arrow.metadata or {}
            names = set(file.schema_arrow.names)
            if metadata.get(b"kind") != KIND or not names >= set(COLUMNS):
                raise LogError(f"{path}: a Parquet table, but not one of frames")
            yield from _blocks(file, options, damages)
    except (pa.ArrowException, OSError) as error:
        raise LogError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from error


def _blocks(file: Any, options: ReadOptions, damages: Damages) -> Iterator[Frames]:
    import pyarrow as pa

    known: list[str] = []
    groups = file.num_row_groups
    for group in range(groups):
        try:
            for batch in file.iter_batches(
                min(options.block_frames, ROWS_TOGETHER),
                row_groups=[group],
                columns=list(COLUMNS),
                use_threads=False,
            ):
                if batch.num_rows:
                    yield possible(_frames(batch, known), damages)
        except (pa.ArrowException, OSError, ValueError) as error:
            words = str(error).splitlines()[0] if str(error) else "cannot be read"
            damages.add("broken row group", "group", group, words)


def _frames(batch: Any, known: list[str]) -> Frames:
    column = {name: batch.column(COLUMNS.index(name)) for name in COLUMNS}
    channel = column["channel"]
    channel = channel if hasattr(channel, "dictionary") else channel.dictionary_encode()
    names = [str(name) for name in channel.dictionary.to_pylist()]
    known += [name for name in dict.fromkeys(names) if name not in known]
    if len(known) > 256:
        raise ValueError(f"{len(known)} channels")
    numbers = np.array([known.index(name) for name in names] or [0], np.uint8)
    data = column["data"]
    length = numpy_column(column["length"], np.uint8)
    return Frames(
        numpy_column(column["at_ns"], np.int64),
        numpy_column(column["identifier"], np.uint32),
        numpy_column(column["flags"], np.uint8),
        numbers[numpy_column(channel.indices, np.int64)],
        np.minimum(length, FD_BYTES).astype(np.uint8),
        _data(data),
        tuple(known),
    )


def _data(column: Any) -> Bytes:
    """Return (n, 8) or (n, 64) bytes of a binary column."""
    if column.null_count:
        raise ValueError("frames without data")
    offsets = np.frombuffer(column.buffers()[1], np.int32)[
        column.offset : column.offset + len(column) + 1
    ].astype(np.int64)
    sizes = np.diff(offsets)
    longest = int(sizes.max()) if len(sizes) else 0
    if longest > FD_BYTES or (len(sizes) and int(sizes.min()) < 0):
        raise ValueError(f"a frame of {longest} bytes")
    width = CLASSIC_BYTES if longest <= CLASSIC_BYTES else FD_BYTES
    data = np.zeros((len(sizes), width), np.uint8)
    content = column.buffers()[2]
    if content is not None and len(sizes):
        packed = np.frombuffer(content, np.uint8)[offsets[0] : offsets[-1]]
        data[np.arange(width) < sizes[:, None]] = packed
    return data
