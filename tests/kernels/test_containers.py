"""Arrays of other libraries: used rightly, or refused with the argument's name."""

import inspect
import re
import warnings
from array import array
from collections import UserList, deque

import numpy as np
import pandas as pd
import pytest
from containers import (
    ArrayWithUnit,
    InUnit,
    Lazy,
    Named,
    Quantity,
    TypeWithUnit,
    masked_at_first,
    with_a_loss,
    without_a_loss,
)
from fuzz_calls import arguments_of, call, functions
from fuzz_values import valid_values
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from scipy import sparse

import oee_tabular as oee
from oee_tabular import FiniteMDP, Transitions

# options that the method of the call does not use
UNUSED = {
    "density_ratio": ("n_centers", "step_size", "batch_size", "n_iterations", "seed"),
    "interval": ("n_bootstrap", "seed"),
    "compare_policies": ("n_bootstrap", "seed"),
    "transition_ratio": ("seed",),
    "Conditional.fit": ("seed",),
    "InClass.fit": ("seed",),
    "Tied.fit": ("seed",),
    "discretize": ("seed",),
    "ContinuousSimulator.discretize": ("seed",),
}
# whose errors name what the argument becomes, or that take a function's own keywords
OTHERWISE = (
    "KinovaHand",
    "Families",
    "padded_log",
    "mdps",
    "mdp_pairs",
    "cartpole_policy",
    "reacher_policy",
)
# taken by its labels
BY_NAME = (
    ("initial", "shuffled"),
    ("initial", "shuffled when computed"),
    ("initial", "shuffled inside"),
)


def is_result(name, function, known):
    """Whether a class keeps what it is given, or looks at it on use."""
    return inspect.isclass(function) and (
        name in known["holders"] or name in ("Embedded", "Sides", "Outlook")
    )


@pytest.fixture(scope="module")
def known():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return valid_values()


@pytest.mark.filterwarnings("ignore")
def test_no_public_function_loses_what_a_container_says(known):
    """The guard of the kind: every argument that is a number or an array, of every
    public function.
    """
    n_tried = 0
    wrong = []
    for name, function in functions(known).items():
        checks = name in (
            "FiniteMDP",
            "Transitions",
            "ContinuousTransitions",
            "Problem",
        )
        is_operator = re.search(r"\.__(?!call__)\w+__$", name) is not None
        if name in OTHERWISE or is_operator:
            continue
        if is_result(name, function, known) and not checks:
            continue
        values = arguments_of(name, function, known)
        for argument, value in values.items():
            if argument in UNUSED.get(name, ()):
                continue
            for kind, container in with_a_loss(value).items():
                if (argument, kind) in BY_NAME or (
                    argument == "reward" and ("masked" in kind or kind == "missing")
                ):
                    continue
                n_tried += 1
                try:
                    call(function, values | {argument: container})
                    outcome = "taken"
                except ValueError as error:
                    begins = str(error).startswith(
                        (argument, argument.rstrip("s"), *RENAMED.get(name, ()))
                    )
                    outcome = "" if begins else str(error)
                if outcome:
                    wrong.append(f"{name}({argument}: {kind}): {outcome:.100}")
    assert not wrong, "\n".join(wrong)
    assert n_tried > 500


RENAMED = {"discretize": ("shape",)}


# ---- worked examples

