"""``sean survey ratings``: files of SocNav3's format are measured as a float64 loop does, and ratings are compared."""

import csv
import json

import numpy as np
import pytest
import scipy.stats
from rich.console import Console

from sean_jax.cli import command_line
from sean_jax.core.errors import FileError, InputError
from sean_jax.studies.survey import ratings, report

STEP = 0.2  # s between frames of a file


def pose(x: float, y: float, angle: float) -> dict:
    return {"x": x, "y": y, "angle": angle}


def trajectory(aside=1.0, steps=40, speed=0.5, goal=4.0, person_speed=-0.5, begin=1000.0) -> dict:
    """A robot along x; a person who comes towards it at a distance aside, and one who stands and looks at the start."""
    disc = {"type": "circle", "width": 0.6, "length": 0.6}
    sequence = []
    for k in range(steps + 1):
        time = STEP * k
        people = [{"id": 7, **pose(4.0 + person_speed * time, aside, np.pi)}]
        if 10 <= k <= 30:
            people.append({"id": 3, **pose(0.0, -3.0, np.pi / 2)})
        sequence.append({
            "timestamp": begin + time,
            "robot": {**pose(speed * time, 0.0, 0.0), "shape": disc, "speed_x": speed, "speed_y": 0.0, "speed_a": 0.0},
            "goal": {**pose(goal, 0.0, 0.0), "type": "go-to", "human": None, "pos_threshold": 0.3},
            "people": people,
            "objects": [{"id": 1, "type": "table", **pose(2.0, 2.0, np.pi / 2), "shape":
                         {"type": "rectangle", "width": 2.0, "length": 1.0}}],
        })  # fmt: skip
    grid = {"width": 1, "height": 1, "cell_size": 1.0, "x_orig": 0.0, "y_orig": 0.0, "angle_orig": 0.0, "data": [[0]]}
    walls = [[-1.0, -2.5, 5.0, -2.5], [0.0, 0.0, 0.0, 0.0]]  # the second one is none
    return {"metadata": "made here", "grid": grid, "walls": walls, "sequence": sequence}


def write(path, content) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def measured(tmp_path, content) -> dict[str, float]:
    write(tmp_path / "000000001.json", content)
    return ratings.measure(ratings.read(tmp_path / "000000001.json"))


def test_the_robot_is_as_wide_as_its_longer_side(tmp_path):
    for width, length in ((0.5, 0.8), (0.8, 0.5)):
        content = trajectory(1.0, 40)
        for frame in content["sequence"]:
            frame["robot"]["shape"] = {"type": "rectangle", "width": width, "length": length}
        write(tmp_path / "000000001.json", content)
        assert ratings.read(tmp_path / "000000001.json").robot_radius == np.float32(0.4)


def test_a_mean_names_its_rating_and_its_trial():
    rows = [{"trial": trial, "ratings": {"calm": float(value)}} for trial, value in (("a", 1), ("a", 3), ("b", 5))]
    found = report.means(rows)
    assert [(mean.rating, mean.trial, mean.value, mean.participants) for mean in found] == [
        ("calm", "a", 2.0, 2), ("calm", "b", 5.0, 1),
    ]  # fmt: skip


@pytest.mark.parametrize("aside", [0.3, 0.9, 2.0])
@pytest.mark.parametrize("steps", [40, 70])  # in arrays of 128 and 256 rows
def test_metrics_are_those_of_a_loop(tmp_path, aside, steps):
    values = measured(tmp_path, trajectory(aside, steps, goal=0.5 * STEP * steps + 0.2))
    times = np.arange(round(STEP * steps / 0.1) + 1) * 0.1
    robot = np.stack([0.5 * times, 0.0 * times], -1)
    walker = np.stack([4.0 - 0.5 * times, np.full(len(times), aside)], -1)
    gap = np.linalg.norm(walker - robot, axis=-1)
    there = (times > 2.0 - 1e-6) & (times < 6.0 + 1e-6)
    other = np.where(there, np.linalg.norm(robot - (0.0, -3.0), axis=-1), np.inf)
    nearest = np.minimum(gap, other)
    assert values["time_in_situation"] == pytest.approx(times[-1], abs=1e-4)
    assert values["path_length"] == pytest.approx(0.5 * times[-1], abs=1e-4)
    assert values["path_efficiency"] == pytest.approx(0.5 * times[-1] / (0.5 * times[-1] + 0.2), abs=1e-4)
    assert values["min_distance_to_people"] == pytest.approx(nearest.min(), abs=1e-4)
    assert values["personal_space_compliance"] == pytest.approx((nearest[1:] >= 0.5).mean(), abs=1e-6)
    touches = gap <= 0.3 + 0.2 + 0.01
    assert values["collision_robot_on_person"] == (touches[1:] & ~touches[:-1]).sum()
    assert values["min_distance_to_obstacles"] == pytest.approx(
        1.5, abs=1e-4
    )  # half the table's length from its middle
    assert (values["reached_goal"], values["collision_with_obstacle"]) == (1.0, 0.0)
    assert values["mean_speed"] == pytest.approx(0.5, abs=1e-4) and values["max_jerk"] < 0.02
    seen = (walker[:, 0] - robot[:, 0] >= np.cos(np.radians(5.0)) * gap) & (gap <= 3.6)
    up = (np.array([0.0, 1.0]) * (robot - (0.0, -3.0))).sum(-1) >= np.cos(np.radians(5.0)) * other
    seen |= there & up & (other <= 3.6)
    assert values["time_looked_at"] == pytest.approx(0.1 * seen[1:].sum(), abs=0.11)


