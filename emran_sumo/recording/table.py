"""A trace as a Parquet table: one float64 column per quantity, its unit in the column's metadata."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as csv
import pyarrow.parquet as pq

AT_ONCE = 60_000  # rows: ten minutes at 100 Hz


def write_trace(
    file: Path | str, columns: Sequence[str], rows: np.ndarray, units: Mapping[str, str] | None = None
) -> None:
    """Write (n, columns) rows; the file appears complete or not at all.

    Args:
        file: path of the .parquet file; its folder is created.
        columns: names, one per column of `rows`.
        rows: (n, columns) values.
        units: unit symbol by column name, where known.

    Raises:
        ValueError: `rows` is not (n, number of columns).
    """
    table = np.asarray(rows, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] != len(columns):
        raise ValueError(f"rows of shape {table.shape} do not fit {len(columns)} columns")
    units = units or {}
    schema = pa.schema(
        [
            pa.field(name, pa.float64(), nullable=False, metadata={"unit": units[name]} if name in units else None)
            for name in columns
        ]
    )
    target = Path(file)
    target.parent.mkdir(parents=True, exist_ok=True)
    part = target.with_name(f"{target.name}.{os.getpid()}.part")
    try:
        with pq.ParquetWriter(part, schema, compression="zstd") as writer:
            for first in range(0, max(len(table), 1), AT_ONCE):  # long traces are not copied as a whole
                rows = table[first : first + AT_ONCE]
                arrays = [pa.array(np.ascontiguousarray(column)) for column in rows.T]
                writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
        os.replace(part, target)
    finally:
        part.unlink(missing_ok=True)


def write_csv(trace: Path, file: Path, units: Mapping[str, str]) -> None:
    """Write a trace as text, a header of names and units first; every number reads back as the same float64."""
    table = pq.read_table(trace)
    header = [f"{name} [{units[name]}]" if name in units else name for name in table.column_names]
    csv.write_csv(table.rename_columns(header), file, csv.WriteOptions(quoting_style="none"))


def read_trace(file: Path | str) -> dict[str, np.ndarray]:
    """The columns of a trace by name, each (n,) float64."""
    table = pq.read_table(file)
    return {name: table.column(name).to_numpy() for name in table.column_names}


def read_units(file: Path | str) -> dict[str, str]:
    """Unit symbol by column name, for the columns that were written with one."""
    schema = pq.read_schema(file)
    return {f.name: f.metadata[b"unit"].decode() for f in schema if f.metadata and b"unit" in f.metadata}
