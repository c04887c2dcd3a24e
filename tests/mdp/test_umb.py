import gzip
import io
import json
import lzma
import tarfile

import numpy as np
import pytest
from helpers import random_mdp, run_command
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

import oee_tabular as oee
from oee_tabular import bench
from oee_tabular.exceptions import ArgumentError
from oee_tabular.mdp import umb_files
from oee_tabular.testing import mdps

pytest.importorskip("umbi", reason="the extra umb")


def assert_same(a, b):
    """Require two MDPs to have the same arrays, bit by bit."""
    arrays, others = a.arrays(), b.arrays()
    assert arrays.keys() == others.keys()
    for name, array in arrays.items():
        if name == "rewards" and not a.has_all_actions:
            array, others[name] = array[a.available], others[name][a.available]
        assert_array_equal(array, others[name])


def there_and_back(mdp, folder):
    path = folder / "model.umb"
    mdp.save(path)
    return oee.FiniteMDP.load(path)


def with_gaps(mdp, rng):
    """The MDP with some actions that are not available."""
    available = rng.random(mdp.rewards.shape) < 0.6
    available[
        np.arange(mdp.n_states), rng.integers(mdp.n_actions, size=mdp.n_states)
    ] = True
    P = mdp.transitions.toarray() * available.reshape(-1, 1)
    table = mdp.transition_rewards
    return oee.FiniteMDP(
        P.reshape(*available.shape, mdp.n_states),
        mdp.rewards if table is None else table,
        mdp.initial,
        mdp.discount,
        available=available,
    )


# ---- our own files


FAMILIES = [name for name in bench.families() if name != "icu_sepsis"][:12]


@pytest.mark.parametrize("name", FAMILIES)
def test_families_come_back_bit_by_bit(name, tmp_path):
    family = bench.families()[name]
    for mdp in (family.simulator, family.target):
        assert_same(mdp, there_and_back(mdp, tmp_path))


@settings(max_examples=60)
@given(mdps(), st.booleans(), st.integers(0, 2**32 - 1))
def test_any_mdp_comes_back_bit_by_bit(tmp_path_factory, mdp, has_gaps, seed):
    if has_gaps:
        mdp = with_gaps(mdp, np.random.default_rng(seed))
    assert_same(mdp, there_and_back(mdp, tmp_path_factory.mktemp("umb")))


@pytest.mark.parametrize("discount", [0.0, 1e-9, 0.3, 0.99, 1.0])
@pytest.mark.parametrize("form", [1, 2, 3])
def test_every_discount_and_form_of_rewards(discount, form, tmp_path):
    rng = np.random.default_rng(form)
    mdp = random_mdp(rng, form=form).with_discount(discount)
    assert_same(mdp, there_and_back(mdp, tmp_path))


def test_all_that_an_mdp_knows_comes_back(tmp_path):
    log = oee.Transitions(
        [0, 0, 1], [0, 0, 0], [0, 1, 1], [0.5, 1.0, 0.0], terminated=[0, 0, 1]
    )
    sampled = oee.FiniteMDP.from_log(log, discount=0.9, initial={0: 0.3, 1: 0.7})
    assert sampled.sampling is not None
    assert_same(sampled, there_and_back(sampled, tmp_path))
    named = oee.tasks.gridworld(2, 0.1).with_names(
        ["héllo", (1, 2), ("a", 3), "d"], ["up", ("x", 1), "left", "right"]
    )
    for layout in ((2, 2), [0.5, 1.0, 2.0, 1e-300], None):
        placed = named.with_layout(layout)
        assert_same(placed, there_and_back(placed, tmp_path))
    undefined = np.full((2, 1, 2), np.nan)
    undefined[0, 0], undefined[1, 0, 1] = [1.0, 2.0], 3.0
    wider = oee.FiniteMDP([[[0.0, 1.0]], [[0.0, 1.0]]], undefined, 0, 0.5)
    back = there_and_back(wider, tmp_path)
    assert_same(wider, back)
    assert back.transition_rewards[0, 0] == 1.0  # outside the support of P


def test_the_same_mdp_makes_the_same_bytes(tmp_path):
    mdp = oee.tasks.gridworld(3, 0.1)
    for name in ("a.umb", "b.UMB"):
        mdp.save(tmp_path / name)
    assert (tmp_path / "a.umb").read_bytes() == (tmp_path / "b.UMB").read_bytes()


