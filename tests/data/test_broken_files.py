"""Files that are broken, too large, elsewhere or written by other programs: one
sentence each, naming the file.
"""

import gzip
import io
import itertools
import os
import zipfile

import numpy as np
import pandas as pd
import pytest
from kernels.files import DIGEST, digest, read_npz
from scipy import sparse

import oee_tabular as oee

GRID = oee.tasks.gridworld(3, 0.3)
LOG = oee.sample_episodes(GRID, oee.uniform_policy(GRID), 4, 20, seed=0)


def npy(array):
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def archive(path, members, method=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", method) as file:
        for name, data in members.items():
            file.writestr(f"{name}.npy", data)
    return path


def header(shape, descr="<f8"):
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        buffer, {"descr": descr, "fortran_order": False, "shape": shape}
    )
    return buffer.getvalue()


def edited(path, **changes):
    """With a digest that fits: what a person may write, not damage."""
    arrays = {
        name: np.asarray(array)
        for name, array in (dict(np.load(path)) | changes).items()
        if name != DIGEST
    }
    np.savez(path, **arrays, **{DIGEST: digest(arrays)})
    return path


# ---- npz


@pytest.mark.parametrize(
    "text", ["{'descr': (", "(" * 3000, "-" * 9000 + "1", "{'a': '\\d'}", "[]"]
)
def test_a_header_that_is_no_header(tmp_path, text):
    written = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()
    (tmp_path / "a.npy").write_bytes(written)
    with pytest.raises(
        ValueError, match=r"a\.npy' must be an npz or npy file of plain arrays; .+"
    ):
        read_npz(tmp_path / "a.npy")


@pytest.mark.parametrize(
    "shape", [(2_000_000_000,), (10**17,), (10**30,), (3, -1), (0, 10**30)]
)
def test_declared_sizes_are_compared_with_what_is_stored(tmp_path, shape):
    """Before memory is taken: the text has both sizes."""
    archive(tmp_path / "a.npz", {"state": header(shape) + bytes(80)})
    with pytest.raises(
        ValueError, match=r"a\.npz' must be an npz or npy file of plain arrays; .+"
    ):
        read_npz(tmp_path / "a.npz")


def refuse_command(capsys, words):
    from oee_tabular.cli import main

    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    return capsys.readouterr().err


def test_missing_memory_is_reported_with_its_size(tmp_path, monkeypatch, capsys):
    path = archive(tmp_path / "a.npz", {"state": npy(np.zeros(2**18))})
    monkeypatch.setattr("oee_tabular._checks.free_memory", lambda: 2.0**20)
    with pytest.raises(
        MemoryError,
        match=r"a\.npz' needs 0\.00195 GiB of memory; 0\.000977 GiB are free",
    ):
        read_npz(path)
    assert refuse_command(capsys, ["info", str(path)]).startswith(
        "oee: not enough memory; "
    )
    pd.DataFrame({"state": np.zeros(2**18), "action": 0, "next_state": 0}).to_parquet(
        tmp_path / "a.parquet"
    )
    with pytest.raises(MemoryError, match=r"a\.parquet' needs 0\.00586 GiB"):
        oee.Transitions.load(tmp_path / "a.parquet")


def test_a_pickle_is_never_opened(tmp_path):
    np.savez(tmp_path / "a.npz", state=np.array([{}], dtype=object))
    with pytest.raises(
        ValueError, match=r"a\.npz' must be an npz or npy file of plain arrays"
    ):
        read_npz(tmp_path / "a.npz")


# ---- simulators


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        (
            {"shape": np.array([np.inf, 4.0])},
            r"shape must be two positive integers, .*; it is \[inf, 4\.0\]",
        ),
        ({"shape": np.array([9, -4])}, r"shape must be two positive integers"),
        ({"discount": np.array("0.5")}, r"discount must be an array of numbers"),
        ({"initial": np.array(["0.5"] * 9)}, r"initial must be an array of numbers"),
        (
            {"transitions_data": np.array(["1"] * 9)},
            r"transitions\.data must be real numbers",
        ),
        (
            {"transitions_indices": np.zeros(3)},
            r"transitions\.indices must be integers of one dimension",
        ),
        (
            {"transitions_indptr": np.zeros(3, dtype=int)},
            r"transitions\.indptr must have 37 entries.*; it has 3",
        ),
        # native code follows row pointers wherever they lead
        (
            {"transitions_indptr": np.arange(37)[::-1]},
            r"transitions\.indptr\[0\] must be 0; it is 36",
        ),
        (
            {"transitions_indptr": np.full(37, 999) * (np.arange(37) > 0)},
            r"transitions\.indptr\[1\] must be at most 120",
        ),
        (
            {"rewards_indptr": np.r_[0, 10**6, np.arange(35)]},
            r"rewards\.indptr\[2\] must be at least the one before",
        ),
    ],
)
def test_parts_of_a_simulator(tmp_path, changes, text):
    GRID.save(tmp_path / "s.npz")
    with pytest.raises(ValueError, match=rf"s\.npz'.*{text}"):
        oee.FiniteMDP.load(edited(tmp_path / "s.npz", **changes))


