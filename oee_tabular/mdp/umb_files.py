"""Files of the unified Markov binary format (.umb), which PRISM and Storm read.

Such a file is a tar archive, usually packed: ``index.json`` says what there is, and the
other members are plain arrays. The package umbi checks and writes the index. Arrays are
read by numpy, because umbi 0.2.5 makes an object of each number, and reads no states'
variables beside bitstring 5; sizes are compared before anything is allocated.
"""

from __future__ import annotations

import bz2
import gzip
import importlib.util
import io
import json
import logging
import lzma
import os
import tarfile
from collections.abc import Mapping
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from oee_tabular import _checks, _files
from oee_tabular.exceptions import ArgumentError
from oee_tabular.typing import Array, BoolArray, IntArray

SUFFIX = ".umb"
INDEX = "index.json"
MAX_UNPACKED_BYTES = 2**32  # of one archive: a bomb is refused in some seconds
_PACKED: tuple[tuple[bytes, Any], ...] = (
    (b"\x1f\x8b", gzip.open),
    (b"\xfd7zXZ\x00", lzma.open),
    (b"BZh", bz2.open),
)
_MAX_BITS = 62  # of an integer that is read
_WORD_BYTES = 8  # bits are padded to whole words


def require_umbi() -> None:
    """Raise an ImportError that names the extra where umbi is missing."""
    if importlib.util.find_spec("umbi") is None:
        raise ImportError("umbi is not installed; in a clone: pip install '.[umb]'")
    # an invalid index is an error of ours, not a line on standard error
    logger = logging.getLogger("umbi")
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())


class _Bounded(io.RawIOBase):
    """Read from a file that unpacks itself, up to a number of bytes."""

    def __init__(self, source: Any) -> None:
        self._source = source
        self._left = MAX_UNPACKED_BYTES

    def readable(self) -> bool:
        """Say that this can be read."""
        return True

    def read(self, size: int = -1, /) -> bytes:
        """Return up to ``size`` bytes; raise a ValueError beyond the limit."""
        asked = self._left + 1 if size < 0 else min(size, self._left + 1)
        data: bytes = self._source.read(asked)
        self._left -= len(data)
        if self._left < 0:
            raise ValueError(f"it unpacks to more than {MAX_UNPACKED_BYTES} bytes")
        return data