def test_the_command_writes_and_reads_it(tmp_path, capsys):
    path, log = str(tmp_path / "m.umb"), str(tmp_path / "log.npz")
    assert run_command("export", "gridworld:3,slip=0.3", "--output", path) == 0
    assert_same(oee.tasks.gridworld(3, 0.3), oee.FiniteMDP.load(path))
    grid = oee.tasks.gridworld(3, 0.3)
    oee.sample_episodes(grid, oee.uniform_policy(grid), 5, 20, seed=0).save(log)
    words = (
        "--simulator",
        path,
        "--log",
        log,
        "--policy",
        "uniform",
        "--discount",
        "0.9",
    )
    assert run_command("evaluate", *words) == 0
    assert "discount 0.9" in capsys.readouterr().out


def total_reward(path, name="reward"):
    """The largest total reward until `end`, of the file's own states and rewards."""
    text = index_of(path)
    text["file-data"]["tool"] = "another"
    changed = path.with_name("other.umb")
    write_members(changed, members_of(path) | {"index.json": json.dumps(text).encode()})
    model = oee.FiniteMDP.load(changed, reward=name, until="end")
    if name == "cost":
        model = model.with_rewards(-model.rewards)
    return oee.policy_value(model, oee.optimal_policy(model))


@pytest.mark.parametrize("form", [1, 2, 3])
def test_total_reward_of_the_file_is_the_discounted_value(form, tmp_path):
    rng = np.random.default_rng(form)
    mdp = random_mdp(rng, form=form, discount=0.8)
    mdp = mdp.with_rewards(mdp.rewards - mdp.rewards.mean())
    best = oee.policy_value(mdp, oee.optimal_policy(mdp))
    path = tmp_path / "m.umb"
    mdp.save(path)
    assert total_reward(path) == pytest.approx(best, abs=1e-12)
    more = -mdp.rewards.min() / (1.0 - 0.8)
    assert total_reward(path, "shifted") == pytest.approx(best + more, abs=1e-11)
    losses = mdp.with_rewards(mdp.rewards - mdp.rewards.max())
    losses.save(path)
    best = oee.policy_value(losses, oee.optimal_policy(losses))
    assert total_reward(path, "cost") == pytest.approx(best, abs=1e-12)


# ---- files by others


def members_of(path):
    with tarfile.open(path) as archive:
        return {
            member.name: archive.extractfile(member).read()
            for member in archive
            if member.isreg()
        }


def index_of(path):
    return json.loads(members_of(path)["index.json"])


def write_members(path, members, pack=gzip.compress):
    raw = io.BytesIO()
    with tarfile.open(fileobj=raw, mode="w") as archive:
        for name, data in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    path.write_bytes(pack(raw.getvalue()))


def model(**changes):
    """Three states: two choices in the first, one in each other; `changes` of members."""
    system = {
        "time": "discrete",
        "#players": 1,
        "#states": 3,
        "#initial-states": 1,
        "#choices": 4,
        "#choice-actions": 2,
        "#branches": 6,
        "#branch-actions": 0,
        "#observations": 0,
        "branch-probability-type": {"type": "double", "size": 64},
    }
    double = {"type": "double", "size": 64}
    flag = {"type": "bool", "size": 1}
    index = {
        "format-version": 1,
        "format-revision": 0,
        "transition-system": system,
        "annotations": {
            "rewards": {
                "time": {"applies-to": ["states"], "type": double},
                "all": {
                    "alias": "all of them",
                    "applies-to": ["states", "choices", "branches"],
                    "type": double,
                },
            },
            "aps": {"goal": {"applies-to": ["states"], "type": flag}},
        },
        "valuations": {
            "states": {
                "unique": True,
                "classes": [
                    {
                        "variables": [
                            {"name": "x", "type": {"type": "uint", "size": 2}},
                            {"name": "b", "type": {"type": "bool", "size": 1}},
                            {
                                "name": "y",
                                "type": {"type": "int", "size": 3},
                                "offset": 1,
                            },
                            {"padding": 2},
                        ]
                    }
                ],
            }
        },
    }
    rewards = "annotations/rewards"
    members = {
        "state-is-initial.bin": bytes([0b001]) + bytes(7),
        "state-to-choices.bin": np.array([0, 2, 3, 4], "<u8").tobytes(),
        "choice-to-branches.bin": np.array([0, 2, 4, 5, 6], "<u8").tobytes(),
        "branch-to-target.bin": np.array([1, 2, 0, 2, 2, 2], "<u8").tobytes(),
        "branch-to-probability.bin": np.array([0.3, 0.7, 0.5, 0.5, 1, 1]).tobytes(),
        "actions/choices/values.bin": np.array([0, 1, 1, 0], "<u4").tobytes(),
        "actions/choices/strings.bin": b"goleap",
        "actions/choices/string-mapping.bin": np.array([0, 2, 6], "<u8").tobytes(),
        f"{rewards}/time/states/values.bin": np.array([1.0, 1.0, 0.0]).tobytes(),
        f"{rewards}/all/states/values.bin": np.array([1.0, 2.0, 0.0]).tobytes(),
        f"{rewards}/all/choices/values.bin": np.array(
            [10.0, 20.0, 30.0, 0.0]
        ).tobytes(),
        f"{rewards}/all/branches/values.bin": np.array(
            [1e2, 2e2, 3e2, 4e2, 5e2, 0]
        ).tobytes(),
        "annotations/aps/goal/states/values.bin": bytes([0b100]) + bytes(7),
        # x = 3, b = false, y = -2 + 1; ...
        "valuations/states/valuations.bin": bytes([0b110011, 0b000101, 0b001010]),
    }
    for name, change in changes.items():
        if name == "system":
            system |= change
        elif name == "index":
            index |= change
        elif change is None:
            del members[name]
        else:
            members[name] = change
    return {"index.json": json.dumps(index).encode()} | members