P = np.array([[[0.5, 0.5], [0.0, 1.0]], [[1.0, 0.0], [0.25, 0.75]]])
R = np.array([[1.0, 0.0], [-1.0, 2.0]])
MDP = FiniteMDP(P, R, [0.5, 0.5], 0.9)
PI = np.array([[0.25, 0.75], [0.5, 0.5]])
EVEN = np.full((2, 2), 0.25)
USES = {
    "transitions": (P, lambda x: FiniteMDP(x, R, 0, 0.9).transitions.toarray()),
    "rewards": (R, lambda x: FiniteMDP(P, x, 0, 0.9).rewards),
    "rewards (S,)": (R[:, 0], lambda x: FiniteMDP(P, x, 0, 0.9).rewards),
    "initial": (PI[0], lambda x: FiniteMDP(P, R, x, 0.9).initial),
    "layout": (R[:, 0], lambda x: MDP.with_layout(x).layout),
    "distribution": (EVEN, lambda x: oee.sample_transitions(MDP, x, 9, seed=0).state),
    "p": (PI[0], lambda x: oee.density_ratio(x, [1, 2]).ratio),
    "g": (R[0], lambda x: oee.check_assumptions([1, 1], [1, 1], lower=0.5, upper=2.0)),
    "reward": (R[0], lambda x: Transitions([0, 1], [0, 0], [1, 1], x).reward),
    "state": (np.array([0, 1]), lambda x: Transitions(x, [0, 0], [1, 1]).state),
    "terminated": (
        np.array([0, 1]),
        lambda x: Transitions([0, 1], [0, 0], [1, 1], terminated=x).terminated,
    ),
    "terminal_state": (
        np.array([1, 0]),
        lambda x: FiniteMDP(P, R, 0, 0.9, terminal_state=x).terminal_state,
    ),
    "seed": (
        np.array([3, 4]),
        lambda x: oee.sample_transitions(MDP, EVEN, 9, seed=x).state,
    ),
    "rows": (
        np.array([1, 0]),
        lambda x: Transitions([0, 1], [0, 0], [1, 1]).select(x).state,
    ),
}


@pytest.mark.parametrize("use", USES)
def test_containers_that_say_no_more_give_the_same_as_plain_arrays(use):
    value, function = USES[use]
    wanted = function(value)
    for kind, container in without_a_loss(value).items():
        if use in ("state", "terminated", "terminal_state") and kind == "objects":
            continue  # of a log the names
        if use in ("seed", "rows") and kind in ("list of quantities", "objects"):
            continue
        found = function(container)
        if isinstance(wanted, np.ndarray):
            assert_array_equal(found, wanted, err_msg=kind)


def test_masked_rewards_of_a_log_are_missing():
    masked = np.ma.array([1.0, -999.0], mask=[0, 1])
    nullable = pd.array([1.0, None], dtype="Float64")
    whole = np.ma.array([1, -999], mask=[0, 1])
    for reward in (
        masked,
        nullable,
        whole,
        Lazy(masked),
        [1.0, np.ma.masked],
        [1.0, pd.NA],
    ):
        log = Transitions([0, 0], [0, 0], [0, 1], reward=reward)
        assert_array_equal(log.reward, [1.0, np.nan])


def test_masked_rewards_of_moves_are_undefined():
    table = np.ma.array(np.ones((2, 2, 2)), mask=P == 0.0)
    assert MDP.with_rewards(table).transition_rewards.nnz == 6
    with pytest.raises(ValueError, match=r"rewards\[0, 0, 0\] must be finite"):
        MDP.with_rewards(masked_at_first(np.ones((2, 2, 2))))


def test_a_series_with_labels_is_a_distribution_by_its_labels():
    named = MDP.with_names(["hall", "dock"])
    for labels, mdp in (([1, 0], MDP), (["dock", "hall"], named)):
        series = pd.Series([0.25, 0.75], index=labels)
        assert_array_equal(mdp.with_initial(series).initial, [0.75, 0.25])
    with pytest.raises(ValueError, match=r"initial's state must be in 0\.\.1"):
        MDP.with_initial(pd.Series([0.5, 0.5], index=[7, 0]))
    with pytest.raises(ValueError, match="initial must have each state once"):
        MDP.with_initial(pd.Series([0.5, 0.5], index=[0, 0]))


