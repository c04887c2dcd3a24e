"""Tests of a results folder.

It may have other settings, other code, damaged and malicious files, links, or two
commands at a time.
"""

import hashlib
import json
import re

import pytest
from lab.noise import bytes_of, experiment

from oee_tabular.lab import run as running
from oee_tabular.lab.experiments.catalogue import save
from oee_tabular.lab.run import FILES, LOCK, Store, alone, code_version, run_experiment

SETTINGS = experiment().settings()


@pytest.fixture
def folder(tmp_path):
    """Return a finished run; every repaired folder must give its table again."""
    bytes_of(tmp_path / "a", SETTINGS)
    return tmp_path / "a"


# ---- settings and code


def test_other_settings_are_refused_with_the_difference(folder):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    settings = json.loads(before["settings.json"])
    digests = {
        name: hashlib.sha256(data).hexdigest()
        for name, data in before.items()
        if name not in ("settings.json", "cells.jsonl")
    }
    assert len(digests) == 6
    assert settings.pop("files") == digests
    assert settings.pop("made_by")["version"] == code_version()
    assert settings == SETTINGS.as_dict()
    other = experiment(axes={"n": (1, 2)}).settings(seed=7)
    text = (
        r"other settings: seed 0 there, 7 asked; n \[1, 2, 3\] there, \[1, 2\] asked"
        r" \(--fresh empties it"
    )
    with pytest.raises(ValueError, match=text):
        run_experiment(folder, other)
    with pytest.raises(
        ValueError, match="other settings: experiment 'noise' there, 'other' asked"
    ):
        run_experiment(folder, experiment(id="other").settings())
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert run_experiment(folder, other, fresh=True).computed == 4


DIGEST = "0123456789abcdef0123456789abcdef01234567"


def checkout(folder, kind):
    """Make a folder a git checkout, in one of the forms that git gives it."""
    git = folder / ".git"
    if kind == "none":
        return
    if kind == "worktree":
        git.write_text("gitdir: main/worktrees/a\n")
        git = folder / "main" / "worktrees" / "a"
        git.mkdir(parents=True)
        (git / "commondir").write_text("../..\n")
        shared = folder / "main"
    else:
        git.mkdir()
        shared = git
    head = DIGEST if kind == "detached" else "ref: refs/heads/fix/one"
    (git / "HEAD").write_text(f"{head}\n")
    if kind == "packed":
        (git / "packed-refs").write_text(f"# pack-refs\n{DIGEST} refs/heads/fix/one\n")
    elif kind in ("loose", "worktree"):
        (shared / "refs" / "heads" / "fix").mkdir(parents=True)
        (shared / "refs" / "heads" / "fix" / "one").write_text(f"{DIGEST}\n")
    elif kind == "damaged":
        (git / "packed-refs").write_bytes(b"\xff\xfe")


@pytest.mark.parametrize(
    ("kind", "found"),
    [
        *((kind, DIGEST) for kind in ("loose", "packed", "detached", "worktree")),
        *((kind, None) for kind in ("none", "unborn", "damaged")),
    ],
)
def test_the_commit_is_told_where_the_package_is_a_checkout(
    kind, found, tmp_path, monkeypatch
):
    """Elsewhere there is none, and nothing fails."""
    checkout(tmp_path, kind)
    monkeypatch.setattr(running, "PACKAGE", tmp_path / "oee_tabular")
    running.commit.cache_clear()
    try:
        assert running.commit() == found
    finally:
        running.commit.cache_clear()


def test_more_seeds_are_added_to_those_that_are_there(folder, tmp_path):
    more = experiment().settings(repetitions=3)
    sweep = run_experiment(folder, more)
    assert (sweep.computed, sweep.cached) == (3, 6)
    assert bytes_of(folder, more) == bytes_of(tmp_path / "b", more)
    with pytest.raises(
        ValueError, match="other settings: repetitions 3 there, 2 asked"
    ):
        Store(folder, SETTINGS)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"editor": 1}',
        '{"experiment": "noise", "repetitions": 2, "axes": 3}',
        "[" * 9999,
    ],
)
def test_a_folder_of_something_else_is_neither_used_nor_emptied(tmp_path, text):
    (tmp_path / "thesis.txt").write_text("kept")
    with pytest.raises(
        ValueError,
        match=r"must be a results folder to be emptied; it has no settings\.json",
    ):
        run_experiment(tmp_path, SETTINGS, fresh=True)
    (tmp_path / "settings.json").write_text(text)
    with pytest.raises(
        ValueError, match=r"must be the settings of a results folder; it is not"
    ):
        run_experiment(tmp_path, SETTINGS)
    with pytest.raises(
        ValueError, match=r"must hold results only to be emptied; it holds thesis\.txt"
    ):
        run_experiment(tmp_path, SETTINGS, fresh=True)
    with pytest.raises(ValueError, match="must be a folder; it is a file"):
        run_experiment(tmp_path / "thesis.txt", SETTINGS)
    assert (tmp_path / "thesis.txt").read_text() == "kept"


def test_results_of_other_code_are_computed_again_and_kept_for_its_return(tmp_path):
    old = Store(tmp_path, SETTINGS, code="0.0.0+old")
    old.open()
    old.add(SETTINGS.cells()[0], [{"name": "one", "value": -1.0}])
    sweep = run_experiment(tmp_path, SETTINGS)
    assert (sweep.computed, sweep.cached, sweep.stale) == (6, 0, 1)
    assert (sweep.table().value > 0).all()
    assert "1 of another version of the code left aside" in str(sweep)
    assert len(Store(tmp_path, SETTINGS, code="0.0.0+old").missing()) == 5
    assert re.fullmatch(r"[\d.]+\+[0-9a-f]{12}", code_version())


