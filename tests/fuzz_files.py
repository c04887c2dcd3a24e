"""Damaged files: byte-flipped, cut and edited npz, npy, CSV and parquet files of logs,
counts, simulators and policies.

    python tests/fuzz_files.py --seed 0 --files 20000

Every file is read in a child process, which may take 10 s for it. A reader gives
something finite (nan where a reward is missing) or raises ValueError,
FileNotFoundError, or MemoryError with the size that is needed, in a message that names
the file. An npz or a parquet file of our own,
which carries a digest, gives what was saved or nothing. Anything else is printed and
the exit code is 1. The same seed makes the same files.
"""

import argparse
import collections
import contextlib
import hashlib
import importlib.util
import io
import json
import re
import struct
import sys
import tarfile
import tempfile
import time
import traceback
import warnings
import zipfile
from pathlib import Path

import fuzz_csv
import numpy as np
from fuzz_child import START, Child

HOSTILE = [
    0,
    1,
    -1,
    2,
    3,
    5,
    7,
    100,
    0.25,
    0.5,
    -0.5,
    1e-320,
    1e160,
    1e300,
    -1e300,
    np.nan,
    np.inf,
    -np.inf,
    2**31,
    2**53 + 1,
    2**62,
    2**63 - 1,
    -(2**63),
]
FIELDS = [
    "",
    "0",
    "1",
    "-1",
    "1.0",
    "1.5",
    "1e3",
    "nan",
    "inf",
    "-inf",
    "1e400",
    "9" * 30,
    "True",
    "no",
    '"',
    '"0,1"',
    "'",
    "=1+1",
    "\x00",
    "0x10",
    "1_000",
    "٣",
    "1;2",
    "\t",
    "  2",
    "NA",
    "None",
    "1970-01-01",
    "1/3",
    "é",
    "\ud7ff",
    "a" * 200_000,
]
DTYPES = [
    "f4",
    "f8",
    "f2",
    "i1",
    "i8",
    "u8",
    "?",
    "c16",
    "U4",
    "S3",
    "M8[s]",
    "m8[D]",
    "O",
    "V8",
    "i4,f8",
    ">f8",
    ">i8",
    "f16",
]
SHAPES = [
    (),
    (0,),
    (1,),
    (2, 1),
    (1, 1),
    (0, 3),
    (3, 0),
    (2, 2, 2),
    (4, 4),
    (10**9,),
    (10**18,),
    (10**30,),
    (-1,),
    (2**31, 2**31),
    (2_000_000_000,),
    ("a",),
    (1.5,),
    (True,),
]


# ---- whole files to begin with


def pick(rng, things):
    return things[rng.integers(len(things))]


def originals(folder):
    """Bytes of sound files: (ending, what it is) -> bytes."""
    import oee_tabular as oee

    grid = oee.tasks.gridworld(3, 0.3)
    log = oee.sample_episodes(grid, oee.uniform_policy(grid), 4, 12, seed=0)
    plain = oee.FiniteMDP(grid.transitions, grid.rewards, grid.initial, 0.9)
    rng = np.random.default_rng(0)
    states = rng.normal(size=(20, 2))
    continuous = oee.ContinuousTransitions(
        states, rng.integers(0, 2, 20), states + 0.1, rng.normal(size=20)
    )
    found = {}
    things = [
        (log, "log", (".npz", ".csv", ".parquet")),
        (continuous, "states", (".npz", ".csv", ".parquet")),
    ]
    for thing, kind, endings in [
        *things,
        (grid, "simulator", (".npz",)),
        (plain, "simulator2", (".npz",)),
    ]:
        for ending in endings:
            path = folder / f"{kind}{ending}"
            thing.save(path)
            found[ending, kind] = path.read_bytes()
    oee.Transitions.open(folder / "log.npz").save(folder / "counts.npz")
    found[".npz", "counts"] = (folder / "counts.npz").read_bytes()
    policy = oee.uniform_policy(grid)
    found[".npy", "policy"] = _written(np.save, policy)
    found[".npz", "policy"] = _written(
        lambda handle, array: np.savez(handle, policy=array), policy
    )
    found[".csv", "trials"] = b"policy,success,weight\na,1,1\na,0,2\nb,true,.5\n"
    task = {"successes": [True, False, True], "sum_rewards": [1.0, 0.0, 2.5]}
    info = {"per_task": [{"task_group": "g", "task_id": 0, "metrics": task}]}
    found[".json", "trials"] = json.dumps(info).encode()
    found[".parquet", "frames"] = _frames()
    if importlib.util.find_spec("umbi"):
        plain.save(folder / "simulator.umb")
        found[".umb", "simulator"] = (folder / "simulator.umb").read_bytes()
    return found