def test_a_robot_that_ends_elsewhere_has_no_efficiency(tmp_path):
    values = measured(tmp_path, trajectory(goal=9.0))
    assert values["reached_goal"] == 0.0 and "path_efficiency" not in values
    assert values["final_distance_to_goal"] == pytest.approx(9.0 - 0.5 * 8.0, abs=1e-4)


@pytest.mark.parametrize(("last", "nearest"), [(25, 1.0), (24, 0.3)])  # a gap of 2.2 s and one of 2 s
def test_a_person_is_absent_in_a_long_gap(tmp_path, last, nearest):
    content = trajectory(aside=0.3)
    for frame in content["sequence"][15:last]:  # in which the person passes
        frame["people"] = []
    assert measured(tmp_path, content)["min_distance_to_people"] == pytest.approx(nearest, abs=0.1)


def dataset(tmp_path, raters=8, number=12) -> tuple[str, str]:
    """Raters who like distance, and trajectories in two folders; two of them are variants of one."""
    draw = np.random.default_rng(0)
    aside = draw.uniform(0.2, 2.5, number)
    for k in range(number):
        write(tmp_path / "data" / "unlabeled" / "ab"[k % 2] / f"{k + 1:09}.json", trajectory(float(aside[k])))
    groups = {"0": ["000000001.json", "000000002.json"], "1": ["000000003.json"]}
    write(tmp_path / "data" / "unlabeled" / "trajectory_variants.json", groups)
    for rater in range(raters):
        indices = draw.permutation(number)[:8] + 1
        taste = np.clip(aside[indices - 1] / 3 + draw.normal(size=8) * 0.1, 0, 1)
        answers = {str(k): float(value) for k, value in enumerate(taste)}
        content = {"indices": indices.tolist(), "descriptions": ["A robot."] * 8, "answers": answers, "country": "a\nb"}
        path = tmp_path / "data" / "ratings" / f"rater-{rater}.json"
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps(content).replace("\\n", "\n"))  # ends of lines in words, as in the dataset
    return str(tmp_path / "data" / "unlabeled"), str(tmp_path / "data" / "ratings")


def test_the_command_writes_correlations(tmp_path, capsys):
    folders = dataset(tmp_path)
    assert command_line.main(["survey", "ratings", *folders, "--out", str(tmp_path / "out")]) == 0
    assert "correlations were computed" in capsys.readouterr().out
    found = {row["metric"]: row for row in csv.DictReader((tmp_path / "out" / "correlations.csv").open())}
    table = {row["trajectory"]: row for row in csv.DictReader((tmp_path / "out" / "trajectories.csv").open())}
    assert "path_length" not in found  # equal for all
    pairs, means = [], {}
    for rater in range(8):
        content = json.loads((tmp_path / "data" / "ratings" / f"rater-{rater}.json").read_text(), strict=False)
        for place, value in content["answers"].items():
            number = str(content["indices"][int(place)])
            pairs.append((value, float(table[number]["min_distance_to_people"])))
            means.setdefault(number, []).append(value)
    row = found["min_distance_to_people"]
    expected = scipy.stats.spearmanr(*zip(*pairs, strict=True)).statistic
    assert float(row["value"]) == pytest.approx(expected) and expected > 0.7
    assert float(row["low"]) < expected < float(row["high"]) and float(row["p"]) < 0.05
    assert (row["pairs"], row["participants"]) == ("64", "8")
    for number, some in means.items():
        assert float(table[number]["mean_rating"]) == pytest.approx(np.mean(some))
        assert table[number]["variant"] == {"1": "variant 0", "2": "variant 0", "3": "variant 1"}.get(number, number)
    assert "Fisher" in (tmp_path / "out" / "report.html").read_text()
    assert command_line.main(["survey", "ratings", *folders, "--out", str(tmp_path / "out")]) == 2  # it is not empty


