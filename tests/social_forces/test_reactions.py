"""Reactions to the robot: what each kind of person does, who reacts late, and that the rest stays as it was."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import classifiers, metrics, social_forces
from sean_jax.core.data_types import Obstacles, Robot, Snapshot
from sean_jax.core.errors import FileError, InputError
from sean_jax.people.pedestrian_models import pedestrians_at
from sean_jax.policies import POLICIES
from sean_jax.simulation import episodes
from sean_jax.social_forces import Kind, Reactions, preset
from sean_jax.studies.prediction import predict
from support import trees

KINDS = jnp.asarray(list(Kind), jnp.int32)
SHARES = [kind.name.lower() for kind in Kind if kind]
STEP, RADIUS = 0.1, 0.2
FORCES = social_forces.build([*preset("calibrated"), Reactions()])


def robot_at(position, speed=0.0) -> Robot:
    """A robot that looks and drives to the left."""
    position = jnp.asarray(position, float)
    return Robot(position, jnp.asarray([-1.0, 0.0]), jnp.asarray(speed, float), jnp.zeros(()), ())


def one_person(kind, alertness=1.0, forces=FORCES, position=(0.0, 0.1)):
    """Somebody who walks to the right at 1.34 m/s."""
    people = pedestrians_at(jnp.asarray([position]), jnp.asarray([[1.34, 0.0]]), preferred_speed=jnp.asarray([1.34]))
    drawn = forces.reactions.draw(jax.random.key(0), 1)
    of_kind = replace(drawn, kind=jnp.reshape(kind, 1), alertness=jnp.reshape(jnp.asarray(alertness, float), 1))
    return replace(people, reaction=of_kind)


@jax.jit
def advance(forces, people, robot, obstacles=None):
    """People a control step later."""
    people = forces.reactions.attend(people, robot, obstacles, STEP)

    def substep(people, _):
        return social_forces.integrate(forces, people, None, None, robot, STEP / 2, RADIUS), None

    return jax.lax.scan(substep, people, length=2)[0]


@jax.jit
@partial(jax.vmap, in_axes=(0, 0, None, None))
def meet(kind, alertness, speed, forces):
    """People and robots after each step of six meetings of 15 s, head-on from 6 m."""

    def step(people, tick):
        robot = robot_at((6.0, 0.0), speed)
        robot = replace(robot, position=robot.position + robot.heading * speed * STEP * tick)
        people = advance(forces, people, robot)
        return people, (people, robot)

    return jax.lax.scan(step, one_person(kind, alertness, forces), jnp.arange(150, dtype=float))[1]


@pytest.fixture(scope="module")
def meetings():
    """Speed of the robot -> people, robots and their distance [m] (kinds, steps) in 15 s."""
    met = {speed: meet(KINDS, jnp.ones(6), jnp.float32(speed), FORCES) for speed in (0.0, 0.5)}
    met = jax.tree.map(np.asarray, met)
    return {speed: (people, robot, distance(people, robot)) for speed, (people, robot) in met.items()}


def distance(people, robot):
    return np.linalg.norm(people.position[..., 0, :] - robot.position, axis=-1)


def speed_of(people):
    return np.linalg.norm(people.velocity[..., 0, :], axis=-1)


def facing(people, robot):
    """Cosine of the angle between a person's heading and the way to the robot."""
    way = np.asarray(robot.position - people.position[..., 0, :])
    return (way * np.asarray(people.heading[..., 0, :])).sum(-1) / np.linalg.norm(way, axis=-1)


def test_surprised_people_stop_and_look_at_the_robot(meetings):
    people, robot, away = meetings[0.0]
    assert speed_of(people)[Kind.SURPRISED, 40:].max() < 0.05 < 0.4 < speed_of(people)[Kind.INDIFFERENT].min()
    assert 3.0 < away[Kind.SURPRISED, 40:].min() <= away[Kind.SURPRISED].max()
    people, robot, away = meetings[0.5]  # it passes, and they turn with it
    passed = np.asarray(robot.position)[Kind.SURPRISED, :, 0] < np.asarray(people.position)[Kind.SURPRISED, :, 0, 0]
    assert passed.any() and facing(people, robot)[Kind.SURPRISED, 40:].min() > 0.7