def _frames():
    """Frames of two episodes, as LeRobot writes them."""
    import pyarrow as pa
    from pyarrow import parquet

    state = np.random.default_rng(0).normal(size=(12, 2))
    table = pa.table(
        {
            "observation.state": pa.array(state.tolist(), pa.list_(pa.float32(), 2)),
            "action": pa.array([[float(k % 3)] for k in range(12)]),
            "frame_index": pa.array([*range(6), *range(6)]),
            "episode_index": pa.array([0] * 6 + [1] * 6),
            "next.reward": pa.array([0.5] * 12),
            "next.done": pa.array([False] * 5 + [True] + [False] * 6),
        }
    )
    return _written(lambda handle: parquet.write_table(table, handle))


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
    return data[: rng.integers(0, 9)] + rng.bytes(int(rng.integers(0, 200)))


def mixed(data, rng):
    """A CSV of odd lines, as fuzz_csv makes them."""
    return fuzz_csv.texts(rng)[0]


def packed(arrays, rng):
    """An npz of arrays, or of bytes that stand for one, with the habits of other
    programs.
    """
    buffer = io.BytesIO()
    method = pick(rng, [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA])
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, array in arrays.items():
            archive.writestr(
                f"{name}.npy",
                array if isinstance(array, bytes) else _written(np.save, array),
            )
    return buffer.getvalue()


def forged(array, rng):
    """The npy of an array with another header."""
    shape = pick(rng, SHAPES) if rng.random() < 0.7 else array.shape
    descr = pick(rng, DTYPES) if rng.random() < 0.5 else array.dtype.str
    words = [
        repr(
            {"descr": descr, "fortran_order": bool(rng.random() < 0.3), "shape": shape}
        )
    ] * 4
    words += [
        pick(
            rng,
            [
                "(" * 3000,
                "-" * 9000 + "1",
                "{'a': 1}",
                "{",
                "\x00",
                "'\\d'",
                "{'shape': (1L,)}",
                "9" * 5000,
                "",
            ],
        )
    ]
    header = pick(rng, words).encode()
    version = bytes([pick(rng, [1, 1, 1, 2, 3, 0, 9]), 0])
    size = struct.pack("<H" if version[0] == 1 else "<I", len(header) + 1)
    return b"\x93NUMPY" + version + size + header + b"\n" + array.tobytes()


def edited_array(array, rng):
    """The same array with one thing changed."""
    kind = rng.integers(6)
    flat = array.reshape(-1)
    with (
        np.errstate(all="ignore"),
        contextlib.suppress(OverflowError, RuntimeError, TypeError, ValueError),
    ):
        if kind == 0 and array.size:
            changed = (
                array.astype(float)
                if rng.random() < 0.5 and array.dtype.kind in "biuf"
                else array.copy()
            )
            changed.flat[rng.integers(changed.size)] = pick(rng, HOSTILE)
            return changed
        if kind == 1:
            return array.astype(pick(rng, [name for name in DTYPES if "," not in name]))
    return pick(
        rng,
        [
            flat[: rng.integers(array.size + 1)],
            np.concatenate([flat, flat]),
            rng.permutation(flat).reshape(array.shape),
            array[None],
            np.array(None),
            np.array(["0.25"] * 3),
            np.zeros((0, 3)),
            np.array(np.nan),
            array.astype("O"),
        ],
    )


def edited_npz(data, rng):
    with np.load(io.BytesIO(data)) as stored:
        arrays = dict(stored)
    for _ in range(rng.integers(1, 3)):
        name, other = (str(name) for name in rng.choice(list(arrays), 2))
        kind = rng.integers(8)
        is_array = isinstance(arrays[name], np.ndarray)
        if kind == 0 and len(arrays) > 1:
            del arrays[name]
        elif kind == 1:
            arrays[
                pick(
                    rng,
                    [
                        "more",
                        "policy",
                        "layout",
                        "../x",
                        "behavior_probability",
                        "reward",
                    ],
                )
            ] = arrays[name]
        elif kind == 2:
            arrays[name], arrays[other] = arrays[other], arrays[name]
        elif kind == 3:
            arrays[name + pick(rng, ["_", "2", "x"])] = arrays.pop(name)
        elif is_array:
            arrays[name] = (forged if kind == 4 else edited_array)(arrays[name], rng)
    return packed(arrays, rng)


