"""What came through the doors in November 2026 (wrong data, a foreign file, orphans,
dead processes), each as a test.
"""

import contextlib
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from kernels.files import DIGEST, KIND, digest, read_npz
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP

GRID = oee.tasks.gridworld(3, 0.3)
UNIFORM = oee.uniform_policy(GRID)
LOG = oee.sample_episodes(GRID, UNIFORM, 4, 20, seed=0)


# ---- files of ours that changed


def drop_member(path, name):
    """The same file without one member, as a damaged directory of a zip file makes it:
    no checksum covers names.
    """
    with zipfile.ZipFile(path) as archive:
        members = {
            member.filename: archive.read(member) for member in archive.infolist()
        }
    with zipfile.ZipFile(path, "w") as archive:
        for member, data in members.items():
            if member != name:
                archive.writestr(member, data)


@pytest.mark.parametrize(
    "name", ["reward", "episode", "behavior_probability", "state", KIND, DIGEST]
)
def test_a_log_without_one_of_its_columns_is_refused(tmp_path, name):
    LOG.save(tmp_path / "log.npz")
    drop_member(tmp_path / "log.npz", f"{name}.npy")
    for read in (oee.Transitions.load, read_npz):
        with pytest.raises(ValueError, match=r"log\.npz' must hold"):
            read(tmp_path / "log.npz")


def test_a_simulator_with_another_member_is_refused(tmp_path):
    GRID.save(tmp_path / "grid.npz")
    with (
        zipfile.ZipFile(tmp_path / "grid.npz", "a") as archive,
        archive.open("state_names.npy", "w") as member,
    ):
        np.lib.format.write_array(member, np.array([str(k) for k in range(9)]))
    with pytest.raises(
        ValueError, match=r"grid\.npz' must hold the arrays that were saved in it"
    ):
        FiniteMDP.load(tmp_path / "grid.npz")


@pytest.mark.parametrize("ending", ["npz", "parquet"])
def test_no_flipped_byte_loads_other_data(tmp_path, ending):
    path = tmp_path / f"log.{ending}"
    rng = np.random.default_rng(0)
    LOG.save(path)
    data = path.read_bytes()
    columns = digest({k: np.asarray(v) for k, v in LOG.columns().items()})
    counts = oee.Transitions.open(path).count.tolist()
    for k in rng.integers(len(data), size=150):
        path.write_bytes(
            data[:k] + bytes([data[k] ^ (1 << rng.integers(8))]) + data[k + 1 :]
        )
        with contextlib.suppress(ValueError):
            found = oee.Transitions.load(path)
            assert (
                digest({k: np.asarray(v) for k, v in found.columns().items()})
                == columns
            )
        with contextlib.suppress(ValueError):
            assert oee.Transitions.open(path).count.tolist() == counts


def test_a_digest_knows_names_types_shapes_and_values_but_no_order():
    one = {"a": np.arange(4), "b": np.array(["x", "y"])}
    others = (
        {"a": np.arange(4)},
        {"c": one["a"], "b": one["b"]},
        one | {"a": np.arange(4.0)},
        one | {"a": np.arange(1, 5)},
    )
    assert digest(dict(reversed(one.items()))) == digest(one)
    assert (
        len(
            {
                digest(arrays)
                for arrays in (one, *others, one | {"a": np.arange(4).reshape(2, 2)})
            }
        )
        == 6
    )


# ---- sparse matrices that are none


def broken_matrix(form):
    """The grid's transitions in one of scipy's formats, edited after it was made."""
    matrix = sparse.csr_array(GRID.transitions, copy=True).asformat(form)
    if form in ("csr", "csc", "bsr"):
        matrix.indptr = matrix.indptr.copy()
        matrix.indptr[3] = 10**6
    elif form == "coo":
        matrix.coords = (matrix.coords[0], np.full_like(matrix.coords[1], 10**6))
    elif form == "lil":
        matrix.rows[3].append(10**6)
        matrix.data[3].append(1.0)
    else:
        matrix.offsets = matrix.offsets[:-1]
    return matrix


DOORS = {
    "transitions": lambda c: FiniteMDP(c, np.zeros((9, 4)), 0, 0.9),
    "rewards": lambda c: FiniteMDP(GRID.transitions, c, 0, 0.9),
    "rewards of a log": lambda c: FiniteMDP.from_log(LOG, discount=0.9, rewards=c),
    "matrix of counts": lambda c: oee.TransitionCounts.of(c, 4),
    "kernel": lambda c: oee.exact.solve_policy_system(c, np.zeros(9), 0.9),
    "ratio": lambda c: oee.exact.reweight(GRID, c),
    "counts of a ratio": lambda c: oee.transition_ratio(c, GRID),
    "counts of a problem": lambda c: oee.Problem(GRID, LOG, counts=c),
    "zeta": lambda c: oee.weighted_return_moments(GRID, c, UNIFORM, horizon=3),
    "seed": lambda c: oee.sample_episodes(GRID, UNIFORM, 4, 20, seed=c),
    "policy": lambda c: oee.policy_value(GRID, c),
    "horizon": lambda c: oee.policy_value(GRID, UNIFORM, horizon=c),
    "discount": lambda c: FiniteMDP(GRID.transitions, np.zeros((9, 4)), 0, c),
    "p": lambda c: oee.density_ratio(c, c),
}


@pytest.mark.parametrize("form", ["csr", "csc", "bsr", "coo", "lil", "dia"])
@pytest.mark.parametrize("door", DOORS)
@pytest.mark.filterwarnings("ignore:.*never recorded")
def test_native_code_sees_no_malformed_matrix(door, form):
    """A failure here ends the process."""
    with pytest.raises(ValueError, match=door.split()[0]):
        DOORS[door](broken_matrix(form))


# ---- terminals, labels


def test_a_header_cannot_speak_to_the_terminal(tmp_path):
    (tmp_path / "e.csv").write_text("state,action,next_state,\033[31mX\n0,0,1,2\n")
    for command in (("info", "e.csv"), ("counts", "e.csv", "--output", "c.npz")):
        done = subprocess.run(
            [sys.executable, "-m", "oee_tabular", *command],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert r"\x1b[31mX" in done.stdout + done.stderr
