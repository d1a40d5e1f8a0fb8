"""Entrances with intervals and buses: when people come in, and mistakes in graph.yaml."""

import types
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import yaml

import sean_jax
from sean_jax.core.errors import FileError
from sean_jax.core.padding import common_sizes, pad
from sean_jax.graph import annotation
from sean_jax.io import files
from sean_jax.people.behaviors import trips
from sean_jax.simulation.scenario import direct_pedestrians
from support import graphs

TICKS = 1500  # of 0.1 s
TABLES = {
    "rates": [0.3, True],
    "times": [{"rate": 2.0, "times": [[0, 12.3], [60, 90]]}, 0.2],
    "closed": [{"times": [[20, 30]]}, {"rate": 0.7, "times": [[140, 1000]]}],
    "bus": [{"bus": {"every": 40, "people": 5, "first": 7.5}}, 0.1],
    "buses": [{"bus": {"every": 60.05, "people": 3}}, {"bus": {"every": 30, "people": 400, "first": 60}}],
}


def ring(entrances) -> annotation.Annotation:
    """A ring of waypoints, the first of which have these values of ``entrance``."""
    made = yaml.safe_load(annotation.to_yaml(graphs.ring(1)))
    for index, value in enumerate(entrances):
        made["nodes"][f"n{index}"]["entrance"] = value
    return annotation.Annotation.model_validate(made)


def built(entrances):
    return replace(annotation.build_graph(ring(entrances), None), names=())


@pytest.fixture(scope="module")
def lab():
    scenario = sean_jax.make("lab", task="random_ab_nav", dynamics="twin")
    return scenario, jax.jit(lambda key: sean_jax.reset(scenario, key))(jax.random.key(0))


def arrivals(lab, graph, chances):
    """(T,) the node at which somebody comes in at each tick, -1 nobody, while there is room for everybody."""
    scenario, state = lab
    nobody = replace(state.pedestrians, present=jnp.zeros(scenario.people, bool))
    far = replace(state.robot, position=jnp.full(2, 500.0))
    memory = state.memory._replace(passengers=jnp.zeros_like(graph.timetable.people))
    state = replace(state, pedestrians=nobody, robot=far, memory=memory, tick=jnp.zeros((), jnp.int32))
    everybody = jnp.ones(scenario.people, bool)

    def one(state, chance):
        people, memory = trips.come_in(scenario, graph, state, everybody, chance)
        node = jnp.where(people.present.any(), memory.goal[jnp.argmax(people.present)], -1)
        return replace(state, memory=memory, tick=state.tick + 1), (node, people.present.sum())

    return jax.lax.scan(one, state, chances)[1]


def counted(entrances, chances):
    """The same by a loop over ticks, from the words of the file."""
    nodes, waiting, since = [], {}, {}
    for tick, (arrival, _, where, _) in enumerate(np.asarray(chances, float)):
        time = tick * 0.1
        rates = np.zeros(len(entrances))
        for index, entrance in enumerate(entrances):
            entrance = {"rate": 1.0} if entrance is True else entrance
            entrance = entrance if isinstance(entrance, dict) else {"rate": entrance}
            if "bus" in entrance:
                bus = entrance["bus"]
                coming = bus.get("first", 0.0) + bus["every"] * np.arange(100)
                if any(abs(np.ceil(moment / 0.1 - 1e-6) - tick) < 0.5 for moment in coming):
                    waiting[index], since[index] = bus["people"], tick
                if tick - since.get(index, tick) >= 300:  # 30 s
                    waiting[index] = 0
                continue
            times = entrance.get("times", [[0, np.inf]])
            if any(begin - 1e-6 <= time < end - 1e-6 for begin, end in times):
                rates[index] = entrance.get("rate", 1.0)
        rate = rates.sum()
        if rate and arrival < 1 - np.exp(-rate * 0.1):
            nodes.append(int(np.searchsorted(np.cumsum(rates), where * rate, side="right")))
        elif total := sum(waiting.values()):
            buses = sorted(waiting)
            share = np.cumsum([waiting[bus] for bus in buses])
            bus = buses[int(np.searchsorted(share, where * total, side="right"))]
            waiting[bus] -= 1
            nodes.append(bus)
        else:
            nodes.append(-1)
    return np.array(nodes)


@pytest.fixture(scope="module")
def chances():
    return jnp.asarray(np.random.default_rng(0).uniform(size=(TICKS, 4)), jnp.float32)


@pytest.mark.parametrize("name", TABLES)
def test_people_come_in_by_the_timetable(lab, chances, name):
    nodes, number = jax.jit(lambda graph: arrivals(lab, graph, chances))(built(TABLES[name]))
    wanted = counted(TABLES[name], chances)
    assert (np.asarray(nodes) == wanted).all() and (np.asarray(number) == (wanted >= 0)).all()
    assert len(np.unique(wanted)) == 3  # both entrances, and nobody


def test_a_stack_of_graphs_with_and_without_timetables(lab, chances):
    plain = [built(table) for table in TABLES.values()]
    sizes = common_sizes(plain)
    padded = [jax.tree.map(jnp.asarray, pad(graph, sizes)) for graph in plain]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *padded)
    nodes, _ = jax.jit(jax.vmap(lambda graph: arrivals(lab, graph, chances)))(stacked)
    for row, table in zip(np.asarray(nodes), TABLES.values(), strict=True):
        assert (row == counted(table, chances)).all()


