"""Damaged files: byte-flipped, cut and edited npz, npy, CSV and parquet files of logs, counts, simulators and policies.

    python tests/fuzz_files.py --seed 0 --files 20000

Every file is read in a child process, which may take 10 s for it. A reader gives something finite or raises ValueError,
FileNotFoundError, or MemoryError with the size that is needed, in a message that names the file. An npz or a parquet file of
our own, which carries a digest, gives what was saved or nothing. Anything else is printed and the exit code is 1. The same
seed makes the same files.
"""

import argparse
import collections
import contextlib
import hashlib
import io
import json
import select
import struct
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np

HANG = 10.0  # seconds for a file
START = 300.0  # seconds for a child to import and compile

HOSTILE = [
    0, 1, -1, 2, 3, 5, 7, 100, 0.25, 0.5, -0.5, 1e-320, 1e160, 1e300, -1e300, np.nan, np.inf, -np.inf, 2**31, 2**53 + 1,
    2**62, 2**63 - 1, -(2**63),
]  # fmt: skip
FIELDS = [
    "", "0", "1", "-1", "1.0", "1.5", "1e3", "nan", "inf", "-inf", "1e400", "9" * 30, "True", "no", '"', '"0,1"', "'", "=1+1",
    "\x00", "0x10", "1_000", "٣", "1;2", "\t", "  2", "NA", "None", "1970-01-01", "1/3", "é", "\ud7ff", "a" * 200_000,
]  # fmt: skip
DTYPES = [
    "f4", "f8", "f2", "i1", "i8", "u8", "?", "c16", "U4", "S3", "M8[s]", "m8[D]", "O", "V8", "i4,f8", ">f8", ">i8", "f16",
]  # fmt: skip
SHAPES = [
    (), (0,), (1,), (2, 1), (1, 1), (0, 3), (3, 0), (2, 2, 2), (4, 4), (10**9,), (10**18,), (10**30,), (-1,), (2**31, 2**31),
    (2_000_000_000,), ("a",), (1.5,), (True,),
]  # fmt: skip


# ---- whole files to begin with


def originals(folder):
    """Bytes of sound files: (ending, what it is) -> bytes."""
    import oee_tabular as oee

    grid = oee.tasks.gridworld(3, 0.3)
    log = oee.sample_episodes(grid, oee.uniform_policy(grid), 4, 12, seed=0)
    plain = oee.FiniteMDP(grid.transitions, grid.rewards, grid.initial, 0.9)
    rng = np.random.default_rng(0)
    states = rng.normal(size=(20, 2))
    continuous = oee.ContinuousTransitions(states, rng.integers(0, 2, 20), states + 0.1, rng.normal(size=20))
    found = {}
    things = [(log, "log", (".npz", ".csv", ".parquet")), (continuous, "states", (".npz", ".csv", ".parquet"))]
    for thing, kind, endings in [*things, (grid, "simulator", (".npz",)), (plain, "simulator2", (".npz",))]:
        for ending in endings:
            path = folder / f"{kind}{ending}"
            thing.save(path)
            found[ending, kind] = path.read_bytes()
    oee.Transitions.open(folder / "log.npz").save(folder / "counts.npz")
    found[".npz", "counts"] = (folder / "counts.npz").read_bytes()
    policy = oee.uniform_policy(grid)
    found[".npy", "policy"] = _written(np.save, policy)
    found[".npz", "policy"] = _written(lambda handle, array: np.savez(handle, policy=array), policy)
    return found


def _written(write, *arguments):
    buffer = io.BytesIO()
    write(buffer, *arguments)
    return buffer.getvalue()


# ---- what is done to them: (bytes, rng) -> bytes


def flipped(data, rng):
    changed = bytearray(data)
    for _ in range(rng.integers(1, 6)):
        changed[rng.integers(len(changed))] = rng.integers(256)
    return bytes(changed)


def cut(data, rng):
    return data[: rng.integers(len(data))]