def test_curious_people_come_slowly_and_stop_at_a_distance(meetings):
    people, robot, away = meetings[0.0]
    assert (np.diff(away[Kind.CURIOUS]) < 1e-4).all()
    assert away[Kind.CURIOUS, -1] == pytest.approx(float(FORCES.reactions.stop), abs=0.05)
    assert speed_of(people)[Kind.CURIOUS, 25:].max() < FORCES.reactions.approach + 0.1
    assert facing(people, robot)[Kind.CURIOUS, 20:].min() > 0.99


def test_curious_people_lose_interest():
    """After its duration, within a few delays; then they go where they wanted to."""
    short = FORCES.tree_replace({"reactions.duration": 4.0})
    people, _ = jax.tree.map(np.asarray, meet(KINDS, jnp.ones(6), jnp.float32(0.5), short))
    attention, x = people.reaction.attention[Kind.CURIOUS, :, 0], people.position[Kind.CURIOUS, :, 0, 0]
    assert attention[40] > 0.9 and attention[90:].max() < 0.1
    assert x[-1] > 10.0 and speed_of(people)[Kind.CURIOUS, -1] == pytest.approx(1.34, abs=0.05)


def test_cautious_people_keep_farther_away(meetings):
    clearance = FORCES.reactions.clearance
    for speed, share in ((0.0, 1.0), (0.5, 0.85)):  # one that comes at them gets somewhat nearer
        away = meetings[speed][2]
        assert share * clearance < away[Kind.CAUTIOUS].min() < 1.1 * clearance
        assert away[Kind.INDIFFERENT].min() < 1.0
        people = meetings[speed][0]
        assert people.position[Kind.CAUTIOUS, -1, 0, 0] > 6.5  # and get to where they wanted


def test_impassive_people_take_no_notice_until_bodies_touch(meetings):
    for speed in (0.0, 0.5):
        people, _, away = meetings[speed]
        before = np.cumprod(away[Kind.IMPASSIVE] > 2 * RADIUS + 0.05).astype(bool)
        assert before.sum() > 20 and not before.all()
        np.testing.assert_allclose(people.position[Kind.IMPASSIVE, before, 0, 1], 0.1, atol=1e-5)
        assert away[Kind.INDIFFERENT].min() > 2 * RADIUS + 0.1


def test_threatening_people_stay_in_the_way_of_the_robot(meetings):
    for speed in (0.0, 0.5):
        people, robot, away = meetings[speed]
        ahead = np.asarray(robot.position[:, :, 0] - people.position[:, :, 0, 0])[Kind.THREATENING, 50:]
        aside = np.asarray(people.position[:, :, 0, 1])[Kind.THREATENING, 50:]
        assert 0.5 < ahead.min() and ahead.max() < 1.1 and np.abs(aside).max() < 0.1
        assert facing(people, robot)[Kind.THREATENING, 50:].min() > 0.99


def test_threatening_people_walk_round_the_robot_without_touching_it():
    """People whose way crosses that of the robot, from all sides."""

    def cross(angle, offset, speed):
        direction = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        meeting = jnp.asarray([6.0, 0.0]) - jnp.asarray([4.0, 0.0]) * speed + offset
        person = one_person(Kind.THREATENING, position=(0.0, 0.0))
        velocity = 1.34 * direction[None]
        start = meeting[None] - 4.0 * velocity
        person = replace(person, position=start, velocity=velocity, desired_velocity=velocity, heading=direction[None])

        def step(people, tick):
            robot = robot_at((6.0, 0.0), speed)
            robot = replace(robot, position=robot.position + robot.heading * speed * STEP * tick)
            people = advance(FORCES, people, robot)
            return people, distance_to(people, robot)

        return jax.lax.scan(step, person, jnp.arange(150, dtype=float))[1]

    def distance_to(people, robot):
        return jnp.linalg.norm(people.position[0] - robot.position)

    generator = np.random.default_rng(0)
    angle = generator.uniform(-np.pi, np.pi, 256)
    offset = generator.normal(0.0, 0.5, (256, 2))
    speed = generator.uniform(0.3, 1.0, 256)
    away = np.asarray(jax.jit(jax.vmap(cross))(*map(jnp.float32, (angle, offset, speed))))
    assert (away.min(1) < 2 * RADIUS).mean() < 0.02
    assert (away[:, 70:].min(1) < 1.2).mean() > 0.7  # and most get to their place before it


