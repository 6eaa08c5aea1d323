"""The log of all episodes of a drive: rows in memory, a Parquet file on disk."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lanebound.agents.episodes.columns import Column, Moment, columns, row_of
from lanebound.integrity.assessment.record import Record
from lanebound.integrity.positioning.modes import Mode

__all__ = ["EpisodeLog", "schema_of"]


def schema_of(shown: Sequence[Column]) -> Any:
    """A pyarrow Schema of columns; unit and meaning of each are in the metadata of its field."""
    import pyarrow as pa

    types = {
        "int": pa.int64(),
        "float": pa.float64(),
        "bool": pa.bool_(),
        "text": pa.string(),
        "floats": pa.list_(pa.float64()),
    }
    return pa.schema([pa.field(c.name, types[c.kind], metadata={"unit": c.unit, "meaning": c.meaning}) for c in shown])


class EpisodeLog:
    """Rows of all steps in memory.

    Attributes
    ----------
    rows : one dict for each step, with the keys of :func:`~lanebound.agents.episodes.columns.columns`
    """

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []

    def note(self, moment: Moment) -> None:
        """Append the row of a step."""
        self.rows.append(row_of(moment))

    def episode(self, number: int) -> list[dict[str, Any]]:
        """The rows of one episode, its start first."""
        return [row for row in self.rows if row["episode"] == number]

    def to_table(self) -> Any:
        """A pyarrow Table; unit and meaning of a column are in the metadata of its field."""
        import pyarrow as pa

        return pa.Table.from_pylist(self.rows, schema=schema_of(columns()))

    def write(self, path: Path) -> None:
        """Write the Parquet file; it is complete at any time."""
        import pyarrow.parquet as pq

        part = path.with_suffix(".part")
        pq.write_table(self.to_table(), part)
        os.replace(part, path)

    @property
    def limits_m(self) -> tuple[float, float]:
        """Alert limits along and across the track at the start."""
        return self.rows[0]["al_at_m"], self.rows[0]["al_ct_m"]

    def to_record(self, step_s: float) -> Record:
        """Belief and truth after every decision, all episodes in one line, for assessment.

        Where alert limits change, errors and levels are scaled to :attr:`limits_m`.
        """
        rows = [row for row in self.rows if row["step"] > 0]

        def column(name: str) -> Any:
            return np.array([row[name] for row in rows])

        at, ct = (limit / column(name) for limit, name in zip(self.limits_m, ("al_at_m", "al_ct_m"), strict=True))
        return Record(
            time_s=step_s * np.arange(1.0, len(rows) + 1.0),
            mode=np.array([int(Mode.named(row["mode"])) for row in rows]),
            error_at_m=at * column("err_at_m"),
            error_ct_m=ct * column("err_ct_m"),
            pl_at_m=at * column("pl_at_m"),
            pl_ct_m=ct * column("pl_ct_m"),
            alert=column("alert"),
            available=column("available"),
        )