def spliced(data, rng):
    a, b = sorted(rng.integers(len(data), size=2))
    return data[:b] + data[a:] if rng.random() < 0.5 else data[:a] + data[b:]


def noise(data, rng):
    head = data[: rng.integers(0, 9)]
    return head + rng.bytes(int(rng.integers(0, 200)))


def packed(arrays, rng):
    """An npz of arrays, or of bytes that stand for one, with the habits of other programs."""
    method = rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA])
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", int(method)) as archive:
        for name, array in arrays.items():
            data = array if isinstance(array, bytes) else _written(lambda h, a: np.save(h, a, allow_pickle=True), array)
            archive.writestr(f"{name}.npy", data)
    return buffer.getvalue()


def forged(array, rng):
    """The npy of an array with another header."""
    buffer = io.BytesIO()
    shape = SHAPES[rng.integers(len(SHAPES))] if rng.random() < 0.7 else array.shape
    descr = rng.choice(DTYPES) if rng.random() < 0.5 else array.dtype.str
    words = [repr({"descr": descr, "fortran_order": bool(rng.random() < 0.3), "shape": shape})]
    words += ["(" * 3000, "-" * 9000 + "1", "{'a': 1}", "{", "[]", "\x00", "'\\d'", "{'shape': (1L,)}", "9" * 5000, ""]
    header = words[0 if rng.random() < 0.8 else rng.integers(len(words))].encode()
    version = bytes([[1, 1, 1, 2, 3, 0, 9][rng.integers(7)], 0])
    size = struct.pack("<H", len(header) + 1) if version[0] == 1 else struct.pack("<I", len(header) + 1)
    buffer.write(b"\x93NUMPY" + version + size + header + b"\n" + array.tobytes())
    return buffer.getvalue()


def edited_array(array, rng):
    """The same array with one thing changed."""
    kind = rng.integers(6)
    if kind == 0 and array.size:
        changed = array.copy() if rng.random() < 0.5 or array.dtype.kind not in "biuf" else array.astype(np.float64)
        value = HOSTILE[rng.integers(len(HOSTILE))]
        try:
            with np.errstate(all="ignore"):
                changed.reshape(-1)[rng.integers(changed.size)] = value
        except (OverflowError, TypeError, ValueError):
            return np.array(value)
        return changed
    if kind == 1:
        try:
            with np.errstate(all="ignore"):
                return array.astype(rng.choice([name for name in DTYPES if "," not in name]))
        except (RuntimeError, TypeError, ValueError):
            return array.astype("O")
    if kind == 2:
        return array.reshape(-1)[: rng.integers(array.size + 1)]
    if kind == 3:
        return np.concatenate([array.reshape(-1), array.reshape(-1)])
    if kind == 4:
        return rng.permutation(array.reshape(-1)).reshape(array.shape)
    return [array[None], np.array(None), np.array(["0.25"] * 3), np.zeros((0, 3)), np.array(np.nan)][rng.integers(5)]


def edited_npz(data, rng):
    with np.load(io.BytesIO(data)) as stored:
        arrays = dict(stored)
    for _ in range(rng.integers(1, 3)):
        name = rng.choice(list(arrays))
        other, kind = rng.choice(list(arrays)), rng.integers(8)
        if kind == 0 and len(arrays) > 1:
            del arrays[name]
        elif kind == 6:
            arrays[name], arrays[other] = arrays[other], arrays[name]
        elif kind == 7:
            arrays[f"{name}{rng.choice(['_', '2', 'x'])}"] = arrays.pop(name)
        elif kind == 1:
            more = ["more", "policy", "layout", "../x", "behavior_probability", "reward"]
            arrays[more[rng.integers(6)]] = arrays[name]
        elif kind == 2 and isinstance(arrays[name], np.ndarray):
            arrays[name] = forged(arrays[name], rng)
        elif isinstance(arrays[name], np.ndarray):
            arrays[name] = edited_array(arrays[name], rng)
    return packed(arrays, rng)