def test_indifferent_people_and_a_crowd_without_robot_are_as_without_the_term(meetings):
    plain = preset("calibrated")

    @jax.jit
    def walk(forces, people, robot):
        def step(people, _):
            return social_forces.integrate(forces, people, None, None, robot, 0.05, RADIUS), None

        return jax.lax.scan(step, people, length=80)[0]

    for kind, robot in ((Kind.INDIFFERENT, robot_at((4.0, 0.0))), (Kind.THREATENING, None)):
        people = one_person(KINDS[kind])
        people = jax.tree.map(lambda leaf: jnp.concatenate([leaf, leaf]), people)
        velocity = jnp.array([[1.3, 0.0], [-1.3, 0.0]])
        people = replace(people, position=jnp.array([[0.0, 0.1], [6.0, 0.1]]), velocity=velocity)
        people = replace(people, desired_velocity=people.velocity, heading=jnp.sign(people.velocity))
        attentive = replace(people, reaction=replace(people.reaction, attention=jnp.ones(2)))
        after, before = walk(FORCES, attentive, robot), walk(plain, replace(people, reaction=None), robot)
        assert abs(before.position[0, 1] - 0.1) > 0.1  # they met somebody
        for name in ("position", "velocity", "heading", "desired_velocity"):
            np.testing.assert_allclose(getattr(after, name), getattr(before, name), atol=2e-5, err_msg=name)


def test_inattentive_people_step_aside_later():
    """The distance to a robot, and to somebody who comes, at which they are 5 cm aside."""
    alertness = jnp.asarray([1.0, 0.8, 0.6, 1.0, 1.0, 1.0])
    people, robot = meet(jnp.zeros(6, jnp.int32), alertness, jnp.float32(0.5), FORCES)
    onset = [away[np.argmax(np.abs(path - 0.1) > 0.05)] for path, away in
             zip(np.asarray(people.position[:, :, 0, 1]), distance(people, robot), strict=True)]  # fmt: skip
    assert onset[0] > onset[1] + 0.2 > onset[2] + 0.4
    two = jax.tree.map(lambda leaf: jnp.concatenate([leaf, leaf]), one_person(KINDS[0], 0.6))
    two = replace(two, position=jnp.array([[0.0, 0.0], [8.0, 0.0]]), velocity=jnp.array([[1.34, 0], [-1.34, 0]]))
    two = replace(two, desired_velocity=two.velocity, heading=jnp.sign(two.velocity))

    @jax.jit
    @jax.vmap
    def path(alertness):
        people = replace(two, reaction=replace(two.reaction, alertness=alertness))

        def step(people, _):
            people = social_forces.integrate(FORCES, people, None, None, None, STEP / 2)
            return people, people.position

        return jax.lax.scan(step, people, length=120)[1]

    paths = np.asarray(path(jnp.array([[1.0, 1.0], [0.6, 1.0]])))
    away = np.linalg.norm(paths[:, :, 0] - paths[:, :, 1], axis=-1)
    onset = [away[k, np.argmax(np.abs(paths[k, :, 0, 1]) > 0.05)] for k in (0, 1)]
    assert onset[0] > 2.0 and onset[1] < onset[0] - 0.7
    assert np.abs(paths[1, -1, 0, 1]) < np.abs(paths[1, -1, 1, 1])  # the other gives way for both