def test_a_changed_module_of_the_user_is_other_code(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    module = tmp_path / "changing_estimator.py"
    module.write_text("x = 1\n")
    first = code_version("changing_estimator")
    assert first == code_version("changing_estimator") != code_version()
    module.write_text("x = 2\n")
    code_version.cache_clear()
    assert code_version("changing_estimator") != first


# ---- cells.jsonl


def signed(content):
    """Return a line whose checksum is right, whatever it says."""
    text = json.dumps(content, sort_keys=True).encode()
    return json.dumps({"content": content, "sha256": hashlib.sha256(text).hexdigest()})


def change(**parts):
    """Return the line with other content, and a checksum that is right."""
    return lambda line: signed(json.loads(line)["content"] | parts)


def alter(name, value):
    """Return the line with another setting of its cell."""

    def altered(line):
        content = json.loads(line)["content"]
        (content["of"] if name in content["of"] else content["of"]["cell"])[name] = (
            value
        )
        return signed(content)

    return altered


DAMAGED = {
    "truncated": lambda line: line[: len(line) // 2],
    "no object": lambda line: "17",
    "empty object": lambda line: "{}",
    "older version": lambda line: json.dumps(
        {"key": "ab", "code": code_version(), "rows": [{"name": "one", "value": 1.0}]}
    ),
    "key of a wrong type": lambda line: json.dumps({"content": [1], "sha256": {}}),
    "another number": lambda line: re.sub(r'"value": \d', '"value": 9', line),
    "wrong checksum": lambda line: (
        line[:-3] + ("00" if line[-3:-1] != "00" else "11") + line[-1:]
    ),
    "deep": lambda line: "[" * 100_000,
    "long number": lambda line: "9" * 10_000,
    "other experiment": alter("experiment", "other"),
    "other seed": alter("seed", 3),
    "a setting more": alter("hidden", 3),
    "cell of a wrong type": alter("n", [1]),
    "repetition of a wrong type": alter("repetition", "0"),
    "no rows": change(rows=[]),
    "rows of a wrong type": change(rows={"name": "one"}),
    "row of a wrong type": change(rows=[3]),
    "nan": change(rows=[{"name": "one", "value": float("nan")}]),
    "text for a number": change(rows=[{"name": "one", "value": "1.0"}]),
    "no measure": change(rows=[{"name": "one", "size": 1.0}]),
    "no key": change(rows=[{"value": 1.0}]),
    "a list in a row": change(rows=[{"name": "one", "value": 1.0, "more": [1]}]),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_line_that_does_not_fit_is_reported_and_computed_again(folder, name):
    expected = (folder / "table.csv").read_bytes()
    cells = folder / "cells.jsonl"
    first, *rest = cells.read_text().splitlines()
    cells.write_text("\n".join([DAMAGED[name](first), *rest]) + "\n")
    sweep = run_experiment(folder, SETTINGS)
    assert (sweep.computed, sweep.cached, sweep.damaged) == (1, 5, 1)
    assert "lines of cells.jsonl that did not fit and are left out: 1" in str(sweep)
    save(sweep)
    assert (folder / "table.csv").read_bytes() == expected
    assert run_experiment(folder, SETTINGS).damaged == 0


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00binary\n\n\x80" * 50, b"\n\n"])
def test_a_file_without_a_line_that_fits(folder, content):
    expected = (folder / "table.csv").read_bytes()
    (folder / "cells.jsonl").write_bytes(content)
    with pytest.raises(
        ValueError, match="lacks 6 of 6 cells; run the experiment again"
    ):
        Store(folder, SETTINGS).table()
    save(run_experiment(folder, SETTINGS))
    assert (folder / "table.csv").read_bytes() == expected


def test_a_cell_that_is_there_twice_counts_once(folder):
    expected = (folder / "table.csv").read_bytes()
    cells = folder / "cells.jsonl"
    cells.write_text(cells.read_text() * 2)
    save(run_experiment(folder, SETTINGS))
    assert (folder / "table.csv").read_bytes() == expected
    assert len(cells.read_text().splitlines()) == 6


# ---- links and locks


@pytest.mark.parametrize("name", [*FILES, LOCK])
@pytest.mark.parametrize("kind", ["link", "dangling link", "folder"])
def test_nothing_is_written_through_what_is_no_plain_file(tmp_path, name, kind):
    precious = tmp_path / "precious"
    path = tmp_path / "r" / name
    path.parent.mkdir()
    precious.write_text("mine")
    if kind == "folder":
        path.mkdir()
    elif kind == "link":
        path.symlink_to(precious)
    else:
        path.symlink_to(tmp_path / "nowhere")
    for attempt in (
        lambda: run_experiment(path.parent, SETTINGS),
        lambda: alone(path.parent).__enter__(),
    ):
        with pytest.raises(
            ValueError,
            match=(
                rf"{re.escape(name)}' must be a plain file; it is a link or something"
                r" else"
            ),
        ):
            attempt()
    assert precious.read_text() == "mine"
    assert not (tmp_path / "nowhere").exists()


def test_a_link_that_comes_while_cells_are_computed(tmp_path):
    precious = tmp_path / "precious"
    folder = tmp_path / "r"
    precious.write_text("mine")

    def swap(cell, stream):
        (folder / "cells.jsonl").unlink()
        (folder / "cells.jsonl").symlink_to(precious)
        (folder / "table.csv").symlink_to(precious)
        return [{"name": "one", "value": 1.0}]

    with pytest.raises(OSError, match="cannot be written"):
        run_experiment(folder, experiment(swap).settings())
    store = run_experiment(tmp_path / "b", SETTINGS)
    (tmp_path / "b" / "table.csv").symlink_to(precious)
    with pytest.raises(ValueError, match="must be a plain file"):
        save(store)
    assert precious.read_text() == "mine"