def edited_zip(data, rng):
    """Fields of the zip's own directory: sizes, methods, flags."""
    changed = bytearray(data)
    at = data.rfind(b"PK\x01\x02") if rng.random() < 0.5 else data.find(b"PK\x01\x02")
    offset, width = [(8, 2), (10, 2), (16, 4), (20, 4), (24, 4), (28, 2), (42, 4)][rng.integers(7)]
    value = [0, 1, 8, 9, 12, 14, 93, 99, 0xFFFF, 2**31, 2**32 - 1][rng.integers(11)] & (256**width - 1)
    changed[at + offset : at + offset + width] = value.to_bytes(width, "little")
    return bytes(changed)


def bomb(data, rng):
    """A megabyte or so that says that it is many gigabytes, in a header, a directory, or truly."""
    header = _written(lambda h: np.lib.format.write_array_header_1_0(h, {
        "descr": "<f8", "fortran_order": False, "shape": ([2_000_000_000, 10**17][rng.integers(2)],)}))  # fmt: skip
    arrays = {
        "oee_tabular_kind": np.array(["transitions", "finite_mdp"][rng.integers(2)]),
        "state": header + bytes(10**6),
    }
    return packed(arrays, rng)


def edited_npy(data, rng):
    array = np.load(io.BytesIO(data))
    if rng.random() < 0.5:
        return forged(array, rng)
    return _written(lambda h, a: np.save(h, a, allow_pickle=True), edited_array(array, rng))


def edited_csv(data, rng):
    lines = [line.split(",") for line in data.decode().splitlines()]
    for _ in range(rng.integers(1, 4)):
        row = lines[rng.integers(len(lines))]
        kind = rng.integers(7) if row and lines[0] else 1
        if kind == 0:
            row[rng.integers(len(row))] = FIELDS[rng.integers(len(FIELDS))]
        elif kind == 1:
            row.append(FIELDS[rng.integers(len(FIELDS))])
        elif kind == 2 and len(row) > 1:
            del row[rng.integers(len(row))]
        elif kind == 3:
            lines[0] = [label.upper() if rng.random() < 0.5 else label for label in lines[0]]
        elif kind == 4:
            lines.insert(rng.integers(len(lines) + 1), [])
        elif kind == 5:
            k = rng.integers(len(lines[0]))
            for each in lines[1:]:
                if k < len(each):
                    each[k] = FIELDS[rng.integers(12)]
        else:
            lines = [line + [f"x{k}" for k in range(2000)] for line in lines]
    comma, end = rng.choice([",", ",", ",", ",", ";", "\t", "|", " "]), rng.choice(["\n", "\n", "\r\n", "\r"])
    text = str(end).join(str(comma).join(line) for line in lines)
    return text.encode(str(rng.choice(["utf-8", "utf-8", "utf-8", "utf-8-sig", "utf-16"])), errors="replace")


def edited_parquet(data, rng):
    import pyarrow as pa
    from pyarrow import parquet

    saved = parquet.read_table(io.BytesIO(data))
    table = saved.to_pydict()
    name, other = (str(name) for name in rng.choice(list(table), 2))
    column = table[name]
    values = [
        HOSTILE[rng.integers(len(HOSTILE))], None, "0.25", b"x", [1, 2], {"a": 1}, True, np.datetime64("2020-01-01", "s"),
        10**30, "a" * 1000,
    ]  # fmt: skip
    value = values[rng.integers(len(values))]
    kind = rng.integers(5)
    if kind == 4:
        table[name], table[other] = table[other], table[name]
    elif kind == 0:
        table[name] = [value] * len(column)
    elif kind == 1:
        table[name] = [*column[:-1], value]
    elif kind == 2:
        del table[name]
    else:
        table[str(value)[:50]] = table.pop(name)
    arrays = {}
    for label, values in table.items():
        try:
            arrays[label] = pa.array(values)
        except (pa.ArrowException, OverflowError, TypeError, ValueError):
            arrays[label] = pa.array([str(item) for item in values])
    if rng.random() < 0.2:
        arrays = {
            label: array.dictionary_encode()
            for label, array in arrays.items()
            if not (pa.types.is_nested(array.type) or pa.types.is_null(array.type))
        }
    made = pa.table(arrays)
    if rng.random() < 0.1:
        made = pa.Table.from_arrays(made.columns, names=["state"] * made.num_columns)
    if rng.random() < 0.5:  # the digest stays
        made = made.replace_schema_metadata(saved.schema.metadata)
    codec = str(rng.choice(["none", "snappy", "gzip", "zstd"]))
    return _written(lambda handle: parquet.write_table(made, handle, compression=codec))


