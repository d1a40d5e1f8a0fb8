"""Constants of the social forces from recorded people."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import FileError, InputError, preset
from sean_jax.config import CalibrateConfig
from sean_jax.social_forces import PRESETS, build, presets
from sean_jax.studies import calibration
from sean_jax.studies.calibration import families, fitting, loss, search, windows
from sean_jax.studies.calibration.crowds import Crowds
from sean_jax.studies.calibration.fitting import HABITS, Recordings
from sean_jax.studies.calibration.search import Search
from sean_jax.studies.prediction import predict
from sean_jax.studies.scenes import model, simulate
from sean_jax.studies.validation import crowds, doors, individuals, measures
from support.forces import plain

NAMES = ["walking.relaxation_time", "repulsion.strength", "repulsion.range"]
TRUE = {"walking.relaxation_time": 0.5, "repulsion.strength": 4.0, "repulsion.range": 0.35}
STEP = 0.4


def with_values(*values):
    """These forces with other values of ``NAMES``."""
    return plain().tree_replace(dict(zip(NAMES, values, strict=True)))


# ------------------------------------------------------------------ constants in files


def test_a_file_of_constants_is_forces(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(presets.text("helbing1995", {"repulsion.strength": 3.5}, {"fitted to": "nothing"}))
    forces = build(str(file))
    assert float(forces.repulsion.strength) == 3.5
    assert float(forces.repulsion.range) == pytest.approx(float(preset("helbing1995").repulsion.range))
    scenario = sean_jax.make("lab", behavior="random", people=2, forces=str(file))
    assert float(scenario.forces.repulsion.strength) == 3.5
    observed = np.zeros((2, 2, 2)) + [[0.0, 0.0], [0.5, 0.0]]
    np.testing.assert_allclose(predict(str(file), observed, STEP, 2), predict(forces, observed, STEP, 2), atol=1e-6)


@pytest.mark.parametrize(
    "content, message",
    [
        ("preset: helbing1996\n", "mine.yaml: .*'helbing1996' .*helbing1995"),
        ("preset: helbing1995\nparameters: {repulsion.strenght: 2.0}\n", "mine.yaml: .*strenght.*strength"),
        ("preset: helbing1995\nparameters: {repulsion.strength: much}\n", "mine.yaml:2"),
        (
            "preset: sean2\nparameters: {repulsion.range: 0}\n",
            "mine.yaml: forces.repulsion.range: 0.0 must be from 0.01",
        ),
        (
            "preset: sean2\nparameters: {repulsion.range: -0.1}\n",
            "mine.yaml: forces.repulsion.range: -0.1 must be from",
        ),
        ("preset: sean2\nparameters: {walking.relaxation_time: 0}\n", "relaxation_time: 0.0 must be from 0.001"),
        ("preset: sean2\nparameters: {walking.lateral_damping: 0}\n", "lateral_damping: 0.0 must be from 0.001"),
        ("preset: sean2\nparameters: {walking.speed_min: 3}\n", "forces.walking: speed_min is more than speed_max"),
        ("preset: sean2\nparameters: {repulsion.reach: 9}\n", "forces.repulsion: reach is more than 20 times range"),
        ("preset: calibrated\nparameters: {headway.time: 0}\n", "forces.headway.time: 0.0 must be from 0.01"),
        ("preset: calibrated\nparameters: {walking.depth: 0.3}\n", "forces.walking: depth is more than radius"),
        (
            "preset: calibrated\nparameters: {evasion.speed: 0}\n",
            "mine.yaml: forces.evasion.speed: 0.0 must be from 0.001",
        ),
        (
            "preset: calibrated\nparameters: {cohesion.ramp: 0}\n",
            "mine.yaml: forces.cohesion.ramp: 0.0 must be from 0.001",
        ),
        ("preset: helbing1995\nvalues: {}\n", "mine.yaml:2.*'values' is not a known key"),
    ],
)
def test_a_wrong_file_of_constants_is_refused(tmp_path, content, message):
    (tmp_path / "mine.yaml").write_text(content)
    with pytest.raises(FileError, match=message):
        build(str(tmp_path / "mine.yaml"))


# ------------------------------------------------------------------ parameters


def test_parameters_stay_between_their_bounds_and_come_back():
    names = list(fitting.BOUNDS)
    low, high = np.array(list(fitting.BOUNDS.values())).T
    free = np.random.default_rng(0).normal(0.0, 4.0, (200, len(names)))
    values = np.asarray(fitting.from_free(names, jnp.asarray(free)))
    slack = 1e-5 * (np.abs(low) + np.abs(high))
    assert (values >= low - slack).all() and (values <= high + slack).all()
    middle = np.asarray(fitting.from_free(names, jnp.asarray(np.clip(free, -3.0, 3.0))))
    again = fitting.from_free(names, fitting.to_free(names, jnp.asarray(middle)))
    np.testing.assert_allclose(again, middle, rtol=2e-3, atol=1e-3)
    assert np.isfinite(fitting.to_free(names, jnp.asarray(low * 0.0))).all()


def test_what_a_fit_may_find_can_be_used():
    """Constants at both ends of what is fitted, alone and together, lie within the limits of the terms."""
    for name in PRESETS:
        forces = preset(name)
        names = fitting.names_of(forces)
        for end in (0, 1):
            build(forces.tree_replace({each: fitting.BOUNDS[each][end] for each in names}))
            for each in names:
                build(forces.tree_replace({each: fitting.BOUNDS[each][end]}))


def test_which_parameters_are_fitted():
    assert "repulsion.anticipation" not in fitting.names_of(preset("helbing2000"))  # its law is circular
    assert "repulsion.back_weight" not in fitting.names_of(preset("calibrated"))  # it looks all round
    usual = fitting.names_of(preset("helbing1995"))
    assert {"repulsion.anticipation", "sidestep.preference", "walls.range"} <= set(usual)
    assert not any(name.startswith("headway") for name in usual)
    assert "walking.acceleration" not in usual  # missing, or without a bound
    assert fitting.names_of(plain(), NAMES[::-1]) == NAMES
    with pytest.raises(InputError, match="fit: 'repulsion.size' is not one of"):
        fitting.names_of(plain(), ["repulsion.size"])
    with pytest.raises(InputError, match="fit: the forces have no walls.range"):
        fitting.names_of(plain(), ["walls.range"])
    forces = with_values(0.7, 3.0, 0.2)
    np.testing.assert_allclose(fitting.values_of(forces, NAMES), [0.7, 3.0, 0.2], rtol=1e-6)


# ------------------------------------------------------------------ recordings


def write(path, tracks, first=0, step=10, velocities=True):
    """Tracks (T, N, 2) as lines of a file."""
    head = "frame,ped_id,x_m,y_m" + (",vx_mps,vy_mps" if velocities else "")
    lines = [head]
    speed = np.gradient(tracks, STEP, axis=0)
    for moment, places in enumerate(tracks):
        for person, (x, y) in enumerate(places):
            if np.isfinite(x):
                end = "".join(f",{v:.4f}" for v in speed[moment, person]) if velocities else ""
                lines.append(f"{first + step * moment},{person + 1},{x:.4f},{y:.4f}{end}")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")


def people_who_meet(seed, people=4):
    """Tracks of people of known constants who walk to one place from all sides."""
    random = np.random.default_rng(seed)
    forces = plain().tree_replace(TRUE)
    angle = np.linspace(0.0, 2 * np.pi, people, endpoint=False) + random.normal(0.0, 0.3, people)
    velocity = -1.3 * np.stack([np.cos(angle), np.sin(angle)], -1)
    middle = -velocity * 6.5 * random.uniform(0.9, 1.1, (people, 1)) + random.normal(0.0, 0.4, (people, 2))
    observed = middle + np.arange(2)[:, None, None] * STEP * velocity
    return np.concatenate([observed, np.asarray(predict(forces, observed, STEP, 26))])


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """Two scenes of prediction by people of known constants."""
    folder = tmp_path_factory.mktemp("recordings")
    for name, seed in (("north", 1), ("south", 2)):
        write(folder / "eth_ucy" / f"{name}.csv", people_who_meet(seed))
    return folder


def test_corridors_are_windows_between_walls(tmp_path):
    moments = np.arange(80)[:, None]
    x, late = np.array([0.5, 1.2, 0.9]), np.array([0, 4, 24])
    y = 5.0 - 0.25 * 1.2 * (moments - late)
    y = np.where((moments >= late) & (y > -5.5), y, np.nan)
    tracks = np.stack([np.where(np.isfinite(y), x, np.nan), y], -1)
    write(tmp_path / "uo-180-180-090.csv", tracks, step=4, velocities=False)
    prediction, corridors = windows.find(tmp_path)
    assert not prediction and list(corridors) == ["uo-180-180-090"]
    found = windows.corridor_scenes(corridors)
    assert found.observed.shape[1] == 2 and found.after.shape[1] == windows.CORRIDOR_STEPS
    assert (found.known[:, -1].sum(1) >= 2).all()
    np.testing.assert_allclose(np.linalg.norm(found.direction[found.known[:, -1]], axis=-1), 1.0, atol=1e-6)
    assert (found.direction[found.known[:, -1]][:, 1] < -0.9).all()
    y = found.observed[:, -1, :, 1][found.known[:, -1]]
    assert (np.abs(y) < 4.0).all()
    np.testing.assert_allclose(found.reference, 0.0, atol=1e-3)  # they walk straight
    moved = found.after[:, 0] - found.observed[:, -1]
    np.testing.assert_allclose(
        moved[found.counted[:, 0]], np.broadcast_to([0.0, -0.6], moved[found.counted[:, 0]].shape), atol=1e-3
    )
    assert np.isfinite(found.others).any()  # who comes later is replayed
    assert found.walls.center.shape == (4, 2)  # two beside the corridor, two beside the exit


def test_there_must_be_recordings(tmp_path):
    with pytest.raises(InputError, match="data: .* has no recordings"):
        windows.find(tmp_path)
    with pytest.raises(InputError, match="data: .* is no folder"):
        windows.find(tmp_path / "nowhere")


# ------------------------------------------------------------------ crowds


def measured(family, forces):
    """A family's rows with these forces."""
    rows = Crowds([family], forces, lambda _: forces).rows(jnp.zeros((1, 1)))
    return {row: float(value[0]) for row, value in rows.items()}


