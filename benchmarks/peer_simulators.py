"""Other crowd simulators in the hall of ``peers.py``.

Each is a function of ``peers.Hall`` that returns ``(begin, description)``: ``begin()`` makes a new crowd and returns
``advance(steps)``; ``description`` describes the simulator's step. Your own file with such a function
named ``simulator`` takes part with ``peers.py --simulator FILE``.
"""

import importlib
import logging
import tempfile
import warnings
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from sean_jax.people import orca


class Peer(NamedTuple):
    """A simulator of somebody else."""

    run: Callable  # of a hall
    install: str = ""
    module: str = ""
    law: str = "social forces"  # of this project that it stands beside
    crowds: int = 1  # at once


def jupedsim(hall):
    """JuPedSim's social force model, in C++, steered straight to the goals."""
    import jupedsim as jps  # pyright: ignore[reportMissingImports]
    import shapely  # pyright: ignore[reportMissingImports]

    warnings.simplefilter("ignore")
    if hall.rings:
        floor = shapely.Polygon(hall.outline, hall.rings)
    else:
        wide = 4.0 * hall.half + 50.0
        floor = shapely.Polygon([(-wide, -wide), (wide, -wide), (wide, wide), (-wide, wide)])

    def begin():
        simulation = jps.Simulation(model=jps.SocialForceModel(), geometry=floor, dt=hall.time_step)
        stage = simulation.add_direct_steering_stage()
        journey = simulation.add_journey(jps.JourneyDescription([stage]))
        for start, goal, speed in zip(hall.starts, hall.goals, hall.speeds, strict=True):
            ahead = (goal - start) / np.linalg.norm(goal - start)
            agent = jps.SocialForceModelAgentParameters(
                position=tuple(start), orientation=tuple(ahead), journey_id=journey, stage_id=stage,
                desired_speed=float(speed), radius=hall.radius,
            )  # fmt: skip
            simulation.agent(simulation.add_agent(agent)).target = tuple(goal)
        return simulation.iterate

    return begin, "social forces, neighbor grid, routing over a mesh"


def pysocialforce(hall):
    """PySocialForce, numpy and Numba."""
    logging.disable(logging.INFO)
    psf = importlib.import_module("pysocialforce")
    ahead = hall.goals - hall.starts
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    state = np.concatenate([hall.starts, hall.speeds[:, None] * ahead, hall.goals], 1)
    walls = [(a[0], b[0], a[1], b[1]) for a, b in hall.segments] or None
    with tempfile.NamedTemporaryFile("w", suffix=".toml", delete=False) as settings:
        settings.write(
            f"[scene]\nenable_group = true\nagent_radius = {hall.radius}\nstep_width = {hall.time_step}\n"
            "max_speed_multiplier = 1.3\ntau = 0.5\nresolution = 10\n"
        )

    def begin():
        return psf.Simulator(state.copy(), groups=None, obstacles=walls, config_file=settings.name).step

    return begin, "social forces of all pairs, walls as points"


def socialforce(hall):
    """Socialforce, with PyTorch."""
    import torch  # pyright: ignore[reportMissingImports]

    package = importlib.import_module("socialforce")
    potentials = importlib.import_module("socialforce.potentials")
    torch.set_num_threads(1)
    ahead = hall.goals - hall.starts
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    state = torch.tensor(
        np.concatenate([hall.starts, hall.speeds[:, None] * ahead, hall.goals], 1), dtype=torch.float32
    )
    walls = None
    if hall.segments:
        points = [np.linspace(a, b, int(10 * np.linalg.norm(np.subtract(b, a))) + 2) for a, b in hall.segments]
        walls = potentials.PedSpacePotential([torch.tensor(line, dtype=torch.float32) for line in points])
    simulator = package.Simulator(
        ped_ped=potentials.PedPedPotential(), ped_space=walls, delta_t=hall.time_step, oversampling=1
    )
    first = simulator.normalize_state(state)

    def begin():
        now = [first]

        def advance(steps):
            with torch.no_grad():
                for _ in range(steps):
                    now[0] = simulator(now[0]).detach()

        return advance

    return begin, "elliptical potential of all pairs, walls as points"