ANY = (flipped, flipped, flipped, cut, spliced, noise)
EDITS = {
    ".npz": (*ANY, *[edited_npz] * 8, edited_zip, edited_zip, bomb),
    ".npy": (*ANY, *[edited_npy] * 6),
    ".csv": (*ANY, *[edited_csv] * 6),
    ".parquet": (*ANY, *[edited_parquet] * 6),
}


# ---- the child: reads what it is told to


def child():
    """Read the files that are named on standard input, a line each; say a line of JSON about each."""
    import warnings

    warnings.simplefilter("ignore")
    said = sys.stdout
    sys.stdout = sys.stderr  # lines of others are no answers
    readers = _readers()
    for line in sys.stdin:
        name, kind = json.loads(line)
        answers = {}
        for reader, read in readers[kind].items():
            answers[reader] = _outcome(read, name)
        print(json.dumps(answers), file=said, flush=True)


def _outcome(read, name):
    import traceback

    try:
        content = read(name)
        return ["finite" if content is not None else f"not finite: {read.__name__}", content]
    except (ValueError, FileNotFoundError) as error:
        text = str(error)
        if any(ord(c) < 32 and c not in "\n\t" for c in text) or len(text) > 1500:
            return [f"not printable: {text!a:.300}", ""]
        return ["refused" if Path(name).name in text or name in text else f"nameless: {error}", ""]
    except MemoryError as error:
        return ["too large" if "needs" in str(error) else f"no size: {error}", ""]
    except Exception:
        return ["raised: " + traceback.format_exc()[-1500:], ""]


def _content(columns):
    """A digest of columns by name, or None where a number is not finite."""
    columns = {name: np.asarray(column) for name, column in columns.items() if column is not None}
    if not all(np.isfinite(column).all() for column in columns.values() if column.dtype.kind == "f"):
        return None
    return hashlib.sha256(repr([(name, columns[name].tolist()) for name in sorted(columns)]).encode()).hexdigest()


def _readers():
    import oee_tabular as oee
    from oee_tabular.cli.files import describe_files
    from oee_tabular.mdp import check_policy
    from oee_tabular.mdp.policies import read_policy_array

    grid = oee.tasks.gridworld(3, 0.3)

    def log(name):
        loaded = oee.Transitions.load(name)
        with contextlib.suppress(ValueError):  # it reads well, but may be no log of this grid
            oee.Problem(grid, loaded)
        return _content(loaded.columns())

    def counted(name):
        return _content(oee.Transitions.open(name).columns())

    def counts(name):
        loaded = oee.TransitionCounts.load(name)
        return _content({**loaded.columns(), "recording": np.array(repr(loaded.recording))})

    def states(name):
        return _content(oee.ContinuousTransitions.load(name).columns())

    def simulator(name):
        loaded = oee.FiniteMDP.load(name)
        value = oee.policy_value(loaded, oee.uniform_policy(loaded), horizon=20)
        return _content({**loaded.arrays(), "value": value})

    def policy(name):
        return _content({"policy": check_policy(read_policy_array(name, "policy"), grid, name=f"policy {name!r}")})

    def info(name):
        describe_files([name])
        return ""

    readers = {"log": (log, counted), "counts": (counts, counted), "states": (states,), "policy": (policy,)}
    readers |= {"simulator": (simulator,), "simulator2": (simulator,)}
    return {kind: {read.__name__: read for read in (*reads, info)} for kind, reads in readers.items()}


