"""CartPole, Reacher and the simulated stand-in of the Gen3: dynamics, policies, logs."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse
from scipy.integrate import solve_ivp

import oee_tabular as oee
from oee_tabular.continuous.task.cartpole import ANGLE_LIMIT, EXPERT
from oee_tabular.continuous.task.gen3 import HOME, STEP, end_effector, resolved_rates
from oee_tabular.continuous.task.reacher import (
    STOP,
    fingertip,
    joint_angles,
    link_bodies,
)
from oee_tabular.data import ContinuousTransitions
from oee_tabular.tasks import (
    CartPole,
    Reacher,
    cartpole_policy,
    discretize,
    gymnasium_simulator,
    kinova,
    monte_carlo_value,
    reacher_policy,
    record,
    resimulate,
    train_expert,
)


@pytest.mark.parametrize("gravity", [7.5, 9.8, 15.0])
def test_one_step_is_gymnasium_s_to_the_last_bit(gravity):
    rng = np.random.default_rng(0)
    states = rng.uniform([-2.45, -3, -0.22, -4], [2.45, 3, 0.22, 4], (3000, 4))
    actions = rng.integers(0, 2, 3000)
    theirs = gymnasium_simulator(f"CartPole-v1:gravity={gravity}").task.step(
        states, actions, rng
    )
    ours = CartPole(gravity, noise=0.0).step(states, actions, rng)
    assert_array_equal(ours.next_state, theirs.next_state)
    assert_array_equal(ours.terminated, theirs.terminated)
    assert_array_equal(ours.reward, theirs.reward)


@given(st.floats(0, 30), st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_laws_of_cartpole_s_step(gravity, seed):
    """Mirror symmetry; the angle does not see the cart; gravity enters linearly; noise
    is added at the end.
    """
    rng = np.random.default_rng(seed)
    states = rng.uniform(-0.2, 0.2, (20, 4))
    actions = rng.integers(0, 2, 20)
    xi = rng.standard_normal((20, 4))
    task = CartPole(gravity, noise=0.01)
    moved = task.moves(states, actions, xi)
    assert_allclose(
        task.moves(-states, 1 - actions, -xi).next_state,
        -moved.next_state,
        rtol=0,
        atol=1e-15,
    )
    elsewhere = states + np.array([1.0, 0.3, 0.0, 0.0])
    assert_array_equal(
        task.moves(elsewhere, actions, xi).next_state[:, 2:], moved.next_state[:, 2:]
    )
    still = CartPole(gravity, noise=0.0).moves(states, actions, xi).next_state
    assert_allclose(moved.next_state - still, 0.01 * xi, rtol=0, atol=1e-14)
    none, twice = (
        CartPole(g, 0.0).moves(states, actions, xi).next_state
        for g in (0.0, 2 * gravity)
    )
    assert_allclose(none + twice, 2 * still, rtol=0, atol=1e-12)


def test_the_failing_step_has_a_reward_too():
    """A pole that never falls is worth 1 - 0.99^100 = 0.633967658726771 (the paper's
    ceiling).
    """
    falling = np.array([[0.0, 0.0, ANGLE_LIMIT - 1e-3, 1.0], [0.0, 0.0, 0.0, 0.0]])
    moved = CartPole().moves(falling, np.array([1, 1]), np.zeros((2, 4)))
    assert_array_equal(moved.terminated, [True, False])
    assert_array_equal(moved.reward, [1.0, 1.0])
    model = discretize(CartPole(), cells=(20, 20), closure_episodes=0)
    assert_array_equal(model.mdp.rewards[:-1], 1.0)
    assert_array_equal(model.mdp.rewards[-1], 0.0)
    stands = model.mdp.with_transitions(
        sparse.kron(sparse.eye_array(model.mdp.n_states), np.ones((2, 1)), "csr")
    )
    ceiling = oee.policy_value(
        stands, oee.uniform_policy(stands), horizon=100, normalized=True
    )
    assert_allclose(ceiling, 0.633967658726771, rtol=1e-12)


def test_the_shipped_expert_is_the_trained_one():
    assert train_expert() == EXPERT
    assert train_expert(seed=1) == train_expert(seed=1) != EXPERT


def test_cartpole_s_policies():
    states = record(
        CartPole(), cartpole_policy(0.5), n_transitions=200, max_steps=100, seed=0
    ).state
    expert = cartpole_policy(0.0)(states)
    uniform = cartpole_policy(1.0)(states)
    assert_array_equal(uniform, 0.5)
    assert_allclose(cartpole_policy(0.3)(states), 0.3 * uniform + 0.7 * expert)
    firm = cartpole_policy(0.0, deterministic=True)(states)
    assert_array_equal(firm[:, 1], expert[:, 1] > 0.5)
    right = 1 / (
        1 + np.exp(-(EXPERT[0] * states[:, 2] + EXPERT[1] * states[:, 3] + EXPERT[2]))
    )
    assert_allclose(expert[:, 1], right)


def test_records_say_what_happened():
    log = record(
        CartPole(noise=0.0), cartpole_policy(0.3), n_episodes=40, max_steps=30, seed=0
    )
    assert_array_equal(log.reward, 1.0)
    starts = np.flatnonzero(log.timestep == 0)
    assert len(starts) == 40
    lengths = np.diff(np.append(starts, len(log)))
    assert lengths.max() == 30
    ends = np.append(starts[1:], len(log)) - 1
    assert_array_equal(log.terminated[ends] ^ log.truncated[ends], True)
    assert_array_equal(np.abs(log.next_state[:, 2]) > ANGLE_LIMIT, log.terminated)
    again = resimulate(CartPole(noise=0.0), log)
    assert_array_equal(again.next_state, log.next_state)
    chosen = cartpole_policy(0.3)(log.state)[np.arange(len(log)), log.action]
    assert_allclose(log.behavior_probability, chosen)
    assert (
        abs((log.action == 1).mean() - cartpole_policy(0.3)(log.state)[:, 1].mean())
        < 0.05
    )


def test_the_same_seed_gives_the_same_bits():
    one, two, other = (
        record(
            CartPole(), cartpole_policy(0.3), n_transitions=3000, max_steps=100, seed=s
        )
        for s in (1, 1, 2)
    )
    assert_array_equal(one.next_state, two.next_state)
    assert not np.array_equal(one.next_state, other.next_state)
    # a shorter log is the beginning of a longer one
    short = record(
        CartPole(), cartpole_policy(0.3), n_transitions=1000, max_steps=100, seed=1
    )
    assert_array_equal(short.state, one.state[:1000])
    # also within the first episode, which does not go on where the log has ended
    endless = record(
        CartPole(), cartpole_policy(0.3), n_transitions=20, max_steps=10**12, seed=1
    )
    assert_array_equal(endless.state, one.state[:20])
    values = [
        monte_carlo_value(CartPole(), cartpole_policy(0.3), 5000, 100, seed=4)
        for _ in range(2)
    ]
    assert values[0] == values[1]


# ---------------------------------------------------------------- Reacher


LENGTHS = [0.05, 0.1, 0.2]
seeds = st.integers(0, 2**32 - 1)


def states_of(rng, n, speed=4.0):
    return rng.uniform([-3.0, -2.5, -speed, -speed], [3.0, 2.5, speed, speed], (n, 4))


def links(q2, length, kind="box"):
    """Mass, moment, Jacobian of the centre (in the frame of the upper link) and turn of
    each link, without the step.
    """
    for k, (mass, r, moment) in enumerate(link_bodies(length, kind)):
        along = np.array([-np.sin(q2), np.cos(q2)])
        upper = np.array([[0.0, 0.0], [r, 0.0]])
        lower = np.column_stack([[0.0, length] + r * along, r * along])
        yield mass, moment, lower if k else upper, np.array([1.0, float(k > 0)])


def inertia(q2, length, kind="box"):
    """M(q) from the Jacobians of the centres of mass, link by link."""
    return sum(
        m * jac.T @ jac + moment * np.outer(turn, turn)
        for m, moment, jac, turn in links(q2, length, kind)
    )


def test_small_steps_converge_to_the_equations_of_motion():
    """Against Lagrange's equations with derivatives of M taken numerically, by an
    adaptive Runge-Kutta method.
    """
    length = 0.1
    torque = np.array([0.02, -0.01])

    def motion(t, s):
        step = 1e-6
        slope = (inertia(s[1] + step, length) - inertia(s[1] - step, length)) / (
            2 * step
        )
        w = s[2:]
        force = (
            torque - 1e-3 * w - s[3] * slope @ w + np.array([0.0, 0.5 * w @ slope @ w])
        )
        return np.concatenate([w, np.linalg.solve(inertia(s[1], length), force)])

    start = np.array([0.1, 0.8, 1.0, -2.0])
    exact = solve_ivp(motion, (0, 0.1), start, rtol=1e-10, atol=1e-12).y[:, -1]
    arm = Reacher(
        length, gear=1.0, damping=1e-3, drag=0.0, timestep=1e-5, substeps=10_000
    )
    assert_allclose(arm.advance(start[None], torque[None])[0], exact, rtol=0, atol=2e-3)


@given(seeds, st.sampled_from(LENGTHS), st.booleans())
@settings(max_examples=20)
def test_laws_of_reacher_s_step(seed, length, tamed):
    """Mirror images, the shoulder's angle as a mere rotation, 2 pi, and the elbow's
    stop.
    """
    rng = np.random.default_rng(seed)
    arm = Reacher.tamed(length) if tamed else Reacher(length)
    states = states_of(rng, 20)
    commands = rng.uniform(-1, 1, (20, 2))
    after = arm.advance(states, commands)
    assert_allclose(arm.advance(-states, -commands), -after, rtol=0, atol=1e-12)
    turned = states + np.array([0.7, 0.0, 0.0, 0.0])
    assert_allclose(
        arm.advance(turned, commands),
        after + np.array([0.7, 0.0, 0.0, 0.0]),
        rtol=0,
        atol=1e-12,
    )
    assert_allclose(
        fingertip(states + np.array([2 * np.pi, 0, 0, 0]), length),
        fingertip(states, length),
        atol=1e-12,
    )
    assert (np.abs(after[:, 1]) <= STOP).all()


@given(seeds, st.sampled_from(LENGTHS))
def test_drag_is_a_force_at_each_centre_and_a_torque_on_each_link(seed, length):
    """Bullet's law from the velocities of the centres of mass; the torques of that,
    without drag, make the same step.
    """
    states = states_of(np.random.default_rng(seed), 20, speed=10.0)
    k = 0.04
    torques = np.zeros((20, 2))
    for row, (_, q2, w1, w2) in zip(torques, states, strict=True):
        for mass, moment, jacobian, turn in links(q2, length):
            velocity = jacobian @ (w1, w2)
            spin = turn @ (w1, w2)
            row -= jacobian.T @ (k * mass * velocity * (1 + np.hypot(*velocity)))
            row -= turn * k * moment * spin * (1 + abs(spin))
    arm, drawn = (
        Reacher(length, gear=1.0, drag=drag, timestep=1e-3) for drag in (0.0, k)
    )
    braked = drawn.advance(states, np.zeros((20, 2)))
    still = arm.advance(states, np.zeros((20, 2)))
    pushed = arm.advance(states, torques)
    assert_allclose(braked, pushed, rtol=1e-12, atol=1e-14)
    assert np.abs(braked - still)[:, 2:].max() > 1e-4


def test_the_elbow_s_stop():
    """The elbow stops, and its impulse leaves the shoulder's generalised momentum
    alone.
    """
    arm = Reacher(0.1, drag=0.0, timestep=1e-4)
    state = np.array([[0.0, STOP - 1e-6, 0.5, 3.0]])
    after = arm.advance(state, np.zeros((1, 2)))[0]
    assert after[1] == STOP
    assert after[3] == 0.0
    assert_allclose(
        inertia(STOP, 0.1)[0] @ after[2:],
        inertia(STOP, 0.1)[0] @ state[0, 2:],
        rtol=1e-3,
    )
    at_stop = arm.reward_terms(
        np.array([[0, 2.98, 0, 0], [0, -3.0, 0, 0], [0, 2.9, 0, 0]])
    )[:, 3]
    assert_array_equal(at_stop, [1, 1, 0])


def test_kinematics_by_hand():
    states = np.array(
        [[0, 0, 0, 0], [np.pi / 2, 0, 0, 0], [0, np.pi, 0, 0], [0, np.pi / 2, 0, 0]],
        dtype=float,
    )
    assert_allclose(
        fingertip(states, 0.1),
        [[0.21, 0], [0, 0.21], [-0.01, 0], [0.1, 0.11]],
        atol=1e-15,
    )
    for target in ((0.1, 0.1), (-0.05, 0.12), (0.0, -0.2)):
        q1, q2 = joint_angles(target)
        assert_allclose(
            fingertip(np.array([[q1, q2, 0, 0]]), 0.1)[0], target, atol=1e-12
        )


def test_reacher_s_reward_by_hand():
    """100 (drop in distance) - .01 sum |a| (1 + |w'|) - .1 at the stop: action 8 has
    both levels at 2/3.
    """
    task = Reacher(0.1, target=(0.31, 0.0))
    states = np.array([[0.0, 0.0, 0.0, 0.0]])
    following = np.array([[np.pi / 2, 2.99, 3.0, -6.0]])
    away = np.hypot(*(fingertip(following, 0.1)[0] - [0.31, 0.0]))
    wanted = 100 * (0.1 - away) - 0.01 * (2 / 3) * (1 + 3 + 1 + 6) - 0.1
    assert_allclose(task.reward_between(states, np.array([8]), following), wanted)
    assert_allclose(Reacher(0.2, 0.1).distance(states), Reacher(0.1).distance(states))
    moved = task.moves(states, np.array([3]), np.zeros((1, 0)))
    assert_allclose(
        moved.reward, task.reward_between(states, np.array([3]), moved.next_state)
    )
    assert not moved.terminated.any()


def test_the_masses_are_bullet_s():
    """.0356, .0670, .0199 kg at .1, .2, .05 m; the tip .00419 kg; the capsule's inertia
    by integration.
    """
    assert_allclose(
        [link_bodies(x)[0, 0] for x in (0.1, 0.2, 0.05)],
        [0.0356, 0.0670, 0.0199],
        atol=5e-5,
    )
    rng = np.random.default_rng(0)
    inside = rng.uniform([-0.06, -0.01, -0.01], [0.06, 0.01, 0.01], (400_000, 3))
    past = np.maximum(np.abs(inside[:, 0]) - 0.05, 0.0)
    inside = inside[past**2 + inside[:, 1] ** 2 + inside[:, 2] ** 2 < 1e-4]
    mass, _, moment = link_bodies(0.1, "capsule")[0]
    assert_allclose(
        moment, mass * (inside[:, 0] ** 2 + inside[:, 1] ** 2).mean(), rtol=0.01
    )


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize(
    ("armature", "damping", "gear"),
    [(0.0, 1e-4, 0.05), (1.0, 1.0, 200.0)],
    ids=["free", "stock"],
)
def test_the_arm_is_mujoco_s(length, armature, damping, gear):
    """Gymnasium's Reacher with other links: armature 0, damping 1e-4, gear .05; and
    with its own 1, 1, 200.
    """
    mujoco = pytest.importorskip(
        "mujoco", reason="MuJoCo is not installed: pip install '.[mujoco]'"
    )
    import gymnasium

    text = (
        Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets" / "reacher.xml"
    ).read_text()
    for old, new in {
        'fromto="0 0 0 0.1 0 0"': f'fromto="0 0 0 {length} 0 0"',
        'name="body1" pos="0.1 0 0"': f'name="body1" pos="{length} 0 0"',
        'name="fingertip" pos="0.11 0 0"': (
            f'name="fingertip" pos="{length + 0.01} 0 0"'
        ),
        'armature="1" damping="1"': f'armature="{armature}" damping="{damping}"',
        'gear="200.0"': f'gear="{gear}"',
        'integrator="RK4" timestep="0.01"': 'integrator="Euler" timestep="0.01"',
    }.items():
        assert old in text
        text = text.replace(old, new)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    arm = Reacher(
        length,
        gear=gear,
        armature=armature,
        damping=damping,
        drag=0.0,
        timestep=0.01,
        substeps=2,
        inertia="capsule",
    )
    rng = np.random.default_rng(0)
    for state, command in zip(
        states_of(rng, 40), rng.uniform(-1, 1, (40, 2)), strict=True
    ):
        mujoco.mj_resetData(model, data)
        data.qpos[:2] = state[:2]
        data.qvel[:2] = state[2:]
        data.ctrl[:] = command
        mujoco.mj_step(model, data, 2)
        theirs = np.concatenate([data.qpos[:2], data.qvel[:2]])
        assert_allclose(
            arm.advance(state[None], command[None])[0], theirs, rtol=1e-9, atol=1e-9
        )
        assert_allclose(
            fingertip(theirs[None], length)[0], _tip(mujoco, model, data), atol=1e-12
        )


def _tip(mujoco, model, data):
    mujoco.mj_forward(model, data)
    return data.body("fingertip").xpos[:2]


def test_reacher_s_policies():
    states = states_of(np.random.default_rng(0), 50)
    expert = reacher_policy(0.0)(states)
    random = reacher_policy(1.0)(states)
    assert_array_equal(np.sort(expert, axis=1)[:, :-1], 0.0)
    assert_allclose(random, 1 / 9)
    assert_allclose(reacher_policy(0.3)(states), 0.3 * random + 0.7 * expert)
    there = np.array([[*joint_angles((0.1, 0.1)), 0.0, 0.0]])
    assert reacher_policy(0.0)(there)[0, 4] == 1.0  # no torque at rest on the target
    assert_array_equal(
        reacher_policy(0.2)(states + np.array([2 * np.pi, 0, 0, 0])),
        reacher_policy(0.2)(states),
    )


# ---------------------------------------------------------------- the arm


def needs_mujoco():
    return pytest.importorskip(
        "mujoco", reason="needs the extra: pip install '.[mujoco]'"
    )


def test_the_kinematics_of_the_fact_table():
    assert_allclose(
        end_effector(np.zeros((1, 7)))[0], [0.0, -0.02485, 1.18739], atol=1e-5
    )
    assert_allclose(end_effector(HOME[None])[0], [0.4567, 0.00135, 0.4337], atol=5e-5)


def test_resolved_rates_move_the_hand_as_asked():
    joints = HOME + 0.1 * np.random.default_rng(0).standard_normal((5, 7))
    velocity = np.array(
        [[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1], [0.1, -0.1, 0.1], [0, 0, 0]]
    )
    moved = (
        end_effector(joints + 1e-6 * resolved_rates(joints, velocity))
        - end_effector(joints)
    ) / 1e-6
    assert_allclose(moved, velocity, atol=4e-3)  # what the damping takes


def test_mujoco_agrees_with_the_kinematics():
    mujoco = needs_mujoco()
    from oee_tabular.continuous.task.gen3 import arm_xml

    model = mujoco.MjModel.from_xml_string(arm_xml())
    data = mujoco.MjData(model)
    assert_allclose(model.body_mass.sum(), 8.188, atol=1e-3)
    for joints in HOME + np.random.default_rng(1).standard_normal((5, 7)):
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        assert_allclose(data.site_xpos[0], end_effector(joints[None])[0], atol=1e-12)


def test_a_command_moves_the_hand_by_a_step_and_the_target_by_more():
    needs_mujoco()
    rng = np.random.default_rng(0)
    for scale in (1.0, 1.4):
        arm = kinova.KinovaArm(velocity_scale=scale, encoder_noise=0.0)
        state = arm.initial_states(27, rng)
        moved = (
            arm.moves(state, np.arange(27), np.zeros((27, 7))).next_state[:, :3]
            - state[:, :3]
        )
        assert_allclose(moved / STEP, scale * kinova.COMMANDS, atol=0.12)


def test_latency_keeps_the_last_command():
    needs_mujoco()
    arm = kinova.KinovaArm(latency=0.2, encoder_noise=0.0)
    state = arm.initial_states(1, np.random.default_rng(0))
    moved = arm.moves(state, np.array([26]), np.zeros((1, 7)))
    assert np.abs(moved.next_state[0, :3] - state[0, :3]).max() < 0.1 * STEP
    again = arm.moves(moved.next_state, np.array([13]), np.zeros((1, 7)))
    assert (again.next_state[0, :3] - moved.next_state[0, :3] > 0.8 * STEP).all()


def test_a_log_of_a_real_arm(tmp_path):
    pytest.importorskip(
        "pyarrow", reason="needs the extra: pip install 'oee-tabular[parquet]'"
    )
    joints = np.stack([HOME, HOME + 0.01, HOME + 0.02])
    log = ContinuousTransitions(
        joints[:2], [[0.1, 0, 0], [0, 0, -0.1]], joints[1:], episode=[0, 0]
    )
    for ending in ("csv", "parquet", "npz"):
        log.save(tmp_path / f"arm.{ending}")
        found = kinova.load_kinova_log(tmp_path / f"arm.{ending}", speed=0.1)
        assert_allclose(found.state, end_effector(joints[:2]))
        assert found.action_numbers(kinova.COMMANDS, strict=True).tolist() == [22, 12]


def test_without_mujoco_everything_imports_and_says_which_extra():
    code = (
        "import sys; sys.modules['mujoco'] = None\n"
        "import oee_tabular.lab.experiments.kinova\n"
        "from oee_tabular.continuous import kinova\n"
        "try:\n    kinova.record_goals(kinova.KinovaArm(), n_runs=1)\n"
        "except ImportError as error:\n    print(error)"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert (
        found.stdout.strip()
        == "mujoco is not installed; in a clone: pip install '.[mujoco]'"
    )
