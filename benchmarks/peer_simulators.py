"""Other crowd simulators that pip can install, in the hall of ``peers.py``.

Each is a function of ``peers.Hall`` that returns ``(begin, description)``: ``begin()`` makes a new crowd and returns
``advance(steps)``; ``description`` describes the simulator's step. Your own file with such a function
named ``simulator`` takes part with ``peers.py --simulator FILE``.
"""

import importlib
import logging
import tempfile
import warnings

import numpy as np


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


SIMULATORS = {"jupedsim": jupedsim, "pysocialforce": pysocialforce, "socialforce": socialforce}