# ---- sparse matrices that were edited after they were made


def test_flags_that_no_longer_hold_are_not_believed():
    """scipy keeps what it found out about the order of the indices; who edits them
    afterwards makes that wrong.
    """
    matrix = sparse.csr_array(np.array([[0.25, 0.75], [0.5, 0.5]]))
    assert matrix.has_sorted_indices
    matrix.indices[:2] = [1, 0]
    matrix.data[:2] = [0.75, 0.25]
    mdp = oee.FiniteMDP(matrix, np.zeros(2), [1, 0], 0.5)
    np.testing.assert_array_equal(mdp.transitions.toarray(), [[0.25, 0.75], [0.5, 0.5]])
    np.testing.assert_array_equal(mdp.transitions.indices, [0, 1, 0, 1])


# ---- words that look like numbers


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_text_is_the_number_that_it_writes(tmp_path, ending):
    frame = pd.DataFrame(
        {
            "state": ["0", "3"],
            "action": [0, 0],
            "next_state": [1, 1],
            "reward": ["0.5", "much"],
        }
    )
    path = tmp_path / f"l{ending}"
    for rows in (frame[:1], frame):
        (rows.to_csv if ending == ".csv" else rows.to_parquet)(path, index=False)
        for read in (oee.Transitions.load, oee.Transitions.open):
            if len(rows) == 1:
                assert len(read(path)) == 1
            else:
                with pytest.raises(
                    ValueError,
                    match=rf"l\{ending}': reward\[1\] must be a number; it is 'much'",
                ):
                    read(path)


@pytest.mark.parametrize(
    "damage",
    [
        {b"oee_tabular_digest": b"oee_tabular_di_est"},
        {b"oee_tabular_sha256:": b"oee_*abular_sha256:"},
        {
            b"oee_tabular_digest": b"oee_tabular_di_est",
            b"oee_tabular_sha256:": b"oee_*abular_sha256:",
        },
        {
            b"oee_tabular_digest": b"oee-tabular_digest",
            b"oee_tabular_sha256:": b"oee_tabular_sha25_:",
        },
    ],
)
def test_a_parquet_file_whose_own_mark_is_damaged_is_no_other_program_s(
    damage, tmp_path
):
    path = tmp_path / "l.parquet"
    LOG.save(path)
    data = path.read_bytes()
    for old, new in damage.items():
        data = data.replace(old, new)
    path.write_bytes(data)
    with pytest.raises(ValueError, match=r"l\.parquet' must be as it was saved"):
        oee.Transitions.load(path)


# ---- tables


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        (
            "state;action;next_state\n0;0;1\n",
            (
                "state;action;next_state: its fields must be separated by commas; .*"
                " semicolons"
            ),
        ),
        (
            "state\taction\tnext_state\n0\t0\t1\n",
            "separated by commas; they are by tabs",
        ),
        (
            "from,did,to\n0,0,1\n",
            (
                r"it has from, did, to \(say which column holds each: columns=\{"
                r"'state': 'LABEL', 'action': 'LABEL', 'next_state': 'LABEL'\}, --column"
                r" state=LABEL --column action=LABEL --column next_state=LABEL\)$"
            ),
        ),
        (
            "state,action,nxt_state\n0,0,1\n",
            r"columns=\{'next_state': 'nxt_state'\}, --column next_state=nxt_state\)$",
        ),
        (
            "state,acton,nxt state\n0,0,1\n",
            (
                r"columns=\{'action': 'acton', 'next_state': 'nxt state'\}, --column"
                r" action=acton --column 'next_state=nxt state'\)$"
            ),
        ),
    ],
)
def test_what_a_table_of_another_program_must_change(tmp_path, text, hint):
    (tmp_path / "l.csv").write_text(text)
    with pytest.raises(
        ValueError,
        match=rf"l\.csv' must have the columns state, action, next_state; .*{hint}",
    ):
        oee.Transitions.load(tmp_path / "l.csv")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "state_0;next_state_0;action\n1;2;0\n",
            r"l\.csv' must have the columns state_0.*by semicolons",
        ),
        (
            "from_0,to_0,action\n1,2,0\n",
            r"l\.csv' must have the columns state_0.*--column state_0=LABEL",
        ),
        (
            "state_0,state_999999999,next_state_0,action\n1,2,3,0\n",
            "every column from state_0 to .*; state_1 is missing",
        ),
    ],
)
def test_the_same_for_continuous_states(tmp_path, text, words):
    (tmp_path / "l.csv").write_text(text)
    with pytest.raises(ValueError, match=words):
        oee.ContinuousTransitions.load(tmp_path / "l.csv")


