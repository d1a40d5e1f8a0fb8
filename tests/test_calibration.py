"""Constants of the social forces from recorded people."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import sean_jax
from sean_jax import FileError, InputError, preset
from sean_jax.config import CalibrateConfig
from sean_jax.social_forces import PRESETS, build, presets
from sean_jax.studies import calibration
from sean_jax.studies.calibration import fitting, windows
from sean_jax.studies.calibration.fitting import HABITS, Fit
from sean_jax.studies.prediction import predict

NAMES = ["walking.relaxation_time", "repulsion.strength", "repulsion.range"]
TRUE = {"walking.relaxation_time": 0.5, "repulsion.strength": 4.0, "repulsion.range": 0.35}
STEP = 0.4


def plain():
    """Forces with one pair term, quick to compile."""
    whole = preset("helbing1995")
    return build([whole.walking, whole.repulsion])


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
    scenario = sean_jax.make("warehouse", people=4, dynamics="twin", forces=str(file))
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
        (
            "preset: sean2\nparameters: {walking.relaxation_time: 0}\n",
            "relaxation_time: 0.0 must be from 0.001",
        ),
        ("preset: sean2\nparameters: {walking.lateral_damping: 0}\n", "lateral_damping: 0.0 must be from 0.001"),
        ("preset: sean2\nparameters: {walking.speed_min: 3}\n", "forces.walking: speed_min is more than speed_max"),
        ("preset: sean2\nparameters: {repulsion.reach: 9}\n", "forces.repulsion: reach is more than 20 times range"),
        (
            "preset: calibrated\nparameters: {headway.length: 1.8}\n",
            "headway: range is less than 0.01 m more than length",
        ),
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
    usual = fitting.names_of(preset("helbing1995"))
    assert {"repulsion.anticipation", "sidestep.preference", "walls.range"} <= set(usual)
    assert not any(name.startswith("headway") for name in usual)
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


# ------------------------------------------------------------------ the fit


def test_known_constants_are_found_again():
    """From people who are known to walk straight at one another."""
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
    fit = Fit(wrong, NAMES, [kind], 40, 4)
    descent = fit.start(2, 1, 0)
    for step in range(40):
        descent, loss = fit.descend(descent, np.array([[1.0, 1.0], [1.0, 0.0]]), fit.rows(0, step))
        assert np.isfinite(loss).all()
    before, after, other = fit.errors(jnp.concatenate([fit.start(1, 1, 0).free[:, 0], descent.mean[:, 0]]))[0].mean(-1)
    assert max(after, other) < 0.2 * before, (before, after, other)


def options(scenes, folder, **others):
    given = dict(data=scenes, forces="helbing1995", fit=",".join(NAMES[1:]), steps=4, batch=2, out=folder, quiet=True)
    return CalibrateConfig(**{**given, **others})


@pytest.mark.slow
def test_the_command_writes_constants_figures_and_a_report(scenes, tmp_path):
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
    assert set(results["scores"]["north (recorded)"]) == {"constant velocity", "before", "all scenes", "left out"}
    assert np.array(results["losses"]["all"]).shape == (4, 1)
    page = (folder / "report.html").read_text()
    assert "repulsion.strength" in page and "without north" in page


@pytest.mark.slow
def test_a_fit_that_was_stopped_goes_on(scenes, tmp_path, monkeypatch):
    """And gives the same constants."""
    results = json.loads((calibration.run(options(scenes, tmp_path / "one")) / "results.json").read_text())
    whole = Fit.descend
    calls = []

    def broken(self, *arguments):
        if len(calls) == 2:
            raise KeyboardInterrupt
        calls.append(1)
        return whole(self, *arguments)

    monkeypatch.setattr(Fit, "descend", broken)
    with pytest.raises(KeyboardInterrupt):
        calibration.run(options(scenes, tmp_path / "two"))
    assert (tmp_path / "two" / "unfinished.npz").is_file()
    monkeypatch.setattr(Fit, "descend", whole)
    with pytest.raises(InputError, match="was begun with --steps 4, not 5"):
        calibration.run(options(scenes, tmp_path / "two", steps=5))
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


@pytest.mark.slow
def test_recorded_scenes_are_predicted_better_by_fitted_constants(recordings, tmp_path):
    given = options(recordings, tmp_path / "real", fit=None, leave_out="none", steps=10, forces="helbing1995")
    results = json.loads((calibration.run(given) / "results.json").read_text())
    before, after = (results["errors"][what] for what in ("before", "all"))
    assert sum(after.values()) < sum(before.values())
    assert jax.tree.all(jax.tree.map(np.isfinite, after))