def load(folder, members, pack=gzip.compress, **options):
    path = folder / "given.umb"
    write_members(path, members, pack)
    return oee.FiniteMDP.load(path, **options)


@pytest.mark.parametrize("pack", [gzip.compress, lzma.compress, bytes])
def test_reads_choices_rewards_and_names(pack, tmp_path):
    mdp = load(tmp_path, model(), pack, reward="all of them")
    assert mdp.action_names == ("go", "leap")
    assert mdp.state_names == ((3, 0, -1), (1, 1, 1), (2, 0, 2))
    assert_array_equal(mdp.available, [[True, True], [False, True], [True, False]])
    expected = np.zeros((6, 3))
    expected[[0, 0, 1, 1, 3, 4], [1, 2, 0, 2, 2, 2]] = [0.3, 0.7, 0.5, 0.5, 1, 1]
    assert_array_equal(mdp.transitions.toarray(), expected)
    paid = mdp.transition_rewards.toarray()
    assert_array_equal(paid[0], [0.0, 111.0, 211.0])
    assert_array_equal(paid[1], [321.0, 0.0, 421.0])
    assert_array_equal(paid[3], [0.0, 0.0, 532.0])
    assert (mdp.discount, mdp.initial.tolist()) == (1.0, [1.0, 0.0, 0.0])
    ended = load(tmp_path, model(), pack, reward="time", until="goal")
    assert oee.policy_value(ended, oee.optimal_policy(ended)) == pytest.approx(2.0)


def test_success_pays_one_on_entering_a_label(tmp_path):
    mdp = load(tmp_path, model(), success="goal")
    assert mdp.absorbing().tolist() == [False, False, True]
    assert oee.policy_value(mdp, oee.optimal_policy(mdp)) == pytest.approx(1.0)
    assert mdp.with_discount(0.5).rewards[0].tolist() == [0.7, 0.5]


def test_choices_of_one_action_are_numbered(tmp_path):
    same = {"actions/choices/values.bin": np.zeros(4, "<u4").tobytes()}
    mdp = load(tmp_path, model(**same), reward="time")
    assert mdp.action_names is None
    assert_array_equal(mdp.available, [[True, True], [True, False], [True, False]])


def test_a_markov_chain_has_one_action(tmp_path):
    members = model(
        **{
            "system": {"#players": 0, "#choices": 3, "#choice-actions": 0},
            "state-to-choices.bin": None,
            "choice-to-branches.bin": np.array([0, 2, 4, 6], "<u8").tobytes(),
            "branch-to-probability.bin": np.array(
                [0.3, 0.7, 0.5, 0.5, 0.5, 0.5]
            ).tobytes(),
        }
    )
    mdp = load(tmp_path, members, reward="time")
    # two branches that lead to one state are one transition
    assert mdp.transitions.toarray().tolist() == [
        [0, 0.3, 0.7],
        [0.5, 0, 0.5],
        [0, 0, 1],
    ]