def test_people_do_not_see_through_obstacles_nor_behind_their_backs():
    wall = Obstacles(jnp.array([[1.5, 0.0]]), jnp.array([[0.2, 2.0]]), jnp.zeros(1), jnp.ones(1))
    people, there = one_person(KINDS[Kind.CURIOUS]), robot_at((3.0, 0.0))

    def attention(people, robot, obstacles):
        return float(advance(FORCES, people, robot, obstacles).reaction.attention[0])

    assert attention(people, there, replace(wall, center=wall.center + 5.0)) > 0.2
    assert attention(people, there, replace(wall, height=jnp.zeros(1))) > 0.2  # an edge of the floor
    assert attention(people, there, wall) == 0.0
    nothing = replace(wall, center=wall.center + 50.0)
    assert attention(people, robot_at((-1.0, 0.0)), nothing) == 0.0
    assert attention(people, robot_at((5.2, 0.0)), nothing) == 0.0
    assert attention(one_person(KINDS[Kind.CURIOUS], 0.5), there, nothing) == 0.0  # a phone shortens the sight


def test_members_of_groups_who_stand_do_not_react():
    people = replace(one_person(KINDS[0]), group=jnp.zeros(1, jnp.int32), velocity=jnp.zeros((1, 2)))
    people = replace(people, desired_velocity=jnp.zeros((1, 2)))

    def place(kind):
        reaction = replace(people.reaction, kind=jnp.full(1, int(kind), jnp.int32), attention=jnp.ones(1))
        return advance(FORCES, replace(people, reaction=reaction), robot_at((2.5, 0.0))).position

    places = [place(kind) for kind in (Kind.INDIFFERENT, Kind.CURIOUS, Kind.CAUTIOUS)]
    np.testing.assert_array_equal(places[0], places[1])
    np.testing.assert_array_equal(places[0], places[2])


def test_kinds_are_drawn_by_their_shares_and_change_no_other_draw():
    shares = dict(surprised=0.1, curious=0.2, cautious=0.15, impassive=0.05, threatening=0.3)
    forces = social_forces.build([*preset("calibrated"), Reactions(**shares, inattentive=0.25)])  # pyright: ignore
    people = pedestrians_at(jnp.zeros((20_000, 2)), jnp.zeros((20_000, 2)))
    drawn, again, other = (social_forces.individualize(forces, people, jax.random.key(k)) for k in (0, 0, 1))
    shares = [1.0 - sum(shares.values()), *shares.values()]
    np.testing.assert_allclose(np.bincount(drawn.reaction.kind, minlength=6) / 20_000, shares, atol=0.012)
    late = drawn.reaction.alertness < 1.0
    assert late.mean() == pytest.approx(0.25, abs=0.012)
    assert abs(np.corrcoef(late, drawn.reaction.kind == Kind.THREATENING)[0, 1]) < 0.03
    trees.assert_equal(drawn, again)
    assert (drawn.reaction.kind != other.reaction.kind).mean() > 0.5
    plain = social_forces.individualize(preset("calibrated"), people, jax.random.key(0))
    assert plain.reaction is None
    trees.assert_equal(replace(drawn, reaction=None), plain)
    all_of_one = social_forces.build([*preset("calibrated"), Reactions(impassive=np.float64(1.0))])
    kinds = social_forces.individualize(all_of_one, people, jax.random.key(0)).reaction.kind
    assert (kinds == Kind.IMPASSIVE).mean() > 0.9999
    assert (social_forces.individualize(FORCES, people, jax.random.key(0)).reaction.kind == 0).all()