def recorded(family, forces):
    """The tracks of a family's scenes by the ordinary simulation."""
    scenes = [dataclasses.replace(case.scene, seconds=family.seconds) for case in family.cases]
    return [np.asarray(tracks.position, float) for tracks in simulate(scenes, model(forces))]


@pytest.mark.slow
def test_a_single_file_is_measured_as_its_tracks(monkeypatch):
    forces = preset("calibrated")  # whose files move alike, whatever the rounding
    monkeypatch.setattr(families.SingleFile, "seconds", 8.0)
    family = families.SingleFile([families.Case(f"{n}", crowds.in_file(n, 8.0, 0.0, 1, 0.2)) for n in (10, 12)])
    rows = measured(family, forces)
    for case, x in zip(family.cases, recorded(family, forces), strict=True):
        speed = measures.steps_along(x[40::4, :, 0], 8.0) / 0.4
        assert rows[f"file {case.row}"] == pytest.approx(speed.mean(), rel=1e-3)
        assert rows[f"file deviation {case.row}"] == pytest.approx(measures.deviation_in_time(speed), rel=0.02)


@pytest.mark.slow
def test_meetings_and_encounters_are_measured_as_their_tracks():
    forces = plain()
    cases = [families.Case(f"{a}", individuals.two(np.deg2rad(a), 0.1, (1.3, 1.3))) for a in (180, 90)]
    pairs = families.Pairs(cases, 0.4)
    apart = [float(measures.separation(x[:, 0], x[:, 1])) for x in recorded(pairs, forces)]
    assert measured(pairs, forces) == pytest.approx(
        {"pairs gap": min(apart) - 0.4, "pairs head-on": apart[0]}, abs=1e-3
    )
    passing = families.Passing([families.Case("", scene) for scene in individuals.passing_scenes(3)], 0.6)
    apart = [
        float(measures.separation(x[:, 0], case.scene.robot_path(0.1 * np.arange(len(x)))))
        for case, x in zip(passing.cases, recorded(passing, forces), strict=True)
    ]
    wanted = {"clearance": np.mean(apart), "deviation": np.std(apart), "touched": np.mean(np.less(apart, 0.6))}
    assert measured(passing, forces) == pytest.approx(
        {f"robot {name}": value for name, value in wanted.items()}, abs=1e-3
    )