@pytest.mark.parametrize("foreign", [5000, 100_000])
def test_foreign_columns_are_not_read(tmp_path, foreign):
    names = ["state", "action", "next_state", *(f"sensor_{k}" for k in range(foreign))]
    rows = [",".join(["0", "0", "1", *["0.5"] * foreign])] * 2
    (tmp_path / "l.csv").write_text("\n".join([",".join(names), *rows]))
    if foreign > 10_000:
        with pytest.raises(
            ValueError, match=r"l\.csv' must have at most 10000 columns; it has 100003"
        ):
            oee.Transitions.load(tmp_path / "l.csv")
    else:
        with pytest.warns(
            UserWarning, match=r"left out: sensor_0, .*, sensor_9, and 4990 more$"
        ):
            assert len(oee.Transitions.load(tmp_path / "l.csv")) == 2


def test_a_parquet_file_with_a_column_twice(tmp_path):
    import pyarrow as pa
    from pyarrow import parquet

    twice = pa.Table.from_arrays(
        [pa.array([0])] * 4, names=["state", "state", "action", "next_state"]
    )
    parquet.write_table(twice, tmp_path / "l.parquet")
    with pytest.raises(
        ValueError,
        match=r"l\.parquet' must have columns that differ; it has 'state' twice",
    ):
        oee.Transitions.load(tmp_path / "l.parquet")


# ---- other machines, other folders


ADDRESSES = [
    "http://host/x.csv",
    "https://host/x.parquet",
    "s3://bucket/x.npz",
    "ftp://host/x-v0",
    "file:///x.csv",
]


@pytest.mark.parametrize("address", ADDRESSES)
def test_nothing_is_fetched(address, monkeypatch, capsys):
    import socket
    from pathlib import Path

    from oee_tabular.mdp.policies import read_policy_array

    def refuse(*_, **__):
        raise AssertionError("the network")

    monkeypatch.setattr(socket, "socket", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    readers = [
        oee.Transitions.load,
        oee.ContinuousTransitions.load,
        oee.FiniteMDP.load,
        LOG.save,
        lambda path: read_policy_array(path, "policy"),
    ]
    for reader in readers:
        for given in (address, Path(address)):
            with pytest.raises(
                ValueError,
                match=r"path must be a file of this machine; .* and nothing is fetched",
            ):
                reader(given)
    assert "nothing is fetched" in refuse_command(capsys, ["info", address])


def test_a_minari_id_is_checked_before_a_folder_is_made(tmp_path, monkeypatch):
    root = tmp_path / "root"
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(root))
    for name in (
        "minari:../../elsewhere/x-v0",
        "minari:grid/uniform",
        "minari:/etc/x-v0",
        "minari:",
    ):
        with pytest.raises(
            ValueError,
            match=r"path must be a Minari id, minari:namespace/name-v0, .*; it is",
        ):
            LOG.save(name)
        with pytest.raises(
            FileNotFoundError, match="neither a file nor a Minari folder"
        ):
            oee.Transitions.load(name)
    assert list(tmp_path.iterdir()) == []


# ---- what is no file, and what unpacks to far more