def test_gradients_are_finite_even_with_the_robot_in_the_persons_place():
    @jax.jit
    @partial(jax.vmap, in_axes=(0, None))
    def slopes(kind, place):
        def end(forces, position, robot_position):
            people = replace(one_person(kind, 0.6, forces), position=position)
            people = replace(people, reaction=replace(people.reaction, attention=jnp.full(1, 0.5)))
            robot = robot_at(robot_position, 0.3)
            people = forces.reactions.attend(people, robot, None, STEP)
            people = social_forces.integrate(forces, people, None, None, robot, STEP, RADIUS)
            return (people.position + people.velocity).sum() + (people.heading * jnp.array([[0.3, 0.7]])).sum()

        return jax.grad(end, (0, 1, 2))(FORCES, jnp.array([[0.0, 0.1]]), place)

    for place in ([0.0, 0.1], [1.2, 0.0], [-0.3, 0.1], [2.4, 0.5]):
        found = jax.tree.map(np.asarray, slopes(KINDS, jnp.asarray(place)))
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found)), place
        assert max(np.abs(leaf).max() for leaf in found[1:]) < (1e7 if place == [0.0, 0.1] else 10.0), place
    assert np.abs(found[0].reactions.caution[Kind.CAUTIOUS]) > 0.0
    assert np.abs(found[0].reactions.approach[Kind.CURIOUS]) > 0.0


def test_accelerations_are_bounded_and_types_stay(meetings):
    for people, _, _ in meetings.values():
        change = np.linalg.norm(np.diff(people.velocity[:, :, 0], axis=1), axis=-1) / STEP
        for kind in set(Kind) - {Kind.IMPASSIVE}:  # whom bodies push
            assert change[kind].max() < FORCES.walking.acceleration
    before = one_person(KINDS[Kind.CURIOUS])
    after = jax.eval_shape(partial(advance, FORCES), before, robot_at((2.0, 0.0)))
    assert jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), before) == jax.tree.map(
        lambda leaf: (leaf.shape, leaf.dtype), after
    )


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (dict(curious=0.7, cautious=0.4), "forces.reactions: the shares of .* sum to more than 1; change one"),
        (dict(surprised=-0.1), "forces.reactions.surprised: -0.1 must be from 0 to 1"),
        (dict(inattentive=1.5), "forces.reactions.inattentive: 1.5 must be from 0 to 1"),
        (dict(phone=0.0), "forces.reactions.phone: 0.0 must be from 0.01 to 1"),
    ],
)
def test_wrong_shares_are_refused(values, words, tmp_path):
    with pytest.raises(InputError, match=words):
        social_forces.build([*preset("calibrated"), Reactions(**values)])
    file = tmp_path / "forces.yaml"
    lines = "".join(f"  reactions.{name}: {value}\n" for name, value in values.items())
    file.write_text(f"preset: calibrated\nparameters:\n{lines}")
    with pytest.raises(FileError, match=f"forces.yaml: {words.split(';')[0]}"):
        social_forces.build(str(file))


def test_a_file_of_constants_adds_the_term(tmp_path):
    file = tmp_path / "forces.yaml"
    file.write_text("preset: helbing1995\nparameters:\n  reactions.curious: 0.2\n  repulsion.range: 0.25\n")
    forces = social_forces.build(str(file))
    assert forces.reactions.curious == np.float32(0.2) and forces.repulsion.range == 0.25
    assert forces.get(Reactions) is not None and len(forces) == len(preset("helbing1995")) + 1
    file.write_text("preset: calibrated\nparameters:\n  reactions.curios: 0.2\n")
    with pytest.raises(FileError, match="forces.reactions.curios: 'reactions' has no such parameter; did you mean"):
        social_forces.build(str(file))


def snapshot(people, robot) -> Snapshot:
    """What situations and metrics read."""
    index, zero = jnp.full((), -1, jnp.int32), jnp.zeros(())
    velocity = robot.speed * robot.heading
    return Snapshot(
        people, robot.position, robot.heading, velocity, robot.position, robot.position - 9.0, index, index, zero,
        jnp.zeros(5, bool), jnp.zeros((), jnp.int32), jnp.asarray(RADIUS), jnp.asarray(0.2), time_step=STEP,
    )  # fmt: skip