@pytest.mark.slow
def test_people_leave_also_where_nobody_comes_in_and_passengers_come_as_there_is_room(tmp_path):
    """A floor of eight people with a bus and an entrance that is closed but for a while."""
    entrances = [{"bus": {"every": 50, "people": 4, "first": 30}}, {"rate": 5.0, "times": [[0, 1]]}]
    graphs.yard(tmp_path / "yard")
    (tmp_path / "yard" / "graph.yaml").write_text(annotation.to_yaml(ring(entrances)), encoding="utf-8")
    scenario = sean_jax.make(str(tmp_path / "yard"), people=8, task="random_ab_nav", dynamics="twin")
    assert scenario.behavior.data.graph.timetable.people.tolist() == [4]

    def one(state, _):
        key = jax.random.fold_in(state.streams.people, state.tick)
        after = direct_pedestrians(scenario, state, key)
        people = after.pedestrians
        position = people.position + scenario.time_step * people.desired_velocity
        people = replace(people, position=position, velocity=people.desired_velocity)
        return replace(after, pedestrians=people, tick=state.tick + 1), (people.present, after.memory)

    def walk(key):
        state = sean_jax.reset(scenario, key)
        state = replace(state, robot=scenario.robot.place(scenario.robot, jnp.full(2, 90.0), state.robot.heading))
        return jax.lax.scan(one, state, length=3000)[1]

    present, memory = jax.tree.map(np.asarray, jax.jit(walk)(jax.random.key(0)))
    comes = ~present[:-1] & present[1:]
    leaves = present[:-1] & ~present[1:]
    time = (np.arange(len(comes)) + 1) * scenario.time_step
    ticks, person = np.nonzero(comes)
    assert (memory.origin[1:][ticks, person][time[ticks] > 1.0] == 0).all()  # the bus alone
    assert (memory.goal[:-1][np.nonzero(leaves)] == 1).any()  # the closed entrance
    for begin in range(30, 300, 50):
        during = (time >= begin - 0.05) & (time < begin + 30.0)
        between = (time >= begin + 30.0) & (time < begin + 49.95)
        assert comes[during].sum() <= 4 and not comes[between].any()
    assert comes.sum() >= 8 and (present.sum(1) <= 8).all()


@pytest.mark.parametrize(
    ("entrance", "message"),
    [
        (-1, "entrance: -1 is less than 0, the least allowed."),
        ("now", "entrance: 'now' is not an entrance; write true, a number of people/s or a mapping."),
        ([0.1], r"entrance: \[0.1\] is not an entrance; write true"),
        ({"rate": -1}, "entrance.rate: -1 is less than 0"),
        ({"tims": [[0, 1]]}, "entrance.tims: 'tims' is not a known key; did you mean 'times'"),
        ({"times": []}, "entrance.times: .* has 0 values, 1 are needed|entrance.times: has 0 values"),
        ({"times": [[900, 300]]}, r"entrance.times\[0\]: \[900, 300\] does not end after it begins; give the earlier"),
        ({"times": [[0, 5], [9, 9]]}, r"entrance.times\[1\]: \[9, 9\] does not end after it begins"),
        ({"times": [[0, 5, 6]]}, r"entrance.times\[0\]: \[0, 5, 6\] is not an interval; give its begin"),
        ({"times": [[0, -5]]}, r"entrance.times\[0\]\[1\]: -5 is less than 0"),
        ({"times": 5}, "entrance.times: 5 is not a list"),
        ({"bus": {"every": 0, "people": 8}}, "entrance.bus.every: 0 is less than 1"),
        ({"bus": {"every": -3, "people": 8}}, "entrance.bus.every: -3 is less than 1"),
        ({"bus": {"every": 60, "people": -8}}, "entrance.bus.people: -8 is less than 1"),
        ({"bus": {"every": 60, "people": 2.5}}, "entrance.bus.people: 2.5 is not a whole number"),
        ({"bus": {"every": 60}}, "entrance.bus.people: is missing"),
        ({"bus": {"every": 60, "people": 8, "first": -1}}, "entrance.bus.first: -1 is less than 0"),
        ({"bus": 60}, "entrance.bus: 60 is not a mapping"),
        ({"bus": {"every": 60, "people": 8}, "rate": 1}, "entrance.rate: a bus is given as well; remove one of them."),
        ({"bus": {"every": 60, "people": 8}, "times": [[0, 1]]}, "entrance.times: a bus is given as well"),
    ],
)
def test_mistakes_of_entrances_are_told(tmp_path, entrance, message):
    content = yaml.safe_load(annotation.to_yaml(graphs.ring(0)))
    content["nodes"]["n0"]["entrance"] = entrance
    path = tmp_path / "graph.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(FileError, match=rf"graph.yaml:\d+:\d+: nodes.n0.(?:{message})") as caught:
        files.load(path, annotation.Annotation, annotation.check)
    assert len(str(caught.value).splitlines()) == 1


def test_entrances_are_written_as_they_are_read(tmp_path):
    shown = {"true": True, "0.25": 0.25}
    for table in TABLES.values():
        made = ring([*table, False, 0])
        path = tmp_path / "graph.yaml"
        path.write_text(annotation.to_yaml(made))
        assert files.load(path, annotation.Annotation, annotation.check) == made
        assert made.nodes["n2"].entrance is None and made.nodes["n3"].entrance is None
    for text, value in shown.items():
        assert f"entrance: {text}}}" in annotation.to_yaml(ring([value]))


def test_no_passengers_are_left_before_the_first_bus():
    """As in an episode that follows a warm-up, whose ticks begin again; whatever the gap between buses."""
    for every in (40.0, 110.0, 120.0, 600.0):
        table = types.SimpleNamespace(every=jnp.array([every]), first=jnp.array([100.0]), people=jnp.array([20]))
        graph = types.SimpleNamespace(timetable=table)
        for tick, left in ((0.0, 0), (50.0, 0), (999.0, 0), (1000.0, 20), (1010.0, 15)):
            passengers = trips._passengers(graph, jnp.array([15]), jnp.float32(tick), 0.1)
            assert int(passengers[0]) == left, (every, tick)