def test_columns_of_chosen_rows_of_a_frame_are_one_log():
    frame = pd.DataFrame(
        {"state": [0, 1, 2], "action": [0, 0, 1], "next_state": [1, 2, 0], "pay": 1.0}
    )
    chosen = frame[frame["state"] > 0]
    columns = [chosen[name] for name in ("state", "action", "next_state", "pay")]
    assert Transitions(*columns).state.tolist() == [1, 2]
    for odd in (frame["pay"][:2], chosen["pay"][::-1]):
        with pytest.raises(ValueError, match="must be a plain array"):
            Transitions(*columns[:3], odd)
    with pytest.raises(ValueError, match="state must be a plain array"):
        Transitions(chosen["state"], [0, 1], [2, 0])


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (np.ma.array(R, mask=[[0, 0], [1, 0]]), r"rewards\[1, 0\] must be finite"),
        (R.view(InUnit), r"rewards must be numbers without a unit; it is in m \(give"),
        (Quantity(R, "1/second"), r"in 1/second \(.*: \.m_as\('1/second'\)\)"),
        (Quantity(R, "percent"), "it is in percent"),
        (
            [[Quantity(1.0), 0.0], [0.0, 0.0]],
            r"rewards\[0, 0\] must be numbers without",
        ),
        (Named(R, ("action", "state")), r"dimensions 'action', 'state' \(.*transpose"),
        (Named(R[0], ("s",), {"s": [1, 0]}), r"coordinate 's' \(1, 0\) is not 0, 1"),
        (Named(R[0], ("s",), {"s": ["b", "a"]}), r"coordinate 's' \(b, a\) is not"),
        (
            pd.DataFrame(R, columns=["l", "r"]),
            r"whose columns \(l, r\) are not .*to_numpy",
        ),
        (pd.DataFrame(R, index=[1, 0]), r"whose index \(1, 0\) is not 0, 1, 2"),
        (pd.Series(R[0])[::-1], r"got Series whose index \(1, 0\) is"),
        (pd.Series(R[0], index=pd.MultiIndex.from_tuples([(0, 0), (0, 1)])), "Series"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_remedy_for_each_container(value, text):
    with pytest.raises(ValueError, match=text) as refused:
        MDP.with_rewards(value)
    assert str(refused.value).startswith("rewards")
    assert str(refused.value).isprintable()


def test_tables_of_polars_and_arrow():
    polars = pytest.importorskip("polars")
    arrow = pytest.importorskip("pyarrow")
    named = {"l": R[:, 0], "r": R[:, 1]}
    for table in (polars.DataFrame(named), arrow.table(named)):
        with pytest.raises(ValueError, match=r"rewards .* columns \(l, r\)"):
            MDP.with_rewards(table)
    assert_array_equal(MDP.with_rewards(polars.DataFrame(R)).rewards, R)
    for column in (polars.Series(R[0]), arrow.array(R[0]), arrow.chunked_array([R[0]])):
        assert_array_equal(MDP.with_rewards(column).rewards[:, 0], R[0])
    with pytest.raises(ValueError, match=r"rewards\[1\] must be finite"):
        MDP.with_rewards(arrow.array([1.0, None]))


def test_what_dask_computes_keeps_its_masks_and_labels():
    arrays = pytest.importorskip("dask.array")
    frames = pytest.importorskip("dask.dataframe")

    def read(reward):
        return Transitions([0, 0], [0, 1], [0, 1], reward=reward).reward

    plain = arrays.from_array(np.array([1.0, -999.0]), chunks=1)
    masked = arrays.ma.masked_equal(plain, -999.0)
    assert_array_equal(read(plain), [1.0, -999.0])
    for reward in (masked, [*masked], masked.persist()):
        assert_array_equal(read(reward), [1.0, np.nan])
    series = frames.from_pandas(
        pd.Series([1, 0], index=[1, 0]), npartitions=1, sort=False
    )
    move = {"state": [0, 0], "action": [0, 1], "next_state": [0, 1]}
    for column in (*move, "reward", "terminated", "episode", "behavior_probability"):
        with pytest.raises(ValueError, match=rf"^{column} .* index \(1, 0\) is not"):
            Transitions(**(move | {column: series}))
    frame = frames.from_pandas(pd.DataFrame(move), npartitions=2)
    log = Transitions(*(frame[column] for column in move))
    assert log.action.tolist() == [0, 1]
    with pytest.raises(
        ValueError, match=r"got dask.*'s DataFrame .*frame\.compute\(\)"
    ):
        Transitions.from_frame(frame)
    assert Transitions.from_frame(frame.compute()).action.tolist() == [0, 1]


@pytest.mark.parametrize(
    "dtype",
    [
        TypeWithUnit(),
        TypeWithUnit("1/second"),
        TypeWithUnit("km", "unit"),
        TypeWithUnit("degC", "unit"),
    ],
    ids=lambda dtype: str(vars(dtype)),
)
@pytest.mark.parametrize("column", ["state", "reward", "terminated", "episode"])
def test_a_column_of_a_frame_whose_type_has_a_unit_is_refused(dtype, column):
    frame = pd.DataFrame({"state": [0], "action": [0], "next_state": [0]})
    frame[column] = ArrayWithUnit([1.0], dtype)
    rule = rf"frame: {column} must be numbers without a unit; it is in .* \(give its"
    with pytest.raises(ValueError, match=rule):
        Transitions.from_frame(frame)
    values = {name: frame[name] for name in frame}
    with pytest.raises(ValueError, match=rf"^{column} must be numbers without"):
        Transitions(**values)


def test_a_type_without_a_unit_is_read():
    frame = pd.DataFrame({"state": [0], "action": [0], "next_state": [0]})
    frame["reward"] = ArrayWithUnit([2.0], TypeWithUnit("dimensionless"))
    assert Transitions.from_frame(frame).reward.tolist() == [2.0]


def test_the_real_libraries_where_they_are_installed():
    found = {}
    for name in ("astropy.units", "pint", "xarray"):
        try:
            found[name] = __import__(name, fromlist=["x"])
        except ImportError:
            continue
    values = []
    if "astropy.units" in found:
        values += [R * found["astropy.units"].m]
    if "pint" in found:
        values += [found["pint"].UnitRegistry().Quantity(R, "meter")]
    if "xarray" in found:
        values += [found["xarray"].DataArray(R, dims=("action", "state"))]
    for value in values:
        with pytest.raises(ValueError, match="rewards must be"):
            MDP.with_rewards(value)
    if not values:
        pytest.skip("none is installed")


class Raising:
    """An object that fails in its own way when it is asked for its numbers."""

    def __init__(self, error):
        self.error = error

    def __array__(self, dtype=None, copy=None):
        raise self.error


class Endless:
    def __array__(self, dtype=None, copy=None):
        return np.asarray(self)

    def __len__(self):
        return -1  # noqa: PLE0303


def self_holding():
    array = np.empty(1, dtype=object)
    array[0] = array
    return array


def self_holding_list():
    items = []
    items.append(items)
    return items


class Unending:
    """A sequence whose items never end, whatever it says of its length."""

    def __init__(self, length):
        self.length = length

    def __len__(self):
        return self.length

    def __getitem__(self, k):
        return 0.5


HOSTILE = [
    Unending(2),
    Unending(2**62),
    Raising(KeyError("x")),
    Raising(RuntimeError("\x1b[31mgrad")),
    Raising(MemoryError()),
    Endless(),
    self_holding(),
    self_holding_list(),
    [self_holding(), self_holding()],
    np.array(self_holding()[0], dtype=object).reshape(()),
    np.array([[1.0], [1.0, 2.0]], dtype=object),
    np.empty((), dtype=object),
    np.zeros(2, dtype=[("a", float)]),
]


@pytest.mark.parametrize("value", HOSTILE, ids=lambda value: type(value).__name__)
def test_hostile_objects_are_refused_with_the_argument(value):
    calls = {
        "rewards": lambda: MDP.with_rewards(value),
        "transitions": lambda: FiniteMDP(value, R, 0, 0.9),
        "initial": lambda: MDP.with_initial(value),
        "policy": lambda: oee.policy_value(MDP, value),
        "discount": lambda: MDP.with_discount(value),
        "horizon": lambda: oee.policy_value(MDP, PI, horizon=value),
        "seed": lambda: oee.sample_transitions(MDP, EVEN, 9, seed=value),
        "state": lambda: Transitions(value, [0], [0]),
        "size": lambda: oee.bench.tandem(value),
    }
    for name, function in calls.items():
        with pytest.raises(ValueError, match=f"^{name}") as refused:
            function()
        assert str(refused.value).isprintable()


def test_sequences_by_their_methods_are_arrays():
    for reward in (deque([1.0, 2.0]), UserList([1.0, 2.0]), array("d", [1.0, 2.0])):
        assert Transitions([0, 1], [0, 0], [1, 1], reward).reward.tolist() == [1, 2]
    assert MDP.with_rewards(memoryview(R)).rewards.tolist() == R.tolist()


def test_choices_of_a_policy_are_read_like_arrays():
    row = np.array([0.25, 0.75])
    fine = [np.ma.array(row), Quantity(row, ""), pd.Series(row), Lazy(row)]
    for choice in fine:
        found = oee.mdp.check_policy(lambda s, c=choice: c, MDP)
        assert_array_equal(found, [row, row])
    odd = [
        masked_at_first(row),
        np.ma.masked,
        np.ma.array(1, mask=True),
        (np.ma.array(1, mask=True), None),
        row.view(InUnit),
        Quantity(row),
        pd.Series(row, index=["go", "stay"]),
        {0: Quantity(0.25), 1: 0.75},
        {0: np.ma.masked, 1: 1.0},
    ]
    for choice in odd:
        for policy in (lambda s, c=choice: c, {0: choice, 1: 0}):
            with pytest.raises(ValueError, match=r"^policy"):
                oee.mdp.check_policy(policy, MDP)


# ---- seeds
@pytest.mark.parametrize(
    "seed",
    [
        range(10**8),
        10**200_000,
        [1] * 20_000,
        [[[[[[[[[[[1]]]]]]]]]]],
        np.zeros(20_000, dtype=int),
        "7",
        [1.0],
        1.0,
        [None],
        {1: 2},
        np.array(["a"]),
        np.array([1.5]),
        np.ma.array([1, 2], mask=[0, 1]),
        Quantity(3),
        True,
        np.False_,
        [3, True],
        np.array([True, False]),
        {1, 2},
        sparse.coo_array(np.eye(2, dtype=int)),
    ],
    ids=lambda seed: type(seed).__name__,
)
def test_seeds_are_what_numpy_documents(seed):
    with pytest.raises(ValueError, match=r"^seed"):
        oee.sample_transitions(MDP, EVEN, 9, seed=seed)


@pytest.mark.parametrize(
    "seed",
    [
        *[0, 2**70, np.int32(5), [1, 2**80], (1, 2), range(4), [[1, 2], [3]]],
        *[np.arange(3), np.uint32([7]), np.array(4), np.matrix([0, 1])],
        np.array([1, 2**70], dtype=object),
    ],
    ids=repr,
)
def test_seeds_give_the_streams_of_numpy(seed):
    plain = np.asarray(seed) if isinstance(seed, np.matrix) else seed
    if isinstance(seed, np.ndarray) and seed.dtype.hasobject:
        plain = seed.tolist()
    if isinstance(seed, np.ndarray) and seed.ndim == 0:
        plain = int(seed)
    try:
        stream = np.random.default_rng(plain)
    except (TypeError, ValueError):  # nested sequences, by numpy from 2.5 on
        with pytest.raises(ValueError, match=r"^seed"):
            oee.sample_transitions(MDP, EVEN, 30, seed=seed)
        return
    found = oee.sample_transitions(MDP, EVEN, 30, seed=seed)
    wanted = oee.sample_transitions(MDP, EVEN, 30, seed=stream)
    assert_array_equal(found.state, wanted.state)


# ---- sparse values
entries = st.lists(
    st.tuples(
        st.integers(0, 3), st.integers(0, 1), st.integers(1, 4), st.integers(-3, 3)
    ),
    min_size=4,
    max_size=20,
)
FORMS = {
    "coo": lambda coo: coo,
    "coo_matrix": sparse.coo_matrix,
    "csr": lambda coo: repeated(coo, sparse.csr_array),
    "csc": lambda coo: repeated(coo, sparse.csc_array),
    "csr_matrix": lambda coo: repeated(coo, sparse.csr_matrix),
    "bsr": lambda coo: repeated(coo, sparse.bsr_array),
}


def repeated(coo, kind):
    """A compressed matrix with these entries, repeated ones as well, in their order."""
    rows, columns = coo.coords if kind is not sparse.csc_array else coo.coords[::-1]
    n = coo.shape[0] if kind is not sparse.csc_array else coo.shape[1]
    order = np.argsort(rows, kind="stable")
    indptr = np.searchsorted(rows[order], np.arange(n + 1))
    data = coo.data[order]
    if kind is sparse.bsr_array:
        data = data.reshape(-1, 1, 1)
    return kind((data, columns[order], indptr), shape=coo.shape)


@settings(max_examples=60, deadline=None)
@given(entries, st.sampled_from(sorted(FORMS)))
def test_repeated_rewards_are_averaged_by_their_probabilities(drawn, form):
    """As the sum over outcomes says: r(s, a) = sum_k p_k r_k."""
    drawn = [(row, 0, 1, 0) for row in range(4)] + drawn
    row, column, weight, reward = (np.array(part) for part in zip(*drawn, strict=True))
    p = weight / np.bincount(row, weight)[row]
    P, R = (
        FORMS[form](sparse.coo_array((part, (row, column)), shape=(4, 2)))
        for part in (p, reward.astype(float))
    )
    found = FiniteMDP(P, R, 0, 0.9)
    wanted = np.bincount(row, p * reward).reshape(2, 2)
    np.testing.assert_allclose(found.rewards, wanted, atol=1e-12)
    total = sparse.coo_array((p, (row, column)), shape=(4, 2)).toarray()
    np.testing.assert_allclose(found.transitions.toarray(), total, atol=1e-12)


def test_repeated_values_are_one_where_they_agree():
    at = ([0, 0, 1], [1, 1, 1])
    P, R = (
        sparse.coo_array((v, at), shape=(2, 2))
        for v in ([0.5, 0.5, 1.0], [-1.0, -1.0, 0.0])
    )
    mdp = FiniteMDP(P, R, 0, 0.9)
    assert mdp.rewards.tolist() == [[-1.0], [0.0]]
    assert mdp.with_rewards(R).rewards.tolist() == [[-1.0], [0.0]]
    assert FiniteMDP([P], [R], 0, 0.9).rewards.tolist() == [[-1.0], [0.0]]
    # R knows nothing of P's parts, P is one number
    other = sparse.coo_array(([-1.0, -3.0, 0.0], at), shape=(2, 2))
    for P_or_none in (P.tocsr(), P.toarray()[:, None]):
        with pytest.raises(
            ValueError, match=r"rewards\[0, 1\] must have one value; it has -1 and -3"
        ):
            FiniteMDP(P_or_none, other, 0, 0.9)
    log = Transitions([0, 1], [0, 0], [1, 1])
    assert FiniteMDP.from_log(log, R, initial=0).rewards.tolist() == [[-1.0], [0.0]]
    zeta = sparse.coo_array(([1.0, 1.0, 1.0], at), shape=(2, 2))
    assert oee.exact.reweight(mdp, zeta).transitions.toarray().tolist() == [
        [0, 1],
        [0, 1],
    ]
    # those of counts add up
    counts = sparse.coo_array(([2, 3, 1], at), shape=(2, 2))
    assert oee.transition_ratio(counts, mdp).counts.sum() == 6


def test_a_sparse_matrix_for_each_action():
    dense = P.transpose(1, 0, 2)
    paid = np.arange(8.0).reshape(2, 2, 2)
    kinds = (sparse.csr_array, sparse.csc_matrix, sparse.lil_array, sparse.coo_matrix)
    wanted = FiniteMDP(P, paid.transpose(1, 0, 2), 0, 0.9)
    for kind in kinds:
        parts, prices = [kind(part) for part in dense], tuple(map(kind, paid))
        objects = np.empty(2, dtype=object)
        objects[:] = parts
        for given_parts in (parts, tuple(parts), objects):
            found = FiniteMDP(given_parts, prices, 0, 0.9)
            assert_array_equal(
                found.transitions.toarray(), wanted.transitions.toarray()
            )
            assert_array_equal(found.rewards, wanted.rewards)
    with pytest.raises(ValueError, match=r"transitions\[1\] must have shape \(2, 2\)"):
        FiniteMDP([sparse.eye_array(2), sparse.eye_array(3)], R, 0, 0.9)
    with pytest.raises(ValueError, match="transitions must be an array of numbers"):
        FiniteMDP([sparse.eye_array(2), np.eye(2)], R, 0, 0.9)


# ---- single precision
ROWS = np.random.default_rng(0).dirichlet(np.ones(7), size=(3, 2))
MODEL = FiniteMDP(np.full((7, 2, 7), 1 / 7), np.zeros((7, 2)), 0, 0.9)
TABLE = np.random.default_rng(1).dirichlet(np.ones(3), size=5)
SIZED = FiniteMDP(np.full((5, 3, 5), 0.2), np.zeros((5, 3)), 0, 0.9)


def precise_doors(kind):
    """Label -> a call that takes probabilities of this type, in every form."""
    law = np.random.default_rng(2).dirichlet(np.ones(7), size=(7, 2)).astype(kind)
    start = law[0, 0]
    table = TABLE.astype(kind)
    share = (TABLE / 5).astype(kind)
    zeros = np.zeros((7, 2))
    flat = law.reshape(14, 7)
    rows = dict(enumerate(table))
    by_action = {s: dict(enumerate(row)) for s, row in enumerate(table)}
    return {
        "dense": lambda: FiniteMDP(law, zeros, 0, 0.9),
        "list of arrays": lambda: FiniteMDP(list(law), zeros, 0, 0.9),
        "nested lists": lambda: FiniteMDP(
            [[list(r) for r in s] for s in law], zeros, 0, 0.9
        ),
        "sparse": lambda: FiniteMDP(sparse_of(flat), zeros, 0, 0.9),
        "list of sparse": lambda: FiniteMDP(
            [sparse_of(law[:, a]) for a in (0, 1)], zeros, 0, 0.9
        ),
        "initial": lambda: MODEL.with_initial(start),
        "initial list": lambda: MODEL.with_initial(list(start)),
        "initial mapping": lambda: MODEL.with_initial(dict(enumerate(start))),
        "initial series": lambda: MODEL.with_initial(pd.Series(start)),
        "policy": lambda: oee.policy_value(SIZED, table),
        "policy list": lambda: oee.policy_value(SIZED, list(table)),
        "policy mapping": lambda: oee.policy_value(SIZED, rows),
        "policy by action": lambda: oee.policy_value(SIZED, by_action),
        "policy function": lambda: oee.policy_value(SIZED, lambda s: table[s]),
        "mix": lambda: oee.mix(table, table, 0.5),
        "distribution": lambda: oee.sample_transitions(SIZED, share, 9, seed=0),
        "data_distribution": lambda: oee.efficiency_bound(SIZED, table, share),
    }


def test_probabilities_of_single_precision_may_round_to_more_than_one():
    above = np.nextafter(np.float32(1), np.float32(2))
    move = ([0], [0], [1])
    frame = pd.DataFrame(
        {"state": [0], "action": [0], "next_state": [1], "behavior_probability": above}
    ).astype({"behavior_probability": np.float32})
    for log in (
        Transitions(*move, behavior_probability=np.array([above])),
        Transitions(*move, behavior_probability=[above]),
        Transitions.from_frame(frame),
    ):
        assert log.behavior_probability.tolist() == [1.0]
    for wrong in ([float(above)], np.array([1.01], dtype=np.float32)):
        with pytest.raises(ValueError, match=r"behavior_probability\[0\] must be in"):
            Transitions(*move, behavior_probability=wrong)


def sparse_of(array):
    """scipy has no half precision."""
    kind = np.float32 if array.dtype == np.float16 else array.dtype
    exact = array.astype(kind)
    if array.dtype == np.float16:
        exact = (exact / exact.sum(axis=-1, keepdims=True)).astype(kind)
    return sparse.csr_array(exact)


@pytest.mark.parametrize("kind", [np.float16, np.float32])
@pytest.mark.parametrize("door", precise_doors(np.float32))
def test_single_precision_is_scaled_at_every_door(door, kind):
    precise_doors(kind)[door]()


@pytest.mark.parametrize(
    "door", ["dense", "sparse", "initial", "policy", "mix", "distribution"]
)
def test_rounded_doubles_are_told_how_to_scale(door, monkeypatch):
    """As a file of JSON has the numbers of single precision."""
    doors = {
        name: inspect.getclosurevars(function)
        for name, function in precise_doors(np.float32).items()
    }
    assert door in doors
    law = np.full((7, 2, 7), 1 / 7).astype(np.float32).astype(np.float64)
    table = np.full((5, 3), 1 / 3).astype(np.float32).astype(np.float64)
    calls = {
        "dense": lambda: FiniteMDP(law.tolist(), np.zeros((7, 2)), 0, 0.9),
        "sparse": lambda: FiniteMDP(
            sparse.csr_array(law.reshape(14, 7)), np.zeros((7, 2)), 0, 0.9
        ),
        "initial": lambda: MODEL.with_initial(law[0, 0].tolist()),
        "policy": lambda: oee.policy_value(SIZED, table),
        "mix": lambda: oee.mix(table.tolist(), table, 0.5),
        "distribution": lambda: oee.sample_transitions(SIZED, table / 5, 9, seed=0),
    }
    with pytest.raises(ValueError, match=r"single precision, or rounded\? Divide"):
        calls[door]()