# ---- the parent


class Reader:
    """A child process that is started again when it dies or hangs."""

    def __init__(self):
        self.start()

    def start(self):
        self.process = subprocess.Popen(
            [sys.executable, __file__, "--child"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        self.wait = START

    def read(self, path, kind):
        """Reader -> outcome, or the one thing that happened to the process."""
        self.process.stdin.write(json.dumps([str(path), kind]) + "\n")
        self.process.stdin.flush()
        if not select.select([self.process.stdout], [], [], self.wait)[0]:
            hung = f"hung: more than {self.wait:g} s"
            self.end()
            self.start()
            return {"process": [hung, ""]}
        line = self.process.stdout.readline()
        if not line:
            code = self.process.wait()
            self.start()
            return {"process": [f"died: exit code {code}", ""]}
        self.wait = HANG
        return json.loads(line)

    def end(self):
        self.process.kill()
        self.process.communicate()


def fuzz(seed, seconds, folder, most=10**9):
    """(outcomes, failures) of as many files as the time allows, the child's start not counted."""
    folder = Path(folder)
    sound = originals(folder)
    rng, reader = np.random.default_rng(seed), Reader()
    outcomes, failures, intact = collections.Counter(), [], {}
    try:
        for (ending, kind), data in sound.items():  # what is sound is read
            path = folder / f"sound{ending}"
            path.write_bytes(data)
            intact[ending, kind] = reader.read(path, kind)
            if any(outcome != "finite" for outcome, _ in intact[ending, kind].values()):
                failures.append((str(path), "sound", intact[ending, kind]))
        number, end = 0, time.monotonic() + seconds
        while time.monotonic() < end and number < most:
            ending, kind = list(sound)[number % len(sound)]
            edit = EDITS[ending][rng.integers(len(EDITS[ending]))]
            path = folder / f"broken{number}{ending}"
            path.write_bytes(data := edit(sound[ending, kind], rng))
            found = reader.read(path, kind)
            if is_ours(ending, kind, edit, data):
                found = {name: _compared(one, intact[ending, kind].get(name)) for name, one in found.items()}
            for outcome, _ in found.values():
                outcomes[outcome.partition(":")[0]] += 1
            bad = {name: one for name, (one, _) in found.items() if one not in ("finite", "refused", "too large")}
            if bad:
                failures.append((str(path), f"{kind} {edit.__name__}", bad))
            else:
                path.unlink()
            number += 1
    finally:
        reader.end()
    return number, outcomes, failures


def is_ours(ending, kind, edit, data):
    """Whether a file still says that it is one of ours, or is one whose bytes were damaged; its content is then held to."""
    return kind != "policy" and (
        (ending == ".npz" and edit is not bomb)
        or (ending == ".parquet" and (edit in ANY or b"oee_tabular_digest" in data))
    )


def _compared(one, intact):
    """An outcome of a file of ours: other content than was saved is a failure."""
    changed = intact is not None and one[0] == "finite" and one[1] != intact[1]
    return ["other content than was saved", one[1]] if changed else one


def main():
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--files", type=int, default=20_000)
    parser.add_argument("--keep", type=Path, help="an existing folder for the files that broke something")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        child()
        return
    with tempfile.TemporaryDirectory() as folder:
        number, outcomes, failures = fuzz(given.seed, given.seconds, given.keep or folder, given.files)
    counts = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.most_common())
    print(f"{number} files, {sum(outcomes.values())} readings: {counts}; {len(failures)} files broke a rule")
    for path, edit, bad in failures:
        print(f"\n{path} ({edit})")
        for reader, outcome in bad.items():
            print(f"  {reader}: {outcome}")
    sys.exit(bool(failures))


if __name__ == "__main__":
    main()
