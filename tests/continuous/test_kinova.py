"""The simulated stand-in of the Gen3: kinematics, the arm, its finite model, logs of a real one."""

import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

from oee_tabular.continuous.gen3 import HOME, STEP, end_effector, resolved_rates
from oee_tabular.data import ContinuousTransitions
from oee_tabular.tasks import kinova


def needs_mujoco():
    return pytest.importorskip("mujoco", reason="needs the extra: pip install 'oee-tabular[mujoco]'")


def test_the_kinematics_of_the_fact_table():
    assert_allclose(end_effector(np.zeros((1, 7)))[0], [0.0, -0.02485, 1.18739], atol=1e-5)
    assert_allclose(end_effector(HOME[None])[0], [0.4567, 0.00135, 0.4337], atol=5e-5)


def test_resolved_rates_move_the_hand_as_asked():
    joints = HOME + 0.1 * np.random.default_rng(0).standard_normal((5, 7))
    velocity = np.array([[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1], [0.1, -0.1, 0.1], [0, 0, 0]])
    moved = (end_effector(joints + 1e-6 * resolved_rates(joints, velocity)) - end_effector(joints)) / 1e-6
    assert_allclose(moved, velocity, atol=4e-3)  # what the damping takes


def test_mujoco_agrees_with_the_kinematics():
    mujoco = needs_mujoco()
    from oee_tabular.continuous.gen3 import arm_xml

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
        moved = arm.moves(state, np.arange(27), np.zeros((27, 7))).next_state[:, :3] - state[:, :3]
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
    pytest.importorskip("pyarrow", reason="needs the extra: pip install 'oee-tabular[parquet]'")
    joints = np.stack([HOME, HOME + 0.01, HOME + 0.02])
    log = ContinuousTransitions(joints[:2], [[0.1, 0, 0], [0, 0, -0.1]], joints[1:], episode=[0, 0])
    for ending in ("csv", "parquet", "npz"):
        log.save(tmp_path / f"arm.{ending}")
        found = kinova.load_kinova_log(tmp_path / f"arm.{ending}", speed=0.1)
        assert_allclose(found.state, end_effector(joints[:2]))
        assert found.action_numbers(kinova.COMMANDS, strict=True).tolist() == [22, 12]


def test_without_mujoco_everything_imports_and_says_which_extra():
    code = (
        "import sys; sys.modules['mujoco'] = None\n"
        "import oee_tabular.lab.experiments.kinova\n"
        "from oee_tabular.tasks import kinova\n"
        "try:\n    kinova.record_goals(kinova.KinovaArm(), n_runs=1)\n"
        "except ImportError as error:\n    print(error)"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "mujoco is not installed: pip install 'oee-tabular[mujoco]'"