def test_rational_numbers_are_read(tmp_path):
    pairs = [(3, 10), (7, 10), (1, 2), (1, 2), (1, 1), (1, 1)]
    data = b"".join(
        a.to_bytes(8, "little", signed=True) + b.to_bytes(8, "little") for a, b in pairs
    )
    kind = {"branch-probability-type": {"type": "rational", "size": 128}}
    mdp = load(
        tmp_path,
        model(system=kind, **{"branch-to-probability.bin": data}),
        reward="time",
    )
    assert mdp.transitions.data.tolist()[:2] == [0.3, 0.7]
    zero = data[:8] + bytes(8) + data[16:]
    with pytest.raises(ArgumentError, match="no denominator 0"):
        load(tmp_path, model(system=kind, **{"branch-to-probability.bin": zero}))


INTERVALS = {"branch-probability-type": {"type": "double-interval", "size": 128}}
OBSERVED = {"#observations": 2, "observations-apply-to": "states"}
GAME = {"#players": 2, "player-names": ["a", "b"]}


@pytest.mark.parametrize(
    ("system", "text"),
    [
        (OBSERVED, "a POMDP"),
        ({"time": "stochastic"}, "continuous time"),
        ({"time": "urgent-stochastic"}, "a Markov automaton"),
        (GAME, "a game of 2 players"),
        (INTERVALS, "an interval model"),
        (
            {"branch-probability-type": {"type": "rational-function"}},
            "a parametric model",
        ),
        ({"branch-probability-type": None}, "without"),
        ({"#initial-states": 0}, "one initial state; it has 0"),
        ({"#states": 2**60}, "a choice in each state"),
        ({"#branches": 2**61}, "bytes in branch-to-target.bin"),
        ({"#choices": -1}, "unsigned"),
        ({"#states": "three"}, "integer"),
        ({"#choice-actions": 1}, "actions below 1"),
    ],
)
def test_another_kind_of_model_is_refused_with_what_it_is(system, text, tmp_path):
    members = model()
    index = json.loads(members["index.json"])
    index["transition-system"] |= system
    if system.get("branch-probability-type", 0) is None:
        del index["transition-system"]["branch-probability-type"]
    members["index.json"] = json.dumps(index).encode()
    with pytest.raises(ArgumentError, match=text) as error:
        load(tmp_path, members, reward="time")
    assert "given.umb" in str(error.value)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"branch-to-target.bin": None}, "must have the member branch-to-target"),
        (
            {"branch-to-target.bin": b"1234567"},
            "must have 48 bytes in branch-to-target",
        ),
        ({"branch-to-target.bin": b"\xff" * 48}, "smaller integers"),
        ({"branch-to-target.bin": np.full(6, 3, "<u8").tobytes()}, "leads to 3"),
        (
            {"state-to-choices.bin": np.array([0, 3, 2, 4], "<u8").tobytes()},
            "offsets in order",
        ),
        (
            {"state-to-choices.bin": np.array([0, 3, 3, 4], "<u8").tobytes()},
            "state 1 has none",
        ),
        (
            {"choice-to-branches.bin": np.array([0, 4, 4, 5, 6], "<u8").tobytes()},
            "branch in each choice",
        ),
        ({"branch-to-probability.bin": np.full(6, 0.4).tobytes()}, "sum to 1"),
        ({"branch-to-probability.bin": np.full(6, np.nan).tobytes()}, "finite|nan"),
        (
            {"state-is-initial.bin": bytes([0b011]) + bytes(7)},
            "one initial state; it has 2",
        ),
        ({"state-is-initial.bin": b""}, "must have 3 bits"),
        (
            {
                "actions/choices/string-mapping.bin": np.array(
                    [0, 9, 6], "<u8"
                ).tobytes()
            },
            "offsets in order",
        ),
        ({"actions/choices/strings.bin": b"\xff\xfe\xfd\xfc\xfb\xfa"}, "UTF-8"),
        ({"annotations/rewards/time/states/values.bin": b""}, "must have 24 bytes"),
    ],
)
def test_members_that_contradict_the_index_are_refused(changes, text, tmp_path):
    with pytest.raises(ValueError, match=text) as error:
        load(tmp_path, model(**changes), reward="time")
    assert "given.umb" in str(error.value)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "reward must say which rewards .* 'time', 'all of them'.*labels: 'goal'"),
        ({"reward": "tim"}, "reward must be one of the rewards"),
        ({"reward": 3}, "reward must be one of the rewards"),
        ({"success": "gaol"}, "success must be one of the labels"),
        ({"reward": "time", "until": ""}, "until must be one of the labels"),
        (
            {"reward": "time", "success": "goal"},
            "success must be left out where reward",
        ),
    ],
)
def test_bad_choices_of_rewards_are_refused(options, text, tmp_path):
    with pytest.raises(ArgumentError, match=text):
        load(tmp_path, model(), **options)


