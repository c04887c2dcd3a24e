"""Odd CSV files: the reader of small files and that of large ones say the same.

    python tests/fuzz_csv.py --seed 0 --files 2400

Each file is read twice: as it is, and with as many right rows after its own as make it
larger than what Python reads by itself. The columns of its own rows, or the error, must
be the same, in ``load`` and in ``open`` with bad rows dropped. What differs is printed
and the exit code is 1. The same seed makes the same files.
"""

import argparse
import re
import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np

import oee_tabular as oee

NUMBERS = ["0", "1", "2", "3", "+1", "-0", "00", "01", "1.0", "1e0", "1E0", "2.", ".0"]
NUMBERS += [" 1 ", "\t2", "1e-400", "0e9", "-1", "1.5", "1e400", "9" * 25, "inf"]
NUMBERS += ["0x1", "1_0", "1,0", "٣", "1 2", "1d0", "nan", "+nan", "9007199254740993"]
FLAGS = ["True", "False", "TRUE", "false", "t", "F", "0", "1", "1.0", "yes", "2", "T "]
MISSING = [
    "",
    "NA",
    "NaN",
    "NULL",
    "\\N",
    "None",
    "null",
    "N/A",
    "#N/A",
    " ",
    "na ",
    ".",
]
EPISODES = ["7", "007", "1e1", "10", "ab12", "12ab", "7.0", "6.5", "2020-01-01", " 7"]
EPISODES += ["-3", "9" * 25, "run 1", "é", "e\u0301", "True", "inf"]
NAMES = ["hall", "dock", "NA", "true", "7", "(0, 1)", "é", "e\u0301", " hall", "state"]
QUOTES = ['"', '""', '"a', 'a"', '"a"b', '"1"', '" 1"', "'1'", '"a""b"', '6" inch']
LABELS = ["state", "action", "next_state", "reward", "terminated", "episode"]
LABELS += ["timestep", "behavior_probability", "truncated", "note"]
WELL = {
    "reward": ["0", "1", "-1.5", "2e3", "0.1"],
    "terminated": ["True", "False", "0", "1"],
    "truncated": ["False", "0"],
    "episode": ["a", "b", "3"],
    "timestep": ["0", "1"],
    "behavior_probability": ["0.5", "1", "0"],
    "note": ["", "x", "6 inch"],
}
ODD = {
    "reward": NUMBERS + MISSING,
    "terminated": NUMBERS[:20] + FLAGS + MISSING,
    "truncated": NUMBERS[:20] + FLAGS + MISSING,
    "episode": EPISODES + MISSING,
    "timestep": NUMBERS + MISSING,
    "behavior_probability": NUMBERS + MISSING + FLAGS[:2],
    "note": [*QUOTES, "\x00", "a" * 200_000],
}
SIZE = 2**21  # of a file that Python does not read by itself


def pick(rng, things):
    """Return one of some things."""
    return things[rng.integers(len(things))]


def odd_rows(rng, labels):
    """Return some rows of fields, most of them right, and whether states are names."""
    is_named = bool(rng.random() < 0.2)
    well = WELL | {label: ["hall", "dock"] for label in LABELS[:3]}
    if not is_named:
        well |= {label: ["0", "1", "2"] for label in LABELS[:3]}
    rows = [
        [pick(rng, well[label]) for label in labels] for _ in range(rng.integers(1, 9))
    ]
    odd = ODD | dict.fromkeys(LABELS[:3], NUMBERS + NAMES + MISSING)
    for _ in range(rng.integers(0, 5)):
        k = rng.integers(len(labels))
        pick(rng, rows)[k] = pick(rng, odd[labels[k]])
    return rows, is_named


def odd_lines(rng):
    """Return the labels, the lines and the sound lines that may follow them."""
    others = [label for label in LABELS[3:] if rng.random() < 0.4]
    if "timestep" in others and "episode" in others:
        others.remove("timestep")
    labels = [str(label) for label in rng.permutation(LABELS[:3] + others)]
    rows, is_named = odd_rows(rng, labels)
    lines = [",".join(quoted(rng, row)) for row in rows]
    for _ in range(rng.integers(0, 3)):
        place = rng.integers(len(lines) + 1)
        kind = rng.integers(9)
        if kind == 0:
            lines.insert(place, "")
        elif kind == 1:
            lines.insert(place, ",".join(labels))
        elif kind == 2:
            lines.insert(place, ",".join(f'"{label}"' for label in labels))
        elif kind == 3:
            lines.insert(place, pick(rng, ["  ", "\t", "#", '"', ","]))
        elif kind == 4 and lines:
            k = min(place, len(lines) - 1)
            lines[k] += pick(rng, [",", ",1", '"', " ", "\r", "\x0b"])
        elif kind == 5 and lines:
            k = min(place, len(lines) - 1)
            lines[k] = lines[k].rpartition(",")[0]
        elif kind == 6:
            fields = pick(rng, rows).copy()
            fields[rng.integers(len(fields))] = pick(rng, QUOTES)
            lines.insert(place, ",".join(fields))
    after = dict.fromkeys(labels, "1") | {"episode": "end", "terminated": "0"}
    if is_named:
        after |= dict.fromkeys(LABELS[:3], "hall")
    else:
        after["action"] = " " * 90 + "1"  # so that few rows make a large file
    after |= {"truncated": "0", "note": "x"}
    return labels, lines, ",".join(after[label] for label in labels)