def resealed(data, rng):
    """An npz of ours with one array forged, and a digest that fits."""
    from kernels.files import DIGEST, digest

    with np.load(io.BytesIO(data)) as stored:
        arrays = {name: array for name, array in stored.items() if name != DIGEST}
    name = str(rng.choice(list(arrays)))
    for _ in range(20):
        array = edited_array(arrays[name], rng)
        if not array.dtype.hasobject:
            arrays[name] = array
            break
    return packed(arrays | {DIGEST: np.array(digest(arrays))}, rng)


def edited_zip(data, rng):
    """Fields of the zip's own directory: sizes, methods, flags."""
    changed = bytearray(data)
    at = data.rfind(b"PK\x01\x02") if rng.random() < 0.5 else data.find(b"PK\x01\x02")
    offset, width = pick(
        rng, [(8, 2), (10, 2), (16, 4), (20, 4), (24, 4), (28, 2), (42, 4)]
    )
    value = pick(rng, [0, 1, 8, 9, 12, 14, 93, 99, 0xFFFF, 2**31, 2**32 - 1]) & (
        256**width - 1
    )
    changed[at + offset : at + offset + width] = value.to_bytes(width, "little")
    return bytes(changed)


def bomb(data, rng):
    """A megabyte or so that says that it is many gigabytes."""
    form = {
        "descr": "<f8",
        "fortran_order": False,
        "shape": (pick(rng, [2_000_000_000, 10**17]),),
    }
    header = _written(np.lib.format.write_array_header_1_0, form)
    kind = np.array(pick(rng, ["transitions", "finite_mdp"]))
    return packed({"oee_tabular_kind": kind, "state": header + bytes(10**6)}, rng)


def edited_npy(data, rng):
    array = np.load(io.BytesIO(data))
    return (
        forged(array, rng)
        if rng.random() < 0.5
        else _written(np.save, edited_array(array, rng))
    )


def edited_csv(data, rng):
    lines = [line.split(",") for line in data.decode().splitlines()]
    for _ in range(rng.integers(1, 4)):
        row = pick(rng, lines)
        kind = rng.integers(7) if row and lines[0] else 1
        if kind == 0:
            row[rng.integers(len(row))] = pick(rng, FIELDS)
        elif kind == 1:
            row.append(pick(rng, FIELDS))
        elif kind == 2 and len(row) > 1:
            del row[rng.integers(len(row))]
        elif kind == 3:
            lines[0] = [
                label.upper() if rng.random() < 0.5 else label for label in lines[0]
            ]
        elif kind == 4:
            lines.insert(rng.integers(len(lines) + 1), [])
        elif kind == 5:
            k = rng.integers(len(lines[0]))
            lines[1:] = [
                [*line[:k], pick(rng, FIELDS[:12]), *line[k + 1 :]]
                for line in lines[1:]
            ]
        else:
            lines = [line + [f"x{k}" for k in range(2000)] for line in lines]
    comma = pick(rng, [",", ",", ",", ",", ";", "\t", "|", " "])
    end = pick(rng, ["\n", "\n", "\r\n", "\r"])
    text = end.join(comma.join(line) for line in lines)
    return text.encode(
        pick(rng, ["utf-8", "utf-8", "utf-8", "utf-8-sig", "utf-16"]), errors="replace"
    )


def edited_parquet(data, rng):
    import pyarrow as pa
    from pyarrow import parquet

    saved = parquet.read_table(io.BytesIO(data))
    table = saved.to_pydict()
    name, other = (str(name) for name in rng.choice(list(table), 2))
    date = np.datetime64("2020-01-01", "s")
    number = pick(rng, HOSTILE)
    value = pick(
        rng,
        [number, None, "0.25", b"x", [1, 2], {"a": 1}, True, date, 10**30, "a" * 1000],
    )
    kind = rng.integers(5)
    column = table[name]
    if kind == 4:
        table[name], table[other] = table[other], table[name]
    elif kind < 2:
        table[name] = [value] * len(column) if kind == 0 else [*column[:-1], value]
    else:
        column = table.pop(name)
        table |= {str(value)[:50]: column} if kind == 3 else {}
    arrays = {}
    for label, values in table.items():
        try:
            arrays[label] = pa.array(values)
        except (pa.ArrowException, OverflowError, TypeError, ValueError):
            arrays[label] = pa.array([str(item) for item in values])
    if rng.random() < 0.2:
        plain = {
            k: v
            for k, v in arrays.items()
            if not (pa.types.is_nested(v.type) or pa.types.is_null(v.type))
        }
        arrays = {label: array.dictionary_encode() for label, array in plain.items()}
    made = pa.table(arrays)
    if rng.random() < 0.1:
        made = pa.Table.from_arrays(made.columns, names=["state"] * made.num_columns)
    if rng.random() < 0.5:  # the digest stays
        made = made.replace_schema_metadata(saved.schema.metadata)
    codec = pick(rng, ["none", "snappy", "gzip", "zstd"])
    return _written(lambda handle: parquet.write_table(made, handle, compression=codec))


