"""Gradients in float64 against central differences with steps from 1e-5 to 1e-2, along lines through many states.

Where a law is continuous, the mean of its central differences over all places of all lines is the mean of its
gradients, however long the step. A law that jumps makes the two differ by how often and how far it jumps: laws as
printed in papers do, and this says which.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sean_jax import sensors, social_forces
from sean_jax.people.pedestrian_models import MODELS
from sean_jax.simulation.scenario import move_robot
from sean_jax.social_forces import PRESETS
from sean_jax.social_forces.forces import Forces, term_name
from support.float64 import in_double
from support.state_sweep import floats, met, state_of, states

pytestmark = pytest.mark.night
LINES, PLACES = 64, 48
LENGTH = 0.5  # m, m/s, rad/s: of a line
STEPS = (1e-5, 1e-4, 1e-3, 1e-2)
COMPANIONS = [[1, -1], [0, -1], [-1, -1], [-1, -1]]


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A room with two boxes, two people who stand in a group and two who walk, and a robot, in float64."""
    made, state = met(tmp_path_factory.mktemp("room"))
    with jax.enable_x64(True), jax.numpy_dtype_promotion("standard"):
        yield in_double(made), in_double(state)


def slopes(function, shared=(), keep=("turn",)):  # it decides who is in a group
    """Gradients and central differences (steps, LINES, PLACES) of a function of a state, ``keep`` of which is held."""
    random = np.random.default_rng(3)
    begin = {name: np.asarray(part, float)[-LINES:] for name, part in states(5).items()}
    near = random.uniform(-1.2, 1.2, begin["people"].shape) + begin["robot"][:, None]  # all in reach of one another
    begin["people"] = np.where(np.arange(LINES)[:, None, None] % 4 > 0, near, begin["people"])
    way = {name: random.normal(size=part.shape) * (name not in keep) for name, part in begin.items()}
    way["ahead"], way["heading"] = 0.0 * way["ahead"], 0.0 * way["heading"]  # they have length 1
    turned = jax.tree.map(lambda leaf: 0.3 * random.normal(size=(LINES, *jnp.shape(leaf))) * np.asarray(leaf), shared)

    def value(place, at, way, turned):
        along = lambda leaf, change: leaf + place * change  # noqa: E731
        leaves = jax.tree.leaves(function(jax.tree.map(along, at, way), jax.tree.map(along, shared, turned)))
        return sum((0.5 + 0.3 * k) * jnp.sum(jnp.sin(1.0 + leaf)) for k, leaf in enumerate(leaves))

    def over(function):
        return jax.jit(jax.vmap(jax.vmap(function, (0, None, None, None)), (None, 0, 0, 0)))

    places = jnp.asarray(np.sort(random.uniform(0.0, LENGTH, PLACES)))
    values, gradient = over(value), np.asarray(over(jax.grad(value))(places, begin, way, turned))
    differences = [
        np.asarray(values(places + h, begin, way, turned) - values(places - h, begin, way, turned)) / (2 * h)
        for h in STEPS
    ]
    assert np.isfinite(gradient).all() and np.abs(gradient).max() > 1e-4
    return gradient, np.stack(differences)


JUMPS = {
    "in_cone": "a push counts half as soon as it comes from beyond the angle of sight",
    "elliptical": "whoever stands on the line to the other's next step is pushed to either side of it",
    "sidestep": "the other becomes oncoming all at once",
    "robot_repulsion": "the robot is kept at a distance as soon as it moves",
    "perception": "who is farther away is not felt",
}
"""what jumps -> how; the terms and presets with any of it are not held to equal means"""


def jumps(forces):
    """Whether the forces jump."""
    names = [term_name(term) for term in forces]
    functions = [forces.repulsion.law.__name__, forces.repulsion.sight.__name__] if "repulsion" in names else []
    near = ["perception"] if float(forces.walking.perception) < 1e3 else []
    return any(name in JUMPS for name in (*names, *functions, *near))


def jump(gradient, differences):
    """By how much the means differ at each step, as a share of the mean size of the gradient."""
    return np.abs((differences - gradient).mean((1, 2))) / np.abs(gradient).mean()


def agree(gradient, differences):
    """The share of places at which they agree to 2 % at each step."""
    size = 0.02 * (np.abs(gradient) + np.abs(gradient).mean())
    return (np.abs(differences - gradient) < size).mean((1, 2))


def check(gradient, differences, smooth=True):
    """Most places agree at each step, fewer at longer ones; of what is ``smooth``, the means do too.

    A difference over 1 mm or 1 cm leaps over edges of obstacles and the beginning of contacts.
    """
    shares, apart = agree(gradient, differences), jump(gradient, differences)
    assert (shares > (0.99, 0.97, 0.85, 0.4)).all(), shares
    assert not smooth or (apart < (1e-3, 0.02, 0.12, 0.12)).all(), apart


def terms():
    """name -> (forces of that term alone, with the pair term that it needs): each term of each preset once."""
    found = {}
    for preset, forces in PRESETS.items():
        for term in forces:
            name = term_name(term)
            if name == "walking":
                continue
            together = [forces.walking, term] + ([forces.repulsion] if name == "robot_repulsion" else [])
            found[f"{preset}.{name}"] = Forces(tuple(together))
    return found


def after(room, forces, at):
    now = state_of(room, at)
    people = replace(now.pedestrians, heading=now.pedestrians.heading)
    surroundings = (
        room[0].environment.obstacle_grid,
        now.groups,
        now.robot,
        0.05,
        0.16,
        jnp.asarray(COMPANIONS, jnp.int32),
    )
    people = social_forces.integrate(forces, people, *surroundings)
    return people.position, people.velocity


@pytest.mark.parametrize("name", terms())
def test_terms(room, name):
    constants, put = floats(in_double(terms()[name]))
    found = slopes(lambda at, shared: after(room, put(shared), at), constants)
    check(*found, smooth=not jumps(terms()[name]))


@pytest.mark.parametrize("name", PRESETS)
def test_presets(room, name):
    constants, put = floats(in_double(social_forces.preset(name)))
    found = slopes(lambda at, shared: after(room, put(shared), at), constants)
    check(*found, smooth=not jumps(PRESETS[name]))


@pytest.mark.parametrize("name", MODELS)
def test_models(room, name):
    constants, put = floats(room[0].forces)

    def moved(at, shared):
        people = MODELS[name](room[0].replace(forces=put(shared)), state_of(room, at))
        return people.position, people.velocity

    check(*slopes(moved, constants), smooth=name == "constant_velocity")


def test_robot(room):
    def driven(at, shared):
        robot = move_robot(room[0], state_of(room, at), shared).robot
        return robot.position, robot.heading, robot.speed, robot.turn_rate

    check(*slopes(driven, jnp.asarray([0.4, 0.6]), keep=()))


@pytest.mark.parametrize("name", ["scan", "depth"])
def test_sensors(room, name):
    scenario = room[0]
    lidar, camera = sensors.lidar(scenario, count=24), sensors.camera(scenario, "depth", width=8, height=6)

    def seen(at, _):
        now = state_of(room, at)
        return sensors.scan(scenario, now, lidar) if name == "scan" else sensors.depth(scenario, now, camera)

    check(*slopes(seen), smooth=False)  # a ray that leaves a body jumps to what is behind
