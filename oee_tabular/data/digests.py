"""Parquet files of this package: a digest of all their other bytes, which no page of parquet has, in their metadata."""

from __future__ import annotations

import errno
import hashlib
import os
import re
from collections.abc import Mapping

from oee_tabular._checks import Column

DIGEST_KEY, DIGEST_MARK, EMPTY = b"oee_tabular_digest", b"oee_tabular_sha256:", b"0" * 64
TAIL = 2**20  # bytes at the end of a file, in which parquet keeps its metadata


def write_parquet(path: str, columns: Mapping[str, Column]) -> None:
    """Write a table, with a digest of all its other bytes in its metadata."""
    import duckdb
    import pandas as pd

    with duckdb.connect(":memory:", config={"threads": 1, "autoload_known_extensions": False}) as connection:
        connection.register("log_in_memory", pd.DataFrame(dict(columns)))
        try:
            connection.execute(
                f"COPY log_in_memory TO {quote_text(os.path.abspath(path))} (FORMAT parquet, USE_TMP_FILE false, "
                f"KV_METADATA {{{DIGEST_KEY.decode()}: '{(DIGEST_MARK + EMPTY).decode()}'}})"
            )
        except duckdb.IOException as error:  # a full disk, as the system's own error
            code = re.search(r'errno"?:"?(\d+)', str(error))
            number = int(code[1]) if code else errno.EIO
            raise OSError(number, os.strerror(number)) from None
    _, digest, place = _read_digest(path)
    with open(path, "r+b") as handle:
        handle.seek(place)
        handle.write(digest)


def check_digest(path: str) -> None:
    """ValueError where a parquet file of this package has other bytes than it was written with."""
    stored, digest, _ = _read_digest(path)
    if stored != digest:
        raise ValueError(
            f"{path!r} must be as it was saved: its digest is not that of its bytes. It is damaged, or another program "
            "wrote it anew (then make a log of its frame and save that: Transitions.from_frame(frame).save(path))"
        )


def _read_digest(path: str) -> tuple[bytes, bytes, int]:
    """The digest in a file, that of its bytes (SHA-256, zeros where it stands), its place; twice nothing of others' files."""
    with open(path, "rb") as handle:
        n_before = max(os.fstat(handle.fileno()).st_size - TAIL, 0)
        handle.seek(n_before)
        start, mark, rest = handle.read().rpartition(DIGEST_MARK)
        if not mark:  # another program's, or a file of ours whose mark is damaged
            return b"", DIGEST_KEY if DIGEST_KEY in rest else b"", -1
        digest = hashlib.sha256()
        handle.seek(0)
        for k in range(0, n_before, TAIL):
            digest.update(handle.read(min(TAIL, n_before - k)))
        digest.update(start + mark + EMPTY + rest[64:])
    return rest[:64], digest.hexdigest().encode(), n_before + len(start + mark)


def quote_text(text: str) -> str:
    """Text as SQL has it."""
    return "'" + text.replace("'", "''") + "'"