def edited_json(data, rng):
    """A JSON text with some of its words replaced."""
    text = data.decode()
    words = ["null", "true", "1", "[]", "{}", '"x"', "NaN", "-1e999", "[[1]]", "1.5"]
    words.append("9" * 400)
    for _ in range(rng.integers(1, 4)):
        old = pick(rng, re.findall(r'"[^"]*"|[\w.]+|\[[^][]*\]', text) or [" "])
        text = text.replace(old, pick(rng, words), 1)
    return text.encode()


def edited_umb(data, rng):
    """An archive of a model with one of its members changed, lost or named anew."""
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        members = {
            each.name: archive.extractfile(each).read()
            for each in archive.getmembers()
            if each.isfile()
        }
    name = pick(rng, list(members))
    content = members.pop(name)
    if rng.random() < 0.8:
        edit = pick(rng, [flipped, cut, spliced, noise, lambda data, _: data * 2])
        content = edited_json(content, rng) if name.endswith("json") else content
        members[name] = content if name.endswith("json") else edit(content, rng)
    elif rng.random() < 0.5:
        members[f"{name}x"] = content
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w:gz") as archive:
        for name, content in members.items():
            info = tarfile.TarInfo(name)
            info.size = len(content)
            archive.addfile(info, io.BytesIO(content))
    return buffer.getvalue()


ANY = (flipped, flipped, flipped, cut, spliced, noise)
EDITS = {
    ".npz": (*ANY, *[edited_npz] * 8, *[resealed] * 4, edited_zip, edited_zip, bomb),
    ".npy": (*ANY, *[edited_npy] * 6),
    ".csv": (*ANY, *[edited_csv] * 6, *[mixed] * 4),
    ".parquet": (*ANY, *[edited_parquet] * 6),
    ".json": (*ANY, *[edited_json] * 6),
    ".umb": (*ANY, *[edited_umb] * 12),
}


# ---- the child: reads what it is told to


def read_all(pipe):
    """Read the files that are asked for: {reader: (outcome, content)}."""
    import duckdb  # noqa: F401, what is imported before the first answer takes no file's time
    from pyarrow import parquet  # noqa: F401

    warnings.simplefilter("ignore")
    readers = _readers()
    while True:
        name, kind = pipe.recv()
        pipe.send({read.__name__: _outcome(read, name) for read in readers[kind]})


def _outcome(read, name):
    try:
        content = read(name)
        return (
            "finite" if content is not None else f"not finite: {read.__name__}"
        ), content
    except (ValueError, FileNotFoundError) as error:
        text = str(error)
        if any(ord(c) < 32 and c not in "\n\t" for c in text) or len(text) > 1500:
            return f"not printable: {text!a:.300}", ""
        return (
            "refused"
            if Path(name).name in text or name in text
            else f"nameless: {error}"
        ), ""
    except MemoryError as error:
        return ("too large" if "needs" in str(error) else f"no size: {error}"), ""
    except Exception:
        return "raised: " + traceback.format_exc()[-1500:], ""


def _content(columns):
    """A digest of columns by name, or None where a number is not finite."""
    columns = {
        name: np.asarray(column)
        for name, column in columns.items()
        if column is not None
    }
    for name, column in columns.items():
        if column.dtype.kind != "f":
            continue
        # a reward that is missing is nan
        is_reward = name in ("reward", "reward_min", "reward_max")
        missing = np.isnan(column) & is_reward
        if not (np.isfinite(column) | missing).all():
            return None
    return hashlib.sha256(
        repr([(name, columns[name].tolist()) for name in sorted(columns)]).encode()
    ).hexdigest()