@pytest.mark.night
def test_doors_corridors_and_lanes_are_measured_as_their_tracks(monkeypatch):
    forces = preset("calibrated")
    monkeypatch.setattr(families.Doors, "seconds", 10.0)  # later, rounding makes other crowds of the same kind
    room = doors.before_door(1.6, doors.crowd_in_room(0), 1.34, 0.0)
    family = families.Doors([families.Case(name, room) for name in ("here", families.Doors.PRESS)])
    scene = dataclasses.replace(room, seconds=family.seconds)
    tracks = simulate(scene, "calibrated")[0]
    rows, times = measured(family, forces), measures.crossing_times(tracks, scene.gates[0])
    assert rows["flow here"] == pytest.approx(measures.flow(times), rel=0.08)  # the last may cross in the last step
    assert rows["doors inside"] == pytest.approx(np.isinf(times).sum(), abs=1)
    assert rows["density here"] == pytest.approx(
        measures.peak(measures.densities(tracks.position, tracks.present, *doors.BEFORE), 100), rel=0.05
    )
    press = simulate(dataclasses.replace(scene, seed=1), "calibrated")[0]  # the second case has other people
    later = slice(round(doors.APART / 0.1), None)
    place, facing, there = (np.asarray(part)[later] for part in (press.position, press.facing, press.present))
    deep = measures.overlap(place, facing, there, forces.walking)
    assert rows["overlap"] == pytest.approx(deep, abs=1e-3)
    monkeypatch.setattr(families.Corridor, "seconds", 8.0)
    monkeypatch.setattr(families.Lanes, "seconds", 8.0)
    scenes, _ = crowds.corridors((0.4,), 1, 0.0, crowds.hermes_speeds)
    corridor = families.Corridor([families.Case("0.4", scenes[0])])
    (x,) = recorded(corridor, forces)
    speed = measures.steps_along(x[40:, :, 0], crowds.PERIOD) / 0.1
    assert measured(corridor, forces) == pytest.approx({"corridor 0.4": speed.mean()}, rel=1e-3)
    lanes = families.Lanes([families.Case("0.5", crowds.mixed_corridor(0.5, 0))])
    (x,) = recorded(lanes, forces)
    own = np.where(np.arange(x.shape[1]) < x.shape[1] // 2, 1.0, -1.0)
    order = measures.lane_order(x[..., 1], own, np.ones(x.shape[:2], bool))[-32:]
    assert measured(lanes, forces) == pytest.approx({"lanes 0.5": order.mean()}, rel=1e-3)


def test_candidates_side_by_side_are_as_each_alone():
    family = families.Pairs([families.Case("180", individuals.two(np.pi, 0.1, (1.3, 1.3)))], 0.4)
    both = Crowds([family], plain(), lambda own: plain().tree_replace({"repulsion.strength": own[0]}))
    values = jnp.asarray([[5.0], [0.0], [5.0]])
    apart = both.rows(values)["pairs head-on"]
    assert apart[0] == apart[2] == both.rows(values[:1])["pairs head-on"][0]
    assert apart[1] < apart[0] - 0.1


# ------------------------------------------------------------------ the loss


def test_rows_have_targets():
    exact = {
        f"{group} {loss._case(case)}".removesuffix(" any"): np.array([float(target)])
        for group, table in loss.GROUPS.items()
        for case, target in (table["target"] if isinstance(table["target"], dict) else {"any": table["target"]}).items()
    }
    exact |= {"file deviation 1.125": np.array([9.0]), "flow press": np.array([9.0])}  # measured, without a target
    assert loss.target_of("flow press") is None and loss.target_of("file deviation 1.125") is None
    assert loss.target_of("waves deviation 40").tolerance == pytest.approx(0.15 * 0.141)
    assert loss.target_of("prediction eth") == loss.target_of("prediction hotel")
    assert loss.total(exact) == pytest.approx(0.0)
    low, high = ({"lanes 1": np.array([value])} for value in (0.90, 1.0))
    assert loss.total(high) == 0.0 and loss.total(low) == pytest.approx(2**0.5 - 1)  # one tolerance, on one side
    assert loss.total({"prediction eth": np.array([1.5])}, ("prediction eth",)) == 0.0
    assert loss.total({"lanes 1": np.array([np.nan, 1.0])}).tolist() == [loss.WORST, 0.0]


def test_every_row_of_the_crowds_is_in_the_loss():
    """The table and the scenes agree: each group of crowds has rows, and each target is measured."""
    named = [case.row for family in families.families(preset("calibrated"), 1, False) for case in family.cases]
    for group in ("corridor", "file", "waves", "flow", "density", "lanes"):
        for case in loss.GROUPS[group]["target"]:
            assert loss._case(case) in named, (group, case)


# ------------------------------------------------------------------ the search


def bowl(free):
    """Rows that are right at 1, 2, 3."""
    away = np.abs(free - [1.0, 2.0, 3.0]).sum(-1)
    return {"pairs head-on": 0.8 + 0.1 * away, "prediction eth": 0.96 + 0.0 * away}


def test_the_search_goes_where_the_loss_is_least_and_goes_on_as_before():
    whole = Search(bowl, np.zeros(3), [None, "eth"], 8, 3)
    for _ in range(40):
        whole.generation()
    np.testing.assert_allclose(whole.best(), np.broadcast_to([1.0, 2.0, 3.0], (2, 2, 3)), atol=0.1)
    half = Search(bowl, np.zeros(3), [None, "eth"], 8, 3)
    half.resume(np.stack(whole.tried[:20]), np.stack(whole.losses[:20]))
    for _ in range(20):
        half.generation()
    np.testing.assert_array_equal(half.tried, whole.tried)


def test_a_scene_that_is_left_out_is_not_fitted():
    """It pulls far away; only the search that has all scenes goes there, and each has its own best candidate."""

    def rows(free):
        away = np.abs(free + [3.0, 3.0, 3.0]).sum(-1)
        return bowl(free) | {"prediction eth": 0.96 + 0.8 * away}

    search = Search(rows, np.zeros(3), [None, "eth"], 8, 3)
    for _ in range(40):
        search.generation()
    whole, without = search.best()
    np.testing.assert_allclose(without, np.broadcast_to([1.0, 2.0, 3.0], (2, 3)), atol=0.1)
    assert (np.abs(whole - [1.0, 2.0, 3.0]).sum(-1) > 1.0).all()
    for k, losses in enumerate(np.stack(search.losses, 1)):
        tried = np.stack(search.tried, 1)[k].reshape(-1, 3)
        np.testing.assert_array_equal(search.best()[k][1], tried[losses.argmin()])
        left_out = ("prediction eth",) if k else ()
        np.testing.assert_allclose(losses.ravel(), loss.total(rows(tried), left_out))
    assert len(loss.total(rows(tried), ("prediction eth",))) == len(tried)


def test_known_constants_are_found_again():
    """From people who are known to walk straight at one another: the true constants have the least error."""
    random = np.random.default_rng(4)
    direction = np.stack([np.ones((8, 2)) * [1.0, -1.0], np.zeros((8, 2))], -1)  # windows, people, x and y
    begin = -direction * random.uniform(1.0, 2.0, (8, 1, 1)) + random.uniform(-0.3, 0.3, (8, 2, 2))
    speed = float(np.mean(HABITS.speed))  # where fits begin
    observed = begin[:, None] + np.array([-STEP, 0.0])[:, None, None] * (direction * speed)[:, None]
    known = np.ones((8, 2, 2), bool)
    true = plain().tree_replace(TRUE)
    after = np.asarray(predict(true, observed, STEP, 6, desired_velocity=direction * speed))
    kind = windows.Scenes(
        observed=observed, known=known, after=after, counted=np.ones((8, 6, 2), bool), scene=np.arange(8) % 2,
        direction=direction, others=None, walls=None, reference=np.ones((2, 2)), names=("north", "south"),
        time_step=STEP,
    )  # fmt: skip
    wrong = with_values(0.3, 1.5, 0.2)
    start = np.append(np.asarray(fitting.to_free(NAMES, fitting.values_of(wrong, NAMES))), np.zeros(len(HABITS)))
    recordings = Recordings(wrong, NAMES, [kind])

    def rows(free):
        free = np.concatenate([free[:, : len(NAMES)], np.zeros((len(free), len(HABITS)))], 1)
        measured = recordings.rows(jnp.asarray(free, float))
        return {"pairs head-on": 0.8 + measured["prediction north"] + measured["prediction south"]}  # no less than it

    search = Search(rows, start, [None], 8, 0)
    for _ in range(30):
        search.generation()
    before, after = rows(start[None])["pairs head-on"] - 0.8, rows(search.best()[0])["pairs head-on"] - 0.8
    assert after.min() < 0.2 * before[0], (before, after)


def options(scenes, folder, **others):
    given = dict(data=scenes, forces="helbing1995", fit=",".join(NAMES[1:]), generations=3, population=4,
        draws=1, quick=True, out=folder, quiet=True)  # fmt: skip
    return CalibrateConfig(**{**given, **others})


def fewer_families(monkeypatch):
    """Crowds of two families alone, each of which takes long to compile."""
    families_of = search.families
    kept = families.Corridor, families.Passing
    monkeypatch.setattr(search, "families", lambda *given: [each for each in families_of(*given) if type(each) in kept])


@pytest.mark.night
def test_the_command_writes_constants_figures_and_a_report(scenes, tmp_path, monkeypatch):
    fewer_families(monkeypatch)
    folder = calibration.run(options(scenes, tmp_path / "one"))
    names = {file.name for file in folder.iterdir() if not file.name.startswith(".")}
    assert names == {
        "forces.yaml", "forces-without-north.yaml", "forces-without-south.yaml", "results.json", "calibration.json",
        "report.html",
    }  # fmt: skip
    results = json.loads((folder / "results.json").read_text())
    fitted = build(str(folder / "forces.yaml"))
    for name in NAMES[1:]:
        assert float(fitting.values_of(fitted, [name])[0]) == pytest.approx(
            results["parameters"]["all"][name], rel=1e-5
        )
    assert {"constant velocity", "before", "all scenes", "left out"} < set(results["scores"]["north (recorded)"])
    assert np.array(results["losses"]["all"]).shape == (3, 4)
    assert {"prediction north", "corridor 1", "robot clearance"} < set(results["rows"])
    assert results["loss"]["all"] <= results["loss"]["before"]
    page = (folder / "report.html").read_text()
    assert "repulsion.strength" in page and "without north" in page


@pytest.mark.night
def test_a_fit_that_was_stopped_goes_on(scenes, tmp_path, monkeypatch):
    """And gives the same constants."""
    fewer_families(monkeypatch)
    results = json.loads((calibration.run(options(scenes, tmp_path / "one")) / "results.json").read_text())
    whole = Search.generation
    calls = []

    def broken(self, *arguments):
        if len(calls) == 2:
            raise KeyboardInterrupt
        calls.append(1)
        return whole(self, *arguments)

    monkeypatch.setattr(Search, "generation", broken)
    with pytest.raises(KeyboardInterrupt):
        calibration.run(options(scenes, tmp_path / "two"))
    assert (tmp_path / "two" / "unfinished.npz").is_file()
    monkeypatch.setattr(Search, "generation", whole)
    with pytest.raises(InputError, match="was begun with --generations 3, not 5"):
        calibration.run(options(scenes, tmp_path / "two", generations=5))
    calibration.run(options(scenes, tmp_path / "two"))
    again = json.loads((tmp_path / "two" / "results.json").read_text())
    assert again["parameters"]["all"] == pytest.approx(results["parameters"]["all"], rel=1e-5)
    assert not (tmp_path / "two" / "unfinished.npz").exists()


def test_what_cannot_be_fitted_is_refused_and_leaves_no_trace(scenes, tmp_path):
    for wrong, message in (
        (dict(leave_out="north, east"), "leave_out: 'east' is not one of north, south"),
        (dict(fit="repulsion.size"), "fit: 'repulsion.size'"),
        (dict(forces="helbing"), "helbing1995"),
        (dict(data=tmp_path), "has no recordings"),
    ):
        with pytest.raises(InputError, match=message):
            calibration.run(options(scenes, tmp_path / "three", **wrong))
        assert not (tmp_path / "three").exists()