def rvo2(hall):
    """RVO2, ORCA in C++, with neighbors and horizons of this project's ORCA; velocities are preferred once."""
    package = importlib.import_module("rvo2")
    ours, radius = orca, hall.radius + 0.5 * orca.SPACE
    ahead = hall.goals - hall.starts
    preferred = hall.speeds[:, None] * ahead / np.linalg.norm(ahead, axis=1, keepdims=True)

    def begin():
        simulator = package.PyRVOSimulator(
            hall.time_step, ours.RANGE, ours.NEIGHBORS, ours.HORIZON, ours.WALL_HORIZON, radius, 2.0
        )
        for start, velocity, speed in zip(hall.starts, preferred, hall.speeds, strict=True):
            agent = simulator.addAgent(tuple(start))
            simulator.setAgentMaxSpeed(agent, float(1.3 * speed))
            simulator.setAgentPrefVelocity(agent, tuple(velocity))
        for ring in hall.rings and [hall.outline[::-1], *hall.rings]:  # people are on the right of the corners' order
            simulator.addObstacle(ring)
        simulator.processObstacles()

        def advance(steps):
            for _ in range(steps):
                simulator.doStep()

        return advance

    return begin, "ORCA, k-d tree, nearest neighbors"


def jsfm(hall, crowds=1):
    """JSFM of social-jym: social forces of all pairs in JAX, a loop over the others."""
    sfm = importlib.import_module("jsfm.sfm")
    state, parameters = _social_jym(hall, 4)
    away = [[(1e4, 1e4), (1e4 + 1, 1e4)]]  # it needs an obstacle
    walls = jnp.asarray(_edges(hall) or [away * 4], float)
    goals = jnp.asarray(hall.goals, float)

    def step(state):
        return sfm.step(state, goals, parameters, walls, hall.time_step)

    return _scanned(step, state, crowds), "social forces, all pairs and walls"


def jhsfm(hall, crowds=1):
    """JHSFM of social-jym: social forces with heading of all pairs in JAX."""
    hsfm = importlib.import_module("jhsfm.hsfm")
    state, parameters = _social_jym(hall, 6)
    people = len(hall.starts)
    others = ~jnp.eye(people, dtype=bool)
    walls = jnp.asarray(_edges(hall) or [[[(np.nan, np.nan)] * 2]], float)
    walls = jnp.broadcast_to(walls, (people, *walls.shape))
    goals = jnp.asarray(hall.goals, float)

    def step(state):
        return hsfm.step(state, others, goals, parameters, walls, hall.time_step)

    return _scanned(step, state, crowds), "social forces and torque, all pairs and walls"


def _social_jym(hall, columns):
    """The first state (N, columns), at rest and with a heading for six, and the parameters (N, 19)."""
    ahead = hall.goals - hall.starts
    state = np.zeros((len(hall.starts), columns))
    state[:, :2] = hall.starts
    if columns == 6:
        state[:, 4] = np.arctan2(ahead[:, 1], ahead[:, 0])
    standard = importlib.import_module("jsfm.utils" if columns == 4 else "jhsfm.utils").get_standard_humans_parameters
    parameters = standard(len(state)).at[:, 0].set(hall.radius).at[:, 2].set(jnp.asarray(hall.speeds, float))
    return jnp.asarray(state, float), parameters


def _edges(hall):
    """Of each obstacle its four edges as pairs of points."""
    rings = [hall.outline, *hall.rings] if hall.rings else []
    return [[(ring[k], ring[(k + 1) % 4]) for k in range(4)] for ring in rings]


def _scanned(step, state, crowds):
    """``begin`` of a jitted step: many steps of several equal crowds in one call."""
    states = jnp.broadcast_to(state, (crowds, *state.shape))
    run = jax.jit(lambda states, steps: jax.lax.fori_loop(0, steps, lambda _, states: jax.vmap(step)(states), states))
    return lambda: lambda steps: jax.block_until_ready(run(states, steps))


_JYM = "pip install git+https://github.com/TommasoVandermeer/"

SIMULATORS = {
    "jupedsim": Peer(jupedsim, 'pip install -e ".[peers]"', "jupedsim"),
    "pysocialforce": Peer(pysocialforce, 'pip install -e ".[peers]"', "pysocialforce"),
    "socialforce": Peer(socialforce, 'pip install -e ".[peers]"', "socialforce"),
    "jsfm": Peer(jsfm, f"{_JYM}JSFM", "jsfm"),
    "jsfm, B = 16": Peer(partial(jsfm, crowds=16), f"{_JYM}JSFM", "jsfm", crowds=16),
    "jhsfm": Peer(jhsfm, f"{_JYM}JHSFM", "jhsfm"),
    "jhsfm, B = 16": Peer(partial(jhsfm, crowds=16), f"{_JYM}JHSFM", "jhsfm", crowds=16),
    "rvo2": Peer(
        rvo2,
        "pip install cython setuptools wheel; CMAKE_BUILD_TYPE=Release pip install --no-build-isolation "
        "git+https://github.com/sybrenstuvel/Python-RVO2",
        "rvo2",
        law="orca",
    ),
}