def test_situations_and_metrics_see_what_the_kinds_do(meetings):
    """Situations follow their equations; threatening people violate the personal distance, and cautious ones less."""
    people, robot, away = meetings[0.5]
    limits = classifiers.thresholds()
    each = jax.vmap(jax.vmap(snapshot))(people, robot)
    flags = np.asarray(jax.jit(jax.vmap(jax.vmap(lambda s: classifiers.classify(s, limits))))(each))
    cross, down, join, leave, empty = np.moveaxis(flags, -1, 0)
    near = away < limits.near
    cosine = (np.asarray(people.heading[:, :, 0]) * np.asarray(robot.heading)).sum(-1)
    walks = speed_of(people) > limits.walking
    np.testing.assert_array_equal(empty, ~near)
    np.testing.assert_array_equal(cross, near & walks & (np.abs(cosine) <= np.sin(limits.angle)))
    np.testing.assert_array_equal(down, near & (cosine >= np.cos(limits.angle)))
    assert not join.any() and not leave.any()
    assert empty[Kind.THREATENING].mean() < empty[Kind.INDIFFERENT].mean() - 0.4

    close = metrics.metric.share_of_time(lambda now: jnp.linalg.norm(now.people.position[0] - now.position) < 1.2)
    nearest = metrics.METRICS["min_distance_to_people"]

    def measure(path):
        def one(values, after):
            return [
                each.update(value, after, after) for each, value in zip((close, nearest), values, strict=True)
            ], None

        first = jax.tree.map(lambda leaf: leaf[0], path)
        values = jax.lax.scan(one, [close.init(first), nearest.init(first)], path)[0]
        return jnp.ravel(close.compute(values[0]))[0], jnp.ravel(nearest.compute(values[1]))[0]

    share, least = map(np.asarray, jax.jit(jax.vmap(measure))(each))
    assert share[Kind.THREATENING] > 0.7 > 0.2 > share[Kind.INDIFFERENT]
    np.testing.assert_allclose(least, away.min(1), rtol=1e-4)
    assert least[Kind.IMPASSIVE] < least[Kind.INDIFFERENT] < least[Kind.CAUTIOUS]


@pytest.mark.slow
def test_predictions_have_no_robot_and_ignore_the_kinds():
    x, y = jnp.meshgrid(0.5 * jnp.arange(8.0), jnp.array([0.0, 2.0]), indexing="ij")
    seen, key = jnp.stack([x, y], -1)[None], jax.random.key(0)
    term = social_forces.build([*preset("calibrated"), Reactions(threatening=np.float64(1.0))])
    plain, term = (predict(forces, seen, 0.4, 4, key=key) for forces in (preset("calibrated"), term))
    np.testing.assert_allclose(plain, term, atol=1e-5)


@pytest.mark.night
def test_robots_among_threatening_people_do_not_arrive():
    """In the warehouse, from reset on: distances, entries into the personal distance, and what is on the way."""
    scenario = sean_jax.make(
        "warehouse", behavior="graph", task="join_group", people=16, dynamics="twin",
        forces=[*preset("calibrated"), Reactions()],
    )  # fmt: skip

    @jax.jit
    @partial(jax.vmap, in_axes=(0, None))
    @partial(jax.vmap, in_axes=(None, 0))
    def run(shares, key):
        reactions = scenario.forces.reactions.replace(**shares)
        own = scenario.replace(forces=scenario.forces.replace(reactions=reactions))
        state, away = episodes.rollout(
            own, POLICIES["go_to_goal"], key, 300,
            lambda before, after, action: jnp.linalg.norm(
                after.pedestrians.position - after.robot.position[None], axis=-1).min(),
        )  # fmt: skip
        return away, state.completed

    rows = {name: jnp.asarray([float(name == other) for other in ("none", *SHARES)]) for name in SHARES}
    away, completed = run(rows, jax.random.split(jax.random.key(1), 8))
    close = dict(zip(("indifferent", *SHARES), np.asarray(away < 1.2).mean((1, 2)), strict=True))
    assert close["threatening"] > 1.5 * close["indifferent"] and close["cautious"] < 0.9 * close["indifferent"]
    assert completed[0].any() and not completed[Kind.THREATENING].any()