def _readers():
    import oee_tabular as oee
    from oee_tabular.cli.files import describe_files
    from oee_tabular.mdp import check_policy
    from oee_tabular.mdp.policies import read_policy_array

    grid = oee.tasks.gridworld(3, 0.3)

    def log(name):
        loaded = oee.Transitions.load(name)
        # it reads well, but may be no log of this grid
        with contextlib.suppress(ValueError):
            oee.Problem(grid, loaded)
        return _content(loaded.columns())

    def counted(name):
        return _content(oee.Transitions.open(name).columns())

    def counts(name):
        loaded = oee.TransitionCounts.load(name)
        return _content(
            {**loaded.columns(), "recording": np.array(repr(loaded.recording))}
        )

    def states(name):
        return _content(oee.ContinuousTransitions.load(name).columns())

    def simulator(name):
        loaded = oee.FiniteMDP.load(name)
        value = oee.policy_value(loaded, oee.uniform_policy(loaded), horizon=20)
        return _content({**loaded.arrays(), "value": value})

    def policy(name):
        return _content(
            {
                "policy": check_policy(
                    read_policy_array(name, "policy"), grid, name=f"policy {name!r}"
                )
            }
        )

    def trials(name):
        loaded = oee.Trials.load(name)
        return _content({"returns": loaded.returns, "weight": loaded.weight})

    def info(name):
        describe_files([name])
        return ""

    readers = {
        "log": (log, counted),
        "counts": (counts, counted),
        "states": (states,),
        "policy": (policy,),
    }
    readers |= {"simulator": (simulator,), "simulator2": (simulator,)}
    made = {kind: (*reads, info) for kind, reads in readers.items()}
    return made | {"frames": (states, info), "trials": (trials,)}


# ---- the parent


def fuzz(seed, seconds, folder, most=10**9, limit=10.0):
    """(outcomes, failures) of as many files as the time allows, the child's start not
    counted, and at most so many. ``limit``: seconds for a file; None waits.
    """
    folder = Path(folder)
    sound = originals(folder)
    rng = np.random.default_rng(seed)
    child = Child(limit, read_all)
    outcomes = collections.Counter()
    failures = []
    intact = {}
    number = 0

    def read(path, kind):
        answer = child.ask((str(path), kind))
        return {"process": (answer, "")} if isinstance(answer, str) else answer

    try:
        for (ending, kind), data in sound.items():  # what is sound is read
            path = folder / f"sound{ending}"
            path.write_bytes(data)
            # the first of a kind may compile
            child.wait = None if limit is None else START
            intact[ending, kind] = read(path, kind)
            if any(outcome != "finite" for outcome, _ in intact[ending, kind].values()):
                failures.append((str(path), "sound", intact[ending, kind]))
        end = time.monotonic() + seconds
        while time.monotonic() < end and number < most:
            ending, kind = list(sound)[number % len(sound)]
            edit = pick(rng, EDITS[ending])
            path = folder / f"broken{number}{ending}"
            path.write_bytes(data := edit(sound[ending, kind], rng))
            found = read(path, kind)
            if is_ours(ending, kind, edit, data):
                found = {
                    name: _compared(one, intact[ending, kind].get(name))
                    for name, one in found.items()
                }
            outcomes.update(outcome.partition(":")[0] for outcome, _ in found.values())
            bad = {
                name: one
                for name, (one, _) in found.items()
                if one not in ("finite", "refused", "too large")
            }
            if bad:
                failures.append((str(path), f"{kind} {edit.__name__}", bad))
            else:
                path.unlink()
            number += 1
    finally:
        child.end()
    return number, outcomes, failures


def is_ours(ending, kind, edit, data):
    """Whether a file still says that it is one of ours, or is one whose bytes were
    damaged; its content is then held to.
    """
    return kind not in ("policy", "trials", "frames") and (
        (ending == ".npz" and edit not in (bomb, resealed))
        or (ending == ".parquet" and (edit in ANY or b"oee_tabular_digest" in data))
    )


def _compared(one, intact):
    """An outcome of a file of ours: other content than was saved is a failure."""
    changed = intact is not None and one[0] == "finite" and one[1] != intact[1]
    return ("other content than was saved", one[1]) if changed else one


def main():
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--files", type=int, default=20_000)
    parser.add_argument(
        "--keep",
        type=Path,
        help="an existing folder for the files that broke something",
    )
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        number, outcomes, failures = fuzz(
            given.seed, given.seconds, given.keep or folder, given.files
        )
    counts = ", ".join(
        f"{count} {outcome}" for outcome, count in outcomes.most_common()
    )
    print(
        f"{number} files, {sum(outcomes.values())} readings: {counts}; {len(failures)}"
        " files broke a rule"
    )
    for path, edit, bad in failures:
        print(f"\n{path} ({edit})")
        for reader, outcome in bad.items():
            print(f"  {reader}: {outcome}")
    sys.exit(bool(failures))


if __name__ == "__main__":
    main()