def test_options_are_for_files_by_others(tmp_path):
    mdp = oee.tasks.gridworld(2, 0.1)
    for name in ("m.umb", "m.npz"):
        mdp.save(tmp_path / name)
        with pytest.raises(ArgumentError, match="reward must be left out"):
            oee.FiniteMDP.load(tmp_path / name, reward="reward")


@pytest.mark.parametrize("seed", range(3))
def test_damaged_files_are_refused_by_name(seed, tmp_path):
    """Cut off, of other bytes, or of members that were edited: an error that says so."""
    rng = np.random.default_rng(seed)
    path = tmp_path / "m.umb"
    oee.tasks.gridworld(2, 0.1).save(path)
    whole = path.read_bytes()
    damaged = [whole[: rng.integers(len(whole))] for _ in range(10)]
    for place in rng.integers(len(whole), size=10):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << rng.integers(8)
        damaged.append(bytes(flipped))
    for data in damaged:
        path.write_bytes(data)
        refuse_or_load(path)
    members = members_of_bytes(whole)
    for name in members:
        for change in (b"", members[name][:-8], bytes(len(members[name]))):
            write_members(path, members | {name: change})
            refuse_or_load(path)


def refuse_or_load(path):
    """Load a file, or get an error that names it: some bits of a header say nothing."""
    try:
        oee.FiniteMDP.load(path)
    except ValueError as error:
        found = error
    else:
        return
    assert path.name in str(found)


def members_of_bytes(data):
    with tarfile.open(fileobj=io.BytesIO(data)) as archive:
        return {member.name: archive.extractfile(member).read() for member in archive}


def test_a_bomb_is_refused_before_it_is_unpacked(monkeypatch, tmp_path):
    monkeypatch.setattr(umb_files, "MAX_UNPACKED_BYTES", 2**20)
    for label in ("branch-to-target.bin", "other", "index.json"):
        members = {label: bytes(2**22)} | (model() if label == "other" else {})
        for pack in (gzip.compress, lzma.compress):
            with pytest.raises(
                ArgumentError, match="unpacks to more than 1048576 bytes"
            ):
                load(tmp_path, members, pack)


@pytest.mark.parametrize(
    "data",
    [b"", b"PK\x03\x04", b"\x1f\x8b", b"BZh9", b"\xfd7zXZ\x00", b"{}", bytes(2000)],
)
def test_other_files_are_refused(data, tmp_path):
    path = tmp_path / "m.umb"
    path.write_bytes(data)
    with pytest.raises(ArgumentError, match=r"m\.umb' must be a \.umb file"):
        oee.FiniteMDP.load(path)


@pytest.mark.parametrize("text", ["[]", "{}", "[" * 100_000, "null", "{", '"a"'])
def test_an_index_that_is_none_is_refused(text, tmp_path):
    with pytest.raises(ArgumentError, match=r"must be a \.umb file"):
        load(tmp_path, model() | {"index.json": text.encode()})


def test_a_member_that_stands_twice_is_refused(tmp_path):
    path = tmp_path / "m.umb"
    raw = io.BytesIO()
    with tarfile.open(fileobj=raw, mode="w") as archive:
        for name in ("index.json", "./index.json"):
            archive.addfile(tarfile.TarInfo(name))
    path.write_bytes(raw.getvalue())
    with pytest.raises(ArgumentError, match=r"holds 'index\.json' twice"):
        oee.FiniteMDP.load(path)


# ---- Storm


COIN = "mdp/coin2-2.nm"  # consensus by shared coins: states of one and two choices


def storm():
    return pytest.importorskip("stormpy", reason="the extra storm")


def ask(model, query):
    """Storm's value of a query in the first state, to 1e-12."""
    stormpy = storm()
    environment = stormpy.environments.sound()
    environment.solver().min_max().precision = stormpy.Rational("1/1000000000000")
    found = stormpy.model_checking(
        model, stormpy.parse_properties(query)[0], environment=environment
    )
    return found[model.initial_states[0]].value