def of_raters_and_trajectories(draw, raters=12, trajectories=15) -> list[dict]:
    """Ratings and a metric that are independent: a rater's taste, a trajectory's charm, and noise."""
    taste, charm, metric = draw.normal(size=raters), draw.normal(size=trajectories), draw.normal(size=trajectories)
    return [
        {"participant": j, "trial": k, "ratings": {"a": taste[j] + charm[k] + draw.normal()},
         "metrics": {"b": metric[k]}}
        for j in range(raters) for k in draw.permutation(trajectories)[:6]
    ]  # fmt: skip


def test_intervals_over_raters_and_trajectories_cover(monkeypatch):
    """Zero is inside in about 95 % of cases; with raters alone as the units it would be far less."""
    monkeypatch.setattr(report, "RESAMPLES", 200)
    both = raters = 0
    for seed in range(200):
        rows = of_raters_and_trajectories(np.random.default_rng(seed))
        (one,), (other,) = report.correlations(rows, ("participant", "trial")), report.correlations(rows)
        both, raters = both + (one.low <= 0 <= one.high), raters + (other.low <= 0 <= other.high)
    assert 0.88 <= both / 200 <= 0.99 and raters < both - 20


def refusal(tmp_path, content) -> str:
    write(tmp_path / "000000001.json", content)
    with pytest.raises(FileError) as error:
        ratings.read(tmp_path / "000000001.json")
    return str(error.value)


@pytest.mark.parametrize(
    ("keys", "value", "words"),
    [
        (("sequence", 3, "robot", "x"), "near", ["sequence[3].robot.x", "'near'"]),
        (("sequence", 3, "robot", "x"), 1e9, ["sequence[3].robot.x", "1000000000"]),
        (("sequence", 2, "timestamp"), 1000.0, ["sequence[2].timestamp", "1000 s is not after 1000.2 s", "in order"]),
        (("sequence", 40, "timestamp"), 9000.0, ["sequence[40].timestamp", "8000 s", "3600 s"]),
        (("sequence", 0, "goal", "type"), "follow", ["sequence[0].goal.type", "'follow'", "go-to"]),
        (("sequence", 12, "people", 1, "id"), 7, ["sequence[12].people[1].id", "7 is there twice", "id"]),
        (("sequence", 0, "robot", "shape", "type"), "polygon", ["robot.shape.type", "'polygon'", "circle"]),
        (("walls", 0), [1, 2, 3], ["walls[0]"]),
        (("sequence",), [], ["sequence"]),
    ],
)
def test_wrong_values_are_named(tmp_path, keys, value, words):
    content = trajectory()
    place = content
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = value
    message = refusal(tmp_path, content)
    assert "000000001.json" in message and all(word in message for word in words), message


def test_a_missing_key_is_named(tmp_path):
    content = trajectory()
    del content["sequence"][5]["people"]
    assert "sequence[5].people" in refusal(tmp_path, content)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"answers": {"9": 0.5}}, ["answers.9", "no place in the 1 indices"]),
        ({"answers": {"9" * 5000: 0.5}}, ["answers.9", "no place in the 1 indices"]),
        ({"answers": {"0": 7.0}}, ["answers.0", "7"]),
        ({"indices": [55]}, ["indices[0]", "55 has no file 000000055.json"]),
    ],
)
def test_wrong_ratings_are_named(tmp_path, change, words):
    write(tmp_path / "t" / "000000001.json", trajectory())
    write(tmp_path / "r" / "one.json", {"indices": [1], "descriptions": [""], "answers": {"0": 0.5}} | change)
    with pytest.raises(FileError) as error:
        ratings.rated(tmp_path / "t", tmp_path / "r", Console(quiet=True))
    assert all(word in str(error.value) for word in ["one.json", *words]), error.value


def test_folders_without_files_are_refused(tmp_path):
    (tmp_path / "r").mkdir()
    with pytest.raises(InputError, match=r"000000001\.json; give the folder"):
        ratings.rated(tmp_path, tmp_path / "r", Console(quiet=True))
    write(tmp_path / "a" / "000000001.json", trajectory())
    with pytest.raises(InputError, match="has no file"):
        ratings.rated(tmp_path, tmp_path / "r", Console(quiet=True))
    write(tmp_path / "b" / "000000001.json", trajectory())
    with pytest.raises(FileError, match="keep one of them"):
        ratings.rated(tmp_path, tmp_path / "r", Console(quiet=True))
