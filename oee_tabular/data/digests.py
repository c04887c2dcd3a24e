"""Parquet files of this package: a digest of all their other bytes, which no page of parquet has, in their metadata."""

from __future__ import annotations

import errno
import hashlib
import os
import re
from collections.abc import Mapping

from oee_tabular._checks import Column

DIGEST_KEY, DIGEST_MARK = b"oee_tabular_digest", b"oee_tabular_sha256:"
TAIL = 2**20  # bytes at the end of a file, in which parquet keeps its metadata


def write_parquet(path: str, columns: Mapping[str, Column]) -> None:
    """Write a table, with a digest of all its other bytes in its metadata."""
    import duckdb
    import pandas as pd

    empty = (DIGEST_MARK + b"0" * 64).decode()
    with duckdb.connect(":memory:", config={"threads": 1, "autoload_known_extensions": False}) as connection:
        connection.register("log_in_memory", pd.DataFrame(dict(columns)))
        try:
            connection.execute(
                f"COPY log_in_memory TO {quote_text(os.path.abspath(path))} (FORMAT parquet, USE_TMP_FILE false, "
                f"KV_METADATA {{{DIGEST_KEY.decode()}: '{empty}'}})"
            )
        except duckdb.IOException as error:  # a full disk, as the system's own error
            code = re.search(r'errno"?:"?(\d+)', str(error))
            number = int(code[1]) if code else errno.EIO
            raise OSError(number, os.strerror(number)) from None
    digest, place = digest_of(path)
    with open(path, "r+b") as handle:
        handle.seek(place)
        handle.write(digest)


def check_digest(path: str) -> None:
    """ValueError where a parquet file of this package has other bytes than it was written with."""
    with open(path, "rb") as handle:
        size = os.fstat(handle.fileno()).st_size
        handle.seek(max(size - TAIL, 0))
        tail = handle.read()
    if DIGEST_KEY not in tail and DIGEST_MARK not in tail:
        return  # another program's
    digest, place = digest_of(path)
    start = place - max(size - TAIL, 0)
    if place < 0 or tail[start : start + 64] != digest:
        raise ValueError(
            f"{path!r} must be as it was saved: its digest is not that of its bytes. It is damaged, or another program "
            "wrote it anew (then make a log of its frame and save that: Transitions.from_frame(frame).save(path))"
        )


def digest_of(path: str) -> tuple[bytes, int]:
    """The SHA-256 of a file's bytes, 64 hexadecimal digits, with zeros where they stand in it; -1: they have no place."""
    with open(path, "rb") as handle:
        size = os.fstat(handle.fileno()).st_size
        handle.seek(max(size - TAIL, 0))
        mark = handle.read().rfind(DIGEST_MARK)
        if mark < 0:
            return b"", -1
        place = max(size - TAIL, 0) + mark + len(DIGEST_MARK)
        handle.seek(0)
        digest, left = hashlib.sha256(), place
        while left and (block := handle.read(min(left, TAIL))):
            digest.update(block)
            left -= len(block)
        digest.update(b"0" * 64)
        handle.seek(place + 64)
        while block := handle.read(TAIL):
            digest.update(block)
    return digest.hexdigest().encode(), place


def quote_text(text: str) -> str:
    """Text as SQL has it."""
    return "'" + text.replace("'", "''") + "'"