@pytest.mark.parametrize("form", [1, 2, 3])
@pytest.mark.parametrize("has_gaps", [False, True])
def test_storm_finds_our_optimum_in_our_file(form, has_gaps, tmp_path):
    stormpy = storm()
    rng = np.random.default_rng(form)
    mdp = random_mdp(rng, form=form, discount=0.9)
    if has_gaps:
        mdp = with_gaps(mdp, rng)
    path = tmp_path / "m.umb"
    for shift, query, sign in (
        (mdp.rewards.min(), 'R{"reward"}max=? [F "end"]', 1.0),
        (mdp.rewards.max(), 'R{"cost"}min=? [F "end"]', -1.0),
    ):
        moved = mdp.with_rewards(mdp.rewards - shift)
        moved.save(path)
        best = oee.policy_value(moved, oee.optimal_policy(moved))
        found = sign * ask(stormpy.build_model_from_umb(str(path)), query)
        assert found == pytest.approx(best, abs=1e-9)


def test_storm_keeps_our_file(tmp_path):
    """What Storm reads of it and writes again has the same value as the MDP."""
    stormpy = storm()
    from stormpy.io import export_to_umb

    mdp = oee.tasks.gridworld(3, 0.1)
    mdp.save(tmp_path / "a.umb")
    export_to_umb(
        stormpy.build_model_from_umb(str(tmp_path / "a.umb")), str(tmp_path / "b.umb")
    )
    back = oee.FiniteMDP.load(tmp_path / "b.umb", reward="reward", until="end")
    value = oee.policy_value(mdp, oee.optimal_policy(mdp))
    assert oee.policy_value(back, oee.optimal_policy(back)) == pytest.approx(
        value, abs=1e-9
    )


def test_coin_is_read_and_evaluated_as_storm_does(tmp_path):
    stormpy = storm()
    from stormpy.examples import files
    from stormpy.io import export_to_umb

    program = stormpy.parse_prism_program(f"{files.testfile_dir}/{COIN}")
    options = stormpy.BuilderOptions()
    options.set_build_state_valuations(True)
    options.set_build_all_labels(True)
    options.set_build_all_reward_models(True)
    coin = stormpy.build_model(program, options=options)
    path = tmp_path / "coin.umb"
    export_to_umb(coin, str(path))
    mdp = oee.FiniteMDP.load(path, until="finished")
    assert (mdp.n_states, int(mdp.available.sum())) == (272, 400)
    assert mdp.state_names[0] == (6, 0, 0, 0, 0)
    for sign, extreme in ((1.0, "max"), (-1.0, "min")):
        best = mdp.with_rewards(sign * mdp.rewards)
        value = sign * oee.policy_value(best, oee.optimal_policy(best))
        found = ask(coin, f'R{{"steps"}}{extreme}=? [F "finished"]')
        assert value == pytest.approx(found, abs=1e-8)
    won = oee.FiniteMDP.load(path, success="all_coins_equal_1", until="finished")
    for sign, extreme in ((1.0, "max"), (-1.0, "min")):
        best = won.with_rewards(sign * won.rewards)
        value = sign * oee.policy_value(best, oee.optimal_policy(best))
        found = ask(coin, f'P{extreme}=? [F "finished" & "all_coins_equal_1"]')
        assert value == pytest.approx(found, abs=1e-8)


@pytest.mark.parametrize(
    ("kind", "name", "text"),
    [
        ("pomdp", "maze_2.prism", "a POMDP"),
        ("ctmc", "tiny.sm", "continuous time"),
        ("ma", "simple.ma", "a Markov automaton"),
        ("smg", "example_smg.nm", "a game"),
    ],
)
def test_storms_other_kinds_are_refused_with_what_they_are(kind, name, text, tmp_path):
    stormpy = storm()
    from stormpy.examples import files
    from stormpy.io import export_to_umb

    program = stormpy.parse_prism_program(
        f"{files.testfile_dir}/{kind}/{name}", prism_compatibility=kind == "ctmc"
    )
    options = stormpy.BuilderOptions()
    options.set_build_choice_labels(True)
    built = stormpy.build_model(program, options=options)
    export_to_umb(built, str(tmp_path / "m.umb"))
    with pytest.raises(ArgumentError, match=text):
        oee.FiniteMDP.load(tmp_path / "m.umb")