N_AFTER = 12  # sound rows in the small file, most of whose values are thus sound


def quoted(rng, row):
    """Return fields, those with a comma in quotes, and some others as well."""
    return [
        f'"{field}"'
        if "," in field or (field.isalnum() and rng.random() < 0.05)
        else field
        for field in row
    ]


def texts(rng):
    """Return a small file and the same with more rows, as bytes, and its own rows."""
    labels, lines, after = odd_lines(rng)
    end = pick(rng, ["\n", "\n", "\n", "\r\n", "\r"])
    code = pick(rng, ["utf-8"] * 6 + ["utf-8-sig", "utf-16"])
    first = pick(rng, ["", "", "", end])
    head = first + end.join([",".join(labels), *lines]) + end
    small = head + end.join([after] * N_AFTER) + pick(rng, ["", end])
    large = head + end.join([after] * (SIZE // len(after) + 2)) + end
    data, more = small.encode(code), large.encode(code)
    if rng.random() < 0.05:  # a byte that UTF-8 does not have ends the own rows
        k = len(head.encode(code)) - 1
        data, more = (x[:k] + b"\xff" + x[k + 1 :] for x in (data, more))
    return data, more, len(lines)


def outcome(read, path, n):
    """Return what a reader says of a file, without its path and the rows after."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return read(path, n)
    except ValueError as error:
        return words(error, path)


def words(text, path):
    """Return an error without its path and numbers of rows."""
    text = str(text).replace(str(path), "FILE")
    return re.sub(r"(\(|; )\d+ (other|of the column|such).*", "", text)


def loaded(path, n):
    """Return the first n rows of a log's columns."""
    columns = oee.Transitions.load(path).columns()
    return {label: shown(column[:n]) for label, column in columns.items()}


def shown(column):
    """Return a column as text, in which zero has no sign."""
    return re.sub(r"-0\.0(?=[,\]])", "0.0", repr(column.tolist()))


def is_same(one, other):
    """Return whether two outcomes are the same, or errors about one broken file.

    A file that is not in UTF-8 and has a field that is too long may be told either.
    """
    broken = "must be a CSV table with a header"
    texts = isinstance(one, str) and isinstance(other, str)
    return one == other or (texts and broken in one and broken in other)


def counted(path, n):
    """Return what was left out of counts, and why, and the counts of the first rows."""
    counts = oee.Transitions.open(path, bad_rows="drop")
    told = counts.recording
    reasons = [words(reason, path) for reason in told.reasons]
    is_after = (counts.state == 1) & (counts.action == 1) & (counts.next_state == 1)
    rest = {label: column[~is_after] for label, column in counts.columns().items()}
    sums = {label: shown(column) for label, column in rest.items()}
    return told.dropped, told.episodes, told.broken, reasons, sums


def compare(seed, number, folder, readers=(loaded, counted)):
    """Read so many files of a seed in both ways; return what differs.

    Each of the ``readers`` reads every file.
    """
    rng = np.random.default_rng(seed)
    small, large = Path(folder) / "a.csv", Path(folder) / "b.csv"
    differ = []
    for k in range(number):
        data, more, n = texts(rng)
        small.write_bytes(data)
        large.write_bytes(more)
        # without a simulator counts take no names, and leave all other rows out
        for read in readers[: 1 + (b"hall,hall" not in data)]:
            one, other = outcome(read, small, n), outcome(read, large, n)
            if not is_same(one, other):
                differ.append((k, read.__name__, data[:1500], one, other))
                print(f"file {k}, {read.__name__}: {data[:1500]!r}")
                print(f"  small: {one}\n  large: {other}\n", flush=True)
    return differ


def main():
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--files", type=int, default=2400)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        differ = compare(given.seed, given.files, folder)
    print(f"{given.files} files; in {len(differ)} readings the two readers differ")
    sys.exit(bool(differ))


if __name__ == "__main__":
    main()
