"""Makes pyarrow arrays from numpy columns by their buffers.

`pyarrow.array` loads pandas wherever that is installed, which takes 50 MB and half a second.
"""

from typing import Any

import numpy as np


def arrow_column(values: Any, valid: Any = None) -> Any:
    """Return an array of numbers, flags or texts; numbers share the memory of the column.

    Args:
        values: (n,) numbers, flags, or text.
        valid: (n,) which items are there; None for all.
    """
    import pyarrow as pa

    there = None
    if valid is not None and not valid.all():
        there = pa.py_buffer(np.packbits(valid, bitorder="little"))
    if values.dtype.kind in "iuf":
        column = pa.py_buffer(np.ascontiguousarray(values))
        kind = pa.from_numpy_dtype(values.dtype)
        return pa.Array.from_buffers(kind, len(values), [there, column])
    if values.dtype.kind == "b":
        bits = pa.py_buffer(np.packbits(values, bitorder="little"))
        return pa.Array.from_buffers(pa.bool_(), len(values), [there, bits])
    texts = [str(each).encode() for each in values.tolist()]
    ends = np.cumsum([0, *map(len, texts)]).astype(np.int32)
    content = pa.py_buffer(b"".join(texts))
    return pa.Array.from_buffers(pa.string(), len(texts), [there, pa.py_buffer(ends), content])


def numpy_column(column: Any, kind: Any) -> Any:
    """Return (n,) numbers of an arrow array without gaps. `to_numpy` would load pandas, too.

    Raises:
        ValueError: for a column with gaps.
    """
    import pyarrow as pa

    if column.null_count:
        raise ValueError("items are missing")
    numbers = column.cast(pa.from_numpy_dtype(kind))
    found = np.frombuffer(numbers.buffers()[1], kind) if len(numbers) else np.zeros(0, kind)
    return found[numbers.offset : numbers.offset + len(numbers)]


def arrow_names(rows: Any, names: Any) -> Any:
    """Return (n,) names by their numbers `rows`, each name stored once."""
    import pyarrow as pa

    numbers = arrow_column(np.asarray(rows, np.int32))
    return pa.DictionaryArray.from_arrays(numbers, arrow_column(np.asarray(names)))