def kinds_of_no_file(folder):
    """Return a named pipe, a socket and links to devices, of all endings."""
    for ending in (".csv", ".csv.gz", ".parquet", ".npz", ".npy", ".json", ""):
        os.mkfifo(folder / f"pipe{ending}")
        (folder / f"link{ending}").symlink_to(folder / f"pipe{ending}")
        (folder / f"zero{ending}").symlink_to("/dev/zero")
    return sorted(folder.iterdir())


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_pipes_and_devices_are_refused_at_once(tmp_path):
    from oee_tabular.cli.files import describe_files
    from oee_tabular.data.tables import csv_frame
    from oee_tabular.mdp.policies import read_policy_array

    readers = (
        oee.Transitions.load,
        oee.Transitions.open,
        oee.ContinuousTransitions.load,
        oee.FiniteMDP.load,
        oee.TransitionCounts.load,
        lambda path: oee.Problem(GRID, path),
        lambda path: describe_files([str(path)]),
        lambda path: csv_frame(str(path)),
        lambda path: read_policy_array(str(path), "policy"),
    )
    for path in kinds_of_no_file(tmp_path):
        for read in readers:
            with pytest.raises(ValueError, match="must be a regular file; it is a"):
                read(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_pipe_in_a_folder_is_not_passed_over(tmp_path):
    LOG.save(tmp_path / "a.csv")
    os.mkfifo(tmp_path / "b.csv")
    for path in (tmp_path, str(tmp_path / "*.csv")):
        for read in (oee.Transitions.load, oee.Transitions.open):
            with pytest.raises(ValueError, match=r"b\.csv' must be a regular file"):
                read(path)


@pytest.mark.parametrize(
    "read",
    [
        oee.Transitions.load,
        oee.Transitions.open,
        oee.FiniteMDP.load,
        oee.TransitionCounts.load,
        lambda handle: oee.Problem(GRID, handle),
    ],
)
def test_open_files_are_no_paths(tmp_path, read):
    with pytest.raises(ValueError, match="open file"):
        read(io.StringIO("state,action,next_state\n0,0,1\n"))


def test_what_unpacks_to_more_than_its_header_says(tmp_path, monkeypatch):
    """Nothing of it is unpacked, whatever memory there is."""
    large = bytes(2**24)
    members = {
        "raw": large,
        "few": header((3,)) + large,
        "long": b"\x93NUMPY\x02\x00\xff\xff\xff\x7f" + large,
        "oee_tabular_kind": header((), "<U3") + large,
    }
    read = []
    plain = zipfile.ZipExtFile.read
    monkeypatch.setattr(
        zipfile.ZipExtFile, "read", lambda file, n=-1: read.append(n) or plain(file, n)
    )
    for name, data in members.items():
        path = archive(tmp_path / f"{name}.npz", {name: data})
        for load in (read_npz, oee.Transitions.load, oee.Transitions.open):
            with pytest.raises(ValueError, match=rf"{name}\.npz' must be an npz"):
                load(path)
    assert 0 <= min(read) <= max(read) <= 10_000


@pytest.mark.parametrize("ending", [".csv", ".csv.gz"])
@pytest.mark.parametrize("start", ["", "state,action,next_state\n0,0,1\n"])
def test_a_line_without_an_end(tmp_path, ending, start):
    data = start.encode() + b"1" * (2**24 + 10)
    path = tmp_path / f"a{ending}"
    path.write_bytes(gzip.compress(data, 1) if ending == ".csv.gz" else data)
    for load in (oee.Transitions.load, oee.Transitions.open):
        with pytest.raises(
            ValueError, match=rf"line {1 + start.count(chr(10))} has more than 16777216"
        ):
            load(path)


# ---- forged arrays with digests that fit


WRONG = [
    np.array(None, dtype=float),
    np.array("x"),
    np.array(["a", "\x1b[31mb"]),
    np.array([-1]),
    np.array([2**62]),
    np.array([[1]]),
    np.zeros(0),
    np.array([1j]),
    np.array(["2020"], dtype="M8[s]"),
    np.zeros((0, 3)),
    np.array([np.inf]),
    np.array([True]),
    np.array(b"x"),
    np.array(3),
    np.zeros(8) - 1,
    np.zeros(8, dtype=np.int64) + 2**60,
    np.full(8, 1.5),
    np.array([2, 0, 0, 0, 0, 0, 0, 0]),
    np.array([1, 1, 5, 1, 0, 0, 0, 0]),
    np.array(["a"] * 9),
    np.zeros(2, dtype="V8"),
    np.zeros(2, dtype=[("a", "i4")]),
]


def test_forged_arrays_of_every_kind_are_refused_in_a_sentence(tmp_path):
    """What is read can be printed, and prints no control character."""
    LOG.save(tmp_path / "log.npz")
    LOG.save(tmp_path / "log.csv")
    oee.Transitions.open(tmp_path / "log.csv").save(tmp_path / "counts.npz")
    GRID.save(tmp_path / "grid.npz")
    oee.Transitions(["a"], ["x"], ["b"]).save(tmp_path / "names.npz")
    vectors = oee.ContinuousTransitions([[0.0, 1.0]], [0], [[1.0, 2.0]], [0.5])
    vectors.save(tmp_path / "vectors.npz")
    readers = {
        "log": oee.Transitions.load,
        "names": oee.Transitions.load,
        "counts": oee.TransitionCounts.load,
        "grid": oee.FiniteMDP.load,
        "vectors": oee.ContinuousTransitions.load,
    }
    for name, read in readers.items():
        arrays = read_npz(tmp_path / f"{name}.npz")
        for label, wrong in itertools.product(arrays, [*WRONG, None]):
            forged = {key: array for key, array in arrays.items() if key != label}
            forged |= {} if wrong is None else {label: wrong}
            np.savez(tmp_path / "f.npz", **forged, **{DIGEST: digest(forged)})
            try:
                told = repr(read(tmp_path / "f.npz"))
            except ValueError as error:
                told = str(error)
                assert "f.npz" in told, (name, label, wrong)
                assert "__init__" not in told, (name, label, wrong)
            assert "\x1b" not in told


@pytest.mark.parametrize("ending", [".csv", ".csv.gz"])
def test_a_table_beyond_memory_is_refused_while_it_is_read(
    tmp_path, monkeypatch, ending
):
    """Before the libraries that read it find no memory, which some do not survive."""
    rows = np.arange(400_000) % 9
    frame = pd.DataFrame({"state": rows, "action": 0 * rows, "next_state": rows})
    path = tmp_path / f"log{ending}"
    frame.to_csv(path, index=False)
    assert len(oee.Transitions.load(path)) == len(rows)
    monkeypatch.setattr(oee._checks, "free_memory", lambda: 4 * 2**20)
    with pytest.raises(MemoryError, match=rf"log{ending}' needs .* are free"):
        oee.Transitions.load(path)


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be", "utf-32", "utf-32-be"])
@pytest.mark.parametrize("read", [oee.Transitions.load, oee.Transitions.open])
def test_an_encoding_of_two_bytes_a_letter_or_four_is_named(tmp_path, encoding, read):
    text = "state,action,next_state\n0,0,1\n"
    (tmp_path / "l.csv").write_bytes(text.encode(encoding))
    with pytest.raises(ValueError, match=r"l\.csv' must .*UTF-(16|32).* \(save it as"):
        read(tmp_path / "l.csv")


@pytest.mark.parametrize("sep", [",", ";", "\t"])
@pytest.mark.parametrize("end", ["txt", "dat"])
def test_the_advice_on_a_text_of_any_separator_makes_a_log(tmp_path, sep, end):
    path = tmp_path / f"l.{end}"
    path.write_text(f"state{sep}action{sep}next_state\n0{sep}0{sep}1\n")
    with pytest.raises(ValueError, match="sep=None, engine='python'"):
        oee.Transitions.load(path)
    pd.read_csv(path, sep=None, engine="python").to_csv(
        tmp_path / "log.csv", index=False
    )
    assert oee.Transitions.load(tmp_path / "log.csv").next_state.tolist() == [1]


@pytest.mark.parametrize("break_", ["\n", "\r", "\r\n"])
def test_a_name_with_a_line_break_is_saved_where_it_can_be_read(tmp_path, break_):
    name = f"a{break_}b"
    log = oee.Transitions([name, "c"], ["x", "x"], ["c", name])
    for end in ("csv", "csv.gz"):
        with pytest.raises(ValueError, match=r"^state\[0\] must have no line break"):
            log.save(tmp_path / f"l.{end}")
        assert not (tmp_path / f"l.{end}").exists()
    for end in ("npz", "parquet"):
        log.save(tmp_path / f"l.{end}")
        assert oee.Transitions.load(tmp_path / f"l.{end}").state_names == (name, "c")


@pytest.mark.parametrize("name", ["NA", "None", "missing"])
@pytest.mark.parametrize("end", ["csv", "parquet"])
def test_a_name_that_means_no_value_elsewhere_takes_its_simulator(tmp_path, name, end):
    oee.Transitions([name, "b"], ["x", "x"], ["b", name]).save(tmp_path / f"l.{end}")
    with pytest.raises(ValueError, match=r"where it is a name, .*Problem\(simulator"):
        oee.Transitions.load(tmp_path / f"l.{end}")
    mdp = oee.FiniteMDP([[[0, 1]], [[1, 0]]], [[0], [0]], 0, 0.9)
    named = mdp.with_names([name, "b"], ["x"])
    assert oee.Problem(named, str(tmp_path / f"l.{end}")).counts.sum() == 2