class UmbFile:
    """Hold the members of a .umb file, and read them as arrays of known lengths.

    Attributes
    ----------
    name : str
        The path, with which errors begin.
    index : dict
        The index, as umbi's schema allows it.
    """

    name: str
    index: dict[str, Any]

    def __init__(self, path: str | os.PathLike[str]) -> None:
        require_umbi()
        self.name = _files.local(path)
        with _files.open_regular(self.name) as handle:
            try:
                self._members = _read_members(handle, self.name)
                self.index = self._read_index()
            except MemoryError:
                raise
            except Exception as error:
                # tarfile, zlib, lzma, json and umbi raise many classes on bytes that
                # are not theirs
                words = _checks.escape_controls(str(error) or type(error).__name__)
                raise self.error(
                    f"must be a .umb file, a tar archive of a model; {words:.300}"
                ) from None

    def error(self, rule: str) -> ArgumentError:
        """Return the error that the file breaks a rule."""
        return ArgumentError(f"{self.name!r}", rule)

    def count(self, label: str) -> int:
        """Return a number of the index's transition system."""
        return int(self.index["transition-system"].get(label) or 0)

    def has(self, member: str) -> bool:
        """Say whether there is a member."""
        return member in self._members

    def read(self, member: str, n_bytes: int | None = None) -> bytes:
        """Return the bytes of a member, which must be so many."""
        if member not in self._members:
            raise self.error(f"must have the member {member}; it has none")
        data = self._members[member]
        if n_bytes is not None and len(data) != n_bytes:
            raise self.error(
                f"must have {n_bytes} bytes in {member}, as its index says; it has"
                f" {len(data)}"
            )
        return data

    def integers(self, member: str, count: int, n_bytes: int = 8) -> IntArray:
        """Return a member of ``count`` unsigned integers."""
        data = self.read(member, count * n_bytes)
        values = np.frombuffer(data, dtype=f"<u{n_bytes}")
        if values.size and values.max() >= 2**_MAX_BITS:
            raise self.error(
                f"must have smaller integers in {member}; it has {values.max()}"
            )
        return values.astype(np.int64)

    def offsets(self, member: str, count: int, total: int) -> IntArray:
        """Return where the parts of ``count`` owners begin and end; each has one.

        Without the member each owner has exactly one part.
        """
        if not self.has(member) and count == total:
            return np.arange(count + 1)
        values = self.integers(member, count + 1)
        if values[0] != 0 or values[-1] != total or (np.diff(values) < 0).any():
            raise self.error(f"must have offsets in order, 0 to {total}, in {member}")
        return values

    def numbers(self, member: str, count: int, kind: Mapping[str, Any]) -> Array:
        """Return a member of ``count`` real numbers of a type of the format."""
        name = kind.get("type")
        bits = kind.get("size") or {"rational": 128}.get(str(name), 64)
        if name == "double" and bits == 64:
            data = self.read(member, count * 8)
            return np.frombuffer(data, dtype="<f8").astype(np.float64)
        if name in ("int", "uint") and bits in (8, 16, 32, 64):
            data = self.read(member, count * bits // 8)
            letter = "u" if name == "uint" else "i"
            return np.frombuffer(data, f"<{letter}{bits // 8}").astype(np.float64)
        if name == "rational" and bits % 16 == 0:
            return self._rationals(member, count, bits // 16)
        raise self.error(
            f"must have numbers in {member}, double, rational, int or uint; they are"
            f" {_checks.show(name)} of {_checks.show(bits)} bits"
        )

    def flags(self, member: str, count: int) -> BoolArray:
        """Return a member of ``count`` bits, which may be padded."""
        data = self.read(member)
        if not count <= 8 * len(data) < count + 8 * _WORD_BYTES:
            raise self.error(
                f"must have {count} bits in {member}, as its index says; it has"
                f" {8 * len(data)}"
            )
        bits = np.frombuffer(data, dtype=np.uint8)
        return np.unpackbits(bits, count=count, bitorder="little").astype(np.bool_)

    def texts(self, folder: str, count: int) -> list[str]:
        """Return the ``count`` texts of a folder: their bytes, and where each begins."""
        data = self.read(f"{folder}/strings.bin")
        bounds = self.offsets(f"{folder}/string-mapping.bin", count, len(data))
        try:
            ends = bounds.tolist()
            return [
                data[begin:end].decode()
                for begin, end in zip(ends[:-1], ends[1:], strict=True)
            ]
        except UnicodeDecodeError:
            raise self.error(f"must have texts in UTF-8 in {folder}") from None

    def variables(self, n_states: int) -> IntArray | None:
        """Return the values of the states' variables (n, v), or None.

        None where there are none, or some that are no plain integers or flags.
        """
        described = (self.index.get("valuations") or {}).get("states") or {}
        classes = described.get("classes") or []
        if len(classes) != 1:
            return None
        places = []
        n_bits = 0
        for field in classes[0]["variables"]:
            if "padding" in field:
                n_bits += field["padding"]
                continue
            kind = field["type"]["type"]
            size = field["type"].get("size") or {"bool": 1}.get(kind, 64)
            is_plain = kind in ("bool", "int", "uint") and size <= _MAX_BITS
            if not is_plain or field.get("is-optional"):
                return None
            places.append((n_bits, size, kind == "int", field.get("offset") or 0))
            n_bits += size
        member = "valuations/states/valuations.bin"
        if not places or n_bits % 8 or not self.has(member):
            return None
        data = self.read(member, n_states * n_bits // 8)
        _checks.require_memory(n_states * n_bits, repr(self.name), size=1)
        table = np.frombuffer(data, dtype=np.uint8).reshape(n_states, n_bits // 8)
        bits = np.unpackbits(table, axis=1, bitorder="little")
        values = []
        for begin, size, is_signed, offset in places:
            value = bits[:, begin : begin + size] @ (1 << np.arange(size))
            if is_signed:
                value -= bits[:, begin + size - 1].astype(np.int64) << size
            values.append(value + offset)
        return np.stack(values, axis=1)

    def _rationals(self, member: str, count: int, n_bytes: int) -> Array:
        """Return numbers that are two integers of ``n_bytes`` each, as floats."""
        data = self.read(member, count * 2 * n_bytes)
        values = np.empty(count)
        for k in range(count):
            begin = 2 * n_bytes * k
            top = int.from_bytes(data[begin : begin + n_bytes], "little", signed=True)
            below = int.from_bytes(
                data[begin + n_bytes : begin + 2 * n_bytes], "little"
            )
            if below == 0:
                raise self.error(f"must have no denominator 0 in {member}; entry {k}")
            values[k] = top / below
        return values

    def _read_index(self) -> dict[str, Any]:
        """Return the index, once umbi has found nothing wrong with it."""
        from umbi.umb.index import UmbIndex  # an extra

        data = self._members.get(INDEX)
        if data is None:
            raise ValueError(f"it has no {INDEX}")
        index = json.loads(data)
        if isinstance(index, dict):
            refuse_kinds(index.get("transition-system"))
        UmbIndex.from_json(index)
        return dict(index)


def refuse_kinds(system: Any) -> None:
    """Raise a ValueError for a model that is neither an MDP nor a Markov chain."""
    if not isinstance(system, dict):
        return
    n_players = system.get("#players")
    described = system.get("branch-probability-type")
    kind = described.get("type") if isinstance(described, dict) else None
    text = None
    if system.get("time") == "stochastic":
        text = "a model in continuous time (a CTMC or a CTMDP)"
    elif system.get("time") == "urgent-stochastic":
        text = "a Markov automaton, in continuous time"
    elif system.get("#observations"):
        text = "a POMDP, whose states are observed in part"
    elif isinstance(n_players, int) and n_players > 1:
        text = f"a game of {n_players} players"
    elif isinstance(kind, str) and kind.endswith("-interval"):
        text = "an interval model, whose probabilities are not numbers"
    elif isinstance(kind, str) and kind not in ("double", "rational"):
        text = f"a parametric model, whose probabilities are of the type {kind:.40}"
    if text is not None:
        raise ValueError(
            f"it holds {text}, where an MDP or a Markov chain in discrete time is"
            " needed"
        )


def write_umb(
    path: str | os.PathLike[str],
    index: Any,
    arrays: Mapping[str, NDArray[Any] | list[str]],
) -> None:
    """Write a .umb file, whole or not at all.

    ``index`` is umbi's. Arrays of bool become bits, lists of texts two members.
    """
    from umbi.tar import TarCoder  # an extra

    index.validate()
    members = TarCoder()
    members.add_json(INDEX, index.to_json())
    for name, values in arrays.items():
        if isinstance(values, list):
            texts = [text.encode() for text in values]
            ends = np.cumsum([0, *map(len, texts)])
            members.add_file(f"{name}/strings.bin", b"".join(texts))
            members.add_file(f"{name}/string-mapping.bin", ends.astype("<u8").tobytes())
        elif values.dtype == np.bool_:
            bits = np.packbits(values, bitorder="little")
            padded = np.resize(bits, -(-len(bits) // _WORD_BYTES) * _WORD_BYTES)
            padded[len(bits) :] = 0
            members.add_file(f"{name}.bin", padded.tobytes())
        else:
            members.add_file(f"{name}.bin", values.tobytes())
    with (
        _files.whole_file(path, (SUFFIX,)) as handle,
        # neither the name nor the time: the same MDP makes the same bytes
        gzip.GzipFile("", "wb", 6, handle, mtime=0) as packed,
        tarfile.open(fileobj=packed, mode="w") as archive,
    ):
        for name, data in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))


def _read_members(handle: IO[bytes], name: str) -> dict[str, bytes]:
    """Return the regular members of the archive that the format knows, by name."""
    first = handle.read(8)
    handle.seek(0)
    source: Any = handle
    for magic, unpack in _PACKED:
        if first.startswith(magic):
            source = unpack(handle)
    members: dict[str, bytes] = {}
    total = 0
    with tarfile.open(fileobj=_Bounded(source), mode="r|") as archive:
        for member in archive:
            label = member.name.removeprefix("./")
            if not member.isreg() or not (label == INDEX or label.endswith(".bin")):
                continue
            if member.issparse():
                raise ValueError(f"{label!r:.80} is stored with holes")
            if label in members:
                raise ValueError(f"it holds {label!r:.80} twice")
            if label == INDEX and member.size > _files.MAX_TEXT_BYTES:
                raise ValueError(f"its {INDEX} has {member.size} bytes")
            total += member.size
            _checks.require_memory(total, repr(name), size=1)
            file = archive.extractfile(member)
            data = b"" if file is None else file.read()
            if len(data) != member.size:
                raise ValueError(f"{label!r:.80} is cut off")
            members[label] = data
    return members
