"""What the social forces do to people (section IV-D): who passes on which side, how far from a robot.

python benchmarks/walkers.py                 all experiments, for each preset
python benchmarks/walkers.py passing robot   some of them
"""

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax import social_forces
from sean_jax.base import Array, Pedestrians, Robot

STEP = 0.05  # s


def walkers(position: Array, desired: Array, robot_distance: Array | float = 0.0) -> Pedestrians:
    """People at these places (N, 2) [m] who walk as they desire (N, 2) [m/s]."""
    number = position.shape[0]
    speed = jnp.linalg.norm(desired, axis=1)
    return Pedestrians(
        position=position,
        velocity=desired,
        heading=desired / jnp.maximum(speed, 1e-6)[:, None],
        desired_velocity=desired,
        group=jnp.full(number, -1, jnp.int32),
        party=jnp.full(number, -1, jnp.int32),
        present=jnp.ones(number, bool),
        preferred_speed=speed,
        robot_distance=jnp.broadcast_to(jnp.asarray(robot_distance, jnp.float32), (number,)),
    )


def right_share(parameters: social_forces.Parameters, preferences, meetings: int = 1000, seed: int = 0) -> np.ndarray:
    """(P,) share of head-on meetings in which both keep to their right, for each ``side_preference`` [m/s2].

    Two people walk towards one another from 8 m apart on parallel lines that are up to 0.3 m apart, either way, with
    speeds drawn as for any crowd.
    """

    def meet(preference, key):
        offset_key, trait_key = jax.random.split(key)
        offset = jax.random.uniform(offset_key, (), jnp.float32, -0.15, 0.15)
        speed = social_forces.draw_traits(parameters, trait_key, 2)[0]
        people = walkers(
            jnp.stack([jnp.stack([jnp.float32(-4.0), offset]), jnp.stack([jnp.float32(4.0), -offset])]),
            jnp.stack([speed, jnp.zeros(2, jnp.float32)], -1) * jnp.array([[1.0], [-1.0]]),
        )
        chosen = parameters.replace(side_preference=preference)

        def step(people, _):
            after = social_forces.advance(chosen, people, None, None, None, STEP)
            return after, after.position

        x, y = jnp.moveaxis(jax.lax.scan(step, people, length=400)[1], -1, 0)
        met = jnp.argmax(x[:, 0] > x[:, 1])
        return jnp.where((x[:, 0] > x[:, 1]).any(), (y[met, 0] < y[met, 1]).astype(jnp.float32), jnp.nan)

    keys = jax.random.split(jax.random.key(seed), meetings)
    run = jax.jit(jax.vmap(jax.vmap(meet, (None, 0)), (0, None)))
    return np.asarray(run(jnp.asarray(preferences, jnp.float32), keys), float)


def robot_gaps(
    parameters: social_forces.Parameters, distances, crossings: int = 200, robot_speed: float = 0.5, seed: int = 0
) -> Array:
    """(R, crossings) closest approach [m], centre to centre, of a walker to a robot that comes towards them.

    ``distances`` (R,) [m] is the person's ``robot_distance``, or (R, crossings) one for each. They start 8 m apart on
    parallel lines that are up to 0.5 m apart, either way.
    """

    def meet(distance, key):
        offset_key, trait_key = jax.random.split(key)
        offset = jax.random.uniform(offset_key, (), jnp.float32, -0.5, 0.5)
        speed = social_forces.draw_traits(parameters, trait_key, 1)[0]
        people = walkers(
            jnp.stack([jnp.float32(-4.0), offset])[None], jnp.stack([speed, jnp.zeros_like(speed)], -1), distance
        )
        heading = jnp.array([-1.0, 0.0])

        def step(carry, _):
            people, x = carry
            place = jnp.stack([x, jnp.zeros_like(x)])
            robot = Robot(place, heading, jnp.float32(robot_speed), jnp.float32(0.0), ())
            after = social_forces.advance(parameters, people, None, None, robot, STEP, 0.16)
            gap = jnp.linalg.norm(after.position[0] - place)
            return (after, x - STEP * robot_speed), gap

        return jax.lax.scan(step, (people, jnp.float32(4.0)), length=300)[1].min()

    keys = jax.random.split(jax.random.key(seed), crossings)
    distances = jnp.asarray(distances, jnp.float32)
    return jax.vmap(jax.vmap(meet), (0, None))(
        jnp.broadcast_to(distances[:, None] if distances.ndim == 1 else distances, (distances.shape[0], crossings)), keys
    )
