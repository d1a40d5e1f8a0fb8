"""A Unitree Go1 walks among people: MuJoCo Playground's model and its trained policy, as an articulated robot.

Both files come from a checkout of github.com/google-deepmind/mujoco_playground; the meshes of MuJoCo Menagerie are not
needed. The package onnx reads the policy.

    FOLDER=mujoco_playground/mujoco_playground
    python examples/go1.py $FOLDER/_src/locomotion/go1/xmls $FOLDER/experimental/sim2sim/onnx/go1_policy.onnx

It prints how the trunk follows commands without walls and people, and episodes of ``go_to_goal`` in the lab.

Observation and scale of actions are of Playground's Go1 joystick environment (Zakka et al., 2025).
"""

import sys
import tempfile
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import sean_jax
from sean_jax import robots
from sean_jax.core.data_types import Obstacles
from sean_jax.policies import go_to_goal

SCENE = """
<mujoco model="go1">
  <include file="{model}"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 0.01" contype="1" conaffinity="0" priority="1" friction="0.6" condim="3"/>
  </worldbody>
  <keyframe>
    <key name="home" qpos="0 0 0.278 1 0 0 0 0.1 0.9 -1.8 -0.1 0.9 -1.8 0.1 0.9 -1.8 -0.1 0.9 -1.8"/>
  </keyframe>
</mujoco>
"""
HOME = (0.1, 0.9, -1.8, -0.1, 0.9, -1.8, 0.1, 0.9, -1.8, -0.1, 0.9, -1.8)  # rad, of the joints
ACTION_SCALE = 0.5  # rad
COMMANDS = (0.5, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.5), (0.5, 0.0, 0.5), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)
STEPS = 200  # of 0.1 s; means are over the second half
NO_WALLS = Obstacles(jnp.zeros((0, 2)), jnp.zeros((0, 2)), jnp.zeros(0), jnp.zeros(0))
GYRO, VELOCITY = slice(0, 3), slice(3, 6)  # of the model's sensors


def network(path):
    """The function (48,) -> (12,) of the ONNX file: normalization, then layers with swish, then tanh of the means."""
    import onnx

    graph = onnx.load(path).graph
    arrays = {each.name: jnp.asarray(onnx.numpy_helper.to_array(each)) for each in graph.initializer}
    (mean,) = (arrays[node.input[1]] for node in graph.node if node.op_type == "Sub")
    scale = next(arrays[node.input[1]] for node in graph.node if node.op_type == "Mul" and node.input[1] in arrays)
    layers = [(arrays[node.input[1]], arrays[node.input[2]]) for node in graph.node if node.op_type == "Gemm"]

    def evaluate(observation):
        hidden = (observation - mean) * scale
        for weights, bias in layers[:-1]:
            hidden = jax.nn.swish(hidden @ weights + bias)
        weights, bias = layers[-1]
        return jnp.tanh((hidden @ weights + bias)[: len(HOME)])

    return evaluate


def robot(model, policy):
    """The RobotModel of Playground's folder ``xmls`` and an ONNX file."""
    evaluate, home = network(policy), jnp.asarray(HOME)

    def controller(command, data, last_action):
        trunk = data.xmat[1]
        parts = [data.sensordata[VELOCITY], data.sensordata[GYRO], -trunk[2]]
        parts += [data.qpos[7:] - home, data.qvel[6:], last_action, command]
        action = evaluate(jnp.concatenate(parts))
        return home + ACTION_SCALE * action, action

    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "go1.xml"
        scene.write_text(SCENE.format(model=(Path(model) / "go1_mjx_feetonly.xml").resolve()))
        return robots.articulated(
            scene,
            controller,
            radius=0.35,
            max_speed=1.0,
            max_lateral_speed=0.5,
            max_turn_rate=1.0,
            control_period=0.02,
            memory=jnp.zeros(len(HOME)),
        )


def main(model, policy):
    """Print how the trunk follows commands, and an episode in the lab."""
    go1 = robot(model, policy)
    scenario = sean_jax.make("lab", robot=go1, people=6)
    open_floor = scenario.replace(environment=scenario.environment.replace(obstacles=NO_WALLS))
    state = jax.jit(sean_jax.reset)(scenario, jax.random.key(0))
    alone = state.replace(
        pedestrians=state.pedestrians.replace(present=jnp.zeros_like(state.pedestrians.present)),
        robot=go1.place(go1, jnp.zeros(2), jnp.asarray([1.0, 0.0])),
    )

    @jax.jit
    def walk(command):
        def one(robot, _):
            robot = go1.drive(open_floor, alone.replace(robot=robot), command)
            height = robot.drive_state.physics["qpos"][2]
            return robot, jnp.stack([robot.speed, robot.sideways, robot.turn_rate, height])

        last, values = jax.lax.scan(one, alone.robot, length=STEPS)
        return values[STEPS // 2 :], last.drive_state.fallen

    print("command (m/s, m/s, rad/s)   mean speed  sideways  turn rate   height (m)     fallen")
    for command in COMMANDS:
        values, fallen = map(np.asarray, walk(jnp.asarray(command)))
        speed, sideways, turn_rate, _ = values.mean(0)
        low, high = values[:, 3].min(), values[:, 3].max()
        print(f"{command!s:26}  {speed:10.3f}{sideways:10.3f}{turn_rate:11.3f}   {low:.3f} to {high:.3f}  {fallen}")
    print(sean_jax.evaluate(scenario, go_to_goal, episodes=8, seed=0).table())


if __name__ == "__main__":
    main(*sys.argv[1:])
