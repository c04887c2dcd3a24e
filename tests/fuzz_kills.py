"""Kill commands at random moments, and look at what is left.

    python tests/fuzz_kills.py --seed 0 --kills 30

Every round runs a command that writes into a folder of its own, and ends it by SIGKILL,
SIGTERM or SIGINT at a random moment of its time, or at a random moment after the first
change of the folder. The files must be whole: as before, or as the command writes them.
Then the command runs again, with ``--overwrite`` where its file is there: it must end
with 0, and leave what a command leaves that nobody killed.

What is wrong is printed with the number of its round, and the exit code is 1. The same
seed makes the same rounds, but for the speed of the machine.
"""

import argparse
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

GRID = "gridworld:6,slip=.3"
# a command, and files whose bytes differ from run to run: they have times
COMMANDS = {
    "evaluate": f"evaluate --simulator {GRID} --log log.csv --output out",
    "page": (
        f"evaluate --simulator {GRID} --log log.csv --estimators oee --report page.html"
    ),
    "bench": (
        "bench --estimators oee --families machine,inventory20 --sizes 1,3 --seeds 2 --jobs 2"
        " --output out"
    ),
    "reproduce": "reproduce lambda_n --smoke --seeds 2 --jobs 2 --output out",
    "counts": f"counts log.csv --simulator {GRID} --output c.npz",
    "sample": f"sample {GRID} --transitions 20000 --output l.parquet",
    "sample csv": f"sample {GRID} --transitions 20000 --output l.csv.gz",
    "plan": f"plan --simulator {GRID} --log log.csv --transitions 99 --output n.npy",
    "export": f"export {GRID} --output m.npz",
    "policy": f"policy {GRID} optimal --output p.npy",
}
TIMED = ("out/cells.jsonl", "out/table.csv", "out/cells.csv", "out/settings.json")
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
WAIT_SECONDS = 600.0
INTERRUPTED = 130


def words_of(line):
    """The words of a process that is the command."""
    return [sys.executable, "-m", "oee_tabular", *line.split()]


def prepare(folder):
    """Write the log that the commands read."""
    line = f"sample {GRID} --transitions 3000 --seed 1 --output log.csv"
    subprocess.run(words_of(line), cwd=folder, check=True, capture_output=True)


def contents(folder, *, with_times=True):
    """File -> its bytes."""
    return {
        name: path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
        and (name := path.relative_to(folder).as_posix())
        and (with_times or (name not in TIMED and not name.startswith("out/league")))
    }


def changed_at(folder):
    """The newest change of any folder below this one."""
    return max(path.stat().st_mtime_ns for path in (folder, *folder.rglob("*")))


def kill(line, folder, blow, share, seconds, *, is_late, draw):
    """Start the command, end it at its moment; its exit code, None if it was over."""
    before = changed_at(folder)
    process = subprocess.Popen(
        words_of(line),
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        # a background job of a shell ignores Ctrl-C, and so do its children
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    start = time.monotonic()
    if is_late:
        while process.poll() is None and changed_at(folder) == before:
            time.sleep(0.0005)
        time.sleep(draw.random() ** 3 * 0.1)
    else:
        time.sleep(max(0.0, share * seconds - (time.monotonic() - start)))
    is_over = process.poll() is not None
    process.send_signal(blow)
    told = process.communicate(timeout=WAIT_SECONDS)[1].decode()
    return None if is_over else process.returncode, told


def half_written(found, old, whole):
    """The names of files that are neither as before nor as the command writes them."""
    wrong = []
    for name, data in found.items():
        is_hidden = Path(name).name.startswith(".")
        # finished cells are kept, and what is made of the clock differs
        is_timed = name.endswith(("cells.jsonl", "settings.json")) or name in TIMED
        is_timed |= name.startswith("out/league") or name.endswith(".png")
        if not is_hidden and not is_timed and data not in (old.get(name), whole[name]):
            wrong.append(name)
    return wrong


def fuzz(seed, kills, folder):
    """Kill so many commands; return (number that were hit, what was wrong)."""
    draw = random.Random(seed)
    names = list(COMMANDS)
    seconds = {}
    whole = {}
    for name, line in COMMANDS.items():
        place = folder / f"whole {name}"
        place.mkdir()
        prepare(place)
        for _ in range(2):  # what is compiled is kept for the second time
            start = time.monotonic()
            again = f"{line} --overwrite" if seconds.get(name) else line
            subprocess.run(words_of(again), cwd=place, check=True, capture_output=True)
            seconds[name] = time.monotonic() - start
        whole[name] = contents(place)
    n_hit = 0
    wrong = []
    for k in range(kills):
        name = names[k % len(names)]
        place = folder / f"{k}"
        place.mkdir()
        prepare(place)
        line = COMMANDS[name]
        is_second = draw.random() < 0.5  # over the files of another run
        if is_second:
            subprocess.run(words_of(line), cwd=place, check=True, capture_output=True)
            line += " --overwrite"
        blow = draw.choice(SIGNALS)
        old = contents(place)
        is_late = draw.random() < 0.6
        code, told = kill(
            line, place, blow, draw.random(), seconds[name], is_late=is_late, draw=draw
        )
        at = f"round {k}: {name}, {blow.name}, {'late' if is_late else 'any time'}"
        if code is not None:
            n_hit += 1
            expected = INTERRUPTED if blow == signal.SIGINT else -blow
            # a command that was nearly over may end as it would have, or by the signal
            if code not in (0, expected, -blow):
                wrong.append(f"{at}: exit code {code}: {told[-300:]}")
            # before the package is imported, Ctrl-C is Python's own
            if "Traceback" in told and "oee_tabular" in told:
                wrong.append(f"{at}: a traceback: {told[-300:]}")
        found = contents(place)
        wrong += [f"{at}: half: {one}" for one in half_written(found, old, whole[name])]
        parts = [one for one in found if Path(one).name.startswith(".")]
        again = line
        if "--overwrite" not in line and name not in ("evaluate", "bench", "reproduce"):
            again += " --overwrite" if len(found) - len(parts) > 1 else ""
        done = subprocess.run(
            words_of(again), cwd=place, capture_output=True, text=True, check=False
        )
        if done.returncode:
            wrong.append(
                f"{at}: then exit code {done.returncode}: {done.stderr[-300:]}"
            )
        left = contents(place)
        if set(left) != set(whole[name]):
            wrong.append(f"{at}: left {sorted(set(left) ^ set(whole[name]))}")
        differing = [
            one
            for one, data in contents(place, with_times=False).items()
            if whole[name].get(one) != data
            and not one.endswith(("jsonl", ".json"))
            and not (name == "bench" and one.endswith(".png"))
        ]
        wrong += [f"{at}: other bytes in {one}" for one in differing]
        print(f"{at}: code {code}, {len(parts)} hidden files: {parts}", flush=True)
    return n_hit, wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kills", type=int, default=30)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        n_hit, wrong = fuzz(given.seed, given.kills, Path(folder))
    print(f"{n_hit} of {given.kills} hit, {len(wrong)} wrong")
    print("\n".join(wrong))
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
